"""Boxes around means and outputs of agents with expressions, for the check: from the spans of ``step_intervals`` alone.

The search's enclosures are not used. Names become spans on a cell, the trees of the agent are read on them, and the
components of the mean follow.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ....envs.systems.agents import AnyAgent
from ....envs.systems.expressions import Tree
from ...certificates.cell_probabilities import state
from ...relations.grids import FloatArray
from .step_intervals import Span, bounds, span


@dataclass(frozen=True, eq=False)
class Enclosed:
    """What was enclosed, for whoever proves it: expressions of states on cells, under an input (n, m) for each.

    Parameters
    ----------
    trees : sequence of Tree, or None for the means of matrices
    agent : AnyAgent
        Whose states, inputs and unknowns the names are.
    inputs : (n, m) array
    less : pair of (n, d) and (n, d, d) arrays, optional
        z and G: what is enclosed is what is left after ``z + G (x - c)``, c being the middle of the cell.
    constants : mapping
        Further names, and a number (n,) for each cell.
    """

    trees: Sequence[Tree] | None
    agent: AnyAgent
    inputs: FloatArray
    less: tuple[FloatArray, FloatArray] | None = None
    constants: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def told_apart_by(self) -> tuple[object, ...]:
        """All that it says: equal agents are proved once."""
        trees = None if self.trees is None else repr(self.trees)
        names, rows = tuple(self.constants), tuple(self.constants.values())
        ranges = None if self.trees is None else repr(getattr(self.agent, "unknowns", None))
        model = tuple(map(repr, self.agent.model_key))
        return model, ranges, trees, self.inputs, self.less, names, rows


def enclosed_means(
    agent: AnyAgent,
    low: FloatArray,
    high: FloatArray,
    inputs: FloatArray,
    parts: int,
    beside: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Corners (n, d) of boxes that hold the means from closed cells under every disturbance.

    Parameters
    ----------
    agent : AnyAgent
    low, high : (n, d) arrays
        Corners of cells.
    inputs : (n, m) array
        Input in each cell.
    parts : int
        Parts into which cells are cut along each axis.
    beside : (l, n) array, optional
        States of others that the dynamics name, in the rows of inputs of others no numbers: these are anywhere in their
        boxes. By default all of them are anywhere.
    """
    shape = low.shape
    first, last = np.full(shape, np.inf), np.full(shape, -np.inf)
    cuts = [low + (high - low) * (k / parts) for k in range(parts)] + [high]
    calm = [(np.full(len(low), a), np.full(len(low), b)) for a, b in agent.unknowns.values()]
    if beside is not None:
        for k, (row, is_input) in enumerate(zip(beside, agent.neighbour_inputs, strict=True), len(agent.disturbances)):
            calm[k] = calm[k] if is_input else (row, row)
    with np.errstate(all="ignore"):
        for part in itertools.product(range(parts), repeat=shape[1]):
            box = [(cuts[k][:, axis], cuts[k + 1][:, axis]) for axis, k in enumerate(part)] + calm
            outputs = partial(spans_of_means, agent, inputs)
            ends = np.stack(bounds(outputs, np.array(box)), axis=-1)
            first, last = np.minimum(first, ends[0]), np.maximum(last, ends[1])
    state("spans", Enclosed(agent.trees, agent, inputs), (low, high), calm, (first, last))
    return first, last


def enclosed_scales(
    agent: AnyAgent, low: FloatArray, high: FloatArray, inputs: FloatArray, parts: int
) -> tuple[FloatArray, FloatArray]:
    """Ends (n, d) of what the noise is multiplied with on closed cells (n, d) of states, under inputs (n, m)."""
    first, last = np.full(low.shape, np.inf), np.full(low.shape, -np.inf)
    cuts = [low + (high - low) * (k / parts) for k in range(parts)] + [high]
    unknown = [(np.full(len(low), a), np.full(len(low), b)) for a, b in agent.unknowns.values()]

    def outputs(on: FloatArray, with_slopes: bool = False) -> list[Span]:
        leaves = leaves_of(agent, on, inputs, with_slopes)
        return [span(tree, leaves) for tree in agent.scale_trees]

    with np.errstate(all="ignore"):
        for part in itertools.product(range(parts), repeat=low.shape[1]):
            box = [(cuts[k][:, axis], cuts[k + 1][:, axis]) for axis, k in enumerate(part)]
            ends = np.stack(bounds(outputs, np.array(box + unknown)), axis=-1)
            first, last = np.minimum(first, ends[0]), np.maximum(last, ends[1])
    spans = Enclosed(agent.scale_trees, agent, inputs)
    state("spans", spans, (low, high), unknown, (first, last))
    return first, last


def output_spans(agent: AnyAgent, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Corners (n, p) of boxes around outputs from closed boxes (n, d) of states; infinite where nothing is known."""
    box, no_inputs = np.stack([low.T, high.T], axis=1), np.zeros((len(low), 0))

    def outputs(on: FloatArray, with_slopes: bool = False) -> list[Span]:
        leaves = leaves_of(agent, on, no_inputs, with_slopes)
        return [span(tree, leaves) for tree in agent.output_trees]

    with np.errstate(all="ignore"):
        ends = np.stack(bounds(outputs, box), axis=-1)
    state("spans", Enclosed(agent.output_trees, agent, no_inputs), (low, high), [], tuple(ends))
    return np.where(np.isnan(ends[0]), -np.inf, ends[0]), np.where(np.isnan(ends[1]), np.inf, ends[1])


def leaves_of(agent: AnyAgent, box: FloatArray, inputs: FloatArray, with_slopes: bool) -> dict[str, Span]:
    """Spans of all names on boxes (v, 2, n) of variables: the axes of the cell, then disturbances and neighbours."""
    v, n = len(box), box.shape[2]
    unit = np.zeros((v, 2, v if with_slopes else 0, n))
    for k in range(v if with_slopes else 0):
        unit[k, :, k] = 1.0
    variables = [Span(ends, slopes) for ends, slopes in zip(box, unit, strict=True)]
    leaves = dict(zip(agent.states, variables, strict=False))
    for name, column in zip(agent.inputs, inputs.T, strict=False):  # outputs read no inputs
        leaves[name] = Span.of(column, column, variables[0])
    return leaves | dict(zip(agent.unknowns, variables[agent.n_states :], strict=False))


def spans_of_means(
    agent: AnyAgent,
    inputs: FloatArray,
    on: FloatArray,
    with_slopes: bool = False,
) -> list[Span]:
    """Spans of the components of the mean on boxes (v, 2, n) of variables."""
    leaves = leaves_of(agent, on, inputs, with_slopes)
    return [span(tree, leaves) for tree in agent.trees]
