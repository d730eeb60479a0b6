"""What somebody sees who follows the README in an empty folder: every command as it is printed, with its time.

Run with ``python -m benchmarks.first_user`` (``make first-user``). The last commit is cloned into an empty folder, and
what the README prints is done there, in its order and in one shell: indented blocks are typed, the job file is saved
under the name that the text before it gives. Nothing else is there: no environment, no compiled kernels. Packages come
from wherever pip has them. Times are those of the clock; processor time stands beside them, since other work on the
machine makes the clock run on.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from benchmarks.run import REPOSITORY
from benchmarks.verdicts import Verdict, kept, measured, table, table_console

ALLOWED = 300.0  # s, from nothing to a report
REPORT = "out/report.html"
# What make does, for those who have none: not typed as well.
ALTERNATIVE = "Without make"


@dataclass(frozen=True, slots=True)
class Step:
    """Something the README tells to do: a command to type, or a file to save."""

    typed: str = ""
    file: str = ""
    content: str = ""


@dataclass(frozen=True, slots=True)
class Done:
    """A command that was typed: its exit code, and seconds by the clock and of the processors."""

    typed: str
    code: int
    wall: float
    processor: float


def steps(text: str) -> Iterator[Step]:
    """What a README in Markdown tells to do, in its order."""
    before = ""
    for block in re.split(r"\n{2,}", text):
        if block.startswith("    "):
            if ALTERNATIVE not in before:
                yield from (Step(typed=line.strip()) for line in block.splitlines())
        elif match := re.fullmatch(r"```toml\n(.*?)```", "\n".join(_fenced(block, text)), re.DOTALL):
            named = re.search(r"[Ss]ave\s+this as `([^`]+)`", before)
            if named:
                yield Step(file=named[1], content=match[1])
        before = block


def _fenced(block: str, text: str) -> list[str]:
    """A fenced block to its end, which may be beyond an empty line."""
    if not block.startswith("```"):
        return []
    start = text.index(block)
    return text[start : text.index("\n```", start) + 4].splitlines()


def script(todo: list[Step]) -> str:
    """A shell script that does it all, and notes on descriptor 3 how each command ended, when, and the time it took."""
    lines = ['note() { echo "$1 $2 $EPOCHREALTIME" >&3; times >&3; }', "note -1 0"]
    for number, step in enumerate(todo):
        if step.file:
            lines += [f"cat > {step.file} <<'END OF FILE'", step.content.rstrip("\n"), "END OF FILE"]
        else:
            lines += [step.typed, f"code=$?; note {number} $code; [ $code -eq 0 ] || exit 1"]
    return "set -o pipefail\n" + "\n".join(lines) + "\n"


def _seconds(minutes: str) -> float:
    """The time that `times` prints, as 1m2.345s."""
    found = re.fullmatch(r"(\d+)m([\d.,]+)s", minutes)
    assert found
    return 60.0 * int(found[1]) + float(found[2].replace(",", "."))


def followed(todo: list[Step], folder: Path, log: Path) -> list[Done]:
    """Do it all in a folder; what the commands say goes to `log`. Ends at the first command that fails."""
    keep = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "NUMBA", "VIRTUAL_ENV"))
    }
    own = os.environ.get("VIRTUAL_ENV", "")
    keep["PATH"] = os.pathsep.join(
        place for place in os.environ["PATH"].split(os.pathsep) if not own or not place.startswith(own)
    )
    notes = folder / ".git" / "notes-of-the-first-user"
    with log.open("wb") as stream, notes.open("wb") as written:
        subprocess.run(
            ["bash", "-c", f'exec 3>&{written.fileno()}; . "$0"', _saved(folder, script(todo))],
            cwd=folder,
            env=keep,
            stdin=subprocess.DEVNULL,
            stdout=stream,
            stderr=subprocess.STDOUT,
            pass_fds=(written.fileno(),),
            check=False,
        )
    done, clock, spent = [], 0.0, 0.0
    lines = iter(notes.read_text().splitlines())
    for line in lines:
        number, code, now = line.split()
        next(lines)
        processor = sum(map(_seconds, next(lines).split()))
        if int(number) >= 0:
            step = todo[int(number)]
            done.append(Done(step.typed, int(code), float(now) - clock, processor - spent))
        clock, spent = float(now), processor
    return done


def _saved(folder: Path, text: str) -> str:
    path = folder / ".git" / "script-of-the-first-user"
    path.write_text(text, encoding="utf-8")
    return str(path)


def measure(folder: Path) -> tuple[list[Verdict], dict[str, Any]]:
    """Follow the README in a new clone in an empty folder."""
    subprocess.run(["git", "clone", "--quiet", str(REPOSITORY), str(folder)], check=True)
    todo = list(steps((folder / "README.md").read_text("utf-8")))
    commands = [step for step in todo if step.typed]
    log = folder.with_name("log.txt")
    done = followed(todo, folder, log)
    console = table_console()
    shown = table("the README, command by command", "command", "exit code", "seconds", "of processor")
    for each in done:
        shown.add_row(each.typed, str(each.code), f"{each.wall:.1f}", f"{each.processor:.1f}")
    console.print(shown)
    good = len(done) == len(commands) and all(each.code == 0 for each in done)
    if not good:
        console.print(log.read_text("utf-8", "replace")[-4000:], markup=False)
    first = done[0] if done else Done("nothing", 1, 0.0, 0.0)
    report = folder / REPORT
    there = report.is_file() and first.code == 0
    found = f"{first.wall:.0f} s by the clock, {first.processor:.0f} s of processor" if there else "no report"
    total = sum(each.wall for each in done)
    verdicts = [
        Verdict("from nothing to a report", f"≤ {ALLOWED:.0f} s", found, there and first.wall <= ALLOWED),
        Verdict("commands that work as printed", str(len(commands)), str(sum(each.code == 0 for each in done)), good),
        Verdict("all of them, after that report too", "", f"{total:.0f} s", True),
    ]  # fmt: skip
    figures = {each.typed: {"wall_s": round(each.wall, 1), "processor_s": round(each.processor, 1)} for each in done}
    return verdicts, figures


@click.command()
@click.option(
    "--json", "as_json", metavar="FILE", type=click.Path(path_type=Path), help="Write the figures to FILE too."
)
def main(as_json: Path | None) -> None:
    """Follow the README from nothing."""
    console = table_console()
    load = os.getloadavg()[0]
    console.print(f"load of the machine {load:.1f}, {os.cpu_count()} cores")
    with tempfile.TemporaryDirectory(prefix="first-user-") as empty:
        verdicts, figures = measured(console, "first user", {"readme": lambda: measure(Path(empty) / "conflank")}, None)
    if as_json is not None:
        content = {"load": round(load, 1), "asked": kept(verdicts), "commands": figures["readme"]}
        as_json.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
