"""From a job and its part to the scene: design faces with their regions cut out, and the check mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from conflank_cli import job as jobs
from conflank_cli.cad.loops import Box, bounds, clip, merge, rectangle, snap
from conflank_cli.cad.mesh import mesh_faces
from conflank_cli.cad.obstacles import read_obstacles
from conflank_cli.cad.part import FaceGeometry, Part, PartFace
from conflank_cli.cad.quadrature import trimmed_area
from conflank_cli.cad.reader import read_part
from conflank_cli.cad.triangulation import DEFLECTION_MM
from conflank_cli.errors import InputError
from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.once import Once
from conflank_cli.scene import Scene

Array = npt.NDArray[np.float64]

# A face below this area has no place for a cutter's contact line.
LEAST_AREA_MM2 = 1.0e-3
# Relative to the parameter box: points and lines nearer than this are the same.
SAME = 1.0e-9
WHOLE = (0.0, 1.0, 0.0, 1.0)


def load_scene(job: jobs.Job, folder: Path, part_of: Callable[[], Part] | None = None) -> Scene:
    """Read the part of a job and resolve everything that stages need; triangles are made when first asked for.

    Parameters
    ----------
    job: the job.
    folder: what the job's paths are relative to.
    part_of: where the part comes from (`KernelProcess.read`) unless it is to be read here.

    Raises
    ------
    InputError: as `read_part`, `resolve_faces`, `Part.to_check`, `read_obstacles` and `Job.resolved_tools`; as
        `check_mesh` whoever asks for the triangles.
    """
    tools = job.resolved_tools()
    part = read_part(folder / job.part.file, job.part.scale) if part_of is None else part_of()
    obstacles, hashes = read_obstacles(job, folder)
    return Scene(
        job,
        part.name,
        resolve_faces(part, job.part),
        tools,
        Once(partial(_with_obstacles, part, to_check(part, job.part), obstacles)),
        {part.file: part.sha256, **hashes},
    )


def resolve_faces(part: Part, wanted: jobs.Part) -> tuple[DesignFace, ...]:
    """The design faces of a job, in its order.

    Regions are fractions of the parameter box that `conflank inspect` prints, that of the B-spline form of the face. On
    a face that goes all the way round, a region may run across the seam (start > end, or fractions past 0 and 1).

    Raises
    ------
    InputError: no such face, a name that several have, a region of no extent or off the face, or a face of no area.
    """
    return tuple(_design_face(part, design, index) for index, design in enumerate(wanted.design))


def to_check(part: Part, wanted: jobs.Part) -> list[PartFace]:
    """The faces that nothing may touch.

    "rest" is every face that is not a design face; a face of which only a region is one is a design face.
    """
    return part.to_check([item.face for item in wanted.design], wanted.check_faces)


def check_mesh(part: Part, wanted: jobs.Part, deflection: float = DEFLECTION_MM) -> CheckMesh:
    """Triangles of the faces that nothing may touch, within `deflection` mm."""
    return mesh_faces(part, to_check(part, wanted), deflection)


def _with_obstacles(part: Part, faces: Sequence[PartFace], obstacles: CheckMesh) -> CheckMesh:
    return CheckMesh.joined([mesh_faces(part, faces, DEFLECTION_MM), obstacles])


def _place(index: int) -> str:
    return f"[[part.design]] {index}"


def _design_face(part: Part, design: jobs.Design, index: int) -> DesignFace:
    face = part.face(design.face, f"{_place(index)} face")
    where = f"{part.file}: face {face.number}"
    geometry = face.load()
    area = trimmed_area(geometry.surface, geometry.loops)
    if not area > LEAST_AREA_MM2:
        raise InputError(where, f"an area of {area:.2g} mm2", "a face with an area", "Choose another face.")
    surface, loops = geometry.surface, geometry.loops
    region = tuple(float(x) for x in design.region)
    if region != WHOLE:
        box = _region_box(geometry, region, f"{part.file}: {_place(index)} region")
        surface = geometry.sheet.unwrapped(box)
        loops = tuple(cut_region(geometry, box))
        area = trimmed_area(surface, loops)
        if not area > LEAST_AREA_MM2:
            raise InputError(
                f"{part.file}: {_place(index)} region",
                f"{list(region)}, which leaves {area:.2g} mm2 of face {face.number}",
                "a region that overlaps the trimmed face",
                "Widen the region.",
            )
    sense = face.orientation if design.side == "outside" else -face.orientation
    return DesignFace(face.number, face.name or face.colour, surface, loops, sense)


def _region_box(geometry: FaceGeometry, region: tuple[float, ...], where: str) -> Box:
    """The region as a parameter box; past the face's own box where it runs across a seam."""
    around = geometry.sheet.closes(geometry.box)
    result = []
    for axis, name in enumerate("uv"):
        start, end = region[2 * axis], region[2 * axis + 1]
        if not (np.isfinite(start) and np.isfinite(end)) or start == end:
            raise InputError(where, f"{name} from {start:g} to {end:g}", "a range with an extent", "Widen the region.")
        if around[axis]:
            if start > end:
                end += 1.0
            sound, expected = start < end <= start + 1.0 and start >= -1.0 and end <= 2.0, "one turn at most"
        else:
            sound = 0.0 <= start < end <= 1.0
            expected = f"0 <= start < end <= 1, because the face does not close in {name}"
        if not sound:
            raise InputError(where, f"{name} from {start:g} to {end:g}", expected, "Correct the region.")
        low, high = geometry.box[2 * axis], geometry.box[2 * axis + 1]
        result += [low + start * (high - low), low + end * (high - low)]
    return result[0], result[1], result[2], result[3]


