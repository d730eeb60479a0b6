"""Job files: every key of the contract with its default, and one message for everything that is wrong."""

import gc
import math
from pathlib import Path

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conflank_cli.errors import InputError
from conflank_cli.job import Job, job_from_builtins, load_job, parse_job
from conflank_cli.tool import CATALOGUE, Section
from postprocessors.facts import plain

PART = '[part]\nfile = "blade.step"\n[[part.design]]\nface = 0\n'
LEAST = PART + '[tools]\nuse = ["T1"]\n'

# The contract, key by key, at its defaults, with everything off that does not exist yet.
WHOLE = """
[part]
file = "blade.step"
scale = 1.0
check_faces = "rest"
[[part.design]]
face = 0
side = "outside"
region = [0.0, 1.0, 0.1, 0.9]
[[part.design]]
face = "suction"
side = "inside"

[tools]
use = ["T1", "T3", "MY6"]
[tools.define.MY6]
r_min = 1.5
r_max = 3.0
length = 24.0
shank = {diameter = 6.0, length = 40.0}
holder = [{diameter = [20.0, 27.0], length = 40.0}, {diameter = 40.0, length = 40.0}]
number = 6
spindle_rpm = 4000
feed_mm_min = 800.0

[tolerance]
overcut = 0.010
undercut = 0.010
allowance = 0.0

[detection]
density = "quick"

[optimization]
mu1 = 1.0
mu2 = 0.1
mu3 = 0.001
mu4 = 0.1
mu5 = 0.1
samples = [100, 30]
polish = true
grow = true

[selection]
coverage = 0.90
objective = "sweeps"
ball_passes = {enabled = false, scallop = 0.005, tool = "T1"}

[obstacles]
meshes = []
margin = {cutter = 0.2, shank = 0.5, holder = 1.0}

[setup]
rotate_deg = [90.0, 0.0, 0.0]
translate = [0.0, 0.0, 0.0]
copies = {axis = [0, 0, 1], count = 24, only = [0]}

[machine]
name = "ac-table"

[program]
name = "BLADE1"
format = "h"
style = "tcpm"
datum = 1
cutting = "climb"
safe = {clearance = 5.0}
coolant = "M8"
cycle32 = {t = 0.002}
"""


def parse(text: str, folder: Path = Path()) -> Job:
    return parse_job(text.encode(), "job.toml", folder)


def test_three_keys_are_enough_and_defaults_are_those_of_the_contract() -> None:
    job = parse(LEAST)
    assert (job.part.scale, job.part.check_faces) == (1.0, "rest")
    assert (job.part.design[0].side, job.part.design[0].region) == ("outside", (0.0, 1.0, 0.0, 1.0))
    assert (job.tolerance.overcut, job.tolerance.undercut, job.tolerance.allowance) == (0.010, 0.010, 0.0)
    weights = job.optimization
    assert (weights.mu1, weights.mu2, weights.mu3, weights.mu4, weights.mu5) == (1.0, 0.1, 0.001, 0.1, 0.1)
    assert (weights.samples, weights.polish, weights.grow) == ((100, 30), True, True)
    assert (job.selection.coverage, job.selection.objective) == (0.90, "sweeps")
    margin = job.obstacles.margin
    assert (margin.cutter, margin.shank, margin.holder) == (0.2, 0.5, 1.0)
    assert job.machine.name == "ac-table"
    program = job.program
    assert (program.format, program.style, program.datum, program.cutting) == ("h", "tcpm", 1, "climb")
    assert (program.safe.clearance, program.coolant, program.cycle32.t, program.cycle32.ta) == (5.0, "M8", 0.002, None)
    assert job.resolved_tools() == (CATALOGUE["T1"],)


def test_a_format_without_a_style_leaves_the_style_to_the_post() -> None:
    assert parse(LEAST + '[program]\nformat = "h"\n').program.style is None
    assert parse(LEAST + '[program]\nstyle = "ln"\n').program.style == "ln"


