"""Completion, as the shells ask for it: by environment variables, and a real bash with the script it is given."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from conflank_cli.cli import cli
from conflank_cli.commands.completion import SHELLS
from postprocessors.dnc.profile import shipped_profiles
from postprocessors.machines.machine import shipped_machines

ROOT = Path(__file__).parent.parent


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with one of everything."""
    monkeypatch.chdir(tmp_path)
    for name in ("job.toml", "blade.step", "BLADE1.H", "BLADE1.H.verification.json", "notes.txt", ".hidden.toml"):
        (tmp_path / name).write_text("")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "plan.npz").write_text("")
    return tmp_path


def offered(*words: str) -> list[str]:
    """What is offered for the last word."""
    runner = CliRunner(
        env={
            "_CONFLANK_COMPLETE": "bash_complete",
            "COMP_WORDS": " ".join(["conflank", *words]),
            "COMP_CWORD": str(len(words)),
        }
    )
    return [line.partition(",")[2] for line in runner.invoke(cli, []).stdout.split()]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["re"], ["reach", "report"]),
        (["detect", ""], ["job.toml", "out/"]),
        (["detect", "--density", "q"], ["quick"]),
        (["detect", "--de"], ["--density", "--debug"]),
        (["optimize", "out/"], ["out/plan.npz"]),
        (["inspect", "b"], ["blade.step"]),
        (["verify", "B"], ["BLADE1.H"]),
        (["verify", "BLADE1.H", "--job", "j"], ["job.toml"]),
        (["report", "B"], ["BLADE1.H", "BLADE1.H.verification.json"]),
        (["plot", "c"], ["convergence", "coverage"]),
        (["export", "e"], ["envelope"]),
        (["completion", ""], list(SHELLS)),
        (["machines", "check", ""], list(shipped_machines())),
        (["dnc", "send", "--profile", ""], list(shipped_profiles())),
        (["dnc", "s"], ["send", "serve", "simulate"]),
        (["dnc", "simulate", "load"], ["load=", "load-all"]),
        # Folders alone are the shell's own business, which goes on inside them.
        (["detect", "o"], ["o"]),
        (["detect", "nowhere/"], []),
    ],
    ids=lambda value: " ".join(value),
)
def test_what_is_offered(words: list[str], expected: list[str], folder: Path) -> None:
    assert offered(*words) == expected


def test_bash_completes_with_the_script(folder: Path) -> None:
    """The function that the script defines, called as bash calls it."""
    bash = shutil.which("bash")
    assert bash is not None
    (folder / "conflank").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m conflank_cli "$@"\n')
    (folder / "conflank").chmod(0o755)
    script = """
        source <(conflank completion bash)
        COMP_WORDS=(conflank plot gap out/); COMP_CWORD=3
        $(complete -p conflank | sed 's/.*-F \\([^ ]*\\).*/\\1/') conflank
        echo "${COMPREPLY[@]}"
    """
    path = os.pathsep.join([str(folder), os.environ["PATH"]])
    done = subprocess.run(
        [bash, "-c", script],
        env={**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.stdout, done.stderr) == ("out/plan.npz\n", "")


@pytest.mark.parametrize("shell", SHELLS)
def test_there_is_a_script_for_each_shell(shell: str) -> None:
    result = CliRunner().invoke(cli, ["completion", shell])
    assert result.exit_code == 0
    assert f"_CONFLANK_COMPLETE={shell}_complete" in result.stdout
