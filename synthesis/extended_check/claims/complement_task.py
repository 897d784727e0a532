"""That one task is the opposite of another, and that the same controllers act in both.

What is certified for the opposite is taken off 1 for an upper bound (docs/theory/bounds.md, "The other end of any
certificate"). The opposite moves like the task while nobody is outside, accepts at the horizon what the task rejects,
and goes to its last state, which accepts and is not left, once somebody is outside. Those of earlier versions read no
exits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.automata import Automaton
from ....envs.tasks.problem import Problem
from ...certificates.proofs import OnGrid
from ...relations.grids import Grid

MOVES = ("root", "variable", "low", "high")
"""Arrays of an automaton that say how it moves."""


def wrong_complement(problem: Problem, complement: Problem) -> list[str]:
    """Why a task is not the opposite of ``problem`` with the same automaton states; empty if it is."""
    mine, other = problem.automaton, complement.automaton
    here, there = problem.to_dict(), complement.to_dict()
    inside = {
        name: region["agent"] for name, region in there["propositions"].items() if name not in here["propositions"]
    }
    failures = ["its agents are not those of the task"] if here["agents"] != there["agents"] else []
    if any(there["propositions"].get(name) != region for name, region in here["propositions"].items()):
        failures.append("its propositions are not those of the task")
    if problem.horizon != complement.horizon:
        failures.append("its horizon is not that of the task")
    if sorted(inside.values()) != (sorted(problem.agent_names) if other.reads_exits else []):
        failures.append("it has not one more proposition for each agent, to say that it is inside")
    # Networks are told the number of the automaton state: states must move alike under the same numbers.
    moves_alike = _reads_exits(mine, other, {*inside}) if other.reads_exits else _is_equal(mine, other)
    if not moves_alike or mine.initial != other.initial:
        failures.append("its automaton does not move like that of the task")
    elif other.is_co_safe or not np.array_equal(mine.accepting, ~other.accepting[: mine.n_states]):
        failures.append("it does not accept at the horizon what the task rejects")
    return failures


def _is_equal(mine: Automaton, other: Automaton) -> bool:
    """Whether two automata move alike in all states."""
    same = mine.propositions == other.propositions
    return same and all(np.array_equal(getattr(mine, name), getattr(other, name)) for name in MOVES)


def _reads_exits(mine: Automaton, other: Automaton, inside: set[str]) -> bool:
    """Whether an automaton moves like another while all of ``inside`` hold, and else to a last state, which accepts.

    States in which the task is decided stay where they are, whoever leaves: an accepting state of a co-safe task, or
    a dead state, is not left.
    """
    lost = mine.n_states
    if other.n_states != lost + 1 or not other.accepting[lost]:
        return False
    for q in range(other.n_states):
        if q == lost or mine.absorbing[q]:
            if other.root[q] != -1 - q:
                return False
        elif any(_leaves(other, q, name) != {lost} for name in inside) or not _moves_alike(mine, other, q, inside):
            return False
    return True


def _leaves(automaton: Automaton, q: int, absent: str) -> set[int]:
    """States that letters without a proposition lead to from q."""
    seen, stack = set[int](), [int(automaton.root[q])]
    while stack:
        entry = stack.pop()
        if entry in seen:
            continue
        seen.add(entry)
        if entry >= 0:
            stack.append(int(automaton.low[entry]))
            if automaton.propositions[automaton.variable[entry]] != absent:
                stack.append(int(automaton.high[entry]))
    return {-1 - entry for entry in seen if entry < 0}


def _moves_alike(mine: Automaton, other: Automaton, q: int, inside: set[str]) -> bool:
    """Whether q leads to the same states in two automata under all letters in which all of ``inside`` hold."""
    place = {name: k for k, name in enumerate(mine.propositions)}
    seen, stack = set[tuple[int, int]](), [(int(mine.root[q]), int(other.root[q]))]
    while stack:
        a, b = stack.pop()
        while b >= 0 and other.propositions[other.variable[b]] in inside:
            b = int(other.high[b])
        if (a, b) in seen or (a < 0 and a == b):
            continue
        seen.add((a, b))
        if a < 0 and b < 0:
            return False
        # Both are led on by the proposition that comes first; one that the task does not know is no reason to move.
        first = int(mine.variable[a]) if a >= 0 else len(place)
        second = place.get(other.propositions[other.variable[b]], -1) if b >= 0 else len(place)
        if second < 0:
            return False
        for side in ("low", "high"):
            here = int(getattr(mine, side)[a]) if first <= second else a
            stack.append((here, int(getattr(other, side)[b]) if second <= first else b))
    return True


def other_controllers(certificate: OnGrid, complement: OnGrid) -> list[str]:
    """Why the controllers of two certificates act differently before the task of the first is decided; empty if not.

    What they do afterwards changes nothing: an accepting state of a co-safe task, or a dead state, is not left, and who
    is outside its workspace has failed. So the opposite may have cells around those of the certificate.
    """
    if len(certificate.proof.agents) != len(complement.proof.agents):
        return ["they are not the same agents"]
    undecided = np.flatnonzero(~certificate.problem.automaton.absorbing)
    horizon, failures = certificate.problem.horizon, []
    for agent, mine, other in zip(
        certificate.problem.agents, certificate.proof.agents, complement.proof.agents, strict=True
    ):
        cells = _cells_within(other.grid, mine.grid)
        same = (
            len(mine.lattice) == len(other.lattice)
            and all(map(np.array_equal, mine.lattice, other.lattice))
            and mine.acting == other.acting
        )
        if cells is None or mine.input_set is None or other.input_set is None:
            same = same and cells is not None and mine.input_set is other.input_set
        else:
            same = same and np.array_equal(mine.input_set, other.input_set[cells])
        if not same or not np.array_equal(
            np.broadcast_to(mine.policy, (horizon, *mine.policy.shape[1:]))[:, undecided],
            np.broadcast_to(other.policy, (horizon, *other.policy.shape[1:]))[:, undecided][..., cells],
        ):
            failures.append(f"agent `{agent.name}` does not act as it does under the certificate")
    return failures


def _cells_within(grid: Grid, inner: Grid) -> NDArray[np.int64] | None:
    """Numbers of the cells of a grid that are those of another one, in its order; None if that is no part of it.

    Upper ends may be the next number: workspaces hold their upper faces, and what is beyond begins there.
    """
    places = []
    for theirs, ours in zip(grid.edges, inner.edges, strict=True):
        first = int(np.searchsorted(theirs, ours[0]))
        cut = theirs[first : first + len(ours)]
        if len(cut) < len(ours) or not np.array_equal(cut[:-1], ours[:-1]):
            return None
        if cut[-1] not in (ours[-1], np.nextafter(ours[-1], np.inf)):
            return None
        places.append(np.arange(first, first + len(ours) - 1))
    return np.asarray(np.ravel_multi_index(np.ix_(*places), grid.shape)).ravel()
