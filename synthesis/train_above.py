"""An upper bound on what given policies attain, as tensor trains: the other side of ``train_value``.

The same recursion, but for what a lower bound counts as failed and the continuous system may survive: with A the
visited cells (outside which the trains of the lower bound are 0), and v_i the cells in which agent i has a choice,

    U_q,t+1 = (P_1^pi x .. x P_I^pi) (W_q 1[in A])  +  (prod_i P_i^pi 1[anywhere] - prod_i P_i^pi 1[in A])
              + (1 - prod_i v_i) ,          W_q = sum_q' 1[the letter leads q to q'] U_q',t .

So U is the probability of succeeding, of leaving A inside the workspaces, or of meeting a cell without a choice, before
failing; what it adds to a value are four columns per bond at most. It bounds the closed loop from above where nothing
is lost at region and workspace edges (``Abstraction.is_exact``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from .ascent import Laws
from .joint import JointModel
from .kernel import UNIT
from .occupancy import Occupancy
from .train import Cells, Core, Train
from .train_value import Rounding, Smooth, Trains, backward, routes, start_value


def evaluate_above(
    joint: JointModel, laws: Laws, rounding: Rounding, each: Callable[[int, Trains], None] | None = None
) -> Trains:
    """Function U of the module's text at time 0, rounded as the lower bound is; each read with its error added."""

    def beside(t: int, q: int) -> Train | None:
        points = [model.choices.points(law[t, q]) for model, law in zip(joint.models, laws, strict=True)]
        smooth = [model.kernel.smooth for model in joint.models]
        return counted_as_failed(points, smooth, joint.n_cells, rounding.visited[t], rounding.visited[t + 1])

    ways = routes(joint.guards, joint.masks, joint.n_states)
    choose = partial(_frozen, laws)
    return backward(joint, ways, choose, rounding.tolerance, each, rounding.visited, beside)


def _frozen(laws: Laws, t: int, q: int, _: Train) -> list[NDArray[np.int32]]:
    return [law[t, q] for law in laws]


def counted_as_failed(
    points: Sequence[NDArray[np.integer]], smooth: Sequence[Smooth], n_cells: Sequence[int], here: Cells, there: Cells
) -> Train | None:
    """Probability, per joint cell, of what a lower bound counts as failed in one step; None if there is none.

    Parameters
    ----------
    points : sequence of (S_i,) int arrays
        Lattice points that the choices lead to; -1 where there is none.
    smooth : sequence of callables
        Expected values of rows (n, S_i) at every lattice point.
    n_cells : sequence of int
    here, there : Cells
        Visited cells now, which the result covers, and one step later.
    """
    own = list(points) if here is None else [p[cells] for p, cells in zip(points, here, strict=True)]
    columns: list[list[NDArray[np.float64]]] = []
    if any(np.any(p < 0) for p in own):
        valid = [(p >= 0).astype(float) for p in own]
        columns += [[np.ones(len(p)) for p in own], [-valid[0], *valid[1:]]]
    if there is not None and any(len(cells) < n for cells, n in zip(there, n_cells, strict=True)):
        rates = []
        for p, push, n, cells in zip(own, smooth, n_cells, there, strict=True):
            rows = np.ones((2, n))
            rows[1] = 0.0
            rows[1, cells] = 1.0
            rates.append(np.where(p >= 0, push(rows)[:, np.maximum(p, 0)], 0.0))
        columns += [[anywhere for anywhere, _ in rates], [-rates[0][1], *(visited for _, visited in rates[1:])]]
    if not columns:
        return None
    operations = 4 * len(columns) * (len(own) + 2 * sum(n_cells))
    cores = tuple(_diagonal([column[i] for column in columns], i, len(own)) for i in range(len(own)))
    return Train(cores, operations * UNIT, here)


def _diagonal(rows: list[NDArray[np.float64]], i: int, n_agents: int) -> Core:
    """Core of agent i of a sum of products with factors ``rows``."""
    core = np.zeros((len(rows), len(rows[0]), len(rows)))
    core[np.arange(len(rows)), :, np.arange(len(rows))] = np.asarray(rows, dtype=float)
    core = core.sum(axis=0, keepdims=True) if i == 0 else core
    return core.sum(axis=2, keepdims=True) if i == n_agents - 1 else core


def start_above(start: Occupancy, value: Trains) -> float:
    """Upper bound on ``sum_q <mu_0,q , U_q>``, where U is 1 outside the cells that its trains cover."""
    inside = outside = 0.0
    for q, rows in enumerate(start.terms.index):
        train = value.states[q]
        for row in rows if train is not None else ():
            weights = [own[k] for own, k in zip(start.terms.factors, row, strict=True)]
            whole = float(np.prod([own.sum() for own in weights]))
            if train is not None and train.cells is not None:
                weights = [own[cells] for own, cells in zip(weights, train.cells, strict=True)]
            covered = float(np.prod([own.sum() for own in weights]))
            inside += covered
            outside += max(0.0, whole - covered) + 1e-14
    return float(start_value(start, value) + value.error * inside * (1 + 1e-12) + outside)
