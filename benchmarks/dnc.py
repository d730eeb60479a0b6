"""What the transfer of programs must reach: bytes, faults, rate, memory.

Run with ``python -m benchmarks.dnc`` (or ``make bench``); ``--large`` adds 10 MB in both directions. The simulated
control runs in a process of its own at a pseudo-terminal and takes characters no faster than a line of that rate
carries them; the random schedules run on a made-up clock, with the seeds of the tests.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from tests.postprocessors.dnc.test_faults import random_case

MAIN = [sys.executable, "-c", "from conflank_cli.cli import main; main()"]
PROTOCOLS = ("standard", "blockwise", "fe1", "fe2")
LINE = "L X+12.1234 Y-2.0000 Z+11.2345 A-30.0000 C+11.0000 F800"
RATE_BYTES = 250_000
SMALL_BYTES, LARGE_BYTES = 100_000, 10_000_000
SAMPLE_S = 0.05  # of a process's memory
UNPACED = 4_000_000  # baud; faster than both processes are
TABLE_WIDTH = 120
MOST_GROWTH_MB = 2.0  # of memory between the small and the large file


@dataclass(frozen=True, slots=True)
class Run:
    """One transfer: whether the bytes are the same, what the control said, memory of the sender or receiver."""

    identical: bool
    said: str
    memory_mb: float
    seconds: float


def program(size: int) -> bytes:
    """A program of about that many bytes; of one line if that is less than two."""
    count = max(0, size // (len(LINE) + 9) - 2)
    lines = ["0 BEGIN PGM BIG MM", *(f"{n} {LINE}" for n in range(1, count + 1)), f"{count + 1} END PGM BIG MM"]
    return "".join(line + "\r\n" for line in (lines if size > 1 else ["M"])).encode()


def transfer(direction: str, protocol: str, baud: int, text: bytes) -> Run:
    """Send to, or receive from, a simulated control."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "memory").mkdir()
        here, there = folder / "BIG.H", folder / "memory" / "BIG.H"
        source, target = (here, there) if direction == "send" else (there, here)
        source.write_bytes(text)
        action = "save=BIG.H" if direction == "receive" else "load=BIG.H" if protocol != "standard" else "load=BIG"
        settings = ["--profile", f"itnc530-{protocol}", "--set", f"baud={baud}"]
        simulate = [*MAIN, "dnc", "simulate", action, "--link", "tnc", "--memory", "memory", *settings]
        call = [*MAIN, "dnc", direction, "BIG.H", "--port", "./tnc", *settings, "--quiet"]
        call += ["--send", "--unverified"] if direction == "send" else []
        with subprocess.Popen(simulate, cwd=folder, stdout=subprocess.PIPE, text=True) as control:
            assert control.stdout is not None
            control.stdout.readline()
            start = time.perf_counter()
            with subprocess.Popen(call, cwd=folder) as process:
                memory = 0.0
                while process.poll() is None:
                    memory = max(memory, _memory_mb(process.pid))
                    time.sleep(SAMPLE_S)
            seconds = time.perf_counter() - start
            said = control.stdout.read().strip()
        identical = process.returncode == 0 and target.exists() and target.read_bytes() == text
        return Run(identical, said, memory, seconds)


def _memory_mb(pid: int) -> float:
    """Most memory that a process has had (Linux; 0 elsewhere). What wait4 tells starts with that of the parent."""
    try:
        status = Path(f"/proc/{pid}/status").read_text("ascii")
    except OSError:
        return 0.0
    lines = [line.split() for line in status.splitlines() if line.startswith("VmHWM")]
    return float(lines[0][1]) / 1024.0 if lines else 0.0


@click.command()
@click.option("--large", is_flag=True, help="Also 10 MB in both directions: some minutes.")
@click.option("--schedules", default=1000, show_default=True, help="How many random fault schedules.")
def main(large: bool, schedules: int) -> None:
    """Print the figures; exit code 1 if one is missed."""
    console = Console(width=None if sys.stdout.isatty() else TABLE_WIDTH)
    table = Table("what", "required", "reached", "", title="transfer over RS-232")
    missed = 0

    def row(what: str, required: str, reached: str, good: bool) -> None:
        nonlocal missed
        missed += not good
        table.add_row(what, required, reached, "" if good else "missed")

    for size in (1, SMALL_BYTES):
        text = program(size)
        runs = [transfer(way, protocol, UNPACED, text) for protocol in PROTOCOLS for way in ("send", "receive")]
        same = sum(run.identical for run in runs)
        row(f"{len(text):,} bytes, 4 protocols, both directions", "identical", f"{same} of 8 identical", same == 8)

    start = time.perf_counter()
    wrong = complete = ambiguous = failed = 0
    for seed in range(schedules):
        result, own, expected = random_case(seed)
        wrong += result.kept is not None and result.kept != expected
        if result.error:
            failed += 1
        elif result.kept == expected:
            complete += 1
        elif own.protocol == "standard":
            ambiguous += 1
        else:
            wrong += 1
    seconds = time.perf_counter() - start
    row(
        f"{schedules} random fault schedules",
        "no wrong file, no hang",
        f"{wrong} wrong, {complete} complete",
        wrong == 0,
    )
    row("", "an error otherwise", f"{failed} with an error, {ambiguous} ambiguous EOT, {seconds:.1f} s", True)

    for protocol in ("standard", "blockwise"):
        run = transfer("send", protocol, 115_200, program(RATE_BYTES))
        share = float(run.said.rpartition(", ")[2].partition(" %")[0]) if "%" in run.said else 0.0
        required = ">= 95 %" if protocol == "standard" else "(none)"
        good = run.identical and (protocol != "standard" or share >= 95.0)
        row(f"rate at 115,200 baud, {protocol}, {RATE_BYTES:,} bytes", required, f"{share:.1f} % of the line", good)

    if large:
        for protocol in ("standard", "blockwise"):
            for way in ("send", "receive"):
                small = transfer(way, protocol, UNPACED, program(SMALL_BYTES))
                big = transfer(way, protocol, UNPACED, program(LARGE_BYTES))
                growth = big.memory_mb - small.memory_mb
                what = f"{len(program(LARGE_BYTES)):,} bytes, {way}, {protocol}"
                reached = f"{'identical' if big.identical else 'different'}, {growth:+.1f} MB, {big.seconds:.0f} s"
                good = big.identical and growth <= MOST_GROWTH_MB
                row(what, "identical, constant memory", reached, good)
    console.print(table)
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
