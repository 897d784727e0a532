"""The search for good policies: several starts, coordinate ascent from each, the best kept.

Starts: *naive* (every cell and every team-mate counts alike), *relaxed* (each agent as if the team would follow, see
``relaxation``), *staged* (jumps over region edges at the same time, see ``paths``), and on request *perturbed* ones
(the best plans advanced or delayed, agent by agent) or policies from elsewhere, such as those of another horizon. Where
the value tree grows more than ``MANY_TERMS`` terms, the value function is held as tensor trains instead, and the ascent
continues with them; the same happens where the tree of large agents would not fit into memory.

Every bound is valid for whatever policies were found: nothing here claims optimality (docs/theory/tree.md, "Policies:
occupancy-weighted ascent").
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ....envs.systems.arguments import tree_text
from ....envs.tasks.problem import Problem
from ...abstraction.models import JointModel, Policies, spread_start, start_of
from ...certificates.value_functions import Occupancy
from .coordinate_ascent import Sweep, resting_policies, start_value, sweep
from .limits import Limits
from .paths import perturbed, staged_starts
from .relaxation import Relaxation, relax, relaxed_policies, upper_bound
from .search_settings import Search
from .train_ascent import TrainSweep
from .train_search import RESTART_SEED, TrainAscent

FINAL = Limits(contribution=1e-10, elsewhere=1e-4, mass=1e-11, rank=1500)
"""What the last pass over a tree, with frozen policies, may leave out."""

LINEAR_LIMITS = Limits(contribution=1e-5, elsewhere=1e-2, mass=1e-6, rank=40)
"""What sweeps of linear agents leave out at least: every term costs them its bends, and many terms much time."""

LINEAR_FINAL = Limits(contribution=1e-6, elsewhere=1e-2, mass=1e-7, rank=60)
"""What their evaluation leaves out."""

HOPE, HOPE_SHARE = 0.02, 0.5
"""What the evaluation of linear agents may be below their last sweep without being tried in another way; and without
other policies being evaluated in the same way, as a share of what is left to 1."""

SPENT = (0.0, 0.05, None)
"""Shares that unions from below may lose, one after the other; None: nothing is united."""

MOST_ENDS = 3
"""Policies that are evaluated in all these ways, at most: those of the largest value in sweeps."""

MANY_TERMS = 64
"""Terms of a naive value tree from which tensor trains are used instead, unless the caller decides."""

TREE_BYTES = 3 * 2**30
"""Memory of a value tree from which tensor trains are used instead, unless the caller decides."""

FINAL_TERMS = 16
"""Arrays that a tree holds at its peak, in the last pass, per term of the naive one (an estimate)."""

SAME_VALUE_SHARE = 1e-5
"""Relative difference up to which two starts count as having led to the same value, and further ones are left out."""

LEAST_PROGRESS = 1e-7
"""Relative improvement below which a sweep over trees was the last from its start."""

LINEAR_PROGRESS = 3e-4
"""The same for linear agents, whose sweeps are long and about right only."""

LEAST_ROOM = 1e-9
"""Relative distance from the upper bound below which nothing is left to gain on these cells."""

LEAST_GAIN_SHARE = 1e-5
"""What one agent alone could gain, as a share of the value, from which policies are improved on the full tree.

