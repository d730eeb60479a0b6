"""Programs in files: what a control may see of a folder, and what becomes of a file that arrives."""

from hashlib import sha256
from pathlib import Path

import pytest

from postprocessors.dnc.blockwise import BlockwiseServer
from postprocessors.dnc.folder import FileSink, Folder, OneFile, OneProgram, same_name
from postprocessors.dnc.program import Program, read_program
from postprocessors.dnc.standard import StandardReceiver
from postprocessors.dnc.store import Refusal
from postprocessors.dnc.wire import make_frame
from postprocessors.errors import DeviceError, PostError
from tests.postprocessors.dnc.line import Line, control_for, profile

OWN = profile("blockwise")
TEXT = b"0 BEGIN PGM A MM\r\n1 L X+1\r\n2 END PGM A MM\r\n"


def serve(path: Path, **options: bool) -> Folder:
    return Folder(path, OWN, lambda file, digest: None, **options)


def test_names_are_the_same_without_case_and_extension() -> None:
    assert same_name("blade1", "BLADE1.H") and same_name("A.H", "a.h")
    assert not same_name("A.H", "A.I") and not same_name("A", "B.H")


@pytest.mark.parametrize("name", ["../X", "X/Y", ".X", "", "A B", "X" * 60, "A\x00", "..", "TNC:\\X"])
def test_illegal_names_are_neither_read_nor_written(name: str, tmp_path: Path) -> None:
    (tmp_path / "inside").mkdir()
    (tmp_path / "X").write_bytes(TEXT)
    folder = serve(tmp_path / "inside")
    with pytest.raises(Refusal):
        folder.read(name, "H")
    with pytest.raises(Refusal, match="ILLEGAL NAME"):
        folder.create(name, "H")
    assert [path.name for path in tmp_path.iterdir()] in (["inside", "X"], ["X", "inside"])


def test_a_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    sink = serve(tmp_path).create("NEW", "H")
    sink.write(b"line")
    assert not (tmp_path / "NEW.H").exists()
    assert serve(tmp_path).directory() == []
    sink.commit()
    assert (tmp_path / "NEW.H").read_bytes() == b"line\r\n"
    other = serve(tmp_path).create("OTHER", "D")
    other.discard()
    assert [path.name for path in tmp_path.iterdir()] == ["NEW.H"]


def test_a_file_that_appears_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    sink = serve(tmp_path).create("NEW", "H")
    sink.write(b"late")
    (tmp_path / "NEW.H").write_bytes(b"early")
    with pytest.raises(Refusal):
        sink.commit()
    assert (tmp_path / "NEW.H").read_bytes() == b"early"
    assert len([*tmp_path.iterdir()]) == 1


def test_overwriting_is_told_and_read_only_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a.h").write_bytes(TEXT)
    with pytest.raises(Refusal, match="FILE EXISTS"):
        serve(tmp_path).create("A.H", "H")
    with pytest.raises(Refusal, match="READ ONLY"):
        serve(tmp_path, writable=False).create("B.H", "H")
    sink = serve(tmp_path, overwrite=True).create("A", "H")
    sink.write(b"new")
    sink.commit()
    assert (tmp_path / "a.h").read_bytes() == b"new\r\n"


def test_the_name_in_the_first_line_must_be_the_one_that_is_waited_for(tmp_path: Path) -> None:
    sink = FileSink(tmp_path / "B.H", overwrite=False, expected="B")
    with pytest.raises(DeviceError, match="program A from the control"):
        sink.write(b"0 BEGIN PGM A MM")
    sink.discard()
    assert [*tmp_path.iterdir()] == []


def test_one_program_and_one_file_serve_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "A.H").write_bytes(TEXT)
    program = OneProgram(read_program(tmp_path / "A.H", OWN))
    assert [*program.read("A", "H")] == TEXT.split(b"\r\n")[:-1]
    for refused in (
        lambda: program.read("B", "H"),
        lambda: program.create("A", "H"),
        lambda: OneFile("A", tmp_path / "C.H", False).read("A", "H"),
        lambda: OneFile("A", tmp_path / "C.H", False).create("B", "H"),
    ):
        with pytest.raises(Refusal):
            refused()


