"""The swept gap of a posted program, point by point on a parameter grid: what the pictures show.

Only the program's text and the trimmed faces go in; reading, kinematics and the search for the least distance are those
of the verification.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.face import DesignFace
from conflank_cli.tool import Tool
from conflank_cli.verification.gap import cutting_body, nearest
from conflank_cli.verification.kinematics import Frame
from conflank_cli.verification.poses import Poses, build_cells, poses_on_part
from conflank_cli.verification.program import Interpolation, Program
from conflank_cli.verification.reader import read_program
from conflank_cli.verification.sampling import evaluate_grid, inside_rows

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

REACH = 0.5
"""mm; where every cut stays further away than this the gap is not computed: it is stock, however much."""


@dataclass(frozen=True, slots=True)
class PostedProgram:
    """A program as the verification reads it.

    Attributes
    ----------
    program: the text, read.
    tools: the cutter of each tool call.
    poses: all poses, in the CAD frame.
    sweeps: which of the program's cuts are sweeps, in their order.
    """

    program: Program
    tools: tuple[Tool, ...]
    poses: Poses
    sweeps: tuple[int, ...]

    @classmethod
    def of(cls, text: str) -> PostedProgram:
        """Read a program whose header states its tools and frame and that programs the tip, as our own do."""
        program = read_program(text)
        stated = {tool.number: tool for tool in program.header.tools}
        tools = []
        for call in program.tool_calls:
            if call.number is None:
                raise ValueError(f"block {call.block} calls a tool without a number")
            own = stated[call.number]
            tools.append(Tool(own.name, own.r_min, own.r_max, own.length, number=own.number))
        frame = program.header.frame or Frame((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        poses = poses_on_part(program.moves, program.letters, frame, np.zeros(len(program.moves.block)))
        sweeps = tuple(k for k, cut in enumerate(program.cuts) if cut.kind == "sweep")
        return cls(program, tuple(tools), poses, sweeps)

    def sweep_poses(self, sweep: int) -> tuple[Tool, Array, Array]:
        """The tool of a sweep (counted from 0), and its tip points and axes in the CAD frame, (N, 3) each."""
        chosen = np.flatnonzero(self.poses.moves.cut == self.sweeps[sweep])
        return self.tools[int(self.poses.moves.tool[chosen[0]])], self.poses.tip[chosen], self.poses.axis[chosen]


@dataclass(frozen=True, slots=True)
class GapMap:
    """The swept gap on one face.

    Attributes
    ----------
    face: the face.
    u, v: parameters of the grid, (U,), (V,).
    points, normals: (U, V, 3) mm and unit, normals towards the cutter.
    inside: (U, V), whether a grid point is on the trimmed face.
    gap: (U, V) mm, inf beyond `REACH`; the worse of both ways in which the axis may go between two blocks.
    by_sweep: (sweeps, U, V), the same for each sweep alone.
    """

    face: DesignFace
    u: Array
    v: Array
    points: Array
    normals: Array
    inside: Flags
    gap: Array
    by_sweep: Array

    def covered(self, over: float, under: float) -> Flags:
        """Where the gap is within tolerance (mm), on the trimmed face."""
        return np.asarray(self.inside & (self.gap >= -over) & (self.gap <= under))


def gap_map(posted: PostedProgram, face: DesignFace, shape: tuple[int, int]) -> GapMap:
    """Swept gap of a program on a grid of `shape` over the box of the face's trim loops."""
    corners = np.concatenate(face.loops)
    u, v = (np.linspace(corners[:, k].min(), corners[:, k].max(), shape[k]) for k in (0, 1))
    points, by_u, by_v = evaluate_grid(face.surface, u, v)
    normals = face.sense * np.cross(by_u, by_v)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    # Grid points on the border belong to the face: the rule decides for points just inside of them.
    middle_u, middle_v = 0.5 * (u[0] + u[-1]), 0.5 * (v[0] + v[-1])
    inside = inside_rows(face.loops, middle_u + (u - middle_u) * (1.0 - 1e-6), middle_v + (v - middle_v) * (1.0 - 1e-6))
    gap, by_sweep = _gaps(posted, points.reshape(-1, 3))
    return GapMap(face, u, v, points, normals, inside, gap.reshape(shape), by_sweep.reshape(-1, *shape))


def _gaps(posted: PostedProgram, points: Array) -> tuple[Array, Array]:
    """Gap of points (N, 3): over the whole program (N,), and by sweep (sweeps, N)."""
    moves = posted.poses.moves
    modes = (Interpolation.VECTOR, Interpolation.AXIS)
    whole = np.full((len(modes), len(points)), np.inf)
    by_cut = np.full((len(modes), len(posted.program.cuts), len(points)), np.inf)
    for call, cut in sorted(set(zip(moves.tool.tolist(), moves.cut.tolist(), strict=True))):
        if call < 0:
            continue
        chosen = np.flatnonzero((moves.tool == call) & (moves.cut == cut))
        for row, mode in enumerate(modes):
            found = nearest(points, build_cells(posted.poses, chosen, mode), cutting_body(posted.tools[call]), REACH)
            distance = np.where(found.move >= 0, found.distance, np.inf)
            whole[row] = np.minimum(whole[row], distance)
            if cut >= 0:
                by_cut[row, cut] = np.minimum(by_cut[row, cut], distance)
    return _worse(whole), _worse(by_cut)[list(posted.sweeps)]


def _worse(values: Array) -> Array:
    """Of the values along the first axis the one that is further from zero."""
    return np.asarray(np.take_along_axis(values, np.abs(values).argmax(axis=0)[None], axis=0)[0])
