"""Proofs on cells: every agent has cells, a choice for each of them by time and automaton state, and shares a tree.

Agents must not share noise, and the noise of each must be independent and positive along the axes of its states. What
is asked here: cells tile the workspace; inputs stay in their boxes; guards lead where they say, also from the letter of
time 0; then the value at the start is recomputed (``tree``), and the claim follows if it is at least 1 - failure.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import fields
from .cells import Cells, Kernel, spread, start_weights
from .expressions import names_in
from .fields import Refused
from .file import Contents
from .labels import cell_labels
from .motions import check_targets, maps_of_inputs
from .problem import STANDARD, Agent, Problem
from .rigorous import Array
from .tables import normal_table
from .trains import value_at_start as by_trains
from .tree import Guards, Tree, check_guards, value_at_start

MOST_CELLS, MOST_PARTS = 2**26, 16
"""Cells of an agent, and parts of a side at whose ends values are read."""


def read_proof(contents: Contents, problem: Problem) -> CellProof:
    """Return the proof in a file; raise ``Unreadable`` if there is none of this kind."""
    data = fields.table(contents.header["proof"], "proof", ("kind", "guards", "start", "agents"), ("tree", "tolerance"))
    if ("tree" in data) == ("tolerance" in data):
        raise fields.Unreadable("proof: expected either `tree`, or `tolerance` for tensor trains")
    Q, agents = len(problem.automaton.accepting), problem.agents
    entries = fields.each(data["agents"], "proof.agents", _entry, len(agents))
    cells = [AgentCells.read(contents, entry, agent, problem) for entry, agent in zip(entries, agents, strict=True)]
    sets = [len(own.sets) for own in cells], [len(own.start_sets) for own in cells]
    guards = _guards(contents, data["guards"], "proof.guards", Q, sets[0])
    start = _guards(contents, data["start"], "proof.start", Q, sets[1])
    if "tolerance" in data:
        tolerance = fields.number(data["tolerance"], "proof.tolerance")
        if not 0.0 < tolerance < 1.0:
            raise fields.expected("proof.tolerance", "a number between 0 and 1", tolerance)
        return CellProof(tuple(cells), guards, start, tolerance)
    own = fields.table(data["tree"], "proof.tree", ("vertices", "unions", "kept"))
    T, n, most = problem.horizon, len(agents), 2**31
    limits = {
        "vertices": (T, Q, len(guards.source), most),
        "unions": (T, Q, most, most, n, n + 1),
        "kept": (T, Q, most),
    }
    tables = [_columns(contents, own[name], f"proof.tree.{name}", ends) for name, ends in limits.items()]
    return CellProof(tuple(cells), guards, start, Tree(*tables))


class CellProof:
    """What a file holds of all agents: cells, guards, guards of the letter of time 0, and the tree.

    In the place of a tree there may be the tolerance of tensor trains: what their cuts may cost.
    """

    def __init__(self, cells: tuple[AgentCells, ...], guards: Guards, start: Guards, tree: Tree | float) -> None:
        self.cells, self.guards, self.start, self.tree = cells, guards, start, tree


def failure_of(problem: Problem, proof: CellProof) -> float:
    """Return an upper bound on the probability that the task fails; raise ``Refused`` if nothing follows."""
    if problem.pairs:
        raise Refused("the task is about pairs of agents, and cells know single agents")
    if any(np.any(agent.shared_noise) for agent in problem.agents):
        raise Refused("agents share noise, and cells take them for independent")
    if any(agent.angles for agent in problem.agents):
        raise Refused("a state is an angle, and cells take states for numbers")
    # Labels, guards of all steps, and guards of the letter of time 0.
    known = [cell_labels(problem, i, own.edges) for i, own in enumerate(proof.cells)]
    check_guards(problem.automaton, proof.guards, [own.sets for own in proof.cells], known)
    initial = np.full(len(proof.start.target), problem.automaton.initial, dtype=np.int64)
    start = Guards(initial, proof.start.target, proof.start.sets)
    check_guards(problem.automaton, start, [own.start_sets for own in proof.cells], known)
    # Kernels of agents that are alike are made once.
    kernels: dict[Any, Kernel] = {}
    cells = [own.cells(agent, problem, kernels) for own, agent in zip(proof.cells, problem.agents, strict=True)]
    arguments = problem.automaton, problem.horizon, cells, proof.guards, start
    value = (
        value_at_start(*arguments, proof.tree) if isinstance(proof.tree, Tree) else by_trains(*arguments, proof.tree)
    )
    return min(1.0, float(np.nextafter(1.0 - value, 2.0)))


# Reading.

KEYS = ("edges", "lattice", "values", "parts", "inputs", "inverse", "sets", "start_sets", "policy")


def _entry(value: Any, place: str) -> dict[str, Any]:
    return fields.table(value, place, KEYS)


def _columns(contents: Contents, number: Any, place: str, below: tuple[int, ...]) -> NDArray[np.int64]:
    """Return a table of whole numbers; only the last column of unions, of remainders, may be negative."""
    rows = contents.integers(number, place, (None, len(below)), -(2**31), 2**31)
    least = -(below[-1] - 1) if len(below) == 6 else 0
    for k, end in enumerate(below):
        column = rows[:, k]
        if len(column) and (column.min() < (least if k == 5 else 0) or column.max() >= end):
            raise fields.Unreadable(f"{place}: column {k} holds a number that is out of range")
    return rows


def _guards(contents: Contents, value: Any, place: str, Q: int, sets: list[int]) -> Guards:
    own = fields.table(value, place, ("target", "sets") if place == "proof.start" else ("source", "target", "sets"))
    target = contents.integers(own["target"], f"{place}.target", (None,), 0, Q)
    source = contents.integers(own["source"], f"{place}.source", (len(target),), 0, Q) if "source" in own else target
    table = contents.integers(own["sets"], f"{place}.sets", (len(target), len(sets)), 0, 2**31)
    if np.any(table >= np.array(sets)):
        raise fields.Unreadable(f"{place}.sets: it names a set of cells that does not exist")
    return Guards(source, target, table)


class AgentCells:
    """What a file holds of one agent."""

    def __init__(self, **values: Any) -> None:
        self.edges: list[Array] = values["edges"]
        self.lattice: list[Array] = values["lattice"]
        self.corners: bool = values["corners"]
        self.parts: int = values["parts"]
        self.inputs: Array = values["inputs"]
        self.inverse: Array | None = values["inverse"]
        self.sets: NDArray[np.bool_] = values["sets"]
        self.start_sets: NDArray[np.bool_] = values["start_sets"]
        self.policy: NDArray[np.int64] = values["policy"]
        self.key: tuple[Any, ...] = values["key"]

    @classmethod
    def read(cls, contents: Contents, entry: dict[str, Any], agent: Agent, problem: Problem) -> AgentCells:
        """Return what an entry of the header names; ``Unreadable`` if it does not fit the agent."""
        place, d, m = f"proof.{agent.name}", len(agent.states), len(agent.inputs)

        def axes(key: str) -> list[Array]:
            found = fields.each(entry[key], f"{place}.{key}", lambda k, at: contents.floats(k, at, (None,)), d)
            if any(len(axis) < 2 or np.any(np.diff(axis) <= 0.0) for axis in found):
                raise fields.Unreadable(f"{place}.{key}: an axis has fewer than two numbers, or does not increase")
            return found

        edges, lattice = axes("edges"), axes("lattice")
        S, Z = (int(np.prod([float(len(axis) - less) for axis in own])) for own, less in ((edges, 1), (lattice, 0)))
        if max(S, Z) > MOST_CELLS:
            raise fields.Unreadable(f"{place}: it has more than {MOST_CELLS} cells or lattice points")
        if entry["values"] not in ("cells", "corners"):
            raise fields.expected(f"{place}.values", "'cells' or 'corners'", entry["values"])
        inputs = contents.floats(entry["inputs"], f"{place}.inputs", (None, m))
        inverse = entry["inverse"]
        policy = contents.integers(
            entry["policy"], f"{place}.policy", (None, len(problem.automaton.accepting), S), -1, len(inputs) + Z
        )
        if len(policy) not in (1, problem.horizon):
            raise fields.Unreadable(f"{place}.policy: it is for {len(policy)} times, of {problem.horizon}")
        return cls(
            edges=edges,
            lattice=lattice,
            corners=entry["values"] == "corners",
            parts=fields.whole(entry["parts"], f"{place}.parts", 1, MOST_PARTS + 1),
            inputs=inputs,
            inverse=None if inverse is None else contents.floats(inverse, f"{place}.inverse", (m, d)),
            sets=contents.truths(entry["sets"], f"{place}.sets", (None, S)),
            start_sets=contents.truths(entry["start_sets"], f"{place}.start_sets", (None, S)),
            policy=policy,
            key=tuple(str(entry[key]) for key in ("edges", "lattice", "values", "parts", "inputs", "inverse")),
        )

    def cells(self, agent: Agent, problem: Problem, kernels: dict[Any, Kernel]) -> Cells:
        """Return the cells of an agent; ``kernels`` are those of agents before it, for agents that are alike."""
        # Cells tile the workspace: what leaves them has left it.
        low, high = (np.array([axis[k] for axis in self.edges]) for k in (0, -1))
        if not np.array_equal(low, agent.state_box[0]) or not np.array_equal(high, agent.state_box[1]):
            raise Refused(f"the cells of `{agent.name}` do not tile its workspace")
        # agents that differ in no number share what is computed from it
        tied = names_in(agent.dynamics) & (agent.states_of_others.keys() | agent.inputs_of_others.keys())
        moves = agent.dynamics, agent.states, agent.inputs, tuple(agent.disturbances.items())
        numbers = agent.noise.tobytes(), agent.input_box.tobytes(), self.policy.tobytes()
        key = (*self.key, *moves, *numbers, agent.name if tied else "")
        if key not in kernels:
            kernels[key] = self._kernel(agent, problem)
        weights = start_weights(agent.start, self.edges, self.corners)
        return Cells(kernels[key], self.sets, self.policy, spread(self.start_sets, kernels[key]) * weights)

    def _kernel(self, agent: Agent, problem: Problem) -> Kernel:
        deviations = _deviations(agent)
        # Tables of the noise around lattice points, axis by axis.
        pairs = zip(self.lattice, self.edges, deviations.tolist(), strict=True)
        tables = [normal_table(points, edges, deviation, self.corners) for points, edges, deviation in pairs]
        count, chosen = len(self.inputs), self._choices()
        # Inputs have maps; targets have to be reached from all of their cells.
        moving = chosen[chosen[:, 1] < count]
        maps = maps_of_inputs(agent, problem.agents, self.edges, self.inputs, moving[:, 0] * count + moving[:, 1])
        aimed, rest = chosen[chosen[:, 1] >= count], np.zeros(len(deviations))
        if len(aimed):
            if self.inverse is None:
                raise Refused(f"`{agent.name}` chooses targets, and no matrix says by which inputs")
            points = np.unravel_index(aimed[:, 1] - count, [len(axis) for axis in self.lattice])
            targets = np.stack([axis[k] for axis, k in zip(self.lattice, points)], axis=1)
            rest = check_targets(agent, self.edges, self.inverse, aimed[:, 0], targets)
        return Kernel(
            tuple(len(axis) - 1 for axis in self.edges),
            tuple(self.edges),
            tuple(self.lattice),
            deviations,
            tuple(table for table, _ in tables),
            float(sum(lack for _, lack in tables)),
            count,
            maps,
            rest,
            self.corners,
            self.parts,
        )

    def _choices(self) -> NDArray[np.int64]:
        """Return the pairs (n, 2) of a cell and a choice that the policy has, each once, in increasing order."""
        most = int(self.policy.max(initial=0)) + 1
        numbers = np.arange(self.policy.shape[2]) * most + self.policy
        numbers = np.unique(numbers[self.policy >= 0])
        return np.stack(np.divmod(numbers, most), axis=1)


def _deviations(agent: Agent) -> Array:
    """Return the deviation (d,) of the noise along each state; ``Refused`` unless it is independent along them."""
    if agent.scale or any(envelope != STANDARD for envelope in agent.envelopes):
        raise Refused(f"the noise of `{agent.name}` is not normal and the same everywhere")
    used = agent.noise != 0.0
    if np.any(used.sum(axis=1) != 1) or np.any(used.sum(axis=0) > 1):
        raise Refused(f"the noise of `{agent.name}` is not independent and positive along each of its states")
    return np.asarray(np.abs(agent.noise).sum(axis=1))
