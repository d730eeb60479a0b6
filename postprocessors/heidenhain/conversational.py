"""Conversational programs (.H) for the HEIDENHAIN iTNC 530.

The order of a program, and why: a tool is called and the control brought to a known state (no TCPM, no tilted plane,
datum, tolerance) before anything moves; every positioning of the rotary axes happens fully retracted and without
TCPM; TCPM is on exactly from there to the end of the retract along the tool axis. The first move under TCPM goes by
rapid from the retracted position to the start of the approach; both ends lie above the plane through that start across
the tool axis, and so does the straight line between them. No X Y positioning precedes it: without TCPM, X and Y would
not mean part coordinates once a table has turned.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from math import degrees, floor, isfinite

import numpy as np
import numpy.typing as npt

from postprocessors.errors import PostError
from postprocessors.kinematics.two_rotary import SWING_LIMIT, Run, choose_words, swing
from postprocessors.machines.machine import Machine
from postprocessors.toolpath import Cutter, Operation, Purpose, Stretch, ToolPath

Array = npt.NDArray[np.float64]

NAME_PATTERN = r"[A-Z0-9_-]{1,16}"
DECIMALS = 4
"""Of coordinates (0.05 µm) and angles (0.04 µm at 50 mm)."""
COORDINATE_LIMIT = 99999.9999
FEED_LIMIT = 99999.0
SPINDLE_LIMIT = 99999.999
TOOL_LIMIT = 32767
BLOCK_LIMIT = 120
"""Characters in a block; the control's own limit is not published."""
BLANK_RATIO = 200.0
"""The control refuses blanks whose sides differ by this factor or more."""
UNIT_SLACK = 1e-6
"""Deviation of an axis vector's length from 1 that is taken for rounding."""
TA_STEP = 1e-4
"""Last digit of the rotary tolerance, degrees."""

TCPM_ON = "FUNCTION TCPM F TCP AXIS POS PATHCTRL VECTOR"
TCPM_OFF = "FUNCTION RESET TCPM"


@dataclass(frozen=True, slots=True)
class ProgramOptions:
    """How a program is to be written.

    Attributes
    ----------
    version: of the program that writes, for the header.
    style: "tcpm" (FUNCTION TCPM with rotary words).
    datum: preset number for cycle 247.
    coolant: "M7", "M8" or "none".
    tolerance_mm: T of cycle 32.
    tolerance_deg: TA of cycle 32; None derives it from T and the height of the cutter above its tip.
    """

    version: str
    style: str = "tcpm"
    datum: int = 1
    coolant: str = "M8"
    tolerance_mm: float = 0.002
    tolerance_deg: float | None = None


def rotary_tolerance(options: ProgramOptions, cutter: Cutter) -> float:
    """TA of cycle 32 in degrees: given, or the angle that moves the top of the flute by T, rounded down."""
    if options.tolerance_deg is not None:
        return options.tolerance_deg
    # The tip lies no more than r_min below the plane of r_min, where the flute's length begins.
    angle = degrees(options.tolerance_mm / (cutter.length + cutter.r_min))
    return max(floor(angle / TA_STEP) * TA_STEP, TA_STEP)


def write_program(path: ToolPath, machine: Machine, options: ProgramOptions) -> str:
    """The complete program: ASCII text, lines ended by CR LF.

    Parameters
    ----------
    path: what to cut, in program coordinates.
    machine: rotary axes, limits and retract.
    options: style, datum, tolerances.

    Raises
    ------
    PostError: anything the control or the machine could not execute; nothing is written then.
    """
    _check(path, options)
    cuts = [
        [list(stretches) for _, stretches in groupby(operation.stretches, key=lambda stretch: stretch.cut)]
        for operation in path.operations
    ]
    runs = [Run(_label(stretches), _unit_axes(stretches)) for cut in cuts for stretches in cut]
    words = choose_words(machine, runs)
    for run, chosen in zip(runs, words, strict=True):
        _check_swing(machine, run, chosen)

    blocks = [*_opening(path), *_facts(path, machine, options)]
    remaining = iter(words)
    for index, operation in enumerate(path.operations):
        blocks += _tool_call(operation, machine, options, first=index == 0)
        for number, stretches in enumerate(cuts[index]):
            blocks += _cut(stretches, next(remaining), machine, options, first=number == 0)
        if options.coolant != "none":
            blocks.append("M9")
        blocks.append("M5")
    blocks += ["CYCL DEF 32.0 TOLERANCE", "CYCL DEF 32.1", "M127", "M30", f"END PGM {path.name} MM"]
    lines = [f"{number} {block}" for number, block in enumerate(blocks)]
    _check_text(lines)
    return "\r\n".join(lines) + "\r\n"


