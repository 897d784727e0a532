"""What relations rest on in balls: aims and targets that are met, and what pushes coupled states."""

from __future__ import annotations

from typing import Any

import numpy as np
from flint import arb

from certigym.envs.systems.agents import LinearAgent
from certigym.synthesis.certificates.cell_probabilities import AgentRecord
from certigym.synthesis.extended_check.steps import cell_boxes
from certigym.synthesis.relations.grids import FloatArray
from certigym.synthesis.relations.kinds import CoupledRelation, ExactRelation

from .ball_memory import UNIT, Balls, Memory, Proof
from .ball_spans import balls


def mean_targets(
    memory: Memory, agent: LinearAgent, part: AgentRecord, relation: ExactRelation, off: FloatArray
) -> Proof:
    """Means ``A x + B (R (z - d - A_r x) + mid) + c`` miss z by no more than is said."""
    A, B, c = balls(agent.A), balls(agent.B), balls(agent.offset)
    A_r, R = balls(relation.A), balls(relation.right_inverse)
    drift, middle = balls(relation.drift), balls(relation.input_centre)
    x = balls([max(abs(edges[0]), abs(edges[-1])) for edges in part.grid.edges])
    z = balls([np.max(np.abs(axis)) for axis in part.lattice])
    asked = abs(R) @ (z + abs(drift) + abs(A_r) @ x) + abs(middle)
    # A quarter of what is charged for rounding is left for computing this in doubles.
    moved, unit = B @ R, arb((3 * sum(agent.B.shape) + 12) * UNIT)
    missed = abs(A - moved @ A_r) @ x + abs(moved - balls(np.eye(len(off)))) @ z + abs(c + B @ middle - moved @ drift)
    missed = missed + unit * (abs(A) @ x + abs(B) @ asked + abs(c) + z)
    right = all(own <= most for own, most in zip(missed, off.tolist(), strict=True))
    return len(off), [] if right else [f"what the targets of agent `{agent.name}` are missed by was not proved"]


def targets(
    memory: Memory, agent: LinearAgent, part: AgentRecord, relation: ExactRelation, choices: Any, rounding: FloatArray
) -> Proof:
    """Every target of every cell takes inputs of the box only, from all points of the cell."""
    A_r, R = balls(relation.A), balls(relation.right_inverse)
    points, rows = int(np.prod(part.lattice_shape)), choices.reshape(-1, choices.shape[-1]).astype(np.int64)
    cell, target = np.divmod(np.unique((rows + np.arange(rows.shape[1]) * points)[rows >= 0]), points)
    low, high = map(balls, cell_boxes(part))
    centre, half = (low + high) / 2, (high - low) / 2
    base = balls(relation.input_centre) - (centre @ A_r.T + balls(relation.drift)) @ R.T
    spread = half @ abs(R @ A_r).T + balls(rounding)
    places = zip(part.lattice, np.unravel_index(target, part.lattice_shape), strict=True)
    # Targets are few along each axis: what they add to inputs is the sum of what their coordinates add.
    moved: Balls = 0
    for (axis, k), column in zip(places, R.T, strict=True):
        moved = moved + np.array([own * column for own in balls(axis)] or [column])[k]
    inputs = base[cell] + moved
    inside = (inputs - spread[cell] >= balls(agent.input_box.low)) & (
        inputs + spread[cell] <= balls(agent.input_box.high)
    )
    return len(cell), [] if np.all(inside) else [f"agent `{agent.name}` is asked for inputs beyond its input box"]


def disturbance(
    memory: Memory, part: AgentRecord, relation: CoupledRelation, rounding: FloatArray, value: FloatArray
) -> Proof:
    """Half the widest cell, what means are snapped by where something is chosen, and rounding."""
    assert part.input_set is not None
    low, high = map(balls, cell_boxes(part))
    moving = np.any(part.policy >= 0, axis=(0, 1))
    stays = ((low + high) / 2)[moving] @ balls(relation.A).T + balls(relation.drift)
    moves, index = (
        balls(relation.inputs) @ balls(relation.B).T,
        np.unravel_index(part.input_set[moving], part.lattice_shape),
    )
    right = True
    for k, (axis, places) in enumerate(zip(part.lattice, index, strict=True)):
        room = arb(value[k]) - arb(rounding[k]) - max((high - low)[:, k]) / 2
        off = abs(balls(axis)[places] - stays[:, None, k] - moves[None, :, k])
        right &= bool(np.all(off <= room))
    return part.input_set.size, [] if right else ["what a coupled state is pushed by was not proved"]
