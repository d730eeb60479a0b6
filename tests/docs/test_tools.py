"""The tool that docs/tools.md defines is one, and its table is the catalogue."""

import re
import tomllib
from math import cos
from pathlib import Path

import pytest

from conflank_cli.job import parse_job
from conflank_cli.tool import CATALOGUE

TEXT = (Path(__file__).parent.parent.parent / "docs" / "tools.md").read_text("utf-8")


def test_the_tool_of_the_example_is_as_it_says() -> None:
    found = re.search(r"```toml\n(.*?)```", TEXT, re.DOTALL)
    assert found
    head = '[part]\nfile = "a.step"\n[[part.design]]\nface = 0\n'
    tool = parse_job((head + found[1]).encode(), "job.toml", Path()).resolved_tools()[0]
    written = tomllib.loads(found[1])["tools"]["define"]["FLANK8"]
    assert (tool.name, tool.number, tool.shank[0].diameter_low) == ("FLANK8", 7, 8.0)
    # r_min = R cos α, as the text gives it for a tool whose ball radius R is known.
    assert tool.ball_radius * cos(tool.half_angle) == pytest.approx(written["r_min"])


def test_the_table_is_the_catalogue() -> None:
    rows = re.findall(r"^\| (T\d) \| ([\d.]+) \| ([\d.]+) \| ([\d.]+) \|$", TEXT, re.MULTILINE)
    assert {name: tuple(map(float, values)) for name, *values in rows} == {
        name: (tool.r_min, tool.r_max, tool.length) for name, tool in CATALOGUE.items()
    }
