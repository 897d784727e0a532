"""Deviations from nominal states of any agent, to first order: they are drawn, and nothing is certified from them."""

from __future__ import annotations

import numpy as np

from ....envs.systems.agents import TIME, AnyAgent
from ....envs.systems.expressions import Program
from ...relations.grids import FloatArray


def covariances_along(agent: AnyAgent, states: FloatArray, inputs: FloatArray, gains: FloatArray) -> FloatArray:
    """Return covariances (S + 1, d, d) of linear deviations from states (S + 1, d) under feedback (S, m, d) (rounded).

    Noise that is multiplied counts with its nominal multiplier.
    """
    d, m, steps = agent.n_states, agent.n_inputs, len(inputs)
    noises = np.broadcast_to(agent.noise_covariance, (steps, d, d))
    names = (*agent.states, *agent.inputs, *agent.unknowns, TIME)
    calm = np.array([0.5 * low + 0.5 * high for low, high in agent.unknowns.values()]).reshape(-1, 1)
    variables = np.concatenate([states[:-1].T, inputs.T, np.repeat(calm, steps, axis=1), np.arange(steps)[None]])
    _, slopes = Program.of(agent.timed_trees, names).slopes(variables)
    matrices = np.moveaxis(slopes, 2, 0)
    A, B = matrices[:, :, :d], matrices[:, :, d : d + m]
    if agent.timed_scale_trees:
        stds = np.array([law.std for law in agent.laws or ()])
        scaled = Program.of(agent.timed_scale_trees, names).values(variables).T * stds
        noises = np.array([np.diag(row**2) for row in scaled])
    result = np.zeros((steps + 1, d, d))
    for t in range(steps):
        closed = A[t] + B[t] @ gains[t]
        result[t + 1] = closed @ result[t] @ closed.T + noises[t]
    return result
