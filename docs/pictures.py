"""The pictures of README and docs, from a run of the sample blade: `python -m docs.pictures OUT` (make samples).

OUT is a folder that `conflank run` wrote for sample_parts/blisk_blade/job.toml. The gap in the pictures is that of the
posted program's text (`docs.cut_map`), never that of the plan.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import cos, sin, tan
from pathlib import Path
from typing import Any

import click
import matplotlib.image
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Polygon
from scipy.ndimage import distance_transform_edt

from conflank_cli.artifacts.npz import read_artifact
from conflank_cli.cad.reader import read_part
from conflank_cli.geometry.gap import motion_gap
from conflank_cli.geometry.workface import WorkFace
from conflank_cli.optimization import prepare
from conflank_cli.optimization.gauss_newton import error_field
from conflank_cli.optimization.task import (
    FADE_STEPS,
    PAPER_STEPS,
)
from conflank_cli.report.colours import CUTS, LEFT, OVERCUT, gap_colours
from conflank_cli.report.convergence import convergence
from conflank_cli.report.cutter import flute_outline
from conflank_cli.report.gap_map import GapMap, gap_map
from conflank_cli.report.render import Camera, Mesh, Picture, facet_mesh, grid_mesh, render, revolved_mesh
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool
from conflank_cli.verification.posed import PosedProgram, pose_program

Array = npt.NDArray[np.float64]

HERE = Path(__file__).resolve().parent
PICTURES = HERE / "pictures"
PART = HERE.parent / "sample_parts" / "blisk_blade" / "blisk_blade.step"

GRID = (280, 360)
"""Grid of the gap on a face: 0.12 mm apart, less than a pixel of the largest picture."""

DPI = 100
LARGEST_BYTES = 250_000
SHADES = (2, 4, 6, 8)

GAP_COLOURS = gap_colours()
BLADE, HUB, NEIGHBOUR = "#c9ccd1", "#dcdde0", "#e3e4e7"
STEEL, SHANK = "#e9c46a", "#b9bcc2"
RULED_ALPHA = 0.5
CUTTERS = 4  # along the sweep that is shown
SHANK_SHOWN = 4.0  # mm of shank above the flute
STUMP_RADIUS = 64.5  # mm; the neighbour in front of a flank is cut off there, 4.5 mm above the hub
BESIDE, BELOW, ABOVE = 13.0, 11.0, 2.0  # mm of surroundings shown beside, below and above a flank
LIFT = 0.38  # of the way from above
PIXELS = 11.0  # for one mm of the part


def rgb(name: str) -> Array:
    """A colour as (3,)."""
    return np.array(to_rgb(name))


@dataclass(frozen=True, slots=True)
class Sample:
    """What the pictures are made of: the scene and plan, the posted program, the gap on every design face."""

    scene: Scene
    plan: tuple[Sweep, ...]
    posed: PosedProgram
    maps: tuple[GapMap, ...]

    @classmethod
    def of(cls, out: Path) -> Sample:
        """Read the folder that a run wrote."""
        scene, plan, _ = read_artifact(out / "plan.npz", "plan")
        text = (out / f"{scene.job.program.name}.H").read_bytes().decode("ascii")
        posed = pose_program(text, scene)
        return cls(scene, plan, posed, tuple(gap_map(posed, face, GRID) for face in scene.faces))

    @property
    def over(self) -> float:
        """Tolerance for overcut, mm."""
        return self.scene.job.tolerance.overcut

    @property
    def under(self) -> float:
        """Tolerance for stock left, mm."""
        return self.scene.job.tolerance.undercut

    def sweep_poses(self, sweep: int) -> tuple[Tool, Array, Array]:
        """The tool of a sweep (counted from 0), and its tip points and axes in the CAD frame, (N, 3) each."""
        chosen = np.flatnonzero(self.posed.poses.moves.cut == sweep)
        tool = self.posed.tools[int(self.posed.poses.moves.tool[chosen[0]])]
        assert tool is not None
        return tool, self.posed.poses.tip[chosen], self.posed.poses.axis[chosen]

    def gap_colours(self, shown: GapMap) -> Array:
        """Colours (U, V, 3) of the gap: grey where stock is left beyond tolerance."""
        scale = Normalize(-1e3 * self.over, 1e3 * self.under)
        colours = GAP_COLOURS(scale(1e3 * np.clip(shown.gap, -self.over, self.under)))[..., :3]
        return np.where((shown.gap > self.under)[..., None], rgb(LEFT), colours)

    def sweeps_of(self, face: int) -> list[int]:
        """The sweeps over a face of the scene, counted from 0: the program has those of the plan, in its order."""
        return [k for k, sweep in enumerate(self.plan) if sweep.face == face]


# --- the blade ------------------------------------------------------------------------------------------------------


def check_meshes(sample: Sample) -> tuple[list[Mesh], dict[str, list[Mesh]]]:
    """The rest of the part: blade and hub; and each neighbour."""
    names = {face.number: face.name for face in read_part(PART, 1.0).faces}
    check = sample.scene.check
    own: list[Mesh] = []
    neighbours: dict[str, list[Mesh]] = {"left": [], "right": []}
    for number in np.unique(check.face).tolist():
        triangles = check.triangles[check.face == number]
        name = names[number]
        hub = name.startswith("hub") or name == "bore"
        side = next((side for side in neighbours if name.endswith(f"_{side}") and not hub), None)
        mesh = facet_mesh(check.vertices, triangles, rgb(HUB if hub else BLADE if side is None else NEIGHBOUR))
        (own if side is None else neighbours[side]).append(mesh)
    return own, neighbours


def cutter_mesh(tool: Tool, tip: Array, axis: Array) -> list[Mesh]:
    """Ball and cone, and the first of the shank."""
    outline = flute_outline(tool)
    top = tool.length - tool.tip_height
    flute = revolved_mesh(tip, axis, outline.heights, outline.radii, np.tile(rgb(STEEL), (len(outline.heights), 1)))
    ends = np.array([top, top + 1e-3, top + SHANK_SHOWN, top + SHANK_SHOWN + 1e-3])
    shank = revolved_mesh(
        tip, axis, ends, np.array([tool.r_max, tool.r_max, tool.r_max, 0.0]), np.tile(rgb(SHANK), (4, 1))
    )
    return [flute, shank]


def ruled_mesh(tool: Tool, tip: Array, axis: Array, colour: str) -> Mesh:
    """The surface that the axis sweeps from the tip to the plane of r_max."""
    top = tool.length - tool.tip_height
    points = np.stack([tip, tip + top * axis], axis=1)
    along = np.gradient(points, axis=0)
    normals = np.cross(along, axis[:, None, :])
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-300)
    return grid_mesh(points, normals, np.broadcast_to(rgb(colour), points.shape))


def stump(mesh: Mesh) -> Mesh:
    """A neighbouring blade cut off above the hub."""
    return replace(mesh, cut=np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1]) - STUMP_RADIUS)


def camera_for(shown: GapMap, lift: float, bodies: Iterable[Mesh]) -> Camera:
    """A camera that looks at a face from the cutter's side, `lift` of the way from above (+X); the bodies fit in."""
    normal = shown.normals[shown.inside].mean(axis=0)
    up = np.array([1.0, 0.0, 0.0])
    normal -= (normal @ up) * up
    towards = normal / np.linalg.norm(normal) + lift * up
    towards /= np.linalg.norm(towards)
    free = Camera(towards, up, np.zeros(2), np.ones(2), PIXELS)
    flank = shown.points.reshape(-1, 3) @ free.rotation[:2].T
    around = np.concatenate([mesh.vertices for mesh in bodies]) @ free.rotation[:2].T
    low = np.minimum(np.subtract(flank.min(axis=0), (BESIDE, BELOW)), around.min(axis=0) - ABOVE)
    high = np.maximum(np.add(flank.max(axis=0), (BESIDE, ABOVE)), around.max(axis=0) + ABOVE)
    return Camera(towards, up, low, high, PIXELS)


