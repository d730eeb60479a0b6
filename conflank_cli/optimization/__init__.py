"""Optimisation: every candidate sweep to the best motion near it, side by side."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from conflank_cli.cores import threads
from conflank_cli.cover import mean_errors, shortlist
from conflank_cli.errors import NumericalError
from conflank_cli.geometry.screening import Screen
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.optimization.envelope_polish import Points
from conflank_cli.optimization.gauss_newton import STATUS, AxisErrorField, Solution
from conflank_cli.optimization.task import Task
from conflank_cli.optimization.terms import Weights
from conflank_cli.progress import Progress
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep

Array = npt.NDArray[np.float64]
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

# Points that the covered area of one sweep is judged on.
POINTS = 2500
# Points that sweeps are polished on: about so many, and no further apart than this, mm, but not more than the last.
POLISH_POINTS, POLISH_SPACING, MOST_POINTS = 4000, 0.8, 20000
# Sweeps that are worked on at a time: those in good covers of a face with each of the tools, about so many for each.
# What has grown covers more, so that others complete it best: they are looked for anew so often, or until all
# that would be chosen have been worked on.
AT_A_TIME, ROUNDS = 3, 3
# Sweeps of a face and tool that are slid where something is in their way: those that would be in good covers if nothing
# were.
RESCUED = 6
# A sweep that adds less than this share of a face to a cover is not worth refining.
LEAST_GAIN = 0.003


def optimize(scene: Scene, sweeps: list[Sweep], progress: Progress) -> tuple[list[Sweep], dict[str, Any]]:
    """Optimise every sweep, refine those that may be chosen, grow the best of them; sweeps that fail are left out.

    Returns the sweeps and a summary: how many came to which result, as sentences, how many were left out, and how many
    were slid along their axis so that they hit less; these come beside the ones they are made of.

    Raises
    ------
    NumericalError: not one sweep came through.
    """
    limits = Limits.of(scene.job.tolerance)
    target = scene.job.selection.coverage
    tasks = prepare(scene, {(sweep.face, sweep.tool) for sweep in sweeps})
    task_of = [tasks[sweep.face, sweep.tool] for sweep in sweeps]
    with threads() as pool:

        def side_by_side(title: str, work: Callable[[_Item], _Result], items: Sequence[_Item]) -> Iterator[_Result]:
            with progress.stage(title, len(items)) as stage:
                for result in pool.map(work, items):
                    stage.advance()
                    yield result

        indices = range(len(sweeps))
        solutions = list(side_by_side("optimize", lambda k: task_of[k].first(sweeps[k].motion), indices))
        sound = [k for k in indices if not solutions[k].failed]
        gaps: dict[int, Array] = {}

        def worth(
            chosen: Sequence[int], count: int, title: str, gap: Callable[[int], Array], known: dict[int, Array]
        ) -> list[int]:
            """Those of the chosen that make good covers, `count` of every face and tool or so, by their gaps."""
            new = [k for k in chosen if k not in known]
            known.update(zip(new, side_by_side(title, gap, new), strict=True))
            found: list[int] = []
            for group in groups(chosen):
                of_group = np.array([known[k] for k in group])
                found.extend(group[k] for k in _worth_more(task_of[group[0]], of_group, target, count))
            return found

        def groups(chosen: Sequence[int]) -> list[list[int]]:
            """Those of the chosen that may make a cover: of each face with each tool."""
            keys = sorted({(sweep.face, sweep.tool) for sweep in sweeps})
            own = [[k for k in chosen if (sweeps[k].face, sweeps[k].tool) == key] for key in keys]
            return [group for group in own if group]

        def judged(k: int) -> Array:
            motion = solutions[k].motion
            allowed = task_of[k].screen.allowed(motion, task_of[k].tool)
            return unscreened[k] if allowed is motion and k in unscreened else task_of[k].left_by(allowed)

        def improved(k: int) -> Solution:
            return task_of[k].grown(task_of[k].refined(solutions[k], sweeps[k].motion), sweeps[k].motion)

        # What is slid comes beside what it is made of: which of the two makes the better cover is not known yet.
        unscreened: dict[int, Array] = {}
        able = worth(sound, RESCUED, "judge", lambda k: task_of[k].unscreened(solutions[k].motion), unscreened)
        slid = list(side_by_side("rescue", lambda k: task_of[k].rescued(solutions[k]), able))
        rescued = [(k, solution) for k, solution in zip(able, slid, strict=True) if solution is not None]
        sound += range(len(sweeps), len(sweeps) + len(rescued))
        sweeps = [*sweeps, *(replace(sweeps[k], motion=solution.motion) for k, solution in rescued)]
        task_of += [task_of[k] for k, _ in rescued]
        solutions += [solution for _, solution in rescued]

        done: set[int] = set()
        for _ in range(ROUNDS):
            chosen = [k for k in worth(sound, AT_A_TIME, "judge", judged, gaps) if k not in done]
            if not chosen:
                break
            for k, solution in zip(chosen, side_by_side("grow", improved, chosen), strict=True):
                solutions[k] = solution
                del gaps[k]
                unscreened.pop(k, None)
            done.update(chosen)
    if not sound:
        failed = sorted({solution.status for solution in solutions})
        reasons = "; ".join(STATUS[status] for status in failed)
        raise NumericalError(
            scene.part_name,
            f"no sweep that could be optimised ({reasons or 'no candidates'})",
            "at least one",
            "Detect again with the same job, or with a wider tolerance.",
        )
    results = Counter(STATUS[solution.status] for solution in solutions)
    summary = {"left_out": len(sweeps) - len(sound), "rescued": len(rescued), "results": dict(results.most_common())}
    return [
        Sweep(sweeps[k].face, sweeps[k].tool, solutions[k].motion, {**_kept(sweeps[k]), **_facts(solutions[k], limits)})
        for k in sound
    ], summary


def prepare(scene: Scene, keys: Iterable[tuple[int, str]]) -> dict[tuple[int, str], Task]:
    """What sweeps are optimised with, by face (index into those of the scene) and tool."""
    job = scene.job
    wishes = job.optimization
    weights = Weights(wishes.mu1, wishes.mu2, wishes.mu3, wishes.mu4, wishes.mu5)
    limits = Limits.of(job.tolerance)
    tools = {tool.name: tool for tool in scene.tools}
    screen = Screen.of(scene)
    tasks: dict[tuple[int, str], Task] = {}
    for index, name in sorted(keys):
        tool = tools[name]
        face = WorkFace.under(scene.faces[index], tool)
        samples = face.samples(face.spacing(POINTS))
        points = Points.of(face, max(min(face.spacing(POLISH_POINTS), POLISH_SPACING), face.spacing(MOST_POINTS)))
        tasks[index, name] = Task(
            face,
            tool,
            samples,
            points,
            screen,
            limits,
            weights,
            wishes.samples,
            wishes.polish,
            wishes.norm,
            wishes.grow,
        )
    return tasks


def _worth_more(task: Task, gaps: Array, target: float, count: int) -> list[int]:
    covers = np.array([task.covered(gap) for gap in gaps])
    areas = task.samples.areas
    return shortlist(covers, areas, mean_errors(covers, gaps, areas), target, count, LEAST_GAIN)


def _kept(sweep: Sweep) -> dict[str, float]:
    """The facts of detection but the axis error, which is another one by now."""
    return {name: value for name, value in sweep.facts.items() if not name.startswith("axis_error_")}


def _facts(solution: Solution, limits: Limits) -> dict[str, float]:
    """Axis error over the samples on the face, how the solver fared, and what it did to each term."""
    terms = {
        f"term_{name}_{when}": value
        for when, those in (("start", solution.start), ("end", solution.end))
        for name, value in asdict(those).items()
    }
    return {"iterations": float(solution.iterations), **axis_error_facts(solution.field, limits), **terms}


def axis_error_facts(field: AxisErrorField, limits: Limits) -> dict[str, float]:
    """Axis error over the samples on the face: mean of |ε| and share within tolerance, worst overcut and stock left."""
    error = 1e3 * field.error[field.on > 0.5]
    if not error.size:
        return {}
    inside = (error >= -1e3 * limits.over) & (error <= 1e3 * limits.under)
    facts = {
        "axis_error_engaged": float(inside.mean()),
        "axis_error_min_um": float(error.min()),
        "axis_error_max_um": float(error.max()),
    }
    if inside.any():
        facts["axis_error_mean_um"] = float(np.abs(error[inside]).mean())
    return facts
