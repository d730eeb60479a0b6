"""A command as a process of its own: how long it takes, on the clock and of processors, how much memory, what it says.

The peak memory of a process that is started by a large one is that of the large one, for the kernel counts what was
there before the command. So this module is also run between the two, ``python -m benchmarks.process RECORD COMMAND``,
and imports nothing large.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
# What the kernel counts resident memory in: kilobytes, but bytes on macOS.
MEMORY_UNIT = 1.0 if sys.platform == "darwin" else 1024.0


@dataclass(frozen=True, slots=True)
class Ran:
    """What a command took: seconds on the clock and of all processors, peak memory in MB; exit code; what it said."""

    wall: float
    cpu: float
    memory: float
    code: int
    output: str
    errors: str


def ran(command: Sequence[str], environment: Mapping[str, str] | None = None) -> Ran:
    """Run a command; `environment` adds to this process' own, and this repository is found first."""
    path = os.pathsep.join(filter(None, [str(REPOSITORY), os.environ.get("PYTHONPATH", "")]))
    with tempfile.TemporaryDirectory() as folder:
        record = Path(folder) / "record.json"
        subprocess.run(
            [sys.executable, "-m", "benchmarks.process", str(record), *command],
            env={**os.environ, "PYTHONPATH": path, **(environment or {})},
            stdin=subprocess.DEVNULL,
            check=True,
        )
        return Ran(**json.loads(record.read_bytes()))


def main(record: str, *command: str) -> None:
    """Run the command and write what it took to the file `record`."""
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        start = time.perf_counter()
        process = subprocess.Popen(command, stdout=output, stderr=errors)
        status, usage = os.wait4(process.pid, 0)[1:]
        wall = time.perf_counter() - start
        said = []
        for stream in (output, errors):
            stream.seek(0)
            said.append(stream.read().decode("utf-8", "replace"))
    memory = usage.ru_maxrss * MEMORY_UNIT / 1e6
    found = Ran(wall, usage.ru_utime + usage.ru_stime, memory, os.waitstatus_to_exitcode(status), *said)
    Path(record).write_text(json.dumps(asdict(found)), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
