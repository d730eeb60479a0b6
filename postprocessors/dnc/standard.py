"""The standard protocol (MP5030 = 0): lines, DC1 and DC3, ETX, EOT. The operator starts at the control.

It has no check of its own but parity: a character with a wrong parity arrives as NUL (see port.py), and any control
character in the text ends the transfer.
"""

from __future__ import annotations

from collections.abc import Iterator

from postprocessors.dnc.engine import Engine, count_of
from postprocessors.dnc.profile import Profile
from postprocessors.dnc.store import Refusal, Sink
from postprocessors.dnc.wire import CR, DC1, DC3, ESC, LF, LINE_END, NUL, is_text

LONGEST_LINE = 4096
"""Characters; a line without end is no program, and must not fill the memory."""


class StandardSender(Engine):
    """From here to the control: wait for DC1, send the lines and ETX, wait for EOT."""

    def __init__(self, profile: Profile, title: str, lines: Iterator[bytes]) -> None:
        super().__init__(profile, title)
        self._lines = lines
        self._text_over = False
        self._line: bytes | None = None
        self._escape = b""

    def begin(self, now: float) -> None:
        """Start to wait for the control."""
        self._wait(self.profile.start_timeout_s, self._not_started, now)

    def left_behind(self) -> str:
        """Lines that have gone out: the driver and the control may have fewer, never more."""
        lines = self.counts.blocks + (self._line is not None)
        if not lines:
            return ""
        said = count_of(lines, "line")
        if self.finished and self.failure is None:
            return f"the control has received the whole program ({said}) and confirmed it"
        if self._text_over:
            return f"the whole program has gone out to the control ({said}), which has not confirmed it"
        return f"what has gone out to the control: {said}"

    def _character(self, character: int, now: float) -> None:
        if self._escape:
            self._escape += bytes((character,))
            if len(self._escape) == 3:
                found = f"error {self._escape[1:].decode('ascii', 'replace')} from the control"
                self._fail(found, "DC1, DC3 or EOT", "See the message at the control.", now, tell=False)
        elif character == DC1:
            self._pause(False, now)
        elif not self.started:
            # Before the control has started, whatever comes is left over from something else.
            return
        elif character == DC3:
            self._pause(True, now)
        elif character == self._characters.eot:
            self._ended(now)
        elif character == ESC:
            self._escape = bytes((ESC,))

    def _pause(self, paused: bool, now: float) -> None:
        super()._pause(paused, now)
        if not paused and not self.started:
            self.started = True
            self._waiting += bytes((NUL,)) * self.profile.leading_nulls
        if paused or not self._text_over or self._waiting:
            self._wait(self.profile.silence_timeout_s, self._silent, now)
        else:
            self._wait(self.profile.reply_timeout_s, self._no_end, now)

    def _refill(self, now: float) -> bool:
        if not self._more():
            return False
        if self._line is not None:
            self.counts.blocks += 1
            self.counts.bytes += len(self._line)
        line = next(self._lines, None)
        if line is None:
            self._line = None
            self._text_over = True
            self._waiting.append(self._characters.etx)
        else:
            self._line = line + LINE_END
            self._waiting += self._line
        self._wait(self.profile.silence_timeout_s, self._silent, now)
        return True

    def _more(self) -> bool:
        return self.started and not self._text_over and not self.finished

    def _all_out(self, now: float) -> None:
        if self._text_over and not self.finished:
            self._wait(self.profile.reply_timeout_s, self._no_end, now)

    def _ended(self, now: float) -> None:
        if self._text_over and not self._waiting:
            self._end()
            return
        found = "the control ended the transfer (EOT)"
        self._fail(found, "EOT after the last line", "See the message at the control.", now, tell=False)

    def _not_started(self, now: float) -> None:
        next_step = (
            "Start the transfer at the control, or see whether port, cable and settings fit (conflank dnc check)."
        )
        found = f"no DC1 within {self.profile.start_timeout_s:g} s"
        self._fail(found, "DC1 when the control starts reading", next_step, now, tell=False)

    def _silent(self, now: float) -> None:
        found = f"no DC1 for {self.profile.silence_timeout_s:g} s"
        if not self._paused:
            found = f"no character could be sent for {self.profile.silence_timeout_s:g} s"
        self._fail(
            found, "DC1 to go on", "See to the control, and raise silence_timeout_s if it needs longer.", now, True
        )

    def _no_end(self, now: float) -> None:
        found = f"no EOT within {self.profile.reply_timeout_s:g} s after the last line"
        next_step = "Look at the control whether the program is there, whole, and under the name that was typed."
        self._fail(found, "EOT, with which the control confirms", next_step, now, tell=False)

    def _break_off(self, tell: bool) -> None:
        # ETX was never sent, so the control keeps nothing; this tells it not to wait for more.
        if tell and self.started and not self._text_over and self.profile.abort_digit >= 0:
            self._waiting += bytes((ESC,)) + f"1{self.profile.abort_digit}".encode()


