"""Rapids to and from the part, from wherever a retracted tool can stand, followed by kinematics written down here.

The words are read from the text; SciPy's rotations about axes and pivots that are written down independently of the
machine files give the tip on the part; distances are of the tool's sections (as cylinders around them) from points on
everything there is.
"""

import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from conflank_cli.ball_pass import Pass
from conflank_cli.cad.scene import load_scene
from conflank_cli.cli import cli
from conflank_cli.geometry.face import CheckMesh
from conflank_cli.geometry.footpoint import Projector
from conflank_cli.job import load_job
from conflank_cli.posting import post_program, post_programs
from conflank_cli.posting.overhead import Overhead, depth_below_tip
from conflank_cli.scene import Scene
from conflank_cli.tool import CATALOGUE, Tool
from conflank_cli.verification.judge import verify_program
from conflank_cli.verification.reader import read_program
from postprocessors.errors import PostError
from tests.posting.test_program import scene_of

Array = np.ndarray
T1 = CATALOGUE["T1"]
COUNT = 30
"""Places along each rapid."""
KEPT = 4.9
"""The clearance of the job, less what rounding words to four decimals costs."""

# Letter, direction, pivot, and whether the axis is in the head, in the order of t = R(first) R(second) z; the upper
# limit of Z, and how far X and Y go either way.
AXES = {
    "ac-table": ((("C", (0, 0, 1), (0, 0, 0), False), ("A", (1, 0, 0), (0, 0, 0), False)), 500.0, (400.0, 300.0)),
    "bc-table": ((("C", (0, 0, 1), (0, 0, 60), False), ("B", (0, 1, 0), (0, 0, 0), False)), 500.0, (400.0, 300.0)),
    "head-table": ((("C", (0, 0, 1), (0, 0, 0), False), ("B", (0, 1, 0), (0, 0, 150), True)), 900.0, (600.0, 500.0)),
    "head-head": ((("C", (0, 0, 1), (0, 0, 0), True), ("A", (1, 0, 0), (0, 0, 220), True)), 1200.0, (1500.0, 1000.0)),
    "nutating-head": (
        (("C", (0, 0, 1), (0, 0, 0), False), ("B", (0, 1, 1), (0, 60, 200), True)),
        800.0,
        (500.0, 400.0),
    ),
}
MOUNTED = {
    "ac-table": [((0.0, 0.0, 60.0), 150.0), ((-40.0, 30.0, 20.0), 190.0)],
    "bc-table": [((0.0, 0.0, 60.0), 150.0), ((-40.0, 30.0, 20.0), 190.0)],
    "head-table": [((0.0, 0.0, 400.0), 172.0), ((-60.0, 40.0, 250.0), 210.0), ((100.0, -80.0, 560.0), 150.0)],
    "head-head": [((0.0, 0.0, 300.0), 172.0), ((500.0, -100.0, 700.0), 150.0)],
    "nutating-head": [((0.0, 0.0, 300.0), 172.0), ((-30.0, 40.0, 200.0), 150.0)],
}


def turned(name: str, words: Array, head: bool) -> Rotation:
    """Rotation of all head axes (or all table axes, seen from the part) at words by letter."""
    found = Rotation.identity()
    for letter, direction, _, in_head in AXES[name][0]:
        if in_head == head:
            vector = np.array(direction) / np.linalg.norm(direction)
            found = found * Rotation.from_rotvec(np.radians(words[letter]) * vector)
    return found


def tip_on_part(name: str, nose: Array, words: dict[str, float], zero: Array, length: float) -> Array:
    """The tip in program coordinates where the carriage stands at `nose` (N, 3)."""
    tip = np.array([0.0, 0.0, -length])
    for letter, direction, pivot, in_head in reversed(AXES[name][0]):
        if in_head:
            vector = np.array(direction) / np.linalg.norm(direction)
            tip = pivot + Rotation.from_rotvec(np.radians(words[letter]) * vector).apply(tip - pivot)
    place = nose + tip
    # Under the machine's own table axis first, the part's own last; a table turns the part against its word.
    for letter, direction, pivot, in_head in reversed(AXES[name][0]):
        if not in_head:
            vector = np.array(direction) / np.linalg.norm(direction)
            place = pivot + Rotation.from_rotvec(np.radians(words[letter]) * vector).apply(place - pivot)
    return place - zero


