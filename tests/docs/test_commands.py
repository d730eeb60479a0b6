"""Commands in README and docs: there are such commands and options, and what the README prints runs."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner, Result

from benchmarks.first_user import steps
from conflank_cli.cli import cli
from tests.test_cli import write_job

ROOT = Path(__file__).parent.parent.parent
TEXTS = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), ROOT / "sample_parts" / "README.md"]


def calls(text: str) -> Iterator[str]:
    """Every call of conflank in a text, in blocks and within lines, without pipes and redirections."""
    blocks = re.findall(r"^(?:    |\$ )(\S*conflank .*)$", text, re.MULTILINE)
    for line in [*blocks, *re.findall(r"`(conflank [^`]+)`", text)]:
        for part in re.split(r"\||>|&&", line):
            if re.match(r"\S*conflank ", part.strip()):
                yield part.strip()


def resolved(words: list[str]) -> click.Command:
    """The command that words call."""
    command: click.Command = cli
    for word in words:
        found = command.get_command(click.Context(command), word) if isinstance(command, click.Group) else None
        if found is None:
            break
        command = found
    return command


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.name)
def test_commands_and_options_in_texts_exist(path: Path) -> None:
    for call in calls(path.read_text("utf-8")):
        words = shlex.split(call)[1:]
        command = resolved(words)
        known = {name for parameter in command.params for name in parameter.opts} | {"--help", "-h", "--version"}
        assert words[0].startswith("-") or command is not cli, call
        assert {word for word in words if re.match(r"--?[a-z]", word)} <= known, call


def typed(line: str) -> Result:
    """What a shell does with a line of commands, pipes and one redirection, in this process."""
    line, _, file = line.partition(" > ")
    data: bytes | None = None
    for part in line.split(" | "):
        words = shlex.split(part)
        assert words[0] == "conflank"
        result = CliRunner().invoke(cli, words[1:], input=data)
        assert result.exit_code == 0, (part, result.stderr)
        data = result.stdout_bytes
    if file:
        Path(file).write_bytes(result.stdout_bytes)
    return result


def test_the_readme_runs_as_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a small part in the place of the sample blade, which `python -m benchmarks.first_user` takes."""
    monkeypatch.chdir(write_job(tmp_path))
    blade = ROOT / "sample_parts" / "blisk_blade" / "blisk_blade.step"
    (tmp_path / "blade.step").symlink_to(blade)
    todo = list(steps((ROOT / "README.md").read_text("utf-8")))
    job = next(step for step in todo if step.file)
    assert job.file == "job.toml" and 'file = "blade.step"' in job.content
    lines = [step.typed for step in todo if step.typed.startswith("conflank ")]
    assert {shlex.split(line)[1] for line in lines} >= {"inspect", "reach", "run", "detect", "verify", "report", "dnc"}
    for line in lines:
        typed(line)
    # The pipe and the run give one program; what was asked for is there.
    assert Path("BLADE1.H").read_bytes() == Path("out/BLADE1.H").read_bytes()
    for name in ("reach.png", "report.html", "gap.png", "sweeps.step", "BLADE1.H.verification.json"):
        assert Path(name).stat().st_size > 1000
