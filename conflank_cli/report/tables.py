"""What a report says in words: figures, tables, controls; the page's script only makes them work."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape

from conflank_cli import __version__
from conflank_cli.coverage import REASON_WORDS, Reason
from conflank_cli.report.colours import COVERED, GAP, GREYS, LEFT, OVERCUT, REACH
from conflank_cli.report.findings import Spot
from conflank_cli.scene import Scene
from conflank_cli.verification.posed import PosedProgram
from conflank_cli.verification.result import CutFigures, FaceFigures, Verification

NEVER = "-"
"""What is not known."""


@dataclass(frozen=True, slots=True)
class Cut:
    """A sweep or pass of the program.

    Attributes
    ----------
    kind, number: as the program labels it.
    colour: of its surfaces.
    first: index of its first pose.
    face: CAD face number, None where it has no pose.
    feed: least and largest programmed feed, mm/min; None where none is known.
    figures: what it cuts.
    """

    kind: str
    number: int
    colour: str
    first: int
    face: int | None
    feed: tuple[float, float] | None
    figures: CutFigures

    @property
    def label(self) -> str:
        """Such as "sweep 3"."""
        return f"{self.kind} {self.number}"


@dataclass(frozen=True, slots=True)
class Body:
    """The head's title and the body's content."""

    title: str
    content: str


def page_body(
    scene: Scene,
    posed: PosedProgram,
    verification: Verification,
    cuts: Sequence[Cut],
    places: Sequence[Spot],
    modes: Mapping[str, str],
    left: Mapping[Reason, float],
    obstacles: bool,
) -> Body:
    """Everything between the page's style and its script.

    modes: meanings that colours can have, by key. left: area that the plan leaves for each reason, mm2.
    """
    name = escape(scene.part_name)
    program = escape(verification.program)
    parts = (
        f'<header>\n<div class="headline"><h1>{name} <span>{program}</span></h1>',
        '<button type="button" id="theme">Light or dark</button></div>\n',
        _figures(verification, scene),
        '</header>\n<main>\n<div class="work">\n<div>\n',
        _stage(scene, modes, left),
        _PLAYBACK,
        "</div>\n<aside>\n",
        _shown(modes, obstacles),
        _places(places),
        "</aside>\n</div>\n",
        _cuts(cuts, "sweep"),
        _cuts(cuts, "pass"),
        f"<h2>Faces</h2>\n{_faces(verification, scene)}",
        '<h2>Over time</h2>\n<div id="charts"></div>\n',
        f"<h2>Job</h2>\n{_facts(scene, posed, verification)}</main>\n",
        f"<footer>Written by conflank {__version__} from the text of {program} (SHA-256 ",
        f"{verification.program_sha256}). Drag to turn, wheel to come nearer; with the view in focus arrow keys turn ",
        "and + and - zoom. Drawn with three.js, © three.js authors, MIT License.</footer>\n",
    )
    return Body(f"<title>{name}, {program}</title>\n", "".join(parts))


def _figures(verification: Verification, scene: Scene) -> str:
    wanted = scene.job.selection.coverage
    mean = verification.gap_um.mean_abs
    stock = verification.stock_max_um
    findings = len(verification.findings)
    deepest = 1e3 * scene.job.tolerance.overcut
    items = (
        ("coverage", f"{100.0 * verification.coverage:.2f} %", verification.coverage >= wanted),
        *([("by sweeps alone", f"{100.0 * verification.coverage_flank:.2f} %", None)] * bool(verification.passes)),
        ("mean gap where covered", NEVER if mean is None else f"{mean:.2f} µm", None),
        ("deepest overcut", f"{verification.overcut_max_um:.1f} µm", verification.overcut_max_um <= deepest + 1e-4),
        ("most stock left", NEVER if stock is None else f"{stock:.0f} µm", None),
        ("sweeps", str(len(verification.sweeps)), None),
        *([("ball passes", str(len(verification.passes)), None)] if verification.passes else []),
        ("time", f"{verification.time_s / 60.0:.2f} min", None),
        ("findings", str(findings) if findings else "none", findings == 0),
    )
    classes = {True: ' class="good"', False: ' class="bad"', None: ""}
    rows = (f"<li><b{classes[good]}>{value}</b><span>{title}</span></li>" for title, value, good in items)
    return f'<ul class="figures">{"".join(rows)}</ul>\n'


def _gradient(stops: Iterable[tuple[float, str]]) -> str:
    return "linear-gradient(to right, " + ", ".join(f"{colour} {100.0 * place:g}%" for place, colour in stops) + ")"


def _swatch(colour: str) -> str:
    return f'<i class="swatch" style="background:{colour}"></i>'


def _stage(scene: Scene, modes: Mapping[str, str], left: Mapping[Reason, float]) -> str:
    overcut, undercut = scene.job.tolerance.overcut, scene.job.tolerance.undercut
    looks = "".join(
        f'<button type="button" data-look="{index}">face {face.number} {escape(face.name)}</button>'
        for index, face in enumerate(scene.faces)
    )
    looks += '<button type="button" data-look="-1">everything</button>'
    even = [(k / (len(REACH) - 1), colour) for k, colour in enumerate(REACH)]
    legends = [
        '<div class="legend" data-legend="gap">swept gap, µm: overcut &lt; 0 &lt; stock left'
        f'<span class="bar" style="background:{_gradient(GAP)}"></span>'
        f'<span class="ends"><span>−{1e3 * overcut:g}</span><span>0</span><span>+{1e3 * undercut:g}</span></span>'
        f"{_swatch(OVERCUT)}deeper{_swatch(LEFT)}more stock left: not covered</div>",
        '<div class="legend" data-legend="cut" hidden>the cut that goes deepest where the gap is within tolerance'
        f"<br>{_swatch(LEFT)}not covered</div>",
    ]
    if "reason" in modes:
        colours = {Reason.COVERED: COVERED} | GREYS
        rows = [f"{_swatch(colours[why])}{REASON_WORDS[why]}: {area:.0f} mm²" for why, area in left.items() if area]
        legends.append(f'<div class="legend" data-legend="reason" hidden>{"<br>".join(rows)}</div>')
    if len(modes) > len(legends):
        legends.append(
            '<div class="legend" data-legend="reach" hidden>least axis error of any line that touches there, µm'
            f'<span class="bar" style="background:{_gradient(even)}"></span>'
            f'<span class="ends"><span>0</span><span class="to"></span></span>{_swatch(LEFT)}more</div>'
        )
    return (
        '<div class="stage"><canvas id="view" tabindex="0" role="img" '
        'aria-label="The part with the swept gap, the cuts and the cutter; arrow keys turn it, + and - zoom"></canvas>'
        '<canvas id="still" role="img" aria-label="Each face as the program leaves it" hidden></canvas>'
        '<p id="no-view" hidden>This browser has no WebGL, so nothing can be turned or moved here: a still picture of '
        "each face, seen from the cutter. Slider, tables and charts work.</p>"
        '<p id="failure" hidden></p>'
        "<noscript><p>Pictures and charts of this page need JavaScript. The tables below do not.</p></noscript>"
        f'<div class="looks">{looks}</div>{"".join(legends)}<output id="under"></output></div>\n'
    )


_PLAYBACK = """<div class="playback">
<button type="button" id="play" aria-pressed="false">Play</button>
<select id="rate" aria-label="Speed of the motion"><option value="0.1">0.1 ×</option><option value="0.5">0.5 ×</option>
<option value="1" selected>real time</option><option value="4">4 ×</option><option value="16">16 ×</option></select>
<input type="range" id="pose" min="0" max="0" step="1" value="0" aria-label="Pose of the program">
<output id="now"></output></div>
<code id="block"></code>
"""


def _box(layer: str, label: str, on: bool = True) -> str:
    checked = " checked" if on else ""
    return f'<label><input type="checkbox" data-layer="{layer}"{checked}> {label}</label>\n'


def _shown(modes: Mapping[str, str], obstacles: bool) -> str:
    choices = "".join(f'<option value="{escape(key)}">{escape(text)}</option>' for key, text in modes.items())
    return (
        "<fieldset><legend>Show</legend>\n"
        f'<label class="choice">colours <select id="mode">{choices}</select></label>\n'
        '<label class="choice">rest of the part <select id="rest"><option value="through">see-through</option>'
        '<option value="solid">solid</option><option value="hidden">hidden</option></select></label>\n'
        + _box("uncovered", "mark what is not covered", False)
        + _box("cutter", "cutter")
        + _box("holder", "shank and holder")
        + _box("path", "way of the tip")
        + _box("rapids", "rapids", False)
        + (_box("obstacles", "obstacles") if obstacles else "")
        + _box("places", "places", False)
        + "</fieldset>\n"
    )


def _places(places: Sequence[Spot]) -> str:
    items = (
        f'<li><button type="button" data-place="{k}">'
        f"<b{' class=bad' if spot.finding else ''}>{escape(spot.title)}</b>"
        f"<small>{escape(spot.text)}{'' if spot.block is None or spot.finding else f', block {spot.block}'}</small>"
        "</button></li>"
        for k, spot in enumerate(places)
    )
    none = "" if any(spot.finding for spot in places) else '<p class="good">No findings.</p>'
    return f'<fieldset><legend>Findings and places</legend>{none}<ul class="places">{"".join(items)}</ul></fieldset>\n'


def _table(
    columns: Sequence[tuple[str, str]],
    rows: Sequence[Sequence[tuple[str, str]]],
    index: str = "",
    numbers: Sequence[int] = (),
) -> str:
    """Headings and cells are (class, HTML); `index` names an attribute with the rows' `numbers`."""

    def cell(name: str, kind: str, content: str, rest: str = "") -> str:
        own = f' class="{kind}"' if kind else ""
        return f"<{name}{rest}{own}>{content}</{name}>"

    head = "".join(cell("th", kind, content, ' scope="col"') for kind, content in columns)
    marks = [f' data-{index}="{number}"' for number in numbers] or [""] * len(rows)
    body = "".join(
        f"<tr{mark}>" + "".join(cell("td", *each) for each in row) + "</tr>\n"
        for mark, row in zip(marks, rows, strict=True)
    )
    return f'<div class="scroll"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody></table></div>\n'


