"""What one sweep goes through, and the stage as a whole."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from conflank_cli.errors import NumericalError
from conflank_cli.geometry.screening import Screen
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.limits import Limits
from conflank_cli.motion import Motion
from conflank_cli.optimization import axis_error_facts, optimize, prepare
from conflank_cli.optimization.envelope_polish import Points
from conflank_cli.optimization.gauss_newton import STATUS, AxisErrorField
from conflank_cli.optimization.task import FINE_FEWEST, Task
from conflank_cli.optimization.terms import Weights
from conflank_cli.progress import SilentProgress
from conflank_cli.sweep import Sweep
from conflank_cli.tool import CATALOGUE
from tests.faces import design, envelope, envelope_scene, known
from tests.verification.scenes import triangles_of

LIMITS = Limits(0.010, 0.010)
CASE = envelope(CATALOGUE["T3"])


@pytest.fixture(scope="module")
def task() -> Task:
    face = WorkFace.of(design(CASE.surface, CASE.sense), 0.7 * CASE.tool.length)
    samples = face.samples(face.spacing(800))
    screen = Screen.of(envelope_scene(CASE), 1.0)
    points = Points.of(face, face.spacing(2000))
    return Task(face, CASE.tool, samples, points, screen, LIMITS, Weights(), (60, 16), True, 2, True)


def test_a_short_start_grows_over_the_whole_face(task: Task) -> None:
    """A third of the exact motion, 0.1 mm off: optimised it covers its third, grown nearly everything."""
    part = known(CASE).restricted(0.3, 0.6).respaced(8)
    first = task.first(Motion(part.knots, part.p + 0.1, part.q + 0.1))
    assert not first.failed
    areas = task.samples.areas
    before = areas[task.covered(task.gaps(first.motion))].sum() / areas.sum()
    assert 0.25 < before < 0.5
    grown = task.grown(task.refined(first, first.motion), first.motion)
    after = areas[task.covered(task.gaps(grown.motion))].sum() / areas.sum()
    # 4 mm at either end in each round: 32 mm in four rounds, which is all of it.
    assert after > 0.97
    # The terms are those of what comes out, beside where it all began.
    assert grown.start == first.start
    t = np.linspace(0.0, 1.0, 60)
    gone = np.hstack(grown.motion.ends(t)) - np.hstack(first.motion.ends(t))
    assert grown.end.proximity == pytest.approx(np.mean(np.sum(gone**2, axis=1)) / 2.0)
    plain = replace(task, polish=False, grow=False)
    again = plain.grown(plain.refined(first, first.motion), first.motion)
    still = areas[task.covered(task.gaps(again.motion))].sum() / areas.sum()
    assert still == pytest.approx(before, abs=0.05)


def test_overcut_anywhere_covers_nothing(task: Task) -> None:
    gaps = np.zeros(len(task.samples.areas))
    assert task.covered(gaps).all()
    gaps[3] = 0.011
    assert task.covered(gaps).sum() == len(gaps) - 1
    gaps[5] = -0.011
    assert not task.covered(gaps).any()


def test_a_motion_that_collides_from_end_to_end_has_no_gaps(task: Task) -> None:
    motion = known(CASE)
    frame = task.face.projector.evaluate([0.5], [0.5])[0]
    normal = CASE.sense * np.cross(frame[1], frame[2])
    into = -2.0 * normal / np.linalg.norm(normal)
    assert np.all(np.isinf(task.gaps(Motion(motion.knots, motion.p + into, motion.q + into))))


def test_a_sweep_that_stands_too_deep_is_slid_out(task: Task) -> None:
    """Small plates half a millimetre above where the tip comes past, on the second half of the way."""
    motion = known(CASE)
    p, q = motion.ends(np.linspace(0.55, 1.0, 12))
    d = (q - p) / np.linalg.norm(q - p, axis=1)[:, None]
    centres = p + (CASE.tool.tip_height + 0.5) * d
    across = np.cross(d, [1.0, 0.0, 0.0])
    across *= 0.2 / np.linalg.norm(across, axis=1)[:, None]
    plates = triangles_of(
        *(
            [centre + a + b for a, b in ((x, y), (-x, y), (-x, -y), (x, -y))]
            for centre, x, y in zip(centres, across, np.cross(d, across), strict=True)
        )
    )
    blocked = replace(task, screen=Screen.of(envelope_scene(CASE).checking(plates), 1.0))
    solution = task.first(motion)
    assert task.rescued(solution) is None
    areas = task.samples.areas

    def share(task: Task, motion: Motion) -> float:
        return float(areas[task.covered(task.gaps(motion))].sum() / areas.sum())

    assert share(task, solution.motion) > 0.95 and share(blocked, solution.motion) < 0.65
    found = blocked.rescued(solution)
    assert found is not None
    # The flute of 30 mm loses half a millimetre at its end, or one.
    assert share(blocked, found.motion) > 0.9
    low, high = (motion.ends([0.5])[0][0] for motion in (solution.motion, found.motion))
    assert 0.4 < float((high - low) @ d[0]) < 2.1
    # Settling would slide it back along its contact, into the plates.
    assert share(blocked, blocked.refined(found, found.motion).motion) > 0.9


def test_only_sweeps_that_may_be_chosen_are_worked_on() -> None:
    """Three parts of the exact motion that make up the face, and a short one within one of them."""
    scene = envelope_scene(CASE)
    keys = msgspec.structs.replace(scene.job.optimization, samples=(60, 16))
    scene = replace(scene, job=msgspec.structs.replace(scene.job, optimization=keys))
    spans = ((0.0, 0.4), (0.35, 0.75), (0.7, 1.0), (0.5, 0.58))
    starts = [Sweep(0, CASE.tool.name, known(CASE).restricted(*span).respaced(8)) for span in spans]
    found, _ = optimize(scene, starts, SilentProgress())
    worked_on = [len(sweep.motion.p) >= FINE_FEWEST for sweep in found]
    assert worked_on == [True, True, True, False]
    tasks = prepare(scene, [(0, CASE.tool.name)])
    task = tasks[0, CASE.tool.name]
    shares = [task.samples.areas[task.covered(task.gaps(sweep.motion))].sum() for sweep in found]
    assert max(shares[:3]) > 0.97 * task.samples.areas.sum()
    assert shares[3] < 0.2 * task.samples.areas.sum()


def test_facts_of_an_error_field() -> None:
    error = np.array([[-0.002, 0.004, 0.5], [-0.03, 0.006, 0.001]])
    on = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0]])
    facts = axis_error_facts(AxisErrorField(error, on, error, error), LIMITS)
    assert facts == {
        "axis_error_engaged": pytest.approx(0.6),
        "axis_error_min_um": pytest.approx(-30.0),
        "axis_error_max_um": pytest.approx(500.0),
        "axis_error_mean_um": pytest.approx(4.0),
    }
    assert axis_error_facts(AxisErrorField(error, 0.0 * on, error, error), LIMITS) == {}


def test_sweeps_that_are_lost_are_left_out_and_facts_stay() -> None:
    scene = envelope_scene(CASE)
    job = msgspec.structs.replace(
        scene.job, optimization=msgspec.structs.replace(scene.job.optimization, grow=False, samples=(40, 12))
    )
    scene = replace(scene, job=job)
    motion = known(CASE, 12)
    lost = Motion(motion.knots, motion.p + 500.0, motion.q + 500.0)
    sweeps = [Sweep(0, "T3", lost, {}), Sweep(0, "T3", motion, {"lines": 31.0})]
    (found,), summary = optimize(scene, sweeps, SilentProgress())
    assert summary["left_out"] == 1
    assert summary["results"].pop(STATUS["lost"]) == 1
    assert sum(summary["results"].values()) == 1
    assert found.facts["term_distance_end"] < 1e-7 < found.facts["term_fairness_start"]
    assert found.facts["lines"] == 31.0
    assert found.facts["axis_error_mean_um"] < 0.2
    assert found.facts["axis_error_engaged"] > 0.95
    with pytest.raises(NumericalError, match="left the face"):
        optimize(scene, sweeps[:1], SilentProgress())
    with pytest.raises(NumericalError, match="no candidates"):
        optimize(scene, [], SilentProgress())
