"""Figures of a job, as the paper shows them: lines, patches, the gap on the part, convergence, axes over time.

Numbers are those of the posted program's text, as verification reads it, but for lines and convergence, which are about
what comes before there is one. No display is needed.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from conflank_cli.geometry.gap import motion_gap
from conflank_cli.optimization import prepare
from conflank_cli.report.colours import LEFT, cut_colour, gap_colours
from conflank_cli.report.convergence import convergence
from conflank_cli.report.gap_map import FaceGrid, GapMap, face_grid, gap_map
from conflank_cli.report.picture_file import DPI, FORMATS
from conflank_cli.report.render import Camera, Mesh, facet_mesh, grid_mesh, render
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep
from conflank_cli.verification.axes import drive
from conflank_cli.verification.posed import PosedProgram

Array = npt.NDArray[np.float64]

PANEL = 5.0  # inches
PIXELS_ACROSS = 900  # of the part in a shaded picture
LIFT = 0.42  # of the way from above
AROUND = 0.12  # of a face's size, shown beyond it
BEFORE = 0.5  # mm before a face from which on bodies are cut away
BODY, WHITE = "#d5d8dd", (1.0, 1.0, 1.0)
LINES_SHOWN = 9  # along each candidate
GRID = (160, 160)
FINE_GRID = (320, 320)


def encoded(figure: Figure, suffix: str) -> bytes:
    """A figure in the format of a suffix. Equal figures give equal bytes."""
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "conflank", "pdf.fonttype": 42}):
        FigureCanvasAgg(figure)
        figure.savefig(buffer, format=suffix[1:], dpi=DPI, metadata=FORMATS[suffix])
    return buffer.getvalue()


def _figure(columns: int, width: float = PANEL, height: float = PANEL) -> tuple[Figure, list[Any]]:
    figure = Figure(figsize=(width * columns, height), facecolor="white", layout="constrained")
    return figure, list(figure.subplots(1, columns, squeeze=False)[0])


# --- before there is a program --------------------------------------------------------------------------------------


def lines_figure(scene: Scene, sweeps: Sequence[Sweep]) -> Figure:
    """Axes along every sweep of an artifact, over the faces they belong to (the paper's Fig. 5)."""
    figure, panels = _figure(len(scene.faces))
    for index, (panel, face) in enumerate(zip(panels, scene.faces, strict=True)):
        own = [sweep for sweep in sweeps if sweep.face == index]
        camera, background = _stage(scene, index)
        _show(panel, background)
        tools = list(dict.fromkeys(sweep.tool for sweep in sweeps))
        for sweep in own:
            p, q = sweep.motion.ends(np.linspace(0.0, 1.0, LINES_SHOWN))
            low, high = camera.place(p), camera.place(q)
            colour = cut_colour(tools.index(sweep.tool))
            panel.plot(*np.stack([low, high]).transpose(2, 0, 1), color=colour, linewidth=0.5, alpha=0.6)
        panel.set_title(f"face {face.number} {face.name}: axes of {len(own)} sweeps", fontsize=9)
        handles = [Patch(color=cut_colour(k), label=tool) for k, tool in enumerate(tools)]
        panel.legend(handles=handles, loc="lower right", fontsize=8, frameon=False)
    return figure


def convergence_figure(scene: Scene, sweeps: Sequence[Sweep]) -> Figure:
    """Mean and largest gap of the largest sweep, over what it covers in the end, step by step of its optimisation."""

    def size(sweep: Sweep) -> float:
        return sweep.facts.get("area_mm2", 0.0)

    sweep = max(sweeps, key=size)
    tool = next(tool for tool in scene.tools if tool.name == sweep.tool)
    task = prepare(scene, [(sweep.face, sweep.tool)])[sweep.face, sweep.tool]
    steps = convergence(task, sweep.motion)
    samples = task.face.samples(task.face.spacing(6000))
    allowance, tolerance = task.limits.allowance, scene.job.tolerance

    def gap(motion: Any, points: Array) -> Array:
        return motion_gap(motion, tool, points, allowance, np.inf)[0]

    final = gap(steps[-1][1], samples.points)
    served = samples.points[(final >= -tolerance.overcut) & (final <= tolerance.undercut)]
    values = [1e3 * np.abs(gap(motion, served)) for _, motion in steps]
    figure, (panel,) = _figure(1, 8.0, 4.5)
    panel.semilogy([each.max() for each in values], color="#e69f00", marker=".", label="largest |g|")
    panel.semilogy([each.mean() for each in values], color="#1f4e9c", marker=".", label="mean |g|")
    for name in dict.fromkeys(name for name, _ in steps[1:]):
        first = next(k for k, (each, _) in enumerate(steps) if each == name)
        panel.axvline(first - 0.5, color="#999999", linewidth=0.8)
        panel.text(first - 0.4, 0.5, name, transform=panel.get_xaxis_transform(), fontsize=8, rotation=90, va="center")
    panel.set(xlabel="step", ylabel="µm", title=f"largest sweep, {sweep.tool}: gap over what it covers in the end")
    panel.legend(fontsize=8)
    panel.grid(True, which="major", alpha=0.3)
    return figure


# --- of a program ---------------------------------------------------------------------------------------------------


def _maps(scene: Scene, posed: PosedProgram, shape: tuple[int, int]) -> list[GapMap]:
    return [gap_map(posed, face, shape, scene.job.tolerance.allowance) for face in scene.faces]


def coverage_figure(scene: Scene, posed: PosedProgram) -> Figure:
    """What every cut covers of each face over (u, v), and where none does (the paper's Fig. 10)."""
    over, under = scene.job.tolerance.overcut, scene.job.tolerance.undercut
    figure, panels = _figure(len(scene.faces))
    used: list[int] = []
    for panel, shown in zip(panels, _maps(scene, posed, FINE_GRID), strict=True):
        covers = (shown.by_cut >= -over) & (shown.by_cut <= under) & shown.inside
        near = [k for k in range(len(covers)) if covers[k].any()]
        used += [k for k in near if k not in used]
        image = np.broadcast_to(to_rgb(LEFT), (*shown.inside.shape, 3)).copy()
        lowest = np.where(covers, shown.by_cut, np.inf).argmin(axis=0) if len(covers) else np.zeros(image.shape[:2])
        covered = shown.covered(over, under)
        for k in near:
            image[(lowest == k) & covers[k] & covered] = 0.5 * np.array(to_rgb(cut_colour(k))) + 0.5
        image[~shown.inside] = 1.0
        extent = (shown.u[0], shown.u[-1], shown.v[0], shown.v[-1])
        panel.imshow(image.transpose(1, 0, 2), origin="lower", extent=extent, aspect="auto", interpolation="nearest")
        for k in near:
            panel.contour(shown.u, shown.v, covers[k].T.astype(float), [0.5], colors=[cut_colour(k)], linewidths=1.4)
        areas = _areas(shown)
        share = float(areas[covered].sum() / areas[shown.about].sum())
        panel.set(xlabel="u", ylabel="v")
        panel.set_title(f"face {shown.face.number} {shown.face.name}: {100.0 * share:.1f} % covered", fontsize=9)
    cuts = posed.program.cuts
    handles = [Patch(color=cut_colour(k), label=f"{cuts[k].kind} {cuts[k].number}") for k in sorted(used)]
    handles.append(Patch(color=LEFT, label="not covered"))
    figure.legend(handles=handles, loc="outside right upper", fontsize=8)
    return figure


def gap_figure(scene: Scene, posed: PosedProgram) -> Figure:
    """Every face with the gap in colours, and the range of the gap where covered (the paper's Fig. 11, 13 to 16)."""
    over, under = scene.job.tolerance.overcut, scene.job.tolerance.undercut
    scale, colours = Normalize(-1e3 * over, 1e3 * under), gap_colours()
    figure, panels = _figure(len(scene.faces))
    for index, (panel, shown) in enumerate(zip(panels, _maps(scene, posed, FINE_GRID), strict=True)):
        painted = grid_mesh(shown.points, shown.normals, colours(scale(1e3 * shown.gap))[..., :3], shown.inside)
        _, image = _stage(scene, index, [painted])
        _show(panel, image)
        within = 1e3 * shown.gap[shown.covered(over, under)]
        figures = "nowhere within tolerance"
        if len(within):
            spread = f"{within.min():.1f} .. {within.max():.1f} µm"
            figures = f"where covered {spread}, mean |g| {np.abs(within).mean():.2f} µm"
        panel.set_title(f"face {shown.face.number} {shown.face.name}\n{figures}", fontsize=9)
    bar = figure.colorbar(ScalarMappable(scale, colours), ax=panels, shrink=0.7, extend="both")
    bar.set_label("swept gap, µm: overcut < 0 < stock left; grey: not covered")
    return figure


def sweeps_figure(scene: Scene, posed: PosedProgram) -> Figure:
    """Coverage and mean gap after each cut of the program (the paper's Fig. 15)."""
    over, under = scene.job.tolerance.overcut, scene.job.tolerance.undercut
    maps = _maps(scene, posed, GRID)
    # Grid cells are not equal in area: each point stands for what lies around it.
    weights = [_areas(shown) for shown in maps]
    coverage, means = [], []
    for count in range(1, len(posed.program.cuts) + 1):
        gaps = [shown.by_cut[:count].min(axis=0) for shown in maps]
        good = [shown.inside & (gap >= -over) & (gap <= under) for shown, gap in zip(maps, gaps, strict=True)]
        area = sum(float(weight[chosen].sum()) for weight, chosen in zip(weights, good, strict=True))
        total = sum(float(weight[shown.about].sum()) for weight, shown in zip(weights, maps, strict=True))
        error = sum(
            float((weight * np.abs(gap))[chosen].sum()) for weight, gap, chosen in zip(weights, gaps, good, strict=True)
        )
        coverage.append(100.0 * area / total)
        means.append(1e3 * error / area if area else np.nan)
    figure, (panel,) = _figure(1, 7.0, 4.5)
    steps = np.arange(1, len(coverage) + 1)
    panel.plot(steps, coverage, color="#228833", marker="o")
    panel.set(xlabel="cuts, in the program's order", ylim=(0.0, 101.0))
    panel.set_ylabel("covered, %", color="#228833")
    panel.set_xticks(steps)
    panel.axhline(100.0 * scene.job.selection.coverage, color="#228833", linewidth=0.8, linestyle=":")
    other = panel.twinx()
    other.plot(steps, means, color="#1f4e9c", marker="s")
    other.set_ylabel("mean |g| where covered, µm", color="#1f4e9c")
    other.set_ylim(bottom=0.0)
    panel.set_title("what each further cut adds; dotted: what the job asks for", fontsize=9)
    return figure


def _areas(shown: FaceGrid) -> Array:
    """Area that each point of a grid stands for, (U, V), up to a factor."""
    by_u, by_v = (np.gradient(shown.points, axis=k) for k in (0, 1))
    return np.asarray(np.linalg.norm(np.cross(by_u, by_v), axis=2))


def axes_figure(scene: Scene, posed: PosedProgram) -> Figure:
    """Rotary axes, programmed point and feed over time, the cuts behind them."""
    moves = posed.poses.moves
    time = np.cumsum(drive(posed, scene).seconds)
    figure = Figure(figsize=(9.0, 6.5), facecolor="white", layout="constrained")
    rotary, linear, feed = figure.subplots(3, 1, sharex=True)
    if np.isfinite(moves.rotary).any():
        _curves(rotary, time, np.degrees(moves.rotary), list(posed.program.rotary_letters), moves.joined)
        rotary.set_ylabel("rotary axes, °")
    else:
        _curves(rotary, time, posed.poses.axis, ["i", "j", "k"], moves.joined)
        rotary.set_ylabel("tool axis")
    _curves(linear, time, moves.point, ["X", "Y", "Z"], moves.joined)
    linear.set_ylabel("programmed point, mm")
    known = np.isfinite(moves.feed)
    feed.step(time, np.where(known, moves.feed, np.nan), color="#333333", linewidth=1.0, where="pre")
    feed.set(ylabel="feed, mm/min", xlabel="s on the job's machine")
    for index, cut in enumerate(posed.program.cuts):
        own = np.flatnonzero(moves.cut == index)
        if len(own) == 0:
            continue
        start, end = time[max(own[0] - 1, 0)], time[own[-1]]
        for panel in (rotary, linear, feed):
            panel.axvspan(start, end, color=cut_colour(index), alpha=0.18, linewidth=0.0)
        rotary.text(0.5 * (start + end), 1.01, f"{cut.kind} {cut.number}", fontsize=7, ha="center",
                    transform=rotary.get_xaxis_transform())  # fmt: skip
    return figure


def _curves(panel: Axes, time: Array, values: Array, names: Sequence[str], joined: npt.NDArray[np.bool_]) -> None:
    """Columns of values over time, broken where the way between two poses is not known."""
    gaps = np.flatnonzero(~joined[1:]) + 1
    for k, name in enumerate(names):
        panel.plot(np.insert(time, gaps, np.nan), np.insert(values[:, k], gaps, np.nan), linewidth=1.0, label=name)
    panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, frameon=False)
    panel.grid(True, alpha=0.3)


