"""The budgets of some worlds, kept from step to step for an environment behind a shield."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...synthesis.extended_check.shields import Shield

Array = NDArray[Any]


class Watch:
    """Budgets, values and what was overridden in M worlds; the shield itself has no memory.

    Parameters
    ----------
    shield : Shield
    count : int
        Number of worlds M.

    Attributes
    ----------
    budget, value : (M,) arrays
        What is owed, and the certified value, in the present state.
    overridden : (I, M) bool array
        Whose proposal was not let through in the last step.
    """

    def __init__(self, shield: Shield, count: int) -> None:
        self.shield = shield
        self.budget, self.value, self._ratio = np.zeros(count), np.zeros(count), np.ones(count)
        self.overridden = np.zeros((shield.problem.n_agents, count), dtype=bool)

    def begin(self, states: tuple[Array, ...], q: Array, time: Array, which: NDArray[np.bool_]) -> None:
        """Begin episodes in the worlds ``which`` (M,).

        Raises
        ------
        ValueError
            If the certificate does not cover a start.
        """
        budget, covered = self.shield.first_budget(states, q, time)
        if np.any(which & ~covered):
            world = int(np.argmax(which & ~covered))
            value = float(self.shield.value_of(states, q, time)[world])
            raise ValueError(
                f"`initial_state`: expected a start from which {self.shield.probability:.6g} can be kept, got one with "
                f"the certified value {value:.6g}; keep a smaller probability, or begin elsewhere"
            )
        self.budget = np.where(which, budget, self.budget)
        self.value = np.where(which, self.shield.value_of(states, q, time), self.value)
        self._ratio = np.where(which, 1.0, self._ratio)
        self.overridden = self.overridden & ~which

    def judge(
        self, states: tuple[Array, ...], q: Array, time: Array, moving: NDArray[np.bool_], proposed: tuple[Array, ...]
    ) -> tuple[Array, ...]:
        """Return the inputs (m_i, M) that are applied in the worlds that move, and the proposed ones elsewhere."""
        here = np.flatnonzero(moving)
        cut = [tuple(array[:, here] for array in arrays) for arrays in (states, proposed)]
        choice = self.shield.choose(cut[0], q[here], time[here], self.budget[here], cut[1])
        applied = tuple(np.array(u, dtype=float) for u in proposed)
        for u, chosen in zip(applied, choice.inputs, strict=True):
            u[:, here] = chosen
        self._ratio[here], self.overridden[:, here] = choice.ratio, choice.overridden
        return applied

    def arrive(self, states: tuple[Array, ...], q: Array, time: Array, moved: NDArray[np.bool_]) -> None:
        """Note the states (d_i, M) to which worlds have moved."""
        here = np.flatnonzero(moved)
        budget, value = self.shield.next_budget(
            self._ratio[here], tuple(x[:, here] for x in states), q[here], time[here]
        )
        self.budget[here], self.value[here] = budget, value
