"""Exact cover of part of a face: the cheapest sets that reach a coverage, and a bound that nothing cheaper does.

A mixed-integer program with a binary x_k for each set and a covered share y_b for each block of points,

    minimise  price · x    subject to    y_b <= min(1, Σ_k f_kb x_k) ,    Σ_b a_b y_b >= goal ,

f_kb being the share of the block's area that set k covers. With blocks of one point each (or of points that the same
sets cover) that is the problem itself; with larger blocks it asks for less, since sets that overlap within a block are
credited with both their shares. So its price is a bound from below at any size of the blocks, and where it cannot be
solved there is no cover. It begins with a few hundred blocks and splits those in which its answer was credited with
more than it covers, until the answer holds on the points. Borders of patches are all that ever gets split.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_matrix, eye_array, hstack

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

# Rows and columns of points in a block at first, then after each split. Some 250 blocks on a face to begin with.
BLOCK_SIZES = (6, 3, 1)
# A goal is reached if no more than this share of the area is missing: what the solver lets constraints be off.
ROUNDING = 1e-6
# A block whose answer is credited with this share too much is split.
CREDITED = 1e-3
# Rounds of exchanging one set for another.
EXCHANGES = 30
INFEASIBLE = 2


@dataclass(frozen=True, slots=True)
class Price:
    """What a cover costs.

    Attributes
    ----------
    sets: (K,) price of each set, >= 0.
    classes: (C, K) which sets belong to each class (a tool, a direction).
    of_class: (C,) price of having any set of a class.
    area: taken off for covering everything, and as much less for less of the area.
    """

    sets: Array
    classes: BoolArray
    of_class: Array
    area: float = 0.0

    @classmethod
    def count(cls, sets: int) -> Price:
        """Every set costs one."""
        return cls(np.ones(sets), np.zeros((0, sets), dtype=np.bool_), np.zeros(0))

    def of(self, chosen: Sequence[int], share: float) -> float:
        """Price of a cover of this share of the area."""
        index = list(chosen)
        used = self.classes[:, index].any(axis=1)
        return float(self.sets[index].sum() + self.of_class[used].sum() - self.area * share)

    def with_each(self, chosen: Sequence[int]) -> Array:
        """Price of sets with each other one of all, (K,), area aside."""
        index = list(chosen)
        classes = self.classes | self.classes[:, index].any(axis=1, keepdims=True)
        return np.asarray(self.sets[index].sum() + self.sets + self.of_class @ classes)

    def with_two(self, chosen: Sequence[int]) -> Array:
        """Price of sets with each two of all, (K, K), area aside."""
        index = list(chosen)
        classes = self.classes | self.classes[:, index].any(axis=1, keepdims=True)
        # What two have of classes together is what each has less what both have.
        both = (classes * self.of_class[:, None]).T @ classes
        each = self.sets + self.of_class @ classes
        return np.asarray(self.sets[index].sum() + each[:, None] + each - both)

    def only(self, index: IntArray) -> Price:
        """The same for some of the sets."""
        return Price(self.sets[index], self.classes[:, index], self.of_class, self.area)


@dataclass(frozen=True, slots=True)
class ExactCover:
    """The cheapest cover found.

    Attributes
    ----------
    chosen: indices of its sets.
    price: what it costs.
    bound: no cover that reaches the goal costs less; equal to the price where that is proven.
    """

    chosen: list[int]
    price: float
    bound: float

    @property
    def gap(self) -> float:
        """By how much the price may be above the least, as a share of the price."""
        return max(self.price - self.bound, 0.0) / max(abs(self.price), 1e-12)


def exact_cover(
    covers: BoolArray,
    areas: Array,
    cells: IntArray,
    goal: float,
    price: Price,
    incumbent: list[int],
    step: float,
    nodes: int,
) -> ExactCover:
    """The cheapest sets that cover the share `goal` of the area.

    Parameters
    ----------
    covers: (K, N), which points each set covers.
    areas: (N,), area of each point.
    cells: (N, 2), row and column of each point on a grid, by which points are taken together.
    goal: share of the area.
    price: what is to be least; area is not credited.
    incumbent: a cover that reaches the goal; the answer is never worse.
    step: an improvement by less than this is not looked for. Prices that are whole multiples of it sharpen the bound.
    nodes: limit of branch-and-bound nodes in all. Equal inputs give equal covers, as a limit of time would not.
    """
    left = nodes
    index = undominated(covers, price, keep=incumbent)
    own, prices = covers[index], price.only(index)
    place = {int(k): i for i, k in enumerate(index)}
    total = float(areas.sum())
    weighted = np.ascontiguousarray(own * areas, dtype=np.float32)
    whole = not np.any(np.mod(price.sets, step)) and not np.any(np.mod(price.of_class, step))

    def share(chosen: Sequence[int]) -> float:
        return float(areas[own[list(chosen)].any(axis=0)].sum()) / total

    best = [place[k] for k in incumbent]
    least = prices.of(best, share(best))
    bound = 0.0
    sizes = np.full(len(areas), BLOCK_SIZES[0], dtype=np.int64)
    relaxed = True
    while bound < least - 1e-9:
        model = _Model.of(own, areas, _blocks(cells, sizes, own), goal, prices)
        if relaxed:
            # Whatever becomes of the integers, this holds.
            bound = max(bound, _rounded(model.relaxed(), step if whole else 0.0))
            relaxed = False
        if bound >= least - step + 1e-9 or left <= 0.0:
            break
        answer = model.solve(least - step, left)
        if answer is None:
            break
        left -= max(answer.nodes, 1)
        if answer.infeasible:
            bound = max(bound, least - (0.0 if whole else step))
            break
        bound = max(bound, min(_rounded(answer.bound, step if whole else 0.0), least))
        chosen = answer.chosen
        reached = share(chosen)
        if reached < goal - ROUNDING:
            chosen = exchanged(own, weighted, areas, chosen, goal, prices, least - step)
            reached = share(chosen)
        if reached >= goal - ROUNDING and prices.of(chosen, reached) <= least - step + 1e-9:
            best, least = chosen, prices.of(chosen, reached)
            if chosen == answer.chosen:
                continue
        split = model.credited(own, areas, answer) & (sizes > BLOCK_SIZES[-1])
        if not split.any():
            if chosen != best:
                break
            continue
        rank = np.searchsorted(-np.array(BLOCK_SIZES), -sizes[split])
        sizes[split] = np.array(BLOCK_SIZES)[rank + 1]
    return ExactCover(sorted(int(index[k]) for k in best), least, min(bound, least))


def undominated(covers: BoolArray, price: Price, keep: Sequence[int] = ()) -> IntArray:
    """Sets that are not within a set that costs no more, in any of these classes; those in `keep` stay.

    A cover that holds a set so dominated is not worse with the other in its place, of part of the area as well. Points
    have no such rule there: one that is covered whenever another is still has an area of its own.
    """
    sizes = covers.sum(axis=1)
    order = np.lexsort((price.sets, -sizes))
    counts = covers.astype(np.float32)
    within = counts @ counts.T >= sizes[:, None]  # row within column
    alive = sizes > 0
    alive[list(keep)] = True
    kept = set(keep)
    for rank, k in enumerate(order):
        if not alive[k] or int(k) in kept:
            continue
        larger = order[:rank]
        larger = larger[alive[larger] & within[k, larger] & (price.sets[larger] <= price.sets[k])]
        if len(larger) and np.any(np.all(price.classes[:, larger] <= price.classes[:, [k]], axis=0)):
            alive[k] = False
    return np.flatnonzero(alive).astype(np.int64)


def widened(covers: BoolArray, areas: Array, chosen: list[int]) -> list[int]:
    """As many sets that cover more, found by exchanging one for another."""
    weighted = np.ascontiguousarray(covers * areas, dtype=np.float32)
    return exchanged(covers, weighted, areas, chosen, 2.0, Price.count(len(covers)), float(len(chosen)))


def exchanged(
    covers: BoolArray,
    weighted: npt.NDArray[np.float32],
    areas: Array,
    chosen: list[int],
    goal: float,
    price: Price,
    limit: float,
) -> list[int]:
    """Exchange one set for another as long as more area gets covered, until the goal is reached.

    weighted: covers times areas, (K, N). limit: highest price.
    """
    total = float(areas.sum())
    chosen = list(chosen)
    area = float(areas[covers[chosen].any(axis=0)].sum())
    for _ in range(EXCHANGES):
        best: tuple[float, int, int] | None = None
        for out in range(len(chosen)):
            rest = chosen[:out] + chosen[out + 1 :]
            inside = covers[rest].any(axis=0) if rest else np.zeros(covers.shape[1], dtype=np.bool_)
            areas_with = float(areas[inside].sum()) + weighted @ (~inside).astype(np.float32)
            for k in np.argsort(-areas_with, kind="stable"):
                with_k = float(areas_with[k])
                if with_k <= (best[0] if best else area) + ROUNDING * total:
                    break
                if k not in rest and price.of([*rest, int(k)], with_k / total) <= limit + 1e-9:
                    best = (with_k, out, int(k))
                    break
        if best is None:
            break
        chosen[best[1]] = best[2]
        area = float(areas[covers[chosen].any(axis=0)].sum())
        if area >= (goal - ROUNDING) * total:
            break
    return chosen


def cheapened(covers: BoolArray, areas: Array, chosen: list[int], goal: float, price: Price) -> list[int]:
    """As many sets that still cover the share `goal` at a lower price, by exchanging one of them or two for others.

    Of two sets it is the best exchange of all, of more one that no exchange of two betters.
    """
    total = float(areas.sum())
    weighted = np.ascontiguousarray(covers * areas, dtype=np.float32)
    counts = covers.astype(np.float32)
    chosen = list(chosen)
    least = price.of(chosen, float(areas[covers[chosen].any(axis=0)].sum()) / total)
    for _ in range(EXCHANGES):
        best: tuple[float, list[int]] | None = None
        for size in (1, 2):
            # Two are exchanged where exchanging one does not help.
            for out in combinations(range(len(chosen)), size) if best is None else ():
                rest = [k for place, k in enumerate(chosen) if place not in out]
                open_ = ~covers[rest].any(axis=0)
                area = float(areas[~open_].sum())
                gains = weighted[:, open_].sum(axis=1, dtype=np.float64)
                prices = price.with_each(rest)
                if size == 1:
                    area_with = area + gains
                else:
                    area_with = area + gains[:, None] + gains - weighted[:, open_] @ counts[:, open_].T
                    prices = price.with_two(rest)
                prices = prices - price.area * area_with / total
                if size == 2:
                    np.fill_diagonal(prices, np.inf)
                    prices[rest] = np.inf
                prices[..., rest] = np.inf
                prices[area_with < (goal - ROUNDING) * total] = np.inf
                place = int(np.argmin(prices))
                if prices.ravel()[place] < (least if best is None else best[0]) - ROUNDING:
                    best = (float(prices.ravel()[place]), [*rest, *map(int, np.unravel_index(place, prices.shape))])
        if best is None:
            break
        least, chosen = best
    return sorted(chosen)


@dataclass(frozen=True, slots=True)
class _Answer:
    """What a program of blocks gave: sets, a bound on their price, whether there are none, nodes it took."""

    chosen: list[int]
    bound: float
    infeasible: bool
    nodes: int


@dataclass(frozen=True, slots=True)
class _Model:
    """The program with points taken together in blocks.

    block: (N,) number of the block of each point; shares (K, B) f; areas (B,) as shares of the whole area.
    """

    block: IntArray
    shares: Array
    areas: Array
    goal: float
    price: Price

    @classmethod
    def of(cls, covers: BoolArray, areas: Array, block: IntArray, goal: float, price: Price) -> _Model:
        count = int(block.max()) + 1
        in_block = np.bincount(block, areas, count)
        to_block = csr_matrix((areas, (np.arange(len(areas)), block)), shape=(len(areas), count))
        shares = np.asarray(covers.astype(np.float64) @ to_block) / in_block
        return cls(block, shares, in_block / areas.sum(), goal, price)

    def relaxed(self) -> float:
        """Least price with sets taken in part."""
        found = self._milp(np.inf, 1, whole=False)
        return float(found.fun) if found.status == 0 else -np.inf

    def solve(self, limit: float, nodes: int) -> _Answer | None:
        """Sets of the least price up to `limit`; None where so many nodes did not do."""
        found = self._milp(limit, nodes, whole=True)
        if found.status == INFEASIBLE:
            return _Answer([], np.inf, True, 1)
        if found.status != 0:
            return None
        chosen = [int(k) for k in np.flatnonzero(found.x[: len(self.price.sets)] > 0.5)]
        return _Answer(chosen, float(found.mip_dual_bound), False, int(found.mip_node_count))

    def credited(self, covers: BoolArray, areas: Array, answer: _Answer) -> BoolArray:
        """Points (N,) in blocks where an answer is credited with more than it covers."""
        credit = np.minimum(self.shares[answer.chosen].sum(axis=0), 1.0)
        inside = covers[answer.chosen].any(axis=0) if answer.chosen else np.zeros(len(areas), dtype=np.bool_)
        true = np.bincount(self.block, areas * inside, len(self.areas)) / np.bincount(self.block, areas)
        return np.asarray((credit > true + CREDITED)[self.block])

    def _milp(self, limit: float, nodes: int, *, whole: bool):  # type: ignore[no-untyped-def]
        """Variables: sets, classes, covered shares of the blocks that can be covered."""
        able = np.flatnonzero(self.shares.any(axis=0))
        sets, classes, blocks = len(self.price.sets), len(self.price.classes), len(able)
        areas = self.areas[able]
        cover = hstack([csr_matrix(-self.shares[:, able].T), csr_matrix((blocks, classes)), eye_array(blocks)])
        limits = [LinearConstraint(cover.tocsr(), -np.inf, 0.0)]
        limits.append(LinearConstraint(np.r_[np.zeros(sets + classes), areas], self.goal, np.inf))
        cost = np.r_[self.price.sets, self.price.of_class, np.zeros(blocks)]
        if np.isfinite(limit):
            limits.append(LinearConstraint(cost, -np.inf, limit))
        if classes:
            number, member = np.nonzero(self.price.classes)
            row = np.arange(len(member))
            each = csr_matrix(
                (
                    np.r_[np.ones(len(row)), -np.ones(len(row))],
                    (np.r_[row, row], np.r_[member, sets + number]),
                ),
                shape=(len(row), sets + classes + blocks),
            )
            limits.append(LinearConstraint(each, -np.inf, 0.0))
        integer = np.r_[np.ones(sets + classes), np.zeros(blocks)] if whole else np.zeros(sets + classes + blocks)
        return milp(
            cost, constraints=limits, integrality=integer, bounds=Bounds(0.0, 1.0), options={"node_limit": nodes}
        )


def _blocks(cells: IntArray, sizes: IntArray, covers: BoolArray) -> IntArray:
    """Number of the block of each point (N,); single points are taken together where the same sets cover them."""
    key = np.column_stack([sizes, cells // sizes[:, None], np.zeros(len(sizes), dtype=np.int64)])
    alone = np.flatnonzero(sizes == 1)
    if len(alone):
        _, alike = np.unique(np.packbits(covers[:, alone], axis=0), axis=1, return_inverse=True)
        key[alone, 1:3] = 0
        key[alone, 3] = alike.ravel()
    return np.asarray(np.unique(key, axis=0, return_inverse=True)[1].ravel(), dtype=np.int64)


def _rounded(bound: float, step: float) -> float:
    """A bound on prices that are whole multiples of `step` (0: are any) is the next of them."""
    return float(step * np.ceil(bound / step - 1e-6)) if step and np.isfinite(bound) else bound
