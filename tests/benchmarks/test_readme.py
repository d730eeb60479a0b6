"""The tables in README and docs are those that the committed results make."""

import re

import pytest

from benchmarks.readme import BLOCKS, FILES, REPOSITORY, RESULTS, filled, markdown, result
from docs.tour import COMMANDS


@pytest.mark.parametrize("name", FILES)
def test_blocks_are_what_the_results_make(name: str) -> None:
    text = (REPOSITORY / name).read_text("utf-8")
    assert "<!-- figures:" in text
    assert filled(text, name) == text, f"{name}: run python -m benchmarks.readme (or make samples)"


def test_every_block_is_used_somewhere() -> None:
    texts = "".join((REPOSITORY / name).read_text("utf-8") for name in FILES)
    assert set(re.findall(r"<!-- figures:([\w-]+) -->", texts)) == set(BLOCKS)


def test_every_block_says_what_the_results_say() -> None:
    """A change of a figure in the results changes the block."""
    verification = result("BLISK1.H.verification.json")
    assert f"{100 * verification['coverage']:.1f} %" in BLOCKS["sample"]()
    assert all(row["case"] in BLOCKS["bench"]() for row in result("bench.json")["rows"])


def test_bad_markers_are_refused() -> None:
    with pytest.raises(ValueError, match="no figures called nothing"):
        filled("<!-- figures:nothing -->\n<!-- /figures:nothing -->", "here")
    with pytest.raises(ValueError, match="without its other half"):
        filled("<!-- figures:sample -->\n", "here")


def test_table_aligns_numbers_right() -> None:
    assert markdown(["<a", "b"], [["x", "1"]]) == "| a | b |\n| :-- | --: |\n| x | 1 |\n"


def test_results_do_not_tell_when_or_where() -> None:
    for path in RESULTS.glob("*.json"):
        text = path.read_text("utf-8")
        assert str(REPOSITORY) not in text, path.name
        assert not re.search(r"20\d\d-\d\d-\d\d|/home/|/tmp/|/root/", text), path.name


def test_the_tour_shows_every_command_with_the_right_exit_code() -> None:
    said = result("tour.json")
    assert list(said) == [command.block for command in COMMANDS]
    for command in COMMANDS:
        assert said[command.block]["typed"] == command.typed
        assert said[command.block]["code"] == command.code


def test_pictures_are_there_and_modest() -> None:
    shown = set()
    for name in FILES:
        folder = (REPOSITORY / name).parent
        text = (REPOSITORY / name).read_text("utf-8")
        shown |= {(folder / place).resolve() for place in re.findall(r"!\[[^\]]*\]\(([^)]+\.png)\)", text)}
    assert shown == set((REPOSITORY / "docs" / "pictures").glob("*.png"))
    assert all(path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n" for path in shown)
    assert max(path.stat().st_size for path in shown) <= 250_000
