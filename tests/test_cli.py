"""The command line as a user and a shell see it: the pipeline, its files, its exit codes and its messages."""

import hashlib
import json
import os
import pty
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import click
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner, Result

from conflank_cli.artifacts import read_artifact, write_artifact
from conflank_cli.cad.scene import load_scene
from conflank_cli.cli import cli
from conflank_cli.job import BallPasses, Selection, load_job

# A hyperbolic paraboloid, 30 x 20 mm: ruled twice, so one sweep of a cone covers it within the tolerance.
SADDLE = {
    "faces": [
        {
            "name": "saddle",
            "degree_u": 1,
            "degree_v": 1,
            "knots_u": [0, 0, 1, 1],
            "knots_v": [0, 0, 1, 1],
            "poles": [[[0, 0, 1.0], [0, 20, -1.0]], [[30, 0, -1.0], [30, 20, 1.0]]],
            "outside": "along",
        }
    ]
}
JOB = """[part]
file = "blade.json"
[[part.design]]
face = 0
[tools]
use = ["T1"]
[detection]
density = "quick"
"""
# A process of its own starts in another folder, and imports from here nevertheless.
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(Path(__file__).parent.parent)}
FILES = ["BLADE1.H", "BLADE1.H.verification.json", "candidates.npz", "motions.npz", "plan.npz", "report.html"]


def conflank(*arguments: str, cwd: Path, data: bytes | None = None) -> subprocess.CompletedProcess[bytes]:
    """Run the installed program as a shell would."""
    command = [sys.executable, "-c", "from conflank_cli.cli import main; main()", *arguments]
    return subprocess.run(command, cwd=cwd, input=data or b"", capture_output=True, timeout=120)


def invoke(*arguments: str, data: bytes | None = None) -> Result:
    """Run in this process, where a process of its own would prove nothing more."""
    return CliRunner().invoke(cli, list(arguments), input=data)


def write_job(folder: Path, job: str = JOB) -> Path:
    (folder / "blade.json").write_text(json.dumps(SADDLE))
    (folder / "job.toml").write_text(job)
    return folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a job and everything that `conflank run` makes of it in out/; what it printed in done.txt."""
    folder = write_job(tmp_path_factory.mktemp("job"))
    done = conflank("run", "job.toml", "--out", "out", cwd=folder)
    (folder / "done.txt").write_bytes(done.stderr)
    assert (done.returncode, done.stdout) == (0, b""), done.stderr.decode()
    return folder


# --- the pipeline ---------------------------------------------------------------------------------------------------


def test_run_without_a_report_names_one_of_an_earlier_run(finished: Path, tmp_path: Path) -> None:
    shutil.copytree(finished, tmp_path / "again")
    folder = tmp_path / "again"
    (folder / "out" / "report.html").write_text("of an earlier run", encoding="utf-8")
    done = conflank("run", "job.toml", "--out", "out", "--no-report", cwd=folder)
    assert done.returncode == 0, done.stderr.decode()
    assert "report.html is of an earlier run" in done.stderr.decode().replace("\n", "")
    assert (folder / "out" / "report.html").read_text("utf-8") == "of an earlier run"
    for name in FILES:
        if name != "report.html":
            assert (folder / "out" / name).read_bytes() == (finished / "out" / name).read_bytes()
    bare = conflank("run", "job.toml", "--out", "bare", "--no-report", cwd=folder)
    assert "earlier run" not in bare.stderr.decode()
    assert sorted(path.name for path in (folder / "bare").iterdir()) == [
        name for name in FILES if name != "report.html"
    ]


def test_run_writes_its_files_and_a_table(finished: Path) -> None:
    assert sorted(path.name for path in (finished / "out").iterdir()) == FILES
    table = (finished / "done.txt").read_text("utf-8")
    for word in ("sweep 1", "T1", "length mm", "covered mm²", "coverage", "findings      none", "out/BLADE1.H"):
        assert word in table
    verification = json.loads((finished / "out" / "BLADE1.H.verification.json").read_bytes())
    assert verification["coverage"] >= 0.99
    assert verification["overcut_max_um"] <= 10.0
    assert verification["findings"] == []


def test_passes_finish_what_a_short_sweep_leaves(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Passes are told apart from the sweep all the way from the plan to the judgement."""
    monkeypatch.chdir(tmp_path)
    scene, sweeps, _ = read_artifact(finished / "out" / "plan.npz", "plan")
    selection = Selection(coverage=0.5, ball_passes=BallPasses(enabled=True))
    scene = replace(scene, job=msgspec.structs.replace(scene.job, selection=selection))
    short = replace(sweeps[0], motion=sweeps[0].motion.restricted(0.0, 0.8))
    write_artifact("motions", scene, [short], {}, "motions.npz")
    assert invoke("select", "motions.npz", "-o", "plan.npz").exit_code == 0
    listed = invoke("inspect", "plan.npz").stdout
    assert "1 sweeps, " in listed and "with passes %" in listed
    assert invoke("post", "plan.npz", "-o", "P.H").exit_code == 0
    result = invoke("verify", "P.H", "--job", str(finished / "job.toml"))
    found = json.loads(Path("P.H.verification.json").read_bytes())
    assert result.exit_code == 0 and found["coverage"] >= 0.9999 > found["coverage_flank"] + 0.02
    assert found["step_max_um"] <= 10.0
    assert [item["number"] for item in found["passes"]] == list(range(2, 2 + len(found["passes"])))
    assert "% without the passes" in result.output and "and passes" in result.output