def test_the_whole_contract_is_read() -> None:
    job = parse(WHOLE)
    assert [design.face for design in job.part.design] == [0, "suction"]
    assert job.part.design[0].region == (0.0, 1.0, 0.1, 0.9)
    assert job.detection.density == "quick"
    mine = job.resolved_tools()[2]
    assert (mine.name, mine.r_min, mine.r_max, mine.length) == ("MY6", 1.5, 3.0, 24.0)
    assert mine.shank == (Section(6.0, 6.0, 40.0),)
    assert mine.holder == (Section(20.0, 27.0, 40.0), Section(40.0, 40.0, 40.0))
    assert (mine.number, mine.spindle_rpm, mine.feed_mm_min) == (6, 4000.0, 800.0)


def test_a_tool_without_shank_and_holder_gets_those_of_the_built_in_tools() -> None:
    job = parse(LEAST + "[tools.define.T1]\nr_min = 1.5\nr_max = 3.0\nlength = 24.0\n")
    assert job.resolved_tools() == (CATALOGUE["T1"],)


def test_a_cylinder_is_a_tool() -> None:
    (tool,) = parse(
        PART + '[tools]\nuse = ["C"]\n[tools.define.C]\nr_min = 4\nr_max = 4\nlength = 38\n'
    ).resolved_tools()
    assert tool.half_angle == 0.0
    assert tool.ball_radius == 4.0


def test_no_holder_is_no_holder() -> None:
    text = PART + '[tools]\nuse = ["C"]\n[tools.define.C]\nr_min = 3\nr_max = 4\nlength = 38\nholder = []\n'
    assert parse(text).resolved_tools()[0].holder == ()


MY = "[tools.define.MY]\nr_min = {}\nr_max = {}\nlength = {}\n"

