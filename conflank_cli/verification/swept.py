"""The swept gap of a program: at every point the least distance to the cutting body over all poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.once import Once
from conflank_cli.tool import Tool
from conflank_cli.verification.gap import (
    BodyMotion,
    EitherMotion,
    cutting_body,
    spatial_order,
)
from conflank_cli.verification.posed import PosedProgram
from conflank_cli.verification.poses import Cells, Poses, axis_between, build_cells, join_cells
from conflank_cli.verification.program import Interpolation

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

REACH = 0.5
"""Gaps of single cuts are exact up to this, mm; beyond it a cut has nothing to do with a point."""


_SAME_WAY = 1e-5
"""Ways of the axis that nowhere differ by more than this are one, mm at the far end of the cutter: 0.01 um."""


@dataclass(frozen=True, slots=True)
class CutMoves:
    """All moves of one cut with one tool, or those outside any cut (cut -1)."""

    tool: Tool
    cut: int
    cells: tuple[Cells, ...]


@dataclass(frozen=True, slots=True)
class SweptGap:
    """Gap at N points: in all, with the move and share it occurs at; by each cut, with the move; without the passes."""

    gap: Array
    move: Integers
    share: Array
    by_cut: Array
    move_by_cut: Integers
    flank: Array

    def only(self, part: slice | Integers) -> SweptGap:
        """The gap at some of the points."""
        return SweptGap(
            self.gap[part], self.move[part], self.share[part], self.by_cut[:, part], self.move_by_cut[:, part],
            self.flank[part],
        )  # fmt: skip

    def then(self, other: SweptGap) -> SweptGap:
        """The gap at these points and then at others."""
        return SweptGap(
            np.concatenate([self.gap, other.gap]),
            np.concatenate([self.move, other.move]),
            np.concatenate([self.share, other.share]),
            np.concatenate([self.by_cut, other.by_cut], axis=1),
            np.concatenate([self.move_by_cut, other.move_by_cut], axis=1),
            np.concatenate([self.flank, other.flank]),
        )


def _same_axis_way(poses: Poses, move: Integers, height: float) -> bool:
    """Whether both interpolations agree on all the given moves, at a height above the tip."""
    ways = [
        axis_between(poses, move, np.full(len(move), share), Interpolation.AXIS)
        - axis_between(poses, move, np.full(len(move), share), Interpolation.VECTOR)
        for share in (0.25, 0.5, 0.75)
    ]
    return max(float(np.linalg.norm(way, axis=1).max(initial=0.0)) for way in ways) * height < _SAME_WAY


def moves_by_cut(poses: Poses, tools: list[Tool | None], owned: npt.NDArray[np.bool_] | None = None) -> list[CutMoves]:
    """The moves by tool and cut; only those in `owned` (N,) if it is given."""
    moves = poses.moves
    result = []
    for call, cut in sorted(set(zip(moves.tool.tolist(), moves.cut.tolist(), strict=True))):
        tool = tools[call] if call >= 0 else None
        if tool is None:
            continue
        chosen = np.flatnonzero((moves.tool == call) & (moves.cut == cut) & (True if owned is None else owned))
        if not len(chosen):
            continue
        modes = [Interpolation.VECTOR]
        if not _same_axis_way(poses, chosen, tool.length - tool.tip_height):
            modes.append(Interpolation.AXIS)
        result.append(CutMoves(tool, cut, tuple(build_cells(poses, chosen, mode) for mode in modes)))
    return result


def by_tool(stretches: list[CutMoves]) -> list[CutMoves]:
    """All moves of each tool as one stretch: one search over everything is quicker than one for every cut."""
    result = []
    for tool in dict.fromkeys(stretch.tool for stretch in stretches):
        own = [stretch for stretch in stretches if stretch.tool == tool]
        modes = max(len(stretch.cells) for stretch in own)
        chosen = [[stretch.cells[min(mode, len(stretch.cells) - 1)] for stretch in own] for mode in range(modes)]
        result.append(CutMoves(tool, -1, tuple(join_cells(cells) for cells in chosen)))
    return result


@dataclass(frozen=True, slots=True)
class SweptMotions:
    """The motions of all cuts of a program, made ready to be asked for gaps again and again.

    Attributes
    ----------
    stretches: what they are made of.
    kinds: of each cut, "sweep" or "pass".
    cutting: of each stretch the cutting body in each of the motions that the program may mean.
    together: all stretches of each tool as one, for what is far; made when first asked for.
    """

    stretches: tuple[CutMoves, ...]
    kinds: tuple[str, ...]
    cutting: tuple[EitherMotion, ...]
    together: Once[tuple[tuple[BodyMotion, ...], ...]]

    @classmethod
    def of(cls, stretches: Sequence[CutMoves], kinds: Sequence[str]) -> SweptMotions:
        """Prepare moves by cut; `kinds` has what each cut is."""
        stretches = tuple(stretches)

        def together() -> tuple[tuple[BodyMotion, ...], ...]:
            return tuple(
                tuple(BodyMotion.of(cells, cutting_body(each.tool)) for cells in each.cells)
                for each in by_tool(list(stretches))
            )

        cutting = tuple(EitherMotion.of(each.cells, cutting_body(each.tool)) for each in stretches)
        return cls(stretches, tuple(kinds), cutting, Once(together))

    def gap(self, points: Array) -> SweptGap:
        """The gap at points (N, 3), worse of the two interpolations at every point and for every cut."""
        count = len(points)
        modes = max((len(stretch.cells) for stretch in self.stretches), default=1)
        gaps = np.full((modes, count), np.inf)
        flanks = np.full((modes, count), np.inf)
        moves = np.full((modes, count), -1, dtype=np.int64)
        shares = np.zeros((modes, count))
        by_cut = np.full((modes, len(self.kinds), count), np.inf)
        move_by_cut = np.full((len(self.kinds), count), -1, dtype=np.int64)
        order = spatial_order(points)
        ordered = np.ascontiguousarray(points[order])
        within = np.full(count, REACH)
        found = [motion.below(ordered, within) for motion in self.cutting]
        for mode in range(modes):
            for stretch, either in zip(self.stretches, found, strict=True):
                own = either[min(mode, len(either) - 1)]
                hit = order[own.chosen]
                if stretch.cut >= 0:
                    nearer = own.distance < by_cut[mode, stretch.cut, hit]
                    by_cut[mode, stretch.cut, hit[nearer]] = own.distance[nearer]
                    move_by_cut[stretch.cut, hit[nearer]] = own.move[nearer]
                if stretch.cut < 0 or self.kinds[stretch.cut] == "sweep":
                    flanks[mode, hit] = np.minimum(flanks[mode, hit], own.distance)
                nearer = own.distance < gaps[mode, hit]
                hit = hit[nearer]
                gaps[mode, hit], moves[mode, hit], shares[mode, hit] = (
                    own.distance[nearer], own.move[nearer], own.share[nearer],
                )  # fmt: skip
            # Beyond the reach of every cut the gap is still a figure of its own: how much stock stands there.
            far = order[~np.isfinite(gaps[mode, order])]
            for motions in self.together() if len(far) else ():
                own = motions[min(mode, len(motions) - 1)].below(points[far], gaps[mode, far])
                hit = far[own.chosen]
                gaps[mode, hit], moves[mode, hit], shares[mode, hit] = own.distance, own.move, own.share

        def worse(values: Array) -> Array:
            return np.asarray(np.take_along_axis(values, np.abs(values).argmax(axis=0)[None], axis=0)[0])

        pick = np.abs(gaps).argmax(axis=0)[None]
        return SweptGap(
            gap=np.take_along_axis(gaps, pick, axis=0)[0],
            move=np.take_along_axis(moves, pick, axis=0)[0],
            share=np.take_along_axis(shares, pick, axis=0)[0],
            by_cut=worse(by_cut),
            move_by_cut=move_by_cut,
            flank=worse(flanks),
        )


def gaps_of(posed: PosedProgram, points: Array) -> tuple[Array, Array]:
    """Swept gap at points (N, 3), as it is judged: of all the program (N,), and of each of its cuts (cuts, N), mm.

    The gap of a cut is inf where it comes no nearer than `REACH`. Where there are copies the worst of them counts.
    """
    kinds = [cut.kind for cut in posed.program.cuts]
    swept = [SweptMotions.of(moves_by_cut(poses, list(posed.tools)), kinds).gap(points) for poses in posed.by_copy]
    every = np.stack([each.gap for each in swept])
    worst = np.take_along_axis(every, np.abs(every).argmax(axis=0)[None], axis=0)[0]
    # A cut is made for one of the copies, and far from the others.
    return np.asarray(worst), np.min([each.by_cut for each in swept], axis=0)
