"""Whether a program sets the control as its job asks: spindle, coolant, preset, tolerance cycle, compensation.

What a program does not set stays as the operator, the program before or the builder has left it. That is not known, so
it is a finding like a wrong value. A job with [program.foreign] answers for the preset, the coolant and the tolerance
cycle of a program from elsewhere where the program is silent; what it sets must agree all the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan, cos, degrees

import numpy as np
import numpy.typing as npt

from conflank_cli.job import Job
from conflank_cli.tool import Tool
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.program import Program, Setting

Flags = npt.NDArray[np.bool_]

_SAME_SPEED = 1e-6
"""Relative difference of spindle speeds that is rounding: programs carry three decimals."""

_LAST_DIGIT = 1e-4
"""T and TA have four decimals."""

_COOLANT = {"none": 0, "M7": 7, "M8": 8}


def disagreements(program: Program, job: Job, tools: Sequence[Tool | None]) -> list[Finding]:
    """A finding for everything that the program sets otherwise than the job asks, or does not set.

    Parameters
    ----------
    program: as it was read.
    job: what was asked.
    tools: the cutter of every tool call, None where it is not known.
    """
    feed = ~program.moves.rapid
    findings = _spindle(program, tools, feed) + _coolant(program, job, feed)
    if program.control:
        findings += _preset(program, job)
        findings += _plane(program, job)
        findings += _tolerance(program, job, tools, feed)
        findings += _sides(program, job)
    return findings


def _first(program: Program, wrong: Flags, code: str, text: str) -> list[Finding]:
    """One finding for all moves (N,) that are wrong, at the first of them."""
    where = np.flatnonzero(wrong)
    if not len(where):
        return []
    within = program.moves.program(int(where[0]))
    return [
        Finding(
            code,
            text + (f", in {within}" if within else ""),
            int(program.moves.block[where[0]]),
            count=len(where),
        )
    ]


def _spindle(program: Program, tools: Sequence[Tool | None], feed: Flags) -> list[Finding]:
    moves = program.moves
    speed = moves.spindle
    findings = _first(program, feed & (speed == 0.0), "CF114", "feed move while the spindle stands")
    findings += _first(program, feed & (speed < 0.0), "CF114", "feed move while the spindle turns the wrong way (M4)")
    findings += _first(program, feed & np.isnan(speed), "CF114", "feed move at a spindle speed that is not known")
    for call, tool in enumerate(tools):
        if tool is None:
            continue
        own = feed & (moves.tool == call) & (speed > 0.0)
        other = own & (np.abs(speed - tool.spindle_rpm) > _SAME_SPEED * tool.spindle_rpm)
        if other.any():
            text = f"S{speed[other][0]:g} where the job has {tool.spindle_rpm:g} 1/min for {tool.name}"
            findings += _first(program, other, "CF114", text)
    return findings


def _coolant(program: Program, job: Job, feed: Flags) -> list[Finding]:
    asked = _COOLANT[job.program.coolant]
    if job.program.foreign is not None or asked == 0:
        return []
    cutting = feed & (program.moves.cut >= 0)
    text = f"cutting move without the coolant of the job ({job.program.coolant})"
    return _first(program, cutting & (program.moves.coolant != asked), "CF121", text)


def _in_force(settings: Sequence[Setting], count: int) -> npt.NDArray[np.int64]:
    """For each of `count` moves the index of the setting that holds, -1 before the first."""
    places = np.array([setting.before for setting in settings], dtype=np.int64)
    return np.asarray(np.searchsorted(places, np.arange(count), side="right") - 1)


def _preset(program: Program, job: Job) -> list[Finding]:
    asked = job.program.datum
    count = len(program.moves.block)
    if not isinstance(asked, int):
        if program.presets:
            text = "the program sets a preset; the job shifts the datum from the one that is active"
            return [Finding("CF118", text, program.presets[0].block)]
        return []
    held = _in_force(program.presets, count)
    if job.program.foreign is None:
        text = f"no preset is set; the job has number {asked} (cycle 247)"
        findings = _first(program, held < 0, "CF118", text)
    else:
        findings = []
    other = np.array([setting.value != asked for setting in program.presets], dtype=np.bool_)
    if other.any():
        values = [setting.value for setting in program.presets if setting.value != asked]
        text = f"preset {values[0] if values[0] is not None else 'not known'} where the job has number {asked}"
        wrong = (held >= 0) & other[np.maximum(held, 0)]
        found = _first(program, wrong, "CF118", text)
        # One that no known move comes after is none the less wrong: it stays when the program has ended.
        findings += found or [Finding("CF118", text, program.presets[int(np.flatnonzero(other)[0])].block)]
    return findings


def _plane(program: Program, job: Job) -> list[Finding]:
    if job.program.foreign is not None:
        return []
    held = _in_force(program.tilts, len(program.moves.block))
    text = "the working plane is neither reset nor tilted: one that an earlier program has tilted stays so"
    return _first(program, held < 0, "CF118", text)


def _tolerance(program: Program, job: Job, tools: Sequence[Tool | None], feed: Flags) -> list[Finding]:
    cycle = job.program.cycle32
    held = _in_force(program.tolerances, len(feed))
    findings: list[Finding] = []
    unset = feed & (held < 0)
    for index, setting in enumerate(program.tolerances):
        own = feed & (held == index)
        if not isinstance(setting.value, tuple):
            unset |= own
            continue
        t, ta = setting.value
        if t > cycle.t + 0.5 * _LAST_DIGIT:
            findings += _first(program, own, "CF117", f"cycle 32 with T{t:g} where the job has {cycle.t:g} mm")
        for call, tool in enumerate(tools):
            most = _rotary_tolerance(job, tool)
            mine = own & (program.moves.tool == call)
            if ta is None or (most is not None and ta > most + 0.5 * _LAST_DIGIT):
                given = "without TA" if ta is None else f"with TA{ta:g}"
                allowed = "" if most is None else f" where the job has {most:.4f} degrees"
                findings += _first(program, mine, "CF117", f"cycle 32 {given}{allowed}")
    if not (job.program.foreign is not None and not program.tolerances):
        findings += _first(program, unset, "CF117", "feed move with the tolerance that the builder has set (cycle 32)")
    return findings


def _rotary_tolerance(job: Job, tool: Tool | None) -> float | None:
    """Most that TA may be, degrees: given, or the angle that moves the top of the flute by T."""
    if job.program.cycle32.ta is not None or tool is None:
        return job.program.cycle32.ta
    # The flute reaches from the lowest point of the ball to the large end of the cone.
    alpha = atan((tool.r_max - tool.r_min) / tool.length)
    ball = tool.r_min / cos(alpha)
    height = tool.length + ball - np.sqrt(max(ball**2 - tool.r_min**2, 0.0))
    return float(degrees(job.program.cycle32.t / height))


def _sides(program: Program, job: Job) -> list[Finding]:
    used = [setting for setting in program.sides if setting.value != "R0"]
    if not used or job.program.foreign is not None or job.program.options.get("radius") == "on":
        return []
    text = f"radius compensation {used[0].value}, which the job does not ask for ([program] options.radius)"
    return [Finding("CF110", text, used[0].block, count=len(used))]
