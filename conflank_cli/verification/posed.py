"""A program with its poses on the part: tools, frame and reference point found for what the text says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from conflank_cli.scene import Scene
from conflank_cli.tool import Tool
from conflank_cli.verification import pattern
from conflank_cli.verification.agreement import disagreements
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.kinematics import Frame
from conflank_cli.verification.poses import Poses, poses_on_part
from conflank_cli.verification.program import Program
from conflank_cli.verification.reader import read_program

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_SAME_FRAME = 1e-3
"""Frames that differ by less than this are the same, mm or degrees: the header gives four decimals."""


_SAME_TOOL = 1e-3
"""Cutters whose sizes differ by less than this are the same, mm."""


@dataclass(frozen=True, slots=True)
class PosedProgram:
    """A program with the poses on the part that follow from its text.

    Attributes
    ----------
    program: the text, read.
    tools: the cutter of every tool call, None where it is not known.
    poses: all poses, in the CAD frame.
    by_copy: the same as each copy in the job's [setup] sees them, turned back to the first.
    findings: what is wrong or unknown so far.
    """

    program: Program
    tools: tuple[Tool | None, ...]
    poses: Poses
    by_copy: tuple[Poses, ...]
    findings: tuple[Finding, ...]


def _tools_of(program: Program, scene: Scene) -> tuple[list[Tool | None], list[Finding]]:
    """The cutter of every tool call: sizes from the program's header, shank and holder from the job's drawer."""
    tools: list[Tool | None] = []
    findings: list[Finding] = []
    for call in program.tool_calls:
        stated = [
            tool
            for tool in program.header.tools
            if tool.number == call.number or (call.name is not None and tool.name == call.name)
        ]
        drawer = [
            tool
            for tool in scene.tools
            if (tool.name == stated[0].name if stated else tool.number == call.number or tool.name == call.name)
        ]
        called = call.name if call.number is None else str(call.number)
        label = f"tool {called}"
        foreign = scene.job.program.foreign
        if not stated and foreign is not None:
            wanted = foreign.tools.get(called or "")
            meant = [tool for tool in scene.tools if tool.name == wanted] if wanted else drawer
            if len(meant) == 1:
                tools.append(meant[0])
                continue
        if not stated:
            text = f"{label} is not stated in the header (; TOOL n name R_MIN .. R_MAX .. LENGTH ..)"
            if len(drawer) == 1:
                text += f"; judged with {drawer[0].name} of the job"
            findings.append(Finding("CF103", text, call.block))
            tools.append(drawer[0] if len(drawer) == 1 else None)
            continue
        size = stated[0]
        if not (0.0 < size.r_min <= size.r_max and size.length > 0.0):
            findings.append(Finding("CF109", f"{label}: R_MIN, R_MAX and LENGTH make no cutter", call.block))
            tools.append(None)
            continue
        if not drawer:
            findings.append(
                Finding("CF110", f"{label} {size.name} is not in the job: its shank and holder are unknown", call.block)
            )
            tools.append(Tool(size.name, size.r_min, size.r_max, size.length, number=size.number))
            continue
        own = drawer[0]
        if (
            max(abs(own.r_min - size.r_min), abs(own.r_max - size.r_max), abs(own.length - size.length)) > _SAME_TOOL
            or scene.job.program.tool_numbers.get(own.name, own.number) != size.number
        ):
            findings.append(
                Finding("CF110", f"{label} {size.name} is another than the job's tool of that name", call.block)
            )
        tools.append(replace(own, r_min=size.r_min, r_max=size.r_max, length=size.length, number=size.number))
    return tools, findings


def _frame_of(program: Program, scene: Scene) -> tuple[Frame, list[Finding]]:
    """The frame the header states; without it the job's, and a finding."""
    setup = scene.job.setup
    own = Frame(setup.rotate_deg, setup.translate)
    stated = program.header.frame
    if stated is None and scene.job.program.foreign is not None:
        return own, []
    if stated is None:
        text = "the frame is not stated in the header (; FRAME ..); judged in the frame of the job's [setup]"
        return own, [Finding("CF104", text)]
    off = max(
        float(np.degrees(np.abs(stated.matrix - own.matrix)).max()),
        float(np.abs(np.subtract(stated.translate, own.translate)).max()),
    )
    if off > _SAME_FRAME:
        return stated, [Finding("CF110", "the header's frame is another than the job's [setup]", None, None, off)]
    return stated, []


def pose_program(text: str, scene: Scene, called: Callable[[str], str | None] | None = None) -> PosedProgram:
    """Read a program and find the cutter's poses on the part; what the text does not say comes from the scene's job.

    Parameters
    ----------
    text, scene, called: as `verify_program`.
    """
    program = read_program(text, called)
    findings = list(program.findings)
    tools, found = _tools_of(program, scene)
    findings += found
    frame, found = _frame_of(program, scene)
    findings += found
    reference, foreign = program.header.reference, scene.job.program.foreign
    if reference is None and foreign is not None:
        reference = foreign.reference.upper()
    elif reference is None:
        findings.append(Finding("CF107", "the header does not state the reference point; judged as REFERENCE TIP"))
    findings += disagreements(program, scene.job, tools)
    moves = program.moves
    below = np.zeros(len(moves.block))
    if reference == "SPHERE CENTRE":
        radii = np.array([0.0 if tool is None else tool.ball_radius for tool in tools] + [0.0])
        below = radii[moves.tool]
    poses = poses_on_part(moves, program.letters, frame, below)
    copies = scene.job.setup.copies
    by_copy = tuple(
        poses_on_part(moves, program.letters, replace(frame, turned=turn), below) for turn in pattern.turns(copies)
    )
    return PosedProgram(program, tuple(tools), poses, by_copy, tuple(findings))