# --- shaded pictures ------------------------------------------------------------------------------------------------


def _stage(scene: Scene, index: int, painted: Sequence[Mesh] = ()) -> tuple[Camera, Array]:
    """A camera on a face from the cutter's side, and what it sees: the face, or what is painted, on the rest of it.

    What stands between the viewer and the face is cut away.
    """
    shown = face_grid(scene.faces[index], GRID)
    if not painted:
        painted = [grid_mesh(shown.points, shown.normals, _plain(shown.points), shown.inside)]
    camera = _camera(shown, LIFT)
    bodies = []
    if len(scene.check.triangles):
        body = facet_mesh(scene.check.vertices, scene.check.triangles, np.array(to_rgb(BODY)))
        in_front = _in_front(camera, body.vertices, shown.points[shown.about])
        bodies.append(Mesh(body.vertices, body.normals, body.colours, body.triangles, in_front))
    others = [face_grid(face, GRID) for k, face in enumerate(scene.faces) if k != index]
    bodies += [grid_mesh(each.points, each.normals, _plain(each.points), each.inside) for each in others]
    return camera, render(camera, [*bodies, *painted], WHITE).pixels()


def _in_front(camera: Camera, points: Array, face: Array) -> Array:
    """How far points (N, 3) stand before the plane that fits a face best and is moved before all of it, (N,) mm."""

    def columns(places: Array) -> Array:
        return np.column_stack([np.ones(len(places)), places @ camera.rotation[:2].T])

    depth = face @ camera.towards
    plane = np.linalg.lstsq(columns(face), depth)[0]
    before = float((depth - columns(face) @ plane).max()) + BEFORE
    return np.asarray(points @ camera.towards - columns(points) @ plane - before)