def test_the_shell_pipe_gives_the_bytes_of_run(finished: Path) -> None:
    program = f'{shlex.quote(sys.executable)} -c "from conflank_cli.cli import main; main()"'
    stages = f"{program} detect job.toml | tee c.npz | {program} optimize | tee m.npz | {program} select | tee p.npz"
    subprocess.run(["bash", "-o", "pipefail", "-c", f"{stages} | {program} post > P.H"], cwd=finished, check=True)
    for made, file in (("c", "candidates"), ("m", "motions"), ("p", "plan")):
        assert (finished / f"{made}.npz").read_bytes() == (finished / "out" / f"{file}.npz").read_bytes(), file
    assert (finished / "P.H").read_bytes() == (finished / "out" / "BLADE1.H").read_bytes()


def test_equal_inputs_give_equal_bytes_however_called(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    job = finished / "job.toml"
    result = invoke("detect", str(job), "-o", "candidates.npz", "--quiet")
    assert (result.exit_code, result.output) == (0, "")
    assert Path("candidates.npz").read_bytes() == (finished / "out" / "candidates.npz").read_bytes()
    monkeypatch.chdir(finished)
    result = invoke("detect", "-", data=job.read_bytes())
    assert result.stdout_bytes == (finished / "out" / "candidates.npz").read_bytes()


def test_density_on_the_command_line_goes_before_the_job(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(write_job(tmp_path, JOB.replace("quick", "exhaustive")))
    result = invoke("detect", "job.toml", "--density", "quick", "-o", "candidates.npz")
    assert result.exit_code == 0, result.stderr
    (found, sweeps, _), (usual, expected, _) = (
        read_artifact(str(path), "candidates") for path in ("candidates.npz", finished / "out" / "candidates.npz")
    )
    assert found.job.detection.density == usual.job.detection.density == "quick"
    assert [sweep.facts for sweep in sweeps] == [sweep.facts for sweep in expected]
    result = invoke("detect", "job.toml", "--density", "thorough")
    assert result.exit_code == 2
    assert "quick, normal, exhaustive" in result.stderr


@pytest.mark.parametrize(
    ("tolerance", "norm", "overcut", "stock"),
    [
        ("overcut = 0\nundercut = 0.04", "8", 0.0, 40.0),
        pytest.param("overcut = 0.02\nundercut = 0.02", '"max"', 20.0, 20.0, marks=pytest.mark.slow),
    ],
)
def test_a_forbidden_side_and_the_largest_norm_reach_the_posted_program(
    tolerance: str, norm: str, overcut: float, stock: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The saddle is bent too much for this cutter to cover it whole within a micrometre: both have something to do."""
    write_job(tmp_path, JOB + f"[tolerance]\n{tolerance}\n[optimization]\nnorm = {norm}\n")
    monkeypatch.chdir(tmp_path)
    result = invoke("run", "job.toml", "--out", "out")
    assert result.exit_code == 0, result.output
    verification = json.loads((tmp_path / "out" / "BLADE1.H.verification.json").read_bytes())
    assert verification["coverage"] >= 0.99
    assert verification["overcut_max_um"] <= overcut
    assert verification["sweeps"][0]["gap_max_um"] <= stock


def test_run_as_json_keeps_stdout_for_data(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(finished)
    result = invoke("run", "job.toml", "--out", str(tmp_path / "deep" / "out"), "--json", "--quiet")
    summary = json.loads(result.stdout)
    assert result.stderr == ""
    assert set(summary) == documented_keys()["run"]
    assert sorted(Path(name).name for name in summary["files"]) == FILES
    assert summary["verification"]["program_sha256"]
    for name in FILES:
        assert (tmp_path / "deep" / "out" / name).read_bytes() == (finished / "out" / name).read_bytes(), name


def test_verify_leaves_the_program_alone_and_findings_exit_1(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    program = tmp_path / "BLADE1.H"
    text = (finished / "out" / "BLADE1.H").read_bytes()
    program.write_bytes(text)
    result = invoke("verify", "BLADE1.H", "--job", str(finished / "job.toml"))
    assert result.exit_code == 0, result.stderr
    assert program.read_bytes() == text
    # The verification of `run` and that of the program on its own say the same.
    assert (tmp_path / "BLADE1.H.verification.json").read_bytes() == (
        finished / "out" / "BLADE1.H.verification.json"
    ).read_bytes()
    # The same program against a blade that stands 0.1 mm higher cuts into it.
    higher = json.loads(json.dumps(SADDLE))
    for row in higher["faces"][0]["poles"]:
        for pole in row:
            pole[2] += 0.1
    (tmp_path / "blade.json").write_text(json.dumps(higher))
    (tmp_path / "job.toml").write_text(JOB)
    result = invoke("verify", "BLADE1.H", "--job", "job.toml", "-o", "-")
    assert result.exit_code == 1
    verification = json.loads(result.stdout)
    assert {"CF201", "CF202"} <= {finding["code"] for finding in verification["findings"]}
    assert 95.0 < verification["overcut_max_um"] < 105.0
    assert "CF201 gouge" in result.stderr


def test_a_later_stage_takes_what_is_downstream_of_it(finished: Path, tmp_path: Path) -> None:
    other = JOB.replace('"quick"', '"normal"') + '[program]\nname = "OTHER"\n'
    (tmp_path / "other.toml").write_text(other)
    plan = str(finished / "out" / "plan.npz")
    result = invoke("post", plan, "--job", str(tmp_path / "other.toml"))
    assert result.exit_code == 0
    assert result.stdout_bytes.startswith(b"0 BEGIN PGM OTHER MM\r\n")
    assert "[detection]" in result.stderr and "not used" in result.stderr
    expected = (finished / "out" / "BLADE1.H").read_bytes().replace(b"BLADE1", b"OTHER")
    assert result.stdout_bytes == expected


FORMATS = {
    "m128": ("BLADE1.H", 'style = "m128"\ndatum = [10.0, -20.0, 5.5]\n'),
    "ln": ("BLADE1.H", 'style = "ln"\noptions = {decimal = "comma"}\n'),
    "iso": ("BLADE1.I", 'format = "i"\n'),
    "apt": ("BLADE1.APT", 'format = "apt"\n'),
    "number": ("BLADE1.H", "tool_numbers = {T1 = 12}\n"),
    "split": ("BLADE1.H", 'split = "sweep"\n'),
}


def test_a_verification_is_the_same_however_it_is_made(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By run, by verify in another folder, and from an artifact; it says what it is of."""
    monkeypatch.chdir(tmp_path)
    of_run = (finished / "out" / "BLADE1.H.verification.json").read_bytes()
    program = str(finished / "out" / "BLADE1.H")
    assert invoke("verify", program, "--job", str(finished / "job.toml"), "-o", "again.json").exit_code == 0
    assert Path("again.json").read_bytes() == of_run
    result = invoke("report", str(finished / "out" / "plan.npz"), program, "-o", "r.html", "--json")
    assert json.loads(result.stdout)["verification"] == json.loads(of_run)
    found = json.loads(of_run)
    assert (found["schema"], found["schema_version"]) == ("conflank.verification", 2)
    part = hashlib.sha256((finished / "blade.json").read_bytes()).hexdigest()
    assert found["against"]["part"] == {"name": "blade.json", "sha256": part}
    for line in (f"part          blade.json (sha256 {part[:12]})", "unknown       ", "limits        overcut 10"):
        assert line in (finished / "done.txt").read_text("utf-8")


@pytest.mark.parametrize("name", FORMATS)
def test_whatever_is_posted_is_proven(
    name: str, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every format and style cuts what the tcpm program cuts, within what posting may change."""
    monkeypatch.chdir(write_job(tmp_path, f"{JOB}[program]\n{FORMATS[name][1]}"))
    file = FORMATS[name][0]
    result = invoke("post", str(finished / "out" / "plan.npz"), "--job", "job.toml", "-o", file)
    assert result.exit_code == 0, result.stderr
    result = invoke("verify", file, "--job", "job.toml")
    assert result.exit_code == 0, result.stderr
    own, first = (
        json.loads(path.read_bytes())
        for path in (Path(f"{file}.verification.json"), finished / "out" / "BLADE1.H.verification.json")
    )
    for key in ("overcut_max_um", "stock_max_um"):
        assert own[key] == pytest.approx(first[key], abs=0.5)
    assert own["coverage"] == pytest.approx(first["coverage"], abs=0.01)
    assert own["time_s"] == pytest.approx(first["time_s"], rel=0.01)


def test_a_split_program_is_several_files(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(write_job(tmp_path, f'{JOB}[program]\nsplit = "tool"\n'))
    plan = str(finished / "out" / "plan.npz")
    result = invoke("post", plan, "--job", "job.toml")
    assert result.exit_code == 2
    assert_one_message(result.stderr, ["standard output", "several programs", "-o FILE"])
    assert invoke("post", plan, "--job", "job.toml", "-o", "BLADE1_1.H").exit_code == 2
    assert not [*tmp_path.glob("*.H")]
    assert invoke("post", plan, "--job", "job.toml", "-o", "MAIN.H").exit_code == 0
    assert sorted(path.name for path in tmp_path.glob("*.H")) == ["BLADE1_1.H", "MAIN.H"]
    assert invoke("verify", "MAIN.H", "--job", "job.toml").exit_code == 0
    # A part that was judged with the calling program may be sent, and so may that; not once a part is another.
    profile = ["--profile", "itnc530-standard", "--port", "loop://"]
    for program in ("MAIN.H", "BLADE1_1.H"):
        assert invoke("dnc", "send", program, *profile).exit_code == 0
    Path("BLADE1_1.H").write_bytes(Path("BLADE1_1.H").read_bytes().replace(b"F1000", b"F2000"))
    for program in ("MAIN.H", "BLADE1_1.H"):
        result = invoke("dnc", "send", program, *profile)
        assert result.exit_code == 3, result.stderr
    Path("BLADE1_1.H").unlink()
    result = invoke("verify", "MAIN.H", "--job", "job.toml", "-o", "-")
    assert result.exit_code == 1
    findings = {finding["code"]: finding["text"] for finding in json.loads(result.stdout)["findings"]}
    assert "there is no BLADE1_1.H beside the program" in findings["CF102"]


def test_run_writes_all_parts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(write_job(tmp_path, f'{JOB}[program]\nsplit = "sweep"\nstyle = "ln"\n'))
    result = invoke("run", "job.toml", "--out", "out", "--json")
    assert result.exit_code == 0, result.stderr
    done = json.loads(result.stdout)
    assert sorted(done["files"]) == sorted(f"out/{name}" for name in [*FILES, "BLADE1_1.H"])
    assert all(Path(name).is_file() for name in done["files"])
    assert list(done["verification"]["called_sha256"]) == ["BLADE1_1.H"]


def test_inspect_prints_parts_and_artifacts(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(finished)
    result = invoke("inspect", "blade.json")
    assert result.exit_code == 0 and "saddle" in result.stdout
    faces = json.loads(invoke("inspect", "blade.json", "--json").stdout)["faces"]
    # z = slope x y about the middle, so the area is the integral of sqrt(1 + slope² (x² + y²)).
    slope = 1.0 / (15.0 * 10.0)
    x, y = np.meshgrid(np.linspace(-15.0, 15.0, 601), np.linspace(-10.0, 10.0, 401))
    area = np.trapezoid(np.trapezoid(np.sqrt(1.0 + slope**2 * (x**2 + y**2)), dx=0.05), dx=0.05)
    assert faces[0]["area"] == pytest.approx(area, abs=1e-3)
    shown = {
        "candidates": (" area_mm2",),
        "motions": ("axis_error_max_um", "terms of the functional", "orthogonality", "x the last step"),
        "plan": ("covered_area_mm2", "certified_overcut_um"),
    }
    for kind, words in shown.items():
        path = f"out/{kind}.npz"
        result = invoke("inspect", path)
        assert result.exit_code == 0 and result.stdout.startswith(kind), result.stderr
        for word in words:
            assert word in result.stdout
            assert not any(word in invoke("inspect", f"out/{other}.npz").stdout for other in shown if other != kind)
        piped = invoke("inspect", "--json", data=Path(path).read_bytes())
        assert json.loads(piped.stdout)["schema"] == f"conflank/{kind}"


# --- pictures -------------------------------------------------------------------------------------------------------


def test_the_report_is_the_same_from_a_plan_from_its_program_and_from_run(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(finished / "out")
    expected = Path("report.html").read_bytes()
    for name, sources in (
        ("a.html", ["plan.npz"]),
        ("b.html", ["BLADE1.H.verification.json", "BLADE1.H", "plan.npz"]),
    ):
        result = invoke("report", *sources, "-o", str(tmp_path / name))
        assert result.exit_code == 0, result.stderr
        assert (tmp_path / name).read_bytes() == expected
    result = invoke("report", "BLADE1.H", "../job.toml", "-o", "-", "--quiet")
    assert (result.exit_code, result.stderr) == (0, "")
    assert result.stdout_bytes.startswith(b"<!DOCTYPE html>")
    Path("OTHER.H").write_bytes(Path("BLADE1.H").read_bytes().replace(b"F1000", b"F1001"))
    result = invoke("report", "OTHER.H", "plan.npz", "BLADE1.H.verification.json", "-o", str(tmp_path / "c.html"))
    Path("OTHER.H").unlink()
    assert result.exit_code == 3
    assert_one_message(result.stderr, ["BLADE1.H.verification.json", "another text", "OTHER.H"])
    assert not (tmp_path / "c.html").exists()


def test_what_a_report_is_made_of_must_be_there(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(finished / "out")
    for sources, words in (
        (["BLADE1.H"], ["what the part is"]),
        (["motions.npz"], ["no program yet"]),
        (["plan.npz", "../job.toml"], ["job.toml", "carries one"]),
    ):
        result = invoke("report", *sources, "-o", "x.html")
        assert result.exit_code == 2
        assert_one_message(result.stderr, words)
        assert not Path("x.html").exists()


def test_a_report_of_a_job_runs_its_stages(finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(finished)
    result = invoke("report", "job.toml", "--reach", "-o", str(tmp_path / "report.html"))
    assert result.exit_code == 0, result.stderr
    page = (tmp_path / "report.html").read_text("utf-8")
    assert "least axis error of T1, 2/3 of the flute" in page and "why the plan leaves the rest" in page


@pytest.mark.parametrize(
    ("arguments", "begins"),
    [
        (["plot", "lines", "candidates.npz", "-o", "{}/x.png"], b"\x89PNG"),
        (["plot", "convergence", "candidates.npz", "-o", "{}/x.svg"], b"<?xml"),
        (["plot", "axes", "plan.npz", "BLADE1.H", "-o", "{}/x.pdf"], b"%PDF"),
        (["export", "ruled", "plan.npz", "-o", "{}/x.step"], b"ISO-10303-21;"),
        (["export", "envelope", "motions.npz", "-o", "{}/x.step"], b"ISO-10303-21;"),
        (["export", "gap", "plan.npz", "-o", "{}/x.ply"], b"ply"),
        (["export", "cuts", "plan.npz", "-o", "{}/x.csv"], b"kind,number,tool"),
        (["export", "poses", "BLADE1.H", "../job.toml", "-o", "{}/x.csv"], b"block,cut,x_mm"),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, list) else "",
)
def test_figures_and_models(
    arguments: list[str], begins: bytes, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(finished / "out")
    result = invoke(*(each.format(tmp_path) for each in arguments))
    assert result.exit_code == 0, result.stderr
    (made,) = tmp_path.iterdir()
    assert made.read_bytes().startswith(begins)
    assert made.name in result.stderr


# --- help -----------------------------------------------------------------------------------------------------------


def example(text: str) -> list[str]:
    """The example that a help text ends with."""
    found = re.search(r"Example:\n\s+conflank (.*)\n\Z", text)
    assert found, text
    return shlex.split(found[1])


def every_command() -> list[tuple[str, ...]]:
    """The words of every command, with those below it."""
    found: list[tuple[str, ...]] = []

    def walk(command: click.Command, words: tuple[str, ...]) -> None:
        found.append(words)
        if isinstance(command, click.Group):
            context = click.Context(command)
            for name in command.list_commands(context):
                below = command.get_command(context, name)
                assert below is not None
                walk(below, (*words, name))

    walk(cli, ())
    return found


@pytest.mark.parametrize("words", every_command(), ids=lambda words: " ".join(words) or "conflank")
def test_help_is_as_agreed(words: tuple[str, ...]) -> None:
    """Snapshots: after a change on purpose, write them anew with CONFLANK_SNAPSHOTS=write."""
    result = invoke(*words, "--help")
    assert result.exit_code == 0
    snapshot = Path(__file__).parent / "help" / f"{'-'.join(words) or 'conflank'}.txt"
    if os.environ.get("CONFLANK_SNAPSHOTS") == "write":
        snapshot.parent.mkdir(exist_ok=True)
        snapshot.write_text(result.output, "utf-8")
    assert result.output == snapshot.read_text("utf-8")
    assert example(result.output)
    # Every command can be quiet and tell where an error came from; whatever prints figures prints them as JSON.
    if words not in ((), ("dnc",)):
        assert "--quiet" in result.output and "--debug" in result.output
        assert ("--json" in result.output) is (words != ("completion",))


def test_the_examples_of_the_help_texts_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the order of the pipeline each finds the files that the ones before it made."""
    monkeypatch.chdir(write_job(tmp_path))
    (tmp_path / "blade.step").symlink_to(Path(__file__).parent.parent / "sample_parts/blisk_blade/blisk_blade.step")
    first, *others = every_command()
    for words in [*others, first]:
        arguments = example(invoke(*words, "--help").output)
        if words == ("dnc", "receive"):
            # Somebody has to send: that is the example of `simulate`.
            continue
        if words == ("dnc", "simulate"):
            other = [sys.executable, "-m", "conflank_cli", *arguments]
            with subprocess.Popen(other, stdout=subprocess.PIPE, env=ENVIRONMENT) as control:
                assert control.stdout is not None
                control.stdout.readline()
                assert invoke(*example(invoke("dnc", "receive", "--help").output)).exit_code == 0
                assert control.wait(timeout=10) == 0
            assert Path("COPY.H").read_bytes() == Path("BLADE1.H").read_bytes()
            continue
        result = invoke(*arguments)
        assert result.exit_code == 0, (arguments, result.stderr)
    assert (tmp_path / "BLADE1.H").read_bytes() == (tmp_path / "out" / "BLADE1.H").read_bytes()


# --- figures as JSON ------------------------------------------------------------------------------------------------

PROFILE = ("--profile", "itnc530-blockwise")
PLAN, MOTIONS, CANDIDATES = ("out/plan.npz", "out/motions.npz", "out/candidates.npz")
DOCUMENTS = {
    # command as docs/file-formats.md calls it: (a call of it in the folder of a finished job, exit code)
    "inspect PART": (["inspect", "blade.json"], 0),
    "inspect ARTIFACT": (["inspect", PLAN], 0),
    "reach": (["reach", "job.toml", "--points", "60"], 0),
    "detect": (["detect", "job.toml", "-o", "{}/c.npz"], 0),
    "optimize": (["optimize", CANDIDATES, "-o", "{}/m.npz"], 0),
    "select": (["select", MOTIONS, "-o", "{}/p.npz"], 0),
    "post": (["post", PLAN, "-o", "{}/P.H"], 0),
    "verify": (["verify", "out/BLADE1.H", "--job", "job.toml", "-o", "{}/v.json"], 0),
    "report": (["report", PLAN, "out/BLADE1.H", "-o", "{}/r.html"], 0),
    "plot": (["plot", "lines", PLAN, "-o", "{}/l.svg"], 0),
    "export": (["export", "poses", PLAN, "out/BLADE1.H", "-o", "{}/p.csv"], 0),
    "machines": (["machines"], 0),
    "machines check": (["machines", "check", "ac-table"], 0),
    "dnc send": (["dnc", "send", "out/BLADE1.H", *PROFILE], 0),
    "dnc drip": (["dnc", "drip", "out/BLADE1.H", *PROFILE], 0),
    "dnc serve": (["dnc", "serve", "out", *PROFILE], 0),
    "dnc ports": (["dnc", "ports"], 0),
    "dnc check": (["dnc", "check", "--mp5020", "169"], 1),
}


def documented_keys() -> dict[str, set[str]]:
    """The keys of each command's document, from the table in docs/file-formats.md."""
    text = (Path(__file__).parent.parent / "docs" / "file-formats.md").read_text("utf-8")
    section = text.partition("## Figures as JSON")[2].partition("## ")[0]
    keys = {}
    for commands, named in re.findall(r"^\| (`[^|]*) \| ([^|]*) \|", section, re.MULTILINE):
        for command in re.findall(r"`([^`]+)`", commands):
            keys[command] = set(re.findall(r"`([^`]+)`", named))
    return keys


@pytest.mark.parametrize("command", DOCUMENTS)
def test_json_is_one_object_with_the_documented_keys(
    command: str, finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(finished)
    arguments, code = DOCUMENTS[command]
    result = invoke(*(each.format(tmp_path) for each in arguments), "--json", "--quiet")
    assert (result.exit_code, result.stderr) == (code, "")
    document = json.loads(result.stdout)
    assert set(document) == documented_keys()[command]
    # What it says was written is there, and nothing else.
    if "files" in document:
        assert sorted(document["files"]) == sorted(str(path) for path in tmp_path.iterdir())


def test_every_command_with_json_is_documented(finished: Path) -> None:
    described = {
        command.partition(" ")[0] if command.startswith("inspect") else command for command in documented_keys()
    }
    every = {" ".join(words) for words in every_command()} - {"", "dnc", "completion"}
    assert described == every
    document = json.loads((finished / "out" / "BLADE1.H.verification.json").read_bytes())
    shown = invoke("inspect", str(finished / "out" / "BLADE1.H.verification.json"), "--json")
    assert json.loads(shown.stdout) == document


def test_the_verification_is_in_the_document_where_both_go_to_stdout(
    finished: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(finished)
    result = invoke("verify", "--job", "job.toml", "--json", data=Path("out/BLADE1.H").read_bytes())
    document = json.loads(result.stdout)
    assert document["files"] == []
    assert document["verification"]["program_sha256"]
    result = invoke("post", PLAN, "--json")
    assert result.exit_code == 2
    assert_one_message(result.stderr, ["--json", "the program on standard output too", "-o"])


def test_help_answers_at_once(tmp_path: Path) -> None:
    """Under 0.2 s of processor time; the best of three, because other work may be going on here."""
    times = []
    for _ in range(3):
        before = os.times()
        assert conflank("--help", cwd=tmp_path).returncode == 0
        after = os.times()
        times.append(after.children_user + after.children_system - before.children_user - before.children_system)
    assert min(times) < 0.2


# --- what goes wrong ------------------------------------------------------------------------------------------------


def face_of(**changes: object) -> str:
    return json.dumps({"faces": [SADDLE["faces"][0] | changes]})


NAN = face_of().replace("[0, 20, -1.0]", "[0, 20, NaN]")
FLAT = face_of(poles=[[[0, 0, 0], [0, 0, 0]], [[30, 0, 0], [30, 0, 0]]])
MY = "[tools.define.T1]\nr_min = {}\nr_max = {}\nlength = {}\n"

BAD_JOBS = {
    # name: (job, part, file name of the part, exit code, words of the message)
    "part missing": (JOB, None, "blade.json", 3, ["blade.json", "no readable file"]),
    "part empty": (JOB, "", "blade.json", 3, ["blade.json", "empty"]),
    "part of no known type": (JOB.replace(".json", ".dwg"), "x", "blade.dwg", 3, ["blade.dwg", ".step"]),
    "STEP truncated": (
        JOB.replace(".json", ".step"),
        "ISO-10303-21;\nHEADER;\n",
        "blade.step",
        3,
        ["blade.step", "END-ISO-10303-21"],
    ),
    "no STEP": (JOB.replace(".json", ".step"), "solid x\n", "blade.step", 3, ["blade.step", "ISO-10303-21"]),
    "no face": (JOB, '{"faces": []}', "blade.json", 3, ["blade.json"]),
    "face out of range": (JOB.replace("face = 0", "face = 7"), face_of(), "blade.json", 3, ["face number 7"]),
    "face name unknown": (JOB.replace("face = 0", 'face = "x"'), face_of(), "blade.json", 3, ["'x'", "saddle"]),
    "NaN in a face": (JOB, NAN, "blade.json", 3, ["blade.json"]),
    "face without area": (JOB, FLAT, "blade.json", 3, ["blade.json"]),
    "knots too few": (JOB, face_of(knots_u=[0, 1]), "blade.json", 3, ["knots_u"]),
    "job no TOML": ("part", face_of(), "blade.json", 3, ["job.toml", "TOML"]),
    "key unknown": (JOB + "[tolerance]\nover = 1\n", face_of(), "blade.json", 3, ["[tolerance] over", "overcut"]),
    "r_min > r_max": (JOB + MY.format(3, 2, 20), face_of(), "blade.json", 3, ["[tools.define.T1] r_min", "r_max = 2"]),
    "tool without length": (JOB + MY.format(1, 2, 0), face_of(), "blade.json", 3, ["[tools.define.T1] length"]),
    "format unknown": (JOB + '[program]\nformat = "nc"\n', face_of(), "blade.json", 3, ["[program] format", "'h'"]),
    "style not in ISO": (
        JOB + '[program]\nformat = "i"\nstyle = "ln"\n',
        face_of(),
        "blade.json",
        3,
        ["job.toml: [program] style", "'ln'", "no LN and no FUNCTION TCPM"],
    ),
    "tool missing": (JOB + "[program]\ntool_numbers = {T2 = 5}\n", face_of(), "blade.json", 3, ["no number for T1"]),
    "machine unknown": (JOB + '[machine]\nname = "mill"\n', face_of(), "blade.json", 3, ["mill", "ac-table"]),
}


def assert_one_message(stderr: str, words: list[str]) -> None:
    """Place, found, expected, next step; once, and no traceback."""
    assert re.fullmatch(r"error: .+\n  found +.+\n  expected +.+\n  next +.+\n", stderr), stderr
    assert "Traceback" not in stderr
    for word in words:
        assert word in stderr


@pytest.mark.parametrize("name", BAD_JOBS)
def test_bad_input_gets_one_message_and_no_output(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job, part, file, code, words = BAD_JOBS[name]
    monkeypatch.chdir(tmp_path)
    Path("job.toml").write_text(job)
    if part is not None:
        Path(file).write_text(part)
    before = sorted(tmp_path.rglob("*"))
    result = invoke("run", "job.toml", "--out", "out")
    assert result.exit_code == code, result.stderr
    assert result.stdout == ""
    assert_one_message(result.stderr, words)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_tool_so_large_that_no_line_fits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_job(tmp_path, JOB + MY.format(900, 1000, 2000))
    result = invoke("run", "job.toml", "--out", "out")
    assert result.exit_code == 4, result.stderr
    assert_one_message(result.stderr, ["T1"])
    assert not Path("out").exists()


BAD_CALLS = [
    (["frobnicate"], 2, "frobnicate"),
    (["inspet", "x"], 2, "Did you mean 'inspect'?"),
    (["machines", "chekc"], 2, "Did you mean 'check'?"),
    (["detect", "--densty", "quick"], 2, "Did you mean --density?"),
    (["plot", "gpa", "job.toml", "-o", "x.png"], 2, "Did you mean 'gap'?"),
    (["machines", "check", "acc-table"], 3, "Did you mean 'ac-table'?"),
    (["detect", "job.toml", "-o", "/proc/x.npz"], 2, "/proc/x.npz"),
    (["detect", "job.toml", "-o", "/dev/full"], 2, "No space left"),
    (["run", "job.toml", "--out", "job.toml/out"], 2, "a file"),
    (["inspect", "job.toml"], 3, "conflank run"),
    (["inspect", "blade.verification.json"], 3, "no readable file"),
    (["run"], 2, "JOB"),
    (["run", "job.toml", "--fast"], 2, "--fast"),
    (["verify", "BLADE1.H"], 2, "--job"),
    (["run", "none.toml"], 3, "none.toml"),
    (["detect", "none.toml"], 3, "none.toml"),
    (["optimize", "none.npz"], 3, "none.npz"),
    (["inspect", "none.step"], 3, "none.step"),
    (["verify", "none.H", "--job", "job.toml"], 3, "none.H"),
    (["run", "job.toml", "--out", "job.toml"], 2, "a file"),
    (["detect", "job.toml", "-o", "job.toml"], 2, "one of the inputs"),
    (["detect", "job.toml", "-o", "blade.json"], 2, "one of the inputs"),
    (["detect", "job.toml", "-o", "no/such/folder.npz"], 2, "folder"),
    (["verify", "job.toml", "--job", "job.toml", "-o", "blade.json"], 2, "one of the inputs"),
    (["report", "none.npz"], 3, "none.npz"),
    (["report", "job.toml", "job.toml"], 2, "a second job"),
    (["report", "blade.json"], 3, "JSON that is no verification"),
    (["report", "job.toml", "-o", "job.toml"], 2, "one of the inputs"),
    (["plot", "gap", "job.toml", "-o", "gap.gif"], 2, ".png, .svg, .pdf"),
    (["plot", "pie", "job.toml", "-o", "pie.png"], 2, "coverage"),
    (["export", "gap", "job.toml", "-o", "gap.stl"], 2, ".ply .glb"),
    (["export", "ruled", "job.toml", "-o", "x.stl"], 3, "another type"),
    (["optimize", "job.toml"], 3, "another type"),
    (["select", "blade.json", "-o", "x.npz"], 3, "another type"),
    (["select", "blade.json", "--json"], 2, "-o"),
    (["select", "blade.json", "-o", "x.npz", "--picture", "x.gif"], 2, ".png"),
]


@pytest.mark.parametrize(("arguments", "code", "word"), BAD_CALLS, ids=lambda value: str(value))
def test_bad_calls(arguments: list[str], code: int, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(write_job(tmp_path))
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    result = invoke(*arguments)
    assert result.exit_code == code, result.stderr
    assert result.stdout == ""
    assert_one_message(result.stderr[result.stderr.index("error: ") :], [word])
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_select_tells_what_covers_what_in_a_table_in_json_and_in_a_picture(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    motions = str(finished / "out" / "motions.npz")
    result = invoke("select", motions, "-o", "plan.npz", "--json", "--picture", "plan.png")
    assert result.exit_code == 0, result.stderr
    for word in ("covered %", "at least", "gap %", "nothing says where the hub is"):
        assert word in result.stderr
    document = json.loads(result.stdout)
    (face,) = document["summary"]["faces"]
    assert face["sweeps"] == face["bound"] == len(document["sweeps"]) == 1
    assert document["files"] == ["plan.npz", "plan.png"]
    assert face["coverage"] > 0.99
    assert Path("plan.npz").read_bytes() == (finished / "out" / "plan.npz").read_bytes()
    first = Path("plan.png").read_bytes()
    assert first.startswith(b"\x89PNG")
    invoke("select", motions, "-o", "plan.npz", "--picture", "again.png")
    assert Path("again.png").read_bytes() == first
    table = invoke("inspect", "plan.npz").stdout
    assert "at least" in table
    assert "covered_alone_mm2" in table


def test_a_part_that_forbids_every_sweep_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tool is 24 mm of flute and more of shank; another face lies 8 mm above the one to be cut."""
    lid = {
        **SADDLE["faces"][0], "name": "lid",
        "poles": [[[-90, -90, 8.0], [-90, 90, 8.0]], [[90, -90, 8.0], [90, 90, 8.0]]],
    }  # fmt: skip
    monkeypatch.chdir(write_job(tmp_path))
    assert invoke("detect", "job.toml", "-o", "c.npz").exit_code == 0
    assert invoke("optimize", "c.npz", "-o", "m.npz").exit_code == 0
    Path("blade.json").write_text(json.dumps({"faces": [SADDLE["faces"][0], lid]}))
    scene = load_scene(load_job("job.toml"), tmp_path)
    _, sweeps, summary = read_artifact("m.npz", "motions")
    write_artifact("motions", scene, sweeps, summary, "m.npz")
    result = invoke("select", "m.npz", "-o", "plan.npz")
    assert result.exit_code == 1, result.stderr
    assert "too near to face 1" in result.stderr
    assert read_artifact("plan.npz", "plan")[1] == ()
    assert invoke("post", "plan.npz").exit_code == 3


def test_a_stage_refuses_the_file_of_another_stage(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(finished)
    for command, file, named in (
        ("optimize", "plan", "conflank/plan"),
        ("select", "candidates", "conflank/candidates"),
        ("post", "motions", "conflank/motions"),
    ):
        result = invoke(command, f"out/{file}.npz", "-o", "x")
        assert result.exit_code == 3
        assert_one_message(result.stderr, [f"{file}.npz", named])
        assert not Path("x").exists()


def test_debug_shows_where_an_error_came_from(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = invoke("run", "none.toml", "--debug")
    assert result.exit_code == 3
    assert "Traceback" in result.stderr and "load_job" in result.stderr


def test_an_error_of_the_programs_own_is_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down(source: str) -> None:
        raise ZeroDivisionError("a\nb")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("conflank_cli.commands.inputs.read_job", break_down)
    result = invoke("run", "job.toml")
    assert result.exit_code == 4
    assert_one_message(result.stderr, ["ZeroDivisionError: a b", "--debug"])


def test_an_interrupt_while_a_module_is_loaded_is_an_interrupt(monkeypatch: pytest.MonkeyPatch) -> None:
    """The CAD kernel's loader says "initialization failed" then."""

    def break_off(source: str) -> None:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as interrupt:
            raise ImportError("initialization failed") from interrupt

    monkeypatch.setattr("conflank_cli.commands.inputs.read_job", break_off)
    result = invoke("run", "job.toml")
    assert (result.exit_code, result.stderr) == (130, "Interrupted: nothing was written.\n")


def test_without_arguments_there_is_help_and_exit_2() -> None:
    result = invoke()
    assert result.exit_code == 2
    assert "Commands:" in result.stderr


# --- terminals, pipes, signals --------------------------------------------------------------------------------------


def on_terminal(arguments: list[str], cwd: Path, **streams: object) -> tuple[int, str]:
    """Run with the streams set to "terminal" attached to a pseudo-terminal; exit code and what that showed."""
    master, slave = pty.openpty()
    attached = {name: slave if value == "terminal" else value for name, value in streams.items()}
    command = [sys.executable, "-c", "from conflank_cli.cli import main; main()", *arguments]
    process = subprocess.Popen(command, cwd=cwd, **attached)
    os.close(slave)
    shown = b""
    while True:
        try:
            piece = os.read(master, 65536)
        except OSError:
            break
        if not piece:
            break
        shown += piece
    os.close(master)
    return process.wait(timeout=60), shown.decode()


def test_binary_data_does_not_go_to_a_terminal(finished: Path) -> None:
    code, shown = on_terminal(
        ["detect", "job.toml"], finished, stdin=subprocess.DEVNULL, stdout="terminal", stderr="terminal"
    )
    assert code == 2
    assert "terminal" in shown and "-o FILE" in shown
    assert "\x93NUMPY" not in shown


def test_input_from_a_terminal_is_asked_for_not_waited_for(finished: Path) -> None:
    code, shown = on_terminal(["optimize"], finished, stdin="terminal", stdout=subprocess.DEVNULL, stderr="terminal")
    assert code == 2
    assert "No input" in shown


def test_a_terminal_sees_a_bar_for_each_stage(finished: Path) -> None:
    code, shown = on_terminal(
        ["run", "job.toml", "--out", "out"], finished, stdin=subprocess.DEVNULL, stdout="terminal", stderr="terminal"
    )
    assert code == 0
    for stage in ("detect", "optimize", "select", "verify"):
        assert stage in shown
    assert "━" in shown


def test_a_reader_that_leaves_is_no_error_to_speak_of(finished: Path) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-c", "from conflank_cli.cli import main; main()", "inspect", "out/candidates.npz"]
    done = subprocess.run(command, cwd=finished, stdout=writing, stderr=subprocess.PIPE, timeout=60)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, b"")


@pytest.mark.parametrize("as_json", [False, True])
def test_a_terminal_that_knows_few_letters(as_json: bool, finished: Path) -> None:
    """Tables have rules and µ in them; JSON is UTF-8 whatever the terminal."""
    command = [sys.executable, "-m", "conflank_cli", "inspect", "out/plan.npz", *(["--json"] if as_json else [])]
    environment = ENVIRONMENT | {"PYTHONIOENCODING": "latin-1"}
    done = subprocess.run(command, cwd=finished, env=environment, capture_output=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, b"")
    if as_json:
        assert json.loads(done.stdout.decode("utf-8"))["schema"] == "conflank/plan"
    else:
        assert b"area mm\xb2" in done.stdout and b"????" in done.stdout


def test_an_interrupt_is_clean(finished: Path, tmp_path: Path) -> None:
    write_job(tmp_path)
    os.mkfifo(tmp_path / "late.toml")
    # What a shell runs in the background is started to ignore interrupts.
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    program = f"{heed}; from conflank_cli.cli import main; main()"
    command = [sys.executable, "-c", program, "detect", "late.toml", "-o", "x.npz"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE) as process:
        # Opening this end waits until the program has opened the other: from then on it waits for a job.
        late = os.open(tmp_path / "late.toml", os.O_WRONLY)
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
        os.close(late)
    assert process.returncode == 130
    assert errors.strip() == b"Interrupted: nothing was written."
    assert not (tmp_path / "x.npz").exists()
