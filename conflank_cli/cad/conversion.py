"""From faces of the CAD kernel to sheets and trim loops.

Analytic surfaces become exact rational B-splines. Their angles are not the B-spline's parameter inside a span, so trim
curves are carried over by `ParameterMap`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from conflank_cli.cad.loops import SAME_POINT, bounds, clip, rectangle, tidy
from conflank_cli.cad.part import FaceGeometry
from conflank_cli.cad.pcurves import ParameterCurve, chain, polylines
from conflank_cli.cad.sheet import Box, Sheet, clamp, close_smooth_seams, merge_near_knots
from conflank_cli.errors import InputError

Array = npt.NDArray[np.float64]

# Share of the face's parameter box by which an unbounded analytic surface is handed out larger than the face.
MARGIN = 0.25
# A conversion is exact when it agrees within this share of the face's size; an approximated one within these mm.
EXACT = 1.0e-9
APPROXIMATE_MM = 1.0e-5
# Where conversions are compared, as fractions of the parameter box: at a few places for a closed form, which holds or
# does not, at many for a fit.
SAMPLES = np.array([0.0, 0.07, 0.21, 0.43, 0.58, 0.83, 1.0])
FIT_SAMPLES = np.linspace(0.0, 1.0, 42)
# Chords a B-spline trim curve starts with.
MOST_STOPS = 64

KINDS = {
    "GeomAbs_Plane": "plane",
    "GeomAbs_Cylinder": "cylinder",
    "GeomAbs_Cone": "cone",
    "GeomAbs_Sphere": "sphere",
    "GeomAbs_Torus": "torus",
    "GeomAbs_BezierSurface": "bezier",
    "GeomAbs_BSplineSurface": "bspline",
    "GeomAbs_SurfaceOfRevolution": "revolution",
    "GeomAbs_SurfaceOfExtrusion": "extrusion",
    "GeomAbs_OffsetSurface": "offset",
}


@dataclass(frozen=True, slots=True)
class ParameterMap:
    """From the parameter of the kernel's surface to that of the B-spline, in one direction.

    Attributes
    ----------
    shift: whole turns by which the kernel moved the parameter of a periodic surface when it cut it.
    arcs: ends of the circular arcs, where the parameter is an angle; None where both parameters are the same.
    """

    shift: float = 0.0
    arcs: Array | None = None

    def __call__(self, x: Array) -> Array:
        """Map parameters (N,).

        A quadratic rational arc of angle 2 delta in standard form runs through tan(angle / 2) in proportion to its
        parameter, both from the middle of the arc.
        """
        x = x + self.shift
        if self.arcs is None:
            return x
        first, last = self.arcs[0], self.arcs[-1]
        turn = np.zeros_like(x)
        if abs(last - first - 2.0 * np.pi) < 1.0e-9:
            turn = np.floor((x - first) / (last - first)) * (last - first)
        angle = x - turn
        k = np.clip(np.searchsorted(self.arcs, angle, side="right") - 1, 0, len(self.arcs) - 2)
        middle = 0.5 * (self.arcs[k] + self.arcs[k + 1])
        half = 0.5 * (self.arcs[k + 1] - self.arcs[k])
        return np.asarray(turn + middle + half * np.tan(0.5 * (angle - middle)) / np.tan(0.5 * half))


def surface_kind(face: Any) -> str:
    """The kind of surface under a face, in our words."""
    from OCP.BRepAdaptor import BRepAdaptor_Surface

    return KINDS.get(str(BRepAdaptor_Surface(face, False).GetType()).rsplit(".", 1)[-1], "other")


def convert_face(face: Any, scale: float, where: str) -> FaceGeometry:
    """Geometry of a TopoDS_Face.

    Raises
    ------
    InputError: no surface, poles that are no numbers, or no area.
    """
    from OCP.BRep import BRep_Tool
    from OCP.TopAbs import TopAbs_FORWARD
    from OCP.TopoDS import TopoDS

    # Oriented forward, so that each edge of a seam yields its own parameter curve.
    face = TopoDS.Face(face.Oriented(TopAbs_FORWARD))
    surface = BRep_Tool.Surface_s(face)
    if surface is None:
        raise InputError(where, "a face without a surface", "a face with a surface", "Export the part again.")
    spline, sheet, map_u, map_v = _convert_surface(face, surface, where)
    poles = sheet.poles * scale
    if not np.all(np.isfinite(poles)) or (sheet.weights is not None and not np.all(sheet.weights > 0.0)):
        raise InputError(
            where, "control points or weights that are no numbers", "finite ones", "Export the part again."
        )
    sheet = close_smooth_seams(
        Sheet(
            sheet.degree_u,
            sheet.degree_v,
            sheet.knots_u,
            sheet.knots_v,
            poles,
            sheet.weights,
            sheet.period_u,
            sheet.period_v,
        )
    )
    loops, edges = _trim_loops(face, sheet, map_u, map_v, _tangents(spline, sheet, scale), where)
    box = bounds(loops)
    return FaceGeometry(sheet, sheet.unwrapped(box), loops, box, edges)


def _convert_surface(face: Any, surface: Any, where: str) -> tuple[Any, Sheet, ParameterMap, ParameterMap]:
    """The kernel's B-spline surface, the sheet of it (not scaled yet), and the way to their parameters."""
    from OCP.Geom import Geom_BSplineSurface, Geom_RectangularTrimmedSurface
    from OCP.GeomConvert import GeomConvert

    while isinstance(surface, Geom_RectangularTrimmedSurface):
        surface = surface.BasisSurface()
    if isinstance(surface, Geom_BSplineSurface):
        return surface, _sheet(surface), ParameterMap(), ParameterMap()
    bounded, shifts = _bounded(face, surface, where)
    exact = GeomConvert.SurfaceToBSplineSurface_s(bounded)
    size = _size(bounded)
    for arcs_u in _arcs(exact, "U"):
        for arcs_v in _arcs(exact, "V"):
            if _difference(bounded, exact, ParameterMap(0.0, arcs_u), ParameterMap(0.0, arcs_v)) <= EXACT * size:
                return exact, _sheet(exact), ParameterMap(shifts[0], arcs_u), ParameterMap(shifts[1], arcs_v)
    fit = _approximate(bounded, where)
    return fit, _sheet(fit), ParameterMap(shifts[0]), ParameterMap(shifts[1])


