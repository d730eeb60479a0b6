"""An engine and a simulated control at the two ends of a line whose clock is made up."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from postprocessors.dnc.engine import Engine
from postprocessors.dnc.profile import Profile, parse_profile
from postprocessors.dnc.simulated_control import Faults, Setup, SimulatedControl
from postprocessors.dnc.store import Entry, Refusal, Sink

Damage = Callable[[int, int, float], tuple[list[int], float]]
"""From a character's number, itself and the time to what arrives instead, and how much later."""
TICK = 1e-6


def whole(number: int, character: int, now: float) -> tuple[list[int], float]:
    """Nothing happens on the way."""
    return [character], 0.0


def profile(protocol: str = "standard", **changes: object) -> Profile:
    """A profile with the given keys."""
    words = {key: str(value).lower() if isinstance(value, bool) else str(value) for key, value in changes.items()}
    return parse_profile(f'name = "test"\nprotocol = "{protocol}"\n', "test", words)


def control_for(own: Profile, memory: dict[str, bytes] | None = None, faults: Faults | None = None) -> SimulatedControl:
    """A control with the same settings."""
    setup = Setup(
        blockwise=own.protocol != "standard",
        character_s=own.character_s,
        dc3=own.dc3,
        bcc_no_control=own.bcc_no_control,
        line_end_in_block=own.line_end_in_block,
    )
    return SimulatedControl(setup, {} if memory is None else memory, faults)


@dataclass
class MemorySink:
    """What has arrived."""

    lines: list[bytes] = field(default_factory=list)
    state: str = "open"

    def write(self, line: bytes) -> None:
        assert self.state == "open"
        self.lines.append(line)

    def commit(self) -> None:
        assert self.state == "open"
        self.state = "committed"

    def discard(self) -> None:
        assert self.state == "open"
        self.state = "discarded"


@dataclass
class MemoryStore:
    """Programs by name, and what is written."""

    programs: dict[str, list[bytes]] = field(default_factory=dict)
    sinks: dict[str, MemorySink] = field(default_factory=dict)

    def directory(self) -> list[Entry]:
        return [Entry(name, sum(len(line) + 2 for line in lines)) for name, lines in sorted(self.programs.items())]

    def read(self, name: str, kind: str) -> Iterator[bytes]:
        name = name if "." in name else name + ".H"
        if name not in self.programs:
            raise Refusal("FILE NOT FOUND", f"there is no {name}")
        return iter(self.programs[name])

    def create(self, name: str, kind: str) -> Sink:
        if name in self.sinks:
            raise Refusal("FILE EXISTS", f"{name} exists")
        self.sinks[name] = MemorySink()
        return self.sinks[name]


@dataclass
class Line:
    """Both ends, and everything that went over the wire: [">" to the control or "<" from it, characters]."""

    engine: Engine
    control: SimulatedControl
    to_control: Damage = whole
    to_engine: Damage = whole
    chunk: int = 0
    now: float = 0.0
    record: list[tuple[str, bytes]] = field(default_factory=list)

    def run(self, *starts: Callable[[float], None], limit: float = 1e5) -> None:
        """Perform what the operator does, one after the other, until both ends are at rest; no longer than `limit`."""
        engine, control, step = self.engine, self.control, self.engine.profile.character_s
        waiting_starts = deque(starts)
        engine.begin(self.now)
        down: deque[tuple[float, int]] = deque()
        up: deque[tuple[float, int]] = deque()
        free = 0.0
        sent = received = 0
        screens = []
        while True:
            now = self.now
            if control.idle and waiting_starts and not down and not up and not engine.sending:
                if control.screen:
                    screens.append(control.screen)
                waiting_starts.popleft()(now)
            engine.elapsed(now)
            control.tick(now)
            if data := engine.output(now):
                self._note(">", data)
                free = max(free, now)
                for character in data:
                    free += step
                    sent += 1
                    arriving, late = self.to_control(sent, character, now)
                    free += late
                    down.extend((free, one) for one in arriving)
            if data := control.output(now):
                self._note("<", data)
                for character in data:
                    received += 1
                    arriving, late = self.to_engine(received, character, now)
                    at = max(now + step, up[-1][0] if up else 0.0) + late
                    up.extend((at, one) for one in arriving)
            while down and down[0][0] <= now + TICK:
                at, character = down.popleft()
                control.feed(character, at)
            piece = bytearray()
            while up and up[0][0] <= now + TICK:
                piece.append(up.popleft()[1])
            if piece:
                for first in range(0, len(piece), self.chunk or len(piece)):
                    engine.received(bytes(piece[first : first + (self.chunk or len(piece))]), now)
                continue
            times = [queue[-1 if queue is down and not self.exact else 0][0] for queue in (down, up) if queue]
            times += [time for time in (engine.wake_at(now), control.next_time(now)) if time is not None]
            over = engine.finished and control.idle and not waiting_starts
            if not times or (over and not down and not up and not engine.sending):
                break
            if min(times) > limit:
                raise AssertionError("it hangs")
            self.now = max(now, min(times)) + TICK

    exact: bool = True
    """Whether the control gets each character when it arrives, or several at once (faster)."""

    def _note(self, sign: str, data: bytes) -> None:
        if self.record and self.record[-1][0] == sign:
            self.record[-1] = (sign, self.record[-1][1] + data)
        else:
            self.record.append((sign, data))
