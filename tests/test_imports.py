"""The house rules that a reader cannot see at a glance: who may import whom, and what help must not load."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("conflank_cli", "postprocessors")
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for package in PACKAGES
    for path in sorted((ROOT / package).rglob("*.py"))
}

# Layers from the bottom up; a module may import its own layer and those below it. What is not listed is shared data and
# words (tool, motion, job, scene, errors, ...), which stages, artifacts and commands all speak.
LAYERS = {
    "conflank_cli.geometry.kernels": 0,
    "conflank_cli.geometry": 1,
    "conflank_cli.cad": 2,
    "conflank_cli.artifacts": 2,
    "conflank_cli.detection": 2,
    "conflank_cli.optimization": 2,
    "conflank_cli.selection": 2,
    "conflank_cli.verification": 2,
    "conflank_cli.passes": 2,
    "conflank_cli.posting": 2,
    "conflank_cli.report": 2,
    "conflank_cli.commands": 3,
    "conflank_cli.options": 3,
    "conflank_cli.cli": 4,
    "conflank_cli.__main__": 4,
}


def imports(path: Path, module: str) -> set[str]:
    """Full names of the modules that a file imports, wherever in the file."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively"
            found.add(node.module or "")
            # `from package import module` imports the module as well.
            found |= {f"{node.module}.{alias.name}" for alias in node.names if f"{node.module}.{alias.name}" in MODULES}
    return found


IMPORTS = {module: imports(path, module) for module, path in MODULES.items()}


def layer(module: str) -> int | None:
    """The layer of the longest prefix that has one."""
    parts = module.split(".")
    for length in range(len(parts), 0, -1):
        found = LAYERS.get(".".join(parts[:length]))
        if found is not None:
            return found
    return None


def test_there_is_something_to_look_at() -> None:
    assert "conflank_cli.geometry.kernels.footpoint" in MODULES
    assert "conflank_cli.geometry.kernels.footpoint" in IMPORTS["conflank_cli.geometry.footpoint"]


@pytest.mark.parametrize("module", [name for name in MODULES if layer(name) is not None])
def test_imports_run_one_way(module: str) -> None:
    """commands -> stages -> geometry -> kernels."""
    above = {name for name in IMPORTS[module] if (layer(name) or 0) > (layer(module) or 0)}
    assert not above


def test_shared_modules_do_not_know_the_stages() -> None:
    for module in MODULES:
        if layer(module) is None and module.startswith("conflank_cli."):
            stages = {name for name in IMPORTS[module] if (layer(name) or 0) >= 2}
            assert not stages, f"{module} imports {stages}"


def test_postprocessors_know_nothing_of_conflank() -> None:
    for module in MODULES:
        if module.startswith("postprocessors"):
            assert not {name for name in IMPORTS[module] if name.startswith("conflank_cli")}, module


def reachable(start: str) -> set[str]:
    """Everything that importing a module of ours imports of ours, in the end."""
    seen, waiting = set(), {start}
    while waiting:
        module = waiting.pop()
        if module in MODULES and module not in seen:
            seen.add(module)
            waiting |= IMPORTS[module]
    return seen


def test_verification_shares_nothing_with_posts() -> None:
    """Otherwise an error could cancel: written wrongly, read back wrongly, and called right."""
    for module in MODULES:
        if module.startswith("conflank_cli.verification"):
            shared = {name for name in reachable(module) if name.startswith(("postprocessors", "conflank_cli.posting"))}
            assert not shared, f"{module} reaches {shared}"


def test_kernels_are_numba_numpy_and_math() -> None:
    """And llvmlite, which numba is written with, where a type is added to it."""
    for module in MODULES:
        if module.startswith("conflank_cli.geometry.kernels."):
            own = {name for name in IMPORTS[module] if not name.startswith("conflank_cli.geometry.kernels")}
            allowed = {"numba", "numpy", "math", "__future__"}
            if module.endswith(".lanes"):
                allowed |= {"llvmlite", "operator"}
            assert {name.partition(".")[0] for name in own} <= allowed, module


def test_nothing_is_called_utils() -> None:
    assert not [module for module in MODULES if module.rpartition(".")[2] in ("utils", "helpers", "misc", "common")]


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["--version"],
        ["run", "--help"],
        ["inspect", "--help"],
        ["dnc", "send", "--help"],
        ["completion", "bash"],
        ["machines", "check", "ac", "TAB"],
        ["plot", "gap", "TAB"],
        ["dnc", "send", "--profile", "itnc", "TAB"],
    ],
    ids=" ".join,
)
def test_help_loads_no_numerics(arguments: list[str]) -> None:
    """Help within 0.2 s, and what is offered at TAB: what is slow to import must wait until it is needed."""
    program = (
        "import os, sys\nfrom conflank_cli.cli import cli\n"
        f"words = {arguments!r}\n"
        "if words[-1] == 'TAB':\n"
        "    os.environ |= {'_CONFLANK_COMPLETE': 'bash_complete', 'COMP_WORDS': ' '.join(['conflank', *words[:-1]])}\n"
        "    os.environ['COMP_CWORD'] = str(len(words) - 1)\n"
        "try:\n"
        "    cli.main(words, standalone_mode=False)\n"
        "except SystemExit:\n"
        "    pass\n"
        "heavy = {'numpy', 'scipy', 'numba', 'OCP', 'matplotlib', 'rich', 'trimesh', 'msgspec'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_only_the_reader_of_cad_files_imports_the_kernel_at_once() -> None:
    """A part in JSON needs no CAD kernel, so OCP is imported inside functions only."""
    for module, path in MODULES.items():
        tree = ast.parse(path.read_text("utf-8"))
        for node in tree.body:
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if name.partition(".")[0] == "OCP"], module


def test_reading_cad_files_loads_neither_scipy_nor_numba() -> None:
    """The kernel's process reads while the command imports these; it would wait for them itself."""
    program = (
        "import sys\nimport conflank_cli.cad.kernel_process\n"
        "import conflank_cli.cad.reader, conflank_cli.cad.conversion, conflank_cli.cad.triangulation\n"
        "heavy = {'scipy', 'numba', 'msgspec'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
