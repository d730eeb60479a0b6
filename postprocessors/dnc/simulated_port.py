"""The simulated control on a pseudo-terminal, paced like a serial line.

A pseudo-terminal has no rate, no parity and no RTS/CTS. The rate is imitated: characters are taken off it no faster
than the line would carry them. The rest cannot be shown here.
"""

from __future__ import annotations

import os
import pty
import select
import time
from collections.abc import Callable
from pathlib import Path

from postprocessors.dnc.simulated_control import SimulatedControl
from postprocessors.errors import DeviceError

BANK_S = 0.25
"""How late this process may be scheduled and still catch up with the line."""
OPERATOR_S = 0.1
"""Between the opening of the port and the operator's key: whoever opens a port throws away what is in it."""
POLL_S = 0.01
LEAST_S = 0.0001
"""Shortest rest: about what a switch of processes takes."""
GONE_S = 0.5
"""How long after the other side has closed the port an operation may still end by itself."""


class PseudoTerminal:
    """A pseudo-terminal with the control behind it; `link` gives it a name of one's own."""

    def __init__(self, link: Path | None) -> None:
        self._master, slave = pty.openpty()
        self.name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self._poll = select.poll()
        self._poll.register(self._master, select.POLLIN)
        self._link = link
        if link is not None:
            if link.is_symlink():
                link.unlink()
            if link.exists():
                raise DeviceError(str(link), "a file", "a name for the port", "Choose another name for --link.")
            link.symlink_to(self.name)

    def close(self) -> None:
        """Take the port away."""
        os.close(self._master)
        if self._link is not None:
            self._link.unlink(missing_ok=True)

    def wait_for_program(self, seconds: float) -> bool:
        """Wait until somebody has the port open, and a moment longer; False if nobody comes."""
        until = time.monotonic() + seconds if seconds else float("inf")
        while self._left():
            if time.monotonic() > until:
                return False
            time.sleep(POLL_S)
        time.sleep(OPERATOR_S)
        return True

    def wait_for_end(self, seconds: float) -> None:
        """Leave the port until nobody has it open any more: what is still in it would be lost."""
        until = time.monotonic() + seconds
        while not self._left() and time.monotonic() < until:
            time.sleep(POLL_S)
            self._read(4096)

    def _left(self) -> bool:
        return any(event & select.POLLHUP for _, event in self._poll.poll(0))

    def run(self, control: SimulatedControl, start: Callable[[float], None]) -> None:
        """Perform one operation; `start` is what the operator does."""
        character_s = control.setup.character_s
        start(time.monotonic())
        last = time.monotonic()
        tokens = 0.0
        gone_at: float | None = None
        waiting = b""
        while not control.idle or waiting:
            now = time.monotonic()
            control.tick(now)
            waiting += control.output(now)
            if waiting:
                waiting = waiting[self._write(waiting) :]
            if control.vanished:
                return
            tokens = min(tokens + (now - last) / character_s, BANK_S / character_s)
            last = now
            data = self._read(int(tokens)) if tokens >= 1.0 else b""
            if data is None:
                gone_at = gone_at or now
                if now > gone_at + GONE_S:
                    control.screen = control.screen or "the other side has closed the port"
                    return
                time.sleep(POLL_S)
                continue
            tokens -= len(data)
            for character in data:
                control.feed(character, now)
            if not data:
                self._rest(control, now, tokens, character_s)

    def _rest(self, control: SimulatedControl, now: float, tokens: float, character_s: float) -> None:
        """Sleep until something can happen."""
        if tokens < 1.0:
            time.sleep((1.0 - tokens) * character_s)
            return
        wake = control.next_time(now)
        seconds = POLL_S if wake is None else min(max(wake - now, 0.0), POLL_S)
        # poll() counts whole milliseconds, in which a fast line carries hundreds of characters.
        select.select([self._master], [], [], max(seconds, LEAST_S))

    def _read(self, most: int) -> bytes | None:
        """Up to so many characters; None if nobody has the port open."""
        try:
            return os.read(self._master, most)
        except BlockingIOError:
            return b""
        except OSError:
            return None

    def _write(self, data: bytes) -> int:
        try:
            return os.write(self._master, data)
        except BlockingIOError:
            return 0