def _number(value: float | None, digits: int = 2) -> tuple[str, str]:
    return "", NEVER if value is None else f"{value:.{digits}f}"


def _cuts(cuts: Sequence[Cut], kind: str) -> str:
    """The sweeps, or the passes, under a heading; nothing where there is none. Rows are numbered over all cuts."""
    own = [(index, cut) for index, cut in enumerate(cuts) if cut.kind == kind]
    # A pass has a way and no ruled surface.
    layers = {"ruled": ("ruled surface", ""), "patch": ("patch", " checked")}
    if kind == "pass":
        layers.pop("ruled")

    def row(index: int, cut: Cut) -> Sequence[tuple[str, str]]:
        figures = cut.figures
        feed = NEVER if cut.feed is None else " – ".join(dict.fromkeys(f"{value:.0f}" for value in cut.feed))
        switches = (
            f'<input type="checkbox" data-layer="{layer}:{index}" aria-label="{what} of {cut.label}"{on}>'
            for layer, (what, on) in layers.items()
        )
        return (
            ("text", f'{_swatch(cut.colour)}<button type="button" data-seek="{cut.first}">{cut.label}</button>'),
            *(("", switch) for switch in switches),
            ("text", escape(figures.tool)),
            ("", NEVER if cut.face is None else str(cut.face)),
            _number(figures.length_mm),
            _number(figures.covered_mm2),
            _number(figures.gap_min_um),
            _number(figures.gap_mean_abs_um),
            _number(figures.gap_max_um),
            ("", feed),
            _number(figures.time_s),
        )

    if not own:
        return ""
    numbers = ("face", "length mm", "covered mm²", "gap min µm", "mean µm", "max µm", "feed mm/min", "time s")
    every = (
        f'<label><input type="checkbox" data-all="{layer}"{on}> {what}</label>' for layer, (what, on) in layers.items()
    )
    columns = [("text", kind), *(("", switch) for switch in every), ("text", "tool"), *(("", name) for name in numbers)]
    title = {"sweep": "Sweeps", "pass": "Ball passes"}[kind]
    table = _table(columns, [row(index, cut) for index, cut in own], "cut", [index for index, _ in own])
    return f'<section data-kind="{kind}">\n<h2>{title}</h2>\n{table}</section>\n'


