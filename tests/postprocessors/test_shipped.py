"""Machines and profiles that are asked for by a name or key that is not quite right."""

import pytest

from postprocessors.dnc.profile import load_profile
from postprocessors.errors import PostError
from postprocessors.machines.machine import load_machine, parse_machine, read_machine_file


def test_the_nearest_name_and_key_are_suggested() -> None:
    with pytest.raises(PostError) as machine:
        load_machine("acc-table")
    with pytest.raises(PostError) as profile:
        load_profile("itnc530-blockwize")
    with pytest.raises(PostError) as key:
        load_profile("itnc530-standard", {"bauds": "9600"})
    content, _ = read_machine_file("ac-table")
    with pytest.raises(PostError) as misspelt:
        parse_machine(content.replace("travel_mm", "travels_mm", 1), "mine.toml")
    suggested = [caught.value.next_step for caught in (machine, profile, key, misspelt)]
    assert suggested == [f"Did you mean {name!r}?" for name in ("ac-table", "itnc530-blockwise", "baud", "travel_mm")]
    with pytest.raises(PostError) as unlike:
        load_profile("itnc530-standard", {"zzz": "1"})
    assert unlike.value.next_step == "Compare with docs/dnc.md."
