"""DIN/ISO programs (.I) for the HEIDENHAIN iTNC 530: M128 with rotary words.

In ISO this control takes the tool axis from rotary words only; it has neither LN nor FUNCTION TCPM there. Blocks that
differ between versions of the control are options: `datum` and `shift` (the preset, and a shift of the datum), and
`tolerance` with `tolerance_off` (cycle 32). An empty option leaves its block out.
"""

from __future__ import annotations

from collections.abc import Iterator

from postprocessors.errors import PostError
from postprocessors.facts import short
from postprocessors.heidenhain.control import rotary_tolerance
from postprocessors.heidenhain.program import Dialect, rotary_words, signed, write_programs
from postprocessors.heidenhain.rides import Ride
from postprocessors.machines.machine import Machine
from postprocessors.post import Post, ProgramFile, ProgramOptions, own_option
from postprocessors.toolpath import Cutter, ToolPath

LAST_BLOCK = 99999999
_SIDES = {"R0": "G40", "RL": "G41", "RR": "G42"}
STEP = 10
"""Between block numbers, so that blocks can be put in by hand; 1 where the numbers would not do."""


def write_iso(path: ToolPath, machine: Machine, options: ProgramOptions) -> tuple[ProgramFile, ...]:
    """The program of a tool path: ASCII text, lines ended by CR LF.

    Raises
    ------
    PostError: anything the control or the machine could not execute; nothing is written then.
    """
    return write_programs(path, machine, options, Iso(options))


POST = Post(
    suffix=".I",
    styles=("m128",),
    write=write_iso,
    why="in ISO the control takes the tool axis from rotary words under M128 only; it has no LN and no FUNCTION TCPM",
    own={
        "decimal": "point",
        "radius": "off",
        "datum": "G247 Q339=+{datum}",
        "shift": "G54 X{x} Y{y} Z{z}",
        "tolerance": "G62 T{t} P01 0 P02 {ta}",
        "tolerance_off": "G62",
    },
)


class Iso(Dialect):
    """Blocks as the control's ISO language has them."""

    post = POST
    on, off = "M128", "M129"

    def __init__(self, options: ProgramOptions) -> None:
        self.options = options

    def _own(self, key: str, **values: str) -> Iterator[str]:
        template = own_option(POST, self.options, key)
        try:
            block = template.format(**values)
        except (KeyError, IndexError, ValueError):
            expected = "a block with " + (" ".join(f"{{{name}}}" for name in values) or "no places to fill")
            raise PostError(f"[program] options.{key}", f"'{template}'", expected, "Correct the block.") from None
        if block:
            yield block

    def opening(self, path: ToolPath) -> Iterator[str]:
        """Name and blank."""
        yield f"%{path.name} G71"
        for corner, words in ((path.blank_low, "G30 G17"), (path.blank_high, "G31 G90")):
            x, y, z = (signed(value) for value in corner)
            yield f"{words} X{x} Y{y} Z{z}"

    def tool_call(self, cutter: Cutter) -> str:
        """Tool and speed."""
        return f"T{cutter.number} G17 S{short(cutter.spindle_rpm, 3)}"

    def datum(self, options: ProgramOptions) -> Iterator[str]:
        """Preset or shift."""
        if isinstance(options.datum, int):
            return self._own("datum", datum=str(options.datum))
        return self._shift(*options.datum)

    def datum_reset(self) -> Iterator[str]:
        """The shift by nothing."""
        return self._shift(0.0, 0.0, 0.0)

    def _shift(self, x: float, y: float, z: float) -> Iterator[str]:
        return self._own("shift", x=signed(x), y=signed(y), z=signed(z))

    def tolerance(self, options: ProgramOptions, cutter: Cutter) -> Iterator[str]:
        """Cycle 32, for finishing."""
        return self._own("tolerance", t=short(options.tolerance_mm), ta=short(rotary_tolerance(options, cutter)))

    def tolerance_reset(self) -> Iterator[str]:
        """Cycle 32 without values."""
        return self._own("tolerance_off")

    def retract(self, machine: Machine) -> str:
        """Along the tool axis to the limit, or to a height of the machine."""
        if machine.retract_z_mm is None:
            return "G00 G40 M140 MB MAX"
        return f"G00 G40 G90 Z{signed(machine.retract_z_mm)} M91"

    def turn(self, words: str, start: bool) -> str:
        """Rotary axes at rapid."""
        return f"G00 G40 G90 {words}" + (" M3" if start else "")

    def poses(self, ride: Ride) -> list[str]:
        """Rotary words."""
        return rotary_words(ride)

    def first(self, pose: str) -> str:
        """At rapid, without compensation."""
        return f"G00 G40 G90 {pose}"

    def sided(self, pose: str, side: str) -> str:
        """After the path condition."""
        return f"{_SIDES[side]} {pose}"

    def rapid(self, pose: str) -> str:
        """Rapid."""
        return f"G00 {pose}"

    def cut(self, pose: str, feed: int | None) -> str:
        """The feed is modal."""
        return f"G01 {pose}" if feed is None else f"G01 {pose} F{feed}"

    def text(self, blocks: list[str]) -> list[str]:
        """The first block without a number, the last with the highest."""
        step = STEP if STEP * len(blocks) < LAST_BLOCK else 1
        inner = [f"N{step * number} {block} *" for number, block in enumerate(blocks[1:-1], start=1)]
        return [f"{blocks[0]} *", *inner, f"N{LAST_BLOCK} {blocks[-1]} *"]

    def closing(self, path: ToolPath) -> str:
        """The name again."""
        return f"%{path.name} G71"
