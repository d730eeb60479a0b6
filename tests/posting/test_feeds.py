"""Feeds of posted programs, judged from the text by the verification's own kinematics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from benchmarks.posting import on_machine, ready_machines
from benchmarks.simulated_machine import drive as simulated
from conflank_cli.ball_pass import Pass
from conflank_cli.posting import feeds, post_programs, summarize
from conflank_cli.posting.mounting import axis_positions, mounting_of
from conflank_cli.posting.summary import nominal_seconds
from conflank_cli.scene import Scene
from conflank_cli.verification.axes import contact_feeds, drive, labelled_cuts
from conflank_cli.verification.findings import Finding
from conflank_cli.verification.posed import pose_program
from postprocessors.kinematics.time_scaling import Run
from postprocessors.kinematics.visits import visits_with_words
from postprocessors.machines.machine import Limits, load_machine
from tests.posting.test_program import scene_of, twisted

Array = npt.NDArray[np.float64]
DYNAMICS = ("CF115", "CF403", "CF404", "CF405")


def kinked_pass() -> Pass:
    """To and fro with corners; half way the axis begins to swing at once, and goes back as suddenly."""
    t = np.linspace(0.0, 1.0, 121)
    tip = np.stack([np.full(121, -3.0), 4.0 + 40.0 * t, 4.0 + np.abs((8.0 * t) % 2.0 - 1.0)], axis=1)
    lean, turn = np.full(121, 0.9), 1.2 + 2.0 * np.clip(np.minimum(t - 0.4, 0.8 - t), 0.0, 0.2)
    axis = np.stack([-np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)], axis=1)
    return Pass(0, "T1", tip, axis)


def scene_on(name: str, feed: float = 3000.0) -> Scene:
    """The plate on a machine, with tools that are fed so fast that every axis matters."""
    scene = scene_of()
    quick = tuple(replace(tool, feed_mm_min=feed) for tool in scene.tools)
    scene = on_machine(replace(scene, tools=quick), [twisted()], name)
    return scene


@cache
def posted(name: str, mounted: bool) -> tuple[Scene, str]:
    scene = scene_on(name)
    if mounted:
        travel = summarize(scene.job, post_programs(scene, [twisted()], [kinked_pass()])[1]).travel
        machine = msgspec.structs.replace(
            scene.job.machine, zero=tuple(np.round(travel.zero, 1).tolist()), gauge_length=dict(travel.supposed)
        )
        scene = replace(scene, job=msgspec.structs.replace(scene.job, machine=machine))
    return scene, post_programs(scene, [twisted()], [kinked_pass()])[0][0].text


def judged(scene: Scene, text: str) -> list[Finding]:
    """What is found of axes and feeds."""
    posed = pose_program(text, scene)
    ran = drive(posed, scene)
    cutting = labelled_cuts(posed.program)
    found = contact_feeds(posed.poses, posed.program, posed.tools, scene, cutting, cutting, ran.load)
    return [finding for finding in (*ran.findings, *found) if finding.code in DYNAMICS]


CASES = [(name, False) for name in ready_machines()] + [("ac-table", True), ("head-head", True)]
MORE = [(name, True) for name in ready_machines() if (name, True) not in CASES]


@pytest.mark.parametrize(("name", "mounted"), [*CASES, *(pytest.param(*case, marks=pytest.mark.slow) for case in MORE)])
def test_every_axis_follows_the_printed_program(name: str, mounted: bool) -> None:
    scene, text = posted(name, mounted)
    assert text.count("; PASS 2") == 1
    assert judged(scene, text) == []


def test_without_scaled_times_it_could_not(monkeypatch: pytest.MonkeyPatch) -> None:
    def least(runs: Sequence[Run], limits: Limits) -> list[Array]:
        return [run.least for run in runs]

    monkeypatch.setattr(feeds, "scaled_seconds", least)
    scene = scene_on("ac-table")
    text = post_programs(scene, [twisted()], [kinked_pass()])[0][0].text
    assert {"CF404", "CF405"} <= {finding.code for finding in judged(scene, text)}


@pytest.mark.parametrize("name", ["ac-table", "head-head"])
def test_the_predicted_time_is_that_of_a_simulated_machine(name: str) -> None:
    scene, _ = posted(name, False)
    _, path, run = post_programs(scene, [twisted()], [kinked_pass()])
    machine = load_machine(name)
    steps = 0.0
    for visit in visits_with_words(machine, path):
        axes = axis_positions(machine, mounting_of(scene.job), visit.tool, visit.tip, visit.words)
        nominal = nominal_seconds(machine, visit, axes)
        kept = np.concatenate([[True], nominal > 0.0])
        steps += simulated(axes[kept], nominal[nominal > 0.0], machine.limits).seconds
    assert summarize(scene.job, path, run).seconds == pytest.approx(steps, rel=0.02)
    posed = pose_program(posted(name, False)[1], scene)
    ran = drive(posed, scene)
    # The verification also counts what of the ways above the safe plane is known.
    assert ran.seconds.sum() > 0.98 * steps
    in_cuts = ran.seconds[labelled_cuts(posed.program)].sum()
    assert in_cuts == pytest.approx(sum(cut.seconds for cut in summarize(scene.job, path, run).cuts), rel=0.02)


def test_the_feed_changes_no_more_than_it_must() -> None:
    """Far from kinks the feed is that of the tool, and does not jump from block to block."""
    scene, text = posted("ac-table", False)
    moves = pose_program(text, scene).program.moves
    sweep = np.flatnonzero(
        labelled_cuts(pose_program(text, scene).program) & (moves.cut == moves.cut[moves.cut >= 0][0])
    )
    ratio = moves.feed[sweep][1:] / moves.feed[sweep][:-1]
    assert max(ratio.max(), 1.0 / ratio.min()) < 1.2
