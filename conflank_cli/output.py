"""Writing results: whole or not at all, never over an input, never binary to a terminal."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from conflank_cli.errors import UsageError

STANDARD = "-"
"""The name that stands for standard input or standard output."""

_done: list[str] = []
"""What this run of the program has written or sent so far: somebody who interrupts it must be told."""


def note_done(text: str) -> None:
    """Note that something has been written or sent: "out/BLADE1.H was written"."""
    _done.append(text)


def done_so_far() -> list[str]:
    """What has been written or sent since the last `forget_done`."""
    return list(_done)


def forget_done() -> None:
    """Begin a new run."""
    _done.clear()


def check_output(out: str | Path, inputs: Iterable[str | Path] = (), binary: bool = False) -> None:
    """Refuse an output that cannot be written, before any work is done for it.

    Raises
    ------
    UsageError: `out` is one of the inputs, its folder is missing or closed, or it is binary and the terminal.
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
    # A file that may not be written is replaced nevertheless by the rename at the end, which only asks its folder.
    if path.exists() and not os.access(path, os.W_OK):
        raise UsageError(
            f"-o {out}", "a file that may not be written", "one that may", "Name another, or chmod u+w it."
        )
    if not _is_device(path) and not os.access(path.resolve().parent, os.W_OK):
        raise UsageError(f"-o {out}", "a folder that may not be written", "one that may", "Name another.")


def check_folder(option: str, folder: Path) -> None:
    """Refuse a folder for outputs that cannot be made or written, before any work is done for it.

    Raises
    ------
    UsageError: it is a file, or the nearest folder on the way to it that exists may not be written.
    """
    there = next((each for each in (folder, *folder.absolute().parents) if each.exists()), Path("/"))
    if not there.is_dir():
        raise UsageError(f"{option} {folder}", "a file", "a folder", "Name another.")
    if not os.access(there, os.W_OK):
        raise UsageError(f"{option} {folder}", f"{there} may not be written", "a folder that may", "Name another.")


def same_file(one: Path, other: Path) -> bool:
    """Whether two names mean one existing file, through links and relative paths alike."""
    return one.exists() and other.exists() and one.samefile(other)


def write_output(data: bytes | str, out: str | Path, inputs: Iterable[str | Path] = ()) -> None:
    """Write `data` to the file `out` at once (an existing file is replaced), or to standard output for "-".

    Text is written as it is, in UTF-8, without translating line ends.
    """
    write_outputs([(out, data)], inputs)


def write_outputs(contents: Iterable[tuple[str | Path, bytes | str]], inputs: Iterable[str | Path] = ()) -> None:
    """Write several outputs, all of them or none: each is on the disk beside its name before the first gets it.

    Raises
    ------
    UsageError: one of them cannot be written.
    """
    inputs, contents = list(inputs), list(contents)
    for name, content in contents:
        check_output(name, inputs, binary=isinstance(content, bytes))
    waiting: list[tuple[Path, Path]] = []
    out: str | Path = STANDARD
    try:
        for out, data in contents:
            raw = data.encode("utf-8") if isinstance(data, str) else data
            if str(out) == STANDARD:
                sys.stdout.flush()
                # Noted before: from here on some of it may be out.
                note_done("standard output was begun")
                sys.stdout.buffer.write(raw)
                sys.stdout.buffer.flush()
            elif _is_device(Path(out)):
                note_done(f"{out} was begun")
                Path(out).write_bytes(raw)
            else:
                waiting.append(_beside(raw, Path(out)))
        with uninterrupted():
            for temporary, path in waiting:
                temporary.replace(path)
                note_done(f"{path} was written")
    except BrokenPipeError:
        raise
    except OSError as error:
        where = "standard output" if str(out) == STANDARD else f"-o {out}"
        raise UsageError(where, f"{error.strerror}", "a place that can be written", "Name another.") from None
    finally:
        for temporary, _ in waiting:
            temporary.unlink(missing_ok=True)


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Put off Ctrl-C until all files that belong together have their names."""
    before = signal.getsignal(signal.SIGINT)
    # Signals reach the main thread alone; where they are ignored, or end the process at once, nothing can be put off.
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    came: list[int] = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        raise KeyboardInterrupt


def _is_device(path: Path) -> bool:
    """Whether a name is that of a device or a pipe, which is written to and not replaced."""
    return path.exists() and not path.is_file()


def _beside(raw: bytes, out: Path) -> tuple[Path, Path]:
    """Write to a hidden file beside `out`; returns it, and the file it shall be (a link's target)."""
    path = out.resolve() if out.is_symlink() else out
    # In the same folder, so that the last step is a rename within one file system.
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    temporary = Path(name)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(raw)
        temporary.chmod(0o666 & ~_umask())
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    return temporary, path


def _umask() -> int:
    """The process's mask; mkstemp ignores it and makes files that only the owner reads."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
