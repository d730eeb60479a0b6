"""Tables of a program as CSV: a heading with units, a row each, full precision, decimal points."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence

import numpy as np
from msgspec.structs import asdict

from conflank_cli.scene import Scene
from conflank_cli.verification.axes import drive
from conflank_cli.verification.posed import PosedProgram
from conflank_cli.verification.result import CutFigures, Verification


def _written(heading: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    buffer = io.StringIO()
    table = csv.writer(buffer, lineterminator="\n")
    table.writerow(heading)
    # What is not known is an empty cell.
    table.writerows(["" if value is None or value != value else value for value in row] for row in rows)
    return buffer.getvalue()


def cuts_csv(verification: Verification) -> str:
    """What each cut leaves, as in the verification."""
    every = [("sweep", cut) for cut in verification.sweeps] + [("pass", cut) for cut in verification.passes]
    return _written(["kind", *CutFigures.__struct_fields__], ([kind, *asdict(cut).values()] for kind, cut in every))


def poses_csv(posed: PosedProgram, scene: Scene) -> str:
    """Every pose of a program: block, cut, tip and axis in the CAD frame, rotary axes, feed, when it is reached."""
    moves, cuts = posed.poses.moves, posed.program.cuts
    time = np.cumsum(drive(posed, scene).seconds)
    letters = list(posed.program.rotary_letters)
    heading = ["block", "cut", "x_mm", "y_mm", "z_mm", "i", "j", "k", *(f"{letter.lower()}_deg" for letter in letters)]
    rows = (
        [
            int(moves.block[n]),
            "" if moves.cut[n] < 0 else f"{cuts[moves.cut[n]].kind} {cuts[moves.cut[n]].number}",
            *posed.poses.tip[n].tolist(),
            *posed.poses.axis[n].tolist(),
            *np.degrees(moves.rotary[n, : len(letters)]).tolist(),
            float(moves.feed[n]),
            "rapid" if moves.rapid[n] else "feed",
            round(float(time[n]), 6),
        ]
        for n in range(len(moves.block))
    )
    return _written([*heading, "feed_mm_min", "motion", "time_s"], rows)
