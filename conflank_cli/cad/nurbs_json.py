"""NURBS surfaces as JSON, for parts that come from a script and not from CAD.

::

    {"unit": "mm",                        optional: "mm" (default), "cm", "m" or "inch"
     "faces": [
       {"name": "pressure side",          optional
        "degree_u": 3, "degree_v": 1,
        "knots_u": [0, 0, 0, 0, 1, 1, 1, 1], "knots_v": [0, 0, 1, 1],
        "poles": [[[x, y, z], ...], ...], poles[i][j]: i along u, j along v
        "weights": [[w, ...], ...],       optional, all > 0
        "periodic_u": false,              optional, and periodic_v
        "trim": [[[u, v], ...], ...],     optional: closed polylines, first point not repeated; even-odd rule
        "outside": "along"}]}             optional: out of the metal is "along" or "against" S_u x S_v, or "unknown"

n poles of degree p in a direction take n + p + 1 knots, which need not be clamped; the parameter range is from knot p
to knot n. A periodic direction takes n + 1 knots, one period: pole i belongs to the basis function that starts at
knot i, knot i + n is knot i plus the period, and the parameter range is the period. A knot repeats at most p times
inside the range and p + 1 times at its ends.
"""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import Literal

import msgspec
import numpy as np
import numpy.typing as npt

from conflank_cli.cad.loops import bounds, clip, rectangle, tidy
from conflank_cli.cad.part import FaceGeometry, PartFace
from conflank_cli.cad.sheet import Sheet, clamp, close_smooth_seams, merge_near_knots
from conflank_cli.errors import InputError

Array = npt.NDArray[np.float64]

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}


class FaceKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One face, as the module's text says."""

    degree_u: int
    degree_v: int
    knots_u: list[float]
    knots_v: list[float]
    poles: list[list[tuple[float, float, float]]]
    name: str = ""
    weights: list[list[float]] | None = None
    periodic_u: bool = False
    periodic_v: bool = False
    trim: list[list[tuple[float, float]]] | None = None
    outside: Literal["along", "against", "unknown"] = "unknown"


