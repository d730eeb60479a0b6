"""Trim curves in the parameter plane as polylines that are true to a distance on the surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Largest distance on the surface between a trim curve and its polyline. The promise is 5 um; checks at three points
# of a chord can miss a little.
CHORD_MM = 0.002
CHECKS = np.array([0.25, 0.5, 0.75])
# Halvings of a first chord; a curve that still bends after that is noise.
MOST_HALVINGS = 12


class ParameterCurve(NamedTuple):
    """A curve in the parameter plane: points((N,)) -> (N, 2), and where its first chords begin and end, ascending."""

    points: Callable[[Array], Array]
    stops: Array


def polylines(curves: Sequence[ParameterCurve], tangents: Callable[[Array], Array]) -> list[Array]:
    """One polyline (N, 2) a curve, from its first stop to its last.

    Parameters
    ----------
    curves: the curves.
    tangents: (N, 2) parameters -> (N, 2, 3) tangents S_u, S_v, mm.

    All curves of a face are halved together: the surface is evaluated a dozen times, not a dozen times a curve.
    """
    if not curves:
        return []
    owner = np.concatenate([np.full(len(c.stops) - 1, k) for k, c in enumerate(curves)])
    low = np.concatenate([c.stops[:-1] for c in curves])
    high = np.concatenate([c.stops[1:] for c in curves])
    ends = [c.points(c.stops) for c in curves]
    start = np.concatenate([e[:-1] for e in ends])
    end = np.concatenate([e[1:] for e in ends])
    done: list[tuple[Array, ...]] = []
    for _ in range(MOST_HALVINGS):
        t = low[:, None] + (high - low)[:, None] * CHECKS
        between = np.empty((len(low), len(CHECKS), 2))
        for k in np.unique(owner):
            mine = owner == k
            between[mine] = curves[k].points(t[mine].ravel()).reshape(-1, len(CHECKS), 2)
        bad = _sagitta(start, end, between, tangents) > CHORD_MM
        done.append((owner[~bad], low[~bad], start[~bad]))
        if not np.any(bad):
            break
        middle_t, middle = t[bad, 1], between[bad, 1]
        owner = np.tile(owner[bad], 2)
        low, high = np.concatenate([low[bad], middle_t]), np.concatenate([middle_t, high[bad]])
        start, end = np.concatenate([start[bad], middle]), np.concatenate([middle, end[bad]])
    else:
        done.append((owner, low, start))
    owner, low, start = (np.concatenate(parts) for parts in zip(*done, strict=True))
    result = []
    for k in range(len(curves)):
        mine = np.flatnonzero(owner == k)
        order = mine[np.argsort(low[mine])]
        result.append(np.concatenate([start[order], ends[k][-1:]]))
    return result


def _sagitta(start: Array, end: Array, between: Array, tangents: Callable[[Array], Array]) -> Array:
    """Largest distance across the chord, on the surface, of the points between (M, K, 2); (M,) mm.

    A slip along the chord is no error: the polyline is a set of points, not a parametrisation.
    """
    frame = tangents(between.reshape(-1, 2)).reshape(*between.shape, 3)
    offset = np.einsum("mki,mkij->mkj", between - start[:, None], frame)
    chord = np.einsum("mi,mkij->mkj", end - start, frame)
    square = np.einsum("mkj,mkj->mk", chord, chord)
    along = np.einsum("mkj,mkj->mk", offset, chord) / np.where(square > 0.0, square, 1.0)
    across = offset - along[..., None] * chord
    return np.asarray(np.linalg.norm(across, axis=2).max(axis=1))


def chain(pieces: Sequence[Array]) -> Array:
    """Polylines of one wire, end to start, as one closed loop.

    Each next piece is the one that starts nearest, because a wire does not promise its edges in order.
    """
    rest = list(pieces[1:])
    loop = [pieces[0]]
    while rest:
        here = loop[-1][-1]
        k = int(np.argmin([np.linalg.norm(piece[0] - here) for piece in rest]))
        loop.append(rest.pop(k))
    return np.concatenate([piece[:-1] for piece in loop])
