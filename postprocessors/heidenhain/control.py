"""What the HEIDENHAIN iTNC 530 takes: limits of words and names, and the refusal of what lies beyond them."""

from __future__ import annotations

import re
from math import degrees, floor, isfinite

import numpy as np
import numpy.typing as npt

from postprocessors.errors import PostError
from postprocessors.kinematics.two_rotary import SWING_LIMIT, Run, swing
from postprocessors.machines.machine import Machine
from postprocessors.path_checks import check_coordinates, check_cutters, check_path
from postprocessors.post import ProgramOptions
from postprocessors.toolpath import Cutter, ToolPath

Array = npt.NDArray[np.float64]

NAME_PATTERN = r"[A-Z0-9_-]{1,16}"
DECIMALS = 4
"""Of coordinates (0.05 µm) and angles (0.04 µm at 50 mm)."""
VECTOR_DECIMALS = 7
"""Of the components of a tool vector (0.003 µm at 50 mm)."""
COORDINATE_LIMIT = 99999.9999
FEED_LIMIT = 99999.0
SPINDLE_LIMIT = 99999.999
TOOL_LIMIT = 32767
BLOCK_LIMIT = 120
"""Characters in a block; the control's own limit is not published."""
BLANK_RATIO = 200.0
"""The control refuses blanks whose sides differ by this factor or more."""
TA_STEP = 1e-4
"""Last digit of the rotary tolerance, degrees."""


def rotary_tolerance(options: ProgramOptions, cutter: Cutter) -> float:
    """TA of cycle 32 in degrees: given, or the angle that moves the top of the flute by T, rounded down."""
    if options.tolerance_deg is not None:
        return options.tolerance_deg
    # The tip lies no more than r_min below the plane of r_min, where the flute's length begins.
    angle = degrees(options.tolerance_mm / (cutter.length + cutter.r_min))
    return max(floor(angle / TA_STEP) * TA_STEP, TA_STEP)


def check_program(path: ToolPath, options: ProgramOptions) -> None:
    """Refuse what the control would refuse, before anything is written."""
    check_name(path.name)
    for key, value in (("t", options.tolerance_mm), ("ta", options.tolerance_deg)):
        if value is not None and not (isfinite(value) and value >= TA_STEP):
            expected = f"at least {TA_STEP:g}"
            raise PostError(f"[program] cycle32.{key}", f"{value}", expected, "The control knows four decimals.")
    low, high = np.array(path.blank_low), np.array(path.blank_high)
    size = high - low
    if not np.isfinite(size).all() or size.min() <= 0.0 or size.max() >= BLANK_RATIO * size.min():
        expected = f"three finite sides that differ by less than a factor {BLANK_RATIO:g}"
        raise PostError("blank", f"sides {[float(side) for side in size]} mm", expected, "Enlarge the thin side.")
    check_coordinates("blank", np.vstack([low, high]), COORDINATE_LIMIT)
    if not isinstance(options.datum, int):
        check_coordinates("[program] datum", np.array([options.datum], dtype=np.float64), COORDINATE_LIMIT)
    check_path(path, COORDINATE_LIMIT)
    check_cutters(path, TOOL_LIMIT, SPINDLE_LIMIT)


def check_name(name: str) -> None:
    """Refuse a program name that the control, or its predecessors, would not take."""
    if re.fullmatch(NAME_PATTERN, name) is None:
        expected = "1 to 16 characters A-Z 0-9 _ -"
        raise PostError("[program] name", f"'{name}'", expected, "Choose a name the control allows.")


def check_swing(machine: Machine, run: Run, words: Array) -> None:
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


def check_text(lines: list[str]) -> None:
    """Refuse blocks that are too long, or characters the control does not have."""
    for line in lines:
        if len(line) > BLOCK_LIMIT or not line.isascii():
            raise PostError("program text", f"'{line}'", f"at most {BLOCK_LIMIT} ASCII characters", "Shorten the name.")