def _arcs(surface: Any, direction: str) -> list[Array | None]:
    """What the conversion may have done to the parameter; a comparison of points decides."""
    knots = [getattr(surface, f"{direction}Knot")(i + 1) for i in range(getattr(surface, f"Nb{direction}Knots")())]
    # Only arcs below half a turn have the standard form.
    if getattr(surface, f"{direction}Degree")() == 2 and np.max(np.diff(knots)) < np.pi:
        return [None, np.array(knots)]
    return [None]


def _bounded(face: Any, surface: Any, where: str) -> tuple[Any, tuple[float, float]]:
    """The surface cut to the face's parameter box and a margin; a whole turn where the face takes most of one.

    Also says by how much the kernel moved each parameter, which it likes to have between 0 and the period.
    """
    from OCP.BRepTools import BRepTools
    from OCP.Geom import Geom_ConicalSurface, Geom_RectangularTrimmedSurface

    box = list(BRepTools.UVBounds_s(face))
    if not np.all(np.isfinite(box)) or max(abs(x) for x in box) > 1.0e9:
        raise InputError(where, "a face without bounds", "a face that its edges bound", "Trim the face in CAD.")
    limits = list(surface.Bounds())
    for axis, periodic in enumerate((surface.IsUPeriodic(), surface.IsVPeriodic())):
        low, high = box[2 * axis], box[2 * axis + 1]
        margin = MARGIN * (high - low)
        if periodic:
            period = surface.UPeriod() if axis == 0 else surface.VPeriod()
            if high - low + 2.0 * margin > 0.9 * period:
                # The kernel makes nothing of a turn that begins at -1e-13.
                low = limits[2 * axis] if abs(low - limits[2 * axis]) < SAME_POINT * period else low
                high, margin = low + period, 0.0
            low, high = low - margin, high + margin
        else:
            low, high = max(low - margin, limits[2 * axis]), min(high + margin, limits[2 * axis + 1])
        box[2 * axis], box[2 * axis + 1] = low, high
    if isinstance(surface, Geom_ConicalSurface):
        # Past its apex a cone turns inside out.
        apex = -surface.RefRadius() / np.sin(surface.SemiAngle())
        face_box = BRepTools.UVBounds_s(face)
        if box[2] < apex <= face_box[2] + SAME_POINT:
            box[2] = apex
        if box[3] > apex >= face_box[3] - SAME_POINT:
            box[3] = apex
    if not (box[0] < box[1] and box[2] < box[3]):
        raise InputError(where, "a face of no area", "a face with an area", "Remove the face in CAD.")
    cut = Geom_RectangularTrimmedSurface(surface, *(float(x) for x in box))
    bounds_cut = cut.Bounds()
    return cut, (bounds_cut[0] - box[0], bounds_cut[2] - box[2])


