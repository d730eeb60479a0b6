"""Equal inputs give equal bytes: detect, optimize and select twice, on however many threads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec

from conflank_cli.artifacts import write_artifact
from conflank_cli.detection import detect
from conflank_cli.optimization import optimize
from conflank_cli.progress import SilentProgress
from conflank_cli.selection import select
from conflank_cli.tool import CATALOGUE
from tests.faces import envelope, envelope_scene


def test_stages_give_equal_bytes_twice(tmp_path: Path) -> None:
    scene = envelope_scene(envelope(CATALOGUE["T3"]))
    keys = msgspec.structs.replace(scene.job.optimization, samples=(50, 12))
    scene = replace(scene, job=msgspec.structs.replace(scene.job, optimization=keys))
    written = []
    for run in ("first", "second"):
        progress = SilentProgress()
        folder = tmp_path / run
        folder.mkdir()
        found = detect(scene, progress)
        write_artifact("candidates", scene, found, {}, folder / "candidates.npz")
        motions, _ = optimize(scene, found[:5], progress)
        write_artifact("motions", scene, motions, {}, folder / "motions.npz")
        choice = select(scene, motions, progress)
        plan, summary = choice.plan, choice.summary
        write_artifact("plan", scene, plan, summary, folder / "plan.npz", coverage=choice.coverage)
        written.append([(folder / f"{name}.npz").read_bytes() for name in ("candidates", "motions", "plan")])
        # And it is worth comparing: one sweep cuts the whole face.
        assert len(plan) == 1
        assert summary["coverage"] > 0.97
        assert summary["gap_mean_abs_um"] < 0.3
    assert written[0] == written[1]
