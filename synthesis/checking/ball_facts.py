"""Facts about one agent in ball arithmetic: what its controller may be off by, and whether its relation holds.

Every number of the problem, of the grid and of the lattice is read from its shortest decimal; the numbers of the
controller are the binary ones that it computes with. The analysis of ``execution`` is repeated in balls (python-flint):
only that each operation of the controller has a relative error of 2^-53 is taken from there. Edges that a controller
compares with are binary, those of the problem decimal: what lies between them is charged as a misread cell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from flint import arb, ctx

from ...envs.agents import AnyAgent, LinearAgent
from ..certificates import AgentPart
from ..relations import CoupledRelation, ExactRelation, Relation
from .execution import execution_of
from .relation_check import MOST_TERMS, label_margin

BITS = 96
"""Precision of the balls: twice that of double numbers, less what sums of a million terms lose."""

UNIT = 2.0**-53

DENSITY = "0.39895"
"""Upper bound on the density of the standard normal law."""

Balls = Any
"""Array of balls; numpy adds, multiplies and indexes them as objects."""


class NoBallsError(ValueError):
    """Ball arithmetic does not reach this certificate; the text says what is left."""


@dataclass(frozen=True, eq=False)
class BallFacts:
    """What is known of one agent: ``loss`` per step (ball), standard deviations (d,) and what is wrong, in words."""

    loss: Any
    deviations: Balls
    failures: tuple[str, ...]


def decimal(values: Any) -> Balls:
    """Return balls around the shortest decimals of double numbers, in the same shape."""
    ctx.prec = BITS
    array = np.asarray(values, dtype=float)
    return np.array([arb(repr(x)) for x in array.ravel().tolist()] + [None], dtype=object)[:-1].reshape(array.shape)


def binary(values: Any) -> Balls:
    """Return balls that are the double numbers themselves, in the same shape."""
    ctx.prec = BITS
    array = np.asarray(values, dtype=float)
    return np.array([arb(x) for x in array.ravel().tolist()] + [None], dtype=object)[:-1].reshape(array.shape)


def largest(balls: Sequence[Any]) -> Any:
    """Return a ball around the largest of some."""
    return reduce(lambda one, other: one.max(other), balls)


def unreached(agent: AnyAgent, part: AgentPart) -> str | None:
    """Return what was expected of an agent and of its cells, and what came, where balls do not reach them; else None.

    Whatever an agent declares is either read by ``facts_of`` and the kernel in balls, or refused here: a variance says
    nothing of the law that it belongs to.
    """
    covariance, kind = agent.noise_covariance, part.relation["kind"]
    if not isinstance(agent, LinearAgent):
        return f"linear agents, got `{agent.name}` with expressions, which have no balls"
    if agent.laws is not None:
        laws = ", ".join(sorted({law.name for law in agent.laws}))
        return f"normal noise, got other laws of agent `{agent.name}` ({laws}), whose masses have no balls"
    if agent.noise_scale is not None:
        return f"noise that is the same everywhere, got a `noise_scale` of agent `{agent.name}`"
    if np.any(np.diag(covariance) <= 0.0):
        return f"noise in every state, got a state of agent `{agent.name}` without, whose next cell has no balls"
    if kind not in ("exact", "tube"):
        return f"the relations `exact` and `tube`, got `{kind}` of agent `{agent.name}`"
    if not np.array_equal(part.coordinates, np.eye(agent.n_states)) or np.any(
        covariance - np.diag(np.diag(covariance))
    ):
        return f"cells that are boxes of states, got those of correlated noise of agent `{agent.name}`"
    return None


def facts_of(agent: LinearAgent, part: AgentPart, relation: Relation) -> BallFacts:
    """Return what is known of an agent with normal noise whose cells are boxes of its states.

    Raises
    ------
    NoBallsError
        For agents, cells and relations that balls do not reach (``unreached``).
    """
    wrong = unreached(agent, part)
    if wrong is not None:
        raise NoBallsError(f"expected {wrong}")
    if not isinstance(relation, ExactRelation | CoupledRelation) or relation.kind != part.relation["kind"]:
        raise NoBallsError(f"agent `{agent.name}` has the relation `{relation.kind}`, which balls do not reach")
    sizes = _Sizes.of(agent, part)
    if isinstance(relation, ExactRelation):
        return _exact_facts(agent, part, relation, sizes)
    return _tube_facts(agent, part, relation, sizes)


@dataclass(frozen=True, eq=False)
class _Sizes:
    """The agent in decimals, and the largest states ``x``, lattice points ``z`` and inputs ``u``."""

    A: Balls
    B: Balls
    c: Balls
    x: Balls
    z: Balls
    u: Balls
    deviations: Balls
    narrow: Balls
    unit: Any

    @classmethod
    def of(cls, agent: LinearAgent, part: AgentPart) -> _Sizes:
        """Return the sizes of an agent on its cells."""
        edges, lattice, box = part.grid.edges, part.lattice, agent.input_box
        return cls(
            A=decimal(agent.A), B=decimal(agent.B), c=decimal(agent.offset),
            x=np.array([largest([abs(decimal(axis[0])[()]), abs(decimal(axis[-1])[()])]) for axis in edges]),
            z=np.array([abs(decimal(axis[np.argmax(np.abs(axis))])[()]) for axis in lattice]),
            u=np.array([largest(list(ends)) for ends in zip(abs(decimal(box.low)), abs(decimal(box.high)))]),
            deviations=np.array([own.sqrt() for own in decimal(np.diag(agent.noise_covariance))]),
            narrow=np.array([-largest([a - b for a, b in zip(d, d[1:])]) for d in map(decimal, edges)]),
            unit=arb((4 * (agent.n_states + agent.n_inputs) + 16) * UNIT),
        )  # fmt: skip

    def misread(self, off: Balls) -> Any:
        """Mass of the next state within ``off`` (d,) of any cell edge, at most."""
        return (2 * off * (1 / self.narrow + arb(DENSITY) / self.deviations)).sum()

    @property
    def read(self) -> Balls:
        """What decimals of edges are off from the numbers that controllers compare with."""
        return self.x * arb(UNIT)


def _exact_facts(agent: LinearAgent, part: AgentPart, relation: ExactRelation, s: _Sizes) -> BallFacts:
    """As ``execution``: the mean ``A x + B (R (z - d - A_r x) + mid) + c`` is to be z, by an input in the box."""
    A, R = binary(relation.A), binary(relation.right_inverse)
    drift, middle = binary(relation.drift), binary(relation.input_centre)
    asked = abs(R) @ (s.z + abs(drift) + abs(A) @ s.x) + abs(middle)
    moved = s.B @ R
    size = abs(s.A) @ s.x + abs(s.B) @ asked + abs(s.c) + s.z
    off = abs(s.A - moved @ A) @ s.x + abs(moved - binary(np.eye(len(A)))) @ s.z
    off = off + abs(s.c + s.B @ middle - moved @ drift) + s.unit * size
    distance = ((off / s.deviations) ** 2).sum().sqrt()
    loss = (distance / (2 * arb(2).sqrt())).erf() + s.misread(s.read)
    inputs = s.unit * asked
    fits = _targets_fit(agent, part, (A, R, drift, middle, inputs))
    failures = () if fits else ("it is asked for inputs beyond its input box",)
    return BallFacts(loss, s.deviations, failures)


def _targets_fit(agent: LinearAgent, part: AgentPart, numbers: tuple[Balls, ...]) -> bool:
    """Whether every target of every cell takes inputs of the box only, from all points of the cell."""
    A, R, drift, middle, rounding = numbers
    points, n_cells = int(np.prod(part.lattice_shape)), part.grid.n_cells
    chosen = part.policy.astype(np.int64) + np.arange(n_cells) * points
    cell, target = np.divmod(np.unique(chosen[part.policy >= 0]), points)
    axes = [decimal(axis) for axis in part.grid.edges]
    index = np.unravel_index(np.arange(n_cells), part.grid.shape)
    centre = np.stack([((e[1:] + e[:-1]) / 2)[k] for e, k in zip(axes, index, strict=True)], axis=1)
    half = np.stack([((e[1:] - e[:-1]) / 2)[k] for e, k in zip(axes, index, strict=True)], axis=1)
    base = middle - (centre @ A.T + drift) @ R.T
    spread = half @ abs(R @ A).T + rounding
    places = zip(part.lattice, np.unravel_index(target, part.lattice_shape), strict=True)
    goal = np.stack([decimal(axis)[k] for axis, k in places], axis=1)
    inputs = base[cell] + goal @ R.T
    low, high = decimal(agent.input_box.low), decimal(agent.input_box.high)
    inside = (inputs - spread[cell] >= low) & (inputs + spread[cell] <= high)
    return bool(np.all(inside))


def _tube_facts(agent: LinearAgent, part: AgentPart, relation: CoupledRelation, s: _Sizes) -> BallFacts:
    """As ``relation_check``: an invariant zonotope, inputs with room for the feedback, labels that allow for it."""
    A, B, K, drift = (binary(own) for own in (relation.A, relation.B, relation.feedback, relation.drift))
    size = s.x + abs(A) @ s.x + abs(B) @ s.u + abs(drift) + s.z
    landed = abs(s.A - A) @ s.x + abs(s.B - B) @ s.u + abs(s.c - drift) + abs(A) @ s.read + s.read + s.unit * size
    error = s.read + s.unit * s.x
    rounding = landed + (abs(s.B) @ abs(K)) @ error
    spare = abs(K) @ error + s.unit * s.u
    disturbance = _half_cells(part) + _snapped(part, relation, (A, B, drift)) + rounding
    support = _supports(A + B @ K, disturbance, np.concatenate([K, binary(part.coordinates)]))
    failures = []
    if support is None or np.any(relation.coupling):
        return BallFacts(s.misread(rounding), s.deviations, ("its tube was not proved invariant",))
    reserve, margin = support[: len(K)] + spare, support[len(K) :]
    inputs, low, high = binary(relation.inputs), decimal(agent.input_box.low), decimal(agent.input_box.high)
    if not np.all((inputs - reserve >= low) & (inputs + reserve <= high)):
        failures.append("its abstract inputs leave no room for the feedback")
    # Guards were verified with these margins, whose sums were rounded outwards by more than their rounding.
    used = label_margin(part, relation, execution_of(agent, part, relation))
    if used is None or not np.all(margin * (1 + arb("1e-12")) <= binary(used)):
        failures.append("its labels allow for less than its tube")
    return BallFacts(s.misread(rounding), s.deviations, tuple(failures))


def _half_cells(part: AgentPart) -> Balls:
    """Half the widest cell (d,) of every axis."""
    return np.array([largest(list((e[1:] - e[:-1]) / 2)) for e in map(decimal, part.grid.edges)])


def _snapped(part: AgentPart, relation: CoupledRelation, numbers: tuple[Balls, ...]) -> Balls:
    """What means (d,) are moved by to the lattice points of the menu, at most."""
    A, B, drift = numbers
    assert part.menu is not None
    index = np.unravel_index(np.arange(part.grid.n_cells), part.grid.shape)
    axes = zip(map(decimal, part.grid.edges), index, strict=True)
    centre = np.stack([((e[1:] + e[:-1]) / 2)[k] for e, k in axes], axis=1)
    stays, moves = centre @ A.T + drift, binary(relation.inputs) @ B.T
    places = zip(part.lattice, np.unravel_index(part.menu, part.lattice_shape), strict=True)
    off = [abs(decimal(z)[k] - stays[:, None, j] - moves[None, :, j]) for j, (z, k) in enumerate(places)]
    return np.array([largest(list(own.ravel())) for own in off])


def _supports(closed: Balls, disturbance: Balls, rows: Balls) -> Balls | None:
    """Upper bounds (n,) on ``rows @ e`` over an invariant set, as ``relation_check``; None if none was found."""
    power, total, best = np.diag(disturbance), rows[:, 0] * 0, None
    for _ in range(MOST_TERMS):
        total = total + abs(rows @ power).sum(axis=1)
        power = closed @ power
        alpha = largest(list(abs(power).sum(axis=1) / disturbance))
        if alpha < 1:
            found = total / (1 - alpha)
            best = found if best is None else np.array([a if a.upper() < b.upper() else b for a, b in zip(found, best)])
        if alpha < arb("1e-15") or not alpha.is_finite():
            break
    return best
