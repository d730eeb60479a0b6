"""`conflank machines`: what it lists, and what it says of a file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from conflank_cli.cli import cli
from postprocessors.errors import PostError
from postprocessors.machines.machine import read_machine_file, shipped_machines

HELP = Path(__file__).parent.parent / "help"


def invoke(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["machines", *arguments], standalone_mode=True)


def test_the_list_has_every_machine_and_tells_which_can_be_posted_for() -> None:
    result = invoke()
    assert result.exit_code == 0
    for name in shipped_machines():
        assert sum(line.split()[0] == name for line in result.stdout.splitlines()[2:]) == 1
    listed = {item["name"]: item for item in json.loads(invoke("--json").stdout)["machines"]}
    assert set(listed) == set(shipped_machines())
    assert listed["kondia_hs1000"]["unknown"] and not listed["ac-table"]["unknown"]
    assert listed["head-table"]["axes"] == ["C table", "B head"]
    assert not any(item["verified"] for item in listed.values())


def test_a_sound_machine_is_described() -> None:
    result = invoke("check", "nutating-head")
    assert result.exit_code == 0
    assert "B -180 .. 180 deg" in result.stdout and "tilt_deg        90" in result.stdout
    assert json.loads(invoke("check", "bc-table", "--json").stdout)["tilt_deg"] == 110


def test_open_values_are_listed_and_exit_1() -> None:
    result = invoke("check", "kondia_hs1000")
    assert result.exit_code == 1
    assert "rotary[1].range_deg" in result.stdout and "34 values" in result.stderr
    assert len(json.loads(invoke("check", "kondia_hs1000", "--json").stdout)["unknown"]) == 34


def test_a_wrong_file_is_one_message_and_exit_3(tmp_path: Path) -> None:
    content, _ = read_machine_file("ac-table")
    path = tmp_path / "mine.toml"
    path.write_text(content.replace("vector = [1.0, 0.0, 0.0]", "vector = [0.0, 0.0, 1.0]"), "utf-8")
    result = invoke("check", str(path))
    assert result.exit_code == 3
    assert result.stdout == ""
    assert result.stderr.startswith("error: mine.toml: rotary\n  found     two parallel axes\n")
    assert invoke("check", "none-such").exit_code == 3


def test_no_program_is_posted_for_a_template() -> None:
    from conflank_cli.job import parse_job
    from conflank_cli.machine_frame import machine_of

    text = (
        '[part]\nfile = "a.step"\n[[part.design]]\nface = 0\n[tools]\nuse = ["T1"]\n[machine]\nname = "kondia_hs1000"\n'
    )
    with pytest.raises(PostError, match=r"34 values still to be filled in: max_feed_mm_min, block_time_ms, linear\.x"):
        machine_of(parse_job(text.encode(), "job.toml", Path()))
