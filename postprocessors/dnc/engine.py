"""What all protocols share: characters that wait for the line, deadlines, pauses, counts. No input or output, no clock.

Whoever drives an engine gives it what has arrived and the time, asks it what may go on the line now and when it wants
to be asked again. So the same code runs at a port and on a clock that a test makes up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

from postprocessors.dnc.profile import Profile
from postprocessors.errors import DeviceError

Action = Callable[[float], None]
ROUNDING_CHARACTERS = 1e-6
"""Characters: what floating point leaves of a line that has just become free."""


def count_of(number: int, what: str) -> str:
    """A number with its noun: 1 line, 1,200 lines."""
    return f"{number:,} {what}" + ("" if number == 1 else "s")


@dataclass(slots=True)
class Counts:
    """How far a transfer is: bytes and lines of text (blocks, in the blockwise protocols), and blocks repeated."""

    bytes: int = 0
    blocks: int = 0
    repeats: int = 0


class Engine:
    """A transfer as a state machine.

    Attributes
    ----------
    counts: what has gone through.
    finished: whether it is over; what `output` still gives has to be sent nevertheless.
    failure: why it did not succeed.
    left: what `left_behind` said when it was broken off from this side.
    """

    def __init__(self, profile: Profile, title: str) -> None:
        self.profile = profile
        self.title = title
        self.counts = Counts()
        self.finished = False
        self.failure: DeviceError | None = None
        self.started = False
        self.left: str | None = None
        self._characters = profile.characters
        self._waiting = bytearray()
        self._line_free_at = 0.0
        self._paused = False
        self._deadline: float | None = None
        self._on_deadline: Action | None = None

    # --- what the driver calls ---

    def begin(self, now: float) -> None:
        """Start to wait for the control."""
        raise AssertionError("every protocol has its own")

    def received(self, data: bytes, now: float) -> None:
        """Take what has arrived."""
        for character in data:
            if self.finished:
                return
            self._character(character, now)

    def elapsed(self, now: float) -> None:
        """Act on a deadline that has passed."""
        if self._deadline is not None and now >= self._deadline and not self.finished:
            action, self._deadline = self._on_deadline, None
            assert action is not None
            action(now)

    def output(self, now: float) -> bytes:
        """What may go on the line now, no more than fits into the window of characters in flight."""
        if self._paused:
            return b""
        queued = max(0.0, self._line_free_at - now) / self.profile.character_s
        room = self.profile.window - ceil(queued - ROUNDING_CHARACTERS)
        taken = bytearray()
        while len(taken) < room and (self._waiting or self._refill(now)):
            piece = self._waiting[: room - len(taken)]
            del self._waiting[: len(piece)]
            taken += piece
        if taken:
            self._line_free_at = max(now, self._line_free_at) + len(taken) * self.profile.character_s
            if not self._waiting:
                self._all_out(now)
        return bytes(taken)

    @property
    def sending(self) -> bool:
        """Whether characters wait for the line."""
        return bool(self._waiting) and not self._paused

    def wake_at(self, now: float) -> float | None:
        """When to call `elapsed` and `output` next if nothing arrives; None: not before something does."""
        times = [self._deadline] if self._deadline is not None and not self.finished else []
        if not self._paused and (self._waiting or self._more()):
            # Half the window: often enough that the line never runs dry, seldom enough to be scheduled.
            times.append(max(now, self._line_free_at - self.profile.window * self.profile.character_s / 2))
        return min(times, default=None)

    def abort(self, reason: str, now: float) -> None:
        """Break off from this side; the control is told as far as the protocol allows."""
        if self.left is None:
            self.left = self.left_behind()
        if not self.finished:
            self._fail(reason, "a transfer to the end", "Start it again at the control and here.", now, tell=True)

    def left_behind(self) -> str:
        """What the control has of the text at this moment, for somebody who breaks off; "" for nothing."""
        return ""

    # --- what a protocol fills in ---

    def _character(self, character: int, now: float) -> None:
        raise AssertionError("every protocol has its own")

    def _refill(self, now: float) -> bool:
        """Put more into the queue; False where there is no more."""
        return False

    def _more(self) -> bool:
        """Whether `_refill` would find more."""
        return False

    def _all_out(self, now: float) -> None:
        """The queue has just become empty."""

    def _break_off(self, tell: bool) -> None:
        """Undo what is half done; with `tell` queue what tells the control."""

    # --- what protocols use ---

    def _wait(self, seconds: float, action: Action, now: float) -> None:
        """Call `action` unless something happens within `seconds` after the line is free; 0 waits for ever."""
        self._deadline = max(now, self._line_free_at) + seconds if seconds > 0.0 else None
        self._on_deadline = action

    def _pause(self, paused: bool, now: float) -> None:
        """DC3 or DC1."""
        self._paused = paused

    def _place(self) -> str:
        """Where the transfer is, for messages."""
        return f"{self.title}, after line {self.counts.blocks} ({self.counts.bytes} bytes)"

    def _fail(self, found: str, expected: str, next_step: str, now: float, tell: bool) -> None:
        """End with an error."""
        self.failure = DeviceError(self._place(), found, expected, next_step)
        self._end(tell)

    def _end(self, tell: bool = False) -> None:
        """End; with an error if there is one."""
        self._waiting.clear()
        self._paused = False
        self._deadline = None
        self.finished = True
        if self.failure is not None:
            self._break_off(tell)
