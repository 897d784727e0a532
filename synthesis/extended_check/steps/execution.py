"""What a controller does, against what was evaluated: its own matrices, floating point included.

The kernel says where the mean of the next state is, or the finite model's. The controller of the certificate computes
an input from numbers of its own, and a coupled one its abstract state. Here its numbers are compared with those of the
agent: entry by entry, over the whole workspace, with the rounding of every operation. What they may be off by becomes a
probability: a mean that is off by ``dev`` costs at most ``2 Phi(|Sigma^(-1/2) dev| / 2) - 1`` per step (total variation
of two normal laws), a cell that is read off by ``rho`` at most the mass within ``rho`` of any cell edge. Both are added
over steps and agents, whatever relation and units there are.

The very code that acts is run in ``carrying_out``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import erf

from ....envs.systems.agents import AnyAgent, with_matrices
from ...certificates.cell_probabilities import AgentRecord, law_height, state
from ...relations.grids import FloatArray
from ...relations.kinds import BoxRelation, CoupledRelation, ExactRelation, MapRelation, Relation, SymbolicTargets
from .target_enclosures import target_losses

UNIT = 2.0**-53

DENSITY = 0.39895
"""Upper bound on the density of the standard normal law."""

WRAPPED = 1e-13
"""Upper bound on what an angle is off by where it wraps, up to a hundred turns away."""

COUPLING = 1e-12
"""Upper bound on what rounding changes in the law of noise that is drawn by a coupling, in total variation."""


@dataclass(frozen=True, eq=False)
class Execution:
    """How far a controller may be off, at every point of the workspace; upper bounds.

    Parameters
    ----------
    mean : (d,) array
        Of the mean of the next state (``exact``), or of where the abstract state lands.
    disturbance : (d,) array
        What is added to the error of a coupled relation per step; 0 for ``exact``.
    inputs : (m,) array
        Rounding of an input.
    loss : float
        Probability, per step, that it is told from what was evaluated.
    """

    mean: FloatArray
    disturbance: FloatArray
    inputs: FloatArray
    loss: float


@dataclass(frozen=True, eq=False)
class _Setting:
    """The agent, and the sizes of everything.

    ``A``, ``B``, ``c``; ``x``, ``u`` largest states and inputs; ``deviations``, ``narrow`` noise and narrowest cell per
    axis; ``non_gaussian`` whether the noise has other laws than the normal one.
    """

    A: FloatArray
    B: FloatArray
    c: FloatArray
    x: FloatArray
    u: FloatArray
    deviations: FloatArray
    narrow: FloatArray
    unit: float
    non_gaussian: bool


def execution_of(agent: AnyAgent, part: AgentRecord, relation: Relation) -> Execution:
    """How far the controller with this relation may be off."""
    setting = _setting(agent, part)
    if agent.angles:
        # An angle that wraps is rounded once more, and may be read in the cell beside its own.
        plain = execution_of_numbers(setting, agent, part, relation)
        return replace(plain, loss=plain.loss + _misread(setting, np.where(agent.wrapped_axes, WRAPPED, 0.0)))
    return execution_of_numbers(setting, agent, part, relation)


def execution_of_numbers(setting: _Setting, agent: AnyAgent, part: AgentRecord, relation: Relation) -> Execution:
    """How far the controller may be off, apart from what wraps."""
    return CARRIED_OUT[type(relation)](setting, agent, part, relation)


def _setting(agent: AnyAgent, part: AgentRecord) -> _Setting:
    d, m = agent.n_states, agent.n_inputs
    # Means of expressions are enclosed where they are used.
    moves = np.zeros((d, d)), np.zeros((d, m)), np.zeros(d)
    if agent.is_affine:
        linear = with_matrices(agent)
        moves = linear.A, linear.B, linear.offset
    unit = (4.0 * (d + m) + 16.0) * UNIT
    x = np.array([max(abs(edges[0]), abs(edges[-1])) for edges in part.grid.edges])
    u = np.maximum(np.abs(agent.input_box.low), np.abs(agent.input_box.high))
    deviations = np.sqrt(np.diag(agent.noise_covariance))
    if agent.laws is not None:
        # Shifted by off, a density of this height changes by off times it, and d of them by the sum of all.
        deviations = np.array([0.39 / (law_height(law) * np.sqrt(d)) for law in agent.laws])
    return _Setting(
        *moves,
        x=x,
        u=u,
        deviations=deviations * (1.0 - 1e-9),
        narrow=np.array([np.min(np.diff(edges)) for edges in part.grid.edges]),
        unit=unit,
        non_gaussian=agent.laws is not None,
    )


def _exact(s: _Setting, agent: AnyAgent, part: AgentRecord, relation: ExactRelation) -> Execution:
    """The mean of the next state is ``A x + B (R (z - d - A_r x) + mid) + c``; it is to be z."""
    z = np.array([np.max(np.abs(axis)) for axis in part.lattice])
    A, R, drift, middle = relation.A, relation.right_inverse, relation.drift, relation.input_centre
    asked = np.abs(R) @ (z + np.abs(drift) + np.abs(A) @ s.x) + np.abs(middle)
    moved = s.B @ R
    size = np.abs(s.A) @ s.x + np.abs(s.B) @ asked + np.abs(s.c) + z
    off = np.abs(s.A - moved @ A) @ s.x + np.abs(moved - np.eye(len(A))) @ z
    off += np.abs(s.c + s.B @ middle - moved @ drift)
    off += s.unit * size
    distance = float(np.sqrt(np.sum((off / s.deviations) ** 2)))
    loss = float(erf(distance / (2.0 * np.sqrt(2.0)))) * (1.0 + 1e-12)
    state("erf", distance / (2.0 * np.sqrt(2.0)), loss)
    if s.non_gaussian:  # the difference of tails is that of Gaussian noise; its slope at 0 bounds all
        loss = min(1.0, DENSITY * distance)
    state("aims", agent, part, relation, off)
    return Execution(off, np.zeros(len(A)), s.unit * asked, loss)


def _aimed(s: _Setting, part: AgentRecord, relation: SymbolicTargets) -> Execution:
    """Expressions are solved for the inputs, and what these are off by moves the mean."""
    off = target_losses(part, relation)
    shift = min(1.0, DENSITY * float(np.sqrt(np.sum((off / s.deviations) ** 2))))
    return Execution(off, np.zeros(len(off)), np.zeros(len(s.u)), shift)


def targets_alone(part: AgentRecord) -> AgentRecord:
    """The targets of policies that have inputs as well, as lattice points; -1 where they choose something else.

    Rows of the policy that are alike are one: a deadline makes states of which few can be met at a time.
    """
    first, rows = len(part.relation["menu"]), part.policy.reshape(-1, part.policy.shape[-1])
    alone = np.stack(list({row.tobytes(): row for row in rows}.values()))
    return replace(part, policy=np.where(alone >= first, alone - first, -1).astype(alone.dtype))


def _mapped(s: _Setting, agent: AnyAgent, part: AgentRecord, relation: MapRelation) -> Execution:
    """Inputs of a menu, whose means are off by what goes into their maps; targets miss theirs with some probability."""
    inputs = _boxed(s)
    if relation.mean_targets is None:
        return inputs
    part = targets_alone(part)
    mean_targets = relation.mean_targets
    aimed = CARRIED_OUT[type(mean_targets)](s, agent, part, mean_targets)
    return Execution(np.maximum(inputs.mean, aimed.mean), aimed.disturbance, aimed.inputs, max(inputs.loss, aimed.loss))


def _boxed(s: _Setting) -> Execution:
    """Inputs of a menu; what means are off by goes into their boxes."""
    off = s.unit * (np.abs(s.A) @ s.x + np.abs(s.B) @ s.u + np.abs(s.c))
    return Execution(off, np.zeros(len(s.x)), np.zeros(len(s.u)), 0.0)


def _coupled(s: _Setting, part: AgentRecord, relation: CoupledRelation) -> Execution:
    """The abstract state lands on ``z + (x' - A_r x - B_r u - d) + F e``, with what is read and computed."""
    A, B, K, F = relation.A, relation.B, relation.feedback, relation.coupling
    z = np.array([np.max(np.abs(axis)) for axis in part.lattice])
    size = s.x + np.abs(A) @ s.x + np.abs(B) @ s.u + np.abs(relation.drift) + z
    landed = np.abs(s.A - A) @ s.x + np.abs(s.B - B) @ s.u + np.abs(s.c - relation.drift) + s.unit * size
    error = s.unit * s.x  # of ``x - xhat`` as it is computed
    if relation.is_cell:  # what is left of the error when both land in one cell
        landed += np.abs(s.A + s.B @ K - F) @ relation.reach
    disturbance = landed + (np.abs(s.B) @ np.abs(K) + np.abs(F)) @ error
    inputs = np.abs(K) @ error + s.unit * s.u * np.any(K, axis=1)  # without feedback it is a number of the relation
    return Execution(landed, disturbance, inputs, _misread(s, disturbance) + (COUPLING if np.any(F) else 0.0))


def _misread(s: _Setting, off: FloatArray) -> float:
    """Upper bound on the mass of a normal law within ``off`` of any cell edge.

    Along an axis the densities at edges a cell apart sum to at most ``1 / width + largest density``.
    """
    with np.errstate(divide="ignore", invalid="ignore"):  # a state without noise must be read without an error
        return float(np.sum(np.where(off == 0.0, 0.0, 2.0 * off * (1.0 / s.narrow + DENSITY / s.deviations))))


CARRIED_OUT: dict[type, Callable[[_Setting, AnyAgent, AgentRecord, Any], Execution]] = {
    ExactRelation: _exact,
    MapRelation: _mapped,
    BoxRelation: lambda setting, agent, part, relation: _boxed(setting),
    SymbolicTargets: lambda setting, agent, part, relation: _aimed(setting, part, relation),
    CoupledRelation: lambda setting, agent, part, relation: _coupled(setting, part, relation),
}
"""How far controllers may be off, by relation."""
