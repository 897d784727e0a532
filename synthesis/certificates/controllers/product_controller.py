"""Controllers of independent tasks, side by side: every agent follows the controller of its own group.

Where the whole has one automaton, its state says those of all groups, which read their own letters of the same word.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.simulation import Dynamics, Worlds, joint, split_joint
from ....envs.systems.arguments import tree_text
from ....envs.tasks.automata import Automaton
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from .communicated import told_of_all
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
        One for each of ``problem.tasks_apart``, in order.
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
        if not self.problem.groups:
            infos = self._told_apart(observations, infos)
        for part, observed in zip(self.parts, self._by_part(observations), strict=True):
            actions |= part.act(observed, infos)
        return {name: actions[name] for name in observations}

    def _told_apart(self, observations: Mapping[str, Any], infos: Mapping[str, Any] | None) -> dict[str, Any]:
        """Return infos that tell each agent the automaton state of its own group."""
        seen = told_of_all(self.problem, observations, infos, self.problem.automaton.n_states)
        return {
            name: {"state": state, "automaton_state": int(self.states[q, self._part_of[name]]), "time": time}
            for name, (state, q, time) in seen.items()
        }

    @cached_property
    def states(self) -> NDArray[np.int64]:
        """Automaton states (Q, K) of all groups, by that of the whole."""
        return states_apart(self.problem.automaton, [part.problem.automaton for part in self.parts])

    def batch(self, dynamics: Dynamics) -> BatchProduct:
        """Return the same controllers for batched rollouts of ``dynamics``.

        Raises
        ------
        ValueError
            If there is no automaton of the whole: then tasks are simulated one by one (``validation.simulation.Loop``).
        """
        if self.problem.groups:
            raise ValueError(
                f"`dynamics`: expected none, got those of {dynamics.problem.name!r}; independent tasks are simulated "
                "one by one: take the controllers of `.parts`"
            )
        bases = tuple(Dynamics.of(part.problem) for part in self.parts)
        inner = tuple(part.batch(base) for part, base in zip(self.parts, bases, strict=True))
        return BatchProduct(self, dynamics, bases, inner)

    def _by_part(self, observations: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Return the observations of each part."""
        result: list[dict[str, Any]] = [{} for _ in self.parts]
        for name, observation in observations.items():
            result[self._part_of[name]][name] = observation
        return result


@dataclass(frozen=True, eq=False)
class BatchProduct:
    """Controllers of independent tasks arranged for batches of the whole."""

    controller: ProductController
    dynamics: Dynamics
    bases: tuple[Dynamics, ...]
    inner: tuple[Any, ...]

    def begin(self, worlds: Worlds, rng: Any) -> tuple[Any, ...]:
        """Return the memories at time 0."""
        return tuple(own.begin(part, rng) for own, part in zip(self.inner, self._parts(worlds), strict=True))

    def selected(self, memory: tuple[Any, ...], which: NDArray[Any]) -> tuple[Any, ...]:
        """Return the memories of the worlds ``which`` alone."""
        return tuple(own.selected(part, which) for own, part in zip(self.inner, memory, strict=True))

    def act(self, worlds: Worlds, memory: tuple[Any, ...]) -> tuple[tuple[FloatArray, ...], tuple[Any, ...]]:
        """Return inputs (m, n, M) per block, and the memories for the next step."""
        each, after = list[tuple[FloatArray, ...]](), list[Any]()
        for own, part, before in zip(self.inner, self._parts(worlds), memory, strict=True):
            inputs, remembered = own.act(part, before)
            each.append(inputs)
            after.append(remembered)
        blocks = []
        for block in self.dynamics.blocks:
            at = [self._places[i] for i in block.agents.tolist()]
            blocks.append(np.stack([each[k][b][:, j] for k, b, j in at], axis=1))
        return tuple(blocks), tuple(after)

    @cached_property
    def _places(self) -> dict[int, tuple[int, int, int]]:
        """Of each agent its group, and its block and place there."""
        return {
            i: (k, *self.bases[k].position[j])
            for k, group in enumerate(self.controller.problem.apart)
            for j, i in enumerate(group.agents)
        }

    def _parts(self, worlds: Worlds) -> list[Worlds]:
        """Return the worlds of each group."""
        problem, whole = self.controller.problem, joint(self.dynamics, worlds)
        components, result = np.arange(problem.n_states), []
        for k, (group, base) in enumerate(zip(problem.apart, self.bases, strict=True)):
            columns = np.concatenate([components[problem.columns[i]] for i in group.agents])
            q = self.controller.states[worlds.q, k].astype(worlds.q.dtype)
            result.append(replace(worlds, states=split_joint(base, whole[:, columns]), q=q))
        return result


def states_apart(whole: Automaton, parts: Sequence[Automaton]) -> NDArray[np.int64]:
    """Return the states (Q, K) in which automata over disjoint letters are, by that of the automaton of them all.

    States in which a run has ended, or is lost whatever follows, stand for many of theirs, of which one is named.

    Raises
    ------
    ValueError
        If another state stands for several of theirs, or an automaton reads letters in another order than the whole.
    """
    # Diagrams are followed side by side: they test the propositions of the whole in one order.
    place = {name: k for k, name in enumerate(whole.propositions)}
    automata = [whole, *parts]
    if any(np.any(np.diff([place[name] for name in own.propositions]) < 0) for own in parts):
        raise ValueError("automata of the tasks read propositions in another order than that of the whole")
    is_over = whole.absorbing & (~whole.accepting | (whole.semantics == "co-safe"))
    order = [np.array([place[name] for name in own.propositions], dtype=np.int64)[own.variable] for own in automata]
    result = np.full((whole.n_states, len(parts)), -1)
    begun = (whole.initial, *(own.initial for own in parts))
    known, waiting = {begun}, [begun]
    while waiting:
        states = waiting.pop()
        if np.any(result[states[0]] >= 0) and np.any(result[states[0]] != states[1:]):
            if not is_over[states[0]]:
                raise ValueError(f"automaton state {states[0]} of the whole stands for several states of its tasks")
            continue
        result[states[0]] = states[1:]
        entries, seen = [tuple(int(own.root[q]) for own, q in zip(automata, states, strict=True))], set[Any]()
        while entries:
            entry = entries.pop()
            if entry in seen:
                continue
            seen.add(entry)
            tested = [int(v[e]) if e >= 0 else len(place) for v, e in zip(order, entry, strict=True)]
            if (least := min(tested)) == len(place):
                following = tuple(-1 - e for e in entry)
                if following not in known:
                    known.add(following)
                    waiting.append(following)
                continue
            for side in ("low", "high"):
                taken = zip(automata, entry, tested, strict=True)
                entries.append(tuple(int(getattr(own, side)[e]) if v == least else e for own, e, v in taken))
    return np.maximum(result, 0)
