"""Policies behind a shield, for ``rollout`` and ``compare``."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics, Worlds
from ...envs.systems.arguments import tree_text
from ...synthesis.extended_check.shields import ProductShield, Shield
from ..statistical_tests import Batchable, BatchPolicy
from .shielded_batches import in_blocks, inputs_of, states_of, times_of

Array = NDArray[Any]


@dataclass(frozen=True, eq=False, repr=False)
class ShieldedController:
    """Any policy behind a shield, which keeps its success probability at ``shield.probability`` or above.

    Parameters
    ----------
    policy : object with ``batch(dynamics)``
    shield : Shield or ProductShield
    """

    policy: Batchable
    shield: Shield | ProductShield

    def __repr__(self) -> str:
        rows = [("policy", type(self.policy).__name__), ("keeps", f"P(success) >= {self.shield.probability:.6g}")]
        return tree_text(f"ShieldedController of {self.shield.problem.name!r}", rows)

    @property
    def information(self) -> str:
        """What the policy sees, and what the shield sees, in words."""
        seen = getattr(self.policy, "information", "not stated")
        return f"{seen}; the shield: states of all agents, automaton state, time"

    @property
    def kept(self) -> float:
        """Lower bound on the success probability, whatever the policy does."""
        return self.shield.probability

    @property
    def parts(self) -> tuple[ShieldedController, ...]:
        """The policy behind the shield of each independent task; itself if there is one task."""
        if isinstance(self.shield, Shield):
            return (self,)
        policies = getattr(self.policy, "parts", (self.policy,) * len(self.shield.parts))
        return tuple(ShieldedController(*pair) for pair in zip(policies, self.shield.parts, strict=True))

    def batch(self, dynamics: Dynamics) -> ShieldedBatch:
        """Return the policy for batches of ``dynamics``.

        Raises
        ------
        ValueError
            If the shield is that of several tasks, which are simulated one by one.
        """
        if not isinstance(self.shield, Shield):
            raise ValueError("`dynamics`: expected none; independent tasks are simulated one by one: take `.parts`")
        return ShieldedBatch(self.policy.batch(dynamics), self.shield, dynamics)


@dataclass(frozen=True, eq=False)
class ShieldMemory:
    """What is remembered between steps.

    Parameters
    ----------
    inner : object
        The policy's own memory.
    ratio : (M,) array
        Ratios of the last step, with which the next budgets are computed.
    budget : (M,) array
        Budgets in the states in which the policy acted last.
    overridden, steps : int
        Proposals that were not let through, and all proposals so far, agents counted one by one.
    """

    inner: Any
    ratio: Array
    budget: Array
    overridden: int = 0
    steps: int = 0


@dataclass(frozen=True, eq=False)
class ShieldedBatch:
    """A policy behind a shield, arranged for batches."""

    policy: BatchPolicy
    shield: Shield
    dynamics: Dynamics

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> ShieldMemory:
        """Return the memory at time 0.

        Raises
        ------
        ValueError
            If the certificate does not cover a start.
        """
        budget, covered = self.shield.first_budget(states_of(self.dynamics, worlds), worlds.q)
        if not np.all(covered):
            raise ValueError(
                f"`starts`: expected starts from which {self.shield.probability:.6g} can be kept, got "
                f"{np.count_nonzero(~covered)} others among {len(covered)}; keep a smaller probability"
            )
        return ShieldMemory(self.policy.begin(worlds, rng), np.ones(len(budget)), budget)

    def act(self, worlds: Worlds, memory: ShieldMemory) -> tuple[tuple[Array, ...], ShieldMemory]:
        """Return the inputs (m, n, M) per block that the shield lets through or puts in their place."""
        inputs, inner = self.policy.act(worlds, memory.inner)
        states, times = states_of(self.dynamics, worlds), times_of(worlds)
        budget = memory.budget
        if np.any(times > 0):
            budget = self.shield.next_budget(memory.ratio, states, worlds.q, times)[0]
        here = np.flatnonzero(~(worlds.failed | self.shield.problem.automaton.absorbing[worlds.q]))
        if not len(here):
            return inputs, replace(memory, inner=inner, budget=budget)
        applied = tuple(np.array(u, dtype=float) for u in inputs_of(self.dynamics, inputs))
        there, proposed = tuple(x[:, here] for x in states), tuple(u[:, here] for u in applied)
        choice = self.shield.choose(there, worlds.q[here], times[here], budget[here], proposed)
        for u, chosen in zip(applied, choice.inputs, strict=True):
            u[:, here] = chosen
        ratio = memory.ratio.copy()
        ratio[here] = choice.ratio
        overridden, steps = memory.overridden + int(choice.overridden.sum()), memory.steps + choice.overridden.size
        return in_blocks(self.dynamics, applied), ShieldMemory(inner, ratio, budget, overridden, steps)
