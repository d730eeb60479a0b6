"""The path of the ball's centre along a chain of streamlines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.geometry.workface import WorkFace

Array = npt.NDArray[np.float64]

# A chord of the path is off the exact path by this much at most, mm; rounding and the axes leave the rest of what
# posting may cost.
CHORD = 0.00025
# Longest chord, mm: poses are held against the part one by one.
LONGEST = 0.6
# The path is first looked at this finely, mm.
LOOK = 0.1


@dataclass(frozen=True, slots=True)
class Path:
    """Places of the ball along a chain.

    centre (N, 3): centres of the ball, mm. normal (N, 3): unit normals of the face at the contacts, towards the cutter.
    way (N,): length of the path up to each, mm.
    """

    centre: Array
    normal: Array
    way: Array

    def only(self, chosen: npt.NDArray[np.int64]) -> Path:
        """Some of the places."""
        return Path(self.centre[chosen], self.normal[chosen], self.way[chosen])


def path_of(face: WorkFace, corners: list[Array], offset: Callable[[Array], Array]) -> Path:
    """The path over straight pieces (2, 2) in the parameters; `offset` says how far off the face the centre is, mm.

    Places are so close that chords between them stay within CHORD of the exact path, and no closer.
    """
    centres, normals = [], []
    for number, (start, end) in enumerate(corners):
        rough = _raised(face, start + np.linspace(0.0, 1.0, 9)[:, None] * (end - start), offset)[0]
        length = float(np.linalg.norm(np.diff(rough, axis=0), axis=1).sum())
        count = max(int(np.ceil(length / LOOK)), 4) + 1
        share = np.linspace(0.0, 1.0, count)
        fine = _raised(face, start + share[:, None] * (end - start), offset)[0]
        chord = np.diff(fine, axis=0)
        step = np.linalg.norm(chord, axis=1)
        # Across the way the path bends by the second difference: its square root says how many chords it takes.
        bend = np.diff(chord, axis=0)
        along = (chord[1:] + chord[:-1]) / np.maximum(step[1:] + step[:-1], 1e-300)[:, None]
        bend -= np.einsum("ni,ni->n", bend, along)[:, None] * along
        per_step = np.sqrt(np.linalg.norm(bend, axis=1) / (8.0 * CHORD))
        per_step = np.concatenate([per_step[:1], np.maximum(per_step[1:], per_step[:-1]), per_step[-1:]])
        density = np.maximum(per_step, step / LONGEST)
        load = np.concatenate([[0.0], np.cumsum(density)])
        blocks = max(int(np.ceil(load[-1])), 1)
        share = np.interp(np.linspace(0.0, load[-1], blocks + 1), load, share)
        centre, normal = _raised(face, start + share[:, None] * (end - start), offset)
        # Each piece begins where the one before ends.
        first = 1 if number else 0
        centres.append(centre[first:])
        normals.append(normal[first:])
    centre, normal = np.concatenate(centres), np.concatenate(normals)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    return Path(centre, normal, way)


def _raised(face: WorkFace, places: Array, offset: Callable[[Array], Array]) -> tuple[Array, Array]:
    """Points `offset` off the face at parameters (N, 2), and the normals there."""
    frame = face.projector.evaluate(places[:, 0], places[:, 1])
    normal = face.sense * np.cross(frame[:, 1], frame[:, 2])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    return frame[:, 0] + offset(places)[:, None] * normal, normal
