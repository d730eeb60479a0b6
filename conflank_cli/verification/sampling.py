"""Points to judge trimmed design faces at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.face import DesignFace
from conflank_cli.verification.evaluation import evaluate_grid, evaluate_points, inside_rows

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]

POINTS_PER_FACE = 30_000
"""Points of the grid on a face: about 0.3 mm apart on a blade of 50 x 50 mm."""

BORDER_SPACING = 0.5
"""Spacing of the points on a face's border, mm."""

_COARSE = 48
"""Cells a side of the coarse grid that tells how the parameters run over a face."""


@dataclass(frozen=True, slots=True)
class FaceSample:
    """Points on one trimmed face: P on the grid, then those of its border, N together.

    Attributes
    ----------
    points: (N, 3) mm, CAD frame.
    normals: (N, 3) unit normals out of the metal.
    area: (N,) area each stands for, mm2; 0 on the border.
    neighbours: pairs of points next to each other on the grid, (Q, 2).
    along: pairs of points next to each other on the border, (B, 2).
    uv: (N, 2) parameters of the points.
    reach: (N, 2, 2) two ways in the parameter plane along which a point stands for what is up to that far away: on the
        grid in both directions, on the border forward to the next point, with nothing for the second.
    """

    points: Array
    normals: Array
    area: Array
    neighbours: Integers
    along: Integers
    uv: Array
    reach: Array


def _cells_of_even_length(edges: Array, lengths: Array, count: int) -> tuple[Array, Array]:
    """Middles and widths of `count` parameter cells of even length, from lengths of coarse cells between edges."""
    travelled = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, 1e-9 * lengths.sum()))])
    borders = np.interp(np.linspace(0.0, travelled[-1], count + 1), travelled, edges)
    return 0.5 * (borders[1:] + borders[:-1]), np.diff(borders)


def sample_face(face: DesignFace, count: int = POINTS_PER_FACE) -> FaceSample:
    """Points on a trimmed face, evenly spread, with the area each stands for.

    Parameters
    ----------
    face: the face.
    count: how many points the grid shall have inside the trimming loops, about.
    """
    surface = face.surface
    loops = np.concatenate(face.loops)
    u0, u1, v0, v1 = surface.domain
    low, high = np.maximum(loops.min(axis=0), [u0, v0]), np.minimum(loops.max(axis=0), [u1, v1])
    edges_u, edges_v = (np.linspace(low[k], high[k], _COARSE + 1) for k in (0, 1))
    middle_u, middle_v = 0.5 * (edges_u[1:] + edges_u[:-1]), 0.5 * (edges_v[1:] + edges_v[:-1])
    _, by_u, by_v = evaluate_grid(surface, middle_u, middle_v)
    coarse = inside_rows(face.loops, middle_u, middle_v)
    filled = max(float(coarse.mean()), 1.0 / _COARSE**2)
    lengths_u = np.linalg.norm(by_u, axis=2).mean(axis=1) * np.diff(edges_u)
    lengths_v = np.linalg.norm(by_v, axis=2).mean(axis=0) * np.diff(edges_v)
    cells = count / filled
    ratio = np.clip(lengths_u.sum() / lengths_v.sum(), 0.01, 100.0)
    nu, nv = max(int(np.sqrt(cells * ratio)), 4), max(int(np.sqrt(cells / ratio)), 4)
    u, du = _cells_of_even_length(edges_u, lengths_u, nu)
    v, dv = _cells_of_even_length(edges_v, lengths_v, nv)
    points, by_u, by_v = evaluate_grid(surface, u, v)
    normals = face.sense * np.cross(by_u, by_v)
    size = np.linalg.norm(normals, axis=2)
    kept = inside_rows(face.loops, u, v) & (size > 1e-9 * max(float(size.max()), 1e-300))
    number = np.full(kept.shape, -1, dtype=np.int64)
    number[kept] = np.arange(int(kept.sum()))
    pairs = [
        np.stack([first[both], last[both]], axis=1)
        for first, last in ((number[:-1], number[1:]), (number[:, :-1], number[:, 1:]))
        for both in [(first >= 0) & (last >= 0)]
    ]
    inner = int(kept.sum())
    border, ways, along = _sample_border(face)
    border_points, border_normals, sound = points_and_normals(face, border)
    # At a pole of the surface the normal is not defined by its derivatives; the point next to it speaks for it.
    number = np.where(sound, inner + np.cumsum(sound) - 1, -1)
    along = number[along]
    reach = np.zeros((inner, 2, 2))
    rows, columns = np.nonzero(kept)
    reach[:, 0, 0], reach[:, 1, 1] = du[rows], dv[columns]
    ahead = np.stack([ways, np.zeros_like(ways)], axis=1)
    return FaceSample(
        points=np.concatenate([points[kept], border_points[sound]]),
        normals=np.concatenate([normals[kept] / size[kept][:, None], border_normals[sound]]),
        area=np.concatenate([(size * du[:, None] * dv[None, :])[kept], np.zeros(int(sound.sum()))]),
        neighbours=np.concatenate(pairs),
        along=along[(along >= 0).all(axis=1)],
        uv=np.concatenate([np.stack([u[rows], v[columns]], axis=1), border[sound]]),
        reach=np.concatenate([reach, ahead[sound]]),
    )


def points_and_normals(face: DesignFace, uv: Array) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
    """Points and unit normals out of the metal, (N, 3), at parameters (N, 2), and where there is a normal."""
    points, by_u, by_v = evaluate_points(face.surface, uv)
    normals = face.sense * np.cross(by_u, by_v)
    size = np.linalg.norm(normals, axis=1)
    sound = size > 1e-9 * max(float(size.max(initial=0.0)), 1e-300)
    return points, normals / np.where(sound, size, 1.0)[:, None], sound


def _sample_border(face: DesignFace) -> tuple[Array, Array, Integers]:
    """Parameters (B, 2) of points along the trimming loops, the way to the next (B, 2), and pairs of next ones."""
    pieces, ways, pairs, count = [], [], [], 0
    for loop in face.loops:
        ends = np.roll(loop, -1, axis=0)
        way = np.linalg.norm(evaluate_points(face.surface, ends)[0] - evaluate_points(face.surface, loop)[0], axis=1)
        parts = np.maximum(np.ceil(way / BORDER_SPACING).astype(np.int64), 1)
        owner = np.repeat(np.arange(len(loop)), parts)
        share = (np.arange(len(owner)) - np.repeat(np.cumsum(parts) - parts, parts)) / parts[owner]
        pieces.append(loop[owner] + share[:, None] * (ends - loop)[owner])
        ways.append((ends - loop)[owner] / parts[owner][:, None])
        number = count + np.arange(len(owner))
        pairs.append(np.stack([number, np.roll(number, -1)], axis=1))
        count += len(owner)
    return np.concatenate(pieces), np.concatenate(ways), np.concatenate(pairs)