# --- blocks ---------------------------------------------------------------------------------------------------------


def _opening(path: ToolPath) -> Iterator[str]:
    yield f"BEGIN PGM {path.name} MM"
    x, y, z = path.blank_low
    yield f"BLK FORM 0.1 Z X{_number(x)} Y{_number(y)} Z{_number(z)}"
    x, y, z = path.blank_high
    yield f"BLK FORM 0.2 X{_number(x)} Y{_number(y)} Z{_number(z)}"


def _facts(path: ToolPath, machine: Machine, options: ProgramOptions) -> Iterator[str]:
    """What an independent reader needs, one fact a line."""
    yield f"; CONFLANK {_plain(options.version)}"
    part, faces = _plain(path.part), list(path.faces)
    # A long list of faces continues in further lines of the same form.
    while True:
        room = BLOCK_LIMIT - 12 - len(f"; PART {part} FACE ")
        text, count = str(faces[0]), 1
        while count < len(faces) and len(text) + 1 + len(str(faces[count])) <= room:
            text += f",{faces[count]}"
            count += 1
        yield f"; PART {part} FACE {text}"
        faces = faces[count:]
        if not faces:
            break
    for cutter in _cutters(path):
        cone = f"R_MIN {_short(cutter.r_min)} R_MAX {_short(cutter.r_max)} LENGTH {_short(cutter.length)}"
        yield f"; TOOL {cutter.number} {_plain(cutter.name)} {cone}"
    yield "; REFERENCE TIP"
    yield f"; MACHINE {_plain(machine.name)}"
    yield f"; STYLE {options.style}"
    yield f"; FRAME {path.frame}"


def _tool_call(operation: Operation, machine: Machine, options: ProgramOptions, first: bool) -> Iterator[str]:
    cutter = operation.cutter
    yield f"TOOL CALL {cutter.number} Z S{_short(cutter.spindle_rpm, 3)}"
    yield TCPM_OFF
    yield "PLANE RESET STAY"
    if first:
        yield f"CYCL DEF 247 DATUM SETTING ~\r\n    Q339=+{options.datum} ;DATUM NUMBER"
    yield "CYCL DEF 32.0 TOLERANCE"
    yield f"CYCL DEF 32.1 T{_short(options.tolerance_mm)}"
    yield f"CYCL DEF 32.2 HSC-MODE:0 TA{_short(rotary_tolerance(options, cutter))}"
    yield _retract(machine)
    if first:
        # M126 takes the shorter way where a display is reduced to 0 .. 360; counted turns must be taken as written.
        yield "M126" if any(rotary.output == "modulo" for rotary in machine.rotary) else "M127"


def _retract(machine: Machine) -> str:
    if machine.retract_z_mm is None:
        return "L M140 MB MAX"
    return f"L Z{_number(machine.retract_z_mm)} R0 FMAX M91"


def _cut(
    stretches: list[Stretch], words: Array, machine: Machine, options: ProgramOptions, first: bool
) -> Iterator[str]:
    """One cut from the retracted position and back to it."""
    numbers, letters = _program_numbers(np.concatenate([stretch.tip for stretch in stretches]), words, machine)
    feeds = _feeds(np.concatenate([stretch.feed for stretch in stretches]), machine)
    position = "L X%+.4f Y%+.4f Z%+.4f {}%+.4f {}%+.4f".format(*letters)
    spindle = " M3" if first else ""
    yield f"L {letters[0]}{numbers[0, 3]:+.4f} {letters[1]}{numbers[0, 4]:+.4f} R0 FMAX{spindle}"
    yield TCPM_ON
    moved = np.r_[True, (numbers[1:] != numbers[:-1]).any(axis=1)]
    rows = numbers.tolist()
    number, modal = 0, -1
    for stretch in stretches:
        yield f"; {stretch.purpose.name} {stretch.cut}"
        for _ in range(len(stretch.tip)):
            if number == 0:
                yield position % tuple(rows[0]) + " R0 FMAX"
                if first and options.coolant != "none":
                    yield options.coolant
            elif not moved[number]:
                pass
            elif feeds[number] == 0:
                yield position % tuple(rows[number]) + " FMAX"
            elif feeds[number] == modal:
                yield position % tuple(rows[number])
            else:
                modal = feeds[number]
                yield position % tuple(rows[number]) + f" F{modal}"
            number += 1
    yield TCPM_OFF
    yield _retract(machine)