def _faces(verification: Verification, scene: Scene) -> str:
    names = {face.number: face.name for face in scene.faces}
    copies = len({face.copy for face in verification.faces}) > 1

    def row(face: FaceFigures) -> Sequence[tuple[str, str]]:
        return (
            ("", str(face.face)),
            ("text", escape(names.get(face.face, ""))),
            *([("", str(face.copy))] if copies else []),
            _number(face.area_mm2),
            _number(100.0 * face.coverage),
            _number(face.overcut_max_um),
            _number(face.stock_max_um),
        )

    numbers = (["copy"] if copies else []) + ["area mm²", "covered %", "deepest overcut µm", "most stock µm"]
    columns = [("", "face"), ("text", "name"), *(("", name) for name in numbers)]
    return _table(columns, [row(face) for face in verification.faces])


def _facts(scene: Scene, posed: PosedProgram, verification: Verification) -> str:
    tolerance = scene.job.tolerance
    header = posed.program.header
    control = verification.control_tolerance_um
    tools = dict.fromkeys(
        f"{tool.name} (r_min {tool.r_min:g}, r_max {tool.r_max:g}, length {tool.length:g} mm)"
        for tool in posed.tools
        if tool is not None
    )
    facts = (
        ("tools", "; ".join(tools) or NEVER),
        (
            "tolerance",
            f"overcut {1e3 * tolerance.overcut:g} µm, stock {1e3 * tolerance.undercut:g} µm"
            + (f", allowance {tolerance.allowance:g} mm" if tolerance.allowance else ""),
        ),
        ("machine, style", f"{header.machine or NEVER}, {header.style or NEVER}"),
        ("the control may add", NEVER if control is None else f"{control:.1f} µm (T + h TA of its tolerance cycle)"),
        ("read from", ", ".join(f"{name} (SHA-256 {digest})" for name, digest in sorted(scene.inputs.items()))),
    )
    rows = "".join(f"<dt>{name}</dt><dd>{escape(value)}</dd>" for name, value in facts)
    return f'<dl class="facts">{rows}</dl>\n'
