"""From a job and its part to the scene: design faces with their regions cut out, and the check mesh."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
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
    checked = to_check(part, job.part)
    return Scene(
        job,
        part.name,
        resolve_faces(part, job.part),
        tools,
        Once(partial(_with_obstacles, part, checked, obstacles)),
        {part.file: part.sha256, **hashes},
        rest_of_faces(part, job.part),
        Once(partial(_surfaces, checked)),
    )


def resolve_faces(part: Part, wanted: jobs.Part) -> tuple[DesignFace, ...]:
    """The design faces of a job, in its order.

    Regions are fractions of the parameter box that `conflank inspect` prints, that of the B-spline form of the face. On
    a face that goes all the way round, a region may run across the seam (start > end, or fractions past 0 and 1).

    Raises
    ------
    InputError: no such face, a name that several have, a region of no extent or off the face, a face of no area, or
        regions of one face that overlap.
    """
    faces = tuple(_design_face(part, design, index) for index, design in enumerate(wanted.design))
    _refuse_overlaps(part, wanted)
    return faces


def rest_of_faces(part: Part, wanted: jobs.Part) -> tuple[DesignFace, ...]:
    """What is left of the design faces outside all their regions, in pieces; nothing where no face is checked.

    Raises
    ------
    InputError: as `resolve_faces`.
    """
    if wanted.check_faces == "none":
        return ()
    first: dict[int, tuple[int, jobs.Design]] = {}
    regions: dict[int, list[Box]] = {}
    for index, design in enumerate(wanted.design):
        face = part.face(design.face, f"{_place(index)} face")
        first.setdefault(face.number, (index, design))
        regions.setdefault(face.number, []).extend(_fractions(part, design, index))
    pieces = []
    for number, (_, design) in first.items():
        face, geometry = part.faces[number], part.faces[number].load()
        u0, u1, v0, v1 = geometry.box
        for a, b, c, d in _outside(regions[number]):
            box = (u0 + a * (u1 - u0), u0 + b * (u1 - u0), v0 + c * (v1 - v0), v0 + d * (v1 - v0))
            surface, loops = geometry.sheet.unwrapped(box), tuple(cut_region(geometry, box))
            if loops and trimmed_area(surface, loops) > LEAST_AREA_MM2:
                sense = face.orientation if design.side == "outside" else -face.orientation
                pieces.append(DesignFace(number, face.name or face.colour, surface, loops, sense))
    return tuple(pieces)


def to_check(part: Part, wanted: jobs.Part) -> list[PartFace]:
    """The faces that nothing may touch.

    "rest" is every face that is not a design face; a face of which only a region is one is a design face, and what is
    left of it is checked as `rest_of_faces` gives it.
    """
    return part.to_check([item.face for item in wanted.design], wanted.check_faces)


def check_mesh(part: Part, wanted: jobs.Part, deflection: float = DEFLECTION_MM) -> CheckMesh:
    """Triangles of the faces that nothing may touch, within `deflection` mm."""
    return mesh_faces(part, to_check(part, wanted), deflection)


def _with_obstacles(part: Part, faces: Sequence[PartFace], obstacles: CheckMesh) -> CheckMesh:
    return CheckMesh.joined([mesh_faces(part, faces, DEFLECTION_MM), obstacles])


def _surfaces(faces: Sequence[PartFace]) -> tuple[DesignFace, ...]:
    """The CAD surfaces of faces that nothing may touch, of those that have a sound one."""
    found = []
    for face in faces:
        try:
            geometry = face.load()
        except InputError:
            # Its triangles are checked, with what they may be off it held against the cutter.
            continue
        found.append(
            DesignFace(face.number, face.name or face.colour, geometry.surface, geometry.loops, face.orientation)
        )
    return tuple(found)


def _refuse_overlaps(part: Part, wanted: jobs.Part) -> None:
    """Refuse a job that has the same place of a face twice: it would be cut twice."""
    seen: dict[int, list[tuple[int, Box]]] = {}
    for index, design in enumerate(wanted.design):
        number = part.face(design.face, f"{_place(index)} face").number
        own = _fractions(part, design, index)
        for other, box in seen.get(number, []):
            if any(_overlap(box, each) for each in own):
                raise InputError(
                    f"{part.file}: {_place(index)}",
                    f"face {number}, which {_place(other)} has already, over the same region",
                    "each part of a face once",
                    "Remove one of the two tables, or give them regions that do not overlap.",
                )
        seen.setdefault(number, []).extend((index, box) for box in own)


def _fractions(part: Part, design: jobs.Design, index: int) -> list[Box]:
    """A region as boxes within the unit square, in fractions of the face's parameter box: several across a seam."""
    face = part.face(design.face, f"{_place(index)} face")
    geometry = face.load()
    low_u, high_u, low_v, high_v = _region_box(geometry, design.region, f"{part.file}: {_place(index)} region")
    u0, u1, v0, v1 = geometry.box
    along_u = _turns((low_u - u0) / (u1 - u0), (high_u - u0) / (u1 - u0))
    along_v = _turns((low_v - v0) / (v1 - v0), (high_v - v0) / (v1 - v0))
    return [(a, b, c, d) for a, b in along_u for c, d in along_v]


def _turns(start: float, end: float) -> list[tuple[float, float]]:
    """A range of fractions, of one turn at most, brought into 0 to 1."""
    pieces = [(max(start - k, 0.0), min(end - k, 1.0)) for k in (-1, 0, 1)]
    return [(a, b) for a, b in pieces if b - a > SAME]


def _overlap(one: Box, other: Box) -> bool:
    return all(min(one[k + 1], other[k + 1]) - max(one[k], other[k]) > SAME for k in (0, 2))


def _outside(regions: Sequence[Box]) -> list[Box]:
    """Boxes that fill the unit square outside of other boxes."""
    cuts = np.unique([0.0, 1.0, *(x for box in regions for x in box[:2])])
    found: list[Box] = []
    for a, b in pairwise(cuts.tolist()):
        if b - a <= SAME:
            continue
        taken = sorted((box[2], box[3]) for box in regions if _overlap(box, (a, b, 0.0, 1.0)))
        reached = 0.0
        for low, high in [*taken, (1.0, 1.0)]:
            if low - reached > SAME:
                found.append((a, b, reached, low))
            reached = max(reached, high)
    return found


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
