"""What an action is worth: a certified lower bound on the expected value of the next state, at the true state.

A certificate's value function obeys ``V_t(x) <= E V_{t+1}(x')`` under its own controllers. The same tree says what
any other input is worth. Let ``v_ri`` be the factors of the vertices of time t before they are smoothed. For an input u
of the team the mean of agent i is ``m_i = A_i x_i + B_i u_i + c_i``, and

    Q_t(x, u) = sum_r prod_i E v_ri(m_i + w_i)  <=  E V_{t+1}(x').

The inputs are continuous, and the mean is that of the true state, not of its cell (docs/theory/shields.md, "What an
action is worth"). Of agents with expressions a box is known that holds it, whatever disturbances do, and the least
expectation over it is taken (``unknown_means``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent, place_of
from ....envs.systems.arguments import tree_text
from ...certificates.proofs import OnGrid
from ...certificates.value_functions import Terms
from ...relations.grids import FloatArray, linear_agent
from ...relations.kinds import Relation, mean_loss, mean_off
from ..claims import regrow, vertices_of
from ..steps import masks_of
from .noise_probabilities import Axis, noise_axes
from .unknown_means import MeanBox

UNIT = 2.0**-53

NUMBERS_AT_ONCE = 1_000_000
"""Most numbers that are held at once while many worlds are asked about: what caches hold is much faster."""


@dataclass(frozen=True, eq=False)
class Vertices:
    """Factors of one time and automaton state before they are smoothed, per agent: distinct ones (n, places), and the
    one of each of R terms (R,)."""

    distinct: tuple[FloatArray, ...]
    which: tuple[NDArray[np.int64], ...]

    @property
    def rank(self) -> int:
        """Number of terms R."""
        return len(self.which[0])


@dataclass(frozen=True, eq=False, repr=False)
class ActionValues:
    """Values of states and of inputs under a certificate, at every time; lower bounds up to rounding.

    What rounding can make of them is in ``relative_loss`` and ``loss``, for whoever builds a claim on them.

    Parameters
    ----------
    certificate : Certificate
    relations : tuple of Relation
    axes : tuple of tuples of Axis
        Per agent and axis of its grid.
    values : tuple of Terms
        Value functions at times 0 .. T - 1.
    vertices : tuple of tuples of Vertices
        By time and automaton state; empty where the task is finished.
    """

    certificate: OnGrid
    relations: tuple[Relation, ...]
    axes: tuple[tuple[Axis, ...], ...]
    values: tuple[Terms, ...]
    vertices: tuple[tuple[Vertices, ...], ...]

    def __repr__(self) -> str:
        terms = max(vertices.rank for time in self.vertices for vertices in time)
        rows = [("times", f"0 .. {len(self.values) - 1}"), ("terms", f"at most {terms}")]
        return tree_text(f"ActionValues of {self.certificate.problem.name!r}", rows)

    def of_states(self, states: tuple[FloatArray, ...], q: NDArray[Any], time: NDArray[Any]) -> FloatArray:
        """Return the values (M,) of states (d_i, M) per agent in automaton states (M,) at times (M,) from 0 to T.

        Where nothing is left to decide, and at the horizon, the value is 1 or 0; outside the workspace it is 0.
        """
        problem = self.certificate.problem
        inside = np.ones(len(q), dtype=bool)
        for agent, x in zip(problem.agents, states, strict=True):
            low, high = agent.workspace.low[:, None], agent.workspace.high[:, None]
            inside &= np.all((low <= x) & (x <= high), axis=0)
        decided = problem.automaton.absorbing[q] | (time >= problem.horizon)
        values = np.where(decided, problem.automaton.accepting[q], 0.0) * inside
        for at, state, which in groups(time, q, inside & ~decided):
            terms = self.values[at]
            for some in pieces(which, len(terms.index[state])):
                values[some] = self._read(terms, state, tuple(x[:, some] for x in states))
        return values

    def _read(self, terms: Terms, q: int, states: tuple[FloatArray, ...]) -> FloatArray:
        """Return the sum of products (M,) of one automaton state at states (d_i, M) inside the workspaces."""
        product = np.ones((len(terms.index[q]), states[0].shape[1]))
        for i, (part, x) in enumerate(zip(self.certificate.proof.agents, states, strict=True)):
            places, weights = part.places_at(x)
            rows, which = np.unique(terms.index[q][:, i], return_inverse=True)
            # One place is the cell itself, several are its corners.
            factors = terms.factors[i][rows]
            read = np.einsum("rmk,mk->rm", factors[:, places], weights)
            product *= read[which]
        return np.asarray(product.sum(axis=0))

    def expected(self, time: int, q: int, i: int, states: tuple[FloatArray, ...], inputs: FloatArray) -> FloatArray:
        """Return agent i's factors of all terms (R, M), expected from states (d_i, M) of all agents; lower bounds.

        ``inputs`` (m, M) are its own.
        """
        agent = self.certificate.problem.agents[i]
        if isinstance(agent, Agent):
            moving, beside = (states[i], inputs), self.beside(i, states)
            box = MeanBox.of(agent, self.axes[i], moving, beside)
        elif agent.has_plain_noise:
            return self.backed_up(time, q, i, self.mean(i, states[i], inputs))
        else:
            # Where there is no noise it matters what means are off by.
            means, off = self.mean(i, states[i], inputs), mean_off(linear_agent(agent, "exact"))
            known = np.ones(means.shape[1], dtype=bool)
            box = MeanBox.around(means - off[:, None], means + off[:, None], self.axes[i], known)
        least = np.minimum.reduce([self.backed_up(time, q, i, *read) for read in box.points])
        vertices = self.vertices[time][q]
        largest = vertices.distinct[i].max(axis=1, initial=0.0)[vertices.which[i]]
        return np.asarray(np.maximum(least - largest[:, None] * box.interpolation_error, 0.0))

    def beside(self, i: int, states: tuple[FloatArray, ...]) -> FloatArray | None:
        """Return the states (l, M) of others that the dynamics of agent i name; None if there are none.

        Inputs of others are no numbers: what an agent's input is worth holds whatever the others apply.
        """
        agents = self.certificate.problem.agents
        agent = agents[i]
        if not agent.others:
            return None
        places = [place_of(name, agents) for name in agent.others]
        unknown = np.full(states[0].shape[1], np.nan)
        return np.array([unknown if p.is_input else states[p.agent][p.component] for p in places])

    def mean(self, i: int, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return the mean (d, M) of the next state of agent i at states (d, M) under inputs (m, M).

        It is off by rounding, which ``loss`` counts.
        """
        agent = linear_agent(self.certificate.problem.agents[i], "exact")
        return np.asarray(agent.A @ x + agent.B @ u + agent.offset[:, None])

    def backed_up(self, time: int, q: int, i: int, places: FloatArray, scales: FloatArray | None = None) -> FloatArray:
        """Return agent i's factors of all terms (R, M), expected around places (d, M) of the axes of its grid.

        Places are means, and numbers of cells where there is no noise; ``scales`` (d, M) are those
        of the noise, 1 by default.
        """
        vertices, scales = self.vertices[time][q], np.ones(places.shape) if scales is None else scales
        rows = zip(self.axes[i], places, scales, strict=True)
        tables = [axis.masses(place, scale) for axis, place, scale in rows]
        factors = vertices.distinct[i]
        # The last axis is one product of matrices; the others, if there are any, go world by world.
        tensor = factors.reshape(-1, tables[-1].shape[1]) @ tables[-1].T
        for table in reversed(tables[:-1]):
            tensor = tensor.reshape(-1, table.shape[1], table.shape[0])
            tensor = np.einsum("rsm,ms->rm", tensor, table, optimize=False)
        return np.asarray(tensor.reshape(len(factors), places.shape[1])[vertices.which[i]])

    def of_inputs(
        self, time: int, q: int, states: tuple[FloatArray, ...], inputs: tuple[FloatArray, ...]
    ) -> FloatArray:
        """Return lower bounds (M,), up to rounding, on the expected value of the next state under inputs (m_i, M).

        All worlds are at one time and in one automaton state. The bound of an input that is no number is no number.
        """
        total = np.empty(states[0].shape[1])
        for some in pieces(np.arange(len(total)), self.work(time, q)):
            product = np.ones((self.vertices[time][q].rank, len(some)))
            here = tuple(x[:, some] for x in states)
            for i, u in enumerate(inputs):
                product *= self.expected(time, q, i, here, u[:, some])
            total[some] = product.sum(axis=0)
        return total

    def certified_inputs(self, states: tuple[FloatArray, ...], q: int, time: int) -> tuple[FloatArray, ...]:
        """Return the inputs (m_i, M) of the certified controllers at one time and in one automaton state."""
        same, found = np.full(states[0].shape[1], q), list[FloatArray]()
        for i, controller in enumerate(self.certificate.controller.agents):
            beside = self.beside(i, states)
            others = None if beside is None else beside[:, None]
            found.append(controller.act(states[i][:, None], same, time, None, None, others)[0][:, 0])
        return tuple(found)

    def work(self, time: int, q: int) -> int:
        """Return how many numbers a question about one world holds."""
        vertices = self.vertices[time][q]
        most = 2 * vertices.rank
        for axes, factors in zip(self.axes, vertices.distinct, strict=True):
            sizes = [axis.size for axis in axes]
            most = max(most, 4 * max(sizes) + len(factors) * math.prod(sizes[:-1]))
        return most

    @property
    def relative_loss(self) -> float:
        """Upper bound on the share by which rounding may raise what is claimed, over a whole episode.

        Per step: a sum over the numbers of each factor and the unions of its vertices, products over the agents and a
        sum over the terms for a state and for an input, weights of corners, and what is done to a budget.
        """
        merge_log, agents = self.certificate.proof.merge_log, self.certificate.proof.agents
        places = sum(part.n_places + 4 * 2 ** len(part.lattice) + 2 for part in agents)
        united = max((len(merges.into) for step in merge_log for merges in step.merges), default=0)
        rank = max(max(v.rank for time in self.vertices for v in time), max(terms.rank for terms in self.values))
        n = len(merge_log) * (places + united + 2 * (len(agents) + rank) + 16)
        return 2.0 * n * UNIT / (1.0 - n * UNIT)

    @property
    def loss(self) -> float:
        """Upper bound on the probability, over a whole episode, that rounding decides: means and cells that are missed.

        The means are those of the certified controllers, and those of any input.
        """
        per_step = 0.0
        triples = zip(self.certificate.problem.agents, self.certificate.proof.agents, self.relations, strict=True)
        for agent, part, relation in triples:
            per_step += relation.rounding_loss(agent, part.grid.edges)
            if isinstance(agent, Agent) or not agent.has_plain_noise:
                continue  # what means are off by is in their boxes
            per_step += mean_loss(linear_agent(agent, "exact"))
        return per_step * len(self.certificate.proof.merge_log) * (1.0 + 1e-9)