BAD = [
    # text, place, found, expected
    (PART, "[tools]", "nothing", "'tools'"),
    ('[part]\nfile = "a"\n[tools]\nuse = ["T1"]\n', "[part] design", "nothing", "'design'"),
    ('[[part.design]]\nface = 0\n[tools]\nuse = ["T1"]\n', "[part] file", "nothing", "'file'"),
    (LEAST + "[tolerancee]\novercut = 1\n", "[tolerancee]", "unknown key", "tolerance"),
    (LEAST + "[tolerance]\novercutt = 1\n", "[tolerance] overcutt", "unknown key", "overcut"),
    (LEAST + "[tolerance]\novercut = -1\n", "[tolerance] overcut", "-1", ">= 0"),
    (LEAST + "[tolerance]\novercut = 0\nundercut = 0\n", "[tolerance] overcut, undercut", "0 and 0 mm", "0.002 mm"),
    (LEAST + "[tolerance]\novercut = 0.001\nundercut = 0.0005\n", "[tolerance] overcut, undercut", "0.001", "0.002"),
    (LEAST + "[optimization]\nnorm = 3\n", "[optimization] norm", "3", "max"),
    (LEAST + '[optimization]\nnorm = "least"\n', "[optimization] norm", "least", "max"),
    (LEAST + "[tolerance]\novercut = nan\n", "[tolerance] overcut", "nan", "finite"),
    (LEAST + '[tolerance]\novercut = "10 um"\n', "[tolerance] overcut", "'10 um'", "number"),
    (LEAST + "[tolerance]\novercut = true\n", "[tolerance] overcut", "true", "number"),
    (LEAST + "[optimization]\nmu2 = -0.1\n", "[optimization] mu2", "-0.1", ">= 0"),
    (LEAST + "[optimization]\nmu1=0\nmu2=0\nmu3=0\nmu4=0\nmu5=0\n", "[optimization] mu1", "all zero", "positive"),
    (LEAST + "[optimization]\nsamples = [100]\n", "[optimization] samples", "[100]", "length 2"),
    (LEAST + "[optimization]\nsamples = [100, 2]\n", "[optimization] samples[1]", "2", ">= 4"),
    (LEAST + "[selection]\ncoverage = 90\n", "[selection] coverage", "90", "<= 1"),
    (LEAST + '[selection]\nball_passes = {tool = "T2"}\n', "[selection] ball_passes.tool", "'T2'", "T1"),
    (LEAST + "[machine]\ngauge_length = {T2 = 150.0}\n", "[machine] gauge_length.T2", "'T2'", "T1"),
    (LEAST + '[machine]\ngauge_length = {T1 = "long"}\n', "[machine] gauge_length.T1", "'long'", "number"),
    (LEAST + "[machine]\ngauge_length = {T1 = 0.0}\n", "[machine] gauge_length.T1", "0.0", "> 0"),
    (LEAST + "[machine]\nzero = [1.0, 2.0]\n", "[machine] zero", "[1.0, 2.0]", "length 3"),
    (LEAST + '[program]\nfeed = "middle"\n', "[program] feed", "'middle'", "contact"),
    (LEAST + "[setup]\ncopies = {count = 3, only = [3]}\n", "[setup] copies.only", "[3]", "0 to 2"),
    (LEAST + "[setup]\ncopies = {axis = [0, 0, 0]}\n", "[setup] copies.axis", "[0, 0, 0]", "direction"),
    (LEAST + '[machine]\nname = "a"\nfile = "b.toml"\n', "[machine]", "both", "one of them"),
    (LEAST + '[machine]\nfile = "missing.toml"\n', "[machine] file", "missing.toml", "machine file"),
    (LEAST + '[machine]\ndefinition = ""\n', "[machine] definition", "unknown key", "file"),
    (LEAST + '[program]\nname = "blade 1"\n', "[program] name", "blade 1", "A-Z"),
    (LEAST + '[program]\nformat = "nc"\n', "[program] format", "'nc'", "'h'"),
    (LEAST + '[program]\nsplit = "cut"\n', "[program] split", "'cut'", "'sweep'"),
    (LEAST + "[program]\ndatum = -1\n", "[program] datum", "-1", ">= 0"),
    (LEAST + "[program]\ndatum = [1.0, 2.0]\n", "[program] datum", "[1.0, 2.0]", "length 3"),
    (LEAST + "[program]\ndatum = [1.0, 2.0, nan]\n", "[program] datum", "nan", "finite"),
    (LEAST + "[program]\ntool_numbers = {T2 = 5}\n", "[program] tool_numbers", "no number for T1", "in use"),
    (LEAST + "[program]\ntool_numbers = {T1 = 1, T2 = 5}\n", "[program] tool_numbers", "'T2'", "T1"),
    (LEAST + "[program]\ntool_numbers = {T1 = 40000}\n", "[program] tool_numbers", "40000", "32767"),
    (
        LEAST.replace('["T1"]', '["T1", "T2"]') + "[program]\ntool_numbers = {T1 = 4, T2 = 4}\n",
        "[program] tool_numbers",
        "number 4 for T1 and T2",
        "one number",
    ),
    (LEAST + "[program]\noptions = {decimal = 3}\n", "[program] options", "a table", "text for every key"),
    (LEAST + "[program]\ncycle32 = {t = 0}\n", "[program] cycle32.t", "0", "> 0"),
    (LEAST + "[program]\ncycle32 = {tolerance = 1}\n", "[program] cycle32.tolerance", "unknown key", "t, ta"),
    (LEAST + '[program]\ncoolant = "M91"\n', "[program] coolant", "'M91'", "'M8'"),
    (LEAST + MY.format(3, 1.5, 24), "[tools.define.MY] r_min", "r_min = 3", "r_min <= r_max"),
    (LEAST + MY.format(1, 2, 0), "[tools.define.MY] length", "0", "> 0"),
    (LEAST + MY.format(1, 2, -5), "[tools.define.MY] length", "-5", "> 0"),
    (LEAST + MY.format(-1, 2, 5), "[tools.define.MY] r_min", "-1", "> 0"),
    (LEAST + MY.format(1, 2, 5) + "shank = {diameter = [1, 0], length = 1}", "shank.diameter[1]", "0", "> 0"),
    (LEAST + MY.format(1, 2, 5) + "shank = {diameter = 1}", "[tools.define.MY] shank.length", "nothing", "'length'"),
    (LEAST + MY.format(1, 2, 5) + "radius = 1", "[tools.define.MY] radius", "unknown key", "r_max"),
    *(
        (
            LEAST + f'[tools.define."{name}"]\nr_min = 1\nr_max = 2\nlength = 5\n',
            "[tools.define.",
            f"name {name!r}",
            "A-Z",
        )
        for name in ("FLANK 8", "A;B", "A~B", "Fräser", "刀", "A\u2028B", "A/B", "A(B)", "A*B", "$$", "T\u00a08", "-- ")
    ),
    (LEAST + '[tools.define."A\\"B"]\nr_min = 1\nr_max = 2\nlength = 5\n', "[tools.define.", "name", "A-Z"),
    (LEAST + '[tools.define."A\\nB"]\nr_min = 1\nr_max = 2\nlength = 5\n', "[tools.define.", "name", "A-Z"),
    (LEAST + '[tools.define.""]\nr_min = 1\nr_max = 2\nlength = 5\n', "[tools.define.", "name ''", "1 to 32"),
    (LEAST + f"[tools.define.{'A' * 33}]\nr_min = 1\nr_max = 2\nlength = 5\n", "[tools.define.", "AAA", "1 to 32"),
    (PART + '[tools]\nuse = ["T9"]\n', "[tools] use", "'T9'", "T1, T2, T3"),
    (PART + "[tools]\nuse = []\n", "[tools] use", "[]", "at least one"),
    (PART + '[tools]\nuse = ["T1", "T1"]\n', "[tools] use", "twice", "once"),
    (PART + '[tools]\nuse = ["T1", "MY"]\n' + MY.format(1, 2, 5), "[tools] use", "both tool number 1", "its own"),
    (LEAST.replace("face = 0", "face = -1"), "[[part.design]] 0 face", "-1", ">= 0"),
    (LEAST.replace("face = 0", 'face = 0\nside = "left"'), "[[part.design]] 0 side", "'left'", "'outside', 'inside'"),
    (LEAST.replace("face = 0", "face = 0\nregion = [0, 0, 0, 1]"), "[[part.design]] 0 region", "empty", "u0 != u1"),
    (LEAST.replace("face = 0", "face = 0\nregion = [0, 3, 0, 1]"), "[[part.design]] 0 region[1]", "3", "0 to 1"),
    (LEAST.replace("face = 0", "face = 0\nsides = 0"), "[[part.design]] 0 sides", "unknown key", "side"),
    (LEAST.replace('"blade.step"', '""'), "[part] file", "''", "at least one"),
    (LEAST.replace("[part]", '[part]\ncheck_faces = "all"'), "[part] check_faces", "'all'", "'rest', 'none'"),
    (LEAST.replace("[part]", "[part]\nscale = inf"), "[part] scale", "inf", "finite"),
    ("part = 3\n", "[part]", "3", "table"),
    ("no toml", "job.toml", "no TOML", "TOML"),
]


