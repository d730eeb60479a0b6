"""Meshes of fixtures: formats, what is odd about them, and their way through artifacts and stages."""

from __future__ import annotations

import io
import zipfile
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from conflank_cli.artifacts.npz import decode_artifact, encode_artifact
from conflank_cli.cad.obstacles import obstacle_notes, read_obstacles, with_obstacles
from conflank_cli.errors import InputError
from conflank_cli.job import Design, Job, Obstacles, Part, Tools
from tests.verification.scenes import plane_face, scene_of, triangles_of


def job_of(*meshes: str) -> Job:
    return Job(part=Part("part.step", (Design(0),)), tools=Tools(("T1",)), obstacles=Obstacles(meshes))


def block(size: float = 20.0, at: tuple[float, float, float] = (0.0, 0.0, -30.0)) -> trimesh.Trimesh:
    body = trimesh.creation.box((size, size, size))
    body.apply_translation(at)
    return body


def scene_with(folder, *meshes):
    """A plate of 60 by 60, a wall beside it, and obstacles."""
    names = []
    for k, (mesh, suffix) in enumerate(meshes):
        names.append(f"body{k}{suffix}")
        mesh.export(folder / names[-1])
    wall = triangles_of([(0.0, 0.0, 0.0), (60.0, 0.0, 0.0), (60.0, 0.0, -9.0), (0.0, 0.0, -9.0)])
    scene = scene_of(plane_face((0.0, 60.0), (0.0, 60.0)), check=wall)
    job = job_of(*names)
    return replace(with_obstacles(scene, job, folder), job=job)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".3mf", ".STL"])
def test_formats(tmp_path, suffix) -> None:
    block().export(tmp_path / f"block{suffix.lower()}")
    (tmp_path / f"block{suffix.lower()}").rename(tmp_path / f"block{suffix}")
    mesh, hashes = read_obstacles(job_of(f"block{suffix}"), tmp_path)
    assert len(mesh.vertices) == 8 and len(mesh.triangles) == 12
    assert np.all(mesh.face == -1)
    np.testing.assert_allclose([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], [[-10, -10, -40], [10, 10, -20]])
    assert len(hashes[f"block{suffix}"]) == 64


def test_3mf_says_its_unit(tmp_path) -> None:
    with zipfile.ZipFile(io.BytesIO(block().export(file_type="3mf"))) as made:
        parts = {name: made.read(name) for name in made.namelist()}
    with zipfile.ZipFile(tmp_path / "block.3mf", "w") as written:
        for name, content in parts.items():
            written.writestr(name, content.replace(b'unit="millimeter"', b'unit="inch"'))
    mesh, _ = read_obstacles(job_of("block.3mf"), tmp_path)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx([20.0 * 25.4] * 3)


def test_obstacles_are_told_apart_and_travel_with_artifacts(tmp_path) -> None:
    scene = scene_with(tmp_path, (block(), ".stl"), (block(at=(50.0, 0.0, -30.0)), ".ply"))
    assert sorted(set(scene.check.face.tolist())) == [-2, -1, 9]
    assert set(scene.inputs) == {"body0.stl", "body1.ply"}
    data = encode_artifact("candidates", scene, [], {})
    _, again, _, _ = decode_artifact(data, "again")
    np.testing.assert_array_equal(again.check.face, scene.check.face)
    np.testing.assert_array_equal(again.check.vertices, scene.check.vertices)
    # Another job's obstacles replace these, and nothing else.
    without = with_obstacles(scene, job_of(), tmp_path)
    assert set(without.check.face.tolist()) == {9} and without.inputs == {}


def test_a_sound_fixture_is_not_spoken_of(tmp_path) -> None:
    assert obstacle_notes(scene_with(tmp_path, (block(), ".stl"))) == []


def test_an_open_mesh_is(tmp_path) -> None:
    body = block()
    body.update_faces(np.arange(12) > 1)
    (note,) = obstacle_notes(scene_with(tmp_path, (body, ".stl")))
    assert "body0.stl is open (4 edges" in note


@pytest.mark.parametrize(("scale", "unit"), [(1.0 / 25.4, "inches"), (1.0 / 1000.0, "metres"), (1000.0, "micrometres")])
def test_another_unit_is_guessed(tmp_path, scale, unit) -> None:
    body = block(60.0)
    body.apply_scale(scale)
    notes = obstacle_notes(scene_with(tmp_path, (body, ".stl")))
    assert any(unit in note and "body0.stl measures" in note for note in notes), notes


def test_far_away(tmp_path) -> None:
    notes = obstacle_notes(scene_with(tmp_path, (block(at=(0.0, 0.0, -900.0)), ".stl")))
    assert len(notes) == 1 and "890 mm away" in notes[0]


@pytest.mark.parametrize(
    ("name", "content", "found"),
    [
        ("no.stl", None, "no readable file"),
        ("block.step", b"", "ends in '.step'"),
        ("block.stl", b"solid x\nendsolid x\n", "no triangle"),
        ("block.ply", b"rubbish", "cannot be read"),
        ("block.3mf", b"rubbish", "cannot be read"),
        ("flat.obj", b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "all at one place"),
    ],
)
def test_bad_meshes(tmp_path, name, content, found) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as error:
        read_obstacles(job_of(name), tmp_path)
    assert name in error.value.where and found in error.value.found
