"""The protocols against what the manuals print: the check character, transcripts, machine parameters."""

import re
from dataclasses import fields
from hashlib import sha256
from pathlib import Path

import pytest

from postprocessors.dnc.blockwise import BlockwiseServer
from postprocessors.dnc.profile import Profile, explain_mp5020, load_profile, shipped_profiles
from postprocessors.dnc.program import check_drip, feed_limit, read_program
from postprocessors.dnc.simulated_control import Faults
from postprocessors.dnc.standard import StandardReceiver, StandardSender
from postprocessors.dnc.wire import block_check, make_frame
from postprocessors.errors import PostError
from tests.postprocessors.dnc.line import MemorySink, MemoryStore, profile

SOH, STX, ETX, EOT, ACK = b"\x01", b"\x02", b"\x03", b"\x04", b"\x06"
DC1, DC3, NAK, ETB, ESC = b"\x11", b"\x13", b"\x15", b"\x17", b"\x1b"
FIRST, LAST = b"0 BEGIN PGM 15 MM", b"1 END PGM 15 MM"


def frame(start: bytes, text: bytes) -> bytes:
    """By hand: XOR of everything from the start to ETB."""
    check = 0
    for character in start + text + ETB:
        check ^= character
    return start + text + ETB + bytes((check,))


def test_the_check_character_of_the_manual() -> None:
    assert block_check(bytes.fromhex("01 48 31 35 45 17")) == 0x1F
    assert make_frame(1, b"H15E", 0x17, never_control=False) == bytes.fromhex("01 48 31 35 45 17 1F")


def test_the_rule_for_check_characters_below_a_space() -> None:
    assert make_frame(1, b"H15E", 0x17, never_control=True) == bytes.fromhex("01 48 31 35 45 20 17 3F")
    assert make_frame(2, b"L", 0x17, never_control=True) == frame(STX, b"L")


def exchange(engine, *steps: tuple[str, bytes]) -> None:
    """Give what the control sends (<) and expect what goes to it (>), character by character."""
    now = 0.0
    engine.begin(now)
    for sign, characters in steps:
        if sign == "<":
            engine.received(characters, now)
            now += 0.1
            engine.elapsed(now)
            continue
        got = b""
        for _ in range(2000):
            got += engine.output(now)
            now += engine.profile.character_s
        assert got == characters


def test_reading_a_selected_program_in() -> None:
    """TNC 430, "Read-in selected file"."""
    engine = BlockwiseServer(profile("fe1"), "15", MemoryStore({"15.H": [FIRST, LAST]}), once=True)
    exchange(
        engine,
        ("<", frame(SOH, b"H15E") + DC1),
        (">", ACK + frame(STX, FIRST) + DC1),
        ("<", NAK),
        (">", frame(STX, FIRST) + DC1),
        ("<", ACK),
        (">", frame(STX, LAST) + DC1),
        ("<", ACK),
        (">", ETX),
        ("<", EOT),
    )
    assert engine.finished and engine.failure is None


@pytest.mark.parametrize("prompt", [DC1, b""])
def test_outputting_a_selected_program(prompt) -> None:
    """TNC 430, "Output selected file": its table has DC1 after the last check character only."""
    store = MemoryStore()
    engine = BlockwiseServer(profile("fe1"), "15", store, once=True)
    exchange(
        engine,
        ("<", frame(SOH, b"H15A") + prompt),
        (">", ACK),
        ("<", frame(STX, FIRST) + prompt),
        (">", ACK),
        ("<", frame(STX, LAST) + DC1),
        (">", ACK),
        ("<", ETX + EOT),
    )
    assert engine.finished and engine.failure is None
    assert store.sinks["15"].lines == [FIRST, LAST]
    assert store.sinks["15"].state == "committed"


def test_the_header_may_be_echoed() -> None:
    engine = BlockwiseServer(profile("fe1", header_answer="echo"), "15", MemoryStore(), once=True)
    exchange(engine, ("<", frame(SOH, b"H15A") + DC1), (">", frame(SOH, b"H15A")))


