"""What `conflank inspect` says about a part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.cad.part import Part, PartFace
from conflank_cli.cad.quadrature import surface_frames, trim_nodes
from conflank_cli.errors import InputError
from conflank_cli.geometry.surface import to_spans

Array = npt.NDArray[np.float64]

# Where the surface shrinks to a pole, tangents below this share of the usual ones carry no curvature.
DEGENERATE = 1.0e-6


@dataclass(frozen=True, slots=True)
class CurvatureRange:
    """Signed principal curvatures over the trimmed face, 1/mm.

    Positive where the surface bends towards the oriented normal: a solid ball of radius R has -1/R.
    least, greatest: extremes over the points looked at. low, high: 2 % of the area lies below and above.
    """

    least: float
    low: float
    high: float
    greatest: float


@dataclass(frozen=True, slots=True)
class FaceReport:
    """One face.

    Attributes
    ----------
    number, name, colour, kind: as in `PartFace`.
    degree_u, degree_v, poles_u, poles_v, rational: of the B-spline form.
    parameters: (u0, u1, v0, v1) of the trimmed face, what regions in job files are fractions of.
    area: mm2 of the trimmed face. size: of its box along x, y, z, mm.
    curvature: principal curvatures.
    outside_known: whether the oriented normal points out of the metal for certain.
    outside: "along" where the oriented normal is along S_u x S_v, "against" where it is against it.
    edges: number of trim edges.
    closes_u, closes_v: whether the face goes all the way round.
    problem: why there are no numbers, or "".
    """

    number: int
    name: str
    colour: str
    kind: str
    outside_known: bool
    outside: str
    degree_u: int = 0
    degree_v: int = 0
    poles_u: int = 0
    poles_v: int = 0
    rational: bool = False
    parameters: tuple[float, float, float, float] | None = None
    area: float | None = None
    size: tuple[float, float, float] | None = None
    curvature: CurvatureRange | None = None
    edges: int = 0
    closes_u: bool = False
    closes_v: bool = False
    problem: str = ""


def describe(part: Part) -> list[FaceReport]:
    """One report a face. A face without sound geometry is reported with its problem, not refused."""
    return [_describe_face(face) for face in part.faces]


def _describe_face(face: PartFace) -> FaceReport:
    outside = "along" if face.orientation > 0 else "against"
    head = (face.number, face.name, face.colour, face.kind, face.outside_known, outside)
    try:
        geometry = face.load()
    except InputError as error:
        return FaceReport(*head, problem=str(error))
    sheet, surface = geometry.sheet, geometry.surface
    spans = to_spans(surface)
    nodes = trim_nodes(geometry.loops, spans.breaks_u, spans.breaks_v)
    frames = surface_frames(spans, nodes.u, nodes.v)
    normal = np.cross(frames[:, 1], frames[:, 2])
    length = np.linalg.norm(normal, axis=1)
    patch = nodes.weight * length
    area = float(patch.sum())
    if not area > 0.0:
        return FaceReport(*head, problem="a face of no area", area=area)
    border = np.concatenate(geometry.loops)
    points = np.concatenate([frames[:, 0], surface_frames(spans, border[:, 0], border[:, 1])[:, 0]])
    size = np.ptp(points, axis=0)
    sound = length > DEGENERATE * float(np.median(length))
    curvature = principal_curvatures(frames[sound], normal[sound] * (face.orientation / length[sound, None]))
    closes_u, closes_v = sheet.closes(geometry.box)
    return FaceReport(
        *head,
        degree_u=sheet.degree_u,
        degree_v=sheet.degree_v,
        poles_u=sheet.poles.shape[0],
        poles_v=sheet.poles.shape[1],
        rational=sheet.weights is not None,
        parameters=geometry.box,
        area=area,
        size=(float(size[0]), float(size[1]), float(size[2])),
        curvature=_range(curvature, patch[sound]),
        edges=geometry.edges,
        closes_u=closes_u,
        closes_v=closes_v,
    )


def principal_curvatures(frames: Array, normal: Array) -> Array:
    """Principal curvatures (N, 2), the smaller first, of frames (N, 6, 3) with respect to unit normals (N, 3), 1/mm.

    Source: do Carmo, Differential Geometry of Curves and Surfaces (1976), section 3-3.
    """
    e, f, g = (np.einsum("ni,ni->n", frames[:, i], frames[:, j]) for i, j in ((1, 1), (1, 2), (2, 2)))
    ll, mm, nn = (np.einsum("ni,ni->n", frames[:, k], normal) for k in (3, 4, 5))
    det = e * g - f * f
    mean = 0.5 * (e * nn - 2.0 * f * mm + g * ll) / det
    gauss = (ll * nn - mm * mm) / det
    spread = np.sqrt(np.maximum(mean * mean - gauss, 0.0))
    return np.stack([mean - spread, mean + spread], axis=1)


def _range(curvature: Array, patch: Array) -> CurvatureRange:
    low, high = curvature[:, 0], curvature[:, 1]
    return CurvatureRange(
        float(low.min()), _quantile(low, patch, 0.02), _quantile(high, patch, 0.98), float(high.max())
    )


def _quantile(values: Array, weight: Array, share: float) -> float:
    """Value below which this share of the weight lies."""
    order = np.argsort(values)
    below = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(below, share * below[-1])])
