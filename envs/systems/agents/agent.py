"""One continuous linear stochastic agent.

Model (docs/theory/setting.md, "Agents"), with noise w independent over time and agents, `w ~ N(0, Sigma)` as a rule:

    x' = A x + B u + c + w,        y = C x,        x in the workspace,        u in the input box.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ..arguments import counted, float_array, matrix_text, read_only, shown, tree_text, vector_text
from ..distributions import Law
from ..expressions import Tree, affine
from .any_agent import AnyAgent, checked_added, is_passive, shared_fields, summary_rows
from .declaration import declared
from .declared_names import checked_names
from .products import linear

_ARRAYS = (
    "A",
    "B",
    "noise_covariance",
    "state_low",
    "state_high",
    "input_low",
    "input_high",
    "initial_low",
    "initial_high",
    "output_matrix",
    "offset",
)
"""Fields that hold arrays, in the order of problem files."""

_OTHERS = ("name", "laws", "noise_axes", "added_outputs", "states", "inputs")
"""Other fields."""


@dataclass(frozen=True, eq=False, init=False, repr=False)
class LinearAgent(AnyAgent):
    """A linear agent with noise, a workspace and an input box.

    Parameters
    ----------
    name : str
        Letters, digits and underscores, not starting with a digit.
    A : array_like, shape (d, d)
        State matrix.
    B : array_like, shape (d, m)
        Input matrix.
    noise : number, array_like, laws or mapping
        Noise, independent over time. A number, or one for each state: **standard deviations** of Gaussian noise. A
        matrix (d, d): its **covariance**, exactly symmetric and positive semidefinite. A law such as `{"law":
        "uniform", "low": -0.1, "high": 0.1}`, or one for each state. A mapping: `{"laws": ..., "axes": ...}`, where the
        columns of `axes`, shape (d, d), are the directions of the components with those laws.
    state_space : pair (low, high) of array_like, shape (d,)
        Workspace, a closed box; one number stands for all axes. An agent that leaves it violates every task.
    input_space : pair (low, high) of array_like, shape (m,)
        Input box, closed. An agent that nobody steers has neither `B` nor a box, and is given an input that is 0.
    start : array_like, shape (d,), or pair (low, high) of these, optional
        Start: a point, or a box from which it is drawn uniformly.
    output_matrix : array_like, shape (p, d), optional
        C; the identity by default.
    offset : array_like, shape (d,), optional
        Affine term c; zero by default.
    states, inputs : sequence of str, optional
        Names, by which shapes, joint noise and pictures speak of them; they have numbers alone by default.
    **keys
        Keys of problem files: `state_low` and `state_high`, `input_low` and `input_high` for the spaces;
        `initial_state`, or `initial_low` and `initial_high`, for the start; `noise_std`, `noise_covariance` and
        `noise_axes` for the noise. `added_outputs`: how many of the last outputs are there for shapes only;
        problems say it of the agents that they make.

    Raises
    ------
    ValueError
        If an argument is wrong. The message names it, what was expected and what came.

    Examples
    --------
    >>> agent = LinearAgent(
    ...     name="left", A=0.9, B=0.5, noise=0.5, state_space=(-20, 5), input_space=(-5, 5), start=-10
    ... )
    >>> agent.noise_factor
    array([[0.5]])
    """

    name: str
    A: np.ndarray
    B: np.ndarray
    noise_covariance: np.ndarray
    laws: tuple[Law, ...] | None
    noise_axes: np.ndarray
    state_low: np.ndarray
    state_high: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    initial_low: np.ndarray | None
    initial_high: np.ndarray | None
    output_matrix: np.ndarray
    offset: np.ndarray
    added_outputs: int
    states: tuple[str, ...]
    inputs: tuple[str, ...]

    needed_keys: ClassVar[tuple[str, ...]] = ("name", "A", "state_low", "state_high")
    """Keys that it must have in problem files."""

    other_keys: ClassVar[tuple[str, ...]] = (
        *("B", "noise_covariance", "input_low", "input_high", "initial_state", "initial_low", "initial_high"),
        *("output_matrix", "offset", "noise", "noise_std", "noise_axes", "added_outputs", "states", "inputs"),
    )
    """Keys that it may have there."""

    def __init__(
        self,
        *,
        name: str = "agent",
        A: Any,
        B: Any = None,
        noise: Any = None,
        state_space: Any = None,
        input_space: Any = None,
        start: Any = None,
        output_matrix: Any = None,
        offset: Any = None,
        states: Any = None,
        inputs: Any = None,
        **keys: Any,
    ) -> None:
        named = {key: value for key, value in locals().items() if key not in ("self", "keys")}
        # A fixes the number of states d, B the number of inputs m; all other lengths follow.
        matrix = float_array(A, "A", (None, None), "[[0.9]]")
        d = matrix.shape[0]
        if matrix.shape != (d, d):
            raise ValueError(f"`A`: expected a square matrix, got shape {matrix.shape[0]} x {matrix.shape[1]}")
        given = declared("LinearAgent", d, named, keys, ("added_outputs",))
        if is_passive(B, given):
            B = np.zeros((d, 1))
            given |= {"input_low": [0.0], "input_high": [0.0]}
        matrix_of_inputs = float_array(B, "B", (d, None), f"{[[0.5]] * d}")
        m = matrix_of_inputs.shape[1]
        identity, zero = np.eye(d), np.zeros(d)
        values = {
            **shared_fields(d, m, given),
            "A": matrix,
            "B": matrix_of_inputs,
            "states": _names(states, "states", d),
            "inputs": _names(inputs, "inputs", m),
            "output_matrix": float_array(
                identity if output_matrix is None else output_matrix, "output_matrix", (None, d), f"{[[1.0] * d]}"
            ),
            "offset": float_array(zero if offset is None else offset, "offset", (d,), f"{[0.0] * d}"),
        }
        values["added_outputs"] = checked_added(given["added_outputs"], len(values["output_matrix"]))
        for key, value in values.items():
            object.__setattr__(self, key, value)  # the record is frozen

    # Copy and pickle the fields alone: what is cached can be computed again.
    def __getstate__(self) -> dict[str, Any]:
        return {key: getattr(self, key) for key in (*_OTHERS, *_ARRAYS)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for key, value in state.items():
            # a pickled array comes back writable
            object.__setattr__(self, key, read_only(value) if isinstance(value, np.ndarray) else value)

    def __repr__(self) -> str:
        sizes = (counted(self.n_states, "state"), counted(self.n_inputs, "input"), counted(self.n_outputs, "output"))
        return tree_text(f"LinearAgent {self.name!r}: {', '.join(sizes)}", summary_rows(self))

    @property
    def n_outputs(self) -> int:
        """Number of output components p."""
        return int(self.output_matrix.shape[0])

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states; empty where they have numbers alone."""
        return () if self.states == _names(None, "states", self.n_states) else self.states

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs; empty where they have numbers alone."""
        return () if self.inputs == _names(None, "inputs", self.n_inputs) else self.inputs

    @cached_property
    def timed_trees(self) -> tuple[Tree, ...]:
        """Dynamics as sums of products; they never name the time."""
        rows = zip(np.hstack([self.A, self.B]), self.offset, strict=True)
        return tuple(affine(row, (*self.states, *self.inputs), float(offset)) for row, offset in rows)

    @property
    def trees(self) -> tuple[Tree, ...]:
        """Dynamics as sums of products."""
        return self.timed_trees

    @cached_property
    def output_trees(self) -> tuple[Tree, ...]:
        """Outputs as sums of products."""
        return tuple(affine(row, self.states, 0.0) for row in self.output_matrix)

    is_affine = True
    has_straight_outputs = True
    disturbances = MappingProxyType({})

    @property
    def motion_key(self) -> tuple[bytes, ...]:
        """What determines how the agent moves, apart from noise, boxes and names of agents; it serves comparisons."""
        return (b"linear", self.A.tobytes(), self.B.tobytes(), self.offset.tobytes())

    stack_key = ()  # matrices of equal sizes are stacked, whatever their entries

    @cached_property
    def has_full_rank(self) -> bool:
        """Whether B has full row rank: every mean can be commanded."""
        return bool(np.linalg.matrix_rank(self.B) == self.n_states)

    @property
    def motion_text(self) -> str:
        """How it moves, in symbols."""
        states = f" with x = ({', '.join(self.state_names)})" if self.state_names else ""
        numbers = f"A = {matrix_text(self.A)}, B = {matrix_text(self.B)}, c = {vector_text(self.offset)}"
        return f"x' = A x + B u + c + w{states}, {numbers}"

    @property
    def output_key(self) -> tuple[bytes, ...]:
        """What determines its outputs."""
        added = (b"added", str(self.added_outputs).encode()) if self.added_outputs else ()
        return (b"linear", self.output_matrix.tobytes(), *added)

    def mean(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the means ``(d, *S)`` of the next states from states ``(d, *S)`` under inputs ``(m, *S)``."""
        offset = self.offset.reshape(-1, *[1] * (x.ndim - 1))
        return np.asarray(np.tensordot(self.A, x, 1) + np.tensordot(self.B, u, 1) + offset)

    def outputs(self, x: np.ndarray) -> np.ndarray:
        """Return the outputs ``(p, *S)`` at states ``(d, *S)``: the same bits for one state and for many."""
        c = self.output_matrix
        return x if self.has_identity_output else linear(c.reshape(c.shape + (1,) * (x.ndim - 1)), x)

    def output_range(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds around the outputs of closed state boxes (S, d), rounded outwards: two arrays (S, p)."""
        c = self.output_matrix
        # Interval arithmetic: every product takes its extremes at the ends of its interval.
        products = np.stack([c * low[:, None, :], c * high[:, None, :]])
        # Twice the a-priori bound on the rounding of a sum of d products, and the least normal number for underflow.
        slack = 2.0 * (self.n_states + 2) * np.finfo(float).eps * np.abs(products).max(axis=0).sum(axis=-1)
        slack += np.finfo(float).tiny
        return products.min(axis=0).sum(axis=-1) - slack, products.max(axis=0).sum(axis=-1) + slack

    def output_axis(self, k: int) -> tuple[int, float] | None:
        """Return state and factor of output k if it is a multiple of a single state, or None."""
        row = self.output_matrix[k]
        axes = np.flatnonzero(row)
        return (int(axes[0]), float(row[axes[0]])) if len(axes) == 1 else None

    def output_row(self, k: int) -> np.ndarray:
        """Return the row (d,) of output k."""
        return np.asarray(self.output_matrix[k])

    def to_dict(self) -> dict[str, Any]:
        """Return the agent as plain lists and numbers, keyed as in problem files (exact)."""
        data: dict[str, Any] = {"name": self.name}
        for key in _ARRAYS:
            value = getattr(self, key)
            if key == "noise_covariance":
                data |= self.noise_data()
            elif value is not None:
                data[key] = value.tolist()
        if self.added_outputs:
            data["added_outputs"] = self.added_outputs
        for key, names in (("states", self.state_names), ("inputs", self.input_names)):
            data |= {key: list(names)} if names else {}
        return data


def _names(given: Any, argument: str, count: int) -> tuple[str, ...]:
    """Return names of states or inputs: those that are given, or numbers in words, which no expression can name."""
    if given is None:
        return tuple(f"{argument[:-1]} {k}" for k in range(count))
    names = checked_names(given, argument)
    if len({*names}) != count or len(names) != count:
        raise ValueError(f"`{argument}`: expected {counted(count, 'different name')}, got {shown(list(names))}")
    return names


def with_matrices(agent: AnyAgent) -> LinearAgent:
    """Return an agent that is known to be linear (TypeError if it is not)."""
    if not isinstance(agent, LinearAgent):
        raise TypeError(f"agent `{agent.name}`: expected matrices, got expressions")
    return agent
