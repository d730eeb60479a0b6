"""Artifacts: what is written is read back, equal inputs give equal bytes, and foreign files are refused by name."""

import io
import json
import stat
import zipfile
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from conflank_cli.artifacts.npz import (
    KINDS,
    decode_artifact,
    decode_contents,
    decode_coverage,
    encode_artifact,
    read_artifact,
    read_plan,
    write_artifact,
)
from conflank_cli.ball_pass import Pass
from conflank_cli.coverage import FaceCoverage, Reason
from conflank_cli.errors import InputError, NumericalError, UsageError
from conflank_cli.geometry.face import CheckMesh, DesignFace
from conflank_cli.geometry.surface import BSplineSurface
from conflank_cli.job import parse_job
from conflank_cli.motion import Motion, uniform_knots
from conflank_cli.once import Once
from conflank_cli.scene import Scene
from conflank_cli.sweep import Sweep

JOB = b'[part]\nfile = "a.step"\n[[part.design]]\nface = 0\n[tools]\nuse = ["T1", "T3"]\n'


def flat_face(rational: bool = False, holes: int = 1) -> DesignFace:
    poles = np.stack(np.meshgrid([0.0, 10.0], [0.0, 5.0], [1.0], indexing="ij"), axis=-1).reshape(2, 2, 3)
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    surface = BSplineSurface(1, 1, knots, knots, poles, np.array([[1.0, 2.0], [3.0, 4.0]]) if rational else None)
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    loops = (square, *(0.1 * square[:3] + 0.1 * (k + 1) for k in range(holes)))
    return DesignFace(3, "suction side", surface, loops, -1)


def scene_of(*faces: DesignFace) -> Scene:
    job = parse_job(JOB, "job.toml", Path())
    check = CheckMesh(np.eye(3), np.array([[0, 1, 2]], dtype=np.int32), np.array([-1], dtype=np.int32))
    around = (replace(flat_face(), number=7, sense=-1),)
    return Scene(
        job, "a", faces or (flat_face(),), job.resolved_tools(), Once(lambda: check), {"a.step": "0" * 64},
        rest=(flat_face(),), surfaces=Once(lambda: around),
    )  # fmt: skip


def sweep_of(controls: int, seed: int = 0) -> Sweep:
    points = np.random.default_rng(seed).normal(size=(2, controls, 3))
    return Sweep(0, "T3", Motion(uniform_knots(controls), points[0], points[1]), {"axis_error_mean_um": 0.1 + seed})


def assert_same(one: object, other: object) -> None:
    """Equality through dataclasses and arrays, to the last bit."""
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype and one.shape == other.shape and np.array_equal(one, other)
    elif isinstance(one, Once):
        assert_same(one(), other())
    elif hasattr(one, "__dataclass_fields__"):
        assert type(one) is type(other)
        for name in one.__dataclass_fields__:
            assert_same(getattr(one, name), getattr(other, name))
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    else:
        assert one == other


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_comes_back_as_it_went(tmp_path: Path, kind: str) -> None:
    scene, sweeps = scene_of(flat_face(), flat_face(rational=True, holes=3)), (sweep_of(4), sweep_of(9, 1))
    summary = {"candidates": 7, "by_tool": {"T1": [1, 2.5]}, "fair": True}
    write_artifact(kind, scene, sweeps, summary, tmp_path / "a.npz")
    again = read_artifact(tmp_path / "a.npz", kind)
    assert_same((scene, sweeps, summary), again)


def coverage_of(count: int, seed: int) -> FaceCoverage:
    rng = np.random.default_rng(seed)
    sweep = rng.integers(-1, 2, count)
    reason = np.where(sweep < 0, rng.integers(1, len(Reason), count), int(Reason.COVERED))
    return FaceCoverage(rng.random((count, 2)), rng.random((count, 3)), rng.random(count), sweep, reason)


def test_what_a_plan_covers_comes_back_as_it_went(tmp_path: Path) -> None:
    scene, sweeps = scene_of(flat_face(), flat_face()), (sweep_of(4), sweep_of(9, 1))
    coverage = [coverage_of(30, 1), coverage_of(50, 2)]
    write_artifact("plan", scene, sweeps, {}, tmp_path / "a.npz", coverage=coverage)
    data = (tmp_path / "a.npz").read_bytes()
    for own, again in zip(coverage, decode_coverage(data, "a.npz"), strict=True):
        for name in ("uv", "points", "areas", "sweep", "reason"):
            np.testing.assert_array_equal(getattr(own, name), getattr(again, name))
    assert_same((scene, sweeps, {}), read_artifact(tmp_path / "a.npz", "plan"))
    assert decode_coverage(encode_artifact("plan", scene, sweeps, {}), "b.npz") == ()
    for sweep, reason in ((2, 1), (-1, 99)):
        wrong = [coverage[0], replace(coverage[1], sweep=np.full(50, sweep), reason=np.full(50, reason))]
        with pytest.raises(InputError, match="contradict"):
            decode_coverage(encode_artifact("plan", scene, sweeps, {}, coverage=wrong), "a.npz")