def test_reading_all_files_in() -> None:
    """TNC 407, "Read-in all files": headers without a name, ETX when there is no more."""
    store = MemoryStore({"A.H": [b"a1", b"a2"], "B.H": [b"b1"]})
    engine = BlockwiseServer(profile("blockwise"), "all", store, once=False)
    header = frame(SOH, b"HE") + DC1
    exchange(
        engine,
        ("<", header),
        (">", ACK + frame(STX, b"a1") + DC1),
        ("<", ACK),
        (">", frame(STX, b"a2") + DC1),
        ("<", header),
        (">", ACK + frame(STX, b"b1") + DC1),
        ("<", header),
        (">", ETX),
        ("<", EOT),
    )


def test_the_directory_by_breaking_off_each_file() -> None:
    """TNC 407, "Request external directory": a new header after the first block of each file."""
    store = MemoryStore({"A.H": [b"a1", b"a2"], "B.H": [b"b1", b"b2"]})
    engine = BlockwiseServer(profile("fe2"), "all", store, once=False)
    header = frame(SOH, b"NE") + DC1
    exchange(
        engine,
        ("<", header),
        (">", ACK + frame(STX, b"a1") + DC1),
        ("<", header),
        (">", ACK + frame(STX, b"b1") + DC1),
        ("<", header),
        (">", ETX),
        ("<", EOT),
    )


def test_the_directory_of_fe1() -> None:
    """TNC 306: four lines that are ignored, then name and sectors."""
    store = MemoryStore({"15.H": [b"x" * 1022], "B.H": [b"b"]})
    engine = BlockwiseServer(profile("fe1"), "all", store, once=False)
    exchange(
        engine,
        ("<", DC3 + ESC + DC1 + b"0 D\r\n"),
        (">", b"\r\n" * 4 + b"000001 15.H 2\r\n000002 B.H 1\r\n" + ETX),
        ("<", EOT),
    )


def test_a_refusal_is_a_header_with_a_text() -> None:
    engine = BlockwiseServer(profile("blockwise"), "15", MemoryStore(), once=True)
    exchange(engine, ("<", frame(SOH, b"H15E") + DC1), (">", frame(SOH, b"FILE NOT FOUND") + DC1))
    assert "there is no 15" in str(engine.failure)


def test_the_standard_protocol_in() -> None:
    """TNC 407: DC1, optional NULs, lines, ETX after the last, EOT."""
    engine = StandardSender(profile(leading_nulls=3), "15", iter([FIRST, LAST]))
    text = FIRST + b"\r\n" + LAST + b"\r\n"
    exchange(engine, ("<", DC1), (">", b"\0\0\0" + text + ETX), ("<", EOT))
    assert engine.finished and engine.failure is None


def test_the_standard_protocol_out() -> None:
    """TNC 306, "Example: protocol for dialog program": fifty NULs, lines, ETX EOT."""
    sink = MemorySink()
    engine = StandardReceiver(profile(), "15", sink)
    exchange(engine, ("<", b"\0" * 50 + FIRST + b"\r\n" + LAST + b"\r\n" + ETX + EOT), (">", b""))
    assert (sink.lines, sink.state) == ([FIRST, LAST], "committed")


def test_nothing_goes_out_between_dc3_and_dc1() -> None:
    engine = StandardSender(profile(), "15", iter([FIRST] * 9))
    engine.begin(0.0)
    engine.received(DC1, 0.0)
    assert len(engine.output(0.0)) == 8
    engine.received(DC3, 0.001)
    assert engine.output(60.0) == b""
    engine.received(DC1, 60.0)
    assert len(engine.output(60.0)) == 8


