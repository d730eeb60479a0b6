"""What each step of an optimisation makes of a motion."""

from __future__ import annotations

from dataclasses import replace

from conflank_cli.motion import Motion
from conflank_cli.optimization.envelope_polish import for_area
from conflank_cli.optimization.task import (
    PAPER_STEPS,
    POLISH_SCALES,
    SETTLE_PROXIMITY,
    SETTLE_STEPS,
    Task,
)


def convergence(task: Task, candidate: Motion) -> list[tuple[str, Motion]]:
    """The motion of a candidate after each step of its optimisation, without growth, with the name of the phase."""
    schedule = task.schedule()
    steps = [("", candidate)]
    for k in range(1, len(schedule) + 1):
        name = "paper's weights" if k <= PAPER_STEPS else "μ₂, μ₅ fade"
        steps.append((name, task.minimised(candidate, schedule[:k], task.weights).motion))
    fine = task.refitted(steps[-1][1])
    weights = replace(task.weights, mu3=task.weights.mu3 * SETTLE_PROXIMITY)
    for k in range(1, SETTLE_STEPS + 1):
        steps.append(("finer knots", task.minimised(fine, schedule[-1:] * k, weights).motion))
    settled = steps[-1][1]
    points = task.points.near(settled, task.tool, task.limits, POLISH_SCALES[0])
    for k in range(1, len(POLISH_SCALES) + 1):
        polished = for_area(task.tool, settled, points, task.limits, task.polish_weights, POLISH_SCALES[:k])
        if polished is not None:
            steps.append(("polish on g", polished))
    return steps
