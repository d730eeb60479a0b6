"""The commands of docs/tour.md, run for real: `python -m docs.tour` (make samples) records what they print.

The commands run one after the other in the repository's root, as a reader would type them; outputs go to out/. What
they say is kept in benchmarks/results/tour.json, from which `benchmarks.readme` fills the blocks of docs/tour.md.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
RECORD = REPOSITORY / "benchmarks" / "results" / "tour.json"
JOB = "sample_parts/blisk_blade/job.toml"
PROGRAM = "out/BLISK1.H"

# Lines that differ from machine to machine.
NOT_KEPT = ("computed in",)


@dataclass(frozen=True, slots=True)
class Command:
    """A command of the tour: the block it fills, what is typed, and the exit code that is right."""

    block: str
    typed: str
    code: int = 0


COMMANDS = (
    Command("inspect", "conflank inspect sample_parts/blisk_blade/blisk_blade.step"),
    Command("run", f"conflank run {JOB} --out out"),
    Command("plan", "conflank inspect out/plan.npz"),
    Command("program", f"head -n 34 {PROGRAM}"),
    Command("verify", f"conflank verify {PROGRAM} --job {JOB}"),
    # The same program, for a cutter that is 20 µm larger in radius at r_max.
    Command("thicker", f"sed 's/R_MAX 3 /R_MAX 3.02 /' {PROGRAM} > out/THICKER.H"),
    Command("findings", f"conflank verify out/THICKER.H --job {JOB}", 1),
    Command("send", f"conflank dnc send {PROGRAM} --profile itnc530-blockwise --port /dev/ttyUSB0"),
    Command("missing", "conflank inspect out/NO.npz", 3),
    Command(
        "stages",
        f"conflank detect {JOB} | conflank optimize | conflank select | conflank post > out/PIPE.H\n"
        f"cmp out/PIPE.H {PROGRAM}",
    ),
)


@dataclass(frozen=True, slots=True)
class Said:
    """What a command typed gave: standard output and error together, and the exit code."""

    typed: str
    output: str
    code: int


def said(command: Command) -> Said:
    """Run a command.

    Raises
    ------
    RuntimeError: its exit code is not the one the tour tells of.
    """
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    done = subprocess.run(
        ["bash", "-e", "-o", "pipefail", "-c", command.typed],
        cwd=REPOSITORY,
        env={**os.environ, "PATH": path},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    lines = done.stdout.decode("utf-8").replace("\r\n", "\n").splitlines()
    output = "\n".join(line.rstrip() for line in lines if not line.startswith(NOT_KEPT)).strip("\n")
    if done.returncode != command.code:
        raise RuntimeError(f"{command.typed}: exit code {done.returncode}, expected {command.code}\n{output}")
    return Said(command.typed, output, done.returncode)


def main() -> None:
    """Run all commands and keep what they say."""
    record = {command.block: asdict(said(command)) for command in COMMANDS}
    RECORD.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
