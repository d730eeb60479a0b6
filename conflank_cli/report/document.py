"""The report: one file of HTML with everything in it that an engineer looks at before cutting.

The cutter's poses are those that verification's own reader finds in the program's text, never those of the plan. Equal
inputs give equal bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from conflank_cli.coverage import FaceCoverage, Reason
from conflank_cli.detection.reachability import Reachability
from conflank_cli.geometry.face import CheckMesh
from conflank_cli.report.colours import COVERED, GAP, GREYS, LEFT, OVERCUT, REACH, cut_colour
from conflank_cli.report.cutter import outlines
from conflank_cli.report.findings import Spot, spots
from conflank_cli.report.gap_map import GapMap, face_grid, gap_map, grid_shape
from conflank_cli.report.packing import Packer
from conflank_cli.report.tables import Cut, page_body
from conflank_cli.scene import Scene
from conflank_cli.tool import Tool
from conflank_cli.verification.axes import drive
from conflank_cli.verification.evaluation import inside_rows
from conflank_cli.verification.posed import PosedProgram
from conflank_cli.verification.result import Verification

Array = npt.NDArray[np.float64]
Bytes = npt.NDArray[np.uint8]

MESH_TRIANGLES = 20_000
"""Triangles of all design faces together, about."""

GAP_STEP = 2e-5
"""mm, the unit of the gap in the page: ±0.65 mm fit into two bytes."""

FAR = 32767
"""In units of the gap: further away than can be said."""

BORDER = (-1.0 / 3.0, 0.0, 1.0 / 3.0)
"""Where in a cell the trim is asked for, in cells: the share inside makes its border smooth."""

NEAR_GRID = (24, 24)
"""Points of a face to which a cut is held to tell which face it is over."""

REACH_STEPS = 254
"""Steps of the axis error up to twice the tolerance; 255 is more."""

COLOURS = {
    "gap": GAP,
    "overcut": OVERCUT,
    "left": LEFT,
    "marked": "#ff3df2",
    "rest": "#c3c8cf",
    "obstacle": "#b08968",
    "rapid": "#9aa3ad",
    "finding": "#d7191c",
    "place": "#16202c",
    "reach": REACH,
    "reasons": [COVERED if reason is Reason.COVERED else GREYS[reason] for reason in Reason],
}


@dataclass(frozen=True, slots=True)
class ReachOfFace:
    """How well a tool reaches a face of the scene (its index), along a share of the flute (a label); limit in mm."""

    face: int
    tool: str
    engaged: str
    limit: float
    found: Reachability


def report_html(
    scene: Scene,
    posed: PosedProgram,
    text: str,
    verification: Verification,
    coverage: Sequence[FaceCoverage] = (),
    reach: Sequence[ReachOfFace] = (),
) -> str:
    """The report of a program.

    Parameters
    ----------
    scene: the job with its geometry.
    posed, text: the program, with its poses and as it is.
    verification: what it cuts.
    coverage: why the plan leaves what it leaves, one for each face; none where it is not known.
    reach: maps of what the tools reach, to be looked at as well.

    Returns
    -------
    A page that needs nothing else.
    """
    pack = Packer()
    cuts = cuts_of(posed, verification, scene)
    maps = [gap_map(posed, face, grid_shape(face), scene.job.tolerance.allowance) for face in scene.faces]
    places = spots(verification)
    labels = {(each.tool, each.engaged): f"reach{k}" for k, each in enumerate(_one_face(reach))}
    data = {
        "part": scene.part_name,
        "program": {"name": verification.program, "letters": posed.program.rotary_letters},
        "tolerance": {
            "overcut_um": 1e3 * scene.job.tolerance.overcut,
            "undercut_um": 1e3 * scene.job.tolerance.undercut,
        },
        "gap_step_um": 1e3 * GAP_STEP,
        "far_um": round(1e3 * GAP_STEP * FAR),
        "colours": COLOURS,
        "start": cuts[0].first if cuts else 0,
        "cuts": [
            {"label": cut.label, "kind": cut.kind, "colour": cut.colour, "first": cut.first, "face": cut.face}
            for cut in cuts
        ],
        "tools": [_tool_entry(tool) for tool in posed.tools],
        "faces": [_pack_face(pack, index, shown, len(maps)) for index, shown in enumerate(maps)],
        "places": [
            {"point": spot.point, "face": spot.face, "finding": spot.finding, "pose": _pose_at(posed, spot)}
            for spot in places
        ],
        "reach": [
            {"face": each.face, "key": labels[each.tool, each.engaged], "limit_um": 1e3 * each.limit} for each in reach
        ],
    }
    for index, (shown, covered) in enumerate(zip(maps, coverage, strict=False)):
        pack.exact(f"face{index}_reason", _nearest(shown, covered.points, covered.reason), "u1")
    for each in reach:
        values = _reach_values(maps[each.face], each)
        pack.exact(f"face{each.face}_{labels[each.tool, each.engaged]}", values, "u1")
    _pack_poses(pack, posed, scene)
    foreign = scene.check.face < 0
    for name, chosen in (("rest", ~foreign), ("obstacle", foreign)):
        vertices, triangles = _compact(scene.check, chosen)
        pack.points(f"{name}_vertices", vertices)
        pack.whole(f"{name}_triangles", triangles, "i4")
    # Blocks of programs that are called have numbers of their own.
    shown_text = "" if verification.called_sha256 else text
    pack.exact("text", np.frombuffer(shown_text.encode("utf-8", "replace"), dtype=np.uint8), "u1")
    data["arrays"] = pack.entries
    modes = {"gap": "swept gap", "cut": "which cut makes it"}
    if coverage:
        modes["reason"] = "why the plan leaves the rest"
    modes |= {key: f"least axis error of {tool}, {engaged} of the flute" for (tool, engaged), key in labels.items()}
    # Within a script nothing may look like markup.
    document = msgspec.json.encode(data).decode().replace("<", "\\u003c")
    page = files("conflank_cli.report") / "page"
    css, script = ((page / name).read_text("utf-8") for name in ("page.css", "viewer.js"))
    left = {reason: sum(each.area(reason) for each in coverage) for reason in Reason}
    body = page_body(scene, posed, verification, cuts, places, modes, left, bool(foreign.any()))
    return "".join(
        (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
            # An icon of its own, so that no browser asks a server for one.
            '<link rel="icon" href="data:,">\n',
            body.title,
            f"<style>\n{css}</style>\n</head>\n<body>\n",
            body.content,
            f'<script type="application/json" id="report">{document}</script>\n',
            f'<script type="text/plain" id="arrays">{pack.text()}</script>\n',
            f"<script>\n{script}</script>\n</body>\n</html>\n",
        )
    )


def _one_face(reach: Sequence[ReachOfFace]) -> list[ReachOfFace]:
    """Those of the first face: the same tools and shares come again on every other."""
    return [each for each in reach if each.face == reach[0].face]


# --- the program ----------------------------------------------------------------------------------------------------


def cuts_of(posed: PosedProgram, verification: Verification, scene: Scene) -> list[Cut]:
    """The program's cuts, with what the verification says of them."""
    figures = {("sweep", cut.number): cut for cut in verification.sweeps}
    figures |= {("pass", cut.number): cut for cut in verification.passes}
    moves = posed.poses.moves
    found = []
    for index, label in enumerate(posed.program.cuts):
        own = np.flatnonzero(moves.cut == index)
        feeds = moves.feed[own][~moves.rapid[own] & np.isfinite(moves.feed[own])]
        found.append(
            Cut(
                kind=label.kind,
                number=label.number,
                colour=cut_colour(index),
                first=int(own[0]) if len(own) else 0,
                face=_face_below(posed, own, scene),
                feed=(float(feeds.min()), float(feeds.max())) if len(feeds) else None,
                figures=figures[label.kind, label.number],
            )
        )
    return found