def gap_picture(sample: Sample) -> Figure:
    """Both flanks with the gap of the posted program, and the sweeps that make it."""
    own, neighbours = check_meshes(sample)
    flanks = [grid_mesh(m.points, m.normals, sample.gap_colours(m), m.inside) for m in sample.maps]
    plain = [grid_mesh(m.points, m.normals, np.broadcast_to(rgb(BLADE), m.points.shape), m.inside) for m in sample.maps]
    figure = Figure(figsize=(10.8, 10.6), dpi=DPI, facecolor="white")
    axes: Any = figure.subplots(2, 2)
    figure.subplots_adjust(0.01, 0.085, 0.99, 0.97, 0.03, 0.07)
    for row, (shown, face) in enumerate(zip(sample.maps, sample.scene.faces, strict=True)):
        near, far = ("left", "right") if face.name == "pressure" else ("right", "left")
        around = [*own, *neighbours[far], *(stump(mesh) for mesh in neighbours[near])]
        sweeps = sample.sweeps_of(row)
        longest = max(sweeps, key=lambda k: sample.plan[k].facts["covered_area_mm2"])
        tool, tip, axis = sample.sweep_poses(longest)
        cutters = [mesh for k in evenly(tip, CUTTERS) for mesh in cutter_mesh(tool, tip[k], axis[k])]
        ruled = [ruled_mesh(*sample.sweep_poses(k), CUTS[k % len(CUTS)]) for k in sweeps]
        camera = camera_for(shown, LIFT, [*cutters, *ruled])
        _show(axes[row, 0], render(camera, [*around, *flanks]))
        axes[row, 0].set_title(f"{face.name} side: gap of the posted program", fontsize=10.5)

        solid = render(camera, [*around, *plain, *cutters])
        _show(axes[row, 1], render(camera, ruled).over(solid, RULED_ALPHA))
        for k in sweeps:
            of, tips, directions = sample.sweep_poses(k)
            middle = evenly(tips, 3)[1]
            place = camera.place((tips[middle] + 0.5 * (of.length - of.tip_height) * directions[middle])[None])[0]
            _number(axes[row, 1], place, k)
        axes[row, 1].set_title(f"what the axis sweeps; cutter {tool.name} along sweep {longest + 1}", fontsize=10.5)
    _gap_bar(figure, sample, (0.06, 0.05, 0.36, 0.014))
    return figure