motions = st.integers(4, 12).flatmap(
    lambda n: arrays(np.float64, (2, n, 3), elements=st.floats(-1e6, 1e6)).map(
        lambda points: Motion(uniform_knots(n), points[0].copy(), points[1].copy())
    )
)
sweeps_strategy = st.lists(
    st.builds(
        Sweep,
        st.just(0),
        st.sampled_from(["T1", "T3"]),
        motions,
        st.dictionaries(st.text(max_size=8), st.floats(allow_nan=False, allow_infinity=False), max_size=3),
    ),
    max_size=4,
).map(tuple)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(sweeps_strategy)
def test_any_sweeps_come_back_and_bytes_repeat(sweeps: tuple[Sweep, ...]) -> None:
    scene = scene_of()
    data = encode_artifact("motions", scene, sweeps, {})
    kind, scene_again, again, _ = decode_artifact(data, "a.npz", "motions")
    assert kind == "motions"
    assert_same((scene, sweeps), (scene_again, again))
    assert encode_artifact("motions", scene_again, again, {}) == data


def pass_of(count: int) -> Pass:
    turn = np.linspace(0.0, 0.5, count)
    axis = np.stack([np.sin(turn), np.zeros(count), np.cos(turn)], axis=1)
    return Pass(0, "T1", np.linspace([0.0, 0.0, 1.0], [5.0, 0.0, 1.0], count), axis, {"length_mm": 5.0})


def test_a_plan_keeps_its_passes(tmp_path: Path) -> None:
    passes = (pass_of(2), pass_of(7))
    write_artifact("plan", scene_of(), [sweep_of(5)], {}, tmp_path / "plan.npz", passes=passes)
    again = read_plan(tmp_path / "plan.npz")
    assert_same((again.sweeps, again.passes), ((sweep_of(5),), passes))
    # What only wants the sweeps reads it as before, and a plan of before reads as one without passes.
    assert_same(read_artifact(tmp_path / "plan.npz", "plan")[1], (sweep_of(5),))
    assert decode_contents(PLAN, "plan.npz").passes == ()
    assert "passes" not in json.loads(np.load(io.BytesIO(PLAN))["meta"].tobytes())


@pytest.mark.parametrize("drop", ["pass_tip", "pass_axis", "pass_offsets"])
def test_passes_without_their_arrays_are_refused(drop: str) -> None:
    data = encode_artifact("plan", scene_of(), [], {}, passes=[pass_of(3)])
    with pytest.raises(InputError, match=drop):
        decode_contents(altered(data, drop=drop), "plan.npz")


def test_axes_of_passes_that_are_no_unit_vectors_are_refused() -> None:
    item = pass_of(3)
    long = Pass(item.face, item.tool, item.tip, 2.0 * item.axis)
    with pytest.raises(InputError, match="contradict"):
        decode_contents(encode_artifact("plan", scene_of(), [], {}, passes=[long]), "plan.npz")


def test_numpy_alone_reads_it() -> None:
    """The format promises an NPZ without pickles and a JSON document: no code of this project is needed."""
    data = encode_artifact("plan", scene_of(), [sweep_of(5)], {"coverage": np.float64(0.9)})
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        document = json.loads(archive["meta"].tobytes())
        assert archive["motion_p"].shape == (5, 3)
    assert document["schema"] == "conflank/plan"
    assert document["version"] == 2
    assert document["units"] == {"length": "mm", "angle": "rad"}
    assert document["job"]["tolerance"] == {"overcut": 0.01, "undercut": 0.01, "allowance": 0.0}
    assert document["inputs"] == {"a.step": "0" * 64}
    assert document["summary"] == {"coverage": 0.9}


