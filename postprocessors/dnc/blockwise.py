"""The blockwise protocol (MP5030 = 1, FE1, FE2): headers and blocks with a BCC, ACK, NAK. The control is the master.

Source: technical manuals TNC 306/406 and 426/430, "Data transfer with BCC"; TNC 407/415/425 for headers without a name.

Two rules go beyond the manuals, because XOR alone lets a wrong line through. A text character that becomes ETB on the
way ends a block early, and the next character is its BCC with one chance in a hundred: so a block counts only when DC1
or a short silence follows its BCC. And a block is never sent again because an answer is missing: blocks have no
numbers, and the control would keep the line twice if only its ACK was lost. Silence is flow control until
`silence_timeout_s`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from enum import Enum, auto

from postprocessors.dnc.engine import Engine, count_of
from postprocessors.dnc.profile import Profile
from postprocessors.dnc.store import Entry, Refusal, Sink, Store
from postprocessors.dnc.wire import CR, DC1, DC3, DIRECTORY_REQUEST, LF, LINE_END, NAK, block_check, is_text, make_frame
from postprocessors.errors import PostError

INTO_CONTROL, OUT_OF_CONTROL = ord("E"), ord("A")
LONGEST_BLOCK = 4096
"""Characters; a block without end must not fill the memory."""
NAME_PATTERN = r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,40}"
"""Names that a control may ask for: no folders, nothing hidden."""
_NUMBERED = re.compile(rb"N?\d|%")
DIRECTORY_HEADING = 4
"""Lines at the head of an FE1 directory that the control ignores."""


class State(Enum):
    """What the server waits for."""

    IDLE = auto()
    """A header, or the request for the directory."""
    ANSWER = auto()
    """ACK or NAK for the block that was sent."""
    NEXT_HEADER = auto()
    """Reading all files: the header for the next one."""
    END_CONFIRMED = auto()
    """EOT after our ETX."""
    BLOCK = auto()
    """A block from the control, or ETX."""
    END = auto()
    """EOT after the control's ETX."""


class Frame(Enum):
    """How far a frame from the control is."""

    NONE = auto()
    TEXT = auto()
    CHECK = auto()
    """The next character is the BCC, whatever it is."""
    SETTLE = auto()
    """DC1 or silence ends it."""


