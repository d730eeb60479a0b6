"""How accurate a motion can be with control points every so many millimetres: exact envelopes, judged by brute force.

Run with ``python -m benchmarks.knot_spacing --json benchmarks/results/knot_spacing.json`` (``make samples`` does). The
motions that make the envelopes are products of polynomials, cosines and rotations, so no spline space contains them;
what is left after Gauss-Newton has settled is what the spline space lacks.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
import numpy as np
import numpy.typing as npt

from benchmarks.envelopes import EnvelopeCase, cylinder, random_envelopes, swept_gap
from conflank_cli.geometry.face import DesignFace
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.geometry.gap import travel
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion, fitted
from conflank_cli.optimization.gauss_newton import Step, minimise
from conflank_cli.optimization.task import STIFFEST
from conflank_cli.optimization.terms import Weights
from conflank_cli.tool import CATALOGUE

Array = npt.NDArray[np.float64]

SEED = 2018
CASES = 3  # random motions for each tool
SPACINGS = (8.0, 6.0, 4.0, 3.0, 2.0)  # mm of travel between control points
STEPS = 12  # of Gauss-Newton; the last ones move nothing any more
POINTS = 1500


def settled(case: EnvelopeCase, spacing: float) -> Motion:
    """The optimised motion with a control point every `spacing` mm, from a fit of the exact one."""
    u0, u1, v0, v1 = case.surface.domain
    border = np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])
    face = WorkFace.under(DesignFace(0, "envelope", case.surface, (border,), case.sense), case.tool)
    times = np.linspace(0.0, 1.0, len(case.t))
    ends = np.hstack([case.p, case.q])
    count = round(travel(fitted(times, ends, 64)) / spacing) + 3
    step = Step(1e-8, STIFFEST, 0.008, True)
    start = fitted(times, ends, count)
    grid = (max(100, 3 * count), 30)
    solution = minimise(face, case.tool, start, Limits(0.01, 0.01), Weights(mu3=1e-5), grid, (step,) * STEPS)
    return solution.motion


def mean_gap_um(case: EnvelopeCase, motion: Motion) -> float:
    """Mean |g| of a motion over the face, um."""

    def axis(t: Array) -> tuple[Array, Array]:
        p, q = motion.ends(t)
        return p, (q - p) / np.linalg.norm(q - p, axis=1)[:, None]

    u0, u1, v0, v1 = case.surface.domain
    side = int(np.sqrt(POINTS))
    u = np.linspace(u0 + 0.02 * (u1 - u0), u1 - 0.02 * (u1 - u0), side)
    v = np.linspace(v0 + 0.02 * (v1 - v0), v1 - 0.02 * (v1 - v0), side)
    uv = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    points = Projector.of(case.surface).evaluate(uv[:, 0], uv[:, 1])[:, 0]
    gaps, _ = swept_gap(case.tool, axis, points)
    return 1e3 * float(np.abs(gaps).mean())


def measure() -> list[dict[str, Any]]:
    """One row for each tool and spacing: least and largest mean |g| over the cases, um, with three digits."""
    rows = []
    for tool in (cylinder(), *CATALOGUE.values()):
        cases = random_envelopes(tool, CASES, SEED)
        for spacing in SPACINGS:
            means = [mean_gap_um(case, settled(case, spacing)) for case in cases]
            least, most = (float(f"{value:.2g}") for value in (min(means), max(means)))
            rows.append({"tool": tool.name, "spacing_mm": spacing, "least_um": least, "most_um": most})
    return rows


@click.command()
@click.option(
    "--json", "file", type=click.Path(path_type=Path), help="Write the rows to FILE instead of printing them."
)
def main(file: Path | None) -> None:
    """Measure mean |g| against the spacing of control points."""
    text = json.dumps({"cases": CASES, "rows": measure()}, indent=2) + "\n"
    if file is None:
        click.echo(text, nl=False)
    else:
        file.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