def axis_on_part(name: str, words: dict[str, float]) -> Array:
    """The tool axis, table axes before head axes."""
    return (turned(name, words, head=False) * turned(name, words, head=True)).apply([0.0, 0.0, 1.0])


def clearance(tool: Tool, tip: Array, axis: Array, points: Array) -> float:
    """Least distance of points (M, 3) from the tool at poses (N, 3), each section taken as the cylinder around it."""
    height, sections = -tool.tip_height, [(0.0, -tool.tip_height, tool.ball_radius)]
    sections.append((height, height + tool.length, tool.r_max))
    height += tool.length
    for section in (*tool.shank, *tool.holder):
        radius = 0.5 * max(section.diameter_low, section.diameter_high)
        sections.append((height, height + section.length, radius))
        height += section.length
    # |x - tip|^2 = level^2 + off^2.
    level = axis @ points.T - np.einsum("ij,ij->i", axis, tip)[:, None]
    apart = (points**2).sum(axis=1) - 2.0 * tip @ points.T + (tip**2).sum(axis=1)[:, None]
    off = np.sqrt(np.maximum(apart - level**2, 0.0))
    least = np.inf
    for low, high, radius in sections:
        beyond = np.maximum(np.maximum(low - level, level - high), 0.0)
        least = min(least, float((beyond**2 + np.maximum(off - radius, 0.0) ** 2).min()))
    return float(np.sqrt(least))


def retracted_starts(name: str, zero: Array, length: float, words: dict[str, float]) -> Iterator[Array]:
    """Tips on the part with Z at its limit, over corners, edges and middle of X and Y."""
    _, z, (x, y) = AXES[name]
    for across, along in product((-1.0, -0.2, 0.2, 1.0), repeat=2):
        yield tip_on_part(name, np.array([across * x, along * y, z]), words, zero, length)


Pose = tuple[Array, dict[str, float]]


def rapids(text: str) -> Iterator[tuple[dict[str, float], list[Pose], list[Pose]]]:
    """Of each stay at the part: rotary words before it, the poses of the rapids it begins with, and that it ends with.

    The first of the way out is the pose on the safe plane, after that beside the face.
    """
    for stay in text.split("FUNCTION TCPM")[1:]:
        poses, fast = [], []
        for block in stay.partition("FUNCTION RESET TCPM")[0].splitlines():
            if found := re.search(r" L X(\S+) Y(\S+) Z(\S+) ([ABC])(\S+) ([ABC])(\S+)", block):
                tip = np.array([float(found[k]) for k in (1, 2, 3)])
                poses.append((tip, {found[4]: float(found[5]), found[6]: float(found[7])}))
                fast.append("FMAX" in block)
        turn = re.findall(r" L ([ABC])(\S+) ([ABC])(\S+) R0 FMAX", text.partition(stay)[0])[-1]
        yield (
            {turn[0]: float(turn[1]), turn[2]: float(turn[3])},
            poses[: fast.index(False)],
            poses[len(fast) - fast[::-1].index(False) :],
        )


def first_rapids(name: str, text: str, zero: Array, length: float, points: Array) -> float:
    """Least clearance from any start to the pose on the safe plane, and from there to upright."""
    least, share = np.inf, np.linspace(0.0, 1.0, COUNT)[:, None]
    with_head = any(in_head for *_, in_head in AXES[name][0])
    for words, inward, outward in rapids(text):
        tip, first = inward[0]
        assert first == words
        axis = np.repeat(axis_on_part(name, words)[None], COUNT, axis=0)
        starts = list(retracted_starts(name, zero, length, words))
        for start in starts:
            assert (start - tip) @ turned(name, words, head=False).apply([0.0, 0.0, 1.0]) >= 0.0
            least = min(least, clearance(T1, start + share * (tip - start), axis, points))
        # The last of these rapids leads down beside the face; with a head one more may come before it.
        assert len(inward) == 2 or (with_head and len(inward) == 3)
        if len(inward) == 3:
            least = min(least, clearance(T1, tip + share * (inward[1][0] - tip), axis, points))
        if not with_head:
            assert len(outward) == 1
            continue
        # Out: from the pose on the safe plane to above, then the head turns.
        for (low, before), (high, after) in pairwise(outward):
            between = [{key: before[key] + part * (after[key] - before[key]) for key in before} for part in share[:, 0]]
            axis = np.array([axis_on_part(name, words) for words in between])
            least = min(least, clearance(T1, low + share * (high - low), axis, points))
        assert axis[-1] @ turned(name, after, head=False).apply([0.0, 0.0, 1.0]) > 1.0 - 1e-12
    return least


