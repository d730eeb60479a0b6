"""What another process reads against what is read here, and how that process ends."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCone

from conflank_cli.cad.inspection import describe
from conflank_cli.cad.kernel_process import KernelProcess, Tried, Wanted
from conflank_cli.cad.mesh import mesh_faces
from conflank_cli.cad.part import Part
from conflank_cli.cad.reader import read_part
from conflank_cli.cad.scene import load_scene
from conflank_cli.cad.triangulation import DEFLECTION_MM
from conflank_cli.errors import InputError
from conflank_cli.job import load_job
from tests.cad import shapes

BLADE = Path(__file__).parent.parent.parent / "sample_parts" / "blisk_blade"


@pytest.fixture
def without_kernel(monkeypatch):
    """As in a command, which has not loaded the kernel."""
    monkeypatch.delitem(sys.modules, "OCP")


@pytest.fixture
def started(monkeypatch):
    """The processes that are started."""
    processes = []
    popen = subprocess.Popen

    def start(*arguments, **options):
        processes.append(popen(*arguments, **options))
        return processes[-1]

    monkeypatch.setattr(subprocess, "Popen", start)
    return processes


def _same(one, other):
    assert np.array_equal(one.surface.poles, other.surface.poles)
    assert np.array_equal(one.surface.knots_u, other.surface.knots_u)
    assert len(one.loops) == len(other.loops)
    assert all(np.array_equal(a, b) for a, b in zip(one.loops, other.loops, strict=True))


def test_a_scene_is_the_same_wherever_its_part_is_read(without_kernel, started):
    job = load_job(BLADE / "pressure.toml")
    with KernelProcess() as kernel:
        wanted = Wanted(BLADE / job.part.file, job.part.scale, [d.face for d in job.part.design], job.part.check_faces)
        there = load_scene(job, BLADE, kernel.read(wanted))
        assert len(there.check.triangles) > 10_000
        assert len(there.neighbours) > 20
        assert "OCP" not in sys.modules
    (process,) = started
    assert process.returncode is not None
    here = load_scene(job, BLADE)
    for one, other in zip((*there.faces, *there.neighbours), (*here.faces, *here.neighbours), strict=True):
        _same(one, other)
    assert len(here.check.triangles) > 10_000
    assert np.array_equal(there.check.vertices, here.check.vertices)
    assert np.array_equal(there.check.triangles, here.check.triangles)
    assert np.array_equal(there.check.face, here.check.face)
    assert there.inputs == here.inputs


def test_all_faces_are_described_the_same(without_kernel, tmp_path):
    path = shapes.write_step(BRepPrimAPI_MakeCone(6.0, 2.0, 20.0).Shape(), tmp_path / "cone.step")
    with KernelProcess() as kernel:
        there = describe(kernel.read(Wanted(path, 2.0))())
    assert there == describe(read_part(path, 2.0))
    assert len(there) == 3


@pytest.mark.parametrize("content", [None, "", "ISO-10303-21;\nHEADER;\n"], ids=["missing", "empty", "cut short"])
def test_errors_are_those_of_reading_here(content, without_kernel, tmp_path):
    path = tmp_path / "part.step"
    if content is not None:
        path.write_text(content)
    with KernelProcess() as kernel, pytest.raises(InputError) as there:
        kernel.read(Wanted(path))()
    with pytest.raises(InputError) as here:
        read_part(path)
    assert there.value.args == here.value.args
    # --debug prints where it comes from.
    assert any("reader.py" in note for note in there.value.__notes__)


def test_a_face_that_does_not_exist_is_said_where_it_is_asked_for(without_kernel, tmp_path):
    path = shapes.write_brep(BRepPrimAPI_MakeBox(1.0, 2.0, 3.0).Shape(), tmp_path / "box.brep")
    with KernelProcess() as kernel:
        part = kernel.read(Wanted(path, 1.0, [0], [77]))()
    _same(part.faces[0].load(), read_part(path).faces[0].load())
    with pytest.raises(InputError, match="face number 77"):
        part.to_check([0], [77])


def test_a_file_that_ends_the_process_is_a_bad_file(without_kernel, monkeypatch, tmp_path):
    crash = tmp_path / "python"
    crash.write_text("#!/bin/sh\nkill -SEGV $$\n")
    crash.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(crash))
    with KernelProcess() as kernel, pytest.raises(InputError) as caught:
        kernel.read(Wanted(tmp_path / "part.step"))()
    assert caught.value.where == "part.step"
    assert "SIGSEGV" in caught.value.found


def test_a_process_that_breaks_down_over_triangles_leaves_the_faces(without_kernel, monkeypatch, tmp_path):
    faces = Part("part", "part.step", (), "", 1.0)
    (tmp_path / "faces").write_bytes(pickle.dumps(Tried((faces, ((7,), DEFLECTION_MM)))))
    crash = tmp_path / "python"
    crash.write_text(f"#!/bin/sh\ncat {tmp_path}/faces\nkill -SEGV $$\n")
    crash.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(crash))
    with KernelProcess() as kernel:
        part = kernel.read(Wanted(tmp_path / "part.step", check=[7]))()
        assert part.faces == ()
        for _ in range(2):
            with pytest.raises(InputError, match=r"breaks down \(SIGSEGV\)"):
                part.triangulate([7], DEFLECTION_MM)


def test_where_no_process_can_be_started_the_file_is_read_here(without_kernel, monkeypatch, tmp_path):
    path = shapes.write_step(BRepPrimAPI_MakeBox(1.0, 2.0, 3.0).Shape(), tmp_path / "box.step")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "nowhere"))
    with KernelProcess() as kernel:
        part = kernel.read(Wanted(path))()
    assert len(mesh_faces(part, part.faces, DEFLECTION_MM).triangles) == 12


def test_a_process_that_nobody_asks_ends_with_the_context(without_kernel, started, tmp_path):
    # JSON has no use for the kernel.
    with KernelProcess() as kernel, pytest.raises(InputError, match="no readable file"):
        kernel.read(Wanted(tmp_path / "part.json"))()
    (process,) = started
    assert process.returncode is not None


def test_ctrl_c_ends_both_processes(tmp_path):
    """A pipe in the file's place keeps the process waiting for ever; it holds on to standard error while it lives."""
    path = tmp_path / "part.step"
    os.mkfifo(path)
    # What a shell runs in the background is started to ignore interrupts.
    heed = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    command = [sys.executable, "-c", f"{heed}; from conflank_cli.cli import main; main()", "inspect", str(path)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    with path.open("wb"):
        os.killpg(process.pid, signal.SIGINT)
        _, said = process.communicate(timeout=30)
    assert (process.returncode, said.strip()) == (130, "Interrupted: nothing was written.")
