"""The claim of a certificate in ball arithmetic: from the decimals of the problem to the bound, every rounding counted.

``check`` computes in double precision, with allowances derived by hand. Here the numbers of the claim are computed once
more as balls (python-flint, the extra ``rigorous``): normal distribution, kernel, products and sums of the value tree,
what the controllers may be off by, admissible inputs, tubes. A certificate stands if the lower end of the last ball is
at least what it claims. Which vertices there are, which guards lead where and whether cells are disjoint are questions
of whole numbers and of comparing doubles; these answers are those of ``check``, which comes first.

It speaks of the lower bound at the start; the upper end of a claim and other starts are left to ``check``. It reaches
value trees under relations that are never lost (``exact`` and ``tube``) on cells that are boxes of states, for linear
agents with normal noise that is the same everywhere. Everything else is refused before a ball is computed
(``ball_facts.unreached``): what is not read must not be left out in silence.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nextafter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.suite import as_problem
from ..cells import linear_agent
from ..certificates import (
    AgentPart,
    Certificate,
    PairsCertificate,
    PathCertificate,
    ProductCertificate,
    TeamCertificate,
    any_certificate,
    as_certificate,
)
from .certificate_check import check

REACH = 9.5
"""Standard deviations beyond which masses count as 0, which leaves a lower bound."""

Balls = Any
"""Array of balls (``ball_facts``)."""


@dataclass(frozen=True)
class RigorousReport:
    """Outcome of ``check_rigorous``: truthy if the certificate stands.

    Parameters
    ----------
    valid : bool
    claimed : float
        The certificate's lower bound.
    low, high : float
        Ends of the ball around the recomputed bound, rounded outwards; NaN if it was not reached.
    failures : tuple of str
        What is wrong, in words.
    """

    valid: bool
    claimed: float
    low: float
    high: float
    failures: tuple[str, ...]

    def __bool__(self) -> bool:
        return self.valid

    def __str__(self) -> str:
        if self.valid:
            return f"proved in balls: claimed {self.claimed:.15g}, recomputed in [{self.low:.15g}, {self.high:.15g}]"
        return "NOT proved: " + "; ".join(self.failures)


def check_rigorous(certificate: Any, problem: Any = None) -> RigorousReport:
    """Verify the lower bound of a certificate at its start in ball arithmetic.

    Parameters
    ----------
    certificate : Synthesis, Certificate, ProductCertificate or path
    problem : Problem, id or path, optional
        As for ``check``, which is asked first.

    Raises
    ------
    ValueError
        If the certificate is of a kind that is not reached, or python-flint is not installed.
    """
    try:
        from .ball_facts import binary
    except ImportError:
        raise ValueError("`--rigorous`: needs python-flint; pip install 'certigym[rigorous]'") from None
    given = any_certificate(certificate)
    # A joint agent is one linear agent: that it is the team is for ``check`` to say.
    certificate = given.base if isinstance(given, TeamCertificate) else given
    if isinstance(certificate, PairsCertificate):
        raise ValueError(
            "`--rigorous`: expected a task without pairs of agents, or a joint agent, got one by subtraction, "
            "whose masses of near pairs have no balls; leave it out: `check` verifies this certificate as well"
        )
    if isinstance(certificate, PathCertificate):
        raise ValueError(
            "`certificate`: expected one on grids, got one along a path; `check` bounds the rounding of its numbers "
            "already"
        )
    certificate = as_certificate(certificate)
    problem = given.problem if problem is None else as_problem(problem)
    parts = [(certificate, 1)]
    if isinstance(certificate, ProductCertificate):
        parts = [(certificate.parts[same[0]], len(same)) for same in certificate.alike]
    for part, _ in parts:
        _refuse_others(part)
    plain = check(given, problem)
    if not plain:
        return RigorousReport(False, certificate.lower_bound, float("nan"), float("nan"), plain.failures)
    total, nothing, failures = binary(1.0)[()], binary(0.0)[()], list[str]()
    for part, times in parts:
        ball, wrong = _ball_of(part)
        failures += wrong
        total = total * ball.max(nothing) ** times  # that a probability is at least 0 needs no proof
    bounds = [*certificate.bounds.values()] if isinstance(certificate, Certificate) else []
    for value in [certificate.lower_bound, *bounds]:
        if not binary(value)[()] <= total:
            failures.append(f"its bound {value:.15g} was not proved")
    low, high = nextafter(float(total.lower()), -inf), nextafter(float(total.upper()), inf)
    return RigorousReport(not failures, certificate.lower_bound, low, high, tuple(failures))


def _refuse_others(certificate: Certificate) -> None:
    """Refuse certificates that ball arithmetic does not reach."""
    from .ball_facts import unreached

    pairs = zip(certificate.problem.agents, certificate.agents, strict=True)
    wrong = next((text for text in (unreached(*pair) for pair in pairs) if text is not None), None)
    if certificate.rounding is not None:
        wrong = "a value tree, got tensor trains, whose rounding has no balls"
    if wrong is not None:
        raise ValueError(f"`--rigorous`: expected {wrong}; leave it out: `check` verifies this certificate as well")


def _ball_of(certificate: Certificate) -> tuple[Any, list[str]]:
    """Ball around the bound at the start that the policies prove, and what is wrong with their relations."""
    from .ball_facts import BallFacts, binary, facts_of

    failures, loss, deviations = list[str](), binary(0.0)[()], []
    known: dict[object, BallFacts] = {}
    problem = certificate.problem
    for agent, part, own in zip(problem.agents, certificate.agents, certificate.controller.agents, strict=True):
        agent = linear_agent(agent, own.relation.kind)
        arrays = [agent.A, agent.B, agent.offset, agent.noise_covariance, agent.input_box.low, agent.input_box.high]
        # All that facts are read from: the lattice and its menu are the part's own, too.
        arrays += [part.coordinates, part.policy, *part.lattice, *([] if part.menu is None else [part.menu])]
        key = (id(part.grid), str(part.relation), *agent.noise_key, *(array.tobytes() for array in arrays))
        if key not in known:
            known[key] = facts_of(agent, part, own.relation)
        failures += [f"agent `{agent.name}`: {text}" for text in known[key].failures]
        loss = loss + known[key].loss
        deviations.append(known[key].deviations)
    tree = _Tree(certificate, [_Kernel(part, own) for part, own in zip(certificate.agents, deviations, strict=True)])
    value = tree.grown().start_value() - problem.horizon * loss
    return value, failures


class _Kernel:
    """Masses of cells around lattice points, along each axis, computed when they are first asked for."""

    def __init__(self, part: AgentPart, deviations: Balls) -> None:
        from .ball_facts import binary, decimal

        self.part, self.deviations, self.zero = part, deviations, binary(0.0)[()]
        self.edges, self.lattice = [decimal(e) for e in part.grid.edges], [decimal(z) for z in part.lattice]
        self.known: list[dict[int, Balls]] = [{} for _ in self.edges]

    def row(self, axis: int, point: int) -> Balls:
        """Masses (S_k,) of the cells of one axis around one of its lattice points."""
        if point not in self.known[axis]:
            z, edges = float(self.part.lattice[axis][point]), self.part.grid.edges[axis]
            near = REACH * float(self.deviations[axis])
            first, last = np.searchsorted(edges, [z - near, z + near])
            first, last = max(0, int(first) - 1), min(len(edges), int(last) + 1)
            scale = self.deviations[axis] * _root_of_two()
            places = (self.edges[axis][first:last] - self.lattice[axis][point]) / scale
            below = np.array([(-place).erfc() / 2 for place in places] + [None], dtype=object)[:-1]
            row = np.full(len(edges) - 1, self.zero, dtype=object)
            row[first : first + max(0, len(below) - 1)] = below[1:] - below[:-1]
            self.known[axis][point] = row
        return self.known[axis][point]

    def smooth(self, rows: Balls, points: NDArray[np.integer]) -> Balls:
        """Expected value (n, S) of rows (n, S) around the lattice point (S,) of each cell; 0 where there is none."""
        from flint import arb_mat

        cells = np.flatnonzero(points >= 0)
        index = np.unravel_index(points[cells], self.part.lattice_shape)
        tensor, places = rows.reshape(len(rows), *self.part.grid.shape), []
        for axis, wanted in enumerate(index):
            used, place = np.unique(wanted, return_inverse=True)
            places.append(place)
            tensor = np.moveaxis(tensor, 1, -1)  # the axis that is next comes to the end, what it becomes stays there
            lead, size = tensor.shape[:-1], tensor.shape[-1]
            table = [mass for point in used.tolist() for mass in self.row(axis, point)]
            left = arb_mat(int(np.prod(lead)), size, tensor.ravel().tolist())
            product = left * arb_mat(len(used), size, table).transpose()
            tensor = np.array([*product.entries(), None], dtype=object)[:-1].reshape(*lead, len(used))
        result = np.full((len(rows), len(points)), self.zero, dtype=object)
        if len(cells):
            result[:, cells] = tensor[(slice(None), *places)]
        return result


class _Tree:
    """The value tree of a certificate, grown again in balls as ``regrown_tree`` grows it in double precision."""

    def __init__(self, certificate: Certificate, kernels: list[_Kernel]) -> None:
        from .ball_facts import binary

        self.certificate, self.kernels, self.one = certificate, kernels, binary(1.0)[()]
        self.zero, n_agents = binary(0.0)[()], len(kernels)
        accepting = certificate.problem.automaton.accepting
        self.factors: list[list[Balls]] = [[self._ones(part)] for part in certificate.agents]
        self.index = [np.zeros((int(yes), n_agents), dtype=np.int64) for yes in accepting]

    def _ones(self, part: AgentPart) -> Balls:
        return np.full(part.grid.n_cells, self.one, dtype=object)

    def grown(self) -> _Tree:
        """The tree at time 0."""
        for t in reversed(range(len(self.certificate.skeleton))):
            self._step(t)
        return self

    def _step(self, t: int) -> None:
        """The tree one step earlier."""
        certificate, step = self.certificate, self.certificate.skeleton[t]
        stacks, index = [[self._ones(part)] for part in certificate.agents], []
        for q, (origin, merges, kept) in enumerate(zip(step.origin, step.merges, step.kept, strict=True)):
            rows = np.zeros((len(kept), len(stacks)), dtype=np.int64)
            if certificate.problem.automaton.finished[q]:
                index.append(np.zeros((1, len(stacks)), dtype=np.int64))
                continue
            below = self._children(origin)
            for i, part in enumerate(certificate.agents):
                keys = np.stack([certificate.guard_mask[origin[:, 0], i], below[:, i]], axis=1)
                united = _united(keys, merges.into, merges.absorbed, merges.agent == i)
                distinct, where = np.unique([united[1][k] for k in kept.tolist()], return_inverse=True)
                rows[:, i] = where + len(stacks[i])
                if len(distinct):
                    vertices = self._vertices(united[0], distinct.astype(np.int64).tolist(), i)
                    stacks[i] += list(self.kernels[i].smooth(vertices, part.points(t, q)))
            index.append(rows)
        self.factors, self.index = stacks, index

    def _children(self, origin: NDArray[np.integer]) -> NDArray[np.int64]:
        """Factor indices (N, I) of the terms that vertices lead to."""
        below = np.zeros((len(origin), len(self.kernels)), dtype=np.int64)
        targets = self.certificate.guard_target[origin[:, 0]]
        for q in np.unique(targets):
            below[targets == q] = self.index[q][origin[targets == q, 1]]
        return below

    def _vertices(self, recipes: list[tuple[int, ...]], wanted: list[int], i: int) -> Balls:
        """Factors (n, S) of agent i before smoothing, by their recipes."""
        needed = set(wanted)
        for name in reversed(range(len(recipes))):  # what a recipe needs has a smaller number
            if name in needed and len(recipes[name]) == 3:
                needed.update(recipes[name][1:])
        made: dict[int, Balls] = {}
        masks = self.certificate.agents[i].masks
        for name in sorted(needed):
            recipe = recipes[name]
            if len(recipe) == 2:
                made[name] = np.where(masks[recipe[0]], self.factors[i][recipe[1]], self.zero)
            elif recipe[0]:
                made[name] = made[recipe[1]] + made[recipe[2]]
            else:
                made[name] = np.array([a.min(b) for a, b in zip(made[recipe[1]], made[recipe[2]], strict=True)])
        return np.stack([made[name] for name in wanted])

    def start_value(self) -> Any:
        """Ball around the value at the start of the problem, over the products that the start falls into."""
        certificate, problem = self.certificate, self.certificate.problem
        shares = [_shares(agent, part) for agent, part in zip(problem.agents, certificate.agents, strict=True)]
        automaton, total = problem.automaton, self.zero
        if certificate.start == "point" or automaton.finished[automaton.initial]:  # no letter is asked
            q = problem.initial_q if certificate.start == "point" else automaton.initial
            return total if q is None else self._averaged(int(q), shares)
        for q, masks in zip(certificate.start_target.tolist(), certificate.start_mask.tolist(), strict=True):
            parts = zip(shares, certificate.agents, masks, strict=True)
            total = total + self._averaged(q, [np.where(p.start_masks[m], own, self.zero) for own, p, m in parts])
        return total

    def _averaged(self, q: int, shares: list[Balls]) -> Any:
        """Sum over the terms of a state of the products of their averages."""
        total, known = self.zero, [dict[int, Any]() for _ in shares]
        for row in self.index[q].tolist():
            product = self.one
            for i, k in enumerate(row):
                if k not in known[i]:
                    used = np.flatnonzero([not own.is_zero() for own in shares[i]])
                    known[i][k] = sum((self.factors[i][k][used] * shares[i][used]).tolist(), self.zero)
                product = product * known[i][k]
            total = total + product
        return total


def _root_of_two() -> Any:
    """Ball around the square root of 2."""
    from .ball_facts import binary

    return binary(2.0)[()].sqrt()


def _united(
    keys: NDArray[np.integer], into: NDArray[np.integer], absorbed: NDArray[np.integer], own: NDArray[np.bool_]
) -> tuple[list[tuple[int, ...]], list[int]]:
    """Recipes of an agent's factors, and which of them each vertex has once it was united.

    A recipe is a mask and a factor, or whether two earlier ones are added (else their minimum is taken) and which.
    """
    recipes: dict[tuple[int, ...], int] = {}
    names = [recipes.setdefault((int(m), int(c)), len(recipes)) for m, c in keys]
    for a, b, is_sum in zip(into.tolist(), absorbed.tolist(), own.tolist(), strict=True):
        names[a] = recipes.setdefault((int(is_sum), names[a], names[b]), len(recipes))
    return list(recipes), names


def _shares(agent: Any, part: AgentPart) -> Balls:
    """Shares (S,) of the start in each cell, as balls."""
    from .ball_facts import binary, decimal

    shares = binary(np.ones(1))
    for edges, a, b in zip(part.grid.edges, agent.initial.low, agent.initial.high, strict=True):
        left, right = edges[:-1], edges[1:]
        if a == b:
            here = (left <= a) & (a < right)
            here[-1] |= bool(a == right[-1])
            axis = binary(here.astype(float))
        else:
            overlap = decimal(np.minimum(right, b)) - decimal(np.maximum(left, a))
            axis = np.where(np.minimum(right, b) > np.maximum(left, a), overlap, binary(0.0)[()])
            axis = axis / (decimal(b)[()] - decimal(a)[()])
        shares = (shares[:, None] * axis).ravel()
    return shares
