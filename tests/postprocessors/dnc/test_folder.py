"""Programs in files: what a control may see of a folder, and what becomes of a file that arrives."""

from pathlib import Path

import pytest

from postprocessors.dnc.blockwise import BlockwiseServer
from postprocessors.dnc.folder import FileSink, Folder, OneFile, OneProgram, same_name
from postprocessors.dnc.program import read_program
from postprocessors.dnc.simulated_control import SimulatedControl
from postprocessors.dnc.store import Refusal
from postprocessors.errors import DeviceError
from tests.postprocessors.dnc.line import Line, control_for, profile

OWN = profile("blockwise")
TEXT = b"0 BEGIN PGM A MM\r\n1 L X+1\r\n2 END PGM A MM\r\n"


def serve(path: Path, **options: bool) -> Folder:
    return Folder(path, OWN, lambda file: None, **options)


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


def test_a_server_survives_a_file_that_changes_while_it_is_read(tmp_path: Path) -> None:
    lines = ["0 BEGIN PGM A MM", *(f"{n} L X+{n}" for n in range(1, 2000)), "2000 END PGM A MM"]
    path = tmp_path / "A.H"
    path.write_bytes("".join(line + "\r\n" for line in lines).encode())
    (tmp_path / "B.H").write_bytes(TEXT.replace(b"PGM A", b"PGM B"))
    said: list[str] = []

    def change_then_load(control: SimulatedControl, now: float) -> None:
        control.load("A.H", now)

    engine = BlockwiseServer(OWN, "folder", serve(tmp_path), once=False, report=said.append)
    control = control_for(OWN)

    def damage(number: int, character: int, now: float) -> tuple[list[int], float]:
        if number == 2000:
            path.write_bytes(path.read_bytes().replace(b"1999 L X+1999", b"1999 L X-1999"))
        return [character], 0.0

    Line(engine, control, to_control=damage, exact=False).run(
        lambda now: change_then_load(control, now), lambda now: control.load("B.H", now)
    )
    assert any("changes while it is sent" in text for text in said)
    assert set(control.memory) == {"B.H"}
