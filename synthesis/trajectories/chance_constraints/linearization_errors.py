"""Agents that nobody steers: what they do without noise says which letters are likely, before any path is planned."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from .nonlinear_model import NonlinearModel
from .path_limits import corners_along


class LinearizationErrors:
    """The letters that agents without a choice of inputs read if there is no noise.

    Nothing is proved by them: they spare the search plans in which such an agent would have to be elsewhere.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.agents = [i for i, a in enumerate(problem.agents) if np.array_equal(a.input_low, a.input_high)]

    def outputs(self, i: int) -> FloatArray:
        """Return the outputs (T + 1, p) of an agent without a choice of inputs."""
        agent = self.problem.agents[i]
        model, states = NonlinearModel(agent), [0.5 * (agent.initial.low + agent.initial.high)]
        for t in range(self.problem.horizon):
            states.append(model.step(states[-1][:, None], agent.input_low[:, None], t)[:, 0])
        return model.outputs(np.array(states))[0]

    @cached_property
    def letters(self) -> NDArray[np.int8]:
        """Letters (T + 1, P): 1 where a proposition holds, -1 where it does not, 0 where inputs decide."""
        names = self.problem.automaton.propositions
        letters = np.zeros((self.problem.horizon + 1, len(names)), dtype=np.int8)
        for i in self.agents:
            own = self.problem.labeling.agent_propositions[i]
            outputs = self.outputs(i) if len(own) else np.zeros(0)
            for p in own:
                low, high = corners_along(self.problem, names[p], len(letters))
                letters[:, p] = np.where(np.all((low <= outputs) & (outputs < high), axis=1), 1, -1)
        return letters

    def may_read(self, letters: NDArray[np.int8]) -> bool:
        """Return whether letters (S + 1, P), of which 0 asks for nothing, agree with all that nobody steers."""
        asked, told = letters[1:], self.letters[1 : len(letters)]
        return not np.any(asked * told < 0)
