"""The simulated control shares nothing with what it is there to test."""

import ast
from pathlib import Path

import postprocessors.dnc
from postprocessors.dnc.simulated_control import Setup, SimulatedControl

FOLDER = Path(postprocessors.dnc.__file__).parent
PURE = {"__future__", "collections", "dataclasses", "enum", "functools", "math", "operator", "re", "typing"}
PURE |= {"postprocessors"}
OWN = {"postprocessors.dnc.simulated_control", "postprocessors.errors"}


def imported(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
    return found


def test_it_imports_nothing_of_the_sender_nor_the_sender_of_it() -> None:
    for path in FOLDER.glob("*.py"):
        ours = {name for name in imported(path) if name.startswith("postprocessors")}
        if path.stem.startswith("simulated"):
            assert ours <= OWN, path
        else:
            assert not {name for name in ours if "simulated" in name}, path


def test_the_engines_do_no_input_or_output() -> None:
    for module in ("engine", "standard", "blockwise", "wire", "store"):
        for name in imported(FOLDER / f"{module}.py"):
            assert name.partition(".")[0] in PURE, (module, name)
            assert name not in ("postprocessors.dnc.port", "postprocessors.dnc.session"), module


def test_its_header_is_the_vector_of_the_manual() -> None:
    control = SimulatedControl(Setup(blockwise=True, character_s=1e-3), {})
    control.load("15.H", 0.0)
    said = b"".join(control.output(step * 1e-3) for step in range(10))
    assert said == bytes.fromhex("01 48 31 35 45 17 1F 11")
