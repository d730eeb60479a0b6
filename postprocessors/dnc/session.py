"""A transfer at a real port: the engine, the port, the clock, a log and somebody who watches."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TextIO

from postprocessors.dnc.engine import Counts, Engine
from postprocessors.dnc.port import Port, PortLost
from postprocessors.dnc.standard import StandardSender
from postprocessors.errors import DeviceError

WATCH_S = 0.1
"""How often somebody who watches is told."""
STUCK_S = 0.002
"""How long to wait before a port that takes nothing is asked again."""
LAST_WORDS_S = 1.0
"""How long to try to tell the control that a transfer is broken off."""
LOG_COLUMNS = 16
NAMES = {
    0x00: "NUL", 0x01: "SOH", 0x02: "STX", 0x03: "ETX", 0x04: "EOT", 0x06: "ACK", 0x0A: "LF", 0x0D: "CR",
    0x11: "DC1", 0x13: "DC3", 0x15: "NAK", 0x17: "ETB", 0x1B: "ESC",
}  # fmt: skip


class TransferLog:
    """What went over the wire, one direction a line: seconds, > to the control or < from it, and the characters."""

    def __init__(self, stream: TextIO, as_hex: bool) -> None:
        self._stream = stream
        self._hex = as_hex
        self._start = time.monotonic()
        self._sign = ""
        self._at = 0.0
        self._data = bytearray()

    def add(self, sign: str, data: bytes) -> None:
        """Note characters; a line ends where the direction changes, after LF, or when it is full."""
        for character in data:
            if self._data and (sign != self._sign or self._data[-1] == 0x0A or len(self._data) >= 8 * LOG_COLUMNS):
                self.flush()
            if not self._data:
                self._sign, self._at = sign, time.monotonic() - self._start
            self._data.append(character)

    def flush(self) -> None:
        """Write what is not written yet."""
        if self._hex:
            for first in range(0, len(self._data), LOG_COLUMNS):
                part = self._data[first : first + LOG_COLUMNS]
                shown = "".join(chr(c) if 0x20 <= c < 0x7F else "." for c in part)
                self._stream.write(f"{self._at:10.3f} {self._sign} {part.hex(' '):<{3 * LOG_COLUMNS}} {shown}\n")
        elif self._data:
            shown = "".join(chr(c) if 0x20 <= c < 0x7F else f"<{NAMES.get(c, f'{c:02X}')}>" for c in self._data)
            self._stream.write(f"{self._at:10.3f} {self._sign} {shown}\n")
        self._data.clear()

    def note(self, text: str) -> None:
        """Write a remark."""
        self.flush()
        self._stream.write(f"{time.monotonic() - self._start:10.3f} # {text}\n")
        self._stream.flush()


class Session:
    """Runs one engine at one port."""

    def __init__(
        self,
        engine: Engine,
        port: Port,
        log: TransferLog | None = None,
        watch: Callable[[Counts], None] = lambda counts: None,
    ) -> None:
        self._engine = engine
        self._port = port
        self._log = log
        self._watch = watch
        self._watched = 0.0
        # What the engine gave and the port did not take.
        self._left = b""
        self._by_driver = False

    def run(self) -> None:
        """Until the transfer is over.

        Raises
        ------
        DeviceError: it failed; nothing is half done.
        """
        engine = self._engine
        try:
            engine.begin(time.monotonic())
            while not engine.finished:
                self._step()
            self._last_words()
        except PortLost as error:
            engine.abort(f"the port is gone: {error}", time.monotonic())
            if engine.failure is None:
                where = f"{engine.title}, after line {engine.counts.blocks} ({engine.counts.bytes} bytes)"
                raise DeviceError(where, f"the port is gone: {error}", "an open port", "See to the cable.") from error
        except BaseException as error:
            reason = "interrupted" if isinstance(error, KeyboardInterrupt) else str(error)
            engine.abort(reason, time.monotonic())
            self._last_words()
            raise
        finally:
            self._watch(engine.counts)
            if self._log is not None:
                self._log.note("ended: " + (str(engine.failure) if engine.failure else "complete"))
        if engine.failure is not None:
            raise engine.failure

    def _step(self) -> None:
        engine = self._engine
        now = time.monotonic()
        engine.elapsed(now)
        self._driver(engine)
        if not self._left:
            self._left = engine.output(now)
        if self._left:
            taken = self._port.write(self._left)
            if self._log is not None and taken:
                self._log.add(">", self._left[:taken])
            self._left = self._left[taken:]
        if engine.finished:
            return
        wake = engine.wake_at(now)
        seconds = None if wake is None else max(0.0, wake - time.monotonic())
        if self._left:
            seconds = STUCK_S
        # Somebody who watches and a signal that arrives want the loop to turn now and then.
        data = self._port.wait(WATCH_S if seconds is None else min(seconds, WATCH_S))
        now = time.monotonic()
        if data:
            if self._log is not None:
                self._log.add("<", data)
            engine.received(data, now)
        if now - self._watched > WATCH_S:
            self._watched = now
            self._watch(engine.counts)

    def _driver(self, engine: Engine) -> None:
        """Let the driver obey DC3 while a program goes out; not earlier, because it would swallow the first DC1."""
        profile = engine.profile
        wanted = (
            isinstance(engine, StandardSender)
            and engine.started
            and not engine.finished
            and profile.dc3
            and profile.dc3_by == "driver"
        )
        if wanted != self._by_driver:
            self._by_driver = wanted
            self._port.stop_by_driver(wanted)

    def _last_words(self) -> None:
        """Send what the engine still has to say."""
        until = time.monotonic() + LAST_WORDS_S
        try:
            if self._by_driver:
                self._port.stop_by_driver(False)
            self._left = b"" if self._engine.failure is not None else self._left
            while (now := time.monotonic()) < until:
                self._left = self._left or self._engine.output(now)
                if not self._left and not self._engine.sending:
                    return
                taken = self._port.write(self._left) if self._left else 0
                if self._log is not None and taken:
                    self._log.add(">", self._left[:taken])
                self._left = self._left[taken:]
                time.sleep(self._engine.profile.character_s)
        except PortLost:
            return