def _samples(surface: Any, fractions: Array) -> tuple[list[float], list[float]]:
    u0, u1, v0, v1 = surface.Bounds()
    u, v = np.meshgrid(u0 + fractions * (u1 - u0), v0 + fractions * (v1 - v0), indexing="ij")
    return u.ravel().tolist(), v.ravel().tolist()


def _difference(
    original: Any, converted: Any, map_u: ParameterMap, map_v: ParameterMap, fractions: Array = SAMPLES
) -> float:
    """Largest distance between equal parameters, mm."""
    u, v = _samples(original, fractions)
    pairs = zip(u, v, map_u(np.array(u)).tolist(), map_v(np.array(v)).tolist(), strict=True)
    return float(max(original.Value(a, b).Distance(converted.Value(c, d)) for a, b, c, d in pairs))


def _size(surface: Any) -> float:
    u, v = _samples(surface, SAMPLES)
    points = [surface.Value(a, b) for a, b in zip(u, v, strict=True)]
    return float(max(points[0].Distance(point) for point in points))


def _approximate(surface: Any, where: str) -> Any:
    """A surface without exact B-spline form (most offsets), parameter for parameter."""
    from OCP.GeomAbs import GeomAbs_C1
    from OCP.GeomConvert import GeomConvert_ApproxSurface

    # With C2 the kernel's fit is micrometres off and says it is not; an offset of a cubic net is only C1 at its knots.
    fit = GeomConvert_ApproxSurface(surface, APPROXIMATE_MM, GeomAbs_C1, GeomAbs_C1, 9, 9, 200, 0)
    same = ParameterMap()
    error = _difference(surface, fit.Surface(), same, same, FIT_SAMPLES) if fit.HasResult() else np.inf
    if not error <= 10.0 * APPROXIMATE_MM:
        raise InputError(
            where,
            f"a surface that a B-spline meets only within {error:.2g} mm",
            f"a surface with a B-spline form within {10.0 * APPROXIMATE_MM:g} mm",
            "Export it as a B-spline.",
        )
    return fit.Surface()


def _sheet(surface: Any) -> Sheet:
    """A Geom_BSplineSurface as a sheet."""
    count_u, count_v = surface.NbUPoles(), surface.NbVPoles()
    table = surface.Poles()
    poles = np.array(
        [
            [(p.X(), p.Y(), p.Z()) for p in (table.Value(i, j) for j in range(1, count_v + 1))]
            for i in range(1, count_u + 1)
        ]
    )
    weights = None
    if surface.IsURational() or surface.IsVRational():
        weights = np.array([[surface.Weight(i, j) for j in range(1, count_v + 1)] for i in range(1, count_u + 1)])
    degree_u, degree_v = surface.UDegree(), surface.VDegree()
    values = poles if weights is None else np.concatenate([poles * weights[..., None], weights[..., None]], axis=2)
    knots_u, values, period_u = _direction(surface, "U", degree_u, values)
    knots_v, turned, period_v = _direction(surface, "V", degree_v, values.swapaxes(0, 1))
    values = turned.swapaxes(0, 1)
    if weights is not None:
        weights = np.ascontiguousarray(values[..., 3])
        values = values[..., :3] / weights[..., None]
    return Sheet(degree_u, degree_v, knots_u, knots_v, np.ascontiguousarray(values), weights, period_u, period_v)


