"""Obstacles: meshes of fixtures and stock beside the job file, and what is odd about them."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from conflank_cli.errors import InputError
from conflank_cli.geometry.face import CheckMesh
from conflank_cli.geometry.face_mesh import open_edges
from conflank_cli.job import Job
from conflank_cli.scene import Scene

Array = npt.NDArray[np.float64]

SUFFIXES = (".stl", ".obj", ".ply", ".3mf")
# An obstacle so many times larger or smaller than the part is likely to be in another unit.
ODD_RATIO = 15.0
# How many times a length in another unit comes out too large or too small when it is taken for millimetres.
UNITS = {"inches": 25.4, "metres": 1000.0, "centimetres": 10.0, "micrometres": 1.0 / 1000.0}


def read_obstacles(job: Job, folder: Path) -> tuple[CheckMesh, dict[str, str]]:
    """All obstacles of a job as one mesh, obstacle k with the face number -1 - k, and SHA-256 by file name.

    They are in millimetres and in the frame of the CAD file; 3MF says its unit, and is converted.

    Raises
    ------
    InputError: a file is missing, of another kind, damaged, or holds no triangle.
    """
    meshes, hashes = [], {}
    for number, name in enumerate(job.obstacles.meshes):
        where = f"{name} ([obstacles] meshes)"
        path = folder / name
        if path.suffix.lower() not in SUFFIXES:
            raise InputError(
                where, f"a file that ends in {path.suffix!r}", f"one of {', '.join(SUFFIXES)}", "Convert it."
            )
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(
                where, f"no readable file ({error.strerror})", "a mesh beside the job file", "Check the name."
            ) from None
        hashes[name] = hashlib.sha256(data).hexdigest()
        vertices, triangles = _triangles(data, path.suffix.lower()[1:], where)
        meshes.append(CheckMesh(vertices, triangles, np.full(len(triangles), -1 - number, dtype=np.int32)))
    if not meshes:
        return CheckMesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int32), np.empty(0, dtype=np.int32)), {}
    return CheckMesh.joined(meshes), hashes


def with_obstacles(scene: Scene, job: Job, folder: Path) -> Scene:
    """The scene with the obstacles of a job instead of its own."""
    mesh, hashes = read_obstacles(job, folder)
    inputs: Mapping[str, str] = {
        **{name: digest for name, digest in scene.inputs.items() if name not in scene.job.obstacles.meshes},
        **hashes,
    }
    own = scene.check.only(scene.check.face >= 0)
    return replace(scene.checking(CheckMesh.joined([own, mesh])), inputs=inputs)


def obstacle_notes(scene: Scene) -> list[str]:
    """What a user should know of the obstacles: open, of another size than the part, out of any tool's reach."""
    notes: list[str] = []
    if not scene.job.obstacles.meshes:
        return notes
    faces = np.concatenate([face.surface.poles.reshape(-1, 3) for face in scene.faces])
    low, high = faces.min(axis=0), faces.max(axis=0)
    own = np.concatenate([faces, scene.check.only(scene.check.face >= 0).vertices])
    part = float(np.linalg.norm(np.ptp(own, axis=0)))
    reach = max(tool.top - tool.tip_height for tool in scene.tools)
    for number, name in enumerate(scene.job.obstacles.meshes):
        mesh = scene.check.only(scene.check.face == -1 - number)
        size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        edges = open_edges(mesh)
        if edges:
            notes.append(
                f"{name} is open ({edges} edges have no second triangle): distances to its surface hold, but what is "
                "inside of it cannot be told"
            )
        ratio = part / size
        if not 1.0 / ODD_RATIO <= ratio <= ODD_RATIO:
            unit = min(UNITS, key=lambda unit: abs(np.log(ratio / UNITS[unit])))
            notes.append(
                f"{name} measures {size:.4g} mm from corner to corner, the part {part:.4g} mm: it is taken to be in "
                f"millimetres, but may be in {unit}"
            )
        apart = np.maximum(np.maximum(mesh.vertices.min(axis=0) - high, low - mesh.vertices.max(axis=0)), 0.0)
        away = float(np.linalg.norm(apart))
        if away > reach:
            notes.append(
                f"{name} is {away:.4g} mm away from the design faces, further than any tool reaches while it cuts "
                f"({reach:.4g} mm): check its unit and its frame, which is that of the CAD file"
            )
    return notes


def _triangles(data: bytes, kind: str, where: str) -> tuple[Array, npt.NDArray[np.int32]]:
    """Vertices (N, 3) in mm and triangles (M, 3) of a mesh file, vertices at the same place merged."""
    import trimesh

    try:
        loaded: Any = trimesh.load_scene(io.BytesIO(data), file_type=kind)
        if kind == "3mf" and loaded.units not in (None, "mm", "millimeter", "millimeters"):
            loaded = loaded.convert_units("mm")
        mesh = loaded.to_mesh()
    except ModuleNotFoundError as error:
        raise InputError(
            where, f"a file that needs {error.name} to be read", "that package", 'Run: pip install "conflank[3mf]"'
        ) from None
    except Exception as error:  # trimesh raises whatever its readers stumble over
        raise InputError(
            where, f"a {kind.upper()} file that cannot be read ({error})", "a mesh of triangles", "Export it again."
        ) from None
    vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    triangles = np.asarray(mesh.faces, dtype=np.int32).reshape(-1, 3)
    if not len(triangles):
        raise InputError(where, "no triangle", "a mesh of triangles", "Export it again.")
    if not np.all(np.isfinite(vertices)) or not np.any(np.ptp(vertices, axis=0) > 0.0):
        raise InputError(where, "vertices that are not finite, or all at one place", "a solid body", "Export it again.")
    return np.ascontiguousarray(vertices), np.ascontiguousarray(triangles)
