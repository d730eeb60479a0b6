"""A program with its poses on the part: tools, frame and reference point found for what the text says."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from conflank_cli.scene import Scene
from conflank_cli.tool import Tool
from conflank_cli.verification import pattern
from conflank_cli.verification.agreement import disagreements
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.kinematics import Frame
from conflank_cli.verification.machine import MachineModel, machine_of
from conflank_cli.verification.poses import Poses, poses_on_part
from conflank_cli.verification.program import Program
from conflank_cli.verification.reader import read_program
from conflank_cli.verification.standing import Standing
from conflank_cli.verification.travel import out_of_range, out_of_travel
from conflank_cli.verification.ways import Mounted, Ways, follow_ways

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

_SAME_FRAME = 1e-3
"""Frames that differ by less than this are the same, mm or degrees: the header gives four decimals."""


_SAME_TOOL = 1e-3
"""Cutters whose sizes differ by less than this are the same, mm."""

_SAME_DIRECTION = 1e-6
"""Directions of a rotary axis that differ by less than this are the same: the header gives twelve decimals."""

_COMMENT = re.compile(r";.*|\([^)\n]*\)")


@dataclass(frozen=True, slots=True)
class PosedProgram:
    """A program with the poses on the part that follow from its text.

    Attributes
    ----------
    program: the text, read; `unknown_moves` are those that are neither followed nor proven free.
    tools: the cutter of every tool call, None where it is not known.
    poses: all poses, in the CAD frame, those that stand for ways off the part among them.
    rotary: positions of the machine's rotary axes at all poses, (N, 2) radians, in the machine's order; NaN where they
        are not known.
    machine: the job's machine.
    by_copy: the same as each copy in the job's [setup] sees them, turned back to the first.
    findings: what is wrong or unknown so far.
    """

    program: Program
    tools: tuple[Tool | None, ...]
    poses: Poses
    rotary: Array
    machine: MachineModel
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
        if len(stated) > 1:
            findings.append(
                Finding("CF109", f"{label} is stated more than once in the header, and differently", call.block)
            )
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


def _contradictions(program: Program, scene: Scene, machine: MachineModel) -> list[Finding]:
    """What the header states of machine, part and faces, and the job knows otherwise."""
    header = program.header
    texts = []
    if header.machine is not None and header.machine != machine.name:
        texts.append(f"the header names the machine {header.machine}, the job's is {machine.name}")
    stated = {axis.letter: np.array(axis.direction) for axis in header.rotary}
    if stated and "".join(stated) != machine.letters:
        texts.append(f"the header states the rotary axes {' '.join(stated)}, the job's machine has {machine.letters}")
    for axis in machine.rotary:
        own = stated.get(axis.letter)
        if own is None or np.linalg.norm(own) == 0.0:
            continue
        if np.abs(own / np.linalg.norm(own) - np.array(axis.direction)).max() > _SAME_DIRECTION:
            texts.append(f"the header states another direction of axis {axis.letter} than the job's machine has")
    if header.part is not None and header.part != _as_stated(scene.part_name):
        texts.append(f"the header names the part {header.part}, the job's is {scene.part_name}")
    numbers = [face.number for face in scene.faces]
    if other := [face for face in header.faces if face not in numbers]:
        texts.append(f"the header names face {other[0]}, the job's design faces are {', '.join(map(str, numbers))}")
    return [Finding("CF110", text) for text in texts]


def _as_stated(name: str) -> str:
    """A name as comments carry it: one word of printable ASCII."""
    return re.sub(r"[^!-}]", "_", name)[:40] or "_"


def _by_machine(program: Program, machine: MachineModel) -> Program:
    """The program with positions of the job's machine at every move, in its order, NaN where a vector tells them."""
    moves, rotary = program.moves, program.moves.rotary
    turned = any(value for move in program.unknown for letter, value in move.words.items() if letter in machine.letters)
    if not turned and np.all(moves.vector == [0.0, 0.0, 1.0]):
        # Nothing turns any axis: they stand at zero.
        rotary = np.zeros_like(rotary)
    return replace(program, letters=machine.axes, moves=replace(moves, rotary=rotary))