def _program_numbers(tip: Array, words: Array, machine: Machine) -> tuple[Array, list[str]]:
    """Coordinates and words as they are printed, (N, 5), and the letters of the last two columns in order."""
    # Adding zero turns -0 into +0.
    words = np.round(words, DECIMALS) + 0.0
    for column, rotary in enumerate(machine.rotary):
        if rotary.output == "modulo":
            words[:, column] = np.where(words[:, column] >= 360.0, words[:, column] - 360.0, words[:, column])
    letters = [rotary.letter for rotary in machine.rotary]
    order = sorted(range(2), key=lambda column: letters[column])
    return np.hstack([np.round(tip, DECIMALS) + 0.0, words[:, order]]), [letters[column] for column in order]


def _feeds(feed: Array, machine: Machine) -> list[int]:
    """Feeds as they are printed: whole mm/min, at least 1, at most what machine and control take; 0 means rapid."""
    limit = min(floor(machine.max_feed_mm_min), FEED_LIMIT)
    whole = np.where(feed > 0.0, np.clip(np.round(feed), 1.0, max(limit, 1.0)), 0.0)
    return [int(value) for value in whole]


# --- numbers and text -----------------------------------------------------------------------------------------------


def _number(value: float) -> str:
    """A coordinate: signed, as few decimals as it needs."""
    text = f"{round(value, DECIMALS) + 0.0:+.{DECIMALS}f}".rstrip("0").rstrip(".")
    return text


def _short(value: float, decimals: int = DECIMALS) -> str:
    """A positive number without trailing zeros."""
    return f"{value:.{decimals}f}".rstrip("0").rstrip(".")


def _plain(text: str) -> str:
    """Text that is safe in a comment: one word of printable ASCII (a tilde would continue the block)."""
    return re.sub(r"[^!-}]", "_", text)[:40] or "_"


def _label(stretches: list[Stretch]) -> str:
    kind = "pass" if any(stretch.purpose is Purpose.PASS for stretch in stretches) else "sweep"
    return f"{kind} {stretches[0].cut} with its approach"


def _cutters(path: ToolPath) -> list[Cutter]:
    """The tools in order of first use, each once."""
    return list(dict.fromkeys(operation.cutter for operation in path.operations))


def _unit_axes(stretches: list[Stretch]) -> Array:
    axis = np.concatenate([stretch.axis for stretch in stretches])
    return np.asarray(axis / np.linalg.norm(axis, axis=1, keepdims=True))


# --- checks ---------------------------------------------------------------------------------------------------------


def _check(path: ToolPath, options: ProgramOptions) -> None:
    """Refuse what the control would refuse."""
    if re.fullmatch(NAME_PATTERN, path.name) is None:
        expected = "1 to 16 characters A-Z 0-9 _ -"
        raise PostError("[program] name", f"'{path.name}'", expected, "Choose a name the control allows.")
    if options.style != "tcpm":
        raise PostError("[program] style", f"'{options.style}'", "'tcpm'", "Choose a style this post can write.")
    if options.coolant not in ("M7", "M8", "none"):
        raise PostError("[program] coolant", f"'{options.coolant}'", "M7, M8 or none", "Choose one of these.")
    if options.datum < 0:
        raise PostError("[program] datum", f"{options.datum}", "a preset number, 0 or more", "Choose a preset.")
    for key, value in (("t", options.tolerance_mm), ("ta", options.tolerance_deg)):
        if value is not None and not (isfinite(value) and value >= TA_STEP):
            expected = f"at least {TA_STEP:g}"
            raise PostError(f"[program] cycle32.{key}", f"{value}", expected, "The control knows four decimals.")
    if not path.operations or not path.faces:
        raise PostError("tool path", "no cut" if path.faces else "no face", "at least one", "Select sweeps first.")
    low, high = np.array(path.blank_low), np.array(path.blank_high)
    size = high - low
    if not np.isfinite(size).all() or size.min() <= 0.0 or size.max() >= BLANK_RATIO * size.min():
        expected = f"three finite sides that differ by less than a factor {BLANK_RATIO:g}"
        raise PostError("blank", f"sides {[float(side) for side in size]} mm", expected, "Enlarge the thin side.")
    _check_coordinates("blank", np.vstack([low, high]))
    numbers: dict[int, Cutter] = {}
    for operation in path.operations:
        _check_cutter(operation.cutter)
        known = numbers.setdefault(operation.cutter.number, operation.cutter)
        if known != operation.cutter:
            found = f"number {known.number} for {known.name} and {operation.cutter.name}"
            raise PostError("[tools]", found, "one number for each tool", "Give each tool its own number.")
        if not operation.stretches:
            raise PostError(f"tool {operation.cutter.name}", "no cut", "at least one", "Select sweeps first.")
        for stretch in operation.stretches:
            _check_stretch(stretch)


