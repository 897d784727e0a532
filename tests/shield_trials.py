"""Episodes under shields for several tests: who proposes inputs, and a loop that may be sabotaged."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from certigym.envs.simulation import Dynamics
from certigym.envs.simulation import batch_simulator as core
from certigym.synthesis.extended_check.shields import Shield

Array = NDArray[Any]
Proposer = Callable[[Shield, tuple[Array, ...], Array, Array, np.random.Generator], tuple[Array, ...]]
Following = Callable[[Shield, dict[str, Any]], Array]

CANDIDATES = 6
"""Random corners of the input boxes among which the adversary looks for the worst."""


def anything(shield: Shield, states: Any, q: Array, time: Array, rng: np.random.Generator) -> tuple[Array, ...]:
    """Propose uniformly random inputs."""
    boxes = [agent.input_box for agent in shield.problem.agents]
    return tuple(b.low[:, None] + (b.high - b.low)[:, None] * rng.random((len(b.low), len(q))) for b in boxes)


def the_worst(shield: Shield, states: Any, q: Array, time: Array, rng: np.random.Generator) -> tuple[Array, ...]:
    """Propose, of a few extreme inputs, the one whose expected value is least: greedy, one step ahead."""
    best: tuple[Array, ...] = anything(shield, states, q, time, rng)
    least = np.full(len(q), np.inf)
    for _ in range(CANDIDATES):
        tried = []
        for agent in shield.problem.agents:
            low, high = agent.input_box.low[:, None], agent.input_box.high[:, None]
            tried.append(np.where(rng.random((len(low), len(q))) < 0.5, low, high))
        for t in np.unique(time):
            for state in np.unique(q):
                here = np.flatnonzero((time == t) & (q == state))
                if len(here) and not shield.problem.automaton.absorbing[state]:
                    where = tuple(x[:, here] for x in states)
                    q_values = shield.values.of_inputs(int(t), int(state), where, tuple(u[:, here] for u in tried))
                    taken = here[q_values < least[here]]
                    least[here] = np.minimum(q_values, least[here])
                    for u, new in zip(best, tried, strict=True):
                        u[:, taken] = new[:, taken]
    return best


def promised(shield: Shield, step: dict[str, Any]) -> Array:
    """Return the budget as the rule has it."""
    return shield.next_budget(step["ratio"], step["states"], step["q"], step["time"])[0]


def episodes(
    shield: Shield,
    propose: Proposer,
    count: int,
    seed: int,
    following: Following = promised,
    first: Array | None = None,
    disturbance: Any = "zero",
) -> dict[str, Array]:
    """Run episodes under a shield, against a disturbance.

    Return success, last budgets, and the least slack ``V - b`` that was met.
    """
    problem, rng = shield.problem, np.random.default_rng(seed)
    dynamics = Dynamics.of(problem, disturbance)
    worlds = core.initial(dynamics, rng, count)
    budget = shield.first_budget(states_of(dynamics, worlds), worlds.q)[0] if first is None else first
    slack, overridden, steps = np.inf, 0, 0
    for time in range(problem.horizon):
        going = np.flatnonzero(~(worlds.failed | problem.automaton.absorbing[worlds.q]))
        if not len(going):
            break
        states = tuple(x[:, going] for x in states_of(dynamics, worlds))
        q, at = worlds.q[going], np.full(len(going), time)
        before = shield.values.of_states(states, q, at)
        slack = min(slack, float((before - budget[going]).min()))
        proposed = propose(shield, states, q, at, rng)
        choice = shield.choose(states, q, at, budget[going], proposed)
        overridden, steps = overridden + int(choice.overridden.sum()), steps + choice.overridden.size
        worlds = moved(dynamics, worlds, going, choice.inputs, rng)
        after = tuple(x[:, going] for x in states_of(dynamics, worlds))
        step = {"ratio": choice.ratio, "states": after, "q": worlds.q[going], "time": at + 1}
        step |= {"before": before, "budget": budget[going]}
        budget = budget.copy()
        budget[going] = np.where(worlds.failed[going], 0.0, following(shield, step))
    success = np.asarray(core.satisfied(dynamics, worlds))
    return {
        "success": success,
        "budget": budget,
        "slack": np.array(slack),
        "overridden": np.array(overridden / max(steps, 1)),
    }


def states_of(dynamics: Dynamics, worlds: core.Worlds) -> tuple[Array, ...]:
    """Return the states (d_i, M) of every agent."""
    return tuple(worlds.states[block][:, place] for block, place in dynamics.position)


def moved(
    dynamics: Dynamics, worlds: core.Worlds, going: Array, inputs: tuple[Array, ...], rng: np.random.Generator
) -> core.Worlds:
    """Return the worlds one step later; those that are decided get the middle input."""
    blocks = []
    for block in dynamics.blocks:
        middle = 0.5 * block.input_low + 0.5 * block.input_high
        blocks.append(np.repeat(middle, worlds.n_worlds, axis=-1))
    for (number, place), u in zip(dynamics.position, inputs, strict=True):
        blocks[number][:, place, going] = u
    return core.transition(dynamics, worlds, blocks, core.noise(dynamics, rng, worlds.n_worlds))