@pytest.mark.parametrize(("text", "place", "found", "expected"), BAD, ids=range(len(BAD)))
def test_what_is_wrong_is_named(text: str, place: str, found: str, expected: str) -> None:
    with pytest.raises(InputError) as refusal:
        parse(text)
    error = refusal.value
    assert error.where.startswith("job.toml")
    assert place in error.where
    assert found in error.found
    assert expected in error.expected
    assert error.next_step
    assert error.exit_code == 3


def test_a_slip_of_the_pen_gets_a_suggestion() -> None:
    with pytest.raises(InputError, match="Did you mean 'coverage'"):
        parse(LEAST + "[selection]\ncoverrage = 0.9\n")
    with pytest.raises(InputError, match="Did you mean 'BLADE7'"):
        parse(PART + '[tools]\nuse = ["BLADE6"]\n' + MY.replace("MY", "BLADE7").format(1, 2, 5))


def test_a_missing_job_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no readable file"):
        load_job(tmp_path / "none.toml")


def test_a_machine_file_travels_with_the_job(tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text('name = "mine"\n')
    (tmp_path / "job.toml").write_text(LEAST + '[machine]\nfile = "my.toml"\n')
    job = load_job(tmp_path / "job.toml")
    assert job.machine.definition == 'name = "mine"\n'
    assert job_from_builtins(msgspec.to_builtins(job), "a.npz") == job


def test_an_artifacts_job_obeys_the_same_limits() -> None:
    data = msgspec.to_builtins(parse(LEAST))
    data["tolerance"]["overcut"] = -1.0
    with pytest.raises(InputError, match="overcut"):
        job_from_builtins(data, "plan.npz")


@settings(max_examples=50, deadline=None)
@given(st.from_regex("[A-Za-z0-9_.+#-]{1,32}", fullmatch=True))
def test_a_tool_name_that_is_allowed_is_written_as_it_is(name: str) -> None:
    """Otherwise a verification would look for a tool that the job does not have."""
    job = parse(PART + f'[tools]\nuse = ["{name}"]\n' + MY.replace("MY", f'"{name}"').format(1, 2, 5))
    assert [tool.name for tool in job.resolved_tools()] == [name] == [plain(name)]


def test_an_artifacts_tool_names_are_checked_too() -> None:
    data = msgspec.to_builtins(parse(LEAST + MY.format(1, 2, 5)))
    data["tools"]["define"]["FLANK 8"] = data["tools"]["define"].pop("MY")
    with pytest.raises(InputError, match="Rename it, for example 'FLANK_8'"):
        job_from_builtins(data, "plan.npz")


def test_a_machine_file_keeps_its_line_ends(tmp_path: Path) -> None:
    """Its hash is that of its file."""
    (tmp_path / "my.toml").write_bytes(b'name = "mine"\r\n')
    (tmp_path / "job.toml").write_text(LEAST + '[machine]\nfile = "my.toml"\n')
    assert load_job(tmp_path / "job.toml").machine.definition == 'name = "mine"\r\n'


positive = st.floats(1e-6, 1e6)


@settings(max_examples=50, deadline=None)
@given(st.lists(positive, min_size=3, max_size=3), st.floats(0.0, 1.0, exclude_min=True), st.integers(4, 500))
def test_a_resolved_job_comes_back_from_json(numbers: list[float], coverage: float, samples: int) -> None:
    r_min, more, length = numbers
    text = (
        PART
        + f'[tools]\nuse = ["MY"]\n{MY.format(r_min, r_min + more, length)}'
        + f"[selection]\ncoverage = {coverage!r}\n[optimization]\nsamples = [{samples}, 4]\n"
    )
    job = parse(text)
    assert msgspec.json.decode(msgspec.json.encode(job), type=Job) == job
    (tool,) = job.resolved_tools()
    assert tool.half_angle == math.atan2(tool.r_max - tool.r_min, length)


def test_garbage_collection_survives_the_schema() -> None:
    """Limits as msgspec.Meta inside a union crashed the interpreter here (msgspec 0.22)."""
    for _ in range(3):
        with pytest.raises(InputError):
            parse(LEAST + MY.format(1, 2, 5) + 'shank = {diameter = "x", length = 1}')
        gc.collect()
    assert parse(WHOLE) == parse(WHOLE)
