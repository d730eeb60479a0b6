"""The speed benchmark measures what it says: nets of one face, exponents, parts of a job, memory of a process."""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from OCP.Geom import Geom_BSplineSurface
from OCP.gp import gp_Pnt

from benchmarks import footpoints
from benchmarks.growth import fitted_exponent
from benchmarks.occ import occ_surface
from benchmarks.process import ran
from benchmarks.speed import BOTH_SIDES, InThisThread, parts_of, together
from benchmarks.speed_stages import NETS, STAGES, Load, grown, net, one_core
from benchmarks.speed_tables import PARTS_OF_JOB, asked_rows, rounded
from benchmarks.verdicts import Verdict
from conflank_cli import cores
from conflank_cli.job import parse_job
from conflank_cli.options import Talk
from conflank_cli.progress import SilentProgress


def _by_occ(surface: Geom_BSplineSurface, u: float, v: float) -> np.ndarray:
    point = gp_Pnt()
    surface.D0(u, v, point)
    return np.array([point.X(), point.Y(), point.Z()])


@pytest.mark.parametrize("shape", NETS)
def test_nets_are_one_face_for_open_cascade(shape: tuple[int, int]) -> None:
    surface = net(*shape)
    assert surface.poles.shape == (*shape, 3)
    assert surface.domain == (0.0, 1.0, 0.0, 1.0)
    plain, finer = occ_surface(net(4, 4)), occ_surface(surface)
    for u, v in np.random.default_rng(3).random((50, 2)).tolist():
        # mm, on coordinates of up to 60 mm
        assert np.allclose(_by_occ(plain, u, v), _by_occ(finer, u, v), rtol=0.0, atol=1e-12)


def test_exponent_is_the_slope_in_logarithms() -> None:
    sizes = np.array([3.0, 10.0, 70.0, 200.0])
    assert fitted_exponent(sizes.tolist(), (0.02 * sizes**1.3).tolist()) == pytest.approx(1.3, abs=1e-12)


def test_parts_of_a_job_are_read_from_what_run_says(capsys: pytest.CaptureFixture[str]) -> None:
    talk = Talk(quiet=False, verbose=True, progress=SilentProgress())
    for name in PARTS_OF_JOB[1:-1]:
        with talk.timed(name):
            time.sleep(0.01)
    said = capsys.readouterr().err
    found = parts_of(said + "gap           2.1 µm in the mean\nfindings: none\ncomputed in   1.5 s\n", 1.9)
    assert set(found) == set(PARTS_OF_JOB)
    assert found["start"] == pytest.approx(0.4)
    assert all(0.01 <= found[name] < 1.0 for name in PARTS_OF_JOB[1:-1])
    assert sum(found.values()) == pytest.approx(1.9)


def test_a_job_that_does_not_say_its_time_is_refused() -> None:
    with pytest.raises(ValueError, match="computed in"):
        parts_of("detect: 1.00 s\n", 2.0)


def test_memory_of_a_process_is_its_own() -> None:
    """Not that of the process which starts it."""
    held = np.ones(40_000_000)
    small = ran([sys.executable, "-c", "print('said')"])
    large = ran([sys.executable, "-c", "import sys; held = bytes([1]) * 150_000_000; sys.exit(7)"])
    assert held.nbytes == 320_000_000
    assert (small.code, small.output) == (0, "said\n")
    assert small.memory < 100.0
    assert large.code == 7
    assert 150.0 < large.memory < 250.0
    assert 0.0 < small.cpu < small.wall + 0.1


def test_a_profile_sees_all_work() -> None:
    seen = []
    with patch.object(cores, "ThreadPoolExecutor", lambda count: InThisThread()):
        with cores.threads() as pool:
            assert list(pool.map(lambda k: (seen.append(threading.current_thread()), k)[1], range(3))) == [0, 1, 2]
        with pytest.raises(ZeroDivisionError), cores.threads() as pool:
            list(pool.map(lambda k: 1 // k, [0]))
    assert set(seen) == {threading.current_thread()}


def test_one_core_is_one_and_given_back() -> None:
    before = cores.cores()
    with one_core():
        assert cores.cores() == 1
    assert cores.cores() == before


def test_growth_is_timed_in_the_order_of_its_sizes() -> None:
    sizes, seconds = grown(Load(size, 1, lambda size=size: sum(range(10_000 * size))) for size in (1, 30))  # type: ignore[misc]
    assert sizes == [1, 30]
    assert 0.0 < seconds[0] < seconds[1]


def test_every_way_to_find_footpoints_finds_them() -> None:
    rows = footpoints.measure(count=2000, repeats=1)
    assert len(rows) == 5
    for row in rows:
        assert row.per_second > 0.0
        assert row.foot_error <= footpoints.REQUIRED_ACCURACY, row.name
        assert row.distance_error <= footpoints.REQUIRED_ACCURACY, row.name


def test_job_of_both_sides_has_two_faces_and_three_tools() -> None:
    job = parse_job(BOTH_SIDES.encode(), "both.toml", Path())
    assert [design.face for design in job.part.design] == ["pressure", "suction"]
    assert job.tools.use == ("T1", "T2", "T3")


def test_figures_of_other_parts_are_kept(tmp_path: Path) -> None:
    file = tmp_path / "speed.json"
    before = together(None, {"posting": {"units": 1}, "jobs": [1]}, [Verdict("slope", "<= 1", "1.2", False)])
    file.write_text(json.dumps(before), encoding="utf-8")
    verdicts = [Verdict("slope", "<= 1", "0.9", True), Verdict("wall", "", "1", True)]
    found = together(file, {"posting": {"units": 2}, "footpoints": {"units": 3}}, verdicts)
    assert found["jobs"] == [1]
    assert found["stages"] == {"footpoints": {"units": 3}, "posting": {"units": 2}}
    assert list(found["stages"]) == [name for name in STAGES if name in found["stages"]]
    assert found["verdicts"] == {"slope": ["0.9", True], "wall": ["1", True]}
    assert asked_rows(found)[1] == [["slope", "<= 1", "0.9", "reached"]]


def test_large_numbers_are_short() -> None:
    assert [rounded(value) for value in (0.5, 42.0, 800.0, 9800.0, 12_345.0, 4.12e6)] == [
        "0.50",
        "42.0",
        "800",
        "9800",
        "12.3 k",
        "4.12 M",
    ]
