"""Writing results: whole or not at all, never over an input, never binary to a terminal."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path

from conflank_cli.errors import UsageError

STANDARD = "-"
"""The name that stands for standard input or standard output."""


def check_output(out: str | Path, inputs: Iterable[str | Path] = (), binary: bool = False) -> None:
    """Refuse an output that cannot be written, before any work is done for it.

    Raises
    ------
    UsageError: `out` is one of the inputs, its folder is missing, or it is binary and the terminal.
    """
    if str(out) == STANDARD:
        if binary and sys.stdout.isatty():
            raise UsageError(
                "standard output", "a terminal", "a file or a pipe for binary data", "Name a file with -o FILE."
            )
        return
    path = Path(out)
    if path.is_dir():
        raise UsageError(f"-o {out}", "a folder", "a file", "Add a file name.")
    if not path.parent.is_dir():
        raise UsageError(f"-o {out}", "no such folder", "a folder that exists", f"Create it: mkdir -p {path.parent}")
    for source in inputs:
        if str(source) != STANDARD and same_file(path, Path(source)):
            raise UsageError(f"-o {out}", "one of the inputs", "another file", "Name another output.")


def same_file(one: Path, other: Path) -> bool:
    """Whether two names mean one existing file, through links and relative paths alike."""
    return one.exists() and other.exists() and one.samefile(other)


def write_output(data: bytes | str, out: str | Path, inputs: Iterable[str | Path] = ()) -> None:
    """Write `data` to the file `out` at once (an existing file is replaced), or to standard output for "-".

    Text is written as it is, in UTF-8, without translating line ends.
    """
    check_output(out, inputs, binary=isinstance(data, bytes))
    raw = data.encode("utf-8") if isinstance(data, str) else data
    if str(out) == STANDARD:
        sys.stdout.flush()
        sys.stdout.buffer.write(raw)
        sys.stdout.buffer.flush()
        return
    path = Path(out)
    try:
        # In the same folder, so that the last step is a rename within one file system.
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    except OSError as error:
        raise UsageError(f"-o {out}", f"{error.strerror}", "a folder that can be written", "Name another.") from None
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(raw)
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _umask() -> int:
    """The process's mask; mkstemp ignores it and makes files that only the owner reads."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
