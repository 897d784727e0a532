"""What sums and products may gain by rounding, from how many of them there are."""

from __future__ import annotations

import numpy as np
from flint import arb

from certigym.synthesis.certificates.cell_probabilities import AgentRecord
from certigym.synthesis.certificates.proofs import OnGrid
from certigym.synthesis.extended_check.steps import places_of

from .ball_memory import UNIT, Memory, Proof

READ = 1e-9
"""Share of the largest value that reading a lattice may lose to rounding: a third of what readings take off for it."""


def _operations(certificate: OnGrid) -> int:
    """Operations that any number of a value, or of a mass, goes through from one end of the horizon to the other."""
    proof = certificate.proof
    total, horizon = len(proof.agents) + max(proof.rank, len(proof.start_target)) + 1000, 0
    for part in proof.agents:
        total += places_of(part) + 8 * len(part.grid.shape)  # its start
        horizon += _smoothed(part)
    for step in certificate.proof.merge_log:
        total += 2 * max((len(merges.into) for merges in step.merges), default=0)
        total += max((len(kept) for kept in step.kept), default=0)
    return total + certificate.problem.horizon * horizon


def _smoothed(part: AgentRecord) -> int:
    """Operations of a step of one agent: its tables, and reading between lattice points."""
    sides = 2 if part.is_linear else 1
    return sum(sides * n + 2 for n in part.grid.shape) + 64 * 2 ** len(part.grid.shape)


def _gamma(count: int) -> float:
    return count * UNIT / (1.0 - count * UNIT) * (1.0 + 1e-9)


def sums(memory: Memory, certificate: OnGrid, recomputed: float, loss: float) -> Proof:
    """What the sums and products of a value may have gained by rounding is remembered; readings lose what they allow.

    All numbers are nonnegative, so that each is off by ``gamma(n) = n u / (1 - n u)`` of its size after n operations.
    Trains carry what they are off by; their start is read with fewer operations than are counted.
    """
    failures = []
    for agent, part in zip(certificate.problem.agents, certificate.proof.agents, strict=True):
        if not part.is_additive:
            d, reach = len(part.grid.shape), max(part.relation.get("reach", [1]))
            axes = [(axis, (axis[-1] - axis[0]) / (len(axis) - 1)) for axis in part.lattice]
            places = max(float(np.abs(axis).max() / step) + len(axis) for axis, step in axes)
            # Values, second differences with the weights of steps of up to ``reach``, and positions between points.
            step, missing = 2.0 * reach / part.relation.get("parts", 1), float(memory.missing(agent, part).upper())
            weights = d * d * (1.0 + step * step)
            # Boxes take off what rows lack, of which second differences of neighbours need a quarter per axis.
            lacking = missing * (weights if part.is_linear else max(0.0, 0.25 * d - 1.0))
            off = _gamma(_smoothed(part)) * (2.0 + weights) + lacking
            if off + 64 * d * UNIT * (places + 1) > READ:
                failures.append(f"agent `{agent.name}` is read on a lattice with more rounding than is allowed for")
    memory.sums = max(memory.sums, _gamma(_operations(certificate)) * (recomputed + loss))
    return 1, failures


def differences(memory: Memory, base: OnGrid, pairs: int, factor: float) -> Proof:
    """Sums that charge pairs are off by less than a factor; what differences of masses may gain is remembered."""
    # The masses of a pair are summed, and summed against tables; both are taken from one another.
    lattice = max(int(np.prod(part.lattice_shape)) + sum(part.lattice_shape) for part in base.proof.agents)
    # At every time masses of all products sum to 1 at most, for every pair.
    memory.differences += 3.0 * base.problem.horizon * pairs * _gamma(lattice + 16)
    gained = _gamma(_operations(base) + 4 * lattice)
    return 1, [] if 1.0 + gained <= factor else ["sums of masses of pairs round more than is allowed for"]


def spare(memory: Memory, certificate: OnGrid, value: float) -> Proof:
    """Undecided mass, which is pushed forward by masses from below, lacks no more than is said, at any time."""
    missing = arb(0)
    for agent, part in zip(certificate.problem.agents, certificate.proof.agents, strict=True):
        missing += memory.missing(agent, part)
    total = certificate.problem.horizon * missing + arb(_gamma(_operations(certificate)))
    return 1, [] if total <= value else ["the undecided mass lacks more than is said"]