def _named(texts: list[str], letters: str) -> frozenset[str]:
    """Those of the rotary letters that stand with a value anywhere in the text of programs, comments aside."""
    plain = [_COMMENT.sub("", text.upper()) for text in texts]
    words = {letter: re.compile(rf"(?<![A-Z_])I?{letter}(?=[+-]?[\d.,Q])") for letter in letters}
    return frozenset(letter for letter, word in words.items() if any(word.search(text) for text in plain))


def _lengths(tools: list[Tool | None], gauge: Mapping[str, float]) -> tuple[float | None, ...]:
    """Length from tip to nose of the tool of every call, mm."""
    return tuple(None if tool is None else gauge.get(tool.name) for tool in tools)


def pose_program(text: str, scene: Scene, called: Callable[[str], str | None] | None = None) -> PosedProgram:
    """Read a program and find the cutter's poses on the part; what the text does not say comes from the scene's job.

    Parameters
    ----------
    text, scene, called: as `verify_program`.

    Raises
    ------
    InputError: the job's machine cannot be read.
    """
    machine = machine_of(scene.job.machine)
    program = read_program(text, called, machine.axes, machine.harmless)
    findings = list(program.findings)
    tools, found = _tools_of(program, scene)
    findings += found
    frame, found = _frame_of(program, scene)
    findings += [*found, *_contradictions(program, scene, machine), *disagreements(program, scene.job, tools)]
    reference, foreign = program.header.reference, scene.job.program.foreign
    if reference is None and foreign is not None:
        reference = foreign.reference.upper()
        program = replace(program, header=replace(program.header, reference=reference))
    elif reference is None:
        findings.append(Finding("CF107", "the header does not state the reference point; judged as REFERENCE TIP"))
    centre = reference == "SPHERE CENTRE"
    below = tuple(0.0 if tool is None or not centre else tool.ball_radius for tool in tools)
    program = _by_machine(program, machine)
    zero, lengths = scene.job.machine.zero, _lengths(tools, scene.job.machine.gauge_length)
    mounted = Mounted(
        machine=machine,
        standing=Standing.of(scene, frame),
        tools=tuple(tools),
        zero=None if zero is None else np.array(zero),
        lengths=lengths,
        below=below,
        named=_named([text, *(part.text for part in program.called)], machine.letters),
        no_machine=not program.control,
    )
    ways = follow_ways(program, mounted)
    program = replace(
        program, moves=ways.moves, unknown=ways.unknown, events=ways.events, unknown_moves=ways.unknown_moves
    )
    findings += [*ways.findings, *_out_of_reach(ways, mounted)]
    moves = program.moves
    below_point = np.array([*below, 0.0])[moves.tool]
    poses = poses_on_part(moves, program.letters, frame, below_point)
    by_copy = tuple(
        poses_on_part(moves, program.letters, replace(frame, turned=turn), below_point)
        for turn in pattern.turns(scene.job.setup.copies)
    )
    return PosedProgram(program, tuple(tools), poses, ways.rotary, machine, by_copy, tuple(findings))


def _out_of_reach(ways: Ways, mounted: Mounted) -> list[Finding]:
    """Axes that would have to leave their ranges, and, where it is known how all is mounted, their travels."""
    machine, moves = mounted.machine, ways.moves
    findings = list(out_of_range(machine, ways))
    if mounted.zero is not None and any(length is not None for length in mounted.lengths):
        lengths = np.array([*(np.nan if length is None else length for length in mounted.lengths), np.nan])[moves.tool]
        axis = np.where(np.isfinite(moves.vector), moves.vector, machine.tool_axis(ways.rotary))
        tip = moves.point - np.array([*mounted.below, 0.0])[moves.tool][:, None] * axis
        findings += out_of_travel(machine, ways, tip, mounted.zero, lengths)
    return findings