def evenly(points: Array, count: int) -> list[int]:
    """Indices of `count` points that are about evenly spaced along a path (N, 3), both ends included."""
    travel = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    return [int(k) for k in np.abs(travel[:, None] - np.linspace(0.0, travel[-1], count)).argmin(axis=0)]


def _number(axes: Axes, place: Array, cut: int) -> None:
    axes.text(
        place[0], place[1], str(cut + 1), fontsize=11, fontweight="bold", ha="center", va="center", color="white",
        bbox={"boxstyle": "circle,pad=0.25", "facecolor": CUTS[cut % len(CUTS)], "edgecolor": "white"},
    )  # fmt: skip


def _show(axes: Axes, picture: Picture) -> None:
    axes.imshow(picture.pixels(), interpolation="antialiased")
    axes.set_axis_off()


def _gap_bar(figure: Figure, sample: Sample, box: tuple[float, float, float, float]) -> None:
    """Scale of the gap, and what grey means."""
    scale = Normalize(-1e3 * sample.over, 1e3 * sample.under)
    place = figure.add_axes(box)
    bar = figure.colorbar(ScalarMappable(scale, GAP_COLOURS), cax=place, orientation="horizontal")
    bar.set_label("swept gap, µm: overcut < 0 < stock left", fontsize=10)
    text = "within reach of no sweep: more stock left than the tolerance"
    grey = Patch(facecolor=LEFT, label=text)
    figure.legend(
        handles=[grey], loc="lower left", bbox_to_anchor=(box[0] + box[2] + 0.03, box[1] - 0.022), frameon=False
    )


# --- in parameters --------------------------------------------------------------------------------------------------


