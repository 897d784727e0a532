"""The search for good policies: several starts, coordinate ascent from each, the best kept.

Starts: *naive* (every cell and every team-mate counts alike), *relaxed* (each agent as if the team would follow, see
``relaxation``), *staged* (jumps over region edges at the same time, see ``seeds``), and on request *perturbed* ones
(the best plans advanced or delayed, agent by agent) or policies from elsewhere, such as those of another horizon. Where
the value tree grows more than ``MANY_TERMS`` terms, the value function is held as tensor trains instead, and the ascent
goes on with them; so it does where the tree of large agents would not fit into memory.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...envs.problem import Problem
from ..models import JointModel, Policies, start_of
from ..values import HOST, Occupancy
from .ascent import Limits, Sweep, resting_policies, sweep
from .paths import best_paths, path_policies, staged_paths
from .relaxation import Relaxation, relax, relaxed_policies, upper_bound
from .train_ascent import TrainSweep, sweep_trains

FINAL = Limits(contribution=1e-10, elsewhere=1e-4, mass=1e-11, rank=1500)
"""What the last pass over a tree, with frozen policies, may leave out."""

MANY_TERMS = 64
"""Terms of a naive value tree from which tensor trains are used instead, unless the caller decides."""

TREE_BYTES = 3 * 2**30
"""Memory of a value tree from which tensor trains are used instead, unless the caller decides."""

FINAL_TERMS = 16
"""Arrays that a tree holds at its peak, in the last pass, per term of the naive one (an estimate)."""

SOLVED = 0.9
"""Share of the upper bound from which a start is good enough and no further ones are tried."""

SAME = 1e-5
"""Relative difference up to which two starts have led to the same value, and further ones are left out."""

COARSE, FINE, PAIR = 1e-2, 1e-4, 1e-7
"""What rounding of trains may change, as a share of the value: during the search, for what is reported, and that for
two agents, whose rank is that of a matrix."""

FAILURE = 0.05
"""The same for what is reported, as a share of the probability of failing, where that is less."""

VISITED = 1e-2
"""Share of the mass of each step that may lie on cells which trains leave out, as a share of the tolerance."""

WORTHWHILE = 1e-5
"""What one agent alone could gain, as a share of the value, from which the policies are improved on the tree that is
pruned as little as can be: pruning of the search has hidden it."""

POLISHING = 4
"""Most such sweeps."""

RESTART_SEED = 1
"""Seed of the perturbed starts."""

LONGEST_SHIFT = 2
"""Most steps by which a perturbed start advances or delays the plan of an agent."""

VALUES = ("auto", "tree", "train")

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Search:
    """How good policies are searched for.

    Parameters
    ----------
    max_sweeps : int
        Most sweeps from one start.
    limits : Limits
        Pruning of trees during the search.
    value : str
        ``"tree"``, ``"train"``, or ``"auto"`` (see the module's text).
    restarts : int
        Further starts from the best policies, perturbed: from a random step on the plan of every agent is advanced or
        delayed by up to ``LONGEST_SHIFT`` steps, of each agent by its own number.
    progress : callable, optional
        Called with the name of a start and the best value so far.
    stationary : bool
        Policies that do not look at the time.
    device : str
        Where sweeps over trees compute (see ``devices``).

    Raises
    ------
    ValueError
        If a value is none of these.
    """

    max_sweeps: int = 8
    limits: Limits = field(default_factory=Limits)
    value: str = "auto"
    restarts: int = 0
    progress: Progress | None = None
    stationary: bool = False
    device: str = HOST

    def __post_init__(self) -> None:
        for name in ("max_sweeps", "restarts"):
            number = getattr(self, name)
            if isinstance(number, bool) or not isinstance(number, int) or number < 0:
                raise ValueError(f"`{name}`: expected a whole number of at least 0, got {number!r}")
        if self.value not in VALUES:
            raise ValueError(f"`value`: expected one of {', '.join(VALUES)}, got {self.value!r}")

    def used(self) -> dict[str, object]:
        """What a certificate records of the search."""
        recorded = {name: getattr(self, name) for name in ("max_sweeps", "restarts", "stationary")}
        return {**recorded, "limits": vars(self.limits)}

    def tell(self, start: str, value: float) -> None:
        """Report progress."""
        if self.progress is not None:
            self.progress(start, value)


@dataclass(frozen=True, eq=False)
class Found:
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
        What one agent alone could gain by other choices at one time and automaton state, the largest of all (0: the
        policies are person-by-person optimal in this sense); for tensor trains as exact as the mass they are cut from.
    """

    best: Sweep | TrainSweep
    values: list[float]
    starts: dict[str, float]
    relaxations: tuple[Relaxation, ...]
    unilateral_gain: float


def find_policies(
    problem: Problem,
    joint: JointModel,
    search: Search,
    given: dict[str, Policies] | None = None,
    relaxations: tuple[Relaxation, ...] | None = None,
) -> Found:
    """Best policies found from several starts, those ``given`` by name first; ``relaxations`` if they are known."""
    start = start_of(problem, joint)
    relaxations = relax(problem, joint) if relaxations is None else relaxations
    most = upper_bound(joint, start, relaxations)
    trees, given = _Trees(joint, start, search, most), dict(given or {})
    first, many_terms = search.limits, most_terms(joint)
    if search.value != "tree":
        first = Limits(**{**vars(search.limits), "rank": min(search.limits.rank, many_terms)})
    naive, many = None, search.value == "train"
    if not given:
        naive = sweep(joint, resting_policies(joint), None, first, improve=True)
        many = many or (naive.rank >= many_terms and search.value == "auto")
    elif not many:
        many = max(own.rank for own in trees.each(given)) >= many_terms and search.value == "auto"
    if many:
        starts = given | {"relaxed start": relaxed_policies(relaxations)}
        if naive is not None:
            starts["naive start"] = naive.policies
        trains = _Trains(joint, start, search, most)
        best = trains.search(starts, resting_policies(joint) if naive is None else naive.policies)
        return Found(best, trains.values, trains.starts, relaxations, trains.gain)
    policies = trees.search(naive, relaxations)
    frozen, gain = _frozen(joint, policies, start)
    for _ in range(POLISHING if search.max_sweeps else 0):
        if gain <= WORTHWHILE * frozen.value:
            break
        better = sweep(joint, frozen.policies, start, FINAL, improve=True)
        trees.values.append(better.value)
        search.tell("polishing", max(better.value, frozen.value))
        polished, less = _frozen(joint, better.policies, start)
        if polished.value <= frozen.value:
            break
        frozen, gain = polished, less
    return Found(frozen, trees.values, trees.starts, relaxations, gain)


def most_terms(joint: JointModel) -> int:
    """Terms of a naive tree from which trains are used: ``MANY_TERMS``, or fewer where trees would be too large."""
    points = sum(model.n_cells + math.prod(len(axis) for axis in model.lattice) for model in joint.models)
    return int(np.clip(TREE_BYTES / (8.0 * FINAL_TERMS * points), 2, MANY_TERMS))


def _frozen(joint: JointModel, policies: Policies, start: Occupancy) -> tuple[Sweep, float]:
    """Value of given policies, pruned as little as can be, and what one agent alone could gain."""
    gains = [0.0]
    found = sweep(joint, policies, start, FINAL, improve=False, watch=lambda stage: gains.append(stage.gain()))
    return found, max(gains)


class _Trees:
    """Ascent on value trees; the best policies are kept, whatever pruning did to a later sweep."""

    def __init__(self, joint: JointModel, start: Occupancy, search: Search, most: float) -> None:
        self.joint, self.start, self.how, self.most = joint, start, search, most
        self.values: list[float] = []
        self.starts: dict[str, float] = {}
        self.best: Sweep | None = None

    def search(self, naive: Sweep | None, relaxations: tuple[Relaxation, ...]) -> Policies:
        """The best policies from all starts: the naive one, or those that have been begun with."""
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
            if self.best is not None and self.best.value < self.most * (1 - 1e-9):
                self.run(f"perturbed start {k + 1}", perturbed(self.best.policies, rng), sweeps)
        return resting if self.best is None else self.best.policies

    def each(self, starts: dict[str, Policies]) -> list[Sweep]:
        """One sweep from every start."""
        return [self.run(name, policies, min(1, self.how.max_sweeps)) for name, policies in starts.items()]

    def more_starts(self, naive: Policies, relaxations: tuple[Relaxation, ...]) -> None:
        """The relaxed start and, unless it comes to the same, the staged ones; the best two are gone on with."""
        before = self.best
        (relaxed,) = self.each({"relaxed start": relaxed_policies(relaxations)})
        if before is not None and abs(relaxed.value - before.value) <= SAME * before.value:
            return  # two starts that differ have come to the same
        if self.is_solved:
            self.run("relaxed start", relaxed.policies, self.how.max_sweeps - 1, relaxed.value)
            return
        staged = staged_starts(self.joint, self.start, naive)
        tried = dict(zip(("relaxed start", *staged), (relaxed, *self.each(staged)), strict=True))
        for name, found in sorted(tried.items(), key=lambda item: -item[1].value)[:2]:
            if not self.is_solved:
                self.run(name, found.policies, self.how.max_sweeps - 1)

    @property
    def is_solved(self) -> bool:
        """Whether the best is so near the upper bound that no further start is tried."""
        return self.best is not None and self.best.value >= SOLVED * self.most

    def run(self, name: str, policies: Policies, sweeps: int, last: float = -1.0) -> Sweep:
        """Sweep from ``policies``, whose value is ``last`` if known, until nothing improves; the last sweep."""
        found = None
        for _ in range(sweeps):
            found = sweep(self.joint, policies, self.start, self.how.limits, improve=True)
            self.values.append(found.value)
            self.starts[name] = max(found.value, self.starts.get(name, 0.0))
            self.best = found if self.best is None or found.value > self.best.value else self.best
            self.how.tell(name, self.best.value)
            if found.value <= last * (1 + 1e-7) or found.value >= self.most * (1 - 1e-9):
                break
            last, policies = found.value, found.policies
        if found is None:
            found = sweep(self.joint, policies, self.start, self.how.limits, improve=False)
            self.best = found if self.best is None or found.value > self.best.value else self.best
        return found


class _Trains:
    """Ascent on tensor trains, evaluated with a fine rounding in the end."""

    def __init__(self, joint: JointModel, start: Occupancy, search: Search, most: float) -> None:
        self.joint, self.start, self.how, self.most = joint, start, search, most
        self.values: list[float] = []
        self.starts: dict[str, float] = {}
        self.gain = 0.0
        self.best: TrainSweep | None = None

    def search(self, starts: dict[str, Policies], naive: Policies) -> TrainSweep:
        """The best policies from several starts, those of the first one if there are no sweeps to be made."""
        for name, policies in starts.items():
            if self.how.max_sweeps and not self.is_good:
                self.run(name, policies, self.how.max_sweeps)
        if not self.is_good and self.how.max_sweeps >= 2:
            staged = staged_starts(self.joint, self.start, naive)
            tried = {name: self.run(name, policies, 1) for name, policies in staged.items()}
            for k, (name, found) in enumerate(sorted(tried.items(), key=lambda item: -item[1].value)[:2]):
                if k == 0 or not self.is_good:
                    self.run(name, found.policies, self.how.max_sweeps - 1)
        rng = np.random.default_rng(RESTART_SEED)
        for k in range(self.how.restarts):
            if self.best is not None and not self.is_solved:
                self.run(f"perturbed start {k + 1}", perturbed(self.best.policies, rng), self.how.max_sweeps)
        policies = next(iter(starts.values())) if self.best is None else self.best.policies
        value = self.most if self.best is None else max(self.best.value, 1e-6)
        tolerance = _tolerance(min(self.fine * value, max(FAILURE * (1.0 - value), 1e-3 * self.fine)))
        share = VISITED * min(self.fine, tolerance / value)  # the tolerance may be more, where the value is next to 0
        gains = [0.0]
        found = sweep_trains(
            self.joint, policies, self.start, tolerance, improve=False, share=share, watch=gains.append
        )
        self.gain = max(gains)
        return found

    def run(self, name: str, policies: Policies, sweeps: int) -> TrainSweep:
        """Sweep from ``policies`` until nothing improves; the last sweep."""
        last, found = 0.0, self.best
        for _ in range(sweeps):
            tolerance = self.tolerance
            found = sweep_trains(self.joint, policies, self.start, tolerance, improve=True, margin=1)
            self.values.append(found.value)
            self.starts[name] = max(found.value, self.starts.get(name, 0.0))
            self.best = found if self.best is None or found.value > self.best.value else self.best
            self.how.tell(name, self.best.value)
            if found.value <= last + tolerance or self.is_solved:
                break
            last, policies = found.value, found.policies
        assert found is not None
        return found

    @property
    def is_good(self) -> bool:
        """Whether the best is so near the upper bound that no further start is tried."""
        return self.best is not None and self.best.value >= SOLVED * self.most

    @property
    def tolerance(self) -> float:
        """What a sweep may round: a share of the value at first, then of what there may be left to gain."""
        left = self.most if self.best is None else self.most - self.best.value
        return _tolerance(max(COARSE * left, self.fine * self.most))

    @property
    def fine(self) -> float:
        """Rounding of what is reported, as a share of the value."""
        return FINE if len(self.joint.models) > 2 else PAIR

    @property
    def is_solved(self) -> bool:
        """Whether more sweeps are not worth their time."""
        return self.best is not None and self.best.value >= (1 - 2 * self.fine) * self.most


def staged_starts(joint: JointModel, start: Occupancy, naive: Policies) -> dict[str, Policies]:
    """Policies that take the most likely way through the task, in several stagings (see ``seeds``)."""
    starts: dict[str, Policies] = {}
    for path in best_paths(joint, start, width=32, count=1):
        for own in staged_paths(joint, path):
            starts[f"staged start {len(starts) + 1}"] = path_policies(joint, own, naive)
    return starts


def perturbed(policies: Policies, rng: np.random.Generator) -> Policies:
    """Policies whose plans are advanced or delayed from a random step on, those of each agent by their own steps."""
    shifted = []
    for policy in policies:
        times = np.arange(len(policy))
        shift = np.where(times >= rng.integers(len(policy)), rng.integers(-LONGEST_SHIFT, LONGEST_SHIFT + 1), 0)
        shifted.append(policy[np.clip(times + shift, 0, len(policy) - 1)])
    return tuple(shifted)


def _tolerance(wanted: float) -> float:
    """A tolerance that floating point can keep."""
    return float(np.clip(wanted, 1e-9, 0.5))