def _plain(points: Array) -> Array:
    return np.broadcast_to(np.array(to_rgb(BODY)), points.shape)


def _camera(shown: FaceGrid, lift: float) -> Camera:
    """Looks at a face against its mean normal, `lift` of the way along the longer of its edges; all of it fits."""
    normal = shown.normals[shown.about].mean(axis=0)
    normal /= np.linalg.norm(normal)
    # Upwards is where the face runs along its second parameter: for a blade that is from hub to tip or across it.
    up = shown.points[:, -1].mean(axis=0) - shown.points[:, 0].mean(axis=0)
    up -= (up @ normal) * normal
    up /= np.linalg.norm(up)
    towards = normal + lift * up
    towards /= np.linalg.norm(towards)
    free = Camera(towards, up, np.zeros(2), np.ones(2), 1.0)
    flat = shown.points[shown.about] @ free.rotation[:2].T
    rim = AROUND * np.ptp(flat, axis=0).max()
    low, high = flat.min(axis=0) - rim, flat.max(axis=0) + rim
    return Camera(towards, up, low, high, PIXELS_ACROSS / float((high - low).max()))


def _show(panel: Any, image: Array) -> None:
    panel.imshow(np.clip(image, 0.0, 1.0), interpolation="antialiased")
    panel.set_axis_off()