def patches_picture(sample: Sample) -> Figure:
    """Which sweep covers what of each side, and the gap, over (u, v)."""
    figure = Figure(figsize=(14.0, 6.2), dpi=DPI, facecolor="white")
    axes: Any = figure.subplots(1, 2 * len(sample.maps))
    figure.subplots_adjust(0.045, 0.2, 0.99, 0.95, 0.2)
    for row, (shown, face) in enumerate(zip(sample.maps, sample.scene.faces, strict=True)):
        sweeps = sample.sweeps_of(row)
        covers = [(shown.by_cut[k] >= -sample.over) & (shown.by_cut[k] <= sample.under) & shown.inside for k in sweeps]
        ruler = np.argmin(np.where(covers, shown.by_cut[sweeps], np.inf), axis=0)
        reached = np.any(covers, axis=0)
        extent = (shown.u[0], shown.u[-1], shown.v[0], shown.v[-1])
        rate = np.array([np.linalg.norm(np.diff(shown.points, axis=k), axis=2).sum(axis=k).mean() for k in (0, 1)])
        aspect = rate[1] / rate[0] * (extent[1] - extent[0]) / (extent[3] - extent[2])
        palette = [rgb(CUTS[k % len(CUTS)]) for k in sweeps]
        image = np.where(reached[..., None], np.array(palette)[ruler], rgb(LEFT))
        image = np.where(shown.inside[..., None], 0.45 * image + 0.55, 1.0)
        image = np.where((shown.inside & ~reached)[..., None], rgb(LEFT), image)
        left, right = axes[2 * row : 2 * row + 2]
        left.imshow(image.transpose(1, 0, 2), origin="lower", extent=extent, aspect=aspect, interpolation="nearest")
        for k, cover in zip(sweeps, covers, strict=True):
            colour = CUTS[k % len(CUTS)]
            left.contour(shown.u, shown.v, cover.T.astype(float), levels=[0.5], colors=[colour], linewidths=1.6)
            lowest = reached & (ruler == sweeps.index(k))
            own = lowest if lowest.any() else cover
            middle = np.argwhere(own)[_innermost(own)]
            _number(left, np.array([shown.u[middle[0]], shown.v[middle[1]]]), k)
        left.set_title(f"{face.name} side: sweeps", fontsize=11)
        picture = np.where(shown.inside[..., None], sample.gap_colours(shown), 1.0)
        right.imshow(picture.transpose(1, 0, 2), origin="lower", extent=extent, aspect=aspect, interpolation="nearest")
        right.set_title(f"{face.name} side: gap of the program", fontsize=11)
        for each in (left, right):
            each.set_xlabel("u, from leading to trailing edge")
        left.set_ylabel("v, from hub to tip")
    _gap_bar(figure, sample, (0.05, 0.085, 0.26, 0.022))
    figure.text(0.345, 0.045, "outline: what a sweep leaves within tolerance; fill: the sweep that cuts lowest there")
    return figure


def _innermost(mask: npt.NDArray[np.bool_]) -> int:
    """Index into np.argwhere(mask) of the place furthest from its border."""
    depth = distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    return int(np.argmax(depth[mask]))


def axis_error_picture(sample: Sample) -> Figure:
    """The axis error of the longest sweep on its grid of poses and spheres."""
    index = max(range(len(sample.plan)), key=lambda k: sample.plan[k].facts["covered_area_mm2"])
    sweep = sample.plan[index]
    tool = next(tool for tool in sample.scene.tools if tool.name == sweep.tool)
    face = WorkFace.under(sample.scene.faces[sweep.face], tool)
    field, _, fractions = error_field(face, tool, sweep.motion, sample.scene.job.tolerance.allowance, (401, 121))
    error = 1e3 * np.where(field.on > 0.5, field.error, np.nan)
    figure = Figure(figsize=(10.0, 5.0), dpi=DPI, facecolor="white")
    axes = figure.add_axes((0.08, 0.12, 0.78, 0.78))
    limit = 1e3 * sample.over
    colours = GAP_COLOURS.with_extremes(bad="#ffffff", over=LEFT, under=OVERCUT)
    height = fractions * tool.length
    image = axes.imshow(
        error.T, origin="lower", extent=(0.0, 1.0, height[0], height[-1]), aspect="auto", cmap=colours,
        norm=Normalize(-limit, limit), interpolation="nearest",
    )  # fmt: skip
    t = np.linspace(0.0, 1.0, error.shape[0])
    lines = axes.contour(t, height, error.T, levels=[-4, -2, -1, 0, 1, 2, 4, 10], colors="black", linewidths=0.6)
    axes.clabel(lines, fmt="%g", fontsize=8)
    axes.set_xlabel("t, along the sweep")
    axes.set_ylabel("height of the sphere's centre on the axis, mm")
    axes.set_title(f"axis error ε(t, s) of sweep {index + 1}, µm; white: the contact is off the face", fontsize=11)
    figure.colorbar(image, cax=figure.add_axes((0.88, 0.12, 0.022, 0.78)), extend="both").set_label("ε, µm")
    return figure


