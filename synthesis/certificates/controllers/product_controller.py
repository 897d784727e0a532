"""Controllers of independent tasks, side by side: every agent follows the controller of its own group."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ....envs.simulation import Dynamics
from ....envs.systems.arguments import tree_text
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from .controller import Controller
from .predicting import Predicting


@dataclass(frozen=True, eq=False, repr=False)
class ProductController(Predicting):
    """Controllers of all agents of a problem that decomposes into independent tasks.

    Every agent sees its own state, the automaton state of its own group, and the time.

    Parameters
    ----------
    problem : Problem
        The whole problem.
    parts : tuple of Controller
        One for each of ``problem.tasks``, in order.
    """

    problem: Problem
    parts: tuple[Controller, ...]

    def __repr__(self) -> str:
        rows = [("agents", len(self._part_of)), ("tasks", len(self.parts))]
        return tree_text(f"ProductController of {self.problem.name!r}", rows)

    @cached_property
    def _part_of(self) -> dict[str, int]:
        return {name: k for k, part in enumerate(self.parts) for name in part.problem.agent_names}

    def reset(
        self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None, seed: int | None = None
    ) -> None:
        """Begin an episode with the observations of ``env.reset``; ``seed`` fixes the auxiliary draws.

        Raises
        ------
        ValueError
            If the agents are not those of the controller's problem, or the environment has noisy sensors.
        """
        strangers = sorted(set(observations) ^ set(self._part_of))
        if strangers:
            raise ValueError(
                f"`observations`: expected exactly the agents of problem {self.problem.name!r}, got a mismatch at "
                f"{', '.join(strangers[:5])}; reset the controller of this environment's own problem"
            )
        seeds = np.random.SeedSequence(seed).generate_state(len(self.parts), np.uint64)
        for part, observed, drawn in zip(self.parts, self._by_part(observations), seeds, strict=True):
            part.reset(observed, infos, int(drawn) if seed is not None else None)

    def act(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None = None) -> dict[str, FloatArray]:
        """Return the action of every agent observed: name -> (m,) float64; see ``Controller.act``."""
        strangers = sorted(set(observations) - set(self._part_of))
        if strangers:
            raise ValueError(
                f"`observations`: expected agents of problem {self.problem.name!r}, got {strangers[0]!r}; act in its "
                "own environment"
            )
        actions: dict[str, FloatArray] = {}
        for part, observed in zip(self.parts, self._by_part(observations), strict=True):
            actions |= part.act(observed, infos)
        return {name: actions[name] for name in observations}

    def batch(self, dynamics: Dynamics) -> Any:
        """Raise ValueError: batches are simulated task by task (``validation.simulation.Loop``)."""
        raise ValueError(
            f"`dynamics`: expected none, got those of {dynamics.problem.name!r}; independent tasks are simulated one "
            "by one: take the controllers of `.parts`"
        )

    def _by_part(self, observations: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return the observations of each part."""
        result: list[dict[str, Any]] = [{} for _ in self.parts]
        for name, observation in observations.items():
            result[self._part_of[name]][name] = observation
        return result
