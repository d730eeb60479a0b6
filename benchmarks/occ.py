"""The CAD kernel as an independent authority: the same surface as OCP holds it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeFace
from OCP.collections import Array1_double, Array1_int, Array2_double, Array2_gp_Pnt
from OCP.Geom import Geom_BSplineSurface
from OCP.gp import gp_Pnt
from OCP.IFSelect import IFSelect_RetDone
from OCP.Message import Message
from OCP.STEPControl import STEPControl_AsIs, STEPControl_Writer

from conflank_cli.geometry.surface import BSplineSurface


def occ_surface(surface: BSplineSurface) -> Geom_BSplineSurface:
    """The surface as a Geom_BSplineSurface with the same parameters."""
    nu, nv = surface.poles.shape[:2]
    poles, weights = Array2_gp_Pnt(1, nu, 1, nv), Array2_double(1, nu, 1, nv)
    for i in range(nu):
        for j in range(nv):
            poles.SetValue(i + 1, j + 1, gp_Pnt(*(float(x) for x in surface.poles[i, j])))
            weights.SetValue(i + 1, j + 1, 1.0 if surface.weights is None else float(surface.weights[i, j]))
    uk, um = _knots(surface.knots_u)
    vk, vm = _knots(surface.knots_v)
    return Geom_BSplineSurface(poles, weights, uk, vk, um, vm, surface.degree_u, surface.degree_v)


def _knots(full: npt.NDArray[np.float64]) -> tuple[Array1_double, Array1_int]:
    """Distinct knots and their multiplicities."""
    values, counts = np.unique(full, return_counts=True)
    knots, multiplicities = Array1_double(1, len(values)), Array1_int(1, len(values))
    for k, (value, count) in enumerate(zip(values, counts, strict=True), start=1):
        knots.SetValue(k, float(value))
        multiplicities.SetValue(k, int(count))
    return knots, multiplicities


def write_step(surface: BSplineSurface, path: Path) -> None:
    """Write the untrimmed surface as one face of a STEP file, oriented along S_u x S_v.

    Raises
    ------
    RuntimeError: Open CASCADE refused.
    """
    Message.DefaultMessenger_s().ChangePrinters().Clear()
    face = BRepBuilderAPI_MakeFace(occ_surface(surface), 1e-7).Face()
    writer = STEPControl_Writer()
    if writer.Transfer(face, STEPControl_AsIs) != IFSelect_RetDone or writer.Write(str(path)) != IFSelect_RetDone:
        raise RuntimeError(f"{path}: Open CASCADE could not write the STEP file.")
