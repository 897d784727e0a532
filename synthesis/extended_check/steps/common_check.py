"""Inputs that are chosen in common, for the check: one number for the whole team at each time and automaton state.

A certificate may say that agents know inputs of others (``common`` in the relation of an agent, with names and
numbers; the choices of its menu come in as many equal parts as there are rows of numbers). That is true only if these
inputs depend on time and automaton state alone. So for every name the numbers that any cell of any agent counts with,
and the inputs that the owner applies in any of its cells, must be one and the same number there. Cells without a choice
have the value 0 and count for nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent, AnyAgent
from ...certificates.cell_probabilities import AgentRecord
from ...certificates.proofs import OnGrid
from ...relations.grids import FloatArray


def wrong_common(certificate: OnGrid) -> list[str]:
    """What is wrong with inputs that are said to be chosen in common; an empty list if nothing is."""
    agents, parts = certificate.problem.agents, certificate.proof.agents
    names = {name for part in parts for name in part.relation.get("common", {}).get("names", ())}
    times = max(len(part.policy) for part in parts)
    failures = []
    for name in sorted(names):
        owner, _, own_input = name.partition(".")
        owners = [i for i, agent in enumerate(agents) if agent.name == owner]
        inputs = getattr(agents[owners[0]], "inputs", ()) if owners else ()
        if own_input not in inputs:
            failures.append(f"{name!r} is said to be chosen in common, and is no input of an agent")
            continue
        part = parts[owners[0]]
        if part.relation["kind"] != "boxes":
            failures.append(f"{name!r} is said to be chosen in common, and depends on the state of its agent")
            continue
        least, most = _applied(part, inputs.index(own_input), times)
        for other in parts:
            if name in other.relation.get("common", {}).get("names", ()):
                low, high = _counted_with(other, name, times)
                least, most = np.minimum(least, low), np.maximum(most, high)
        # Where nobody has a choice nothing is counted with: infinite the wrong way round.
        if np.any(least < most):
            failures.append(f"{name!r} is said to be chosen in common, and is not the same for all cells and agents")
    return failures


def _applied(part: AgentRecord, own_input: int, times: int) -> tuple[FloatArray, FloatArray]:
    """Least and largest input (T, Q) that an owner applies; minus and plus infinity where a choice steers it."""
    input_set, steer = np.array(part.relation["menu"], dtype=float), np.array(part.relation["steer"], dtype=bool)
    column = input_set[:, own_input]
    return _ends(part, np.where(steer, -np.inf, column), np.where(steer, np.inf, column), times)


def _counted_with(part: AgentRecord, name: str, times: int) -> tuple[FloatArray, FloatArray]:
    """Least and largest number (T, Q) that an agent counts with for an input."""
    common, n_choices = part.relation["common"], len(part.relation["menu"])
    numbers = np.array(common["numbers"], dtype=float)[:, common["names"].index(name)]
    column = np.repeat(numbers, n_choices // len(numbers))
    return _ends(part, column, column, times)


def _ends(part: AgentRecord, low: FloatArray, high: FloatArray, times: int) -> tuple[FloatArray, FloatArray]:
    """Least and largest (T, Q) of numbers (A,) over the choices of all cells that have one."""
    chosen, asked = np.maximum(part.policy, 0), part.policy >= 0
    least = np.where(asked, low[chosen], np.inf).min(axis=2)
    most = np.where(asked, high[chosen], -np.inf).max(axis=2)
    shape = (times, part.policy.shape[1])
    # Policies that do not look at the time have a single row.
    return np.broadcast_to(least, shape), np.broadcast_to(most, shape)


def known_inputs(agent: AnyAgent, part: AgentRecord, choices: NDArray[np.integer]) -> dict[int, FloatArray]:
    """Numbers (C,) of inputs of others under choices (C,), by their places among `others`; empty if none is known."""
    common = part.relation.get("common")
    if common is None:
        return {}
    numbers = np.array(common["numbers"], dtype=float)
    row = choices // (len(part.relation["menu"]) // len(numbers))
    columns = {name: k for k, name in enumerate(common["names"])}
    return {k: numbers[row, columns[name]] for k, name in enumerate(agent.others) if name in columns}


def by_number(
    agent: Agent, part: AgentRecord, choices: NDArray[np.integer]
) -> Iterator[tuple[NDArray[np.int64], Agent]]:
    """Groups of choices (C,) that count with the same numbers, and the agent with these in the place of names."""
    known = known_inputs(agent, part, choices)
    if not known or not len(choices):
        yield np.arange(len(choices)), agent
        return
    rows, which = np.unique(np.stack([*known.values()]), axis=1, return_inverse=True)
    for k, row in enumerate(rows.T.tolist()):
        knowing = agent.knowing({agent.others[place]: number for place, number in zip(known, row, strict=True)})
        yield np.flatnonzero(which.ravel() == k), knowing
