"""A disturbance that looks one step ahead: at every step it does what leaves the certified value lowest.

It sees the states, the inputs and the automaton state, and no noise: it compares the value of the certificate at the
means of the next state under all corners of the disturbance boxes. So it is a behaviour like any other, against which a
true certificate holds; it is greedy, not worst.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.simulation import Dynamics, Worlds, joint, neighbours
from ....envs.systems.agents import Agent
from ...certificates.proofs import OnGrid, VertexProof, seen_by
from ...relations.grids import FloatArray
from .grid_values import VertexValues
from .values_in_time import ValueInTime, claimed_values

MOST_CORNERS = 64
"""Corners of all disturbances together up to which all are compared; beyond, disturbances are changed one at a time."""


class Greedy:
    """The greedy disturbance of a certificate of one task, as `Dynamics` take it.

    Parameters
    ----------
    certificate : Certificate
    """

    def __init__(self, certificate: OnGrid) -> None:
        self.certificate = certificate
        self._value: Any = None

    def __repr__(self) -> str:
        return f"Greedy(of {self.certificate.problem.name!r})"

    def __call__(
        self, dynamics: Dynamics, worlds: Worlds, inputs: Sequence[FloatArray]
    ) -> tuple[FloatArray | None, ...]:
        """Return disturbances (k, n, M) per block; None for blocks without any."""
        counts = [block.n_disturbances * len(block.agents) for block in dynamics.blocks]
        best, lowest = None, np.full(worlds.n_worlds, np.inf)
        for corner in _corners(sum(counts)):
            found = _at_corner(dynamics, worlds, corner)
            value = self._values(dynamics, worlds, inputs, found)
            if best is None:
                best = found
            lower = value < lowest
            best = tuple(_merged(old, new, lower) for old, new in zip(best, found, strict=True))
            lowest = np.minimum(lowest, value)
        assert best is not None
        return best

    def _values(
        self, dynamics: Dynamics, worlds: Worlds, inputs: Sequence[FloatArray], unknown: Sequence[FloatArray | None]
    ) -> FloatArray:
        """Return the certified values (M,) one step later, at the means of the next states."""
        if self._value is None:
            # What a disturbance aims at need not be a bound.
            proof: Any = self.certificate.proof
            self._value = (
                VertexValues(self.certificate)  # type: ignore[arg-type]
                if isinstance(proof, VertexProof)
                else ValueInTime(self.certificate, claimed_values(self.certificate), seen_by(self.certificate))
            )
        means = []
        others = neighbours(dynamics, worlds.states, inputs)
        for block, x, u, v, beside in zip(dynamics.blocks, worlds.states, inputs, unknown, others, strict=True):
            agents = [dynamics.problem.agents[i] for i in block.agents]
            # Agents with the same expressions move in one call; linear ones one by one.
            if isinstance(agents[0], Agent):
                means.append(agents[0].mean(x, u, v, beside))
            else:
                means.append(np.stack([agent.mean(x[:, k], u[:, k]) for k, agent in enumerate(agents)], axis=1))
        following = Worlds(tuple(means), worlds.q, worlds.time, worlds.failed, worlds.accepted)
        states, problem = joint(dynamics, following), dynamics.problem
        holds = [problem.labeling.class_at(i, states[:, columns].T) for i, columns in enumerate(problem.columns)]
        q = problem.automaton.next_state(worlds.q, np.concatenate(holds))
        left = np.broadcast_to(np.maximum(problem.horizon - np.asarray(worlds.time) - 1, 0), worlds.q.shape)
        # What is not a number lies outside every workspace, and is worth nothing.
        known = np.isfinite(states).all(axis=1)
        values = self._value.at(np.where(known[:, None], states, 0.0), q.astype(np.int64), left.astype(np.int64))
        return np.where(known, values, 0.0)


def greedy_disturbance(certificate: Any) -> Greedy:
    """Return the greedy disturbance of a certificate of one task.

    Examples
    --------
    It is given to environments, rollouts and validations as ``disturbance=greedy_disturbance(certificate)``.
    """
    return Greedy(getattr(certificate, "certificate", certificate))


def _corners(count: int) -> Iterator[NDArray[np.int64]]:
    """Yield corners (count,) of a unit box: all of them, or those that differ from two of them in one coordinate."""
    if 2**count <= MOST_CORNERS:
        yield from (np.array(corner, dtype=np.int64) for corner in product((0, 1), repeat=count))
        return
    for end in (0, 1):
        corner = np.full(count, end)
        yield corner
        for k in range(count):
            other = corner.copy()
            other[k] = 1 - end
            yield other


def _at_corner(dynamics: Dynamics, worlds: Worlds, corner: NDArray[np.int64]) -> tuple[FloatArray | None, ...]:
    """Return the disturbances at a corner, the same in all worlds."""
    result: list[FloatArray | None] = []
    first = 0
    for block in dynamics.blocks:
        k, n = block.n_disturbances, len(block.agents)
        agent = dynamics.problem.agents[block.agents[0]]
        if not k:
            result.append(None)
            continue
        at_high = corner[first : first + k * n].reshape(k, n)
        low, high = np.array(list(agent.disturbances.values())).T
        values = np.where(at_high, high[:, None], low[:, None])
        result.append(np.broadcast_to(values[..., None], (k, n, worlds.n_worlds)))
        first += k * n
    return tuple(result)


def _merged(old: FloatArray | None, new: FloatArray | None, where: NDArray[np.bool_]) -> FloatArray | None:
    return None if old is None or new is None else np.where(where, new, old)