def measures_picture(sample: Sample, candidates: Sequence[Sweep]) -> Figure:
    """Both measures of one sweep on the face, as the paper's functional leaves it, and its convergence in both."""
    sweep = max(candidates, key=lambda each: each.facts["area_mm2"])
    tool = next(tool for tool in sample.scene.tools if tool.name == sweep.tool)
    task = prepare(sample.scene, [(sweep.face, sweep.tool)])[sweep.face, sweep.tool]
    allowance = task.limits.allowance
    steps = convergence(task, sweep.motion)
    paper, final = steps[PAPER_STEPS + FADE_STEPS][1], steps[-1][1]
    # The picture is about the border: points of the face as dense as its pixels.
    samples = task.face.samples(task.face.spacing(90_000))
    gap = motion_gap(paper, tool, samples.points, allowance)[0]
    field = error_field(task.face, tool, paper, allowance, (500, 160))[0]
    limit = 1e3 * sample.over
    colours = GAP_COLOURS.with_extremes(over=LEFT, under=OVERCUT)
    figure = Figure(figsize=(12.0, 4.6), dpi=DPI, facecolor="white")
    shown = (
        (
            field.u[field.on > 0.5],
            field.v[field.on > 0.5],
            field.error[field.on > 0.5],
            "axis error ε at its footpoints",
        ),
        (*samples.uv.T, gap, "swept gap g at the points of the face"),
    )
    for k, (u, v, value, title) in enumerate(shown):
        axes = figure.add_axes((0.05 + 0.3 * k, 0.13, 0.27, 0.76))
        points = axes.scatter(
            u, v, c=1e3 * value, s=4.0, marker="s", cmap=colours, norm=Normalize(-limit, limit), linewidths=0.0
        )
        axes.set(xlim=(samples.uv[:, 0].min(), samples.uv[:, 0].max()), xlabel="u", title=title)
        axes.set_ylim(samples.uv[:, 1].min(), samples.uv[:, 1].max())
        axes.set_facecolor("#ffffff")
    figure.colorbar(points, cax=figure.add_axes((0.635, 0.13, 0.012, 0.76)), extend="both").set_label("µm")
    axes = figure.add_axes((0.755, 0.13, 0.235, 0.76))
    served = np.abs(motion_gap(final, tool, samples.points, allowance)[0]) <= sample.under
    axis_means, gap_means = [], []
    for _, motion in steps:
        field = error_field(task.face, tool, motion, allowance, (200, 60))[0]
        near = (field.on > 0.5) & (np.abs(field.error) <= 5.0 * sample.under)
        axis_means.append(1e3 * float(np.abs(field.error[near]).mean()))
        gap = motion_gap(motion, tool, samples.points[served][::7], allowance, 1.0)[0]
        gap_means.append(1e3 * float(np.abs(gap).mean()))
    axes.plot(gap_means, color="#1f4e9c", label="|g| over what is covered in the end")
    axes.plot(axis_means, color="#e69f00", label="|ε| where below 50 µm")
    for name in dict.fromkeys(name for name, _ in steps[1:]):
        first = next(k for k, (each, _) in enumerate(steps) if each == name)
        axes.axvline(first - 0.5, color="#999999", linewidth=0.8)
        axes.text(first - 0.3, 0.98, name, transform=axes.get_xaxis_transform(), fontsize=8, rotation=90, va="top")
    axes.set(xlabel="Gauss-Newton step", title="mean, µm")
    axes.set_ylim(0.0, 1.35 * max(*gap_means, *axis_means))
    axes.legend(fontsize=8, loc="lower left")
    return figure


# --- the cone's spheres ---------------------------------------------------------------------------------------------