class FileKeys(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The whole file, as the module's text says."""

    faces: list[FaceKeys]
    unit: Literal["mm", "cm", "m", "inch"] = "mm"


def parse_faces(data: bytes, file: str, scale: float) -> tuple[PartFace, ...]:
    """Faces of a JSON file, checked to the last number.

    Raises
    ------
    InputError: no JSON, unknown or missing keys, wrong counts, knots that decrease or repeat too often, weights that
        are not positive, numbers that are not finite, trim loops without extent, no faces.
    """
    try:
        keys = msgspec.json.decode(data, type=FileKeys)
    except msgspec.ValidationError as error:
        text, _, place = str(error).partition(" - at `")
        raise InputError(
            f"{file}: {place.strip('`$.') or 'top level'}",
            text[0].lower() + text[1:],
            "the keys that conflank_cli.cad.nurbs_json describes",
            "Correct the key.",
        ) from None
    except msgspec.DecodeError as error:
        raise InputError(
            file, f"text that is no JSON ({error})", "a JSON file", "Correct the place it names."
        ) from None
    if not keys.faces:
        raise InputError(f"{file}: faces", "an empty list", "at least one face", "Add a face.")
    factor = scale * UNITS_MM[keys.unit]
    faces = []
    for number, face in enumerate(keys.faces):
        geometry = _geometry(face, f"{file}: faces[{number}]", factor)
        faces.append(
            PartFace(
                number,
                face.name,
                "",
                "bspline",
                face.outside != "unknown",
                -1 if face.outside == "against" else 1,
                partial(_same, geometry),
            )
        )
    return tuple(faces)


def _same(geometry: FaceGeometry) -> FaceGeometry:
    return geometry


def _geometry(face: FaceKeys, where: str, factor: float) -> FaceGeometry:
    count_u = len(face.poles)
    count_v = len(face.poles[0]) if face.poles else 0
    if any(len(row) != count_v for row in face.poles):
        raise InputError(f"{where}.poles", "rows of different length", "rows of one length", "Complete the rows.")
    poles = np.array(face.poles, dtype=np.float64).reshape(count_u, count_v, 3) * factor
    if not np.all(np.isfinite(poles)):
        raise InputError(f"{where}.poles", "a number that is not finite", "finite numbers", "Correct it.")
    values = poles
    if face.weights is not None:
        if len(face.weights) != count_u or any(len(row) != count_v for row in face.weights):
            raise InputError(
                f"{where}.weights", "another shape than that of the poles", f"{count_u} x {count_v}", "Correct it."
            )
        weights = np.array(face.weights, dtype=np.float64)
        if not (np.all(np.isfinite(weights)) and np.all(weights > 0.0)):
            worst = float(np.min(np.where(np.isfinite(weights), weights, -np.inf)))
            raise InputError(f"{where}.weights", f"weight {worst:g}", "weights > 0", "Correct it.")
        values = np.concatenate([poles * weights[..., None], weights[..., None]], axis=2)
    knots_u = _knots(face.knots_u, face.degree_u, count_u, face.periodic_u, f"{where}", "u")
    knots_v = _knots(face.knots_v, face.degree_v, count_v, face.periodic_v, f"{where}", "v")
    if not face.periodic_u:
        low, high = float(knots_u[face.degree_u]), float(knots_u[-face.degree_u - 1])
        knots_u, values = clamp(knots_u, face.degree_u, values, low, high)
    if not face.periodic_v:
        low, high = float(knots_v[face.degree_v]), float(knots_v[-face.degree_v - 1])
        knots_v, turned = clamp(knots_v, face.degree_v, values.swapaxes(0, 1), low, high)
        values = turned.swapaxes(0, 1)
    sheet_weights = np.ascontiguousarray(values[..., 3]) if face.weights is not None else None
    sheet = Sheet(
        face.degree_u,
        face.degree_v,
        knots_u,
        knots_v,
        np.ascontiguousarray(values if sheet_weights is None else values[..., :3] / sheet_weights[..., None]),
        sheet_weights,
        float(knots_u[-1] - knots_u[0]) if face.periodic_u else None,
        float(knots_v[-1] - knots_v[0]) if face.periodic_v else None,
    )
    domain = sheet.domain
    sheet = close_smooth_seams(sheet)
    loops = _loops(face, sheet, domain, f"{where}.trim")
    box = bounds(loops)
    edges = 4 if face.trim is None else sum(len(loop) for loop in face.trim)
    return FaceGeometry(sheet, sheet.unwrapped(box), loops, box, edges)


def _knots(given: list[float], degree: int, poles: int, periodic: bool, where: str, direction: str) -> Array:
    """Knots of one direction, checked."""
    if degree < 1:
        raise InputError(f"{where}.degree_{direction}", str(degree), "a degree >= 1", "Correct it.")
    place = f"{where}.knots_{direction}"
    if poles < (2 if periodic else degree + 1):
        raise InputError(
            f"{where}.poles", f"{poles} along {direction}", f"at least {degree + 1} for degree {degree}", "Add poles."
        )
    wanted = poles + 1 if periodic else poles + degree + 1
    if len(given) != wanted:
        kind = "periodic " if periodic else ""
        raise InputError(
            place,
            f"{len(given)} knots",
            f"{wanted} for {poles} poles of {kind}degree {degree}",
            "Correct knots, poles, or degree.",
        )
    knots = np.array(given, dtype=np.float64)
    if not np.all(np.isfinite(knots)):
        raise InputError(place, "a number that is not finite", "finite numbers", "Correct it.")
    for i, (a, b) in enumerate(pairwise(knots)):
        if b < a:
            raise InputError(place, f"{b:g} after {a:g} at index {i + 1}", "knots that never decrease", "Sort them.")
    low, high = (knots[0], knots[-1]) if periodic else (knots[degree], knots[-degree - 1])
    if not low < high:
        raise InputError(place, "a parameter range of no length", "a range > 0", "Correct the knots.")
    knots = merge_near_knots(knots)
    distinct, counts = np.unique(knots, return_counts=True)
    if periodic:
        counts[0] += counts[-1] - 1
        counts[-1] = 1
    for x, count in zip(distinct, counts, strict=True):
        most = degree + (not periodic and (x <= low or x >= high))
        if count > most:
            raise InputError(place, f"{x:g} repeated {count} times", f"at most {most} times there", "Remove some.")
    return knots


def _loops(face: FaceKeys, sheet: Sheet, domain: tuple[float, float, float, float], where: str) -> tuple[Array, ...]:
    """Trim loops, clipped to the domain in directions without period."""
    if face.trim is None:
        return (rectangle(domain),)
    loops = []
    for k, points in enumerate(face.trim):
        loop = np.array(points, dtype=np.float64).reshape(-1, 2)
        if not np.all(np.isfinite(loop)):
            raise InputError(f"{where}[{k}]", "a number that is not finite", "finite numbers", "Correct it.")
        u0, u1, v0, v1 = domain
        if sheet.period_u is not None:
            u0, u1 = min(u0, float(loop[:, 0].min())), max(u1, float(loop[:, 0].max()))
        if sheet.period_v is not None:
            v0, v1 = min(v0, float(loop[:, 1].min())), max(v1, float(loop[:, 1].max()))
        clipped = [tidy(part, 0.0) for part in clip([loop], (u0, u1, v0, v1))]
        kept = [part for part in clipped if len(part) >= 3 and np.all(np.ptp(part, axis=0) > 0.0)]
        if not kept:
            raise InputError(
                f"{where}[{k}]",
                "a loop that encloses nothing of the surface",
                "a closed polyline within the parameter range",
                "Correct its points, or leave the trim out.",
            )
        loops.extend(kept)
    if not loops:
        raise InputError(where, "an empty list", "at least one loop", "Leave the key out for an untrimmed face.")
    return tuple(loops)