def cut_region(geometry: FaceGeometry, box: Box) -> list[Array]:
    """Trim loops of the part of a face within a parameter box, copies across a seam joined."""
    u0, u1, v0, v1 = geometry.box
    around = geometry.sheet.closes(geometry.box)
    sizes = (u1 - u0, v1 - v0)
    tolerance = (SAME * sizes[0], SAME * sizes[1])
    if len(geometry.loops) == 1 and len(geometry.loops[0]) == 4 and _is_rectangle(geometry.loops[0], geometry.box):
        return [rectangle(box)]
    periods = (geometry.sheet.period_u or 0.0, geometry.sheet.period_v or 0.0)
    turns = [range(-2, 3) if closes else range(1) for closes in around]
    lines = [(0, box[0]), (0, box[1]), (1, box[2]), (1, box[3])]
    lines += [(0, u0 + k * periods[0]) for k in turns[0] if around[0]]
    lines += [(1, v0 + k * periods[1]) for k in turns[1] if around[1]]
    cut: list[Array] = []
    for turn_u in turns[0]:
        for turn_v in turns[1]:
            copies = [loop + np.array([turn_u * periods[0], turn_v * periods[1]]) for loop in geometry.loops]
            for axis in (0, 1):
                copies = snap(copies, axis, [x for along, x in lines if along == axis], tolerance[axis])
            cut += clip(copies, box)
    # Merged in units of the box, where one tolerance fits both directions.
    scaled = [(loop - (u0, v0)) / sizes for loop in cut]
    unit_lines = [(axis, (x - (u0, v0)[axis]) / sizes[axis]) for axis, x in lines]
    for axis in (0, 1):
        scaled = snap(scaled, axis, [x for along, x in unit_lines if along == axis], SAME)
    merged = merge(scaled, unit_lines, SAME)
    return [np.ascontiguousarray(loop * sizes + (u0, v0)) for loop in merged]


def _is_rectangle(loop: Array, box: Box) -> bool:
    """Whether a loop of four points is its whole box."""
    corners = rectangle(box)
    return bounds([loop]) == box and all(
        bool(np.any(np.all(np.isclose(loop, corner, rtol=0.0, atol=0.0), axis=1))) for corner in corners
    )
