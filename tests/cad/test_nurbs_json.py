from __future__ import annotations

import json

import numpy as np
import pytest

from conflank_cli.cad.inspection import describe
from conflank_cli.cad.quadrature import surface_frames, trimmed_area
from conflank_cli.cad.reader import read_part
from conflank_cli.errors import InputError
from conflank_cli.geometry.surface import to_spans

PATCH = {
    "name": "patch",
    "degree_u": 2,
    "degree_v": 1,
    "knots_u": [0, 0, 0, 1, 1, 1],
    "knots_v": [0, 0, 1, 1],
    "poles": [[[0, 0, 0], [0, 10, 0]], [[5, 0, 2], [5, 10, 2]], [[10, 0, 0], [10, 10, 0]]],
}


def _write(tmp_path, faces, **more):
    path = tmp_path / "part.json"
    path.write_text(json.dumps({"faces": faces, **more}))
    return path


def _quarter_cylinder(radius=6.0, height=9.0):
    arc = [(radius, 0), (radius, radius), (0, radius)]
    return {
        "degree_u": 2,
        "degree_v": 1,
        "knots_u": [0, 0, 0, 1, 1, 1],
        "knots_v": [0, 0, 1, 1],
        "poles": [[[x, y, 0], [x, y, height]] for x, y in arc],
        "weights": [[1, 1], [0.5**0.5] * 2, [1, 1]],
        "outside": "along",
    }


def test_area_curvature_and_unit_of_a_rational_patch(tmp_path):
    part = read_part(_write(tmp_path, [_quarter_cylinder()], unit="inch"), 0.5)
    (report,) = describe(part)
    size = 25.4 * 0.5
    assert report.area == pytest.approx(size**2 * 6.0 * 9.0 * np.pi / 2, rel=1e-7)
    # The normal S_u x S_v of this quarter points away from its axis, so the metal bulges: negative.
    assert report.curvature.least == pytest.approx(-1 / (6.0 * size), rel=1e-6)
    assert report.curvature.greatest == pytest.approx(0.0, abs=1e-9)
    assert report.outside_known and report.rational and report.edges == 4


def test_periodic_and_unclamped_directions(tmp_path):
    count = 8
    angle = 2 * np.pi * np.arange(count) / count
    ring = {
        "degree_u": 3,
        "degree_v": 1,
        "knots_u": list(range(count + 1)),
        "knots_v": [-1, 0, 1, 2],
        "poles": [[[10 * np.cos(a), 10 * np.sin(a), 0], [10 * np.cos(a), 10 * np.sin(a), 20]] for a in angle],
        "periodic_u": True,
    }
    geometry = read_part(_write(tmp_path, [ring])).faces[0].load()
    assert geometry.box == (0.0, 8.0, 0.0, 1.0)
    u = np.linspace(0.01, 7.99, 50)
    points = surface_frames(to_spans(geometry.surface), u, np.full(50, 0.25))[:, 0]
    # A uniform cubic through a regular polygon of poles is round to a thousandth, and pole i peaks at knot i + 2.
    factor = (2.0 + np.cos(np.pi / 4)) / 3.0
    np.testing.assert_allclose(np.hypot(points[:, 0], points[:, 1]), 10 * factor, rtol=1e-2)
    np.testing.assert_allclose(
        np.mod(np.arctan2(points[:, 1], points[:, 0]) - (u - 2.0) * np.pi / 4 + np.pi, 2 * np.pi), np.pi, atol=0.02
    )
    np.testing.assert_allclose(points[:, 2], 5.0, atol=1e-12)


def test_trim_loops_with_a_hole(tmp_path):
    flat = {**PATCH, "poles": [[[x, 0, 0], [x, 10, 0]] for x in (0, 5, 10)]}
    flat["trim"] = [[[0.1, 0.1], [0.9, 0.1], [0.9, 0.9], [0.1, 0.9]], [[0.4, 0.4], [0.6, 0.4], [0.5, 0.6]]]
    geometry = read_part(_write(tmp_path, [flat])).faces[0].load()
    assert trimmed_area(geometry.surface, geometry.loops) == pytest.approx(100 * (0.64 - 0.02), rel=1e-9)


@pytest.mark.parametrize(
    "change,place,found",
    [
        ({"knots_u": [0, 0, 0, 1, 1]}, "faces[0].knots_u", "5 knots"),
        ({"knots_u": [0, 0, 0, 1, 0.5, 1]}, "faces[0].knots_u", "0.5 after 1 at index 4"),
        ({"knots_u": [0, 0, 0, 0, 0, 0]}, "faces[0].knots_u", "no length"),
        ({"knots_v": [0, 0, 0, 1]}, "faces[0].knots_v", "no length"),
        ({"degree_v": 2}, "faces[0].poles", "2 along v"),
        ({"degree_v": 0}, "faces[0].degree_v", "0"),
        ({"weights": [[1, 1], [1, -1], [1, 1]]}, "faces[0].weights", "weight -1"),
        ({"weights": [[1, 1]]}, "faces[0].weights", "another shape"),
        ({"poles": [[[0, 0, 0]], [[0, 0, 0], [1, 0, 0]]]}, "faces[0].poles", "rows of different length"),
        ({"colour": "red"}, "faces[0]", "unknown field `colour`"),
        ({"outside": "up"}, "faces[0].outside", "'up'"),
        ({"trim": []}, "faces[0].trim", "an empty list"),
        ({"trim": [[[0, 0], [1, 1], [0, 0]]]}, "faces[0].trim[0]", "encloses nothing"),
        ({"trim": [[[2, 2], [3, 2], [3, 3]]]}, "faces[0].trim[0]", "encloses nothing"),
    ],
)
def test_wrong_values_are_refused_with_their_place(tmp_path, change, place, found):
    path = _write(tmp_path, [{**PATCH, **change}])
    with pytest.raises(InputError) as caught:
        read_part(path)
    assert place in caught.value.where
    assert found in caught.value.found


def test_text_that_is_no_such_file(tmp_path):
    path = tmp_path / "part.json"
    for text, found in [
        ("{", "no JSON"),
        ('{"faces": []}', "an empty list"),
        ('{"faces": [{"degree_u": NaN}]}', "no JSON"),
        ('{"facets": []}', "unknown field"),
        ('{"faces": [{"degree_u": 1}]}', "missing required field"),
    ]:
        path.write_text(text)
        with pytest.raises(InputError, match=found):
            read_part(path)