That tree is pruned as little as possible: pruning during the search has hidden the gain.
"""

POLISHING = 4
"""Most such sweeps."""

RELAXED = "relaxed start"
"""Name of the start at the policies with which each agent trusts the team to do its best."""


@dataclass(frozen=True, eq=False, repr=False)
class SearchResult:
    """What a search has found.

    Parameters
    ----------
    best : Sweep or TrainSweep
        The best policies, evaluated with frozen policies.
    values : list of float
        Value after each sweep; sweeps prune and round more than the last evaluation.
    starts : dict
        Best value that each start led to, by its name.
    relaxations : tuple of Relaxation
    unilateral_gain : float or None
        Largest increase of the start value if one agent changes its choices at one time and automaton state (an
        estimate); 0 means that the policies are person-by-person optimal in this sense. For tensor trains it is as
        exact as the mass, which is cut.
    """

    best: Sweep | TrainSweep
    values: list[float]
    starts: dict[str, float]
    relaxations: tuple[Relaxation, ...]
    unilateral_gain: float | None

    def __repr__(self) -> str:
        first_rows = [("starts", len(self.starts)), ("sweeps", len(self.values))]
        best = max(self.starts, key=lambda name: self.starts[name], default="none")
        rows = [
            *first_rows,
            ("best start", best),
            ("alone", f"an agent gains about {self.unilateral_gain or 0.0:.2g} at most"),
        ]
        form = "tensor trains" if isinstance(self.best, TrainSweep) else "a tree"
        return tree_text(f"Found: value {self.best.value:.6g} on {form}, not rounded down", rows)


def find_policies(
    problem: Problem,
    joint: JointModel,
    search: Search,
    given: dict[str, Policies] | None = None,
    relaxations: tuple[Relaxation, ...] | None = None,
) -> SearchResult:
    """Return the best policies found from several starts; their value is that of a sweep with frozen policies.

    Parameters
    ----------
    problem : Problem
    joint : JointModel
    search : Search
    given : dict, optional
        Policies to begin with, by name; the naive start is left out then.
    relaxations : tuple of Relaxation, optional
        Relaxations of all agents, if they were solved before.
    """
    joint = replace(joint, spend=search.spend)
    # Lower bounds that are no linear maps of their factors hold for nonnegative factors alone: no tensor trains.
    lossy = sorted({model.relation.kind for model in joint.models if not model.is_additive})
    may_use_trains = search.value == "auto" and not lossy
    if lossy:
        if search.value == "train":
            raise ValueError(f"`value`: expected 'auto' or 'tree' with the relation `{lossy[0]}`, got 'train'")
        search = replace(search, limits=_coarser(search.limits, LINEAR_LIMITS))
    corners = all(model.choices.has_corners for model in joint.models)
    if corners and not search.restarts:
        search = replace(search, good_share=min(search.good_share, LINEAR_SHARE))
    start = start_of(problem, joint)
    relaxations = relax(problem, joint) if relaxations is None else relaxations
    most = upper_bound(joint, start, relaxations)
    given = dict(given or {})
    keeps = bool(given) and (search.max_sweeps == 0 or not lossy)
    # Where policies were carried over, evaluating those of the relaxations was not enough on coarser cells.
    keeps = keeps or (bool(given) and corners and len(joint.models) > 1)
    early = None if keeps else _without_sweeps(joint, start, search, relaxations, most)
    if early is not None:
        return early
    # Linear agents are spared this: their sweeps are long, and cells that no mass meets are weighed in any case. So
    # are relations that lose delta in every step: who looks beside the path gets there later, which costs them more.
    loses = lossy or any(np.any(model.delta > 0.0) for model in joint.models)
    spread = start if loses else spread_start(problem, joint)
    trees = _TreeAscent(joint, start, spread, search, most)
    # One sweep over a tree shows whether it grows too many terms; it need not be pruned less than that.
    first_limits, many_terms = search.limits, most_terms(joint)
    if search.value != "tree":
        first_limits = Limits(**{**vars(search.limits), "rank": min(search.limits.rank, many_terms)})
    naive, uses_trains = None, search.value == "train"
    if not given:
        ends = many_terms if may_use_trains else math.inf
        naive = sweep(joint, resting_policies(joint), None, first_limits, improve=True, until=ends)
        uses_trains = uses_trains or (naive.rank >= many_terms and may_use_trains)
        if len(joint.models) == 1 and start_value(start, naive.terms) <= 0.0:
            # Of one agent this sweep was dynamic programming: others find nothing, either.
            return SearchResult(replace(naive, value=0.0), [0.0], {"naive start": 0.0}, relaxations, None)
    elif not uses_trains:
        uses_trains = max(outcome.rank for outcome in trees.each(given)) >= many_terms and may_use_trains
    if uses_trains:
        starts = given | {RELAXED: relaxed_policies(relaxations)}
        if naive is not None:
            starts["naive start"] = naive.policies
        # Beyond two agents trains leave out the cells beside the path: with them their ranks grow too large.
        trains = TrainAscent(joint, start, spread if len(joint.models) <= 2 else start, search, most)
        best = trains.search(starts, resting_policies(joint) if naive is None else naive.policies)
        return SearchResult(best, trains.values, trains.starts, relaxations, trains.gain)
    policies = trees.search(naive, relaxations)
    if lossy:
        return SearchResult(trees.evaluated(policies), trees.values, trees.starts, relaxations, None)
    frozen, gain = _frozen(joint, policies, start)
    # Go on with the full tree while one agent alone could still gain.
    for _ in range(POLISHING if search.max_sweeps else 0):
        if gain <= LEAST_GAIN_SHARE * frozen.value or frozen.value >= search.enough:
            break
        better = _answered(joint, frozen.policies, start, spread, FINAL)
        trees.values.append(better.value)
        search.tell("polishing", max(better.value, frozen.value))
        polished, polished_gain = _frozen(joint, better.policies, start)
        if polished.value <= frozen.value:
            break
        frozen, gain = polished, polished_gain
    return SearchResult(frozen, trees.values, trees.starts, relaxations, gain)


def _without_sweeps(
    joint: JointModel, start: Occupancy, search: Search, relaxations: tuple[Relaxation, ...], most: float
) -> SearchResult | None:
    """Return what each agent does if the team follows, where that leaves next to nothing to gain; else None.

    Sweeps over linear cells of expressions, and over large teams, are long: evaluating these policies is often enough.
    """
    if all(model.choices.has_corners for model in joint.models):
        if len(joint.models) == 1:
            return _alone(joint, start, relaxations)
        pays, limits, room = int((~joint.absorbing).sum()) == 1, LINEAR_FINAL, WRITTEN_ROOM
    else:
        is_additive = all(model.is_additive for model in joint.models)
        pays = is_additive and len(joint.models) >= LARGE_TEAM and search.value != "train" and search.max_sweeps > 0
        limits, room = FINAL, LARGE_ROOM
    if not pays:
        return None
    followed = sweep(joint, relaxed_policies(relaxations), start, limits, improve=False)
    if followed.value < most * (1 - room):
        return None
    gain = max(0.0, most - followed.value) if limits is FINAL else None
    return SearchResult(followed, [followed.value], {RELAXED: followed.value}, relaxations, gain)


def _alone(joint: JointModel, start: Occupancy, relaxations: tuple[Relaxation, ...]) -> SearchResult:
    """Return the policies of a single agent: its relaxation is dynamic programming, losses counted."""
    best = sweep(joint, relaxed_policies(relaxations), start, LINEAR_FINAL, improve=False)
    return SearchResult(best, [best.value], {RELAXED: best.value}, relaxations, None)


def _coarser(first: Limits, second: Limits) -> Limits:
    """Return limits that leave out as much as either of two."""
    larger = {name: max(getattr(first, name), getattr(second, name)) for name in ("contribution", "elsewhere", "mass")}
    return Limits(**larger, rank=min(first.rank, second.rank))


def most_terms(joint: JointModel) -> int:
    """Return the terms of a naive tree from which trains are used.

    They are ``MANY_TERMS``, or fewer where trees of so many terms would be too large.
    """
    points = sum(model.n_cells + math.prod(len(axis) for axis in model.lattice) for model in joint.models)
    return int(np.clip(TREE_BYTES / (8.0 * FINAL_TERMS * points), 2, MANY_TERMS))


def _answered(joint: JointModel, policies: Policies, start: Occupancy, spread: Occupancy, limits: Limits) -> Sweep:
    """Return a sweep in which agents answer, weighed with the ``spread`` start; its value is that at the true one."""
    outcome = sweep(joint, policies, spread, limits, improve=True)
    return replace(outcome, value=start_value(start, outcome.terms))


def _frozen(joint: JointModel, policies: Policies, start: Occupancy) -> tuple[Sweep, float]:
    """Return the value of given policies, pruned as little as possible, and what one agent alone could gain."""
    gains = [0.0]
    outcome = sweep(joint, policies, start, FINAL, improve=False, watch=lambda stage: gains.append(stage.gain()))
    return outcome, max(gains)


WRITTEN_ROOM = 1e-4
"""Relative distance from the product of the relaxations, which is no bound under linear cells, that ends the search."""

LINEAR_SHARE = 0.9
"""Share of the upper bound from which linear cells, whose sweeps are long, are searched from the naive start alone."""

LARGE_TEAM, LARGE_ROOM = 200, 1e-6
"""Agents from which the policies of the relaxations are tried before all others, and what may be left to gain then."""


class _TreeAscent:
    """Ascent on value trees; the best policies are kept, whatever pruning did to a later sweep."""

    def __init__(self, joint: JointModel, start: Occupancy, spread: Occupancy, search: Search, most: float) -> None:
        self.joint, self.start, self.spread, self.how, self.most = joint, start, spread, search, most
        self.progress = LEAST_PROGRESS if all(model.is_additive for model in joint.models) else LINEAR_PROGRESS
        self.values: list[float] = []
        self.starts: dict[str, float] = {}
        self.best: Sweep | None = None
        self.ends: list[Sweep] = []

    def search(self, naive: Sweep | None, relaxations: tuple[Relaxation, ...]) -> Policies:
        """Return the best policies from all starts, the naive one or the given ones first."""
        resting = resting_policies(self.joint) if naive is None else naive.policies
        sweeps = self.how.max_sweeps
        if naive is not None:
            self.run("naive start", naive.policies, sweeps)
        elif self.best is not None:
            self.run("given start", self.best.policies, sweeps - 1, self.best.value)
        if not self.is_solved and sweeps >= 2:
            self.more_starts(resting, relaxations)
        rng = np.random.default_rng(RESTART_SEED)
        for k in range(self.how.restarts):
            if self.best is not None and self.best.value < self.most * (1 - LEAST_ROOM):
                self.run(f"perturbed start {k + 1}", perturbed(self.best.policies, rng), sweeps)
        return resting if self.best is None else self.best.policies

    def each(self, starts: dict[str, Policies]) -> list[Sweep]:
        """Make one sweep from every start and return them."""
        return [self.run(name, policies, min(1, self.how.max_sweeps)) for name, policies in starts.items()]

    def more_starts(self, naive: Policies, relaxations: tuple[Relaxation, ...]) -> None:
        """Try the relaxed start and, unless it comes to the same, the staged ones; continue with the best two."""
        before = self.best
        (relaxed,) = self.each({RELAXED: relaxed_policies(relaxations)})
        # Two different starts that come to the same value: further ones are not worth their time.
        if before is not None and abs(relaxed.value - before.value) <= SAME_VALUE_SHARE * before.value:
            return
        if self.is_solved or self.is_long:
            self.run(RELAXED, relaxed.policies, self.how.max_sweeps - 1, relaxed.value)
            return
        leading, value = [(RELAXED, relaxed)], relaxed.value
        for number, (name, policies) in enumerate(staged_starts(self.joint, self.start, naive)):
            (outcome,) = self.each({name: policies})
            # Only the best two are kept, the first ones among equals.
            leading = sorted([*leading, (name, outcome)], key=lambda one: -one[1].value)[:2]
            # The most likely way is where agents go that trust the team: other times of the same jumps gain nothing.
            if number == 0 and abs(value - outcome.value) <= SAME_VALUE_SHARE * value:
                break
        del relaxed
        while leading and not self.is_solved:
            name, outcome = leading.pop(0)
            self.run(name, outcome.policies, self.how.max_sweeps - 1)

    def evaluated(self, policies: Policies) -> Sweep:
        """Return the largest evaluation of policies; where it is far below what sweeps see, of others as well.

        Sweeps are about right only: policies that they cannot tell apart may differ much in what is certified of them,
        and unions from below may lose more than they save.
        """
        seen = max(self.values, default=0.0)
        ends = sorted(self.ends, key=lambda end: -end.value)
        tried = [policies, *(end.policies for end in ends if end.policies is not policies)][:MOST_ENDS]
        best: Sweep | None = None
        for spent in SPENT:
            for own in tried:
                found = sweep(self.joint, own, self.start, LINEAR_FINAL, improve=False, climb=spent)
                best = found if best is None or found.value > best.value else best
                if best.value >= seen - min(HOPE, HOPE_SHARE * (1.0 - seen)):
                    return best
            assert best is not None  # there is something to evaluate
            if best.value >= seen - HOPE:
                return best
        assert best is not None
        return best

    @property
    def is_solved(self) -> bool:
        """Whether the best is so near the upper bound that no further start is tried."""
        least = min(self.how.good_share * self.most, self.how.enough)
        return self.best is not None and self.best.value >= least

    @property
    def is_long(self) -> bool:
        """Whether sweeps are so long that the likeliest ways through the task are not tried one by one."""
        return all(model.choices.has_corners for model in self.joint.models)

    def run(self, name: str, policies: Policies, sweeps: int, last: float = -1.0) -> Sweep:
        """Sweep from ``policies``, whose value is ``last`` if known, until nothing improves; return the last sweep."""
        outcome = None
        for _ in range(sweeps):
            # The first sweep finds the way; those after it also look beside it, where more cells have to be weighed.
            weighed = self.start if last < 0.0 else self.spread
            outcome = _answered(self.joint, policies, self.start, weighed, self.how.limits)
            self.values.append(outcome.value)
            self.starts[name] = max(outcome.value, self.starts.get(name, 0.0))
            self.best = outcome if self.best is None or outcome.value > self.best.value else self.best
            self.how.tell(name, self.best.value)
            ends = min(self.most * (1 - LEAST_ROOM), self.how.enough)
            if outcome.value <= last * (1 + self.progress) or outcome.value >= ends:
                break
            last, policies = outcome.value, outcome.policies
        if outcome is not None and not all(model.is_additive for model in self.joint.models):
            self.ends.append(outcome)
        # Without a sweep the policies are only evaluated.
        if outcome is None:
            outcome = sweep(self.joint, policies, self.start, self.how.limits, improve=False)
            self.best = outcome if self.best is None or outcome.value > self.best.value else self.best
        return outcome
