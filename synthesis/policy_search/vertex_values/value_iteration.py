"""Value iteration on finer and finer grids: values by the checker's Bellman backup, cells where runs pass."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.distributions import Law
from ....envs.tasks.problem import Problem
from ...certificates.proofs import NotCanonicalError, Synthesis, VertexGrid, VertexProof, canonical_problem
from ...checker import CheckedProblem, Refused, Unreadable, read_problem
from ...extended_check.vertex_grids import (
    FARTHEST,
    NEAR,
    ROOM,
    Backups,
    Independent,
    Lattice,
    images_at,
    independent,
    vertices_of,
)
from ...relations.grids import FloatArray, RelationRefused
from ...trajectories.planning import CountedWork
from .axis_edges import grid_of, moving_grid_of, spreads_in, spreads_of
from .best_grid import CLAIMED, ENOUGH, BestGrid, left_over
from .counted_backups import Counted
from .input_choice import INPUTS, Choice
from .sampled_runs import Runs, walls_of, within_a_turn

MOST_STATES = 4
"""States up to which there is such a grid."""

FIRST = {1: 60, 2: 400, 3: 1200, 4: 2000}
"""Vertices of the first grid, by the number of states."""

COARSE = 1.0, 2.5
"""How many times as many vertices as the first grid coarse ones have."""

LEFT_OUT, LEAST_NEAR = 1e-3, 4.0
"""Share of the failure that noise may have which is not looked at, in all steps, and deviations that always are."""

FINER_STEPS = np.array([5.0, 4.2, 3.5, 3.0, 2.5, 2.2, 1.9, 1.7, 1.5])
"""How many times as many vertices the next grid has, as the work allows."""

MOST_VERTICES = {1: 2e3, 2: 3e4, 3: 3e4, 4: 3e4}
"""Vertices of the finest grid, by the number of states: on a line each looks at all others."""

GROWS, MORE = 1.25, 1.1
"""Power of the number of vertices with which work grows, before it is known of what kind it is; how much more work the
next grid is than what the kinds of the one before say."""

BEYOND = 3.0
"""Deviations by which a lattice goes beyond the window where runs pass."""

POOR_GUESS = 0.5
"""Failure of a controller from which its runs say nothing of where cells have to be narrow."""

FIRST_WIDTH = 2.5
"""Deviations that cells of the first grid are wide where runs pass, at least."""

SURE_WIDTH, CHARGED, DEAR = 1.6, 1.7, 0.1
"""Deviations that cells are wide at most for a grid to prove something, as a rule; how much more work a grid is on
which something is charged; share of the work that is left which is not spent on wider cells."""

MOVING, MOVING_WIDTH = {2: 0.6, 3: math.inf}, {2: 1.6, 3: 1.3}
"""By the number of states, share of the cells of a grid at rest from which on one moves with runs, and deviations that
its cells are wide at first."""

POINT, FIRST_SHARE = 2e-6, 0.5
"""Work of a point of a lattice in three states, at each time, on a grid that proves something, and the share of the
work that is left which the first one may take."""

HOPELESS = 0.1
"""Share of what a path proves below which what is hoped for on a grid that moves says that its cells are too wide."""

ONLY_MOVING = "a state is an angle: grids of vertices know angles where they move along a path, and there is none"

WIDE = 1.5
"""Deviations from which on a cell is wide: values are continuous across it."""

NARROW, MOST_NARROW = 2.0, 5e4
"""Deviations of the noise that a cell is as wide as, and the most cells so wide that a workspace may have."""


def refuse_vertex_grid(problem: Problem) -> None:
    """Raise RelationRefused where there is no such grid: several agents, more states, other noise."""
    agent = problem.agents[0]
    if problem.n_agents > 1:
        raise RelationRefused("grids of vertices are of one agent")
    if agent.n_states > MOST_STATES or agent.n_inputs not in INPUTS:
        raise RelationRefused(f"grids of vertices have {MOST_STATES} states and {max(INPUTS)} inputs at most")
    try:
        checked = _checked(problem)
        steps = Backups(
            checked,
            whole_of(checked),
            (True,) * agent.n_states,
            NEAR,
            agent.laws,
        )
        len(steps.noises)
    except (Refused, Unreadable, NotCanonicalError) as reason:
        raise RelationRefused(str(reason)) from reason


def whole_of(problem: CheckedProblem) -> tuple[FloatArray, ...]:
    """Return edges of one cell at each time, nearly all of the workspace where there are angles."""
    agent, edges = problem.agents[0], list[FloatArray]()
    for state, (low, high) in zip(agent.states, agent.state_box.T, strict=True):
        is_angle = state in agent.angles
        own = np.array([low + ROOM * is_angle, high - ROOM * is_angle])
        edges.append(np.tile(own, (problem.horizon + 1, 1)) if is_angle else own)
    return tuple(edges)


def _checked(problem: Problem) -> CheckedProblem:
    """Return a problem as the check reads it, in coordinates in which its noise is independent."""
    return independent(read_problem({"problem": canonical_problem(problem)}))


def refuse_small_noise(spreads: FloatArray, window: FloatArray) -> None:
    """Raise RelationRefused where a window (2, d) has too many cells that are as wide as the noise."""
    cells = float(np.prod((window[1] - window[0]) / (NARROW * spreads).mean(axis=1)))
    if cells > MOST_NARROW:
        raise RelationRefused(f"the noise is small: {cells:.2g} cells of a grid would be as wide as it")


def refuse_without_guess(problem: Problem) -> None:
    """Raise RelationRefused where the noise is small beside all that a task leaves of the workspace."""
    refuse_vertex_grid(problem)
    checked = _checked(problem)
    if checked.agents[0].angles:
        raise RelationRefused(ONLY_MOVING)
    spreads = spreads_of(checked)
    first = grid_of(checked, spreads, FIRST[problem.agents[0].n_states], checked.agents[0].state_box)
    refuse_small_noise(spreads, _alive(checked, first))


def vertex_grid_certificate(problem: Problem, work: CountedWork, guess: Any = None) -> Synthesis:
    """Return the certificate of the best grid that the work allows; RelationRefused where there is none.

    Runs under the controller ``guess`` say where cells have to be narrow, if many of them satisfy the task.
    """
    refuse_vertex_grid(problem)
    best = BestGrid[VertexProof](work)
    _refined(problem, work, guess, best)
    return best.synthesis(problem)


def _refined(problem: Problem, work: CountedWork, guess: Any, best: BestGrid[VertexProof]) -> None:
    """Look for the best proof on finer and finer grids."""
    checked, noise_laws = _checked(problem), problem.agents[0].laws
    spreads, states = spreads_of(checked), problem.agents[0].n_states
    vertices, most = float(FIRST[states]), MOST_VERTICES[states]
    full, matrix = checked.agents[0].state_box, checked.matrix if isinstance(checked, Independent) else None
    runs = None if guess is None else Runs.under(problem, guess).seen_by(matrix)
    narrow = None if runs is None else _moving_cells(checked, spreads, runs, noise_laws, work)
    if narrow is None and checked.agents[0].angles:
        raise RelationRefused(ONLY_MOVING)
    if runs is not None and narrow is None and states > 2:
        raise RelationRefused("runs spread too wide for a grid of three states that moves with them")
    if narrow is None:
        alive = _alive(checked, grid_of(checked, spreads, round(vertices), checked.agents[0].state_box))
        # Where the size of noise varies, or its law is another one, what a path keeps to says little.
        if runs is not None and runs.failure < POOR_GUESS and noise_laws is None and not checked.agents[0].scale:
            full = within(alive, runs.window(checked, spreads))
            cells = np.prod(1.0 + (full[1] - full[0]) / (FIRST_WIDTH * np.median(spreads, axis=1)))
            vertices = float(np.clip(cells, vertices, most))
    finer = np.ones(len(spreads))
    with best.kept():
        if runs is None or narrow is None:
            refuse_small_noise(spreads, full)
            # other runs may go further than those of a guess
            runs, spent = _coarse(checked, noise_laws, vertices, within(alive, full), alive, work)
            vertices = min(most, _first(vertices, within(alive, runs.window(checked, spreads)), spreads, spent, work))
        else:
            vertices, window = float(np.clip(narrow, FIRST[states], most)), runs.windows(checked, spreads)
        while True:
            if narrow is None:
                window = within(alive, runs.window(checked, spreads))
                edges = grid_of(checked, spreads, round(vertices), window, finer)
            else:
                window = within_a_turn(checked, hull(window, runs.windows(checked, spreads)))
                edges = moving_grid_of(checked, spreads, round(vertices), window, finer)
            steps = Counted(checked, edges, jumps_of(checked, edges), NEAR, noise_laws).within(work)
            steps.near, steps.window = near_of(steps, max(runs.failure, best.aim)), lattice_around(steps, window)
            had_lattice = best.proof is not None and best.proof.grid.window is not None
            if had_lattice and steps.window is None and steps.agent.disturbances:
                break  # pieces of disturbances stay as wide, and without a lattice more is charged on them
            inputs, laws, failure, hoped = iterated(steps, runs, best.aim)
            is_best = best.tried(" x ".join(str(n) for n in steps.shape), failure)
            if narrow is not None and 1.0 - hoped < HOPELESS * work.largest and failure >= 1.0 - work.largest:
                break
            # Axes along which more is charged get more cells: what is charged falls with the square of their number.
            finer *= steps.wanted
            runs = runs.or_better(Runs.of(steps, inputs, laws, hoped))
            if is_best:
                grid = VertexGrid(edges, inputs, laws, steps.jumps, steps.near, steps.window, matrix)
                best.keep(VertexProof(grid, min(1.0, failure * CLAIMED)), failure)
            least = left_over(failure)
            is_good = least is not None and runs.failure > least and Runs.least_failure(steps, inputs, laws) > least
            each = [min(float(own), most / vertices) for own in FINER_STEPS]
            more = next((own for own in each if work.allows(MORE * steps.grown(own, laws))), None)
            if failure < ENOUGH or best.is_slow or is_good or more is None or vertices >= most:
                break
            vertices *= more


def _moving_cells(
    problem: CheckedProblem, spreads: FloatArray, runs: Runs, noise_laws: Sequence[Law] | None, work: CountedWork
) -> float | None:
    """Return about how many vertices a first grid that moves with runs has; None where one at rest is as good.

    Windows around runs are small, so that three states have a lattice of second derivatives; without one cells of three
    states are charged too much.
    """
    d = len(spreads)
    if d not in MOVING or runs.failure >= POOR_GUESS:
        return None
    windows, lengths, is_smaller = moving_windows(problem, spreads, runs)
    if not is_smaller and not problem.agents[0].angles:
        return None
    cells = 1.0 + lengths.mean(axis=0) / MOVING_WIDTH[d]
    edges = moving_grid_of(problem, spreads, round(float(np.prod(cells))), windows)
    try:
        steps = Backups(problem, edges, (True,) * d, NEAR, noise_laws)
    except Refused:
        return None
    steps.window = lattice_around(steps, windows)
    if d > 2:
        if steps.window is None:
            return None
        points = sum(float(np.prod(steps.lattice(t).shape)) for t in range(1, problem.horizon + 1))
        if POINT * points > FIRST_SHARE * (work.limit - work.spent):
            return None
    return float(np.prod(cells))


def moving_windows(problem: CheckedProblem, spreads: FloatArray, runs: Runs) -> tuple[FloatArray, FloatArray, bool]:
    """Return windows (T + 1, 2, d) of runs, their lengths (T + 1, d) in deviations, and whether they save enough cells.

    A grid that moves along them is much smaller then than one at rest.
    """
    windows, window = runs.windows(problem, spreads), runs.window(problem, spreads)
    lengths = (windows[:, 1] - windows[:, 0]) / spreads_in(problem, spreads, windows)
    at_rest = np.prod((window[1] - window[0]) / np.median(spreads, axis=1))
    return windows, lengths, bool(np.prod(lengths, axis=1).mean() <= MOVING.get(len(spreads), 0.0) * at_rest)


def _coarse(
    problem: CheckedProblem,
    noise_laws: Sequence[Law] | None,
    vertices: float,
    window: FloatArray,
    alive: FloatArray,
    work: CountedWork,
) -> tuple[Runs, float]:
    """Return runs under coarse values, which nothing is charged for, and the work of a grid; a first ``window``."""
    spreads, runs, spent = spreads_of(problem), None, 0.0
    for more in COARSE:
        edges = grid_of(problem, spreads, round(vertices * more), window)
        steps = Counted(problem, edges, jumps_of(problem, edges), NEAR, noise_laws).within(work)
        inputs, laws, _, failure = iterated(steps, runs, is_coarse=True)
        if failure >= 1.0:
            raise RelationRefused("no inputs lead anywhere on coarse grids: is the task out of reach?")
        runs, spent = Runs.of(steps, inputs, laws, failure), steps.spent
        work.hoped(1.0 - runs.failure)
        window = within(alive, runs.window(problem, spreads))
    assert runs is not None
    return runs, spent


def _first(vertices: float, window: FloatArray, spreads: FloatArray, spent: float, work: CountedWork) -> float:
    """Return the vertices of the first grid on which something is charged, from those of coarse ones and their work.

    Where automata have so many states that even a small grid takes a good share of the work, it is not spent on cells
    that are too wide to prove anything.
    """
    sure = float(np.prod(1.0 + (window[1] - window[0]) / (SURE_WIDTH * np.median(spreads, axis=1))))
    coarse, left = COARSE[-1] * vertices, max(0.0, work.limit - work.spent)
    if CHARGED * spent * (vertices / coarse) ** GROWS < DEAR * left:
        return vertices
    return max(vertices, min(sure, coarse * (left / (CHARGED * spent)) ** (1.0 / GROWS)))


def near_of(steps: Backups, failure: float) -> float:
    """Return how many deviations of the noise are looked at: what is left out is little beside a failure."""
    problem = steps.problem
    sides = 4.0 * len(problem.agents[0].states) * problem.horizon
    reach = [noise.reach(LEFT_OUT * failure / sides) for noise in steps.noises if noise is not None]
    return float(np.clip(max(reach, default=NEAR), LEAST_NEAR, FARTHEST))


def lattice_around(steps: Backups, window: FloatArray) -> FloatArray | None:
    """Return ends (.., 2, d) of a lattice around a window of states, of each time too; None where there is none."""
    box = walls_of(steps.problem)
    try:
        beyond = np.outer([-BEYOND, BEYOND], steps.deviations)
        ends = np.clip(window + beyond, *(box + beyond))
        for t, own in enumerate(ends if steps.moves else [ends]):
            Lattice.of(steps.edges_at(t), steps.deviations, own)
    except Refused:
        return None
    return ends


def jumps_of(problem: CheckedProblem, edges: tuple[FloatArray, ...]) -> tuple[bool, ...]:
    """Return along which axes cells are so narrow, for the noise there, that jumps of values cost little."""
    agent, now = problem.agents[0], problem.horizon // 2
    at = vertices_of(tuple(axis[now] if axis.ndim > 1 else axis for axis in edges))
    middle = np.repeat(agent.input_box.mean(axis=0)[None], at.shape[1], axis=0)
    sizes = np.abs(images_at(agent, at, middle, 0)[0][len(at) :])
    return tuple(
        bool(np.median(np.diff(axis, axis=-1)) < WIDE * np.nanmedian(own))
        for axis, own in zip(edges, sizes, strict=True)
    )


def iterated(
    steps: Counted, runs: Runs | None, aim: float = 0.0, is_coarse: bool = False
) -> tuple[FloatArray, NDArray[np.int64], float, float]:
    """Return tables of inputs (L, V, m), which one acts at what time and automaton state (T, Q), and two failures.

    The first one is proved, the second one is what inputs were chosen by. ``runs`` say where inputs matter, and
    ``aim`` how little failure does. ``is_coarse``: nothing is charged, and nothing proved.
    """
    problem, choice = steps.problem, Choice(steps, runs, aim, is_coarse)
    bounds, given_up = steps.at_end()
    values, nowhere = steps.at_end()
    laws = np.zeros((problem.horizon, len(values)), dtype=np.int64)
    for t in range(problem.horizon - 1, -1, -1):
        later = values
        laws[t], values = choice.of(later, t, laws[min(t + 1, problem.horizon - 1)])
        if not is_coarse:
            bounds, given_up = steps.backup(bounds, given_up, np.stack([choice.laws[k] for k in laws[t]]), t)
            # where nothing is proved what is hoped for says along which axes cells are too wide
            for q in np.flatnonzero(given_up.reshape(len(values), -1).all(axis=1) & steps.reached[t]).tolist():
                W = steps.after_letter(later, nowhere, q, t + 1)
                steps.measure(W, values[q], steps.images_of(choice.laws[laws[t, q]], t))
    proved = 1.0 if is_coarse else steps.failure(bounds, given_up)
    return np.stack(choice.laws), laws, proved, steps.failure(values, nowhere)


def within(outer: FloatArray, inner: FloatArray) -> FloatArray:
    """Return what two windows (2, d) have in common."""
    return np.stack([np.maximum(outer[0], inner[0]), np.minimum(outer[1], inner[1])])


def hull(windows: FloatArray, others: FloatArray) -> FloatArray:
    """Return the least windows (T + 1, 2, d) around both."""
    return np.stack([np.minimum(windows[:, 0], others[:, 0]), np.maximum(windows[:, 1], others[:, 1])], axis=1)


def _alive(problem: CheckedProblem, edges: tuple[FloatArray, ...]) -> FloatArray:
    """Return the least box (2, d) with all cells whose letters do not lose the task at once."""
    steps, dead = Backups(problem, edges, (True,) * len(edges)), problem.automaton.dead()
    values, nothing = steps.at_end()
    values[:] = np.reshape(~np.array(dead), (-1, *(1,) * len(edges)))
    moves = any(np.any(end != end[0]) for own in problem.regions for end in (own.low, own.high))
    times, states = range(problem.horizon + 1 if moves else 1), np.flatnonzero(~np.array(dead)).tolist()
    each = [steps.after_letter(values, nothing, q, t) for q in states for t in times]
    held, box = np.max(each, axis=0) > 0.0, problem.agents[0].state_box.copy()
    for k, axis in enumerate(edges):
        some = np.flatnonzero(np.any(held, axis=tuple(j for j in range(len(edges)) if j != k)))
        if len(some):
            box[:, k] = axis[some[0] // 2], axis[some[-1] // 2 + 1]
    return box