def altered(data: bytes, change: dict[str, object] | None = None, drop: str = "", add: str = "") -> bytes:
    """An artifact with parts of its document or its arrays changed."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        content = {name: archive[name] for name in archive.files if name != drop}
    document = json.loads(content["meta"].tobytes()) | (change or {})
    content["meta"] = np.frombuffer(json.dumps(document).encode(), dtype=np.uint8)
    if add:
        content[add] = np.zeros(3)
    buffer = io.BytesIO()
    np.savez(buffer, **content)
    return buffer.getvalue()


PLAN = encode_artifact("plan", scene_of(), [sweep_of(5), sweep_of(6)], {})


@pytest.mark.parametrize(
    ("data", "found"),
    [
        (b"", "nothing"),
        (b"ISO-10303-21;", "another type"),
        (PLAN[:400], "truncated"),
        (altered(PLAN, {"schema": "conflank/candidates"}), "'conflank/candidates'"),
        (altered(PLAN, {"schema": "other/plan"}), "'other/plan'"),
        (altered(PLAN, {"version": 1}), "version 1"),
        (altered(PLAN, {"units": {"length": "inch", "angle": "rad"}}), "inch"),
        (altered(PLAN, {"novelty": 1}), "novelty"),
        (altered(PLAN, {"job": {}}), "part"),
        (altered(PLAN, {"sweeps": []}), "motion_offsets"),
        (altered(PLAN, {"sweeps": [{"face": 1, "tool": "T1", "facts": {}}] * 2}), "contradict"),
        (altered(PLAN, {"sweeps": [{"face": 0, "tool": "T2", "facts": {}}] * 2}), "contradict"),
        (altered(PLAN, drop="motion_q"), "no array 'motion_q'"),
        (altered(PLAN, drop="around0_poles"), "no array 'around0_poles'"),
        (altered(PLAN, drop="rest0_loops"), "no array 'rest0_loops'"),
        (altered(PLAN, add="motion_r"), "unknown array 'motion_r'"),
    ],
)
def test_what_is_no_plan_is_refused_by_name(data: bytes, found: str) -> None:
    with pytest.raises(InputError) as refusal:
        decode_artifact(data, "plan.npz", "plan")
    assert refusal.value.where == "plan.npz"
    assert found in refusal.value.found
    assert refusal.value.next_step


@settings(max_examples=60, deadline=None)
@given(st.integers(0, len(PLAN) - 1), st.integers(1, 255))
def test_a_flipped_byte_is_refused_or_harmless(position: int, flip: int) -> None:
    """The zip's own checksums guard the arrays; nothing but an InputError may come out."""
    damaged = bytearray(PLAN)
    damaged[position] ^= flip
    try:
        decode_artifact(bytes(damaged), "plan.npz", "plan")
    except InputError as refusal:
        assert refusal.where == "plan.npz"


def test_pickles_are_not_loaded() -> None:
    buffer = io.BytesIO()
    np.savez(buffer, meta=np.array([{"schema": "conflank/plan"}], dtype=object))
    with pytest.raises(InputError, match="pickle"):
        decode_artifact(buffer.getvalue(), "plan.npz", "plan")


def test_not_a_number_is_not_written(tmp_path: Path) -> None:
    bad = replace(sweep_of(4), facts={"axis_error_mean_um": float("nan")})
    for sweeps, summary in (([bad], {}), ([], {"deep": [{"x": float("inf")}]})):
        with pytest.raises(NumericalError):
            write_artifact("plan", scene_of(), sweeps, summary, tmp_path / "a.npz")
    assert list(tmp_path.iterdir()) == []


def test_an_input_is_never_replaced(tmp_path: Path) -> None:
    source = tmp_path / "motions.npz"
    source.write_bytes(b"precious")
    link = tmp_path / "link.npz"
    link.symlink_to(source)
    with pytest.raises(UsageError, match="inputs"):
        write_artifact("plan", scene_of(), [], {}, link, inputs=[source])
    assert source.read_bytes() == b"precious"


def test_an_existing_output_is_replaced_whole(tmp_path: Path) -> None:
    out = tmp_path / "plan.npz"
    out.write_bytes(b"old")
    write_artifact("plan", scene_of(), [sweep_of(5), sweep_of(6)], {}, out)
    assert out.read_bytes() == PLAN
    assert [path.name for path in tmp_path.iterdir()] == ["plan.npz"]
    assert stat.S_IMODE(out.stat().st_mode) & 0o400


def test_the_zip_holds_no_date_of_today() -> None:
    with zipfile.ZipFile(io.BytesIO(PLAN)) as archive:
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_the_job_inside_is_the_whole_job() -> None:
    _, scene, _, _ = decode_artifact(PLAN, "plan.npz")
    assert msgspec.to_builtins(scene.job) == msgspec.to_builtins(scene_of().job)
