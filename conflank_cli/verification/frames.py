"""The coordinate systems of a program: how what it writes lies in the system of its preset.

A control applies its transformations one within the other: the shift of the datum, the tilt of the working plane about
the shifted datum, then mirroring, rotation and scaling in the tilted plane. With s the shift, R the tilt, M, Z and S
mirroring, rotation about the tool axis and scaling,

    p = s + R M Z S w

for the programmed w. One that is set while a later one of this order is active would act in a system that depends on
the control's version; that is not followed.

Source: HEIDENHAIN iTNC 530 user's manual, chapters "Coordinate transformation cycles" and "The PLANE function".
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, sin

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

_UPRIGHT: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

_LEAST_SINE = 1e-6
"""Two vectors of a plane closer to parallel than this define no plane."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One such system.

    Attributes
    ----------
    shift: mm.
    tilt: matrix R.
    mirrored: axes that are mirrored, some of "XYZ".
    rotation: of the working plane about the tool axis, radians.
    scale: factors of X, Y and Z.
    """

    shift: Vector = (0.0, 0.0, 0.0)
    tilt: Matrix = _UPRIGHT
    mirrored: str = ""
    rotation: float = 0.0
    scale: Vector = (1.0, 1.0, 1.0)

    @property
    def tilted(self) -> bool:
        """Whether the tool axis of this system is not the Z of the preset, or its X is turned."""
        return self.tilt != _UPRIGHT

    @property
    def only_shifted(self) -> bool:
        """Whether nothing but a shift is active."""
        return not (self.tilted or self.in_plane)

    @property
    def in_plane(self) -> bool:
        """Whether mirroring, rotation or scaling is active."""
        return bool(self.mirrored) or self.rotation != 0.0 or self.scale != (1.0, 1.0, 1.0)

    @property
    def tool_axis(self) -> Vector:
        """Direction of the tool axis that this system asks for."""
        return (self.tilt[0][2], self.tilt[1][2], self.tilt[2][2])

    def point(self, x: float, y: float, z: float) -> Vector:
        """Programmed coordinates in the system of the preset, mm."""
        if self.only_shifted:
            return (x + self.shift[0], y + self.shift[1], z + self.shift[2])
        a, b, c = (self._matrix @ np.array([x, y, z]) + np.array(self.shift)).tolist()
        return (a, b, c)

    def coordinates(self, point: Vector) -> Vector:
        """The reverse: what would be programmed for a point."""
        away = np.array(point) - np.array(self.shift)
        x, y, z = (away if self.only_shifted else np.linalg.solve(self._matrix, away)).tolist()
        return (x, y, z)

    @property
    def _matrix(self) -> Array:
        turn = np.array([[cos(self.rotation), -sin(self.rotation), 0.0], [sin(self.rotation), cos(self.rotation), 0.0]])
        mirror = np.diag([-1.0 if letter in self.mirrored else 1.0 for letter in "XYZ"])
        return np.asarray(np.array(self.tilt) @ mirror @ np.vstack([turn, [0.0, 0.0, 1.0]]) @ np.diag(self.scale))

    def without(self, *names: str) -> Frame:
        """The same with these attributes as they are at the start."""
        start = Frame()
        return replace(self, **{name: getattr(start, name) for name in names})


def spatial(a: float, b: float, c: float) -> Matrix:
    """Tilt by spatial angles in radians: turns about the X, then the new Y, then the new Z axis, R = Rx Ry Rz.

    The control describes the same as turns about its fixed axes in the order C, B, A.
    """
    return _matrix(_about("X", a) @ _about("Y", b) @ _about("Z", c))


def euler(precession: float, nutation: float, rotation: float) -> Matrix:
    """Tilt by Euler angles in radians: turns about Z, then the new X, then the new Z axis."""
    return _matrix(_about("Z", precession) @ _about("X", nutation) @ _about("Z", rotation))


def spanned(base: Vector, normal: Vector) -> Matrix | None:
    """Tilt with its Z along a normal, and its X along what of a base vector lies in the plane; None for no plane."""
    z = np.array(normal)
    x = np.array(base)
    if not np.linalg.norm(z) > 0.0 or not np.linalg.norm(x) > 0.0:
        return None
    z /= np.linalg.norm(z)
    x = x / np.linalg.norm(x)
    x = x - (x @ z) * z
    if np.linalg.norm(x) < _LEAST_SINE:
        return None
    x /= np.linalg.norm(x)
    return _matrix(np.stack([x, np.cross(z, x), z], axis=1))


def further(tilt: Matrix, letter: str, angle: float) -> Matrix:
    """A tilt turned on about one of its own axes."""
    return _matrix(np.array(tilt) @ _about(letter, angle))


def _about(letter: str, angle: float) -> Array:
    c, s = cos(angle), sin(angle)
    return np.array(
        {
            "X": [[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]],
            "Y": [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]],
            "Z": [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]],
        }[letter]
    )


def _matrix(values: Array) -> Matrix:
    a, b, c = ((float(row[0]) + 0.0, float(row[1]) + 0.0, float(row[2]) + 0.0) for row in values)
    return (a, b, c)
