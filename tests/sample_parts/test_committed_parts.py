"""The STEP files in the repository against the formulas, and against Open CASCADE's own measurements."""

from pathlib import Path

import numpy as np
import pytest
from blade_surfaces import SUCTION, side_contact
from blisk_blade import make_blisk_blade, patches
from blisk_law import BliskLaw
from impeller import sides
from impeller_law import ImpellerLaw
from make_parts import PARTS, curvatures, design_surfaces, part_path
from OCP.Bnd import Bnd_Box
from OCP.BRep import BRep_Tool
from OCP.BRepBndLib import BRepBndLib
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.gp import gp_Pnt
from solids import is_valid, volume
from step_file import read_step, step_text

from conflank_cli.job import load_job

FIT = 0.3e-3
"""The blisk's surfaces are bicubic fits, 0.2 µm at most from the formulas; and a margin. mm."""
GRID = np.linspace(0.0, 1.0, 23)


@pytest.fixture(scope="module")
def parts():
    return {name: read_step(part_path(name)) for name in PARTS}


def _points(face, u, v):
    """Points of the surface under a face of the file, (len(u), len(v), 3)."""
    surface = BRep_Tool.Surface_s(face)
    return np.array([[surface.Value(float(a), float(b)).Coord() for b in v] for a in u])


@pytest.mark.parametrize("name", PARTS)
def test_solids_are_valid_and_closed(parts, name):
    assert is_valid(parts[name].shape)
    assert volume(parts[name].shape) > 0.0


def test_blisk_faces_carry_their_names(parts):
    own = ["suction", "leading_edge", "pressure", "trailing_edge"]
    blade = [*own, *(f"fillet_{name}" for name in own), "tip"]
    wheel = ["hub", "hub_front", "hub_back", "hub_side_left", "hub_side_right", "bore"]
    expected = [name + suffix for suffix in ("", "_left", "_right") for name in blade] + wheel
    assert sorted(parts["blisk_blade"].names) == sorted(expected)


def test_impeller_faces_carry_their_names(parts):
    names = parts["impeller"].names
    assert "" not in names
    for suffix in ("", *(f"_{k}" for k in range(1, 8))):
        for name in ("pressure", "suction", "leading_edge", "trailing_edge"):
            assert names.count(name + suffix) == 1


@pytest.mark.parametrize("name", ["suction", "pressure", "leading_edge", "trailing_edge"])
def test_blisk_faces_are_the_analytic_blade_within_a_micrometre(parts, name):
    u, v = np.meshgrid(GRID, GRID, indexing="ij")
    patch = patches(BliskLaw())[name]
    for face, exact in ((name, patch.flank), (f"fillet_{name}", patch.blend)):
        points = _points(parts["blisk_blade"].face(face), GRID, GRID)
        assert np.linalg.norm(points - exact(u, v), axis=-1).max() < FIT


@pytest.mark.parametrize("name", ["suction", "pressure"])
def test_impeller_faces_are_the_analytic_blade_within_a_micrometre(parts, name):
    u, v = np.meshgrid(GRID, GRID, indexing="ij")
    points = _points(parts["impeller"].face(name), GRID, GRID)
    exact, _ = sides(ImpellerLaw())[name](u, v)
    assert np.linalg.norm(points - exact, axis=-1).max() < 1e-3


def test_fillet_is_what_a_ball_leaves_that_touches_hub_and_blade(parts):
    """The ball's centre has the distance 2 mm from the whole solid, as Open CASCADE measures it."""
    solid = parts["blisk_blade"].shape
    for name in ("suction", "pressure", "leading_edge", "trailing_edge"):
        points = _points(parts["blisk_blade"].face(f"fillet_{name}"), [0.1, 0.5, 0.8], [0.0, 0.5, 1.0])
        for hub, middle, blade in points:
            # The ball stands on the hub, above the fillet's lower border.
            centre = hub * np.array([62.0 / 60.0, 62.0 / 60.0, 1.0])
            assert np.linalg.norm(middle - centre) == pytest.approx(2.0, abs=FIT)
            assert np.linalg.norm(blade - centre) == pytest.approx(2.0, abs=FIT)
            vertex = BRepBuilderAPI_MakeVertex(gp_Pnt(*(float(value) for value in centre))).Vertex()
            assert BRepExtrema_DistShapeShape(vertex, solid).Value() == pytest.approx(2.0, abs=FIT)


