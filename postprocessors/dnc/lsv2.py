"""Transfer over TCP to controls with a network option, through pyLSV2 (extra `lsv2`).

A program goes under a temporary name first and gets its own when the control reports the right size, so that a transfer
that breaks off leaves nothing under it.
"""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from postprocessors.errors import DeviceError, Interrupted, PostError

DEFAULT_PORT = 19000
DEFAULT_FOLDER = "TNC:\\"
TEMPORARY = "CONFLANK.TMP"


def split_address(address: str) -> tuple[str, int]:
    """Host and port of "host" or "host:port"."""
    host, colon, port = address.partition(":")
    if colon and not port.isdigit():
        raise PostError(f"--lsv2 {address}", f"port '{port}'", "host or host:port", "Correct the address.")
    return host, int(port) if colon else DEFAULT_PORT


@contextmanager
def _connected(address: str, timeout_s: float) -> Iterator[Any]:
    try:
        import pyLSV2  # type: ignore[import-not-found,unused-ignore]
    except ImportError as error:
        expected, next_step = "the package pyLSV2", 'Install it: pip install "conflank[lsv2]"'
        raise PostError("LSV-2", "no module pyLSV2", expected, next_step) from error
    # What goes wrong is worded here; the library would write it to stderr besides.
    logging.getLogger("LSV2 Client").setLevel(logging.CRITICAL)
    logging.getLogger("LSV2 TCP").setLevel(logging.CRITICAL)
    host, port = split_address(address)
    control = None
    try:
        control = pyLSV2.LSV2(host, port=port, timeout=timeout_s)
        control.connect()
        yield control
    except PostError:
        raise
    except Exception as error:
        # The library raises bare exceptions, its own and those of sockets and of struct.
        words = " ".join(f"{type(error).__name__}: {error}".split())
        expected = "a control that speaks LSV-2"
        raise DeviceError(f"LSV-2 {host}:{port}", words, expected, "See to the network and to the control.") from error
    except KeyboardInterrupt:
        # In the middle of a telegram nothing more can be said to the control.
        if control is not None:
            control._llcom.disconnect()
            control = None
        raise
    finally:
        if control is not None:
            _leave(control)


def _leave(control: Any) -> None:
    """Log out and close; a control that is gone needs neither."""
    try:
        with suppress(Exception):
            control.disconnect()
    finally:
        control._llcom.disconnect()


def _remote(folder: str, name: str) -> str:
    return folder.replace("/", "\\").rstrip("\\") + "\\" + name


def send_data(
    file: str, data: bytes, address: str, folder: str = DEFAULT_FOLDER, overwrite: bool = False, timeout_s: float = 15.0
) -> None:
    """Put data into a folder of the control, as a file of that name.

    Raises
    ------
    DeviceError: no connection, refused, or not all of it arrived; there is nothing under the file's name then.
    Interrupted: Ctrl-C; says what the control has.
    """
    name, temporary = _remote(folder, file), _remote(folder, TEMPORARY)
    where = f"LSV-2 {address}: {name}"
    # What the control has while the next telegrams are under way.
    there = ""
    try:
        with _connected(address, timeout_s) as control:
            if not control.change_directory(folder.replace("/", "\\")):
                raise DeviceError(where, f"no folder {folder}", "a folder of the control", "Name one with --folder.")
            exists = control.file_info(name) is not None
            if exists and not overwrite:
                raise DeviceError(where, "a file that exists", "a new name", "Replace it with --overwrite.")
            there = f"the control may have part of the program as {temporary}: delete it there"
            if control.file_info(temporary) is not None:
                control.delete_file(temporary)
            _upload(control, data, folder, temporary, where)
            there = f"the control has the program as {temporary} or as {name}: look there"
            if exists and not control.delete_file(name):
                found, expected = "a file that cannot be replaced", "one that can"
                raise DeviceError(where, found, expected, "Is it selected at the control?")
            if not control.move_file(TEMPORARY, name):
                raise DeviceError(where, f"{TEMPORARY} could not be renamed", "its name", "Rename it at the control.")
            there = f"the control has the whole program as {name}"
    except KeyboardInterrupt:
        raise Interrupted(there or "nothing was sent") from None


def _upload(control: Any, data: bytes, folder: str, temporary: str, where: str) -> None:
    """Send data as the temporary file, and compare its size there."""
    # The library sends files only: a copy that nobody else may write. It takes the name from it where the remote one
    # ends in a backslash.
    with tempfile.TemporaryDirectory() as copies:
        copy = Path(copies) / TEMPORARY
        copy.write_bytes(data)
        accepted = control.send_file(copy, folder.replace("/", "\\").rstrip("\\") + "\\", binary_mode=True)
    arrived = control.file_info(temporary) if accepted else None
    if arrived is None or arrived.size != len(data):
        found = "the control did not take it" if arrived is None else f"{arrived.size} of {len(data)} bytes arrived"
        raise DeviceError(where, found, "the whole file", "See the control's message, and send it again.")


def receive_file(
    name: str,
    target: Path,
    address: str,
    folder: str = DEFAULT_FOLDER,
    commit: Callable[[Path, Path], None] = lambda temporary, final: None,
    timeout_s: float = 15.0,
) -> int:
    """Get a file from a folder of the control; `commit` gives it its name at the end. Returns its bytes.

    Raises
    ------
    DeviceError: no connection, no such file, or not all of it arrived.
    """
    remote = _remote(folder, name)
    where = f"LSV-2 {address}: {remote}"
    with _connected(address, timeout_s) as control, tempfile.TemporaryDirectory(dir=target.parent) as copies:
        entry = control.file_info(remote)
        if entry is None:
            raise DeviceError(where, "no such file", "a file of the control", "Name another, or its --folder.")
        copy = Path(copies) / "part"
        if not control.recive_file(remote, copy, binary_mode=True) or copy.stat().st_size != entry.size:
            raise DeviceError(where, "a transfer that broke off", "the whole file", "Receive it again.")
        commit(copy, target)
        return int(entry.size)