BLOCK = np.array([[x, y, z] for x in (2.0, 60.0) for y in (-30.0, 90.0) for z in (-20.0, 40.0)])
SIDES = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
         [1, 5, 7], [1, 7, 3]]  # fmt: skip
POINTS = np.vstack(
    [
        np.stack(np.meshgrid(np.linspace(2.0, 60.0, 12), np.linspace(-30.0, 90.0, 24), [-20.0, 40.0]), -1).reshape(
            -1, 3
        ),
        np.stack(np.meshgrid([2.0, 60.0], np.linspace(-30.0, 90.0, 24), np.linspace(-20.0, 40.0, 12)), -1).reshape(
            -1, 3
        ),
        np.stack(np.meshgrid([0.0], np.linspace(0.0, 60.0, 20), np.linspace(0.0, 30.0, 10)), -1).reshape(-1, 3),
    ]
)


def lying_pass(tilt_deg: float, aside_deg: float) -> Pass:
    """Along the wall x = 0 with an axis that lies west, tilted off Z by so much and turned off west by so much."""
    tilt, aside = np.radians([tilt_deg, aside_deg])
    axis = np.array([-np.sin(tilt) * np.cos(aside), np.sin(tilt) * np.sin(aside), np.cos(tilt)])
    way = np.linspace(0.0, 1.0, 12)
    centre = np.stack([np.full(12, -T1.ball_radius), 10.0 + 40.0 * way, np.full(12, 12.0)], axis=1)
    return Pass(0, "T1", centre - T1.ball_radius * axis, np.tile(axis, (12, 1)))


def mounted(name: str, zero: tuple[float, float, float], length: float, extra: str = "") -> Scene:
    """The wall before a block, and the job for that machine."""
    where = f'[machine]\nname = "{name}"\nzero = {list(zero)}\ngauge_length = {{T1 = {length}}}\n'
    scene = scene_of(where + '[program]\nsafe = {links = "retract"}\n' + extra)
    triangles = np.array(SIDES, dtype=np.int32)
    return scene.checking(CheckMesh(BLOCK, triangles, np.zeros(len(triangles), dtype=np.int32)))


TILTS = {"nutating-head": (80.0, 60.0)}
"""The others lie down further than 90 degrees, so that the spindle is lower than the tip."""
CASES = [(name, zero, length) for name, many in MOUNTED.items() for zero, length in many]


def text_of(name: str, zero: tuple[float, float, float], length: float) -> str:
    scene = mounted(name, zero, length)
    first, second = TILTS.get(name, (102.0, 75.0))
    return post_program(scene, [], [lying_pass(first, 20.0), lying_pass(second, -30.0)])[0]


@pytest.mark.parametrize(("name", "zero", "length"), CASES)
def test_no_rapid_comes_near_the_part_from_any_start(
    name: str, zero: tuple[float, float, float], length: float
) -> None:
    text = text_of(name, zero, length)
    assert first_rapids(name, text, np.array(zero), length, POINTS) > KEPT


def test_without_the_way_over_the_part_the_tool_runs_into_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutant takes the safe plane to be above the part, as it is where only tables turn."""
    monkeypatch.setattr(Overhead, "above", lambda *_: None)
    name, zero, length = CASES[4]
    assert name == "head-table"
    assert first_rapids(name, text_of(name, zero, length), np.array(zero), length, POINTS) < 0.5 * KEPT


def outline(tool: Tool) -> tuple[Array, Array]:
    """Radii and heights above the tip, (N,) each, of points on the tool's outline that its hull needs."""
    angle = np.linspace(0.0, np.pi / 2, 60)
    height = tool.length - tool.tip_height
    points = [*zip(tool.ball_radius * np.sin(angle), tool.ball_radius * (1.0 - np.cos(angle)), strict=True)]
    points += [(tool.r_min, -tool.tip_height), (tool.r_max, height)]
    for section in (*tool.shank, *tool.holder):
        points += [(0.5 * section.diameter_low, height), (0.5 * section.diameter_high, height + section.length)]
        height += section.length
    radius, level = np.array(points).T
    return radius, level