def test_an_error_of_the_device() -> None:
    """ESC 1 and a digit end a transfer in the standard protocol, in both directions."""
    sender = StandardSender(profile(), "15", iter([FIRST] * 99))
    sender.begin(0.0)
    sender.received(DC1, 0.0)
    sender.output(0.0)
    sender.received(ESC + b"13", 0.01)
    assert "error 13 from the control" in str(sender.failure)
    other = StandardSender(profile(), "15", iter([FIRST] * 99))
    other.begin(0.0)
    other.received(DC1, 0.0)
    other.output(0.0)
    other.abort("interrupted", 1.0)
    assert other.output(1.0) == ESC + b"10"


def test_the_usual_value_of_the_machine_parameter() -> None:
    """168: 7 data bits, even parity, 1 stop bit, DC3."""
    assert load_profile("itnc530-standard").mp5020 == 168
    said = explain_mp5020(168)
    assert (said["data_bits"], said["parity"], said["stop_bits"], said["handshake"]) == ("7", "even", "1", "dc3")


@pytest.mark.parametrize("name", shipped_profiles())
def test_shipped_profiles(name) -> None:
    shipped = load_profile(name)
    assert shipped.name == name
    said = explain_mp5020(shipped.mp5020)
    assert said["handshake"] == shipped.handshake
    assert shipped.bits_per_character == 10


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"baud": "0"}, "50 to 4000000"),
        ({"speed": "9600"}, "speed"),
        ({"parity": "mark"}, "parity"),
        ({"retries": "16"}, "0 to 15"),
        ({"etb": "2"}, "different control characters"),
        ({"protocol": "fe1", "data_bits": "8"}, "FE fixes"),
        ({"bcc_no_control": "true", "line_end_in_block": "true"}, "line_end_in_block"),
    ],
)
def test_profiles_that_cannot_be(changes, words) -> None:
    with pytest.raises(PostError) as caught:
        load_profile("itnc530-standard", changes)
    assert words in str(caught.value)


# --- drip feed ------------------------------------------------------------------------------------------------------


def write(path, *lines: str):
    path.write_bytes("".join(line + "\r\n" for line in lines).encode())
    return path


def test_the_line_limits_the_feed(tmp_path) -> None:
    """91 characters at 9600 baud take 0.1 s (96 with their frame); half a millimetre in that is F 300."""
    block = "2 LN X+0.5 Y+0.0 Z+0.0 NX+0.0 F800 ;"
    path = write(
        tmp_path / "P.H", "0 BEGIN PGM P MM", "1 L X+0.0 Y+0.0 Z+0.0 F800", block.ljust(91, "."), "3 END PGM P MM"
    )
    limit = feed_limit(read_program(path, profile("blockwise")), profile("blockwise"))
    assert limit.least == pytest.approx(300.0)
    assert (limit.least_line, limit.moves, limit.over) == (3, 1, 1)
    slow = feed_limit(read_program(path, profile("blockwise")), profile("blockwise"), turnaround_s=0.1)
    assert slow.least == pytest.approx(150.0)


@pytest.mark.parametrize(
    "line",
    ["1 LBL 1", "1 CALL LBL 2", "1 CALL PGM OTHER", "1 FN 9: IF +Q1 EQU +Q2 GOTO LBL 5", "1 CYCL DEF 12.0 PGM CALL",
     "N10 G98 L1 *", "N20 L1,3 *", "N30 %:OTHER *", "N40 D09 P01 +Q1 P02 +Q2 P03 5 *"],
)  # fmt: skip
def test_drip_feed_refuses_jumps(line, tmp_path) -> None:
    own = profile("blockwise")
    with pytest.raises(PostError) as caught:
        check_drip(read_program(write(tmp_path / "P.H", "0 L X+1", line), own))
    assert "line 2" in str(caught.value)


def test_drip_feed_takes_what_a_post_writes(tmp_path) -> None:
    lines = [
        "0 BEGIN PGM P MM",
        "1 ; LBL 1 IN A COMMENT",
        "2 L X+1 Y+2 R0 F100 M3",
        "3 CYCL DEF 32.0 TOLERANCE",
        "4 END PGM P MM",
    ]
    check_drip(read_program(write(tmp_path / "P.H", *lines), profile("blockwise")))


