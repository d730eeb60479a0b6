"""What `conflank dnc` asks of a verification before anything goes out, and that the bytes it asked about are sent."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result

from conflank_cli.cli import cli
from conflank_cli.commands import release as releasing
from conflank_cli.verification.result import FileHash, Verification, from_json
from tests.commands.judged import AGAINST, judge, verification_of
from tests.postprocessors.dnc.lsv2_server import FOLDER, Server

TEXT = b"0 BEGIN PGM BLADE1 MM\r\n1 L X+1 Y+2 Z+3 R0 F1000\r\n2 M30\r\n3 END PGM BLADE1 MM\r\n"
OTHER = TEXT.replace(b"X+1", b"X-9")
HAND_MADE = json.dumps(
    {"findings": [], "program_sha256": json.loads(verification_of(TEXT).to_json())["program_sha256"]}
)


def send(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["dnc", "send", "BLADE1.H", *arguments])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a verified program, the current one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "BLADE1.H").write_bytes(TEXT)
    judge(tmp_path / "BLADE1.H")
    return tmp_path


def edited(edit: Callable[[dict[str, Any]], object]) -> str:
    """The verification with a change to its JSON."""
    document = json.loads(verification_of(TEXT).to_json())
    edit(document)
    return json.dumps(document)


# --- what is refused ------------------------------------------------------------------------------------------------

BAD: dict[str, tuple[str | bytes, list[str]]] = {
    "made by hand": (HAND_MADE, ["schema"]),
    "schema left out": (edited(lambda d: d.pop("schema")), ["schema"]),
    "version left out": (edited(lambda d: d.pop("schema_version")), ["schema_version"]),
    "another schema": (edited(lambda d: d.update(schema="conflank/plan")), [": schema", "conflank/plan"]),
    "version 1": (edited(lambda d: d.update(schema_version=1)), ["schema_version", "found     1", "expected  2"]),
    "version 3": (edited(lambda d: d.update(schema_version=3)), ["schema_version", "found     3"]),
    "version as text": (edited(lambda d: d.update(schema_version="2")), ["schema_version", "str"]),
    "no record": (edited(lambda d: d.pop("against")), ["against"]),
    "no limits": (edited(lambda d: d["against"].pop("limits")), ["against", "limits"]),
    "unknown key": (edited(lambda d: d.update(approved=True)), ["approved"]),
    "unknown key inside": (edited(lambda d: d["against"].update(approved=True)), ["against", "approved"]),
    "findings a number": (edited(lambda d: d.update(findings=0)), ["findings", "int", "array"]),
    "findings null": (edited(lambda d: d.update(findings=None)), ["findings"]),
    "unknown code": (
        edited(lambda d: d.update(findings=[{"code": "CF999", "text": "x"}])),
        ["findings[0].code", "CF999"],
    ),
    "coverage as text": (edited(lambda d: d.update(coverage="all")), ["coverage", "str", "float"]),
    "unknown moves < 0": (edited(lambda d: d.update(unknown_moves=-1)), ["unknown_moves"]),
    "hash too short": (edited(lambda d: d.update(program_sha256="0")), ["program_sha256", "64 hexadecimal"]),
    "hash of capitals": (edited(lambda d: d["against"].update(job_sha256="A" * 64)), ["job_sha256"]),
    "hash of the part": (edited(lambda d: d["against"]["part"].update(sha256="x")), ["against.part.sha256"]),
    "called ../x": (edited(lambda d: d.update(called_sha256={"../x": "0" * 64})), ["called_sha256", "'../x'"]),
    "called x/y": (edited(lambda d: d.update(called_sha256={"x/y": "0" * 64})), ["called_sha256", "'x/y'"]),
    "called x\\y": (edited(lambda d: d.update(called_sha256={"x\\y": "0" * 64})), ["called_sha256"]),
    "called /etc/passwd": (edited(lambda d: d.update(called_sha256={"/etc/passwd": "0" * 64})), ["called_sha256"]),
    "called nothing": (edited(lambda d: d.update(called_sha256={"": "0" * 64})), ["called_sha256", "''"]),
    "called a dot": (edited(lambda d: d.update(called_sha256={".": "0" * 64})), ["called_sha256"]),
    "called two dots": (edited(lambda d: d.update(called_sha256={"..": "0" * 64})), ["called_sha256"]),
    "called NUL": (edited(lambda d: d.update(called_sha256={"A\0.H": "0" * 64})), ["called_sha256"]),
    "called a very long name": (edited(lambda d: d.update(called_sha256={"A" * 5000: "0" * 64})), ["called_sha256"]),
    "called hash a number": (edited(lambda d: d.update(called_sha256={"A.H": 0})), ["called_sha256"]),
    "truncated": (verification_of(TEXT).to_json()[:-9], ["invalid JSON"]),
    "empty": ("", ["invalid JSON"]),
    "a list": ("[]", ["array"]),
    "text": ("no JSON", ["invalid JSON"]),
    "not UTF-8": (b'{"schema": "\xff"}', ["invalid JSON"]),
    "NaN": (edited(lambda d: d.update(coverage=float("nan"))), ["invalid JSON"]),
    "nested lists": ("[" * 200_000, ["array"]),
    "nested tables": ('{"a":' * 200_000, ["nested too deeply"]),
    "nested in a key": (edited(lambda d: d)[:-1] + ', "x": ' + "[" * 200_000, ["nested too deeply"]),
    "number of 400 digits": (edited(lambda d: d)[:-1] + ', "schema_version": ' + "9" * 400 + "}", ["schema_version"]),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_verification_of_this_version_is_refused_by_place(folder: Path, name: str) -> None:
    text, words = BAD[name]
    path = folder / "BLADE1.H.verification.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    result = send()
    assert result.exit_code == 3, result.stderr
    for word in ("BLADE1.H.verification.json", *words):
        assert word in result.stderr, result.stderr
    assert result.stdout == "" and "Traceback" not in result.stderr
    # Whoever answers for the program needs no verification of it.
    assert send("--unverified").exit_code == 0


def test_a_missing_verification_and_one_of_another_text(folder: Path) -> None:
    (folder / "BLADE1.H").write_bytes(OTHER)
    result = send()
    assert result.exit_code == 3 and "another text" in result.stderr
    (folder / "BLADE1.H.verification.json").unlink()
    result = send()
    assert result.exit_code == 3 and "BLADE1.H.verification.json is missing" in result.stderr
    (folder / "BLADE1.H.verification.json").mkdir()
    assert send().exit_code == 3
    # A device or a pipe would be read, or waited for, without end.
    (folder / "BLADE1.H.verification.json").rmdir()
    (folder / "BLADE1.H.verification.json").symlink_to("/dev/null")
    result = send()
    assert result.exit_code == 3 and "no readable file" in result.stderr


def test_findings_are_exit_code_1(folder: Path) -> None:
    judge(folder / "BLADE1.H", ["CF201", "CF203", "CF201"])
    result = send()
    assert result.exit_code == 1
    assert "3 findings (CF201, CF203)" in result.stderr
    assert result.stdout == ""
    assert send("--unverified").exit_code == 0


@pytest.mark.parametrize("which", ["part", "machine", "obstacles"])
def test_inputs_without_a_hash_are_refused(folder: Path, which: str) -> None:
    unknown: Any = FileHash("x", None)
    against = msgspec.structs.replace(AGAINST, **{which: (unknown,) if which == "obstacles" else unknown})
    document = verification_of(TEXT, against=against).to_json()
    (folder / "BLADE1.H.verification.json").write_bytes(document)
    result = send()
    assert result.exit_code == 3 and "the hash of x" in result.stderr


# --- what is shown --------------------------------------------------------------------------------------------------


def test_what_was_judged_is_shown(folder: Path) -> None:
    shown = send().stdout
    for word in (
        "blade.step (sha256 111111111111)",
        "obstacle fixture.stl (sha256 222222222222)",
        "ac-table (sha256 333333333333), preset 3; judged by conflank 0.1.0",
        "face 7, face 9 region 0 0.5 0 1, copies 0 5 of 24",
        "overcut 10, undercut 12 µm, allowance 0.1 mm, coverage 90 %",
        "sha256 444444444444, machine ac-table",
        "coverage  95.12 %",
        "unknown   2 moves",
        "findings  none",
    ):
        assert word in shown, word
    document = json.loads(send("--json").stdout)["verification"]
    assert document["against"] == json.loads(msgspec.json.encode(AGAINST))
    assert (document["unknown_moves"], document["findings"], document["coverage"]) == (2, [], 0.9512)
    (folder / "BLADE1.H.verification.json").unlink()
    assert "not verified" in send("--unverified").stdout
    assert json.loads(send("--unverified", "--json").stdout)["verification"] is None


def test_what_was_judged_is_said_when_it_is_sent(folder: Path) -> None:
    server = Server()
    try:
        result = send("--send", "--lsv2", server.address, "--folder", FOLDER)
    finally:
        server.close()
    assert result.exit_code == 0, result.stderr
    for word in ("blade.step (sha256 111111111111)", "2 moves", "findings  none"):
        assert word in result.stderr


def test_a_dry_run_does_not_claim_that_it_sent(folder: Path) -> None:
    (folder / "BLADE1.H.verification.json").unlink()
    dry = send("--unverified")
    assert "would be sent all the same (--unverified)" in dry.stderr
    assert "nothing was sent: add --send" in dry.stdout
    assert "; sent all the same" not in dry.stderr
    server = Server()
    try:
        result = send("--unverified", "--send", "--lsv2", server.address, "--folder", FOLDER)
    finally:
        server.close()
    assert "; sent all the same (--unverified)" in result.stderr


# --- what is sent ---------------------------------------------------------------------------------------------------


def after_the_check(monkeypatch: pytest.MonkeyPatch, change: Callable[[], object]) -> None:
    """Have something happen to the files between the check and the transfer."""
    checked = releasing.release

    def then_changed(program: Path, digest: str) -> Verification:
        verification = checked(program, digest)
        change()
        return verification

    monkeypatch.setattr(releasing, "release", then_changed)


@pytest.mark.parametrize("how", ["file changed", "link turned", "file gone"])
def test_over_the_network_go_the_bytes_that_were_hashed(
    folder: Path, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    path = folder / "BLADE1.H"
    (folder / "evil").write_bytes(OTHER)

    def change() -> None:
        if how == "file changed":
            path.write_bytes(OTHER)
        else:
            path.unlink()
        if how == "link turned":
            path.symlink_to("evil")

    after_the_check(monkeypatch, change)
    server = Server()
    try:
        result = send("--send", "--lsv2", server.address, "--folder", FOLDER)
    finally:
        server.close()
    assert result.exit_code == 0, result.stderr
    assert server.files == {f"{FOLDER}\\BLADE1.H": TEXT}


def test_a_link_that_is_turned_before_the_check_is_judged_by_what_is_read(folder: Path) -> None:
    (folder / "BLADE1.H").unlink()
    (folder / "good").write_bytes(TEXT)
    (folder / "evil").write_bytes(OTHER)
    (folder / "BLADE1.H").symlink_to("good")
    assert send().exit_code == 0
    (folder / "BLADE1.H").unlink()
    (folder / "BLADE1.H").symlink_to("evil")
    assert send().exit_code == 3


# --- called programs ------------------------------------------------------------------------------------------------


def test_a_called_program_goes_with_the_one_that_calls_it(folder: Path) -> None:
    main, part = folder / "MAIN.H", folder / "BLADE1.H"
    (folder / "BLADE1.H.verification.json").unlink()
    main.write_bytes(TEXT.replace(b"BLADE1", b"MAIN"))
    judge(main, called={"BLADE1.H": TEXT})
    assert send().exit_code == 0
    # With findings, with another text of its own, and with another text of the one that calls it.
    judge(main, ["CF201"], called={"BLADE1.H": TEXT})
    assert send().exit_code == 1
    judge(main, called={"BLADE1.H": TEXT})
    part.write_bytes(OTHER)
    result = send()
    assert result.exit_code == 3 and "verification of another BLADE1.H" in result.stderr
    part.write_bytes(TEXT)
    main.write_bytes(main.read_bytes().replace(b"X+1", b"X+2"))
    result = send()
    assert result.exit_code == 3 and "verification of another MAIN.H" in result.stderr
    main.unlink()
    assert send().exit_code == 3


def test_a_program_is_not_sent_with_another_part_beside_it(folder: Path) -> None:
    judge(folder / "BLADE1.H", called={"PART.H": TEXT})
    assert send().exit_code == 3
    (folder / "PART.H").write_bytes(TEXT)
    assert send().exit_code == 0
    (folder / "PART.H").write_bytes(OTHER)
    result = send()
    assert result.exit_code == 3 and "another PART.H" in result.stderr


def test_a_damaged_verification_of_something_else_speaks_for_nothing(folder: Path) -> None:
    (folder / "MAIN.H.verification.json").write_text("[" * 100_000)
    assert send().exit_code == 0
    (folder / "BLADE1.H.verification.json").unlink()
    assert send().exit_code == 3


# --- other readers --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["version 1", "made by hand", "nested tables", "unknown key"])
def test_every_reader_refuses_the_same(folder: Path, name: str) -> None:
    text, _ = BAD[name]
    (folder / "x.verification.json").write_text(str(text))
    for arguments in (["inspect", "x.verification.json"], ["report", "x.verification.json"]):
        result = CliRunner().invoke(cli, arguments)
        assert result.exit_code == 3, result.stderr
        assert "x.verification.json" in result.stderr


def test_what_is_written_is_read_back() -> None:
    verification = verification_of(TEXT, ["CF202"], {"PART.H": OTHER})
    assert from_json(verification.to_json()) == verification
