"""The choice: of the sweeps over a face those that cover what is asked with the fewest cuts or in the least time.

First the greedy cover of the paper, from several first choices; then the exact cover, of which the greedy one is the
upper bound. Among covers with as few sweeps the one is taken that covers more, cuts more accurately, needs fewer tools
and directions, and overlaps less (`ties`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from conflank_cli.cover import LEAST_AREA, fewest_cover, greedy_cover, mean_errors, share_covered
from conflank_cli.geometry.gap import travel
from conflank_cli.job import Job
from conflank_cli.selection.exact import Price, cheapened, exact_cover, widened
from conflank_cli.sweep import Sweep
from conflank_cli.tool import Tool

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# A sweep that adds less than this share of what all of them together cover is not worth its time.
LEAST_GAIN = 0.005
# Limit of branch-and-bound nodes. Most faces are proven with fewer; it is there for the few that would take minutes.
NODES = 100
# What decides between covers of equally many sweeps, in shares of the area that it is worth: one tool less, one
# direction less, a mean |g| that is smaller by the whole tolerance, overlap.
TOOL_WORTH, DIRECTION_WORTH, ERROR_WORTH, OVERLAP_WORTH = 0.03, 0.01, 0.2, 0.1
# So much of the area beyond the goal is kept where equally many sweeps give it.
SPARE = 0.003
# Smaller differences than this are no reason to take another cover than the one that covers most.
TIE_STEP = 0.01
# Machining time is told apart to this, s.
TIME_STEP = 0.1
# What a tool change and a way to and from a sweep take, s. They only weigh sweeps against each other; what a program
# takes, posting and verification say.
TOOL_CHANGE_SECONDS, LINK_SECONDS = 10.0, 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A sweep that may be cut, told apart by identity.

    Attributes
    ----------
    sweep: the sweep.
    gap: (N,) swept gap less allowance on the points of its face, mm.
    covered: (N,) whether that is within tolerance.
    seconds: what it takes, about: its length at the tool's feed, and a way to and from it.
    travel, axis: (3,) unit, where it goes and where its axis points on the whole.
    """

    sweep: Sweep
    gap: Array
    covered: BoolArray
    seconds: float
    travel: Array
    axis: Array

    @classmethod
    def of(cls, sweep: Sweep, tool: Tool, gap: Array, covered: BoolArray, clearance: float) -> Candidate:
        """Weigh a sweep; `clearance` mm are gone at feed before and after it."""
        p, q = sweep.motion.ends(np.linspace(0.0, 1.0, 9))
        middle = 0.5 * (p + q)
        minutes = (travel(sweep.motion) + 2.0 * clearance) / tool.feed_mm_min
        return cls(
            sweep,
            gap,
            covered,
            60.0 * minutes + LINK_SECONDS,
            _unit(middle[-1] - middle[0]),
            _unit((q - p).sum(axis=0)),
        )


@dataclass(frozen=True, slots=True)
class Chosen:
    """The sweeps that were chosen for a face.

    Attributes
    ----------
    items: the sweeps.
    greedy: how many sweeps the greedy cover of the paper has; its time in s where that counts. And the share it covers.
    price: number of sweeps, or their time in s with the tools that are added.
    bound: no cover by these sweeps that reaches as much has a lower price.
    goal: share of the area that was to be reached.
    """

    items: list[Candidate]
    greedy: float
    greedy_share: float
    price: float
    bound: float
    goal: float

    @property
    def gap(self) -> float:
        """By how much the price may be above the least, as a share of it."""
        return max(self.price - self.bound, 0.0) / self.price if self.price else 0.0


def least_gain(covers: BoolArray, areas: Array) -> float:
    """Share of the whole area that a sweep has to add to be worth its time, from what each covers (K, N).

    Where part of a face is out of reach, inside of a hub for instance, a sweep is not weighed against that.
    """
    return LEAST_GAIN * share_covered(covers, areas, range(len(covers)))