# --- text -----------------------------------------------------------------------------------------------------------


def test_characters_that_are_none_of_a_program(tmp_path) -> None:
    path = tmp_path / "P.H"
    for data, place in ((b"1 L X\x03\r\n", "line 1, column 6"), (b"a\r\n\xe4\r\n", "line 2, column 1"), (b"", "P.H")):
        path.write_bytes(data)
        with pytest.raises(PostError) as caught:
            read_program(path, profile())
        assert place in str(caught.value)
    path.write_bytes(b"a\r\n\xe4\r\n")
    assert read_program(path, profile(data_bits=8)).lines == 2


def test_a_program_that_changes_while_it_is_sent(tmp_path) -> None:
    """What was read is what is sent; nobody asks the file again."""
    lines = [f"{n} L X+{n}" for n in range(3000)]
    path = write(tmp_path / "P.H", *lines)
    program = read_program(path, profile())
    text = program.text()
    next(text)
    path.write_bytes(path.read_bytes().replace(b"2999 L X+2999", b"2999 L X-2999"))
    assert [*text] == [line.encode() for line in lines[1:]]
    path.unlink()
    assert sha256(program.data).hexdigest() == program.sha256
    assert [*program.text()] == [line.encode() for line in lines]


def test_a_device_without_end_is_no_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("postprocessors.dnc.program.LARGEST", 1 << 20)
    with pytest.raises(PostError, match="more than 1 MB"):
        read_program(Path("/dev/zero"), profile())


# --- what is left when somebody breaks off -------------------------------------------------------------------------


def test_what_the_standard_sender_leaves_behind() -> None:
    engine = StandardSender(profile(), "15", iter([FIRST, LAST]))
    engine.begin(0.0)
    assert engine.left_behind() == ""
    engine.received(DC1, 0.0)
    assert engine.left_behind() == ""
    assert engine.output(0.0)
    assert engine.left_behind() == "what has gone out to the control: 1 line"
    now = 0.0
    while engine.wake_at(now) is not None and (now := now + 0.01) < 5.0:
        engine.output(now)
    assert engine.left_behind() == "the whole program has gone out to the control (2 lines), which has not confirmed it"
    engine.received(EOT, now)
    assert (
        engine.finished
        and engine.left_behind() == "the control has received the whole program (2 lines) and confirmed it"
    )


def test_what_the_blockwise_server_leaves_behind() -> None:
    engine = BlockwiseServer(profile("blockwise"), "15", MemoryStore({"15.H": [FIRST, LAST]}), once=True)
    engine.begin(0.0)
    assert engine.left_behind() == ""
    said = []
    for sent in (frame(SOH, b"H15E") + DC1, ACK, ACK, EOT):
        engine.received(sent, 0.0)
        now = 0.0
        while engine.sending or now == 0.0:
            engine.output(now)
            now += 0.01
        said.append(engine.left_behind())
    assert said == [
        "the control has acknowledged 0 blocks of 15 and may have one more",
        "the control has acknowledged 1 block of 15 and may have one more",
        "the control has acknowledged 15 to its last block (2 blocks), but not the end",
        "the control has received all of 15 (2 blocks) and confirmed it",
    ]


def test_what_a_receiver_leaves_behind_is_nothing() -> None:
    engine = StandardReceiver(profile(), "15", MemorySink())
    exchange(engine, ("<", FIRST + b"\r\n"))
    engine.abort("interrupted", 1.0)
    assert engine.left == ""


# --- documentation --------------------------------------------------------------------------------------------------


def test_the_documentation_names_every_key_and_every_fault() -> None:
    text = (Path(__file__).parents[3] / "docs" / "dnc.md").read_text("utf-8")
    for name in (*Profile.__struct_fields__, *(field.name for field in fields(Faults))):
        assert re.search(rf"`{name}[`=]", text), name
    for name in shipped_profiles():
        assert f"`{name}`" in text
