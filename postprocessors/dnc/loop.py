"""A port by itself: what it has become of the profile's settings, and whether a loop-back plug returns what is sent.

The plug joins pins 2 and 3 (data), 7 and 8 (RTS, CTS), and 4 and 6 (DTR, DSR) of a 9-pin connector.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import serial

from postprocessors.dnc.port import open_device
from postprocessors.dnc.profile import Profile
from postprocessors.errors import DeviceError

termios: ModuleType | None
try:
    import termios
except ImportError:  # Windows
    termios = None

LINE_CHANGE_S = 0.1
"""How long a handshake line may take to follow the other, through an adapter."""
ROUNDS = 3

Fact = tuple[str, str, bool]
"""Name, value, and whether it is as it should be."""


def port_state(profile: Profile, port: str) -> list[Fact]:
    """Open the port and read its settings back, as far as the system tells them.

    Raises
    ------
    DeviceError: the port does not open with these settings.
    """
    with _open(profile, port) as device:
        facts: list[Fact] = [("port", f"{port} opens", True)]
        if termios is not None and isinstance(device, serial.Serial):
            control = termios.tcgetattr(device.fileno())[2]
            bits = {termios.CS7: 7, termios.CS8: 8}.get(control & termios.CSIZE, 0)
            parity = "none" if not control & termios.PARENB else "odd" if control & termios.PARODD else "even"
            stop = 2 if control & termios.CSTOPB else 1
            facts.append(("data bits", f"{bits}", bits == profile.data_bits))
            facts.append(("parity", parity, parity == profile.parity))
            facts.append(("stop bits", f"{stop}", stop == round(profile.stop_bits + 0.1)))
        for name in ("cts", "dsr", "cd"):
            try:
                facts.append((name.upper(), "on" if getattr(device, name) else "off", True))
            except (OSError, AttributeError, serial.SerialException):
                facts.append((name.upper(), "not known at this port", True))
    return facts


def try_loop(profile: Profile, port: str) -> list[Fact]:
    """Send every character there is with these data bits and compare what returns; then let RTS move CTS.

    Raises
    ------
    DeviceError: the port does not open, or is lost.
    """
    with _open(profile, port) as device:
        sent = bytes(range(1 << profile.data_bits)) * ROUNDS
        # DC1 and DC3 would stop a driver that obeys them; here they are data.
        device.xonxoff = False
        device.rtscts = False
        device.reset_input_buffer()
        start = time.monotonic()
        back = _exchange(device, sent, profile)
        seconds = time.monotonic() - start
        wrong = sum(one != other for one, other in zip(sent, back, strict=False)) + len(sent) - len(back)
        rate = len(back) / seconds if seconds > 0.0 else 0.0
        facts: list[Fact] = [
            ("loop", f"{len(back)} of {len(sent)} characters returned, {wrong} missing or wrong", wrong == 0),
            ("loop rate", f"{rate:.0f} characters/s; the line carries {1.0 / profile.character_s:.0f}", True),
        ]
        if profile.rts_cts:
            facts.append(("RTS -> CTS", *_handshake(device)))
    return facts


def _handshake(device: Any) -> tuple[str, bool]:
    seen = []
    try:
        for level in (True, False, True):
            device.rts = level
            time.sleep(LINE_CHANGE_S)
            seen.append(bool(device.cts) == level)
    except (OSError, serial.SerialException):
        return "not known at this port", False
    return ("follows" if all(seen) else "does not follow"), all(seen)


def _exchange(device: Any, sent: bytes, profile: Profile) -> bytes:
    back = bytearray()
    for first in range(0, len(sent), profile.window):
        piece = sent[first : first + profile.window]
        device.write(piece)
        until = time.monotonic() + 0.5 + 4 * len(piece) * profile.character_s
        while len(back) < first + len(piece) and time.monotonic() < until:
            back += device.read(len(piece))
        if len(back) < first + len(piece):
            break
    return bytes(back)


@contextmanager
def _open(profile: Profile, port: str) -> Iterator[Any]:
    device = open_device(profile, port)
    try:
        yield device
    except (OSError, serial.SerialException) as error:
        raise DeviceError(port, " ".join(str(error).split()), "an open port", "See to the cable.") from error
    finally:
        device.close()
