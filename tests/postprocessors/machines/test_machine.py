import pytest

from postprocessors.errors import PostError
from postprocessors.machines import machine as machines
from postprocessors.machines.machine import (
    load_machine,
    parse_machine,
    read_machine_file,
    shipped_machines,
    unknown_keys,
)

READY = [name for name in shipped_machines() if not unknown_keys(*read_machine_file(name))]


def text_of_example() -> str:
    from pathlib import Path

    return (Path(machines.__file__).parent / "ac-table.toml").read_text("utf-8")


def test_every_shipped_machine_loads_and_claims_nothing() -> None:
    assert "ac-table" in shipped_machines()
    for name in READY:
        machine = load_machine(name)
        assert machine.name == name
        assert machine.verified is False


def test_what_comes_along_has_every_kind_of_machine() -> None:
    kinds = {tuple(axis.carried_by for axis in load_machine(name).rotary) for name in READY}
    assert kinds == {("table", "table"), ("table", "head"), ("head", "head")}
    first = [load_machine(name).rotary[1].vector for name in READY]
    assert (1.0, 0.0, 0.0) in first and (0.0, 1.0, 0.0) in first and (0.0, 1.0, 1.0) in first


def test_a_template_is_refused_with_every_key_that_is_open() -> None:
    assert set(shipped_machines()) - set(READY) == {"kondia_hs1000"}
    with pytest.raises(PostError) as caught:
        load_machine("kondia_hs1000")
    content, _ = read_machine_file("kondia_hs1000")
    assert content.count('= "?"') == 34
    assert caught.value.found.startswith("34 values still to be filled in: ")
    for key in ("linear.x.travel_mm", "rotary[0].vector", "rotary[1].max_jerk_deg_s3", "block_time_ms"):
        assert key in caught.value.found


def test_a_filled_in_template_is_a_machine() -> None:
    content, _ = read_machine_file("kondia_hs1000")
    values = {"letter": '"B"', "vector": "[0.0, 1.0, 0.0]", "carried_by": '"table"', "sign": "1",
              "pivot_mm": "[0.0, 0.0, 0.0]", "range_deg": "[-100.0, 100.0]", "output": '"continuous"',
              "travel_mm": "[0.0, 900.0]"}  # fmt: skip
    lines = []
    for line in content.splitlines():
        key = line.partition(" = ")[0]
        lines.append(f"{key} = {values.get(key, '100.0')}" if line.endswith('"?"') else line)
    text = "\n".join(lines).replace(
        'letter = "B"\nvector = [0.0, 1.0, 0.0]', 'letter = "C"\nvector = [0.0, 0.0, 1.0]', 1
    )
    assert parse_machine(text, "kondia").linear.z.travel_mm == (0.0, 900.0)
    with pytest.raises(PostError, match=r"found 1 values.*linear\.y\.travel_mm"):
        parse_machine(text.replace("[0.0, 900.0]", '[0.0, "?"]').replace('[0.0, "?"]', "[0.0, 9.0]", 1)
                      .replace('[0.0, "?"]', "[0.0, 9.0]").replace("[linear.y]\ntravel_mm = [0.0, 9.0]",
                      '[linear.y]\ntravel_mm = [0.0, "?"]'), "kondia")  # fmt: skip


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
        ("travel_mm = [-100.0, 500.0]", "travel_mm = [500.0, 500.0]", "linear.z.travel_mm", "500"),
        ("travel_mm = [-100.0, 500.0]", "travel_mm = [-inf, 500.0]", "linear.z.travel_mm", "inf"),
        ("[linear.y]", "[linear.v]", "linear", "'v'"),
        ("max_jerk_mm_s3 = 60000.0", "max_jerk_mm_s3 = 0.0", "linear.x.max_jerk_mm_s3", "0.0"),
        ("max_acceleration_deg_s2 = 500.0", "", "rotary[1]", "max_acceleration_deg_s2"),
        ("range_deg = [-120.0, 30.0]", "range_deg = [-inf, 30.0]", "rotary A range_deg", "inf"),
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
    with pytest.raises(PostError, match="one of ac-table, bc-table"):
        load_machine("hs9000")
    with pytest.raises(PostError, match="no readable file"):
        load_machine(tmp_path / "none.toml")
