"""The sample parts' Makefile, as GNU make understands it."""

import subprocess

import pytest
from make_parts import HERE


def _planned(*targets):
    command = ["make", "--no-print-directory", "-n", "-B", "CONFLANK=conflank", "PYTHON=python3", *targets]
    return subprocess.run(command, cwd=HERE, capture_output=True, text=True, check=True).stdout.splitlines()


@pytest.mark.parametrize("job", ["blisk_blade/job", "blisk_blade/pressure", "blisk_blade/suction", "impeller/job"])
def test_each_program_has_one_rule_a_stage(job):
    part, name = job.split("/")
    folder = f"{part}/out/{name}"
    plan = [line for line in _planned(f"{folder}/PROGRAM.H.verification.json") if line.startswith("conflank")]
    assert [line.split()[1] for line in plan] == ["detect", "optimize", "select", "post", "verify"]
    assert plan[0] == f"conflank detect {job}.toml -o {folder}/candidates.npz"
    assert f"conflank verify {folder}/PROGRAM.H --job {job}.toml" in plan[4]


def test_parts_are_made_by_the_script():
    assert _planned("parts") == ["python3 make_parts.py blisk_blade", "python3 make_parts.py impeller"]
