"""What goes over the wire: control characters, the block check character, frames.

Source: HEIDENHAIN technical manuals TNC 306/406, 407/415/425, 426/430, chapter "Data interfaces".
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import xor

NUL = 0x00
CR, LF = 0x0D, 0x0A
DC1, DC3 = 0x11, 0x13
NAK = 0x15
ESC = 0x1B
SPACE = 0x20
DELETE = 0x7F
LINE_END = b"\r\n"
SEVEN_BITS = 0x7F
DIRECTORY_REQUEST = bytes((DC3, ESC, DC1)) + b"0 D\r\n"
"""What FE1 sends before it reads a directory."""


@dataclass(frozen=True, slots=True)
class Characters:
    """The control characters that machine parameters can change; what stands here is their default."""

    soh: int = 0x01
    stx: int = 0x02
    etx: int = 0x03
    eot: int = 0x04
    ack: int = 0x06
    etb: int = 0x17

    def all(self) -> frozenset[int]:
        """Every character that has a meaning and so cannot be text."""
        return frozenset((self.soh, self.stx, self.etx, self.eot, self.ack, self.etb, NAK, DC1, DC3, ESC))


def block_check(frame: bytes) -> int:
    """BCC of a frame from SOH or STX to ETB, both included: XOR of the characters' seven bits."""
    return reduce(xor, frame, 0) & SEVEN_BITS


def make_frame(start: int, text: bytes, etb: int, never_control: bool) -> bytes:
    """A header or a block with its BCC.

    With `never_control` one space goes before ETB where the BCC would be a control character (bit 1 of MP5020): the
    text grows by that space at the receiver.
    """
    frame = bytes((start,)) + text + bytes((etb,))
    check = block_check(frame)
    if never_control and check < SPACE:
        frame = bytes((start,)) + text + bytes((SPACE, etb))
        check = block_check(frame)
    return frame + bytes((check,))


def is_text(character: int, data_bits: int) -> bool:
    """Whether a character may stand in a line of a program: printable, and no more bits than the line carries."""
    return SPACE <= character < DELETE or (data_bits == 8 and character > DELETE)