def test_a_server_sends_what_it_has_read_of_a_file_that_changes(tmp_path: Path) -> None:
    lines = ["0 BEGIN PGM A MM", *(f"{n} L X+{n}" for n in range(1, 200)), "200 END PGM A MM"]
    text = "".join(line + "\r\n" for line in lines).encode()
    path = tmp_path / "A.H"
    path.write_bytes(text)
    engine = BlockwiseServer(OWN, "folder", serve(tmp_path), once=False)
    control = control_for(OWN)

    def damage(number: int, character: int, now: float) -> tuple[list[int], float]:
        if number == 2000:
            path.write_bytes(text.replace(b"199 L X+199", b"199 L X-199"))
        return [character], 0.0

    Line(engine, control, to_control=damage, exact=False).run(lambda now: control.load("A.H", now))
    assert path.read_bytes() != text
    assert control.memory == {"A.H": text}


# --- verifications --------------------------------------------------------------------------------------------------

JUDGED_NAMES = [
    "X.H.verification.json",
    "X.H.VERIFICATION.JSON",
    "x.h.Verification.Json",
    "X.verification.json",
    "X.H.verification.json.",
    "X.H.verification.json...",
    "A.verification.json",
]


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("name", JUDGED_NAMES)
def test_no_control_writes_a_verification(name: str, overwrite: bool, tmp_path: Path) -> None:
    """Some file systems do not tell capitals, and drop full stops at the end."""
    (tmp_path / "A.verification.json").write_bytes(b"{}")
    for kind in ("H", "T", "A", "?", ""):
        with pytest.raises(Refusal, match="ILLEGAL NAME"):
            serve(tmp_path, overwrite=overwrite).create(name, kind)
    assert [path.name for path in tmp_path.iterdir()] == ["A.verification.json"]
    assert (tmp_path / "A.verification.json").read_bytes() == b"{}"


@pytest.mark.parametrize("name", JUDGED_NAMES)
def test_whatever_arrives_does_not_get_the_name_of_a_verification(name: str, tmp_path: Path) -> None:
    with pytest.raises(PostError, match="verification"):
        FileSink(tmp_path / name, overwrite=True)
    assert [*tmp_path.iterdir()] == []


def test_verifications_are_not_files_for_a_control(tmp_path: Path) -> None:
    """Nor is a link to one: replacing it, or reading through it, would be another way to it."""
    for name in ("X.H.verification.json", "Y.H.VERIFICATION.JSON"):
        (tmp_path / name).write_bytes(TEXT)
    (tmp_path / "LINK.H").symlink_to("X.H.verification.json")
    hidden = tmp_path / "Z.H.verification.json"
    hidden.symlink_to(".hidden")
    (tmp_path / ".hidden").write_bytes(TEXT)
    folder = serve(tmp_path, overwrite=True)
    assert folder.directory() == []
    for name in ("X.H.verification.json", hidden.name, "LINK.H", "LINK"):
        with pytest.raises(Refusal, match="FILE NOT FOUND"):
            folder.read(name, "H")
    with pytest.raises(Refusal, match="FILE EXISTS"):
        folder.create("LINK.H", "H")


def test_a_verification_does_not_arrive_over_the_line(tmp_path: Path) -> None:
    """A control that outputs X.H, and then what would make X.H pass for verified."""
    said: list[str] = []
    engine = BlockwiseServer(OWN, "folder", serve(tmp_path, overwrite=True), once=False, report=said.append)
    engine.begin(0.0)
    now = 0.0
    for name in (b"X.H", b"X.H.verification.json", b"X.H.Verification.JSON"):
        frames = [make_frame(1, b"H" + name + b"A", 0x17, never_control=False)]
        frames += [make_frame(2, line, 0x17, never_control=False) for line in TEXT.split(b"\r\n")[:-1]]
        for sent in (*frames, b"\x03", b"\x04"):
            engine.received(sent, now)
            now += 1.0
            engine.elapsed(now)
            engine.output(now)
    assert [path.name for path in tmp_path.iterdir()] == ["X.H"]
    assert sum("no control writes verifications" in text for text in said) == 2, said


