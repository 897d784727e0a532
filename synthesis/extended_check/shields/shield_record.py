"""Shields: a certificate turned into a filter of actions that keeps a success probability.

Whatever proposes the inputs, P(success) >= p holds in every episode that starts where the certificate covers it
(docs/theory/shields.md, "The guarantee"). Everything here is a pure function of arrays: the budget of a run is handed
in and handed back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import tree_text
from ....envs.tasks.problem import Problem
from ...certificates.proofs import (
    Capability,
    Certificate,
    OnGrid,
    ProductProof,
    RunProjection,
    VertexProof,
    alike_members,
    certificate_from,
    members_of,
    on_cells,
    require,
    rounded_down,
    seen_by,
    shown_bound,
    start_of_claim,
)
from ...relations.grids import FloatArray
from ..claims import VertexValues, standing
from .q_values import ActionValues, action_values, groups
from .shield_rule import Case, Choice, Valued, decentralised_choice, joint_choice
from .vertex_action_values import VertexActionValues

FORMS = ("joint", "decentralised")


@dataclass(frozen=True, eq=False, repr=False)
class Shield:
    """What keeps the success probability of one task at ``probability``, whoever proposes inputs.

    Parameters
    ----------
    values : ActionValues or VertexActionValues
    probability : float
        The success probability p that is kept.
    form : "joint" or "decentralised"
    owed : float
        Budget that stands for p: p with everything that rounding can take off, at most the certified bound.
    mean : float or None
        Lower bound on the mean value of a start that is drawn from a box; None for a start in a point.
    seen : Seen
        How runs of the problem that is kept are seen by the certificate: states and inputs are those of its agents.
    """

    values: Valued
    probability: float
    form: str
    risk_budget: float
    mean: float | None
    seen: RunProjection

    def __repr__(self) -> str:
        rows = [
            ("keeps", f"P(success) >= {self.probability:.6g}"),
            ("certified", shown_bound(self.values.certificate.lower_bound, None)),
            ("judges", "the inputs of all agents together" if self.form == "joint" else "each agent's input by itself"),
        ]
        return tree_text(f"Shield of {self.problem.name!r}", rows)

    @property
    def problem(self) -> Problem:
        """The problem that the shield keeps."""
        return self.seen.problem

    def value_of(self, states: tuple[FloatArray, ...], q: NDArray[Any], time: NDArray[Any]) -> FloatArray:
        """Return the values (M,) of states (d_i, M) per agent; lower bounds up to rounding, 0 where no run comes to."""
        on_cells = self.seen.automaton_states(q, time)
        values = self.values.of_states(states, np.maximum(on_cells, 0), time)
        return np.where(on_cells >= 0, values, 0.0)

    def first_budget(
        self, states: tuple[FloatArray, ...], q: NDArray[Any], time: NDArray[Any] | None = None
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the budgets (M,) of runs that begin at states (d_i, M) per agent, and which starts are covered (M,).

        Runs begin at time 0, or where learners practise at times (M,) of their own.

        A start in a point begins with what is owed, one in a box with a share of it in proportion to its value. Where
        the value is smaller than that, the start is not covered, and the budget is the value: what can be kept there.
        """
        value = self.value_of(states, q, np.zeros(len(q), dtype=np.int64) if time is None else time)
        asked = np.full(len(q), self.risk_budget)
        if self.mean is not None:  # rounded down twice, so that it stays below the value
            asked = np.minimum(self.risk_budget / self.mean, 1.0) * value
        return np.minimum(asked, value), value >= asked

    def choose(
        self,
        states: tuple[FloatArray, ...],
        q: NDArray[Any],
        time: NDArray[Any],
        budget: FloatArray,
        proposed: tuple[FloatArray, ...],
    ) -> Choice:
        """Return what is applied in M worlds, each at a time of its own.

        Parameters
        ----------
        states : tuple of (d_i, M) arrays
            True states, per agent.
        q, time : (M,) int arrays
            Automaton states, which have read the letters of these states, and times.
        budget : (M,) array
            What is owed, at most the value.
        proposed : tuple of (m_i, M) arrays
            Inputs; what lies outside the input box counts as the nearest input in it, and what is no number is
            refused. Runs that are decided keep them.
        """
        agents = self.values.certificate.problem.agents
        proposed = self.seen.inputs(proposed, time)
        on_cells = self.seen.automaton_states(q, time)
        low = tuple(agent.input_box.low[:, None] for agent in agents)
        high = tuple(agent.input_box.high[:, None] for agent in agents)
        inputs = tuple(np.clip(u, a, b) for u, a, b in zip(proposed, low, high, strict=True))
        ratio, overridden = np.ones(len(q)), np.zeros((len(agents), len(q)), dtype=bool)
        rule = joint_choice if self.form == "joint" else decentralised_choice
        going = ~self.problem.automaton.absorbing[q] & (time < self.problem.horizon) & (on_cells >= 0)
        for at, state, which in groups(time, on_cells, going):
            here = tuple(x[:, which] for x in states)
            certified = self.certified_inputs(here, state, at)
            asked = tuple(u[:, which] for u in inputs)
            found = rule(self.values, Case(at, state, here, asked, certified, low, high, budget[which]))
            for u, applied in zip(inputs, found.inputs, strict=True):
                u[:, which] = applied
            ratio[which], overridden[:, which] = found.ratio, found.overridden
        return Choice(self.seen.given_back(inputs), ratio, overridden)

    def certified_inputs(self, states: tuple[FloatArray, ...], q: int, time: int) -> tuple[FloatArray, ...]:
        """Return the inputs (m_i, M) of the certified controllers at one time and in one automaton state."""
        return self.values.certified_inputs(states, q, time)

    def next_budget(
        self, ratio: FloatArray, states: tuple[FloatArray, ...], q: NDArray[Any], time: NDArray[Any]
    ) -> tuple[FloatArray, FloatArray]:
        """Return budgets and values (M,) of runs that have come to states (d_i, M), given the ratios of their choices.

        ``b' = rho V'``: the value is that of the new state under its true letter, at the new time.
        """
        value = self.value_of(states, q, time)
        return ratio * value, value


