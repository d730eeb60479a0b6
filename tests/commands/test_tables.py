"""Tables on terminals of any width."""

import os
import re

import pytest

from conflank_cli.commands.tables import text_table

COLUMNS = ["sweep", "<tool", "certified_area_mm2", "covered mm²", "gap mean µm", "size mm", "<why"]
ROWS = [
    (1, "T1", 610.264, 361.9, -7.881, "16.70 x 60.00 x 0.00", "not needed for the coverage asked for"),
    (12, "[/b]", None, 1147.25, 0.5, "3.00 x 2.00 x 1.00", "collision"),
]
FIGURES = {"610.26", "361.90", "-7.88", "16.70 x 60.00 x 0.00", "1147.25", "0.50", "3.00 x 2.00 x 1.00", "[/b]", "12"}


@pytest.mark.parametrize("width", [40, 60, 80, 120, 200])
def test_no_figure_is_cut_short_at_any_width(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setattr("shutil.get_terminal_size", lambda: os.terminal_size((width, 24)))
    text = text_table(COLUMNS, ROWS)
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width
    for figure in FIGURES:
        assert re.search(rf"(?:^|\s){re.escape(figure)}(?:\s|$)", text, re.MULTILINE), figure
    for word in ("certified_area_mm2", "collision", "coverage"):
        assert word in text
    # Every part says which sweep its rows are of.
    parts = text.rstrip("\n").split("\n\n")
    assert all(any(line.lstrip().startswith("12 ") for line in part.splitlines()) for part in parts)


def test_where_nobody_looks_there_is_one_table() -> None:
    text = text_table(COLUMNS, ROWS)
    assert "\n\n" not in text and len(text.splitlines()) == 2 + len(ROWS)
