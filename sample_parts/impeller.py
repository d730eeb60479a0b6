"""The solid of the impeller: eight blades, trimmed by the shroud and the exit cylinder, fused with the hub."""

from __future__ import annotations

from math import pi

from blade_surfaces import (
    PRESSURE,
    SUCTION,
    Contact,
    cap_surface,
    chord_surface,
    crowded_sites,
    edge_contact,
    fit,
    points_only,
    side_contact,
)
from impeller_law import ImpellerLaw
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeEdge
from OCP.Geom import Geom_Ellipse, Geom_TrimmedCurve
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.TopoDS import TopoDS_Edge
from solids import (
    NamedSolid,
    common,
    fuse,
    revolved_solid,
    rotated,
    sewn_solid,
    straight_edge,
    whole_face,
)

from conflank_cli.geometry.surface import BSplineSurface

SIDE_SITES, EDGE_SITES, HEIGHT_SITES = 16, 10, 8
"""Poles along the blade, around the leading edge, from hub to shroud: the fit stays below 0.7 µm with these."""
LAST_X, FIRST_H, LAST_H = 1.02, -0.10, 1.08
"""How far the untrimmed blade reaches past the exit, below the hub and above the shroud."""
BORE_RADIUS, NOSE, BACK_PLATE = 6.0, 5.0, 3.0
"""Radius of the bore; length of the hub before the leading edge; thickness of the disc at the exit. mm."""


def sides(law: ImpellerLaw) -> dict[str, Contact]:
    """Both sides of a blade as exact formulas, u = x and v = h."""
    # The wrap angle falls along the flow: the wheel turns towards +theta, and the side that looks there pushes.
    return {"suction": side_contact(law, SUCTION), "pressure": side_contact(law, PRESSURE)}


def fitted_sides(law: ImpellerLaw) -> dict[str, BSplineSurface]:
    """Both sides as bicubic surfaces, somewhat larger than the blade."""
    sites_x, sites_h = crowded_sites(0.0, LAST_X, SIDE_SITES), crowded_sites(FIRST_H, LAST_H, HEIGHT_SITES)
    return {name: fit(points_only(contact), sites_x, sites_h) for name, contact in sides(law).items()}


def _meridian(law: ImpellerLaw, end: int) -> TopoDS_Edge:
    """The quarter ellipse of hub (end 0) or shroud (end 1) in the half plane y = 0, from inlet to exit."""
    radial = law.exit_radius - law.inlet_radius[end]
    axial = law.inlet_height - end * law.exit_width
    centre = gp_Pnt(law.exit_radius, 0.0, law.inlet_height)
    # Open CASCADE wants the longer half axis first.
    main, cross = (gp_Dir(-1.0, 0.0, 0.0), gp_Dir(0.0, 0.0, -1.0))
    if radial >= axial:
        ellipse = Geom_Ellipse(gp_Ax2(centre, main.Crossed(cross), main), radial, axial)
        return BRepBuilderAPI_MakeEdge(Geom_TrimmedCurve(ellipse, 0.0, 0.5 * pi)).Edge()
    ellipse = Geom_Ellipse(gp_Ax2(centre, cross.Crossed(main), cross), axial, radial)
    return BRepBuilderAPI_MakeEdge(Geom_TrimmedCurve(ellipse, 0.0, 0.5 * pi)).Edge()


def _wheel(law: ImpellerLaw) -> NamedSolid:
    """The hub without blades."""
    top, hub = law.inlet_height + NOSE, law.inlet_radius[0]
    return revolved_solid(
        [
            ("hub", _meridian(law, 0)),
            ("exit", straight_edge((law.exit_radius, 0.0), (law.exit_radius, -BACK_PLATE))),
            ("back", straight_edge((law.exit_radius, -BACK_PLATE), (BORE_RADIUS, -BACK_PLATE))),
            ("bore", straight_edge((BORE_RADIUS, -BACK_PLATE), (BORE_RADIUS, top))),
            ("nose_front", straight_edge((BORE_RADIUS, top), (hub, top))),
            ("nose", straight_edge((hub, top), (hub, law.inlet_height))),
        ]
    )


def _turned_blank(law: ImpellerLaw) -> NamedSolid:
    """The body of revolution that the blades do not exceed: below the shroud, inside the exit radius."""
    top, shroud = law.inlet_height + NOSE, law.inlet_radius[1]
    return revolved_solid(
        [
            ("tip", _meridian(law, 1)),
            ("trailing_edge", straight_edge((law.exit_radius, law.exit_width), (law.exit_radius, 0.0))),
            ("", straight_edge((law.exit_radius, 0.0), (BORE_RADIUS, 0.0))),
            ("", straight_edge((BORE_RADIUS, 0.0), (BORE_RADIUS, top))),
            ("", straight_edge((BORE_RADIUS, top), (shroud, top))),
            ("tip", straight_edge((shroud, top), (shroud, law.inlet_height))),
        ],
        # The seam of the revolved faces belongs where the first blade (0 to 90 degrees) is not.
        start_angle=-0.5 * pi,
    )


def make_impeller(law: ImpellerLaw) -> NamedSolid:
    """The whole impeller; the faces of blade k carry _k, those of the first blade none."""
    flanks = fitted_sides(law)
    pair = (flanks["suction"], flanks["pressure"])
    turn_sites, sites_h = crowded_sites(0.0, 1.0, EDGE_SITES), crowded_sites(FIRST_H, LAST_H, HEIGHT_SITES)
    leading = fit(points_only(edge_contact(law, 0.0)), turn_sites, sites_h)
    blunt = chord_surface(pair, turn_sites)
    untrimmed = sewn_solid(
        [
            ("suction", whole_face(pair[0])),
            ("pressure", whole_face(pair[1])),
            ("leading_edge", whole_face(leading)),
            ("", whole_face(blunt)),
            ("", whole_face(cap_surface(pair, (leading, blunt), 0))),
            ("", whole_face(cap_surface(pair, (leading, blunt), -1))),
        ]
    )
    blade = common(untrimmed, _turned_blank(law))
    pitch = 2.0 * pi / law.blades
    copies = [rotated(blade, k * pitch, f"_{k}" if k else "") for k in range(law.blades)]
    return fuse(_wheel(law), copies)
