"""The order of cuts on plates, where tip, hub and sides are known beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.job import Copies
from conflank_cli.motion import Motion, uniform_knots
from conflank_cli.scene import Scene
from conflank_cli.selection.order import Cut, blades_of, climb, in_order, reversed_motion
from conflank_cli.sweep import Sweep
from tests.verification.scenes import plane_face, scene_of

# A blade 2 mm thick stands up along y, 0 to 40, from a hub below; its sides look along +z and -z.
UPPER = plane_face((0.0, 50.0), (0.0, 40.0))
HUB = CheckMesh(
    np.array([[-50.0, -5.0, -50.0], [100.0, -5.0, -50.0], [25.0, -5.0, 50.0]]),
    np.array([[0, 1, 2]], dtype=np.int32),
    np.array([7], dtype=np.int32),
)
NOTHING = CheckMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32), np.zeros(0, dtype=np.int32))


def turned(face: DesignFace, thickness: float) -> DesignFace:
    """The other side of a plate: it looks the other way."""
    surface = face.surface
    poles = surface.poles - np.array([0.0, 0.0, thickness])
    below = BSplineSurface(surface.degree_u, surface.degree_v, surface.knots_u, surface.knots_v, poles)
    return DesignFace(face.number + 1, "lower", below, face.loops, -face.sense)


def scene_with(
    check: CheckMesh, *, thickness: float = 2.0, cutting: str = "climb", copies: Copies | None = None
) -> Scene:
    base = replace(scene_of(UPPER, check=check), faces=(UPPER, turned(UPPER, thickness)))
    program = msgspec.structs.replace(base.job.program, cutting=cutting)
    setup = msgspec.structs.replace(base.job.setup, copies=copies or Copies())
    return replace(base, job=msgspec.structs.replace(base.job, program=program, setup=setup))


def cut(scene: Scene, face: int, low: float, tool: str = "T1", start: float = 0.0) -> Cut:
    """A strip 10 mm high along x from `low` on; the axis lies along y, off the face."""
    samples = samples_of(scene)[face]
    y = samples.points[:, 1]
    z = 3.0 if face == 0 else -5.0
    knots = uniform_knots(4)
    p = np.stack([np.linspace(start, 50.0 - start, 4), np.full(4, low), np.full(4, z)], axis=1)
    motion = Motion(knots, p, p + np.array([0.0, 10.0, 0.0]))
    return Cut(Sweep(face, tool, motion), (y >= low) & (y < low + 10.0))


def samples_of(scene: Scene) -> list:
    return [WorkFace.of(face, 0.0).samples(2.0) for face in scene.faces]


def ordered(scene: Scene, cuts: Sequence[Cut]) -> tuple[list[int], list[Sweep], str]:
    return in_order(scene, samples_of(scene), cuts)


def test_from_tip_to_hub_both_sides_of_a_thin_blade_in_turn() -> None:
    scene = scene_with(HUB)
    heights = [(0, 0.0), (0, 30.0), (1, 15.0), (1, 0.0), (0, 15.0), (1, 30.0)]
    order, _, why = ordered(scene, [cut(scene, *each) for each in heights])
    levels = [heights[k][1] for k in order]
    assert levels == [30.0, 30.0, 15.0, 15.0, 0.0, 0.0]
    assert [heights[k][0] for k in order] in ([0, 1, 0, 1, 0, 1], [1, 0, 1, 0, 1, 0])
    assert why == "from tip to hub by where the rest of the part is, sides of thin blades in turn"


def test_a_thick_blade_is_cut_side_by_side() -> None:
    scene = scene_with(HUB, thickness=30.0)
    assert blades_of(samples_of(scene)) == [0, 1]
    assert blades_of(samples_of(scene_with(HUB))) == [0, 0]
    heights = [(0, 0.0), (0, 30.0), (1, 0.0), (1, 30.0)]
    order, _, _ = ordered(scene, [cut(scene, *each) for each in heights])
    assert [heights[k][0] for k in order] in ([0, 0, 1, 1], [1, 1, 0, 0])
    assert [heights[k][1] for k in order] == [30.0, 0.0, 30.0, 0.0]


def test_a_channel_is_no_thin_blade() -> None:
    """Faces that look at each other across a gap are as near, but there is no metal between them."""
    scene = scene_with(HUB)
    facing = replace(scene, faces=tuple(replace(face, sense=-face.sense) for face in scene.faces))
    assert blades_of(samples_of(facing)) == [0, 1]


def test_the_axis_of_the_copies_says_where_the_hub_is() -> None:
    """The axis along x through the origin: far from it is far up the blade. It counts before the check geometry."""
    scene = scene_with(NOTHING, copies=Copies((1.0, 0.0, 0.0), 5, (0,)))
    order, _, why = ordered(scene, [cut(scene, 0, low) for low in (0.0, 30.0, 15.0)])
    assert order == [1, 2, 0]
    assert "axis of the copies" in why
    above = scene.checking(replace(HUB, vertices=HUB.vertices + np.array([0.0, 90.0, 0.0])))
    assert ordered(above, [cut(scene, 0, low) for low in (0.0, 30.0, 15.0)])[0] == [1, 2, 0]


def test_without_a_hub_tools_and_links_count() -> None:
    scene = scene_with(NOTHING, thickness=30.0)
    cuts = [cut(scene, 0, 0.0, "T1"), cut(scene, 0, 15.0, "T3"), cut(scene, 0, 30.0, "T1")]
    order, _, why = ordered(scene, cuts)
    assert order == [0, 2, 1]
    assert "nothing says where the hub is" in why


def test_tools_stay_together_unless_that_breaks_the_order() -> None:
    scene = scene_with(HUB, thickness=30.0)
    same_level = [cut(scene, 0, 30.0, "T1"), cut(scene, 0, 29.0, "T3"), cut(scene, 0, 28.0, "T1")]
    assert ordered(scene, same_level)[0] == [0, 2, 1]
    levels = [cut(scene, 0, 30.0, "T1"), cut(scene, 0, 15.0, "T3"), cut(scene, 0, 0.0, "T1")]
    assert ordered(scene, levels)[0] == [0, 1, 2]


@pytest.mark.parametrize("cutting", ["climb", "conventional"])
def test_sweeps_run_the_way_that_is_asked_for(cutting: str) -> None:
    """Axis up along y, the plate below in -z: metal to the right of the feed is where x grows against y x z."""
    scene = scene_with(HUB, cutting=cutting)
    _, sweeps, _ = ordered(scene, [cut(scene, 0, 0.0), cut(scene, 1, 0.0)])
    for sweep in sweeps:
        p, _ = sweep.motion.ends([0.0, 1.0])
        # The spindle turns clockwise seen against the axis: on the upper side the edge at the plate runs along
        # d x n = y x z = +x, on the lower one along -x; climb milling goes against it.
        edge = 1.0 if sweep.face == 0 else -1.0
        assert np.sign(p[1, 0] - p[0, 0]) == (-edge if cutting == "climb" else edge)


def test_cutting_both_ways_makes_the_links_short() -> None:
    scene = scene_with(HUB, thickness=30.0, cutting="both")
    _, sweeps, _ = ordered(scene, [cut(scene, 0, 30.0), cut(scene, 0, 15.0), cut(scene, 0, 0.0)])
    ends = [sweep.motion.ends([0.0, 1.0])[0][:, 0] for sweep in sweeps]
    assert all(one[1] == pytest.approx(other[0]) for one, other in pairwise(ends))


def test_reversed_motion_is_the_same_motion() -> None:
    scene = scene_with(HUB)
    motion = cut(scene, 0, 0.0, start=7.0).sweep.motion
    t = np.linspace(0.0, 1.0, 7)
    np.testing.assert_allclose(np.hstack(reversed_motion(motion).ends(1.0 - t)), np.hstack(motion.ends(t)), atol=1e-12)
    samples = samples_of(scene)[0]
    every = np.ones(len(samples.areas), dtype=np.bool_)
    assert climb(motion, samples, every) == pytest.approx(-climb(reversed_motion(motion), samples, every))