def _direction(surface: Any, name: str, degree: int, values: Array) -> tuple[Array, Array, float | None]:
    """Knots and coefficients of one direction in the form of `Sheet`."""
    distinct = [getattr(surface, f"{name}Knot")(i + 1) for i in range(getattr(surface, f"Nb{name}Knots")())]
    repeats = [getattr(surface, f"{name}Multiplicity")(i + 1) for i in range(len(distinct))]
    if not getattr(surface, f"Is{name}Periodic")():
        knots = merge_near_knots(np.repeat(distinct, repeats))
        knots, values = clamp(knots, degree, values, float(knots[degree]), float(knots[-degree - 1]))
        return knots, values, None
    # The kernel's first pole belongs to the first of the degree + 1 functions that live on the first span: its knot
    # is `degree` places before the last repetition of the first one.
    period = distinct[-1] - distinct[0]
    cycle = np.repeat(distinct[:-1], repeats[:-1])
    count = len(cycle)
    index = np.arange(count + 1) + repeats[0] - 1 - degree
    return merge_near_knots(cycle[index % count] + period * (index // count)), values, period


def _trim_loops(
    face: Any,
    sheet: Sheet,
    map_u: ParameterMap,
    map_v: ParameterMap,
    tangents: Callable[[Array], Array],
    where: str,
) -> tuple[tuple[Array, ...], int]:
    """Trim loops in the sheet's parameters, and the number of edges."""
    from OCP.BRep import BRep_Tool
    from OCP.TopAbs import TopAbs_WIRE
    from OCP.TopExp import TopExp_Explorer
    from OCP.TopoDS import TopoDS, TopoDS_Iterator

    wires: list[list[int]] = []
    curves: list[ParameterCurve] = []
    backward: list[bool] = []
    edges = 0
    explorer = TopExp_Explorer(face, TopAbs_WIRE)
    while explorer.More():
        members = []
        iterator = TopoDS_Iterator(explorer.Current())
        while iterator.More():
            edge = TopoDS.Edge(iterator.Value())
            curve = _parameter_curve(edge, face, map_u, map_v)
            if curve is not None:
                members.append(len(curves))
                curves.append(curve)
                backward.append(str(edge.Orientation()).endswith("REVERSED"))
                edges += not BRep_Tool.Degenerated_s(edge)
            iterator.Next()
        wires.append(members)
        explorer.Next()
    if not curves:
        return (rectangle(sheet.domain),), 0
    lines = polylines(curves, tangents)
    pieces = [line[::-1] if back else line for line, back in zip(lines, backward, strict=True)]
    loops = [chain([pieces[k] for k in members]) for members in wires if members]
    loops = _within(loops, sheet)
    if not loops:
        raise InputError(where, "a face of no area", "a face with an area", "Remove the face in CAD.")
    return tuple(loops), edges


def _tangents(spline: Any, sheet: Sheet, scale: float) -> Callable[[Array], Array]:
    """The tangents S_u, S_v in mm of a sheet at its parameters, (N, 2) -> (N, 2, 3), by the kernel from its surface."""
    from OCP.gp import gp_Pnt, gp_Vec

    def tangents(points: Array) -> Array:
        place, along_u, along_v = gp_Pnt(), gp_Vec(), gp_Vec()
        found = []
        # A sheet repeats where its borders meet smoothly; the kernel may not know that its surface does.
        u = _repeated(points[:, 0], sheet.domain[0], sheet.period_u)
        v = _repeated(points[:, 1], sheet.domain[2], sheet.period_v)
        for a, b in zip(u.tolist(), v.tolist(), strict=True):
            spline.D1(a, b, place, along_u, along_v)
            found.append((*along_u.Coord(), *along_v.Coord()))
        return np.array(found).reshape(-1, 2, 3) * scale

    return tangents


def _repeated(x: Array, low: float, period: float | None) -> Array:
    return x if period is None else low + (x - low) % period


def _within(loops: list[Array], sheet: Sheet) -> list[Array]:
    """Loops clamped to the sheet and without repeated points; a loop that encloses nothing is dropped."""
    low, high = np.concatenate(loops).min(axis=0), np.concatenate(loops).max(axis=0)
    box: Box = (
        sheet.domain[0] if sheet.period_u is None else low[0],
        sheet.domain[1] if sheet.period_u is None else high[0],
        sheet.domain[2] if sheet.period_v is None else low[1],
        sheet.domain[3] if sheet.period_v is None else high[1],
    )
    reach = high - low
    if np.any(low < (box[0] - SAME_POINT * reach[0], box[2] - SAME_POINT * reach[1])) or np.any(
        high > (box[1] + SAME_POINT * reach[0], box[3] + SAME_POINT * reach[1])
    ):
        loops = clip(loops, box)
    kept = [
        tidy(np.clip(loop, (box[0], box[2]), (box[1], box[3])), SAME_POINT * float(np.min(reach))) for loop in loops
    ]
    return [loop for loop in kept if len(loop) >= 3]


def _parameter_curve(edge: Any, face: Any, map_u: ParameterMap, map_v: ParameterMap) -> ParameterCurve | None:
    """The parameter curve of an edge, or None for an edge that bounds nothing."""
    from OCP.BRepAdaptor import BRepAdaptor_Curve2d
    from OCP.GeomAbs import GeomAbs_BSplineCurve, GeomAbs_Line

    if not str(edge.Orientation()).endswith(("FORWARD", "REVERSED")):
        return None
    curve = BRepAdaptor_Curve2d(edge, face)
    first, last = curve.FirstParameter(), curve.LastParameter()
    kind = curve.GetType()
    chords = 1 if kind == GeomAbs_Line else 4
    if kind == GeomAbs_BSplineCurve:
        chords = min(max(chords, curve.NbKnots() - 1), MOST_STOPS)

    def points(t: Array) -> Array:
        flat = np.array([(p.X(), p.Y()) for p in map(curve.Value, t.tolist())])
        return np.stack([map_u(flat[:, 0]), map_v(flat[:, 1])], axis=1)

    return ParameterCurve(points, np.linspace(first, last, chords + 1))
