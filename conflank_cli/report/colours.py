"""Colours that mean the same in every picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

from conflank_cli.coverage import Reason

if TYPE_CHECKING:
    from matplotlib.colors import Colormap

GAP = (
    (0.0, "#b2182b"),
    (0.25, "#f4a261"),
    (0.42, "#cfe39a"),
    (0.5, "#3fa34d"),
    (0.58, "#a6dcb5"),
    (0.75, "#6fb1d8"),
    (1.0, "#1f4e9c"),
)
"""The gap from the overcut that is allowed (0) over none (0.5) to the stock that is allowed (1). Overcut scraps the
part, so it is red; stock is blue; what is right is green."""

OVERCUT = "#67001f"
"""Deeper than allowed."""

LEFT = "#8d8f93"
"""More stock left than allowed."""

CUTS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#e69f00", "#009e73", "#882255", "#999933")
"""Sweeps and passes, in turn."""

GREYS = {
    Reason.NOT_CHOSEN: "#f2f2f2",
    Reason.SMALL: "#dedede",
    Reason.OVERCUT: "#c9b3b3",
    Reason.COLLISION: "#8c4a4a",
    Reason.MACHINE: "#5a5a8c",
    Reason.NO_SWEEP: "#9a9a9a",
    Reason.NO_LINE: "#2b2b2b",
}
"""Why something is left, from what a longer plan would cover to what no line fits."""

COVERED = "#8fcf9b"
"""What is not left."""

REACH = ("#fde725", "#5ec962", "#21918c", "#3b528b", "#440154")
"""The least axis error from none to twice the tolerance."""


def cut_colour(index: int) -> str:
    """Colour of a cut, counted from 0 in the program's order."""
    return CUTS[index % len(CUTS)]


def gap_colours() -> Colormap:
    """The scale of the gap for matplotlib, with the colours beyond it."""
    from matplotlib.colors import LinearSegmentedColormap

    scale = LinearSegmentedColormap.from_list("gap", list(GAP))
    return scale.with_extremes(under=OVERCUT, over=LEFT)