def _face_below(posed: PosedProgram, own: npt.NDArray[np.int64], scene: Scene) -> int | None:
    """Number of the design face that the middle of the cut's axis is nearest to."""
    if len(own) == 0:
        return None
    tool = posed.tools[int(posed.poses.moves.tool[own[0]])]
    height = 0.0 if tool is None else 0.5 * (tool.length - tool.tip_height)
    some = own[:: max(len(own) // 20, 1)]
    distances = []
    for face in scene.faces:
        tree = cKDTree(face_grid(face, NEAR_GRID).points.reshape(-1, 3))
        # With copies, as the one that it is for sees it.
        away = [tree.query(poses.tip[some] + height * poses.axis[some])[0].mean() for poses in posed.by_copy]
        distances.append(float(min(away)))
    return scene.faces[int(np.argmin(distances))].number


def _pose_at(posed: PosedProgram, spot: Spot) -> int | None:
    """The last pose of the block of a place."""
    if spot.block is None:
        return None
    found = np.flatnonzero(posed.poses.moves.block == spot.block)
    return int(found[-1]) if len(found) else None


def _pack_poses(pack: Packer, posed: PosedProgram, scene: Scene) -> None:
    moves = posed.poses.moves
    pack.exact("tip", posed.poses.tip, "f8")
    pack.exact("axis", posed.poses.axis, "f8")
    pack.exact("point", moves.point, "f4")
    pack.exact("rotary", np.degrees(moves.rotary), "f4")
    pack.exact("feed", moves.feed, "f4")
    pack.exact("seconds", drive(posed, scene).seconds, "f4")
    pack.whole("block", moves.block, "i4")
    pack.whole("cut", moves.cut, "i2")
    pack.whole("tool", moves.tool, "i2")
    pack.exact("joined", moves.joined, "u1")
    pack.exact("rapid", moves.rapid, "u1")


def _tool_entry(tool: Tool | None) -> dict[str, Any]:
    """A cutter to be drawn; nothing of one that is not known."""
    if tool is None:
        return {"name": "?", "low": 0.0, "high": 0.0, "parts": []}
    parts = [
        {"kind": part.kind, "profile": np.round(np.stack([part.heights, part.radii], axis=1), 5).tolist()}
        for part in outlines(tool)
    ]
    return {"name": tool.name, "low": -tool.tip_height, "high": tool.length - tool.tip_height, "parts": parts}


# --- the part -------------------------------------------------------------------------------------------------------


def _pack_face(pack: Packer, index: int, shown: GapMap, faces: int) -> dict[str, Any]:
    """Mesh and gaps of a face; returns what the page has to know besides."""
    shape = shown.gap.shape
    side = max(int(np.sqrt(MESH_TRIANGLES / faces / 2)), 2)
    points = face_grid(shown.face, (side, side)).points
    pack.points(f"face{index}_points", points.reshape(-1, 3))
    pack.exact(f"face{index}_inside", _share_inside(shown), "u1")
    pack.whole(f"face{index}_gap", _steps(shown.gap), "i2")
    near = [k for k, gap in enumerate(shown.by_cut) if (np.abs(gap[shown.about]) < GAP_STEP * FAR).any()]
    for k in near:
        pack.whole(f"face{index}_cut{k}", _steps(shown.by_cut[k]), "i2")
    return {
        "index": index,
        "number": shown.face.number,
        "name": shown.face.name,
        "sense": shown.face.sense,
        "grid": shape,
        "mesh": (side, side),
        "cuts": near,
        "normal": np.round(shown.normals[shown.about].mean(axis=0), 6).tolist(),
    }


def _steps(gap: Array) -> npt.NDArray[np.int16]:
    return np.clip(np.round(np.where(np.isfinite(gap), gap, 1.0) / GAP_STEP), -FAR, FAR).astype(np.int16)


def _share_inside(shown: GapMap) -> Bytes:
    """Share of each cell that is on the trimmed face, 0 to 255; beyond the box of the trim as at its border."""
    total = np.zeros(shown.inside.shape)
    steps = [values[1] - values[0] for values in (shown.u, shown.v)]

    def moved(values: Array, by: float) -> Array:
        rim = 1e-6 * (values[-1] - values[0])
        return np.clip(values + by, values[0] + rim, values[-1] - rim)

    u = np.concatenate([moved(shown.u, du * steps[0]) for du in BORDER])
    for dv in BORDER:
        within = inside_rows(shown.face.loops, u, moved(shown.v, dv * steps[1]))
        total += within.reshape(len(BORDER), *total.shape).sum(axis=0)
    return np.round(total * 255.0 / len(BORDER) ** 2).astype(np.uint8)


def _reach_values(shown: GapMap, reach: ReachOfFace) -> Bytes:
    """The least axis error at every value of a face, from the nearest point it was sought at."""
    share = _nearest(shown, reach.found.samples.points, reach.found.error) / reach.limit
    return np.where(share <= 1.0, np.round(REACH_STEPS * np.clip(share, 0.0, 1.0)), 255).astype(np.uint8)


def _nearest(shown: GapMap, points: Array, values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """For every value of a face that of the nearest of some points."""
    return np.asarray(values[cKDTree(points).query(shown.points.reshape(-1, 3))[1]])


def _compact(mesh: CheckMesh, chosen: npt.NDArray[np.bool_]) -> tuple[Array, npt.NDArray[np.int64]]:
    """Some triangles of a mesh, with their own vertices alone."""
    used, inverse = np.unique(mesh.triangles[chosen], return_inverse=True)
    return mesh.vertices[used], inverse.reshape(-1, 3).astype(np.int64)
