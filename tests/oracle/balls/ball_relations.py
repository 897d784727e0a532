"""What relations rest on in balls: aims and targets that are met, tubes and ellipsoids that are kept."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from flint import arb, arb_mat
from scipy.optimize import minimize_scalar

from certigym.envs.systems.agents import LinearAgent
from certigym.synthesis.certificates.cell_probabilities import AgentRecord
from certigym.synthesis.extended_check.steps import MOST_TERMS, cell_boxes
from certigym.synthesis.relations.grids import FloatArray
from certigym.synthesis.relations.kinds import CoupledRelation, ExactRelation

from .ball_memory import UNIT, Balls, Memory, Proof
from .ball_spans import balls


def mean_targets(
    memory: Memory, agent: LinearAgent, part: AgentRecord, relation: ExactRelation, off: FloatArray
) -> Proof:
    """Means ``A x + B (R (z - d - A_r x) + mid) + c`` miss z by no more than is said."""
    C = balls(part.coordinates)
    inverse = np.array(arb_mat(part.coordinates.tolist()).inv().tolist(), dtype=object)
    A, B, c = inverse @ balls(agent.A) @ C, inverse @ balls(agent.B), inverse @ balls(agent.offset)
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


def tube(memory: Memory, relation: CoupledRelation, half: FloatArray, rows: FloatArray, value: FloatArray) -> Proof:
    """Supports of an invariant zonotope, by the sum of its first powers over what is left of the next one."""
    closed, forms = balls(relation.A) + balls(relation.B) @ balls(relation.feedback), balls(rows)
    width, open_rows = balls(half), [*range(len(rows))]
    power, total = np.diag(width) * arb(1), forms[:, 0] * 0
    for _ in range(MOST_TERMS):
        total = total + abs(forms @ power).sum(axis=1)
        power = closed @ power
        alpha = max(own.upper() for own in abs(power).sum(axis=1) / width)
        if alpha < 1:
            open_rows = [k for k in open_rows if not total[k] / (1 - alpha) <= value[k]]
        if not open_rows:
            return len(rows), []
    return len(rows), [] if not np.all(np.isfinite(value)) else ["a tube was not proved invariant"]


def ellipsoid_support(memory: Memory, shape: FloatArray, epsilon: float, rows: FloatArray, value: FloatArray) -> Proof:
    """Supports of an ellipsoid: ``epsilon sqrt(row D^-1 row')``."""
    inverse = np.array(arb_mat(shape.tolist()).inv().tolist(), dtype=object)
    squares = [row @ inverse @ row for row in balls(rows)]
    right = all(arb(epsilon) ** 2 * s <= arb(v) ** 2 for s, v in zip(squares, value.tolist(), strict=True))
    return len(rows), [] if right else ["how far an ellipsoid reaches was not proved"]


def ellipsoid(
    memory: Memory, relation: CoupledRelation, half: FloatArray, variances: FloatArray, value: float
) -> Proof:
    """An ellipsoid is invariant (S-lemma), and its coupling fails with at most some probability."""
    assert relation.shape is not None
    D, d = balls(relation.shape), len(relation.shape)
    closed = balls(relation.A) + balls(relation.B) @ balls(relation.feedback) - balls(relation.coupling)
    square, epsilon, failures = closed.T @ D @ closed, arb(relation.epsilon), []
    for signs in itertools.product((1.0, -1.0), repeat=d - 1):
        vertex = balls(half * np.array([1.0, *signs]))
        cross, corner = closed.T @ D @ vertex, epsilon**2 - vertex @ D @ vertex
        if not _is_mapped_inside(D, square, cross, corner, epsilon):
            failures.append("an ellipsoid was not proved invariant")
            break
    if np.any(relation.coupling) and value < 1.0:
        # With a distance r whose error function is below the value: r^2 D - epsilon^2 F' Sigma^-1 F is not negative.
        distance = _distance(value)
        moved = balls(relation.coupling).T @ np.diag(1 / balls(variances)) @ balls(relation.coupling)
        if not _is_positive(distance**2 * D - epsilon**2 * moved):
            failures.append("how often a coupling fails was not proved")
    return 2 ** (d - 1), failures


def _is_mapped_inside(D: Balls, square: Balls, cross: Balls, corner: Any, epsilon: Any) -> bool:
    """Whether ``lambda (epsilon^2 - e'De) <= epsilon^2 - (M e + v)'D(M e + v)`` for all e, with some lambda >= 0."""

    def matrix(share: float) -> Balls:
        result = np.empty((len(D) + 1, len(D) + 1), dtype=object)
        result[:-1, :-1] = share * D - square
        result[:-1, -1] = result[-1, :-1] = -cross
        result[-1, -1] = corner - arb(share) * epsilon**2
        return result

    def smallest(share: float) -> float:
        # Scaled to a unit diagonal of the ellipsoid: only a guess, which is proved below.
        scale = np.array([*(1.0 / math.sqrt(float(own)) for own in np.diag(D)), 1.0 / float(epsilon)])
        return -float(np.linalg.eigvalsh(np.vectorize(float)(matrix(share)) * np.outer(scale, scale))[0])

    share = float(minimize_scalar(smallest, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-12}).x)
    return _is_positive(matrix(share))


def _is_positive(matrix: Balls) -> bool:
    """Whether a symmetric matrix of balls is positive definite: all pivots of its elimination are."""
    matrix = matrix.copy()
    for k in range(len(matrix)):
        if not matrix[k, k] > 0:
            return False
        for i in range(k + 1, len(matrix)):
            matrix[i, k:] = matrix[i, k:] - matrix[k, k:] * (matrix[i, k] / matrix[k, k])
    return True


def _distance(value: float) -> Any:
    """A number r with ``erf(r / sqrt 8) <= value``, nearly the largest one."""
    low, high = arb(0), arb(40)
    for _ in range(100):
        middle = ((low + high) / 2).mid()
        low, high = (middle, high) if (middle / arb(8).sqrt()).erf() <= value else (low, middle)
    return low