class BlockwiseServer(Engine):
    """Answers the control's requests from a store; one of them (`once`), or until it is aborted.

    `report` is told what happened, one sentence each.
    """

    def __init__(
        self,
        profile: Profile,
        title: str,
        store: Store,
        once: bool,
        report: Callable[[str], None] = lambda text: None,
    ) -> None:
        super().__init__(profile, title)
        self._store = store
        self._once = once
        self._report = report
        self._state = State.IDLE
        self._frame = Frame.NONE
        self._text = bytearray()
        self._damaged = False
        self._check = 0
        self._tail = False
        self._recent = b""
        self._bad_frames = 0
        # of the transfer that is going on
        self._name = ""
        self._header = b""
        self._lines: Iterator[bytes] | None = None
        self._line = b""
        self._next_line: bytes | None = None
        self._block = b""
        self._tries = 0
        self._pending: list[Entry] | None = None
        self._sink: Sink | None = None
        self._aborted = False

    def begin(self, now: float) -> None:
        """Start to wait for the control."""
        self._rest(now)

    def left_behind(self) -> str:
        """Blocks that the control has acknowledged of what it is reading, and the one that it may have besides."""
        blocks, name = self.counts.blocks, self._name or "the program"
        said = count_of(blocks, "block")
        if self._state is State.ANSWER:
            return f"the control has acknowledged {said} of {name} and may have one more"
        if self._state in (State.NEXT_HEADER, State.END_CONFIRMED) and blocks:
            if self.finished and self.failure is None:
                return f"the control has received all of {name} ({said}) and confirmed it"
            return f"the control has acknowledged {name} to its last block ({said}), but not the end"
        return ""

    # --- characters ---

    def _character(self, character: int, now: float) -> None:
        if self._frame is Frame.CHECK:
            self._check = character
            self._frame = Frame.SETTLE
            self._wait(self.profile.settle_s, self._frame_complete, now)
        elif self._frame is Frame.SETTLE and character == DC1:
            self._frame_complete(now)
        elif self._frame is not Frame.NONE:
            # In SETTLE: something follows what seemed a BCC, so it was none.
            self._damaged |= self._frame is Frame.SETTLE
            self._frame = Frame.TEXT
            self._frame_text(character, now)
        elif character == self._characters.soh or (character == self._characters.stx and self._state is State.BLOCK):
            self._tail = False
            self._open_frame(character, damaged=False, now=now)
        elif self._state is State.IDLE:
            self._idle(character, now)
        elif self._state is State.BLOCK:
            self._between_blocks(character, now)
        elif self._state is State.END:
            self._after_end(character, now)
        else:
            self._answer(character, now)

    def _open_frame(self, character: int, damaged: bool, now: float) -> None:
        self._frame = Frame.TEXT
        self._text = bytearray((character,))
        self._damaged = damaged
        self._wait(self.profile.reply_timeout_s, self._frame_broken, now)

    def _frame_text(self, character: int, now: float) -> None:
        self._wait(self.profile.reply_timeout_s, self._frame_broken, now)
        self._text.append(character)
        if character == self._characters.etb:
            self._frame = Frame.CHECK
            return
        line_end = self.profile.line_end_in_block and character in (CR, LF)
        if not (is_text(character, self.profile.data_bits) or line_end) or len(self._text) > LONGEST_BLOCK:
            self._damaged = True
            del self._text[LONGEST_BLOCK:]

    def _frame_complete(self, now: float) -> None:
        self._frame = Frame.NONE
        text = bytes(self._text)
        if self._damaged or block_check(text) != self._check & 0x7F or len(text) < 3:
            self._bad_frame("a block whose check character is wrong", now)
            return
        self._bad_frames = 0
        if text[0] == self._characters.soh:
            self._header_received(text, now)
        elif self._state is State.BLOCK:
            self._block_received(text[1:-1], now)
        else:
            self._bad_frame("a block that begins like none", now)

    def _frame_broken(self, now: float) -> None:
        self._frame = Frame.NONE
        self._bad_frame(f"a block that was not finished within {self.profile.reply_timeout_s:g} s", now)
        self._tail = True

    def _bad_frame(self, what: str, now: float) -> None:
        """Answer NAK, once for each block: the control takes a second one for the answer to its repetition."""
        if self._tail:
            # The rest of a block that came too late and has had its NAK.
            self._tail = False
            self._wait_in_state(now)
            return
        if self._state in (State.ANSWER, State.END_CONFIRMED) and self._pending is None:
            # Nothing but a message of the control can begin so here, and that is not asked for again.
            self._wait_in_state(now)
            return
        self._bad_frames += 1
        self.counts.repeats += 1
        if self._bad_frames > self.profile.retries:
            found = f"{what}, {self._bad_frames} times"
            next_step = "Look at baud rate, parity and cable; `retries` may be raised to 15."
            self._fail(found, "a block with its right check character", next_step, now, tell=True)
            return
        self._waiting.append(NAK)
        self._wait_in_state(now)

    # --- between frames ---

    def _idle(self, character: int, now: float) -> None:
        self._recent = (self._recent + bytes((character,)))[-len(DIRECTORY_REQUEST) :]
        if self._recent == DIRECTORY_REQUEST and not self._once:
            self._recent = b""
            self._send_directory(now)

    def _answer(self, character: int, now: float) -> None:
        if character == DC3 and self.profile.dc3:
            self._paused = True
            self._wait(self.profile.silence_timeout_s, self._silent, now)
        elif character == DC1:
            self._paused = False
            self._wait_in_state(now)
        elif character == self._characters.eot:
            self._eot(now)
        elif self._state is State.ANSWER and character == self._characters.ack:
            if self._waiting:
                self._fail("ACK before the block was sent", "ACK after the block", "Try again.", now, tell=True)
            else:
                self._acknowledged(now)
        elif self._state is State.ANSWER and character == NAK:
            self._repeat(now)

    def _eot(self, now: float) -> None:
        if self._state is State.END_CONFIRMED and not self._waiting:
            what = f"{self._name}: sent, {self.counts.blocks} blocks" if self._pending is None else "reading all: done"
            self._report(what)
            self._done(now)
        else:
            found = "the control ended the transfer (EOT)"
            self._fail(found, "ACK", "See the message at the control.", now, tell=False)

    def _between_blocks(self, character: int, now: float) -> None:
        if character == self._characters.etx:
            self._state = State.END
            self._wait_in_state(now)
        elif character == self._characters.eot:
            found = "the control ended the transfer (EOT)"
            self._fail(found, "ETX after the last block", "See the message at the control.", now, tell=False)
        elif is_text(character, self.profile.data_bits):
            # A block whose STX was lost; its end is waited for, so that the answer does not meet its rest.
            self._open_frame(character, damaged=True, now=now)

    def _after_end(self, character: int, now: float) -> None:
        if character == self._characters.eot:
            assert self._sink is not None
            sink, self._sink = self._sink, None
            try:
                sink.commit()
            except Refusal as refusal:
                self._refuse(refusal, now)
                return
            except PostError as error:
                self._give_up(error, now)
                return
            self._report(f"{self._name}: received, {self.counts.blocks} blocks")
            self._done(now)
        elif character not in (DC1, DC3):
            found = f"character 0x{character:02X} after ETX"
            self._fail(found, "EOT", "Send the program again.", now, tell=True)

    # --- headers ---

    def _header_received(self, text: bytes, now: float) -> None:
        body = text[1:-1]
        nameless = len(body) == 2 and body[-1] == INTO_CONTROL
        if self._state in (State.ANSWER, State.NEXT_HEADER) and nameless and self._pending is not None:
            self._next_file(body, now)
        elif self._state is State.BLOCK and text == self._header and self.counts.blocks == 0:
            self._accept_header(now)
        elif self._state is not State.IDLE:
            self._waiting.append(self._characters.ack)
            message = body.decode("latin-1")
            found = f"message from the control: {message!r}"
            self._fail(found, "ACK or a block", "See to what the control reports.", now, tell=False)
        elif nameless and not self._once:
            self._pending = self._store.directory()
            self._next_file(body, now)
        else:
            self._request(body, text, now)

    def _request(self, body: bytes, text: bytes, now: float) -> None:
        self.started = True
        name = body[1:-1].decode("latin-1").strip()
        direction = body[-1] if len(body) > 1 else 0
        legal = re.fullmatch(NAME_PATTERN, name) is not None
        if direction not in (INTO_CONTROL, OUT_OF_CONTROL) or not (legal or (not name and self._once)):
            message = body.decode("latin-1")
            self._refuse(Refusal("ILLEGAL REQUEST", f"{message!r} is neither a legal name nor a request"), now)
            return
        kind = chr(body[0])
        self._begin_transfer(name, text)
        try:
            if direction == INTO_CONTROL:
                self._lines = self._store.read(name, kind)
                self._first_line()
            else:
                self._sink = self._store.create(name, kind)
        except Refusal as refusal:
            self._refuse(refusal, now)
            return
        self._accept_header(now)

    def _begin_transfer(self, name: str, header: bytes) -> None:
        self.counts.bytes = self.counts.blocks = self.counts.repeats = 0
        self._name, self._header = name, header
        self._line = b""
        if not self._once:
            self.title = name

    def _accept_header(self, now: float) -> None:
        if self._sink is not None:
            if self.profile.header_answer == "echo":
                self._waiting += self._header + bytes((block_check(self._header),))
            else:
                self._waiting.append(self._characters.ack)
            self._state = State.BLOCK
            self._wait_in_state(now)
        else:
            self._waiting.append(self._characters.ack)
            self._send_line(now)

    def _next_file(self, body: bytes, now: float) -> None:
        """Reading all: the control asks for the next file, or breaks off this one for it."""
        assert self._pending is not None
        self._close_lines()
        while self._pending:
            entry = self._pending.pop(0)
            self._begin_transfer(entry.name, b"")
            try:
                self._lines = self._store.read(entry.name, chr(body[0]))
                self._first_line()
            except Refusal as refusal:
                self._report(f"{entry.name}: left out, {refusal.reason}")
                continue
            self._accept_header(now)
            return
        self._send_end(now)

    # --- from here to the control ---

    def _first_line(self) -> None:
        """An empty program must be refused before the header is acknowledged."""
        assert self._lines is not None
        self._next_line = next(self._lines, None)
        if self._next_line is None:
            raise Refusal("EMPTY FILE", f"{self._name} is empty")

    def _send_line(self, now: float) -> None:
        assert self._lines is not None and self._next_line is not None
        self._line, self._next_line = self._next_line, None
        text = self._line + (LINE_END if self.profile.line_end_in_block else b"")
        self._block = make_frame(self._characters.stx, text, self._characters.etb, self.profile.bcc_no_control)
        if self.profile.prompts:
            self._block += bytes((DC1,))
        self._tries = 0
        self._waiting += self._block
        self._state = State.ANSWER
        self._wait_in_state(now)

    def _acknowledged(self, now: float) -> None:
        assert self._lines is not None
        self.counts.blocks += 1
        self.counts.bytes += len(self._line) + len(LINE_END)
        try:
            self._next_line = next(self._lines, None)
        except PostError as error:
            self._give_up(error, now)
            return
        if self._next_line is not None:
            self._send_line(now)
        elif self._pending:
            self._state = State.NEXT_HEADER
            self._wait_in_state(now)
        else:
            self._send_end(now)

    def _repeat(self, now: float) -> None:
        self._tries += 1
        if self._tries > self.profile.retries:
            found = f"block {self.counts.blocks + 1} refused {self._tries} times (NAK)"
            next_step = "Look at baud rate, parity and cable; `retries` may be raised to 15."
            self._fail(found, "ACK", next_step, now, tell=True)
            return
        self.counts.repeats += 1
        # What is left of the first try must not go out before the second.
        self._waiting.clear()
        self._waiting += self._block
        self._wait_in_state(now)

    def _send_end(self, now: float) -> None:
        self._close_lines()
        self._waiting.append(self._characters.etx)
        self._state = State.END_CONFIRMED
        self._wait_in_state(now)

    def _send_directory(self, now: float) -> None:
        """FE1: four lines that are ignored, a line per file, the free sectors, ETX."""
        self._begin_transfer("directory", b"")
        lines = [b""] * DIRECTORY_HEADING
        for number, entry in enumerate(self._store.directory(), 1):
            sectors = str(-(-entry.size // self.profile.sector_bytes))
            words = [entry.name, sectors]
            if self.profile.directory_order == "sectors-name":
                words.reverse()
            lines.append(f"{number:06d} {' '.join(words)}".encode())
        self._waiting += b"".join(line + LINE_END for line in lines)
        self._waiting.append(self._characters.etx)
        self._state = State.END_CONFIRMED
        self._wait_in_state(now)

    # --- from the control to here ---

    def _block_received(self, text: bytes, now: float) -> None:
        assert self._sink is not None
        if self.profile.line_end_in_block:
            if not text.endswith(LINE_END):
                self._bad_frame("a block without CR LF, against line_end_in_block", now)
                return
            text = text[: -len(LINE_END)]
        if text == self._line and _NUMBERED.match(text):
            # The control repeats a block whose ACK was damaged; a number does not come twice in a program.
            self.counts.repeats += 1
            self._waiting.append(self._characters.ack)
            self._wait_in_state(now)
            return
        self._line = text
        try:
            self._sink.write(text)
        except PostError as error:
            self._give_up(error, now)
            return
        self.counts.blocks += 1
        self.counts.bytes += len(text) + len(LINE_END)
        self._waiting.append(self._characters.ack)
        self._wait_in_state(now)

    # --- deadlines and ends ---

    def _wait_in_state(self, now: float) -> None:
        profile = self.profile
        if self._state is State.IDLE:
            seconds = profile.start_timeout_s if self._once else 0.0
            self._wait(seconds, self._not_started, now)
        elif self._state in (State.END_CONFIRMED, State.END):
            self._wait(profile.reply_timeout_s, self._no_end, now)
        elif self._state is State.NEXT_HEADER:
            self._wait(profile.reply_timeout_s, self._send_end, now)
        else:
            self._wait(profile.silence_timeout_s, self._silent, now)

    def _all_out(self, now: float) -> None:
        if not self.finished and self._frame is Frame.NONE:
            self._wait_in_state(now)

    def _not_started(self, now: float) -> None:
        found = f"no request from the control within {self.profile.start_timeout_s:g} s"
        next_step = (
            "Start the transfer at the control, or see whether port, cable and settings fit (conflank dnc check)."
        )
        self._fail(found, "a header", next_step, now, tell=False)

    def _silent(self, now: float) -> None:
        seconds = f"{self.profile.silence_timeout_s:g} s"
        if self._state is State.BLOCK:
            self._fail(
                f"nothing received for {seconds}", "a block or ETX", "See to the control and the cable.", now, True
            )
            return
        found = f"no answer to block {self.counts.blocks + 1} for {seconds}"
        next_step = (
            "See to the control and the cable, or raise silence_timeout_s. The block is not repeated by itself, "
            "because the control may have it already."
        )
        self._fail(found, "ACK or NAK", next_step, now, tell=True)

    def _no_end(self, now: float) -> None:
        found = f"no EOT within {self.profile.reply_timeout_s:g} s after ETX"
        if self._state is State.END_CONFIRMED:
            next_step = "Look at the control whether the program is there, whole."
            self._fail(found, "EOT, with which the control confirms", next_step, now, tell=False)
        else:
            self._fail(found, "EOT, with which the control ends", "Send the program again.", now, tell=True)

    def _refuse(self, refusal: Refusal, now: float) -> None:
        """Answer a request with an error text, which the control shows."""
        expected = "a request that can be granted"
        next_step = f"The control was told: {refusal.text}."
        self._fail(refusal.reason, expected, next_step, now, tell=False)
        self._tell(refusal.text)

    def _give_up(self, error: PostError, now: float) -> None:
        """A file here cannot be read on or written; one transfer ends so, a server goes on."""
        self._fail(error.found, error.expected, error.next_step, now, tell=True)

    def _tell(self, text: str) -> None:
        frame = make_frame(self._characters.soh, text.encode(), self._characters.etb, self.profile.bcc_no_control)
        self._waiting += frame + (bytes((DC1,)) if self.profile.prompts else b"")

    def _fail(self, found: str, expected: str, next_step: str, now: float, tell: bool) -> None:
        reply = bytes(self._waiting) if self._waiting == bytes((self._characters.ack,)) else b""
        super()._fail(found, expected, next_step, now, tell)
        self._waiting[:0] = reply
        if not self._once and not self._aborted:
            assert self.failure is not None
            self._report(str(self.failure))
            self.failure, self.finished = None, False
            self._rest(now)

    def abort(self, reason: str, now: float) -> None:
        """Break off for good, also a server."""
        self._aborted = True
        super().abort(reason, now)

    def _break_off(self, tell: bool) -> None:
        if self._sink is not None:
            self._sink.discard()
            self._sink = None
        self._close_lines()
        if tell and self._state is not State.IDLE:
            self._tell("TRANSFER BROKEN OFF")

    def _done(self, now: float) -> None:
        if self._once:
            self._end()
        else:
            self._rest(now)

    def _rest(self, now: float) -> None:
        """Back to waiting for a header."""
        self._close_lines()
        self._state = State.IDLE
        self._frame = Frame.NONE
        self._bad_frames = 0
        self._tail = False
        self._recent = b""
        self._pending = None
        self._paused = False
        self._wait_in_state(now)

    def _close_lines(self) -> None:
        close = getattr(self._lines, "close", None)
        if close is not None:
            close()
        self._lines = None
        self._next_line = None
