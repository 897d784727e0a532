"""One continuous linear stochastic agent.

Model (docs/theory/setting.md, "Agents"), with `w ~ N(0, Sigma)` independent over time and agents:

    x' = A x + B u + c + w,        y = C x,        x in the workspace,        u in the input box.
"""

from __future__ import annotations

import copy
import re
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from .box import Box
from .checks import float_array, read_only, shown
from .printing import box_text, counted, shortened, tree_text

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
"""Names of agents and propositions: what can stand in a formula."""

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


@dataclass(frozen=True, eq=False, init=False, repr=False)
class LinearAgent:
    """A linear agent with Gaussian noise, a workspace and an input box.

    Parameters
    ----------
    name : str
        Letters, digits and underscores, not starting with a digit.
    A : array_like, shape (d, d)
        State matrix.
    B : array_like, shape (d, m)
        Input matrix.
    noise_covariance : array_like, shape (d, d)
        **Covariance** (not standard deviation) of the noise: exactly symmetric, positive semidefinite.
    state_low, state_high : array_like, shape (d,)
        Workspace, a closed box. An agent that leaves it violates every task.
    input_low, input_high : array_like, shape (m,)
        Input box, closed.
    initial_state : array_like, shape (d,), optional
        Start. Alternatively give a box `initial_low`, `initial_high`, from which the start is drawn uniformly.
    output_matrix : array_like, shape (p, d), optional
        C; the identity by default.
    offset : array_like, shape (d,), optional
        Affine term c; zero by default.

    Raises
    ------
    ValueError
        If an argument is wrong. The message names it, what was expected and what came.

    Examples
    --------
    >>> agent = LinearAgent(
    ...     name="left", A=[[0.9]], B=[[0.5]], noise_covariance=[[0.25]],
    ...     state_low=[-20], state_high=[5], input_low=[-5], input_high=[5], initial_state=[-10],
    ... )
    >>> agent.noise_factor
    array([[0.5]])
    """

    name: str
    A: np.ndarray
    B: np.ndarray
    noise_covariance: np.ndarray
    state_low: np.ndarray
    state_high: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    initial_low: np.ndarray | None
    initial_high: np.ndarray | None
    output_matrix: np.ndarray
    offset: np.ndarray

    # Fourteen keywords: they are the keys of an agent in problem files, and records for some would only add names.
    def __init__(
        self,
        *,
        name: str,
        A: Any,
        B: Any,
        noise_covariance: Any,
        state_low: Any,
        state_high: Any,
        input_low: Any,
        input_high: Any,
        initial_state: Any = None,
        initial_low: Any = None,
        initial_high: Any = None,
        output_matrix: Any = None,
        offset: Any = None,
    ) -> None:
        # A fixes the number of states d, B the number of inputs m; all other lengths follow.
        matrix = float_array(A, "A", (None, None), "[[0.9]]")
        d = matrix.shape[0]
        if matrix.shape != (d, d):
            raise ValueError(f"`A`: expected a square matrix, got shape {matrix.shape[0]} x {matrix.shape[1]}")
        inputs = float_array(B, "B", (d, None), f"{[[0.5]] * d}")
        workspace = Box(state_low, state_high, names=("state_low", "state_high"), length=d)
        input_box = Box(
            input_low, input_high, allow_flat=True, names=("input_low", "input_high"), length=inputs.shape[1]
        )
        identity, zero = np.eye(d), np.zeros(d)
        start = _start(initial_state, initial_low, initial_high, d)
        values = {
            "name": checked_name(name, "name"),
            "A": matrix,
            "B": inputs,
            "noise_covariance": _covariance(noise_covariance, d),
            "state_low": workspace.low,
            "state_high": workspace.high,
            "input_low": input_box.low,
            "input_high": input_box.high,
            "initial_low": None if start is None else start.low,
            "initial_high": None if start is None else start.high,
            "output_matrix": float_array(
                identity if output_matrix is None else output_matrix, "output_matrix", (None, d), f"{[[1.0] * d]}"
            ),
            "offset": float_array(zero if offset is None else offset, "offset", (d,), f"{[0.0] * d}"),
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)  # the record is frozen

    # Copy and pickle the fields alone: what is cached can be computed again.
    def __getstate__(self) -> dict[str, Any]:
        return {"name": self.name, **{key: getattr(self, key) for key in _ARRAYS}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for key, value in state.items():
            # a pickled array comes back writable
            object.__setattr__(self, key, read_only(value) if isinstance(value, np.ndarray) else value)

    def __repr__(self) -> str:
        sizes = (counted(self.n_states, "state"), counted(self.n_inputs, "input"), counted(self.n_outputs, "output"))
        deviations = [f"{x:g}" for x in np.sqrt(np.maximum(np.diag(self.noise_covariance), 0.0))]
        each = deviations[:1] if len(set(deviations)) == 1 else deviations
        rows = [
            ("workspace", box_text(self.state_low, self.state_high)),
            ("inputs", box_text(self.input_low, self.input_high)),
            ("start", "none" if self.initial_low is None else _start_text(self.initial)),
            ("noise", f"standard deviation {shortened(', '.join(each))}"),
        ]
        return tree_text(f"LinearAgent {self.name!r}: {', '.join(sizes)}", rows)

    @property
    def n_states(self) -> int:
        """Number of state components d."""
        return int(self.A.shape[0])

    @property
    def n_inputs(self) -> int:
        """Number of input components m."""
        return int(self.B.shape[1])

    @property
    def n_outputs(self) -> int:
        """Number of output components p."""
        return int(self.output_matrix.shape[0])

    @cached_property
    def workspace(self) -> Box:
        """Closed box of admissible states."""
        return Box(self.state_low, self.state_high)

    @cached_property
    def input_box(self) -> Box:
        """Closed box of admissible inputs."""
        return Box(self.input_low, self.input_high, allow_flat=True)

    @cached_property
    def initial(self) -> Box:
        """Start: a point, or a box from which it is drawn uniformly; ValueError if the agent has none."""
        if self.initial_low is None:
            raise ValueError(f"`initial_state`: expected a start for agent {self.name!r}, got none")
        return Box(self.initial_low, self.initial_high, allow_flat=True)

    @cached_property
    def has_identity_output(self) -> bool:
        """Whether y = x exactly."""
        return self.n_outputs == self.n_states and bool((self.output_matrix == np.eye(self.n_states)).all())

    @cached_property
    def noise_factor(self) -> np.ndarray:
        """L, shape (d, d), with `L L' = Sigma` up to rounding; exact square roots where Sigma is diagonal."""
        # Diagonal covariances are the common case, and square roots are exact where Cholesky would round.
        covariance = self.noise_covariance
        if (covariance == np.diag(np.diag(covariance))).all():
            # the check of covariances lets variances through that rounding has pushed a little below zero
            return read_only(np.diag(np.sqrt(np.maximum(np.diag(covariance), 0.0))))
        try:
            factor = np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:  # a singular covariance has no Cholesky factor, but it has eigenvectors
            spectrum, vectors = np.linalg.eigh(covariance)
            factor = vectors * np.sqrt(np.maximum(spectrum, 0.0))
        return read_only(factor)

    def to_dict(self) -> dict[str, Any]:
        """Return the agent as plain lists and numbers, keyed as in problem files (exact)."""
        data: dict[str, Any] = {"name": self.name}
        for key in _ARRAYS:
            value = getattr(self, key)
            if value is not None:
                data[key] = value.tolist()
        return data

    def replace(self, **changes: Any) -> LinearAgent:
        """Return a copy with some constructor arguments changed; a new start replaces the whole old one."""
        # A new start may be a point or a box: drop both old corners, not just the one that is named.
        data = self.to_dict()
        if any(key.startswith("initial_") for key in changes):
            data.pop("initial_low", None)
            data.pop("initial_high", None)
        return LinearAgent(**{**data, **changes})

    def copies(self, n: int) -> tuple[LinearAgent, ...]:
        """Return `n` agents that differ in their names alone: `name_0`, `name_1`, ..."""
        # A shallow copy shares the checked arrays, so that a thousand agents cost the memory of one.
        clones = tuple(copy.copy(self) for _ in range(n))
        for index, clone in enumerate(clones):
            object.__setattr__(clone, "name", f"{self.name}_{index}")
        return clones


def checked_name(name: Any, argument: str) -> str:
    """Return `name` if it can name an agent or a proposition; raise ValueError otherwise."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise ValueError(
            f"`{argument}`: expected letters, digits and underscores, not starting with a digit, got {shown(name)}"
        )
    return name


def _covariance(value: Any, d: int) -> np.ndarray:
    """Return a covariance if it is symmetric and positive semidefinite; raise ValueError otherwise."""
    covariance = float_array(value, "noise_covariance", (d, d), f"{np.eye(d).tolist()}")
    if (covariance != covariance.T).any():
        raise ValueError(
            f"`noise_covariance`: expected a symmetric matrix, got {shown(covariance.tolist())}; use (S + S.T) / 2"
        )
    spectrum = np.linalg.eigvalsh(covariance)
    # Rounding may push the zero eigenvalues of a singular covariance a little below zero.
    if spectrum[0] < -4.0 * d * np.finfo(float).eps * max(spectrum[-1], 0.0):
        raise ValueError(
            f"`noise_covariance`: expected a positive semidefinite matrix, got the eigenvalue {spectrum[0]:g}"
        )
    return covariance


def _start(state: Any, low: Any, high: Any, d: int) -> Box | None:
    """Return the box of the start, from a point or from two corners; None if there is no start."""
    if state is not None:
        if low is not None or high is not None:
            raise ValueError("`initial_state`: expected a point or a box `initial_low`, `initial_high`, got both")
        return Box.point(state, "initial_state", length=d)
    if (low is None) != (high is None):
        missing = "initial_low" if low is None else "initial_high"
        raise ValueError(f"`{missing}`: expected both corners of the start box, got one; give `{missing}` as well")
    if low is None:
        return None
    return Box(low, high, allow_flat=True, names=("initial_low", "initial_high"), length=d)


def _start_text(start: Box) -> str:
    if start.is_point:
        return shortened(f"({', '.join(f'{x:g}' for x in start.low)})")
    return f"uniform in {box_text(start.low, start.high)}"