@pytest.mark.parametrize(
    ("part", "first", "second"),
    [("blisk_blade", "suction", "pressure_right"), ("blisk_blade", "pressure", "suction_left"),
     ("impeller", "suction", "pressure_7"), ("impeller", "pressure", "suction_1")],
)  # fmt: skip
def test_a_cutter_of_six_millimetres_fits_between_the_blades(parts, part, first, second):
    gap = BRepExtrema_DistShapeShape(parts[part].face(first), parts[part].face(second)).Value()
    assert 8.0 < gap < 14.0


def test_impeller_fits_its_exit_cylinder(parts):
    box = Bnd_Box()
    BRepBndLib.AddOptimal_s(parts["impeller"].shape, box)
    low, high = np.array(box.CornerMin().Coord()), np.array(box.CornerMax().Coord())
    assert (high - low)[:2] == pytest.approx([120.0, 120.0], abs=1e-3)
    assert [low[2], high[2]] == pytest.approx([-3.0, 45.0], abs=1e-3)


@pytest.mark.parametrize(("part", "least"), [("blisk_blade", 0.95), ("impeller", 0.95)])
def test_flanks_are_saddle_shaped_and_smooth(part, least):
    """Mean and Gaussian curvature have no wiggle: their second differences along the grid stay far below their size."""
    grid = np.linspace(0.0, 1.0, 101)
    for (owner, _), surface in design_surfaces().items():
        if owner != part:
            continue
        low, high, element = curvatures(surface, grid, grid)
        assert np.sum(element * (low * high < 0.0)) / np.sum(element) > least
        # Not the principal curvatures: they have true kinks where they meet.
        for curvature in (low + high, low * high):
            size = np.ptp(curvature)
            for axis in (0, 1):
                assert np.abs(np.diff(curvature, n=2, axis=axis)).max() < 0.01 * size


def test_curvatures_of_the_fit_are_those_of_the_formula():
    """Gaussian curvature from the formula by finite differences of its exact normals: Weingarten's map."""
    law = ImpellerLaw()
    contact = side_contact(law, SUCTION)
    u, v = np.linspace(0.1, 0.9, 9), np.linspace(0.2, 0.8, 7)
    x, h = np.meshgrid(u, v, indexing="ij")
    step = 1e-5
    (px, nx), (qx, mx) = contact(x + step, h), contact(x - step, h)
    (ph, nh), (qh, mh) = contact(x, h + step), contact(x, h - step)
    normal = contact(x, h)[1]
    area = np.sum(np.cross(px - qx, ph - qh) * normal, axis=-1)
    exact = np.sum(np.cross(nx - mx, nh - mh) * normal, axis=-1) / area
    low, high, _ = curvatures(design_surfaces()["impeller", "suction"], u, v)
    assert np.abs(low * high - exact).max() < 0.02 * np.abs(exact).max()


def test_making_a_part_twice_gives_equal_bytes():
    first, second = (step_text(make_blisk_blade(BliskLaw()), "blisk_blade") for _ in range(2))
    assert first == second
    assert "2020-01-01T00:00:00" in first


def test_committed_file_has_the_volume_that_the_script_makes(parts):
    assert volume(make_blisk_blade(BliskLaw()).shape) == pytest.approx(volume(parts["blisk_blade"].shape), rel=1e-6)


@pytest.mark.parametrize(
    "job", sorted(Path(part_path("impeller")).parents[1].glob("*/*.toml")), ids=lambda path: path.stem
)
def test_jobs_name_faces_that_exist(parts, job):
    loaded = load_job(job)
    assert loaded.part.check_faces == "rest"
    for design in loaded.part.design:
        assert design.face in parts[job.parent.name].names
