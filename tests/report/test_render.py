"""The renderer against outlines that are known."""

import numpy as np
import pytest

from conflank_cli.report.render import (
    SAMPLES,
    SECTION,
    Camera,
    Mesh,
    Picture,
    facet_mesh,
    grid_mesh,
    render,
    revolved_mesh,
)

RED, BLUE = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
TOP = Camera(np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), np.array([-2.0, -2.0]), np.array([2.0, 2.0]), 20.0)


def sphere(radius: float, centre: tuple[float, float, float], colour: np.ndarray) -> Mesh:
    angle = np.linspace(0.0, np.pi, 61)
    heights, radii = radius * (1.0 - np.cos(angle)), radius * np.sin(angle)
    tip = np.array(centre) - [0.0, 0.0, radius]
    return revolved_mesh(tip, np.array([0.0, 0.0, 1.0]), heights, radii, np.tile(colour, (61, 1)), 120)


def drawn(picture: Picture) -> np.ndarray:
    return np.isfinite(picture.depth)


def test_a_sphere_is_a_disc_with_its_depth() -> None:
    picture = render(TOP, [sphere(1.0, (0.5, 0.0, 0.0), RED)])
    scale = TOP.pixels * SAMPLES
    assert drawn(picture).sum() / scale**2 == pytest.approx(np.pi, rel=0.01)
    rows, columns = np.nonzero(drawn(picture))
    assert columns.mean() / scale - 2.0 == pytest.approx(0.5, abs=0.02)
    assert rows.mean() / scale - 2.0 == pytest.approx(0.0, abs=0.02)
    assert picture.depth.max() == pytest.approx(1.0, abs=1e-3)
    assert picture.pixels().shape == (80, 80, 3)


def test_the_nearer_body_hides_the_other_whatever_the_order() -> None:
    near, far = sphere(0.5, (0.0, 0.0, 1.0), BLUE), sphere(1.0, (0.0, 0.0, -1.0), RED)
    for meshes in ([near, far], [far, near]):
        middle = render(TOP, meshes).pixels()[40, 40]
        assert middle[2] > 0.5 and middle[0] == 0.0


def test_see_through_lets_through_only_where_it_is_nearer() -> None:
    solid = render(TOP, [sphere(1.0, (0.0, 0.0, 0.0), RED)])
    above = render(TOP, [sphere(0.5, (0.0, 0.0, 2.0), BLUE)]).over(solid, 0.5).pixels()[40, 40]
    below = render(TOP, [sphere(0.5, (0.0, 0.0, -2.0), BLUE)]).over(solid, 0.5).pixels()[40, 40]
    assert above[0] > 0.3 and above[2] > 0.3
    assert below[2] == 0.0


def test_a_cut_body_shows_its_section() -> None:
    corners = np.array([[x, y, z] for z in (0.0, 2.0) for y in (-1.0, 1.0) for x in (-1.0, 1.0)])
    outward = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = np.array([[q[0], q[a], q[a + 1]] for q in outward for a in (1, 2)], dtype=np.int32)
    box = facet_mesh(corners, triangles, RED)
    whole = render(TOP, [box]).pixels()[40, 40]
    assert whole[0] > 0.5 and whole[2] == 0.0
    cut = Mesh(box.vertices, box.normals, box.colours, box.triangles, box.vertices[:, 2] - 1.0)
    assert render(TOP, [cut]).pixels()[40, 40] == pytest.approx(np.array(SECTION))


def test_cells_with_a_corner_off_the_face_are_left_out() -> None:
    x, y = np.meshgrid(np.linspace(-1, 1, 5), np.linspace(-1, 1, 5), indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    normals = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    keep = np.ones((5, 5), dtype=bool)
    keep[0, 0] = False
    picture = render(TOP, [grid_mesh(points, normals, np.broadcast_to(RED, points.shape), keep)])
    assert drawn(picture).sum() / (TOP.pixels * SAMPLES) ** 2 == pytest.approx(4.0 - 0.25, rel=0.02)
