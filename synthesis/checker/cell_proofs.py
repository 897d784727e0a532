"""Proofs on cells: every agent has cells, a choice for each of them by time and automaton state, and shares a tree.

Agents must not share noise, and the noise of each must be independent and positive along the axes of its states. What
is asked here: cells tile the workspace; inputs stay in their boxes; guards lead where they say, also from the letter of
time 0; then the value at the start is recomputed (``tree``), and the claim follows if it is at least 1 - failure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .cells import Cells, Grid, Kernel, spread, start_weights
from .distributions import normal_table
from .expressions import names_in
from .fields import Entry, Refused
from .file import Contents
from .motions import cell_labels, check_targets, maps_of_inputs
from .problem import STANDARD, Agent, Problem
from .rigorous import Array, Truth, Whole
from .trains import value_at_start as by_trains
from .tree import Guards, Team, Tree, check_guards, value_at_start

MOST_CELLS, MOST_PARTS = 2**26, 16  # cells of an agent, and parts of a side at whose ends values are read


def read_proof(contents: Contents, problem: Problem) -> CellProof:
    """Return the proof in a file; raise ``Unreadable`` if there is none of this kind."""
    entry = contents.entry("proof")
    own = entry.table(("kind", "guards", "start", "agents"), ("tree", "tolerance"))
    if ("tree" in own) == ("tolerance" in own):
        raise entry.wrong("expected either `tree`, or `tolerance` for tensor trains")
    Q, agents = len(problem.automaton.accepting), problem.agents
    entries = zip(own["agents"].entries(len(agents)), agents, strict=True)
    cells = tuple(AgentCells.read(entry, agent, problem) for entry, agent in entries)
    guards = _guards(own["guards"].table(("source", "target", "sets")), Q, [len(one.sets) for one in cells])
    start = _guards(own["start"].table(("target", "sets")), Q, [len(one.start_sets) for one in cells])
    if "tolerance" in own:
        tolerance = own["tolerance"].number()
        if not 0.0 < tolerance < 1.0:
            raise own["tolerance"].expected("a number between 0 and 1")
        return CellProof(cells, guards, start, tolerance)
    # Columns of the tables of a tree, and below what their numbers are.
    T, n, most = problem.horizon, len(agents), 2**31
    tree = own["tree"].table(("vertices", "unions", "kept"))
    return CellProof(cells, guards, start, Tree(
        _columns(tree["vertices"], (T, Q, len(guards.source), most)),
        _columns(tree["unions"], (T, Q, most, most, n, n + 1)),
        _columns(tree["kept"], (T, Q, most)),
    ))  # fmt: skip


@dataclass(frozen=True, eq=False)
class CellProof:
    """What a file holds of all agents: cells, guards, guards of the letter of time 0, and the tree.

    In the place of a tree there may be the tolerance of tensor trains: what their cuts may cost.
    """

    cells: tuple[AgentCells, ...]
    guards: Guards
    start: Guards
    tree: Tree | float

    @property
    def more(self) -> tuple[str, ...]:
        """Modules of the checker that it needs besides."""
        return () if isinstance(self.tree, Tree) else ("trains",)


def failure_of(problem: Problem, proof: CellProof) -> tuple[float, str, list[Any]]:
    """Return an upper bound on the probability that the task fails, and no more; ``Refused`` if none follows."""
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
    team, tree = Team(problem.automaton, problem.horizon, cells, proof.guards, start), proof.tree
    value = value_at_start(team, tree) if isinstance(tree, Tree) else by_trains(team, tree)
    return min(1.0, float(np.nextafter(1.0 - value, 2.0))), "", []


KEYS = ("edges", "lattice", "values", "parts", "inputs", "inverse", "sets", "start_sets", "policy")


def _columns(entry: Entry, below: tuple[int, ...]) -> Whole:
    """Return a table of whole numbers; only the last column of unions, of remainders, may be negative."""
    rows, least = entry.integers((None, len(below)), -(2**31), 2**31), np.zeros(len(below))
    least[5:] = 1 - below[-1]  # of remainders alone
    wrong = np.flatnonzero(np.any((rows < least) | (rows >= np.array(below)), axis=0))
    if len(wrong):
        raise entry.wrong(f"column {wrong[0]} holds a number that is out of range")
    return rows


def _guards(own: dict[str, Entry], Q: int, sets: list[int]) -> Guards:
    target = own["target"].integers((None,), 0, Q)
    source = own["source"].integers((len(target),), 0, Q) if "source" in own else target
    table = own["sets"].integers((len(target), len(sets)), 0, 2**31)
    if np.any(table >= np.array(sets)):
        raise own["sets"].wrong("it names a set of cells that does not exist")
    return Guards(source, target, table)


def _axis(entry: Entry) -> Array:
    """Return increasing numbers, two of them at least."""
    axis = entry.floats((None,))
    if len(axis) < 2 or np.any(np.diff(axis) <= 0.0):
        raise entry.wrong("an axis has fewer than two numbers, or does not increase")
    return axis


@dataclass(frozen=True, eq=False)
class AgentCells(Grid):
    """What a file holds of one agent; ``key`` says which arrays its cells and maps are made of."""

    inputs: Array
    inverse: Array | None
    sets: Truth
    start_sets: Truth
    policy: Whole
    key: tuple[str, ...]

    @classmethod
    def read(cls, entry: Entry, agent: Agent, problem: Problem) -> AgentCells:
        """Return what an entry of the header names; ``Unreadable`` if it does not fit the agent."""
        own, d, m = entry.table(KEYS), len(agent.states), len(agent.inputs)
        edges, lattice = (tuple(_axis(axis) for axis in own[key].entries(d)) for key in ("edges", "lattice"))
        # cells and lattice points, counted in doubles: a product of whole numbers may overflow
        S, Z = (int(np.prod([float(len(axis) - less) for axis in axes])) for axes, less in ((edges, 1), (lattice, 0)))
        if max(S, Z) > MOST_CELLS:
            raise entry.wrong(f"it has more than {MOST_CELLS} cells or lattice points")
        inputs = own["inputs"].floats((None, m))
        # A choice is an input, or a lattice point as target; -1 is none.
        policy = own["policy"].integers((None, len(problem.automaton.accepting), S), -1, len(inputs) + Z)
        if len(policy) not in (1, problem.horizon):
            raise own["policy"].wrong(f"it is for {len(policy)} times, of {problem.horizon}")
        corners, parts = own["values"].one_of(("cells", "corners")) == "corners", own["parts"].whole(1, MOST_PARTS + 1)
        inverse = None if own["inverse"].value is None else own["inverse"].floats((m, d))
        sets, start_sets = (own[key].truths((None, S)) for key in ("sets", "start_sets"))
        key = tuple(str(own[name].value) for name in KEYS[:6])
        return cls(edges, lattice, corners, parts, inputs, inverse, sets, start_sets, policy, key)

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
        if agent.scale or any(envelope != STANDARD for envelope in agent.envelopes):
            raise Refused(f"the noise of `{agent.name}` is not normal and the same everywhere")
        used, deviations = agent.noise != 0.0, np.abs(agent.noise).sum(axis=1)
        if np.any(used.sum(axis=1) != 1) or np.any(used.sum(axis=0) > 1):
            raise Refused(f"the noise of `{agent.name}` is not independent and positive along each of its states")
        # Tables of the noise around lattice points, axis by axis.
        pairs = zip(self.lattice, self.edges, deviations.tolist(), strict=True)
        tables = [normal_table(points, edges, deviation, self.corners) for points, edges, deviation in pairs]
        # Pairs (n, 2) of a cell and a choice that the policy has, each once, in increasing order.
        count, most = len(self.inputs), int(self.policy.max(initial=0)) + 1
        numbers = np.unique((np.arange(self.policy.shape[2]) * most + self.policy)[self.policy >= 0])
        chosen = np.stack(np.divmod(numbers, most), axis=1)
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
        lack = float(sum(own for _, own in tables))
        grid = self.edges, self.lattice, self.corners, self.parts
        return Kernel(*grid, deviations, tuple(table for table, _ in tables), lack, count, maps, rest)
