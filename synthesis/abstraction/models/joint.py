"""What dynamic programming needs of a problem: agent models, guards, masks and start, compiled once.

The start is an occupancy like any other: the point or box of initial states as a product over agents, after the letter
of time 0 was read, ``qbar_0 = next_state(q_0, l_0)`` (docs/theory/setting.md, "Letters and words").
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.arguments import counted, tree_text
from ....envs.tasks.automata import met_in_time
from ....envs.tasks.problem import Problem
from ...certificates.value_functions import Guards, Occupancy, Terms
from ...relations.grids import CellLabels, FloatArray, alike_text, shape_text
from .finite_models import Abstraction, AgentModel
from .guards import compile_guards

MOST_OCCURRING = 0.5
"""Share of pairs of a time and an undecided automaton state up to which only those that occur have values."""


@dataclass(frozen=True, eq=False, repr=False)
class JointModel:
    """Agent models joined by the robust automaton.

    Parameters
    ----------
    models : tuple of AgentModel
    guards : Guards
        Disjoint guards between automaton states.
    masks : tuple of (K_i, S_i) arrays
        Factors of the guards on the cells of each agent.
    start_guards, start_masks
        The same for reading the letter of time 0, when the state is known to be in the cell itself.
    accepting : (Q,) bool array
    absorbing : (Q,) bool array
        States in which nothing is left to decide: accepting ones of co-safe tasks, and dead ones.
    horizon : int
        Control steps T.
    finds_alike : bool
        Whether sweeps look for factors that are equal without being the same: it keeps trees of tasks small that look
        at the end alone, and leaves the bits of all others to what they were if it is not asked for.
    spend : callable, optional
        Told the work of sweeps, in core seconds, before it is done; it raises what ends them.
    """

    models: tuple[AgentModel, ...]
    guards: Guards
    masks: tuple[NDArray, ...]
    start_guards: Guards
    start_masks: tuple[NDArray, ...]
    accepting: NDArray[np.bool_]
    absorbing: NDArray[np.bool_]
    horizon: int
    finds_alike: bool = False
    spend: Callable[[float], None] | None = None

    def __repr__(self) -> str:
        rows: list[tuple[str, object]] = [
            ("cells", alike_text(shape_text(model.grid.shape) for model in self.models)),
            ("guards", f"{len(self.guards.source)} out of {counted(len({*self.guards.source.tolist()}), 'state')}"),
            ("start guards", len(self.start_guards.source)),
            ("horizon", counted(self.horizon, "control step")),
        ]
        sizes = f"{counted(len(self.models), 'agent')}, {counted(self.n_states, 'automaton state')}"
        return tree_text(f"JointModel: {sizes}", rows)

    @cached_property
    def occurs(self) -> NDArray[np.bool_]:
        """Which undecided automaton states (T, Q) a run may be in at each time, once its letter was read.

        Operators with deadlines count steps in the automaton: few of its states occur at any one time, and values of
        the others need not be computed. Where more than half of all pairs occur, all count as such.
        """
        initial = self.start_guards.source[:1].astype(np.int64)
        here = np.zeros(self.n_states, dtype=bool)
        here[self.start_guards.target] = True
        here[initial] |= self.absorbing[initial]
        rows = []
        for _ in range(self.horizon):
            rows.append(here)
            after = np.zeros(self.n_states, dtype=bool)
            after[self.guards.target[here[self.guards.source]]] = True
            here = after
        table = np.array(rows).reshape(self.horizon, self.n_states)
        return table if _is_sparse(table[:, ~self.absorbing]) else np.ones_like(table)

    @property
    def n_cells(self) -> tuple[int, ...]:
        """Cells of each agent."""
        return tuple(model.n_cells for model in self.models)

    @property
    def n_states(self) -> int:
        """Automaton states Q."""
        return len(self.accepting)


def _is_sparse(table: NDArray[np.bool_]) -> bool:
    """Return whether few pairs of a time and an undecided state occur."""
    return bool(table.size and np.mean(table) <= MOST_OCCURRING)


def count_of_decisions(problem: Problem) -> int:
    """Return how many pairs of a time and an undecided automaton state have values, before any model is made.

    They are those of ``JointModel.occurs``, or a few more: letters that no cell has count here.
    """
    automaton = problem.automaton
    table = met_in_time(automaton, problem.horizon)[:, ~automaton.absorbing]
    return int(table.sum()) if _is_sparse(table) else int(table.size)


def join(problem: Problem, abstraction: Abstraction) -> JointModel:
    """Return the models of ``abstraction`` joined by the guards of ``problem``."""
    automaton = problem.automaton
    models = abstraction.models
    guards = compile_guards(problem, [model.labels.sets for model in models])
    start_guards = compile_guards(problem, [model.start_labels.sets for model in models], [automaton.initial])
    return JointModel(
        models=models,
        guards=guards,
        masks=_at_places(models, cell_masks(guards, [model.labels for model in models])),
        start_guards=start_guards,
        start_masks=_at_places(models, cell_masks(start_guards, [model.start_labels for model in models])),
        accepting=np.asarray(automaton.accepting, dtype=bool),
        absorbing=automaton.absorbing,
        horizon=problem.horizon,
    )


def start_of(problem: Problem, joint: JointModel) -> Occupancy:
    """Return the occupancy at time 0 for the problem's initial states: points, or uniform distributions over boxes.

    The mass of a box is spread over the cells it overlaps; starts outside the workspace carry none.
    """
    boxes = [agent.initial for agent in problem.agents]
    if all(np.array_equal(box.low, box.high) for box in boxes):
        return point_start(problem, joint, [box.low for box in boxes])
    pairs = zip(boxes, joint.models, strict=True)
    factors = [model.share(box.low, box.high) for box, model in pairs]
    return _read_first_letter(problem, joint, factors)


POINT_SHARE = 0.99
"""Share of the mass of a search's start that lies on the true start; the rest is spread over the workspaces."""


