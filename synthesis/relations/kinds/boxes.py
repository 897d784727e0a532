"""The relation of mean boxes: from all points of a cell the mean of the next state lies in a known box.

The controller reads the cell of the true state, the automaton state and the time, and has no memory. From state x of
cell s with centre c, choice a applies the input

    u = u_a + K_a (x - c),

which is admissible on the whole closed cell. All that the finite model knows of the mean is that it lies in the box
``M(s, a)``; the kernel takes the least value over it (docs/theory/boxes.md). So nothing depends on how the boxes were
made, and an agent needs no more than boxes for all points of a cell, and inputs. Here they are made for
linear agents, in ``symbolic_means`` for those whose dynamics are expressions, in ``network_bounds`` for linear agents
that a network moves; kernel, search and tree are the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import Agent, AnyAgent, LinearAgent
from ....envs.systems.arguments import counted
from ..grids import FloatArray, RelationRefused, linear_agent, sharpness
from .cell_relation import ReadsCells, Unsteered
from .exact import INPUT_MARGIN
from .rounding import missed_cells, sizes_of
from .symbolic_means import SymbolicMeans

ROUNDED_TWICE = 2.0
"""Factor on the rounding of a mean: it is computed here, and by the agent itself."""

WRAPPED_OFF = 2e-13
"""What an angle that wraps is off by in floating point, at most."""

AS_FAR_AS = 1e-3
"""Square of the share of the input box by which inputs may differ before feedback, or none, counts for less."""


@dataclass(frozen=True, eq=False)
class MeanBoxes:
    """Boxes around the means of the next state, for n cells and A choices (outer bounds).

    Parameters
    ----------
    low, high : (n, A, d) arrays
        Corners: the mean from every point of the closed cell lies between them.
    admissible : (n, A) bool array
        Whether the input of the choice is admissible at every point of the closed cell.
    scales : pair of (n, A, d) arrays, or None
        Ends of what the noise of each state is multiplied with, positive where a choice is admissible; None where the
        noise is the same everywhere.
    """

    low: FloatArray
    high: FloatArray
    admissible: NDArray[np.bool_]
    scales: tuple[FloatArray, FloatArray] | None = None


@dataclass(frozen=True, eq=False)
class LinearMeans(Unsteered):
    """Boxes around the means of a linear agent.

    Parameters
    ----------
    A, B : (d, d), (d, m) arrays
        Dynamics.
    offset : (d,) array
        Mean from the origin under the input 0.
    rounding : (d,) array
        Upper bounds on what means are off by in floating point, the controller's input included.
    """

    A: FloatArray
    B: FloatArray
    offset: FloatArray
    rounding: FloatArray

    def around(
        self, low: FloatArray, high: FloatArray, input_set: FloatArray, gains: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the corners (n, A, d) of boxes around the means from the closed cells ``[low, high]``, (n, d) each.

        With ``x = c + e``, ``|e| <= h``, the mean is ``A c + B u_a + offset + (A + B K_a) e``: it is off its centre by
        ``|A + B K_a| h`` at most, and by what is rounded.
        """
        centre = 0.5 * (low + high)
        half = np.maximum(high - centre, centre - low) * (1.0 + INPUT_MARGIN)
        closed = np.abs(self.A + self.B @ gains)  # (A, d, d)
        middle = (centre @ self.A.T + self.offset)[:, None] + (input_set @ self.B.T)[None]
        extent = np.einsum("aij,nj->nai", closed, half) + self.rounding
        return middle - extent, middle + extent

    @property
    def description(self) -> dict[str, Any]:
        """What files hold of it."""
        return {}

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that boxes depend on, for comparing relations."""
        return (self.A, self.B, self.offset)


@dataclass(frozen=True, eq=False, repr=False)
class BoxRelation(ReadsCells):
    """Mean boxes of an agent (delta = 0, no memory).

    Parameters
    ----------
    means : LinearMeans or SymbolicMeans
        What makes the boxes.
    menu : (A, m) array
        Inputs u_a at the centres of cells.
    gains : (A, m, d) array
        Feedback K_a of each choice inside its cell.
    input_low, input_high : (m,) arrays
        Input box.
    """

    means: LinearMeans | SymbolicMeans
    input_set: FloatArray
    gains: FloatArray
    input_low: FloatArray
    input_high: FloatArray

    kind = "boxes"
    delta = 0.0

    def __repr__(self) -> str:
        d, m = self.gains.shape[2], len(self.input_low)
        choices = counted(len(self.input_set), "choice")
        return f"BoxRelation({counted(d, 'state')}, {counted(m, 'input')}, {choices}, delta 0)"

    def describe(self) -> dict[str, Any]:
        """Return the description that files hold."""
        return {
            "kind": "boxes",
            "menu": self.input_set.tolist(),
            "gains": self.gains.tolist(),
            **self.means.description,
        }

    @property
    def n_choices(self) -> int:
        """Number of choices A."""
        return len(self.input_set)

    def mean_boxes(self, low: FloatArray, high: FloatArray) -> MeanBoxes:
        """Return boxes around the means from the closed cells ``[low, high]``, (n, d) each (outer bounds).

        A choice is not admissible, either, where nothing is known of its mean.
        """
        first, last = self.means.around(low, high, self.input_set, self.gains)
        # Inputs: u_a is a number of the menu; what feedback adds to it is rounded.
        centre = 0.5 * (low + high)
        half = np.maximum(high - centre, centre - low) * (1.0 + INPUT_MARGIN)
        need = np.einsum("aij,nj->nai", np.abs(self.gains), half)
        moves = np.any(self.gains, axis=2)
        scale = np.maximum(np.abs(self.input_low), np.abs(self.input_high))
        need = need + moves * (INPUT_MARGIN * (scale + need))
        inside = (self.input_low <= self.input_set - need) & (self.input_set + need <= self.input_high)
        known = np.all(np.isfinite(first) & np.isfinite(last), axis=2)
        scales = self.scales(low, high)
        if scales is not None:
            known &= np.all((scales[0] > 0.0) & np.isfinite(scales[1]), axis=2)
        return MeanBoxes(first, last, np.all(inside, axis=2) & known, scales)

    def scales(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return ends (n, A, d) of what noise is multiplied with in the closed cells ``[low, high]``, (n, d) each.

        They are not numbers where nothing is known; None where the noise is the same everywhere.
        """
        return self.means.scales(low, high, self.input_set)

    def inputs(self, choices: NDArray[np.intp], offsets: FloatArray) -> FloatArray:
        """Return the inputs ``u_a + K_a e`` (m, ...) of choices (...) at states e (d, ...) from centres of cells.

        Summed in a fixed order, so that the bits are the same for any number of worlds.
        """
        inputs = np.empty((len(self.input_low), *choices.shape))
        for j, component in enumerate(inputs):
            self._columns[j].take(choices, out=component, mode="clip")
            for k, offset in enumerate(offsets):
                if self._moves[j, k]:
                    component += self._gain_columns[j, k].take(choices, mode="clip") * offset
        return inputs

    def nearest_choices(self, other: BoxRelation) -> NDArray[np.intp]:
        """Return the choice of this relation that does most nearly what each choice (A',) of another one does.

        Inputs count first, as shares of their box, then whether there is feedback.
        """
        if np.array_equal(self.input_set, other.input_set) and np.array_equal(self.gains, other.gains):
            return np.arange(len(other.input_set))
        width = np.where(self.input_high > self.input_low, self.input_high - self.input_low, 1.0)
        apart = np.sum(((other.input_set[:, None] - self.input_set) / width) ** 2, axis=2)
        feeds = [np.any(relation.gains, axis=(1, 2)) for relation in (other, self)]
        return np.argmin(apart + AS_FAR_AS * (feeds[0][:, None] != feeds[1]), axis=1)

    @cached_property
    def _columns(self) -> FloatArray:
        """Inputs (m, A) of the choices, each component on its own."""
        return np.ascontiguousarray(self.input_set.T)

    @cached_property
    def _gain_columns(self) -> FloatArray:
        """Gains (m, d, A) of the choices."""
        return np.ascontiguousarray(np.moveaxis(self.gains, 0, 2))

    @cached_property
    def _moves(self) -> NDArray[np.bool_]:
        """Whether any choice feeds state k back to input j, (m, d)."""
        return np.asarray(np.any(self.gains, axis=0))

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All matrices, for comparing relations."""
        return (
            *self.means.arrays,
            self.input_set,
            self.gains,
            self.input_low,
            self.input_high,
        )

    def rounding_loss(self, agent: AnyAgent, edges: Sequence[FloatArray]) -> float:
        """Return an upper bound on what carrying the relation out in floating point costs per step, a probability.

        What means are off by is in the boxes; angles are rounded once more where they wrap.
        """
        return missed_cells(sharpness(agent), np.where(agent.wrapped_axes, WRAPPED_OFF, 0.0), edges)


def box_relation(
    agent: AnyAgent,
    input_set: FloatArray,
    gains: FloatArray | None = None,
    written: Mapping[str, Any] | None = None,
) -> BoxRelation:
    """Return the relation of mean boxes of an agent.

    Parameters
    ----------
    agent : AnyAgent
    menu : (A, m) array
        Inputs to choose from, at the centres of cells.
    gains : (A, m, d) array, optional
        Feedback of each choice inside its cell; none by default.
    written : mapping, optional
        Further settings of ``SymbolicMeans``: ``parts`` and which choices ``steer``.

    Raises
    ------
    ValueError
        If an input is outside its box, or there is not one gain for each input.
    """
    box, d, m = agent.input_box, agent.n_states, agent.n_inputs
    gains = np.zeros((len(input_set), m, d)) if gains is None else gains
    if gains.shape != (len(input_set), m, d):
        raise RelationRefused(f"agent `{agent.name}`: mean boxes need one feedback for each input of their menu")
    if not len(input_set) or not np.all((box.low <= input_set) & (input_set <= box.high)):
        raise RelationRefused(f"agent `{agent.name}`: mean boxes need inputs inside their box")
    means: LinearMeans | SymbolicMeans
    if isinstance(agent, Agent):
        if np.any(gains):
            raise RelationRefused(f"agent `{agent.name}`: mean boxes of expressions have no feedback inside a cell")
        written = {"parts": 1, **(written or {})}
        steer = written.get("steer")
        steer = np.zeros(len(input_set), dtype=bool) if steer is None else np.array(steer, dtype=bool)
        means = SymbolicMeans(agent, int(written["parts"]), steer)
        if steer.shape != (len(input_set),) or (np.any(steer) and not means.commands):
            raise RelationRefused(f"agent `{agent.name}`: its choices cannot steer, as no input commands an axis")
    else:
        means = linear_means(linear_agent(agent, "boxes"), gains)
    return BoxRelation(means, input_set, gains, box.low, box.high)


def linear_means(agent: LinearAgent, gains: FloatArray) -> LinearMeans:
    """Return what boxes of a linear agent are made of, with the feedbacks (A, m, d) of its choices."""
    sizes = sizes_of(agent)
    # Of the input: the centre of a cell, the difference to it, and a product for each state.
    largest = np.abs(gains).max(axis=0)
    input_off = largest @ (2.0 * sizes.unit * sizes.states) + sizes.unit * np.any(largest, axis=1) * (
        sizes.inputs + largest @ sizes.states
    )
    # Of the mean: the products here and those of the agent.
    mean_off = 2.0 * ROUNDED_TWICE * sizes.unit * sizes.means
    return LinearMeans(agent.A, agent.B, agent.offset, mean_off + np.abs(agent.B) @ input_off)
