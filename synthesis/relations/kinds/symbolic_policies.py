"""Policies that are written as expressions of an agent's states and the time: ``clip(-1.2*x - 0.8*v, -1, 1)``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent, Box, LinearAgent
from ....envs.systems.expressions import Program, read_expression
from ..grids import FloatArray

TIME = "t"


@dataclass(frozen=True, eq=False)
class SymbolicPolicy:
    """The policy of one agent: an expression for each of its inputs, cut off at the input box.

    Parameters
    ----------
    expressions : tuple of str
        Of the states of the agent, its parameters, and the time ``t``, the number of steps taken. Those of an agent
        with matrices are called x0, x1, ..
    states : tuple of str
    parameters : mapping
    input_box : Box
    """

    expressions: tuple[str, ...]
    states: tuple[str, ...]
    parameters: Mapping[str, float]
    input_box: Box

    sees_all: ClassVar[bool] = False

    @classmethod
    def of(cls, agent: AnyAgent, expressions: Sequence[str]) -> SymbolicPolicy:
        """Return the policy of an agent; raise ValueError if an expression cannot be read, or one is missing."""
        if len(expressions) != agent.n_inputs:
            raise ValueError(
                f"`policy`: expected an expression for each of the {agent.n_inputs} inputs of agent `{agent.name}`, "
                f"got {len(expressions)}"
            )
        linear = isinstance(agent, LinearAgent)
        states = tuple(f"x{k}" for k in range(agent.n_states)) if linear else tuple(agent.states)
        parameters = {} if linear else dict(getattr(agent, "parameters", {}))
        made = cls(tuple(expressions), states, parameters, agent.input_box)
        made.program  # noqa: B018 what cannot be read is told here
        return made

    @cached_property
    def program(self) -> Program:
        """The expressions, put in order."""
        names = (*self.states, *(() if TIME in self.states else (TIME,)))
        return Program.of([read_expression(text, names, self.parameters) for text in self.expressions], names)

    def inputs(self, states: FloatArray, q: NDArray[Any], time: int) -> FloatArray:
        """Return the inputs (m, N) at states (d, N) and a time; the automaton state is not looked at."""
        variables = (
            states if TIME in self.states else np.concatenate([states, np.full((1, states.shape[1]), float(time))])
        )
        wanted = self.program.values(variables)
        return np.clip(wanted, self.input_box.low[:, None], self.input_box.high[:, None])

    @property
    def description(self) -> dict[str, Any]:
        """The policy as plain values."""
        return {"expressions": [*self.expressions]}