def body(tool: Tool, tip: Array, axis: Array) -> Array:
    """Points on the tool's surface at a pose, (N, 3)."""
    radius, level = outline(tool)
    across = np.linalg.svd(axis[None])[2][1:]
    turn = np.linspace(0.0, 2.0 * np.pi, 91)
    ring = np.cos(turn)[:, None] * across[0] + np.sin(turn)[:, None] * across[1]
    return np.asarray((tip + level[:, None, None] * axis + radius[:, None, None] * ring).reshape(-1, 3))


def kept_on_the_way(over: Overhead, seed: int, lift: str) -> float:
    """Least clearance, by planes, of a tool that comes over the part to the safe plane and, at the end, turns upright.

    lift: what gives the pose above the part: "right", or a mutant of it.
    """
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis[2] = rng.uniform(-0.5, 1.0) * np.linalg.norm(axis[:2])
    axis /= np.linalg.norm(axis)
    radius = np.linalg.norm(over.corners, axis=1).max()
    start = (radius + over.clearance) * axis + 30.0 * np.cross(axis, rng.normal(size=3))
    up = np.array([0.0, 0.0, 1.0])
    tilt = np.arccos(axis @ up)
    found = over.above(start, axis, up, tilt, T1, "pass 1")
    above = start if found is None else found
    if lift == "without depth":
        above = above - depth_below_tip(T1, tilt) * (above - start) / max((above - start) @ up, 1e-9)
    elif lift == "straight":
        above = start + ((above - start) @ up) * up
    highest = (over.corners @ up).max()
    least = np.inf
    # Along the tool axis it stays beyond the plane across it that touches the sphere, until all of it is above.
    for share in np.linspace(0.0, 1.0, 12):
        points = body(T1, start + share * (above - start), axis)
        beyond = (points @ axis).min() - radius
        least = min(least, max(beyond, (points @ up).min() - highest))
    # The head turns on a great circle.
    for share in np.linspace(0.0, 1.0, 12):
        turned_axis = Rotation.from_rotvec(share * tilt * np.cross(axis, up) / np.sin(tilt)).apply(axis)
        least = min(least, (body(T1, above, turned_axis) @ up).min() - highest)
    return float(least)


def test_the_whole_tool_stays_off_everything_by_the_clearance() -> None:
    """Parts that fill a ball, axes up to 26 degrees below the horizon, starts anywhere on the safe plane."""
    least = {"right": np.inf, "without depth": np.inf, "straight": np.inf}
    for seed in range(16):
        corners = np.random.default_rng(100 + seed).normal(size=(60, 3)) * [40.0, 40.0, 25.0]
        for lift in least:
            least[lift] = min(least[lift], kept_on_the_way(Overhead(corners, 5.0), seed, lift))
    # Rings of 4 degrees miss the lowest point of the largest rim by 0.012 mm.
    assert least["right"] > 5.0 - 1e-9
    assert least["without depth"] < -10.0 and least["straight"] < -5.0


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, 89.0, 102.0, 150.0, 179.0])
def test_the_depth_below_the_tip_is_that_of_the_tools_outline(tilt_deg: float) -> None:
    """Against the outline itself: the ball's arc and the rims, turned in steps of a hundredth of a degree."""
    radius, level = outline(T1)
    tilts = np.radians(np.linspace(0.0, tilt_deg, 2 + int(100 * tilt_deg)))
    depth = (radius * np.sin(tilts)[:, None] - level * np.cos(tilts)[:, None]).max()
    assert depth_below_tip(T1, np.radians(tilt_deg)) == pytest.approx(depth, abs=1e-3)


def test_a_tool_that_points_straight_up_is_refused() -> None:
    over = Overhead(np.zeros((1, 3)), 5.0)
    axis = np.array([0.0, np.sin(0.05), -np.cos(0.05)])
    with pytest.raises(PostError, match="no way leads over the part"):
        over.above(np.array([0.0, 0.0, -60.0]), axis, np.array([0.0, 0.0, 1.0]), 0.0, T1, "pass 1")


