"""Faces with closed forms, and exact envelopes as scenes: the material of the stages' tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import msgspec
import numpy as np
from scipy.interpolate import make_interp_spline

from benchmarks.envelopes import EnvelopeCase, random_envelopes
from conflank_cli.geometry.face import DesignFace
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.job import Detection
from conflank_cli.motion import Motion, fitted
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool
from tests.verification.scenes import rectangle, scene_of

Array = np.ndarray


def interpolated(
    shape: Callable[[Array, Array], Array], u: tuple[float, float], v: tuple[float, float], count: int = 24
) -> BSplineSurface:
    """Degree 5 through count x count points of `shape`: to 1e-8 mm for the smooth shapes of these tests."""
    a, b = np.linspace(*u, count), np.linspace(*v, count)
    points = shape(*np.meshgrid(a, b, indexing="ij"))
    along_u = make_interp_spline(a, points, k=5, axis=0)
    along_v = make_interp_spline(b, np.moveaxis(along_u.c, 1, 0), k=5, axis=0)
    poles = np.ascontiguousarray(np.moveaxis(along_v.c, 0, 1))
    return BSplineSurface(5, 5, along_u.t, along_v.t, poles)


def design(surface: BSplineSurface, sense: int) -> DesignFace:
    """The whole of a surface as a face."""
    return DesignFace(0, "", surface, (rectangle(*surface.domain),), sense)


def work(surface: BSplineSurface, sense: int, margin: float = 0.0) -> WorkFace:
    return WorkFace.of(design(surface, sense), margin)


def stacked(*coordinates: Array) -> Array:
    return np.stack(np.broadcast_arrays(*coordinates), axis=-1)


def round_face(radius: float, taper: float = 0.0, height: float = 30.0, turn: float = 1.2) -> BSplineSurface:
    """A cone about z (cylinder for taper 0) whose radius grows by tan(taper) a mm; S_u x S_v points outwards."""

    def shape(u: Array, v: Array) -> Array:
        r = radius + v * np.tan(taper)
        return stacked(r * np.cos(u), r * np.sin(u), v)

    return interpolated(shape, (-0.5 * turn, 0.5 * turn), (0.0, height))


def envelope(tool: Tool, seed: int = 3) -> EnvelopeCase:
    return random_envelopes(tool, 1, seed)[0]


def known(case: EnvelopeCase, count: int = 24) -> Motion:
    """The motion that cuts an exact envelope, as splines; 1e-5 mm off the closed form."""
    t = np.linspace(0.0, 1.0, 12 * count)
    return fitted(t, np.hstack(case.motion.ends(t)), count)


def envelope_scene(case: EnvelopeCase, density: Literal["quick", "normal"] = "quick") -> Scene:
    scene = scene_of(design(case.surface, case.sense), tools=(case.tool,))
    return replace(scene, job=msgspec.structs.replace(scene.job, detection=Detection(density)))