def choose(
    items: Sequence[Candidate],
    areas: Array,
    cells: IntArray,
    job: Job,
    at_hand: Collection[str],
    target: float,
    *,
    exact: bool = True,
) -> Chosen:
    """Choose from the sweeps over a face.

    Parameters
    ----------
    items: the sweeps.
    areas, cells: (N,) and (N, 2), of the points that their gaps are on.
    job: its objective and tolerance count.
    at_hand: tools that are used anyway.
    target: share of the area to cover. Where no greedy cover reaches it with sweeps that each add `least_gain`, what it
        reaches is the goal.
    exact: without it the greedy cover is taken.
    """
    covers = np.array([item.covered for item in items]).reshape(len(items), len(areas))
    least = least_gain(covers, areas)
    own = np.flatnonzero((covers @ areas >= least * areas.sum()) & covers.any(axis=1))
    if not len(own):
        return Chosen([], 0.0, 0.0, 0.0, 0.0, 0.0)
    items, covers = [items[int(k)] for k in own], covers[own]
    gaps = np.array([item.gap for item in items])
    errors = mean_errors(covers, gaps, areas)
    timed = job.selection.objective == "time"
    tools = _classes([item.sweep.tool for item in items])
    change = np.array([0.0 if name in at_hand else 1.0 for name in dict.fromkeys(item.sweep.tool for item in items)])
    times = np.array([item.seconds for item in items])
    price = Price(times, tools, TOOL_CHANGE_SECONDS * change) if timed else Price.count(len(items))

    first = greedy_cover(covers, areas, errors, target, least, prices=times if timed else None)
    starts = [first]
    if exact:
        starts.append(fewest_cover(covers, areas, errors, target, least))
    if timed and exact:
        # The quickest with one tool alone, too: a greedy choice does not see what a change costs later.
        for row in tools:
            index = np.flatnonzero(row)
            alone = greedy_cover(covers[index], areas, errors[index], target, least, prices=times[index])
            starts.append([int(index[k]) for k in alone])
    goal = min(target, max(share_covered(covers, areas, chosen) for chosen in starts))
    reaching = [chosen for chosen in starts if share_covered(covers, areas, chosen) >= goal]
    incumbent = min(reaching, key=lambda chosen: price.of(chosen, 0.0))
    greedy = price.of(first, 0.0), share_covered(covers, areas, first)
    if not exact:
        return Chosen([items[k] for k in incumbent], *greedy, price.of(incumbent, 0.0), 0.0, goal)
    step = TIME_STEP if timed else 1.0
    found = exact_cover(covers, areas, cells, goal, price, incumbent, step, NODES)
    chosen = found.chosen
    if not timed:
        # Points of the choice flatter it: some area to spare keeps it from falling short where it is measured.
        chosen = widened(covers, areas, chosen)
        goal_kept = min(goal + SPARE, share_covered(covers, areas, chosen))
        tie = _ties(items, covers, areas, errors, tools, change, 0.5 * (job.tolerance.overcut + job.tolerance.undercut))
        other = cheapened(covers, areas, chosen, goal_kept, tie)
        dearer, cheaper = (tie.of(cover, share_covered(covers, areas, cover)) for cover in (chosen, other))
        if dearer - cheaper >= TIE_STEP:
            chosen = other
    return Chosen([items[k] for k in chosen], *greedy, found.price, found.bound, goal)


def _ties(
    items: Sequence[Candidate],
    covers: BoolArray,
    areas: Array,
    errors: Array,
    tools: BoolArray,
    change: Array,
    tolerance: float,
) -> Price:
    """What decides between covers of as many sweeps, in shares of the area.

    Directions: whether a sweep goes along or across what most of them do, and which way its axis points. Sweeps that
    go alike leave marks that run alike, and axes that point alike spare a turn of the machine.
    """
    share = covers @ areas / areas.sum()
    going = np.array([item.travel for item in items])
    pointing = np.array([item.axis for item in items])
    along = np.abs(going @ _main_direction(going, share)) >= np.sqrt(0.5)
    up = pointing @ _main_direction(pointing, share) >= 0.0
    classes = np.concatenate([tools, [along, ~along, up, ~up]])
    prices = np.concatenate([TOOL_WORTH * change, np.full(4, DIRECTION_WORTH)])
    each = share * (ERROR_WORTH * errors / tolerance + OVERLAP_WORTH)
    return Price(each, classes, prices, 1.0 + OVERLAP_WORTH)


def _main_direction(directions: Array, weights: Array) -> Array:
    """The line (3,) that unit vectors (N, 3) lie along most."""
    return np.asarray(np.linalg.eigh((directions * weights[:, None]).T @ directions)[1][:, -1])


def _classes(names: Sequence[str]) -> BoolArray:
    return np.array([[name == other for other in names] for name in dict.fromkeys(names)], dtype=np.bool_)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), LEAST_AREA))