@dataclass(frozen=True, eq=False, repr=False)
class ProductShield:
    """Shields of independent tasks, which together keep ``probability``.

    Each task keeps a power of its bound, so that the product is p. Noises of different tasks are independent, and what
    one task does may depend on the past of all: the product of the budgets is a budget of the whole.

    Parameters
    ----------
    certificate : Certificate
    probability : float
    parts : tuple of Shield
        One for each of ``problem.tasks``, in order.
    """

    certificate: Certificate[ProductProof]
    probability: float
    parts: tuple[Shield, ...]

    def __repr__(self) -> str:
        rows = [("keeps", f"P(success) >= {self.probability:.6g}"), ("tasks", len(self.parts))]
        return tree_text(f"Shield of {self.problem.name!r}", rows)

    @property
    def problem(self) -> Problem:
        """The whole problem."""
        return self.certificate.problem


@dataclass(frozen=True, eq=False)
class _Source:
    """What shields of one task are made of, whatever they keep.

    ``mean`` is a lower bound on the mean value of a start in a box, None for a start in a point; ``most`` is the
    largest probability that can be kept.
    """

    values: Valued
    mean: float | None
    most: float
    seen: RunProjection

    @classmethod
    def of(cls, whole: Certificate) -> _Source:
        """Return the source of a certificate that can be a shield, and stands."""
        values: Valued
        if isinstance(whole.proof, VertexProof):
            values = VertexActionValues(whole, VertexValues(whole))
        else:
            values = action_values(on_cells(whole))
        certificate, problem = values.certificate, values.certificate.problem
        if start_of_claim(certificate) == "mean":
            least = mean = certificate.lower_bound
            if isinstance(values, ActionValues):
                # The claim takes rounding off, so that it is below the mean of what is read at starts.
                claim = replace(values.certificate.claim, value=values.values[0])
                low, high = (
                    np.concatenate([getattr(a.initial, side) for a in problem.agents]) for side in ("low", "high")
                )
                least = mean = claim.mean(low, high)
        else:
            states, mean = tuple(agent.initial.low[:, None] for agent in problem.agents), None
            holds = np.concatenate([problem.labeling.class_at(i, x) for i, x in enumerate(states)])
            q = problem.automaton.next_state(np.full(1, problem.automaton.initial), holds)
            least = float(values.of_states(states, q, np.zeros(1, dtype=np.int64))[0])
        most = max(0.0, (least * (1.0 - values.relative_loss) - values.loss) * (1.0 - 1e-14))
        return cls(values, mean, most, seen_by(whole))

    def renamed(self, whole: Certificate) -> _Source:
        """Return the source of a certificate that differs in names alone."""
        held: Any = whole if isinstance(whole.proof, VertexProof) else on_cells(whole)
        return replace(self, values=replace(self.values, certificate=held), seen=seen_by(whole))

    def shield(self, p: float, form: str) -> Shield:
        """Return the shield that keeps p, at most ``most``."""
        # What rounding may take off is owed on top of p.
        risk_budget = (p + self.values.loss) / (1.0 - self.values.relative_loss) * (1.0 + 1e-15)
        return Shield(self.values, p, form, risk_budget, self.mean, self.seen)


def _check_member(member: Certificate) -> None:
    """Raise ValueError, with what to do, unless a certificate of one task can be a shield."""
    if not isinstance(member.proof, VertexProof):
        require(member, Capability.VALUES)
        _check_certificate(on_cells(member))
    elif member.problem.agents[0].angles or member.proof.grid.matrix is not None:
        raise ValueError(
            f"`certificate`: expected a grid of the states of agent `{member.problem.agent_names[0]}`, got one of "
            "other coordinates, or with an angle: a shield does not know which number stands for a state there"
        )


