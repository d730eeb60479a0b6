"""The frame on the machine table against SciPy's rotations one after the other."""

from __future__ import annotations

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from conflank_cli.job import Copies, Setup
from conflank_cli.machine_frame import Frame, machine_of, reachable_axes
from tests.verification.scenes import plane_face, scene_of

JOB = scene_of(plane_face((0.0, 10.0), (0.0, 10.0))).job


def test_rotation_is_intrinsic_xyz_then_translation() -> None:
    frame = Frame.of(Setup(rotate_deg=(20.0, -35.0, 50.0), translate=(1.0, 2.0, 3.0)))
    # Intrinsic XYZ: about x, then the new y, then the new z; as matrices Rx Ry Rz.
    x, y, z = (
        Rotation.from_rotvec(np.radians(angle) * axis).as_matrix()
        for angle, axis in zip((20.0, -35.0, 50.0), np.eye(3), strict=True)
    )
    points = np.random.default_rng(1).normal(size=(5, 3))
    np.testing.assert_allclose(frame.points(points), points @ (x @ y @ z).T + [1.0, 2.0, 3.0], atol=1e-14)
    np.testing.assert_allclose(frame.directions(points), points @ (x @ y @ z).T, atol=1e-14)
    assert frame.text == "ROTATE 20 -35 50 TRANSLATE 1 2 3"


def test_no_setup_is_the_frame_of_the_part() -> None:
    frame = Frame.of(Setup())
    assert frame.text == "CAD"
    np.testing.assert_array_equal(frame.points(np.eye(3)), np.eye(3))


def test_reach_is_judged_on_the_table_not_in_the_part() -> None:
    """A part that lies upside down on the table is cut from below: A reaches -120 degrees of tilt, no more."""
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    np.testing.assert_array_equal(reachable_axes(JOB, axes), [True, False, True])
    turned = msgspec.structs.replace(JOB, setup=Setup(rotate_deg=(180.0, 0.0, 0.0)))
    np.testing.assert_array_equal(reachable_axes(turned, axes), [False, True, True])
    assert reachable_axes(turned, axes[:0]).shape == (0,)


def test_reach_is_that_of_every_copy() -> None:
    """Leaning by 120 degrees towards y is in reach there, and on the copy a half turn on leans the other way."""
    lean = np.radians(115.0)
    axes = np.array([[0.0, np.sin(lean), np.cos(lean)], [0.0, -np.sin(lean), np.cos(lean)], [0.0, 0.0, 1.0]])
    tipped = Setup(rotate_deg=(60.0, 0.0, 0.0))
    alone = reachable_axes(msgspec.structs.replace(JOB, setup=tipped), axes)
    both = msgspec.structs.replace(tipped, copies=Copies(count=2))
    one = msgspec.structs.replace(tipped, copies=Copies(count=2, only=(1,)))
    other = reachable_axes(msgspec.structs.replace(JOB, setup=one), axes)
    assert alone.tolist() != other.tolist()
    np.testing.assert_array_equal(reachable_axes(msgspec.structs.replace(JOB, setup=both), axes), alone & other)
    assert machine_of(JOB).name == "ac-table"
