"""The solid of the blisk blade: three blades on a sector of the wheel, with rolled fillets.

Every patch of a blade (two sides, two round edges) is cut in its own parameters at the fillet's contact line and at the
tip, so its natural boundary is the border of the face and neighbours share it exactly. Nothing is intersected.
"""

from __future__ import annotations

from math import pi

from blade_surfaces import (
    PRESSURE,
    SUCTION,
    Contact,
    RolledPatch,
    crowded_sites,
    edge_contact,
    fit,
    side_contact,
)
from blisk_law import BliskLaw
from OCP.Geom import Geom_CylindricalSurface
from OCP.gp import gp_Ax3, gp_Dir, gp_Pnt
from solids import (
    NamedSolid,
    border_loop,
    outer_loop,
    plane_face,
    revolved_solid,
    rotated_shape,
    sewn_solid,
    straight_edge,
    trimmed_face,
    whole_face,
)

from conflank_cli.geometry.surface import BSplineSurface

SIDE_SITES, EDGE_SITES, HEIGHT_SITES, FILLET_SITES = 16, 12, 10, 8
"""Poles along the chord, around an edge, along the height, across the fillet: the fit stays below 0.2 µm with these."""
SECTOR = pi / 3.0
"""Angle of the hub segment: three blades span 50 degrees at the hub."""
HUB_LENGTH, BORE_RADIUS = 42.0, 50.0
"""Axial length of the segment (3 mm beyond the fillets on either side) and its inner radius, mm."""


def patches(law: BliskLaw) -> dict[str, RolledPatch]:
    """The four patches around a blade as exact formulas, in a ring, by name."""

    def rolled(contact: Contact) -> RolledPatch:
        return RolledPatch(contact, law.hub_radius, law.tip_radius, law.fillet)

    return {
        "suction": rolled(side_contact(law, SUCTION)),
        "leading_edge": rolled(edge_contact(law, 0.0)),
        "pressure": rolled(side_contact(law, PRESSURE)),
        "trailing_edge": rolled(edge_contact(law, 1.0)),
    }


def fitted_patches(law: BliskLaw) -> tuple[dict[str, BSplineSurface], dict[str, BSplineSurface]]:
    """Flank and fillet of each patch as bicubic surfaces; v runs upwards, from 0 to 1, on both."""
    flanks, fillets = {}, {}
    for name, patch in patches(law).items():
        sites = crowded_sites(0.0, 1.0, EDGE_SITES if name.endswith("edge") else SIDE_SITES)
        flanks[name] = fit(patch.flank, sites, crowded_sites(0.0, 1.0, HEIGHT_SITES))
        fillets[name] = fit(patch.blend, sites, crowded_sites(0.0, 1.0, FILLET_SITES))
    return flanks, fillets


def make_blisk_blade(law: BliskLaw) -> NamedSolid:
    """The middle blade between its neighbours (names with _left and _right) on a sector of the hub."""
    flanks, fillets = fitted_patches(law)
    tip = trimmed_face(_cylinder(law.tip_radius), [border_loop(list(flanks.values()), end=True)])
    blade = [(name, whole_face(surface)) for name, surface in flanks.items()]
    blade += [(f"fillet_{name}", whole_face(surface)) for name, surface in fillets.items()]
    blade.append(("tip", tip))
    root = border_loop(list(fillets.values()), end=False)
    half = 0.5 * HUB_LENGTH
    corners = [(BORE_RADIUS, -half), (law.hub_radius, -half), (law.hub_radius, half), (BORE_RADIUS, half)]
    profile = [
        (name, straight_edge(corners[i], corners[(i + 1) % 4]))
        for i, name in enumerate(("hub_front", "hub", "hub_back", "bore"))
    ]
    sector = revolved_solid(profile, -0.5 * SECTOR, SECTOR)
    pitch = 2.0 * pi / law.blades
    turns = (("", 0.0), ("_left", -pitch), ("_right", pitch))
    # The cylinder's own parameter starts opposite the blades, so that its seam is not in the sector.
    holes = [rotated_shape(root, angle) for _, angle in turns]
    faces = [(name, face) for name, face in sector.named() if name not in ("", "hub")]
    faces += [
        ("hub_side_left", plane_face(corners, -0.5 * SECTOR)),
        ("hub_side_right", plane_face(corners, 0.5 * SECTOR)),
    ]
    faces.append(("hub", trimmed_face(_cylinder(law.hub_radius), [outer_loop(sector.face("hub")), *holes])))
    for suffix, angle in turns:
        faces += [(name + suffix, rotated_shape(face, angle)) for name, face in blade]
    return sewn_solid(faces)


def _cylinder(radius: float) -> Geom_CylindricalSurface:
    return Geom_CylindricalSurface(gp_Ax3(gp_Pnt(0.0, 0.0, 0.0), gp_Dir(0.0, 0.0, 1.0), gp_Dir(-1.0, 0.0, 0.0)), radius)