class StandardReceiver(Engine):
    """From the control to here: NULs, lines, ETX EOT."""

    def __init__(self, profile: Profile, title: str, sink: Sink) -> None:
        super().__init__(profile, title)
        self._sink = sink
        self._line = bytearray()
        self._after_etx = False

    def begin(self, now: float) -> None:
        """Start to wait for the control."""
        self._wait(self.profile.start_timeout_s, self._not_started, now)

    def _character(self, character: int, now: float) -> None:
        if self._after_etx:
            if character == self._characters.eot:
                self._keep(now)
            elif character not in (DC1, DC3):
                self._refuse(character, "EOT after ETX", now)
            return
        if not self.started:
            if character in (NUL, DC1, DC3, CR, LF):
                return
            self.started = True
        self._wait(self.profile.silence_timeout_s, self._silent, now)
        if self._line[:1] == bytes((ESC,)):
            self._line.append(character)
            if len(self._line) == 3:
                found = f"error {self._line[1:].decode('ascii', 'replace')} from the control"
                self._fail(found, "the rest of the program", "See the message at the control.", now, tell=False)
        elif (
            is_text(character, self.profile.data_bits) and self._line[-1:] != b"\r" and len(self._line) < LONGEST_LINE
        ) or (character == CR and self._line[-1:] != b"\r"):
            self._line.append(character)
        elif character == LF and self._line[-1:] == b"\r":
            self._sink.write(bytes(self._line[:-1]))
            self.counts.blocks += 1
            self.counts.bytes += len(self._line) + 1
            self._line.clear()
        elif character == self._characters.etx and not self._line and self.counts.blocks:
            self._after_etx = True
            self._wait(self.profile.reply_timeout_s, self._no_end, now)
        elif character == ESC and not self._line:
            self._line.append(character)
        elif character not in (DC1, DC3):
            self._refuse(character, "text, CR LF or ETX", now)

    def _keep(self, now: float) -> None:
        try:
            self._sink.commit()
        except Refusal as refusal:
            self._fail(refusal.reason, "a name that is free", "Receive it under another name.", now, tell=False)
        else:
            self._end()

    def _refuse(self, character: int, expected: str, now: float) -> None:
        next_step = "Send the program again; look at baud rate, parity and cable if it happens again."
        if character == self._characters.eot:
            self._fail("the control ended the transfer (EOT)", expected, "See the message at the control.", now, False)
            return
        what = "NUL (a character with wrong parity arrives so)" if character == NUL else f"character 0x{character:02X}"
        self._fail(what, expected, next_step, now, tell=False)

    def _not_started(self, now: float) -> None:
        found = f"nothing received within {self.profile.start_timeout_s:g} s"
        next_step = "Start the output at the control, or see whether port, cable and settings fit (conflank dnc check)."
        self._fail(found, "a program from the control", next_step, now, tell=False)

    def _silent(self, now: float) -> None:
        found = f"nothing received for {self.profile.silence_timeout_s:g} s"
        next_step = "See whether the cable is in and the control still sends."
        self._fail(found, "the rest of the program", next_step, now, tell=False)

    def _no_end(self, now: float) -> None:
        found = f"no EOT within {self.profile.reply_timeout_s:g} s after ETX"
        self._fail(found, "EOT, with which the control ends", "Send the program again.", now, tell=False)

    def _break_off(self, tell: bool) -> None:
        self._sink.discard()