@pytest.mark.parametrize(
    ("name", "style", "split"),
    [("ac-table", "tcpm", "sweep"), ("head-table", "tcpm", "tool"), ("head-table", "m128", "sweep"),
     ("head-table", "ln", "sweep")],
)  # fmt: skip
def test_a_part_of_a_split_program_runs_alone(name: str, style: str, split: str) -> None:
    """Each sets all it needs, in an order that can be run from anywhere, and leaves the control as it was."""
    zero, length = MOUNTED[name][0]
    extra = f'style = "{style}"\nsplit = "{split}"\n'
    cuts = [lying_pass(75.0, 20.0), lying_pass(75.0, -30.0)]
    programs, _, _ = post_programs(mounted(name, zero, length, extra), [], cuts)
    assert len(programs) == (3 if split == "sweep" else 2)
    on, off = ("M128", "M129") if style == "m128" else ("FUNCTION TCPM", "FUNCTION RESET TCPM")
    for program in programs[1:]:
        blocks = [line.partition(" ")[2] for line in program.text.splitlines()]
        way = "M126" if name == "ac-table" else "M127"
        order = ["TOOL CALL 1 Z S3000", off, "PLANE RESET STAY", "CYCL DEF 247", r"CYCL DEF 32\.1 T", "L M140 MB MAX",
                 way, "L [AB].*R0 FMAX M3", on, "LN? X.*R0 FMAX", "M8", r"LN? X.* F\d"]  # fmt: skip
        places = [next(k for k, block in enumerate(blocks) if re.match(pattern, block)) for pattern in order]
        assert places == sorted(places), places
        # At the end the control is as it was.
        assert blocks[-8:] == [off, "L M140 MB MAX", "M9", "M5", "CYCL DEF 32.0 TOLERANCE", "CYCL DEF 32.1", "M127",
                               f"END PGM {program.name} MM"]  # fmt: skip
        assert "M30" not in blocks
        read = read_program(program.text)
        assert not read.findings and len(read.cuts) == (1 if split == "sweep" else 2)


@pytest.mark.parametrize("known", [True, False])
def test_verification_proves_every_way_of_a_program_with_a_head(known: bool) -> None:
    """By other rules and other kinematics, with the part's place on the machine and without."""
    name, zero, length = CASES[4]
    scene = mounted(name, zero, length)
    if not known:
        machine = msgspec.structs.replace(scene.job.machine, zero=None, gauge_length={})
        scene = replace(scene, job=msgspec.structs.replace(scene.job, machine=machine))
    verification = verify_program(text_of(name, zero, length), scene, "BLADE1.H")
    assert {finding.code for finding in verification.findings} == {"CF202"}
    assert verification.unknown_moves == 0


SAMPLE = Path(__file__).parents[2] / "sample_parts" / "blisk_blade"


def sample_job(folder: Path, machine: str) -> Path:
    """The sample's job with a machine, in a folder of its own."""
    job = (SAMPLE / "job.toml").read_text("utf-8").replace("blisk_blade.step", str(SAMPLE / "blisk_blade.step"))
    (folder / "job.toml").write_text(f'{job}\n[machine]\nname = "head-table"\n{machine}')
    return folder / "job.toml"


@pytest.fixture(scope="module")
def sample_plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sweeps and passes of the sample blade, both sides."""
    folder = tmp_path_factory.mktemp("sample")
    result = CliRunner().invoke(cli, ["run", "-q", str(sample_job(folder, "")), "--out", str(folder / "out")])
    assert result.exit_code == 0, result.output
    return folder / "out" / "plan.npz"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("zero", "length"),
    [((-265.9, -42.5, 529.9), 172.0), ((-200.0, 0.0, 500.0), 172.0), ((-100.0, 100.0, 400.0), 200.0)],
)
def test_the_sample_blade_on_a_head_table_machine(
    sample_plan: Path, tmp_path: Path, zero: tuple[float, float, float], length: float
) -> None:
    """The first rapid of a pass went 1.7 mm through the blade: B turned by 112 degrees left the tip below its start."""
    job = sample_job(tmp_path, f"zero = {list(zero)}\ngauge_length = {{T1 = {length}}}\n")
    result = CliRunner().invoke(cli, ["post", "-q", str(sample_plan), "--job", str(job), "-o", str(tmp_path / "A.H")])
    assert result.exit_code == 0, result.output
    scene = load_scene(load_job(job), tmp_path)
    # Corners of all triangles next to the blade, and the blade itself.
    points = [scene.check.vertices]
    for face in scene.faces:
        border = np.vstack(face.loops)
        low, size = border.min(axis=0), np.ptp(border, axis=0)
        u, v = (part.ravel() for part in np.meshgrid(*[np.linspace(0.0, 1.0, 40)] * 2))
        points.append(Projector.of(face.surface).evaluate(low[0] + size[0] * u, low[1] + size[1] * v)[:, 0])
    text = (tmp_path / "A.H").read_text("ascii")
    assert first_rapids("head-table", text, np.array(zero), length, np.vstack(points)[::2]) > KEPT
