"""A control at the other end of the wire, for tests and for trying settings and scripts without a machine.

Written from the tables of the technical manuals alone; it shares no code with the modules that talk to real controls,
so that a mistake in them is not made here as well. Where the manuals are silent it is strict: what is in no table is an
error.

Source: HEIDENHAIN technical manuals TNC 306/406, 407/415/425, 426/430, chapter "Data interfaces".
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Generator, MutableMapping
from dataclasses import dataclass, field

NUL, SOH, STX, ETX, EOT, ACK = 0, 1, 2, 3, 4, 6
DC1, DC3, NAK, ETB, ESC = 17, 19, 21, 23, 27
MOST_NAKS = 15
LEADER = 50
"""NULs before a program in the standard protocol."""
MARGIN = 12
"""Characters for which there is room when DC3 goes out."""
SETTLE_S = 0.03
"""A block counts when nothing but DC1 follows its check character."""
LETTERS = {".H": "H", ".I": "D"}

Operation = Generator["float | Sleep", "int | None", str]
"""What the operator started: yields the time to wait for a character (0: for ever), gets it or None; ends in words."""


@dataclass(frozen=True, slots=True)
class Sleep:
    """Do nothing, and read nothing, for so long."""

    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """The machine parameters.

    Attributes
    ----------
    blockwise: MP5030 = 1, or FE.
    character_s: time of one character on the line.
    dc3: whether it stops the sender with DC3; then DC1 also follows each BCC that it sends.
    bcc_no_control: bit 1 of MP5020.
    line_end_in_block: whether blocks carry CR LF.
    patience_s: how long it waits for an answer or the next character before it gives up.
    """

    blockwise: bool
    character_s: float
    dc3: bool = True
    bcc_no_control: bool = False
    line_end_in_block: bool = False
    patience_s: float = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Faults:
    """What goes wrong. Blocks (lines, in the standard protocol) and characters count from 1.

    Attributes
    ----------
    nak: how often a block that arrives whole is refused, by block.
    wrong_check: blocks that are first sent with a wrong BCC.
    lost_answer: blocks whose ACK does not arrive.
    silence: seconds of silence before a block is answered or sent.
    dc3_every, dc3_for: DC3 after so many characters received, DC1 so many seconds later.
    buffer, appetite: receive buffer in characters, and how many a second are taken out of it; 0: no limit.
    error_at: block at which it reports an error instead of going on.
    end_at: block at which it sends EOT instead of going on.
    silent_at: block from which on it says nothing more (cable pulled).
    vanish_at: block at which the port disappears.
    no_eot: whether the last EOT is missing.
    other_name: asks for, or outputs, this program instead.
    corrupt_every: every so manieth character that arrives has a wrong bit.
    """

    nak: dict[int, int] = field(default_factory=dict)
    wrong_check: frozenset[int] = frozenset()
    lost_answer: frozenset[int] = frozenset()
    silence: dict[int, float] = field(default_factory=dict)
    dc3_every: int = 0
    dc3_for: float = 0.0
    buffer: int = 0
    appetite: float = 0.0
    error_at: int = 0
    end_at: int = 0
    silent_at: int = 0
    vanish_at: int = 0
    no_eot: bool = False
    other_name: str = ""
    corrupt_every: int = 0


class Broken(Exception):
    """The operation cannot go on; its text is shown on the screen."""


class SimulatedControl:
    """One control with its program memory.

    Attributes
    ----------
    memory: programs by name with extension; a program gets in only when it is complete.
    screen: what the last operation reported; "" while it is going on.
    vanished: whether the port is to be closed.
    overrun: characters that found the receive buffer full.
    received: characters that arrived.
    first_at, last_at: when the first and the last of them did.
    """

    def __init__(self, setup: Setup, memory: MutableMapping[str, bytes], faults: Faults | None = None) -> None:
        self.setup = setup
        self.memory = memory
        self.faults = faults or Faults()
        self.screen = ""
        self.succeeded = False
        self.vanished = False
        self.overrun = 0
        self.received = 0
        self.first_at = self.last_at = 0.0
        self._operation: Operation | None = None
        self._wakes: float | None = None
        self._sleeping = False
        self._arrived: deque[int] = deque()
        self._eats_at = 0.0
        self._out: deque[int] = deque()
        self._out_free = 0.0
        self._held = False
        self._stopped_sender = False
        self._resume_at: float | None = None
        self._mute = False
        self._outputs = False
        self._now = 0.0

    # --- what the operator does ---

    def load(self, name: str, now: float) -> None:
        """Read a program in."""
        asked = self.faults.other_name or name
        self._start(self._load_blocks(asked, name) if self.setup.blockwise else self._load_lines(asked), now)

    def load_all(self, now: float) -> None:
        """Read all programs in (blockwise)."""
        self._start(self._load_every(headings_only=False), now)

    def directory(self, now: float) -> None:
        """Show what there is, by breaking each file off after its first block (blockwise, without FE1)."""
        self._start(self._load_every(headings_only=True), now)

    def fe1_directory(self, now: float) -> None:
        """Show the directory that FE1 asks for."""
        self._start(self._fe1_directory(), now)

    def save(self, name: str, now: float) -> None:
        """Output a program."""
        shown = self.faults.other_name or name
        self._start(self._save_blocks(name, shown) if self.setup.blockwise else self._save_lines(name), now)

    def save_all(self, now: float) -> None:
        """Output all programs (blockwise): ETX EOT after each."""
        self._start(self._save_every(), now)

    def _start(self, operation: Operation, now: float) -> None:
        self._now = now
        self.screen = ""
        self.succeeded = False
        self._operation = operation
        self._arrived.clear()
        self._advance(None)

    # --- what the line does ---

    def feed(self, character: int, now: float) -> None:
        """A character arrives."""
        self._now = now
        self.first_at = self.first_at or now
        self.last_at = now
        self.received += 1
        if self._mute or self._holds(character):
            return
        if self.faults.corrupt_every and self.received % self.faults.corrupt_every == 0:
            character ^= 0x08
        if self.faults.dc3_every and self.received % self.faults.dc3_every == 0:
            self._stop_sender()
            self._resume_at = now + self.faults.dc3_for
        if self.faults.buffer:
            self.tick(now)
            if len(self._arrived) >= self.faults.buffer:
                self.overrun += 1
                return
            if not self._arrived:
                self._eats_at = now + (1.0 / self.faults.appetite if self.faults.appetite else 0.0)
            self._arrived.append(character)
            if self.faults.buffer - len(self._arrived) <= MARGIN and not self._stopped_sender:
                self._stop_sender()
        else:
            self._arrived.append(character)
        self.tick(now)

    def tick(self, now: float) -> None:
        """Time has passed."""
        self._now = now
        due = self._wakes is not None and now >= self._wakes
        if self._sleeping and due:
            self._sleeping = False
            self._advance(None)
        while self._arrived and not self._sleeping and self._operation is not None:
            if self.faults.buffer and self.faults.appetite:
                if now < self._eats_at:
                    break
                self._eats_at += 1.0 / self.faults.appetite
            self._advance(self._arrived.popleft())
        low = max(0, self.faults.buffer - MARGIN) // 2
        if self._stopped_sender and self._resume_at is None and len(self._arrived) <= low:
            self._let_go()
        if self._resume_at is not None and now >= self._resume_at:
            self._resume_at = None
            self._let_go()
        due = self._wakes is not None and now >= self._wakes
        if due and self._operation is not None and not (self._sleeping or self._out or self._arrived):
            self._advance(None)

    def output(self, now: float) -> bytes:
        """What has left by now, at the rate of the line."""
        sent = bytearray()
        while self._out and not self._held and self._out_free <= now:
            sent.append(self._out.popleft())
            self._out_free = max(self._out_free, now - 0.01) + self.setup.character_s
        return bytes(sent)

    def next_time(self, now: float) -> float | None:
        """When to call `tick` and `output` again if nothing arrives."""
        times = []
        if self._out and not self._held:
            times.append(self._out_free)
        if self._operation is not None and self._wakes is not None and not (self._out and not self._sleeping):
            times.append(self._wakes)
        if self._resume_at is not None:
            times.append(self._resume_at)
        if self._arrived and self.faults.appetite and not self._sleeping:
            times.append(self._eats_at)
        return min(times, default=None)

    @property
    def idle(self) -> bool:
        """Whether the operation is over and everything is sent."""
        return self._operation is None and not (self._out and not self._held)

    # --- inside ---

    def _holds(self, character: int) -> bool:
        """While it outputs, it obeys DC3 and DC1."""
        if self._outputs and character in (DC1, DC3):
            self._held = character == DC3
            return True
        return False

    def _advance(self, character: int | None) -> None:
        assert self._operation is not None
        try:
            wish = self._operation.send(character)
        except StopIteration as stop:
            self._over(str(stop.value), succeeded=True)
        except Broken as broken:
            self._over(str(broken), succeeded=False)
        else:
            self._sleeping = isinstance(wish, Sleep)
            seconds = wish.seconds if isinstance(wish, Sleep) else wish
            since = max(self._now, self._out_free + len(self._out) * self.setup.character_s)
            self._wakes = since + seconds if seconds else None

    def _over(self, screen: str, succeeded: bool) -> None:
        self.screen = screen
        self.succeeded = succeeded
        self._operation = None
        self._outputs = False
        self._wakes = None

    def _say(self, *characters: int) -> None:
        if self._mute:
            return
        if not self._out:
            self._out_free = max(self._out_free, self._now)
        self._out.extend(characters)

    def _stop_sender(self) -> None:
        self._stopped_sender = True
        self._out_free = max(self._out_free, self._now)
        self._out.appendleft(DC3)

    def _let_go(self) -> None:
        self._stopped_sender = False
        self._say(DC1)

    def _trouble(self, block: int) -> Generator[Sleep, int | None, None]:
        """Faults that strike at a block."""
        faults = self.faults
        if block in faults.silence:
            if not self.setup.blockwise and self.setup.dc3 and not self._outputs:
                # Without blocks it is DC3 that makes a sender wait.
                self._stop_sender()
                self._resume_at = self._now + faults.silence[block]
            yield Sleep(faults.silence[block])
        if faults.silent_at and block >= faults.silent_at:
            self._mute = True
            self._out.clear()
            raise Broken("cable pulled")
        if block == faults.vanish_at:
            self.vanished = True
            raise Broken("port gone")
        if block == faults.end_at:
            self._say(EOT)
            raise Broken("ended by the operator")
        if block == faults.error_at:
            if self.setup.blockwise:
                self._say(*self._framed(SOH, b"MEMORY FULL"))
            else:
                self._say(ESC, ord("1"), ord("3"))
            raise Broken("memory full")

    def _store(self, name: str, lines: list[bytes]) -> str:
        if self.overrun:
            self._say(EOT)
            raise Broken(f"{self.overrun} characters lost: receive buffer overrun")
        self.memory[name] = b"".join(line + b"\r\n" for line in lines)
        return f"{name}: {len(lines)} blocks read"

    # --- standard protocol ---

    def _load_lines(self, name: str) -> Operation:
        lines: list[bytes] = []
        line = bytearray()
        found = ended = False
        count = 0
        self._say(DC1)
        patience = 0.0
        while True:
            character = yield patience
            if character is None:
                raise Broken("the sender is silent")
            patience = self.setup.patience_s
            if character == NUL and not line and not count:
                continue
            if character == ESC:
                yield patience
                yield patience
                raise Broken("error of the external device")
            if character == ETX and not line:
                ended = True
                break
            if character == 10 and line[-1:] == b"\r":
                count += 1
                yield from self._trouble(count)
                text = bytes(line[:-1])
                line.clear()
                if not found and _gives_name(text, name, first=count == 1):
                    found = True
                if found:
                    lines.append(text)
            elif (32 <= character < 127 and line[-1:] != b"\r") or (character == 13 and line[-1:] != b"\r"):
                line.append(character)
            else:
                self._say(EOT)
                raise Broken(f"character {character} in line {count + 1}")
        if not found:
            # The manual: it stays without an error message, and nothing is stored.
            raise Broken(f"no program {name}")
        assert ended
        report = self._store(_with_extension(name, lines), lines)
        if not self.faults.no_eot:
            self._say(EOT)
        return report

    def _save_lines(self, name: str) -> Operation:
        self._outputs = True
        self._say(*[NUL] * LEADER)
        for number, line in enumerate(_lines(self.memory[name]), 1):
            yield from self._trouble(number)
            self._say(*line, 13, 10)
            while len(self._out) > 200:
                # Enough is on its way; whoever waits for the line need not be told more.
                yield Sleep(100 * self.setup.character_s)
        self._say(ETX)
        if not self.faults.no_eot:
            self._say(EOT)
        return f"{name}: output"

    # --- blockwise ---

    def _framed(self, start: int, text: bytes, wrong: bool = False) -> bytes:
        check = start ^ ETB
        for character in text:
            check ^= character
        if self.setup.bcc_no_control and check & 0x7F < 0x20:
            text += b" "
            check ^= 0x20
        check = check & 0x7F ^ (0x40 if wrong else 0)
        return bytes((start,)) + text + bytes((ETB, check)) + (bytes((DC1,)) if self.setup.dc3 else b"")

    def _read_frame(self, patience: float) -> Generator[float, int | None, tuple[int, bytes] | None]:
        """Start character and text of a frame; (character, b"") for one that stands alone; None for a damaged one."""
        first = yield patience
        while first in (DC1, DC3, NUL):
            first = yield patience
        if first is None:
            raise Broken("the sender is silent")
        if first in (ETX, EOT, ACK, NAK):
            return first, b""
        good = first in (SOH, STX)
        text = bytearray()
        check = first
        while True:
            character = yield self.setup.patience_s
            if character is None:
                return None
            check ^= character
            if character != ETB:
                good &= 32 <= character < 127 or (self.setup.line_end_in_block and character in (13, 10))
                text.append(character)
                continue
            claimed = yield self.setup.patience_s
            if claimed is None:
                return None
            after = yield SETTLE_S
            if after is None or after == DC1:
                break
            good = False
            text += bytes((character, claimed, after))
        return (first, bytes(text)) if good and check & 0x7F == claimed else None

    def _ask(self, name: str, letter: str, direction: str) -> Operation:
        """A header until it is acknowledged; returns ACK's report, or raises with what the other side says."""
        naks = 0
        while True:
            self._say(*self._framed(SOH, f"{letter}{name}{direction}".encode()))
            # The operator waits until the computer answers.
            answer = yield from self._read_frame(self.setup.patience_s)
            if answer is not None and answer[0] == SOH:
                self._say(ACK, EOT)
                raise Broken(answer[1].decode("ascii"))
            if answer is not None and answer[0] == ETX:
                self._say(EOT)
                return "no more"
            if answer is not None and answer[0] == ACK:
                return "go"
            naks += 1
            if naks > MOST_NAKS:
                self._say(EOT)
                raise Broken("header refused")

    def _load_blocks(self, asked: str, name: str) -> Operation:
        stem, dot, extension = asked.partition(".")
        letter = LETTERS.get(dot + extension, "H")
        yield from self._ask(stem, letter, "E")
        lines = yield from self._read_blocks(stop_after=0)
        report = self._store(_with_extension(asked, lines), lines)
        if not self.faults.no_eot:
            self._say(EOT)
        return report

    def _read_blocks(self, stop_after: int) -> Generator[float | Sleep, int | None, list[bytes]]:
        """Blocks until ETX, or until `stop_after` of them or a block that ends a program (0: until ETX)."""
        lines: list[bytes] = []
        naks = 0
        while True:
            frame = yield from self._read_frame(self.setup.patience_s)
            if frame is not None and frame[0] == ETX:
                return lines
            if frame is not None and frame[0] == SOH:
                self._say(ACK, EOT)
                raise Broken(frame[1].decode("ascii"))
            number = len(lines) + 1
            yield from self._trouble(number)
            refused = frame is None or frame[0] != STX
            if not refused and naks < self.faults.nak.get(number, 0):
                refused = True
            if refused:
                naks += 1
                if naks > MOST_NAKS:
                    self._say(EOT)
                    raise Broken("too many wrong blocks")
                self._say(NAK)
                continue
            assert frame is not None
            naks = 0
            text = frame[1]
            lines.append(text.removesuffix(b"\r\n") if self.setup.line_end_in_block else text)
            if stop_after and (len(lines) == stop_after or b"END PGM" in text):
                # The next header takes the place of the answer.
                return lines
            if number not in self.faults.lost_answer:
                self._say(ACK)

    def _load_every(self, headings_only: bool) -> Operation:
        names: list[str] = []
        while True:
            answer = yield from self._ask("", "H", "E")
            if answer == "no more":
                return "read: " + " ".join(names)
            lines = yield from self._read_blocks(stop_after=1 if headings_only else 1_000_000)
            name = _name_given(lines[0])
            names.append(name)
            if not headings_only:
                self._store(_with_extension(name, lines), lines)

    def _fe1_directory(self) -> Operation:
        self._say(DC3, ESC, DC1, *b"0 D\r\n")
        text = bytearray()
        while True:
            character = yield self.setup.patience_s
            if character is None:
                raise Broken("the sender is silent")
            if character == ETX:
                break
            text.append(character)
        self._say(EOT)
        entries = [line.split() for line in bytes(text).decode("ascii").split("\r\n")[4:-1]]
        return "directory: " + " ".join(f"{entry[1]}={entry[2]}" for entry in entries)

    def _save_blocks(self, name: str, shown: str) -> Operation:
        self._outputs = True
        stem, dot, extension = shown.partition(".")
        yield from self._ask(stem, LETTERS.get(dot + extension, "H"), "A")
        for number, line in enumerate(_lines(self.memory[name]), 1):
            yield from self._trouble(number)
            wrong = number in self.faults.wrong_check
            text = line + (b"\r\n" if self.setup.line_end_in_block else b"")
            naks = 0
            while True:
                self._say(*self._framed(STX, text, wrong))
                answer = yield from self._read_frame(self.setup.patience_s)
                if answer is not None and answer[0] == ACK:
                    break
                if answer is not None and answer[0] == SOH:
                    self._say(ACK, EOT)
                    raise Broken(answer[1].decode("ascii"))
                wrong = False
                naks += 1
                if naks > MOST_NAKS:
                    self._say(EOT)
                    raise Broken("too many repetitions")
        self._say(ETX)
        if not self.faults.no_eot:
            self._say(EOT)
        return f"{name}: output"

    def _save_every(self) -> Operation:
        for name in sorted(self.memory):
            yield from self._save_blocks(name, name)
            # The computer needs a moment to be ready for the next header.
            yield Sleep(0.05)
        return "all output"


def _lines(program: bytes) -> list[bytes]:
    return program.removesuffix(b"\r\n").split(b"\r\n")


def _name_given(line: bytes) -> str:
    """The name in the first line of a program; without one, some name."""
    match = re.match(rb"\s*\d*\s*BEGIN PGM (\S+)|%(\S+)", line)
    return (match[1] or match[2]).decode() if match else "NONAME"


def _gives_name(line: bytes, name: str, first: bool) -> bool:
    """Whether a line begins the program of that name; for a file whose first line begins none any name will do."""
    begins = re.match(rb"\s*\d*\s*BEGIN PGM |%", line) is not None
    return _name_given(line) == name.partition(".")[0] if begins else first


def _with_extension(name: str, lines: list[bytes]) -> str:
    if "." in name:
        return name
    return name + (".I" if lines and lines[0].startswith(b"%") else ".H")
