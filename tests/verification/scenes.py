"""Small scenes with closed forms, and programs written by hand for them."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np

from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.job import Design, Job, Margin, Obstacles, Part, Setup, Tolerance, Tools
from conflank_cli.once import Once
from conflank_cli.scene import Scene
from conflank_cli.tool import CATALOGUE, Tool

T1 = CATALOGUE["T1"]
NOTHING = CheckMesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32), np.zeros(0, dtype=np.int32))


def rectangle(u0: float, u1: float, v0: float, v1: float) -> np.ndarray:
    return np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]])


def plane_face(x: tuple[float, float], y: tuple[float, float], number: int = 0, z: float = 0.0) -> DesignFace:
    """The plane at a height z with u = x, v = y, metal below."""
    poles = np.array([[[a, b, z] for b in y] for a in x])
    surface = BSplineSurface(1, 1, np.array([x[0], *x, x[1]]), np.array([y[0], *y, y[1]]), poles)
    return DesignFace(number, "plane", surface, (rectangle(*x, *y),), 1)


def cylinder_face(radius: float, y: tuple[float, float]) -> DesignFace:
    """A quarter of a cylinder about the y axis, from +x to +z, metal inside; u runs around it, v along it."""
    corner = [[radius, 0.0], [radius, radius], [0.0, radius]]
    poles = np.array([[[a, b, c] for b in y] for a, c in corner])
    weights = np.repeat([[1.0], [np.sqrt(0.5)], [1.0]], 2, axis=1)
    knots_v = np.array([y[0], *y, y[1]])
    surface = BSplineSurface(2, 1, np.array([0.0, 0, 0, 1, 1, 1]), knots_v, poles, weights)
    return DesignFace(4, "cylinder", surface, (rectangle(0.0, 1.0, *y),), -1)


def scene_of(
    *faces: DesignFace,
    tools: Sequence[Tool] = (T1,),
    check: CheckMesh = NOTHING,
    tolerance: Tolerance | None = None,
    setup: Setup | None = None,
    margin: Margin | None = None,
) -> Scene:
    job = Job(
        part=Part("part.step", tuple(Design(face.number) for face in faces)),
        tools=Tools(tuple(tool.name for tool in tools)),
        tolerance=tolerance or Tolerance(),
        setup=setup or Setup(),
        obstacles=Obstacles((), margin or Margin()),
    )
    return Scene(job, "part", tuple(faces), tuple(tools), Once(lambda: check), {})


def triangles_of(*quads: Sequence[Sequence[float]], face: int = 9) -> CheckMesh:
    """Quads as two triangles each."""
    vertices = np.array([corner for quad in quads for corner in quad], dtype=np.float64)
    triangles = [[4 * k + a, 4 * k + b, 4 * k + c] for k in range(len(quads)) for a, b, c in ((0, 1, 2), (0, 2, 3))]
    return CheckMesh(vertices, np.array(triangles, dtype=np.int32), np.full(len(triangles), face, dtype=np.int32))


def header(tool: Tool = T1, frame: str = "CAD", reference: str = "TIP", face: int = 0) -> list[str]:
    return [
        "; CONFLANK 0.1.0",
        f"; PART part FACE {face}",
        f"; TOOL {tool.number} {tool.name} R_MIN {tool.r_min} R_MAX {tool.r_max} LENGTH {tool.length}",
        f"; REFERENCE {reference}",
        "; MACHINE ac-table",
        "; STYLE tcpm",
        f"; FRAME {frame}",
    ]


ROTARY_TOLERANCE = 0.003
"""TA of cycle 32, degrees: less than T over the height of every tool here."""


def program(body: Sequence[str], head: Sequence[str] | None = None, tool: Tool = T1) -> str:
    """A numbered program with our own frame around the body."""
    blocks = [
        "BEGIN PGM TEST MM",
        *(header(tool) if head is None else head),
        f"TOOL CALL {tool.number} Z S3000",
        "PLANE RESET STAY",
        "CYCL DEF 247 DATUM SETTING Q339=+1",
        "CYCL DEF 32.0 TOLERANCE",
        "CYCL DEF 32.1 T0.002",
        f"CYCL DEF 32.2 HSC-MODE:0 TA{ROTARY_TOLERANCE}",
        "M13",
        "L M140 MB MAX",
        *body,
        "M30",
        "END PGM TEST MM",
    ]
    return "".join(f"{number} {block}\r\n" for number, block in enumerate(blocks))


TCPM = "FUNCTION TCPM F TCP AXIS POS PATHCTRL VECTOR"


def lying_on_plane(tool: Tool, height: float = 0.0) -> tuple[float, np.ndarray, np.ndarray]:
    """A cone that touches the plane z = height along a generator, pointing along +y: A in degrees, tip and axis.

    The r_min end of the axis is at x = 0, y = 0; <axis, normal> = sin(half angle).
    """
    alpha = tool.half_angle
    axis = np.array([0.0, cos(alpha), sin(alpha)])
    low = np.array([0.0, 0.0, height + tool.r_min * cos(alpha)])
    return -(90.0 - alpha * 180.0 / pi), low + tool.tip_height * axis, axis
