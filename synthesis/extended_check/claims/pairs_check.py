"""Checks of certificates by subtraction: nothing that a pair of agents can spoil was left out.

No code of the search is used. The task without pairs is compared with the problem state by state of the automaton, and
its own certificate is checked like any other. Then the policies are pushed forward once more, with the kernel of the
checks, and every pair that the automaton asks about is charged at every step:

1. what the policies do depends on the automaton's *mode*: a set of undecided states in which all of them are the same;
2. a product of masses goes on from mode to mode by everything that any guard between them lets through;
3. at each step the next states of two agents are lattice points plus independent Gaussian noise, so that the difference
   is near with a probability that is known per axis.

Reference: docs/theory/pairs.md, "What the check does".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from ....envs.systems.agents import AnyAgent
from ....envs.systems.distributions import Gaussian
from ....envs.tasks.automata import Automaton
from ....envs.tasks.regions import PairRegion
from ...certificates.cell_probabilities import axis_tables, lost_to_rounding, state
from ...certificates.proofs import OnGrid
from ...relations.grids import FloatArray
from ..steps import start_shares
from .forward_occupancy import moved
from .guard_check import cell_classes

if TYPE_CHECKING:
    from ....envs.tasks.problem import Problem
    from ...certificates.proofs import Certificate, UnionBoundProof

MOST_PRODUCTS = 1000
"""Products of the mass at one time that are handled."""

OWN_ERROR = 4e-15
"""Absolute error of a probability of these tables: the complementary error function is accurate to a few units."""

RELATIVE = 1.0 + 1e-9
"""Factor for the rounding of all sums of nonnegative numbers."""


def wrong_pairs(certificate: Certificate[UnionBoundProof], problem: Problem) -> tuple[list[str], float]:
    """Return what is wrong with a certificate by subtraction, apart from its base, and what pairs may spoil at most."""
    base, usual = certificate.proof.base, np.array(certificate.proof.usual, dtype=bool)
    if usual.shape != (len(problem.labeling.pairs),):
        return ["what it takes its pairs to be does not fit the problem"], 1.0
    failures = _wrong_base(problem, base.problem, usual) or _wrong_agents(problem, base)
    if base.gap is not None and not failures:
        failures = _unseen(problem, base)
    if failures:
        return failures, 1.0
    try:
        return [], _spoiled(problem, base, usual)
    except OverflowError as error:
        return [str(error)], 1.0


def _unseen(problem: Problem, base: OnGrid) -> list[str]:
    """Why pairs may make a success of runs whose mass is not counted, so that there is no upper end."""
    if not np.array_equal(base.problem.automaton.dead, problem.automaton.dead):
        return ["it claims an upper end, but pairs may save what is lost without them"]
    for i, part in enumerate(base.proof.agents):
        _, possible, inside = cell_classes(base.problem, i, part, None)
        if np.any(possible.sum(axis=1) != 1) or not inside.all():
            return [
                f"it claims an upper end, but a cell of agent `{problem.agents[i].name}` has no certain class: runs "
                "through it are not counted, and pairs may save them"
            ]
    return []


def _wrong_base(problem: Problem, base: Problem, usual: NDArray[np.bool_]) -> list[str]:
    """The base is the problem with every proposition about a pair taken as usual, its states numbered alike."""
    first = problem.labeling.first_pair
    names = problem.labeling.names[:first]
    if [agent.to_dict() for agent in base.agents] != [agent.to_dict() for agent in problem.agents]:
        return ["the agents of its base are not those of the problem"]
    if base.labeling.pairs or base.labeling.names != names:
        return ["the propositions of its base are not those of single agents in the problem"]
    if any(base.propositions[name].to_dict() != problem.propositions[name].to_dict() for name in names):
        return ["a region of its base is not that of the problem"]
    if base.horizon != problem.horizon:
        return ["the horizon of its base is not that of the problem"]
    ours, theirs = problem.automaton, base.automaton
    alike = (ours.n_states, ours.semantics, ours.initial, ours.accepting.tolist())
    if alike != (theirs.n_states, theirs.semantics, theirs.initial, theirs.accepting.tolist()):
        return ["the automaton of its base has other states than that of the problem"]
    if not _move_alike(ours, theirs, first, usual):
        return ["the automaton of its base moves otherwise than that of the problem when all pairs are as usual"]
    return []


def _move_alike(ours: Automaton, theirs: Automaton, first: int, usual: NDArray[np.bool_]) -> bool:
    """Return whether all states lead to the same states for every letter, in ours with all pairs as usual."""
    stack = [(int(a), int(b)) for a, b in zip(ours.root, theirs.root, strict=True)]
    known: set[tuple[int, int]] = set()
    while stack:
        a, b = stack.pop()
        while a >= 0 and ours.variable[a] >= first:
            a = int(ours.high[a] if usual[ours.variable[a] - first] else ours.low[a])
        if (a, b) in known:
            continue
        known.add((a, b))
        if a < 0 and b < 0:
            if a != b:
                return False
            continue
        # Split on the proposition that is tested first; an entry that does not test it stays.
        tested = min(int(diagram.variable[e]) for diagram, e in ((ours, a), (theirs, b)) if e >= 0)
        sides = []
        for diagram, e in ((ours, a), (theirs, b)):
            tests = e >= 0 and int(diagram.variable[e]) == tested
            sides.append((int(diagram.low[e]), int(diagram.high[e])) if tests else (e, e))
        stack += list(zip(*sides, strict=True))
    return True


def _wrong_agents(problem: Problem, base: OnGrid) -> list[str]:
    """The next state of every agent is a lattice point plus Gaussian noise that is independent along its states."""
    failures = []
    for agent, part in zip(problem.agents, base.proof.agents, strict=True):
        if part.relation["kind"] != "exact" or part.input_set is not None:
            failures.append(f"the relation of agent `{agent.name}` is not exact, so pairs cannot be subtracted")
        elif not has_plain_noise(agent):
            failures.append(f"the noise of agent `{agent.name}` is not Gaussian and independent along its states")
    for pair in problem.labeling.pairs:
        for i, outputs in ((pair.first, pair.outputs[0]), (pair.second, pair.outputs[1])):
            axes = [problem.agents[i].output_axis(k) for k in outputs]
            if any(axis is None or axis[1] != 1.0 for axis in axes):
                failures.append(f"a pair compares outputs of agent `{problem.agents[i].name}` that are no states")
    return failures


def has_plain_noise(agent: AnyAgent) -> bool:
    """Return whether the noise is Gaussian, independent along the states, and the same everywhere."""
    covariance = agent.noise_covariance
    gaussian = agent.laws is None or all(isinstance(law, Gaussian) for law in agent.laws)
    axes_fit = agent.laws is None or np.array_equal(agent.noise_axes, np.eye(agent.n_states))
    return bool(
        agent.has_plain_noise and gaussian and axes_fit and not np.any(covariance - np.diag(np.diag(covariance)))
    )


@dataclass(frozen=True, eq=False)
class _Product:
    """A product of masses in a mode: one factor (S_i,) per agent."""

    mode: int
    factors: list[FloatArray]


def _spoiled(problem: Problem, base: OnGrid, usual: NDArray[np.bool_]) -> float:
    """Return an upper bound on the probability that a pair is not as usual while the task is open and asks for it."""
    asked, charges = pairs_asked(problem), _Charges(problem, base, usual)
    charged = _spoiled_at_start(problem, usual, asked[problem.automaton.initial], charges)
    if charged >= 1.0:
        return 1.0
    for _, states, masses in undecided_course(base):
        about = np.flatnonzero(np.any([asked[q] for q in states], axis=0))
        charged += charges.of(about, masses)
    state("differences", base, len(problem.labeling.pairs), RELATIVE)
    return min(1.0, (charged + lost_on_the_way(base)) * RELATIVE)


def _spoiled_at_start(problem: Problem, usual: NDArray[np.bool_], asked: NDArray[np.bool_], charges: _Charges) -> float:
    """Return an upper bound on the probability that a pair that is asked about is not as usual at the start."""
    starts = [agent.initial for agent in problem.agents]
    if all(np.array_equal(start.low, start.high) for start in starts):
        letter = problem.labeling.letter([start.low for start in starts])
        return float(np.any((letter[problem.labeling.first_pair :] != usual) & asked))
    total = Fraction(0)
    for k in np.flatnonzero(asked).tolist():
        pair, near = problem.labeling.pairs[k], Fraction(1)
        first, second = starts[pair.first], starts[pair.second]
        box = zip(*(pair.inner_box if usual[k] else (pair.low, pair.high)), strict=True)
        for (a, b), (low, high) in zip(charges.axes(pair), box, strict=True):
            ends = [float(end) for end in (first.low[a], first.high[a], second.low[b], second.high[b])]
            # Made wider, or narrower, by what the rounding of a difference can move.
            wider = 1e-14 * (sum(map(abs, ends)) + abs(low) + abs(high)) * (-1.0 if usual[k] else 1.0)
            near *= max(Fraction(0), _below(float(high + wider), ends) - _below(float(low - wider), ends))
        total += 1 - near if usual[k] else near
    return float(total) * RELATIVE


def _below(z: float, ends: list[float]) -> Fraction:
    """Return ``P(x - y <= z)``, exactly, for x uniform between the first two ends and y between the last two.

    It is a second difference of ``max(0, s)^2 / 2``, or a first one of ``max(0, s)`` where one of them is a point.
    """
    a, b, c, d = map(Fraction, ends)
    if a == b and c == d:
        return Fraction(a - c <= z)
    order = (a < b) + (c < d)
    lower, upper = ([(a, 1), (b, -1)] if a < b else [(a, 1)]), ([(d, 1), (c, -1)] if c < d else [(c, 1)])
    shifts = [(y - x, sign * other) for x, sign in lower for y, other in upper]
    area, total = (b - a if a < b else Fraction(1)) * (d - c if c < d else Fraction(1)), Fraction(0)
    for shift, sign in shifts:
        beyond = max(Fraction(0), Fraction(z) + shift)
        total += sign * (beyond * beyond / 2 if order == 2 else beyond)
    return total / area


def lost_on_the_way(base: OnGrid) -> float:
    """Return an upper bound on the mass that kernels lose on the way: it may be near, once for each agent."""
    each = (lost_to_rounding(a, p) for a, p in zip(base.problem.agents, base.proof.agents, strict=True))
    return sum(each) * base.problem.horizon


def undecided_course(base: OnGrid) -> Iterator[tuple[int, list[int], list[FloatArray]]]:
    """Yield, for each step and product of the mass of undecided runs, its automaton states and lattice masses.

    The time is that of the step, and masses (Z_1, ..) are those of each agent on the lattice points it moves to.
    """
    modes = modes_of(base)
    arriving = base.proof.guard_source, base.proof.guard_target, base.proof.guard_mask
    masks = [part.masks for part in base.proof.agents]
    passages = {
        (m, n): _passage(masks, arriving, modes[m], modes[n]) for m in range(len(modes)) for n in range(len(modes))
    }
    known: dict[tuple[bytes, ...], list[FloatArray]] = {}
    parts, products = base.proof.agents, _first_products(base, modes)
    tables = [axis_tables(a, p, known) for a, p in zip(base.problem.agents, parts, strict=True)]
    for t in range(base.problem.horizon):
        following = []
        for product in products:
            states = modes[product.mode]
            points = [part.points(t, states[0]) for part in parts]
            yield t, states, [_on_lattice(*own) for own in zip(parts, product.factors, points)]
            pushed = [moved(own[None], to, axes)[0] for own, to, axes in zip(product.factors, points, tables)]
            for n in range(len(modes)):
                if (open_cells := passages[product.mode, n]) is not None:
                    factors = [own * cells for own, cells in zip(pushed, open_cells)]
                    following += [_Product(n, factors)] if all(own.any() for own in factors) else []
        if len(following) > MOST_PRODUCTS:
            raise OverflowError(f"the mass of its undecided runs has more than {MOST_PRODUCTS} products")
        products = following


def pairs_asked(problem: Problem) -> NDArray[np.bool_]:
    """Return which pairs may change where the automaton goes from each state: bool (Q, number of pairs)."""
    automaton, first = problem.automaton, problem.labeling.first_pair
    below: dict[int, frozenset[int]] = {}
    # Nodes that test later propositions come first: their own pairs are known when they are asked for.
    for node in np.argsort(-automaton.variable, kind="stable").tolist():
        own = {int(automaton.variable[node]) - first} if automaton.variable[node] >= first else set()
        ends = (int(automaton.low[node]), int(automaton.high[node]))
        below[node] = frozenset(own).union(*(below[e] for e in ends if e >= 0))
    result = np.zeros((automaton.n_states, len(problem.labeling.pairs)), dtype=bool)
    for q, root in enumerate(automaton.root.tolist()):
        result[q, list(below[root]) if root >= 0 else []] = True
    return result


def modes_of(base: OnGrid) -> list[list[int]]:
    """Return the undecided states in groups in which every policy is the same at all times."""
    modes: list[list[int]] = []
    for q in np.flatnonzero(~base.problem.automaton.absorbing).tolist():
        for states in modes:
            if all(np.array_equal(part.policy[:, q], part.policy[:, states[0]]) for part in base.proof.agents):
                states.append(q)
                break
        else:
            modes.append([q])
    return modes


def _first_products(base: OnGrid, modes: list[list[int]]) -> list[_Product]:
    """Return the mass of undecided runs once the first letter is read: starts of one letter, or by the guards."""
    problem, parts = base.problem, base.proof.agents
    shares = [start_shares(a, p) for a, p in zip(problem.agents, parts, strict=True)]
    if problem.initial_q is not None or all(agent.initial.is_point for agent in problem.agents):
        return [_Product(m, shares) for m, states in enumerate(modes) if problem.initial_q in states]
    source = np.full(len(base.proof.start_target), problem.automaton.initial)
    reading = source, base.proof.start_target, base.proof.start_mask
    products = []
    for m, states in enumerate(modes):
        way = _passage([part.start_masks for part in parts], reading, [problem.automaton.initial], states)
        if way is not None:
            products.append(_Product(m, [own * cells for own, cells in zip(shares, way, strict=True)]))
    return products


def _passage(
    masks: list[NDArray[np.bool_]], guards: tuple[NDArray, NDArray, NDArray], source: list[int], target: list[int]
) -> list[NDArray[np.bool_]] | None:
    """Return, per agent, the cells that some guard between two modes lets through; None if there is no guard.

    ``guards`` has their sources, their targets, and their masks (G, I).
    """
    used = np.isin(guards[0], source) & np.isin(guards[1], target)
    if not used.any():
        return None
    return [own[guards[2][used, i]].any(axis=0) for i, own in enumerate(masks)]


def _on_lattice(part: object, masses: FloatArray, points: NDArray[np.integer]) -> FloatArray:
    """Return the mass on the lattice points (Z_1, ..) that cells move to; cells without a choice move nowhere."""
    shape: tuple[int, ...] = part.lattice_shape  # type: ignore[attr-defined]
    result = np.zeros(int(np.prod(shape)))
    moving = points >= 0
    np.add.at(result, points[moving], masses[moving])
    return result.reshape(shape)


class _Charges:
    """Probabilities that pairs are not as usual after a step, from the lattice points of their agents."""

    def __init__(self, problem: Problem, base: OnGrid, usual: NDArray[np.bool_]) -> None:
        self.problem, self.base, self.usual = problem, base, usual
        self.known: dict[object, FloatArray] = {}

    def of(self, asked: NDArray[np.integer], masses: list[FloatArray]) -> float:
        """Return the sum, over the pairs asked about, of the mass of a product in which they are not as usual."""
        totals = np.array([own.sum() for own in masses])
        total, spread = 0.0, dict[object, FloatArray]()
        for k in asked.tolist():
            pair = self.problem.labeling.pairs[k]
            others = np.delete(totals, [pair.first, pair.second])
            axes = self.axes(pair)
            first = over_axes(masses[pair.first], [a for a, _ in axes])
            stays = bool(self.usual[k])
            names, tables = zip(*(self.table(pair, n, ab, stays) for n, ab in enumerate(axes)))
            key = (pair.second, tuple(b for _, b in axes), names)
            if key not in spread:
                reached = over_axes(masses[pair.second], [b for _, b in axes])
                for n, table in enumerate(tables):
                    reached = np.moveaxis(np.tensordot(reached, table, axes=(n, 1)), -1, n)
                spread[key] = reached
            near = float(np.sum(first * spread[key]))
            if stays:  # all that is not surely near
                near = max(0.0, float(totals[pair.first] * totals[pair.second]) - near) + OWN_ERROR
            total += near * float(np.prod(others))
        return total

    def axes(self, pair: PairRegion) -> list[tuple[int, int]]:
        """Return the states of both agents that are compared."""
        first, second = (self.problem.agents[i] for i in (pair.first, pair.second))
        found = []
        for k, m in zip(*pair.outputs, strict=True):
            a, b = first.output_axis(k), second.output_axis(m)
            assert a is not None and b is not None  # outputs that are no states were refused
            found.append((a[0], b[0]))
        return found

    def table(self, pair: PairRegion, n: int, axes: tuple[int, int], from_below: bool) -> tuple[object, FloatArray]:
        """Return bounds (Z, Z') on being near along comparison n, between two states, and their name before them."""
        a, b = axes
        i, j = pair.first, pair.second
        mine, theirs = self.base.proof.agents[i].lattice[a], self.base.proof.agents[j].lattice[b]
        agents = self.problem.agents
        variances = float(agents[i].noise_covariance[a, a]), float(agents[j].noise_covariance[b, b])
        low, high = (float(end[n]) for end in (pair.inner_box if from_below else (pair.low, pair.high)))
        name = (mine.tobytes(), theirs.tobytes(), *variances, low, high, from_below)
        if name not in self.known:
            self.known[name] = _near_probability((mine, theirs), variances, (low, high), from_below)
        return name, self.known[name]


def over_axes(masses: FloatArray, axes: list[int]) -> FloatArray:
    """Return the mass over some axes, in this order, all others summed."""
    letters = list(range(masses.ndim))
    return np.asarray(np.einsum(masses, letters, axes))


def _near_probability(
    points: tuple[FloatArray, FloatArray],
    variances: tuple[float, float],
    box: tuple[float, float],
    from_below: bool,
) -> FloatArray:
    """Return bounds (Z, Z') on ``P(low <= z - z' + w < high)``, w Gaussian: from above, or ``from_below``.

    The box is made wider, or narrower, by what the rounding of the states and of their difference can move it.
    """
    (mine, theirs), (low, high) = points, box
    gap = np.subtract.outer(mine, theirs)
    size = np.abs(mine).max() + np.abs(theirs).max() + abs(low) + abs(high)
    scale = np.sqrt(2.0 * sum(variances))
    wider = (1e-14 * size + 1e-12 * scale) * (-1.0 if from_below else 1.0)
    below, above = (low - wider - gap) / scale, (high + wider - gap) / scale
    # Of both ways to write the probability, the one with the smaller tails keeps its digits.
    upper = 0.5 * (erfc(below) - erfc(above))
    lower = 0.5 * (erfc(-above) - erfc(-below))
    mass = np.where(below > 0.0, upper, lower)
    spread = -1.0 if from_below else 1.0
    bounds = np.asarray(np.clip(mass * (1.0 + 1e-13 * spread) + OWN_ERROR * spread, 0.0, 1.0))
    state("near", (mine, theirs), variances, box, from_below, bounds)
    return bounds
