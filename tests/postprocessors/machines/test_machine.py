import pytest

from postprocessors.errors import PostError
from postprocessors.machines import machine as machines
from postprocessors.machines.machine import load_machine, parse_machine, shipped_machines


def text_of_example() -> str:
    from pathlib import Path

    return (Path(machines.__file__).parent / "ac-table.toml").read_text("utf-8")


def test_every_shipped_machine_loads_and_claims_nothing() -> None:
    assert "ac-table" in shipped_machines()
    for name in shipped_machines():
        machine = load_machine(name)
        assert machine.name == name
        assert machine.verified is False


def test_a_file_loads_like_a_shipped_machine(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text_of_example(), "utf-8")
    assert load_machine(path) == load_machine(str(path)) == load_machine("ac-table")


@pytest.mark.parametrize(
    ("old", "new", "where", "found"),
    [
        ('name = "ac-table"', 'name = "ac-table"\ncolour = "red"', "m.toml", "colour"),
        ("block_time_ms = 3.6", "block_time_ms = 0.0", "block_time_ms", "0.0"),
        ("block_time_ms = 3.6", "", "m.toml", "block_time_ms"),
        ("max_feed_mm_min = 10000.0", "max_feed_mm_min = inf", "max_feed_mm_min", "inf"),
        ("vector = [1.0, 0.0, 0.0]", "vector = [0.0, 0.0, 2.0]", "rotary", "two parallel axes"),
        ("vector = [1.0, 0.0, 0.0]", "vector = [0.0, 0.0, 0.0]", "rotary A vector", "[0.0, 0.0, 0.0]"),
        ("vector = [1.0, 0.0, 0.0]", "vector = [nan, 0.0, 0.0]", "rotary A vector", "nan"),
        ("range_deg = [-120.0, 30.0]", "range_deg = [30.0, -120.0]", "rotary A range_deg", "[30.0, -120.0]"),
        ('letter = "A"', 'letter = "C"', "rotary", "two axes C"),
        ('letter = "A"', 'letter = "X"', "rotary[1].letter", "X"),
        ('retract = "M140"', 'retract = "M91"', "retract", "M91"),
        ("z = [-100.0, 500.0]", "z = [500.0, 500.0]", "travel_mm.z", "500"),
        ('name = "ac-table"', 'name = "two words"', "name", "two words"),
        ('name = "ac-table"', "name = ", "m.toml", "line 2"),
    ],
)
def test_a_wrong_file_is_refused_by_place(old: str, new: str, where: str, found: str) -> None:
    text = text_of_example()
    assert old in text
    with pytest.raises(PostError) as caught:
        parse_machine(text.replace(old, new), "m.toml")
    assert where in caught.value.where
    assert found in caught.value.found


def test_one_rotary_axis_is_no_five_axis_machine() -> None:
    text = text_of_example()
    with pytest.raises(PostError, match="length 2"):
        parse_machine(text[: text.rindex("[[rotary]]")], "m.toml")


def test_modulo_words_need_an_endless_axis() -> None:
    text = text_of_example().replace('output = "continuous"', 'output = "modulo"')
    with pytest.raises(PostError, match="endless axis"):
        parse_machine(text, "m.toml")


def test_table_comes_before_head() -> None:
    text = text_of_example().replace('carried_by = "table"', 'carried_by = "head"', 1)
    with pytest.raises(PostError, match="table axis before the head axis"):
        parse_machine(text, "m.toml")


def test_unknown_names_and_missing_files_say_what_to_do(tmp_path) -> None:
    with pytest.raises(PostError, match="one of ac-table"):
        load_machine("hs9000")
    with pytest.raises(PostError, match="no readable file"):
        load_machine(tmp_path / "none.toml")
