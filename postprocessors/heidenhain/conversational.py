"""Conversational programs (.H) for the HEIDENHAIN iTNC 530, in three styles.

- ``tcpm``: FUNCTION TCPM with rotary words; the control swings the axis from pose to pose in a plane.
- ``m128``: M128 with rotary words; every rotary axis moves evenly from pose to pose.
- ``ln``: tool vectors, independent of the machine; the rotary axes are brought to their places by words before.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from postprocessors.facts import short
from postprocessors.heidenhain.control import rotary_tolerance
from postprocessors.heidenhain.program import Dialect, rotary_words, signed, vector_words, write_programs
from postprocessors.heidenhain.rides import Ride
from postprocessors.machines.machine import Machine
from postprocessors.post import Post, ProgramFile, ProgramOptions, own_option
from postprocessors.toolpath import Cutter, Purpose, Stretch, ToolPath

_CUTS = (Purpose.SWEEP, Purpose.PASS)
_TCPM = ("FUNCTION TCPM F TCP AXIS POS PATHCTRL VECTOR", "FUNCTION RESET TCPM")
_SWITCHES = {"tcpm": _TCPM, "m128": ("M128", "M129"), "ln": _TCPM}


def write_conversational(path: ToolPath, machine: Machine, options: ProgramOptions) -> tuple[ProgramFile, ...]:
    """The programs of a tool path: ASCII text, lines ended by CR LF; the first is the one to run.

    Parameters
    ----------
    path: what to cut, in program coordinates.
    machine: rotary axes, limits and retract.
    options: style, datum, tolerances.

    Raises
    ------
    PostError: anything the control or the machine could not execute; nothing is written then.
    """
    return write_programs(path, machine, options, Conversational(options))


POST = Post(
    suffix=".H",
    styles=tuple(_SWITCHES),
    write=write_conversational,
    splits=("none", "sweep", "tool"),
    own={"decimal": "point", "structure": "off", "radius": "off"},
)


class Conversational(Dialect):
    """Blocks of HEIDENHAIN's own language."""

    post = POST
    call = "CALL PGM"

    def __init__(self, options: ProgramOptions) -> None:
        # What is wrong with the options is said when the program is written.
        self.on, self.off = _SWITCHES.get(options.style, _TCPM)
        self.vectors = options.style == "ln"
        self.structured = own_option(POST, options, "structure", "off", "on") == "on"

    def structure(self, stretches: Sequence[Stretch]) -> Iterator[str]:
        """A structure block."""
        if self.structured:
            stretch = next((each for each in stretches if each.purpose in _CUTS), stretches[0])
            yield f"* - {stretch.purpose.name} {stretch.cut}"

    def opening(self, path: ToolPath) -> Iterator[str]:
        """Name and blank."""
        yield f"BEGIN PGM {path.name} MM"
        for corner, words in ((path.blank_low, "0.1 Z"), (path.blank_high, "0.2")):
            x, y, z = (signed(value) for value in corner)
            yield f"BLK FORM {words} X{x} Y{y} Z{z}"

    def tool_call(self, cutter: Cutter) -> str:
        """Tool and speed."""
        return f"TOOL CALL {cutter.number} Z S{short(cutter.spindle_rpm, 3)}"

    def datum(self, options: ProgramOptions) -> Iterator[str]:
        """Cycle 247 or 7."""
        if isinstance(options.datum, int):
            yield f"CYCL DEF 247 DATUM SETTING ~\r\n    Q339=+{options.datum} ;DATUM NUMBER"
        else:
            yield from _shift(*options.datum)

    def datum_reset(self) -> Iterator[str]:
        """Cycle 7."""
        yield from _shift(0.0, 0.0, 0.0)

    def tolerance(self, options: ProgramOptions, cutter: Cutter) -> Iterator[str]:
        """Cycle 32, for finishing."""
        yield "CYCL DEF 32.0 TOLERANCE"
        yield f"CYCL DEF 32.1 T{short(options.tolerance_mm)}"
        yield f"CYCL DEF 32.2 HSC-MODE:0 TA{short(rotary_tolerance(options, cutter))}"

    def tolerance_reset(self) -> Iterator[str]:
        """Cycle 32 without values."""
        yield from ("CYCL DEF 32.0 TOLERANCE", "CYCL DEF 32.1")

    def retract(self, machine: Machine) -> str:
        """Along the tool axis to the limit, or to a height of the machine."""
        if machine.retract_z_mm is None:
            return "L M140 MB MAX"
        return f"L Z{signed(machine.retract_z_mm)} R0 FMAX M91"

    def turn(self, words: str, start: bool) -> str:
        """Rotary axes at rapid."""
        return f"L {words} R0 FMAX" + (" M3" if start else "")

    def poses(self, ride: Ride) -> list[str]:
        """L with rotary words or LN with vectors."""
        if not self.vectors:
            return [f"L {words}" for words in rotary_words(ride)]
        poses = [f"LN {words}" for words in vector_words(ride)]
        if ride.upright:
            # A vector along Z would leave it to the control where the first rotary axis goes.
            poses[-1] = f"L {rotary_words(ride)[-1]}"
        return poses

    def first(self, pose: str) -> str:
        """At rapid, without compensation."""
        return f"{pose} R0 FMAX"

    def sided(self, pose: str, side: str) -> str:
        """After the coordinates."""
        return f"{pose} {side}"

    def rapid(self, pose: str) -> str:
        """FMAX holds for its block only."""
        return f"{pose} FMAX"

    def cut(self, pose: str, feed: int | None) -> str:
        """The feed is modal."""
        return pose if feed is None else f"{pose} F{feed}"

    def text(self, blocks: list[str]) -> list[str]:
        """Numbered from 0."""
        return [f"{number} {block}" for number, block in enumerate(blocks)]

    def closing(self, path: ToolPath) -> str:
        """The name again."""
        return f"END PGM {path.name} MM"


def _shift(x: float, y: float, z: float) -> Iterator[str]:
    yield "CYCL DEF 7.0 DATUM SHIFT"
    for line, (letter, value) in enumerate(zip("XYZ", (x, y, z), strict=True), start=1):
        yield f"CYCL DEF 7.{line} {letter}{signed(value)}"