def spheres_picture() -> Figure:
    """The spheres that a cone is the envelope of; the angle is exaggerated."""
    tool = Tool("exaggerated", 1.5, 6.0, 14.0)
    alpha = tool.half_angle
    figure = Figure(figsize=(10.0, 4.6), dpi=DPI, facecolor="white")
    axes = figure.add_axes((0.01, 0.02, 0.98, 0.96))
    axes.set_aspect("equal")
    axes.set_axis_off()
    top, r_max, r_min = tool.length, tool.r_max, tool.r_min
    outline = [(0.0, r_min), (top, r_max), (top, -r_max), (0.0, -r_min)]
    axes.add_patch(Polygon(outline, closed=True, facecolor="#eef1f5", edgecolor="#333333", linewidth=1.5))
    axes.add_patch(
        Circle((tool.ball_centre_height, 0.0), tool.ball_radius, facecolor="#eef1f5", edgecolor="#333333", zorder=0)
    )
    low, high = tool.centre_range
    axes.plot([tool.tip_height - 1.0, high + 3.5], [0.0, 0.0], color="#333333", linewidth=1.0, dashes=(10, 3, 2, 3))
    for height, colour in ((low, "#228833"), (6.0, "#4477aa"), (high, "#aa3377")):
        radius = float(tool.sphere_radius(height))
        axes.add_patch(Circle((height, 0.0), radius, fill=False, edgecolor=colour, linewidth=1.6))
        contact = (height - radius * sin(alpha), radius * cos(alpha))
        axes.plot([height, contact[0]], [0.0, contact[1]], color=colour, linewidth=1.6)
        axes.plot(*contact, marker="o", color=colour, markersize=6)
        axes.plot(height, 0.0, marker="o", color=colour, markersize=4)
    height, radius = 6.0, float(tool.sphere_radius(6.0))
    cone_radius = r_min + height * tan(alpha)
    axes.plot([height, height], [0.0, cone_radius], color="#cc3311", linewidth=1.6)
    below, beside = radius * sin(alpha), radius * cos(alpha)
    labels = (
        ("r(h), the cone's radius:\nnot a distance", (height, 0.75 * cone_radius), (4.6, 6.4), "#cc3311"),
        (
            "d = r(h) cos α, the sphere's radius:\nthe distance to the face",
            (height - 0.55 * below, 0.55 * beside),
            (-6.2, 5.6),
            "#4477aa",
        ),
        ("it touches r(h) cos α sin α\nbelow its centre", (height - below, beside), (-6.2, 3.6), "#4477aa"),
        ("first centre whose contact is on the cone:\nr_min tan α above p", (low, 0.0), (-6.2, -4.4), "#228833"),
        ("last one: L + r_max tan α above p", (high, 0.0), (18.0, -6.6), "#aa3377"),
    )
    for text, at, place, colour in labels:
        line = {"arrowstyle": "-", "color": colour}
        axes.annotate(text, at, place, color=colour, arrowprops=line, fontsize=11, ha="left", va="center")
    for level, half, name in ((0.0, r_min, "p"), (top, r_max, "q")):
        axes.plot([level, level], [-half, half], color="#777777", linewidth=1.0, linestyle=":")
        axes.plot(level, 0.0, marker="o", color="#333333", markersize=4)
        axes.text(level - 0.15, -0.25, name, fontsize=13, style="italic", ha="right", va="top")
    axes.text(tool.tip_height - 0.2, 0.35, "tip", fontsize=11, ha="right")
    axes.text(high + 3.4, 0.3, "spindle", fontsize=11, ha="right", va="bottom")
    axes.text(0.15, -r_min + 0.1, "r_min", fontsize=11, ha="left", va="bottom", color="#777777")
    axes.text(top + 0.1, -r_max, "r_max", fontsize=11, ha="left", va="bottom", color="#777777")
    axes.set_xlim(-6.5, 27.5)
    axes.set_ylim(-7.2, 7.2)
    return figure


# --- files ----------------------------------------------------------------------------------------------------------


def save(figure: Figure, path: Path) -> None:
    """Write a figure as a small PNG; equal figures give equal bytes.

    Colours are rounded as far as it takes to keep the file small: nobody sees the difference between such shades.
    """
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    levels = np.asarray(canvas.buffer_rgba())[..., :3].astype(np.int64)
    nameless: Any = {"Software": None}
    for step in SHADES:
        shades = np.minimum((levels + step // 2) // step * step, 255).astype(np.uint8)
        buffer = io.BytesIO()
        matplotlib.image.imsave(buffer, shades, format="png", metadata=nameless, pil_kwargs={"optimize": True})
        if len(buffer.getvalue()) <= LARGEST_BYTES:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(buffer.getvalue())
            return
    raise ValueError(f"{path.name} has {len(buffer.getvalue())} bytes, more than {LARGEST_BYTES}")


@click.command()
@click.argument("out", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--to", "folder", type=click.Path(path_type=Path), default=PICTURES, help="Where to write the pictures.")
def main(out: Path, folder: Path) -> None:
    """Draw all pictures of the run in OUT."""
    sample = Sample.of(out)
    save(gap_picture(sample), folder / "blisk_gap.png")
    save(patches_picture(sample), folder / "blisk_patches.png")
    save(axis_error_picture(sample), folder / "axis_error.png")
    candidates = read_artifact(out / "candidates.npz", "candidates")[1]
    save(measures_picture(sample, candidates), folder / "measures.png")
    save(spheres_picture(), folder / "spheres.png")


if __name__ == "__main__":
    main()
