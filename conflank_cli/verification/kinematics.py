"""Forward kinematics and frames: from the words of a program to the cutter's poses on the part.

Written for verification alone, from the definition of the axes; posts have their own inverse.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def about(axis: tuple[float, float, float], angle: float) -> Array:
    """Rotation by an angle (radians) about an axis of any length, (3, 3)."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # Rodrigues: 1 + sin K + (1 - cos) K K, with K the matrix of the cross product.
    return np.asarray(np.eye(3) + sin(angle) * across + (1.0 - cos(angle)) * across @ across)


@dataclass(frozen=True, slots=True)
class Frame:
    """Position of the CAD frame in the program's frame: XYZ intrinsic rotation in degrees, then translation in mm.

    turned: for a copy of a rotary pattern, the axis (any length) and the angle in radians by which what the CAD file
    shows is turned about the CAD frame's origin before that.
    """

    rotate_deg: tuple[float, float, float]
    translate: tuple[float, float, float]
    turned: tuple[tuple[float, float, float], float] | None = None

    @property
    def matrix(self) -> Array:
        """Rotation from CAD to program coordinates, (3, 3): Rx(a) Ry(b) Rz(c), after the turn of a copy."""
        return self._own if self.turned is None else self._own @ about(*self.turned)

    @property
    def _own(self) -> Array:
        a, b, c = (radians(angle) for angle in self.rotate_deg)
        about_x = np.array([[1, 0, 0], [0, cos(a), -sin(a)], [0, sin(a), cos(a)]])
        about_y = np.array([[cos(b), 0, sin(b)], [0, 1, 0], [-sin(b), 0, cos(b)]])
        about_z = np.array([[cos(c), -sin(c), 0], [sin(c), cos(c), 0], [0, 0, 1]])
        return np.asarray(about_x @ about_y @ about_z, dtype=np.float64)


CAD_FRAME = Frame((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def to_cad(frame: Frame, points: Array, vectors: Array) -> tuple[Array, Array]:
    """Points and vectors, each (N, 3), from the program's frame to the CAD frame: p = R^T (p' - t)."""
    matrix = frame.matrix
    return (points - np.array(frame.translate)) @ matrix, vectors @ matrix


def from_cad(frame: Frame, points: Array, vectors: Array) -> tuple[Array, Array]:
    """Points and vectors, each (N, 3), from the CAD frame to the program's frame: p' = R p + t."""
    matrix = frame.matrix
    return points @ matrix.T + np.array(frame.translate), vectors @ matrix.T


@dataclass(frozen=True, slots=True)
class StatedAxes:
    """Two rotary axes that a program or a machine describes: letters, and directions they turn the tool about.

    reduced: the letters whose display stays within one turn, so that M126 takes the shorter way; None where that is not
        known, and M126 holds for all.
    """

    letters: str
    first: tuple[float, float, float]
    second: tuple[float, float, float]
    reduced: str | None = None


Axes = str | StatedAxes
"""A pair of rotary axes: by the letters of a usual pair, or described."""


def reduced_of(axes: Axes) -> str:
    """Letters of the rotary axes that M126 brings to their places the shorter way."""
    if isinstance(axes, StatedAxes) and axes.reduced is not None:
        return axes.reduced
    return letters_of(axes)


def letters_of(axes: Axes) -> str:
    """Letters of a pair of rotary axes, in the order of their positions."""
    return axes.letters if isinstance(axes, StatedAxes) else axes


def turned(direction: tuple[float, float, float], angle: Array, vectors: Array) -> Array:
    """Vectors (N, 3) turned by angles (N,), radians, about a direction (any length)."""
    about = np.array(direction) / np.linalg.norm(direction)
    x, y, z = about
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # R = 1 + sin K + (1 - cos) K K, with K the matrix of the cross product.
    once, twice = vectors @ cross.T, vectors @ (cross @ cross).T
    return np.asarray(vectors + np.sin(angle)[:, None] * once + (1.0 - np.cos(angle))[:, None] * twice)


def axis_of(letters: Axes, rotary: Array) -> Array:
    """Tool axis (tip to spindle) in part coordinates from rotary positions: t = R(first) R(second) z, table sense.

    Parameters
    ----------
    letters: "AC", "BC" or "AB" (A the table, B the head), or described axes; "" stands for axes at zero.
    rotary: (N, 2) radians, in the order of the letters.

    Source: ISO 841 sense of rotary words (tool motion relative to the part); for A/C t = (sin C sin A, -cos C sin A,
    cos A), for B/C t = (cos C sin B, sin C sin B, cos B), for A/B t = (sin B, -sin A cos B, cos A cos B).
    """
    first, second = rotary[:, 0], rotary[:, 1]
    if isinstance(letters, StatedAxes):
        spindle = np.tile([0.0, 0.0, 1.0], (len(rotary), 1))
        return turned(letters.first, first, turned(letters.second, second, spindle))
    if letters == "AC":
        parts = (np.sin(second) * np.sin(first), -np.cos(second) * np.sin(first), np.cos(first))
    elif letters == "BC":
        parts = (np.cos(second) * np.sin(first), np.sin(second) * np.sin(first), np.cos(first))
    elif letters == "AB":
        parts = (np.sin(second), -np.sin(first) * np.cos(second), np.cos(first) * np.cos(second))
    else:
        parts = (np.zeros(len(rotary)), np.zeros(len(rotary)), np.ones(len(rotary)))
    return np.stack(parts, axis=1)


def great_circle(start: Array, end: Array, share: Array) -> Array:
    """Unit vectors on the great circles from start to end (N, 3), at shares (N,) of the angle; either end at 0 and 1.

    Where the two are opposite the circle is not defined; the way then leads over an arbitrary normal.
    """
    cosine = np.clip(np.einsum("ij,ij->i", start, end), -1.0, 1.0)
    chord = np.linalg.norm(end - start, axis=1)
    angle = np.where(cosine > 0.0, 2.0 * np.arcsin(np.clip(chord / 2.0, 0.0, 1.0)), np.arccos(cosine))
    across = end - cosine[:, None] * start
    size = np.linalg.norm(across, axis=1)
    flat = size < 1e-12
    substitute = np.cross(start, np.where(np.abs(start[:, :1]) < 0.5, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]))
    across = np.where(flat[:, None], substitute, across)
    across /= np.linalg.norm(across, axis=1)[:, None]
    turned = share * angle
    return np.asarray(np.cos(turned)[:, None] * start + np.sin(turned)[:, None] * across)
