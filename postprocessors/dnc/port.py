"""Ports through pyserial: any name or URL that it opens.

Parity: pyserial switches the check of received characters off (INPCK). On POSIX it is switched on again, so that a
character with a wrong parity arrives as NUL, which every protocol here refuses.
"""

from __future__ import annotations

import os
import select
import time
from types import ModuleType
from typing import Any, Protocol

import serial

from postprocessors.dnc.profile import Profile
from postprocessors.errors import DeviceError

termios: ModuleType | None
try:
    import termios
except ImportError:  # Windows
    termios = None

POLL_S = 0.02
"""How long a read waits at ports that cannot be waited for."""
_PARITY = {"even": serial.PARITY_EVEN, "odd": serial.PARITY_ODD, "none": serial.PARITY_NONE}


class PortLost(Exception):
    """The port is gone."""


class Port(Protocol):
    """What a session needs of a port."""

    def wait(self, seconds: float | None) -> bytes:
        """What has arrived, after waiting at most so long for it.

        Raises
        ------
        PortLost: there is no port any more.
        """

    def write(self, data: bytes) -> int:
        """Hand over what the port takes now; how much that was.

        Raises
        ------
        PortLost: there is no port any more.
        """

    def stop_by_driver(self, on: bool) -> None:
        """Have the operating system obey DC3 and DC1 by itself, where it can."""

    def close(self) -> None:
        """Give the port back."""


class PosixPort:
    """A serial device or pseudo-terminal: waited for with select, written without blocking."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self._file = device.fileno()
        self._check_parity()

    def _check_parity(self) -> None:
        if termios is not None and self._device.parity != serial.PARITY_NONE:
            settings = termios.tcgetattr(self._file)
            settings[0] = (settings[0] | termios.INPCK) & ~(termios.IGNPAR | termios.PARMRK)
            termios.tcsetattr(self._file, termios.TCSANOW, settings)

    def wait(self, seconds: float | None) -> bytes:
        """What has arrived."""
        ready, _, _ = select.select([self._file], [], [], seconds)
        if not ready:
            return b""
        try:
            data = os.read(self._file, 65536)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise PortLost(error.strerror) from error
        if not data:
            raise PortLost("the device was disconnected")
        return data

    def write(self, data: bytes) -> int:
        """Hand over what the port takes now."""
        try:
            return os.write(self._file, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise PortLost(error.strerror) from error

    def stop_by_driver(self, on: bool) -> None:
        """Have the terminal driver obey DC3 and DC1."""
        if termios is None:
            return
        try:
            settings = termios.tcgetattr(self._file)
            settings[0] = settings[0] | termios.IXON if on else settings[0] & ~termios.IXON
            settings[0] &= ~(termios.IXANY | termios.IXOFF)
            termios.tcsetattr(self._file, termios.TCSANOW, settings)
        except termios.error as error:
            raise PortLost(str(error.args[-1])) from error

    def close(self) -> None:
        """Give the port back."""
        self._device.close()


class PyserialPort:
    """Any other URL of pyserial (socket://, rfc2217://, COM3)."""

    def __init__(self, device: Any) -> None:
        self._device = device

    def wait(self, seconds: float | None) -> bytes:
        """What has arrived; the port's own waiting time is short, so it is asked again and again."""
        until = None if seconds is None else time.monotonic() + seconds
        try:
            while True:
                data = self._device.read(max(1, self._device.in_waiting))
                if data or (until is not None and time.monotonic() >= until):
                    return bytes(data)
        except (OSError, serial.SerialException) as error:
            raise PortLost(str(error)) from error

    def write(self, data: bytes) -> int:
        """Hand over everything."""
        try:
            self._device.write(data)
        except (OSError, serial.SerialException) as error:
            raise PortLost(str(error)) from error
        return len(data)

    def stop_by_driver(self, on: bool) -> None:
        """Where the driver is out of reach, the engine obeys DC3."""
        if isinstance(self._device, serial.Serial):
            self._device.xonxoff = on

    def close(self) -> None:
        """Give the port back."""
        self._device.close()


def open_device(profile: Profile, port: str) -> Any:
    """pyserial's object, open, with the profile's settings.

    Raises
    ------
    DeviceError: no such port, in use, or it does not take the settings.
    """
    try:
        device = serial.serial_for_url(port, do_not_open=True)
        device.baudrate = profile.baud
        device.bytesize = profile.data_bits
        device.parity = _PARITY[profile.parity]
        device.stopbits = int(profile.stop_bits) if profile.stop_bits.is_integer() else profile.stop_bits
        device.rtscts = profile.rts_cts
        device.timeout = POLL_S
        if termios is not None and isinstance(device, serial.Serial):
            device.exclusive = True
        device.open()
    except (OSError, ValueError, serial.SerialException) as error:
        code = getattr(error, "errno", None)
        words = os.strerror(code) if code else " ".join(str(error).split())
        expected = "a port that opens with the profile's settings"
        raise DeviceError(port, words, expected, "conflank dnc ports lists what there is.") from error
    except Exception as error:
        if termios is None or not isinstance(error, termios.error):
            raise
        words = f"the port refuses the settings ({error.args[-1]})"
        raise DeviceError(port, words, "settings it can have", "Compare with conflank dnc check.") from error
    return device


def open_port(profile: Profile, port: str) -> Port:
    """A port for a session.

    Raises
    ------
    DeviceError: no such port, in use, or it does not take the settings.
    """
    device = open_device(profile, port)
    if termios is not None and isinstance(device, serial.Serial):
        return PosixPort(device)
    return PyserialPort(device)