def action_values(certificate: OnGrid) -> ActionValues:
    """Return the values of states and inputs under a certificate with a value tree and relations without memory.

    Growing the tree again takes about as long as ``check``.

    Raises
    ------
    ValueError
        If the certificate's tree is broken.
    """
    problem, n_states = certificate.problem, certificate.problem.automaton.n_states
    grown: list[Terms] = [certificate.proof.tree] * problem.horizon
    regrow(certificate, grown.__setitem__)
    masks = [masks_of(part, part.masks) for part in certificate.proof.agents]
    # At the horizon a run has the value 1 in accepting states.
    ones = tuple(np.ones((1, part.n_places)) for part in certificate.proof.agents)
    rows = tuple(np.zeros((int(a), len(ones)), dtype=np.int64) for a in problem.automaton.accepting)
    later = [*grown[1:], Terms(ones, rows)]
    vertices = tuple(
        tuple(_vertices(certificate, t, q, later[t], masks) for q in range(n_states)) for t in range(problem.horizon)
    )
    parts = certificate.proof.agents
    relations = tuple(part.relation_of(agent) for agent, part in zip(problem.agents, parts, strict=True))
    axes = tuple(noise_axes(agent, part) for agent, part in zip(problem.agents, parts, strict=True))
    return ActionValues(certificate, relations, axes, tuple(grown), vertices)