def _check_cutter(cutter: Cutter) -> None:
    where = f"[tools] {cutter.name}"
    if not 0 <= cutter.number <= TOOL_LIMIT:
        raise PostError(f"{where} number", f"{cutter.number}", f"0 .. {TOOL_LIMIT}", "Renumber the tool.")
    if not 0.0 < cutter.spindle_rpm <= SPINDLE_LIMIT:
        expected = f"above 0, up to {SPINDLE_LIMIT}"
        raise PostError(f"{where} spindle_rpm", f"{cutter.spindle_rpm}", expected, "Correct the speed.")


def _check_stretch(stretch: Stretch) -> None:
    where = f"{stretch.purpose.value} {stretch.cut}"
    count = len(stretch.tip)
    if (
        stretch.tip.shape != (count, 3)
        or stretch.axis.shape != (count, 3)
        or stretch.feed.shape != (count,)
        or not count
    ):
        found = f"shapes {stretch.tip.shape}, {stretch.axis.shape}, {stretch.feed.shape}"
        raise PostError(where, found, "(N, 3), (N, 3) and (N,) with N > 0", "Report this tool path.")
    sound = np.isfinite(stretch.tip).all(axis=1) & (np.abs(np.linalg.norm(stretch.axis, axis=1) - 1.0) <= UNIT_SLACK)
    sound &= np.isfinite(stretch.feed) & (stretch.feed >= 0.0)
    if not sound.all():
        pose = int(np.flatnonzero(~sound)[0])
        found = f"tip {stretch.tip[pose].tolist()}, axis {stretch.axis[pose].tolist()}, feed {stretch.feed[pose]}"
        expected = "finite numbers, an axis of length 1, a feed >= 0"
        raise PostError(f"{where}, pose {pose + 1}", found, expected, "Optimise the sweep again.")
    _check_coordinates(where, stretch.tip)


def _check_coordinates(where: str, points: Array) -> None:
    beyond = np.abs(points).max(axis=1) > COORDINATE_LIMIT
    if beyond.any():
        pose = int(np.flatnonzero(beyond)[0])
        expected = f"within +-{COORDINATE_LIMIT} mm"
        raise PostError(f"{where}, pose {pose + 1}", f"{points[pose].tolist()}", expected, "Check [part] scale.")


def _check_swing(machine: Machine, run: Run, words: Array) -> None:
    """Refuse steps over which the rotary axes would whip around, or turn by half a turn (either way is the shorter)."""
    if np.abs(words).max() > COORDINATE_LIMIT:
        found = f"a word of {np.abs(words).max():.0f} degrees"
        raise PostError(run.label, found, f"up to {COORDINATE_LIMIT}", "Use modulo output for the endless axis.")
    worst = swing(machine, run.axis, words)
    if len(worst) and worst.max() > SWING_LIMIT:
        step = int(worst.argmax())
        found = f"a step whose middle is {degrees(worst[step]):.3f} degrees off the way between its ends"
        expected = f"at most {degrees(SWING_LIMIT):.3f} degrees"
        where = f"{run.label}, pose {step + 2}"
        raise PostError(where, found, expected, "Space poses more closely there, or turn the part in [setup].")


def _check_text(lines: list[str]) -> None:
    for line in lines:
        if len(line) > BLOCK_LIMIT or not line.isascii():
            raise PostError("program text", f"'{line}'", f"at most {BLOCK_LIMIT} ASCII characters", "Shorten the name.")