def _check_certificate(certificate: OnGrid) -> None:
    """Raise ValueError, with what to do, unless a certificate on cells can be a shield."""
    if certificate.proof.terms is None:
        raise ValueError(
            "`certificate`: expected one with a value tree, got tensor trains, whose factors have both signs: shields "
            "judge by least factors, which bound no such sum; grow a tree of the same policies, "
            '`synthesize(problem, start=certificate, search=SearchOptions(value="tree"))`'
        )
    for agent, part in zip(certificate.problem.agents, certificate.proof.agents, strict=True):
        relation = part.relation_of(agent)
        if part.is_linear and agent.laws is not None and any(law.name != "gaussian" for law in agent.laws):
            raise ValueError(
                f"`certificate`: expected Gaussian noise under linear cells, got another law for agent `{agent.name}`; "
                'synthesize with `relation="exact"` or "boxes"'
            )
        if agent.angles:
            raise ValueError(
                f"`certificate`: expected states that are numbers, got the angle {agent.angles[0]!r} of agent "
                f"`{agent.name}`; a shield knows no masses over windings; give the state a workspace of several turns, "
                "and leave it out of `angles`"
            )
        if relation.delta > 0.0:
            raise ValueError(
                f"`certificate`: expected relations with delta = 0, got {relation.delta:.3g} for agent "
                f"`{agent.name}`; what may be lost at every step cannot be promised to a learner; synthesize with "
                '`relation="linear"`, "exact" or "boxes"'
            )
        if relation.has_memory:
            raise ValueError(
                f"`certificate`: expected relations without memory, got {relation.kind!r} for agent `{agent.name}`; "
                'synthesize with `relation="linear"`, "exact" or "boxes"'
            )


def shield_of(certificate: Any, probability: float, form: str = "joint") -> Shield | ProductShield:
    """Return the shield of a certificate, which is checked first, once.

    Parameters
    ----------
    certificate : Synthesis, certificate or path of one
        With a value tree, and relations without memory (``exact``, ``linear``, ``boxes``); or on the grid of vertices
        of one agent.
    probability : float
        Success probability p to keep, above 0 and at most the certified bound (less what rounding may take off).
    form : "joint" or "decentralised"
        Whether the inputs of a team are judged together, or each agent judges its own.

    Raises
    ------
    ValueError
        If the certificate cannot be a shield, ``check`` refuses it, or p is out of range; the text says what to do.
    """
    certificate, p = certificate_from(certificate), _checked(probability, form)
    for member in members_of(certificate):
        _check_member(member)
    certificate = standing(certificate)
    if isinstance(certificate.proof, VertexProof) or on_cells(certificate) is not None:
        source = _Source.of(certificate)
        if p > source.most:
            raise ValueError(_too_much(p, source.most))
        return source.shield(p, form)
    if certificate.proof.factors and not certificate.problem.groups:
        raise ValueError(
            "`certificate`: expected values of the whole task, got a product of those of independent tasks; synthesize "
            "it with `relation`, which keeps the team together, or shield the problems of `.tasks_apart` one by one"
        )
    # Tasks that differ in names alone share their tables.
    sources = {k: _Source.of(members_of(certificate)[same[0]]) for same in alike_members(certificate) for k in same}
    most = math.prod(source.most for source in sources.values())
    if p > most:
        raise ValueError(_too_much(p, most))
    # The same power of each bound: tasks that are surer keep more. With p = 1 = bound any power will do.
    power = math.log(p) / math.log(most) if most < 1.0 else 1.0
    parts = []
    for k, part in enumerate(members_of(certificate)):
        # Rounded up, as far as possible: the product must not fall below p.
        kept = min(sources[k].most ** power * (1.0 + 1e-13), sources[k].most)
        parts.append(sources[k].renamed(part).shield(kept, form))
    return ProductShield(certificate, p, tuple(parts))


def _checked(probability: Any, form: str) -> float:
    """Return a probability above 0; raise ValueError if it is none, or if there is no such form."""
    if form not in FORMS:
        raise ValueError(f"`form`: expected {' or '.join(map(repr, FORMS))}, got {form!r}")
    if isinstance(probability, bool) or not isinstance(probability, int | float) or not 0.0 < probability <= 1.0:
        raise ValueError(f"`probability`: expected a number above 0 and at most 1, got {probability!r}")
    return float(probability)


def _too_much(p: float, most: float) -> str:
    return (
        f"`probability`: expected at most {rounded_down(max(most, 0.0), 6)}, what the certificate promises from its "
        f"start less rounding, got {p:.6g}; take less, or a better certificate (more cells)"
    )
