"""Arcs, roundings and chamfers of the working plane, as points close enough to each other.

All in the programmed coordinates of the working plane, mm; a helix climbs evenly with its angle.
"""

from __future__ import annotations

from math import acos, atan2, ceil, cos, hypot, pi, sin, sqrt, tan

Point = tuple[float, float]

CHORD = 1e-4
"""Most that a straight piece leaves its arc, mm."""

OFF_CIRCLE = 0.016
"""Most that the end of an arc may miss its circle, mm: what the control allows by default."""

_FULL = 2.0 * pi


def about_pole(start: Point, end: Point, pole: Point, turn: int) -> tuple[float, float] | None:
    """Radius and angle (radians, signed by `turn`) of the arc about a pole; a full circle where both ends are one.

    None where both ends are not on one circle.
    """
    radius, other = hypot(start[0] - pole[0], start[1] - pole[1]), hypot(end[0] - pole[0], end[1] - pole[1])
    if radius <= OFF_CIRCLE or abs(radius - other) > OFF_CIRCLE:
        return None
    angle = atan2(end[1] - pole[1], end[0] - pole[0]) - atan2(start[1] - pole[1], start[0] - pole[0])
    if hypot(end[0] - start[0], end[1] - start[1]) < 1e-9:
        return radius, turn * _FULL
    return radius, _signed(angle, turn)


def pole_of_radius(start: Point, end: Point, radius: float, turn: int) -> Point | None:
    """Pole of an arc by its radius: less than half a circle for a positive one, more for a negative one; or None."""
    x, y = end[0] - start[0], end[1] - start[1]
    chord = hypot(x, y)
    if chord <= 0.0 or 0.5 * chord > abs(radius) + OFF_CIRCLE:
        return None
    height = sqrt(max(radius * radius - 0.25 * chord * chord, 0.0))
    # To the left of the chord for a small arc that turns counter-clockwise.
    side = turn * (1.0 if radius > 0.0 else -1.0) * height / chord
    return (start[0] + 0.5 * x - side * y, start[1] + 0.5 * y + side * x)


def pole_of_tangent(start: Point, end: Point, direction: Point) -> tuple[Point, int] | None:
    """Pole and turn of the arc that leaves `start` along a direction; None where that is a straight line."""
    length = hypot(*direction)
    if length <= 0.0:
        return None
    # The left normal n of the direction; |start + r n - end| = r.
    nx, ny = -direction[1] / length, direction[0] / length
    x, y = end[0] - start[0], end[1] - start[1]
    across = nx * x + ny * y
    if abs(across) < 1e-9:
        return None
    radius = (x * x + y * y) / (2.0 * across)
    return (start[0] + radius * nx, start[1] + radius * ny), 1 if radius > 0.0 else -1


def points_on(start: Point, pole: Point, angle: float) -> list[Point]:
    """Points on an arc after its start, the end among them, no piece further off than `CHORD`."""
    x, y = start[0] - pole[0], start[1] - pole[1]
    radius = hypot(x, y)
    step = 2.0 * acos(max(1.0 - CHORD / radius, 0.0)) if radius > CHORD else pi
    count = max(ceil(abs(angle) / step), 1)
    found = []
    for number in range(1, count + 1):
        c, s = cos(angle * number / count), sin(angle * number / count)
        found.append((pole[0] + c * x - s * y, pole[1] + s * x + c * y))
    return found


def rounded(before: Point, corner: Point, after: Point, radius: float) -> tuple[Point, list[Point]] | None:
    """Where the rounding of a corner between two lines begins, and its points after that; None where it has no room."""
    u, v, between = _corner(before, corner, after)
    if between < 1e-9 or between > pi - 1e-9:
        return None
    length = radius / tan(0.5 * between)
    if length > min(hypot(before[0] - corner[0], before[1] - corner[1]), _away(after, corner)) + 1e-9:
        return None
    start, end = _along(corner, u, length), _along(corner, v, length)
    turn = 1 if u[0] * v[1] - u[1] * v[0] < 0.0 else -1
    pole = pole_of_radius(start, end, radius, turn)
    arc = None if pole is None else about_pole(start, end, pole, turn)
    return None if pole is None or arc is None else (start, points_on(start, pole, arc[1]))


def chamfered(before: Point, corner: Point, after: Point, length: float) -> tuple[Point, list[Point]] | None:
    """The same for a chamfer that takes `length` off both lines."""
    u, v, _ = _corner(before, corner, after)
    if length > min(_away(before, corner), _away(after, corner)) + 1e-9:
        return None
    return _along(corner, u, length), [_along(corner, v, length)]


def _corner(before: Point, corner: Point, after: Point) -> tuple[Point, Point, float]:
    """Unit vectors from a corner back and on, and the angle between them."""
    back, on = _away(before, corner), _away(after, corner)
    if back <= 0.0 or on <= 0.0:
        return (0.0, 0.0), (0.0, 0.0), 0.0
    u = ((before[0] - corner[0]) / back, (before[1] - corner[1]) / back)
    v = ((after[0] - corner[0]) / on, (after[1] - corner[1]) / on)
    return u, v, abs(atan2(u[0] * v[1] - u[1] * v[0], u[0] * v[0] + u[1] * v[1]))


def _away(point: Point, other: Point) -> float:
    return hypot(point[0] - other[0], point[1] - other[1])


def _along(point: Point, direction: Point, length: float) -> Point:
    return (point[0] + length * direction[0], point[1] + length * direction[1])


def _signed(angle: float, turn: int) -> float:
    """The same angle, between 0 and a full turn in the sense of `turn`."""
    angle %= _FULL
    return angle if turn > 0 or angle == 0.0 else angle - _FULL