def spread_start(problem: Problem, joint: JointModel) -> Occupancy:
    """Return the start that a search weighs decisions with: each agent at its start with .99, in any cell with .01.

    Cells beside the path then matter a little, and their values are worth something to learners and shields.
    """
    factors = []
    for agent, model in zip(problem.agents, joint.models, strict=True):
        here = model.share(agent.initial.low, agent.initial.high)
        inside = model.spread(model.labels.number >= 0)
        anywhere = inside / max(1, np.count_nonzero(inside))
        factors.append(POINT_SHARE * here + (1.0 - POINT_SHARE) * anywhere)
    return _read_first_letter(problem, joint, factors)


def point_start(problem: Problem, joint: JointModel, states: Sequence[FloatArray]) -> Occupancy:
    """Return the occupancy at time 0 for one joint state, a sequence of (d_i,) vectors; its true letter is read."""
    automaton = problem.automaton
    q = int(automaton.next_state(np.asarray(automaton.initial), problem.labeling.letter(states)))
    factors = []
    for agent, model, state in zip(problem.agents, joint.models, states, strict=True):
        mass = np.zeros((1, model.n_cells))
        if np.all((agent.workspace.low <= state) & (state <= agent.workspace.high)):
            mass[0] = model.share(state, state)
        factors.append(mass)
    alive = all(mass.any() for mass in factors) and not automaton.dead[q]
    n_agents = len(factors)
    rows = [np.zeros((int(alive and other == q), n_agents), dtype=np.int64) for other in range(joint.n_states)]
    return Occupancy(Terms(tuple(factors), tuple(rows)), 0.0)


def _at_places(models: Sequence[AgentModel], masks: Sequence[NDArray]) -> tuple[NDArray, ...]:
    """Return masks of cells at all places of factors."""
    return tuple(model.spread(mask) for model, mask in zip(models, masks, strict=True))


def _read_first_letter(problem: Problem, joint: JointModel, factors: Sequence[FloatArray]) -> Occupancy:
    """Return the occupancy of a product over agents once the guards out of the initial state have read it."""
    initial = problem.automaton.initial
    n_agents = len(factors)
    # An initial state that nothing leaves has no guards: all mass stays in it, or none is alive.
    if joint.absorbing[initial]:
        alive = bool(joint.accepting[initial])
        per_state = [np.zeros((int(alive and q == initial), n_agents), dtype=np.int64) for q in range(joint.n_states)]
        return Occupancy(Terms(tuple(f[None] for f in factors), tuple(per_state)), 0.0)
    # Each guard keeps the mass that its masks let through; products with an empty factor are left out.
    masked = tuple(mask * factor for mask, factor in zip(joint.start_masks, factors, strict=True))
    guards = joint.start_guards
    index = []
    for q in range(joint.n_states):
        chosen = np.flatnonzero((guards.source == initial) & (guards.target == q))
        rows = guards.mask[chosen].astype(np.int64)
        alive_rows = np.ones(len(rows), dtype=bool)
        for i, agent_factors in enumerate(masked):
            alive_rows &= np.any(agent_factors != 0, axis=1)[rows[:, i]]
        index.append(rows[alive_rows])
    return Occupancy(Terms(masked, tuple(index)), 0.0)


def cell_masks(guards: Guards, cells: Sequence[CellLabels]) -> tuple[NDArray, ...]:
    """Return, per agent, the indicator (K_i, S_i) of each mask on the cells; 0 at cells that may be outside."""
    masks = []
    for sets, labels in zip(guards.masks, cells, strict=True):
        on_cells = np.zeros((len(sets), len(labels.number)), dtype=bool)
        inside = labels.number >= 0
        on_cells[:, inside] = sets[:, labels.number[inside]]
        masks.append(on_cells)
    return tuple(masks)
