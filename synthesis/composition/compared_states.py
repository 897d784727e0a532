"""Which states of two agents a pair compares, where the bound by subtraction knows their noise."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...envs.systems.agents import AnyAgent
from ...envs.tasks.problem import Problem
from ...envs.tasks.regions import PairRegion
from ..relations.grids import FloatArray, RelationRefused, refuse_uneven_noise


def compared_axes(problem: Problem, pair: PairRegion) -> tuple[list[int], list[int]]:
    """Return the states of both agents that a pair compares.

    Raises
    ------
    RelationRefused
        If an output compared is no state, or the noise is not Gaussian and independent along the states.
    """
    result: list[list[int]] = []
    for i, outputs in zip((pair.first, pair.second), pair.outputs, strict=True):
        agent = problem.agents[i]
        _check_noise(agent)
        axes = [agent.output_axis(k) for k in outputs]
        if any(axis is None or axis[1] != 1.0 for axis in axes):
            raise RelationRefused(f"agent `{agent.name}`: the bound by subtraction compares states, got other outputs")
        result.append([axis[0] for axis in axes if axis is not None])
    return result[0], result[1]


def _check_noise(agent: AnyAgent) -> None:
    """Raise RelationRefused unless the noise is Gaussian, independent along the states, and the same everywhere."""
    refuse_uneven_noise(agent, "exact")
    covariance: Any = agent.noise_covariance
    lawful = agent.laws is None or all(law.name == "gaussian" for law in agent.laws)
    if not lawful or np.any(covariance != np.diag(np.diag(covariance))):
        raise RelationRefused(
            f"agent `{agent.name}`: the bound by subtraction needs Gaussian noise, independent along the states"
        )


def marginal(masses: FloatArray, lattice: Sequence[FloatArray], axes: Sequence[int]) -> FloatArray:
    """Return masses (Z,) of lattice points as a tensor over some axes of the lattice, in this order."""
    tensor = masses.reshape(tuple(len(axis) for axis in lattice))
    others = tuple(k for k in range(tensor.ndim) if k not in axes)
    kept = sorted(axes)
    return np.asarray(tensor.sum(axis=others).transpose([kept.index(k) for k in axes]))