def test_the_gate_is_asked_about_the_bytes_that_are_sent(tmp_path: Path) -> None:
    """Not about the file, which may be another by then."""
    path = tmp_path / "A.H"
    path.write_bytes(TEXT)
    asked: list[tuple[Path, str]] = []

    def gate(file: Path, digest: str) -> str | None:
        asked.append((file, digest))
        path.write_bytes(TEXT.replace(b"X+1", b"X-1"))
        return None

    lines = [*Folder(tmp_path, OWN, gate).read("A.H", "H")]
    assert asked == [(path, sha256(TEXT).hexdigest())]
    assert b"\r\n".join(lines) + b"\r\n" == TEXT


def test_a_link_that_is_turned_out_of_the_folder_while_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    (tmp_path / "SECRET").write_bytes(TEXT)
    (inside / "A.H").write_bytes(TEXT)

    def turned(path: Path, *arguments: object, **options: bool) -> Program:
        (inside / "A.H").unlink()
        (inside / "A.H").symlink_to(tmp_path / "SECRET")
        return read_program(path, OWN, **options)

    monkeypatch.setattr("postprocessors.dnc.folder.read_program", turned)
    with pytest.raises(Refusal, match="FILE NOT READABLE"):
        serve(inside).read("A.H", "H")


# --- one program in one transfer ------------------------------------------------------------------------------------


def second(text: bytes) -> bytes:
    return text.replace(b" A ", b" B ").replace(b"%A ", b"%B ")


ISO = b"%A G71 *\r\nN10 G17 G40 G90*\r\nN99999999 %A G71 *\r\n"
TWO = {
    "one after the other": TEXT + second(TEXT),
    "the same twice": TEXT + TEXT,
    "with lines between": TEXT + b"\r\n\r\n" + second(TEXT),
    "the first without an end": TEXT.rpartition(b"2 END")[0] + second(TEXT),
    "in ISO": ISO + second(ISO),
    "text after the end": TEXT + b"3 L X+5\r\n",
}


@pytest.mark.parametrize("name", TWO)
def test_a_control_that_outputs_two_programs_is_an_error(name: str, tmp_path: Path) -> None:
    """Standard protocol: lines of both, one ETX, one EOT; today's file would hold both under the first one's name."""
    engine = StandardReceiver(profile(), "A", FileSink(tmp_path / "A.H", overwrite=False, expected="A"))
    engine.begin(0.0)
    with pytest.raises(DeviceError, match=" after "):
        engine.received(b"\0\0\0" + TWO[name] + b"\x03\x04", 0.0)
    engine.abort("two programs", 0.0)
    assert [*tmp_path.iterdir()] == []


# A block without a character is none.
@pytest.mark.parametrize("name", sorted(TWO.keys() - {"with lines between"}))
def test_so_it_is_block_by_block(name: str, tmp_path: Path) -> None:
    said: list[str] = []
    engine = BlockwiseServer(OWN, "folder", serve(tmp_path), once=False, report=said.append)
    control = control_for(OWN, {"A.H": TWO[name]})
    Line(engine, control, exact=False).run(lambda now: control.save("A.H", now))
    assert [*tmp_path.iterdir()] == []
    assert any(" after " in text for text in said)


@pytest.mark.parametrize(
    "text",
    [
        TEXT,
        ISO,
        TEXT + b"\r\n\r\n",
        TEXT.replace(b"1 L", b"1 ; BEGIN PGM B MM\r\n2 L"),
        b"BEGIN TOOL .T MM\r\nT NAME L\r\n[END]\r\n",
        b"\r\n" + TEXT,
        b"0 BEGIN PGM \xc4 MM\r\n1 END PGM \xc4 MM\r\n",
    ],
)
def test_one_program_arrives_as_it_is(text: bytes, tmp_path: Path) -> None:
    sink = FileSink(tmp_path / "A.H", overwrite=False)
    for line in text.split(b"\r\n")[:-1]:
        sink.write(line)
    sink.commit()
    assert (tmp_path / "A.H").read_bytes() == text


def test_the_name_counts_after_empty_lines_too(tmp_path: Path) -> None:
    sink = FileSink(tmp_path / "B.H", overwrite=False, expected="B")
    sink.write(b"")
    with pytest.raises(DeviceError, match="program A from the control"):
        sink.write(b"0 BEGIN PGM A MM")
    sink.discard()