def _vertices(certificate: OnGrid, t: int, q: int, later: Terms, masks: list[NDArray[np.bool_]]) -> Vertices:
    """Return the vertices that are kept at a time in an automaton state, equal factors stored once."""
    if certificate.problem.automaton.absorbing[q]:
        nothing = tuple(np.zeros((0, part.n_places)) for part in certificate.proof.agents)
        return Vertices(nothing, tuple(np.zeros(0, dtype=np.int64) for _ in nothing))
    kept, distinct, which = certificate.proof.merge_log[t].kept[q], [], []
    for factors in vertices_of(certificate, t, q, later, masks):
        number: dict[bytes, int] = {}
        place = np.array([number.setdefault(factors[k].tobytes(), len(number)) for k in kept], dtype=np.int64)
        first = [kept[np.argmax(place == n)] for n in range(len(number))]
        distinct.append(np.ascontiguousarray(factors[first]))
        which.append(place)
    return Vertices(tuple(distinct), tuple(which))


def groups(time: NDArray[Any], q: NDArray[Any], wanted: NDArray[np.bool_]) -> list[tuple[int, int, NDArray[np.int64]]]:
    """Return (time, automaton state, numbers of the wanted worlds there) for all pairs that occur."""
    here = np.flatnonzero(wanted)
    if not len(here):
        return []
    pairs, which = np.unique(np.stack([time[here], q[here]]), axis=1, return_inverse=True)
    which = which.reshape(-1)
    return [(int(t), int(s), here[which == k]) for k, (t, s) in enumerate(pairs.T)]


def pieces(which: NDArray[np.int64], work: int) -> list[NDArray[np.int64]]:
    """Return numbers of worlds in pieces whose work, so many numbers for each, stays within memory."""
    return np.array_split(which, max(1, math.ceil(len(which) * work / NUMBERS_AT_ONCE)))
