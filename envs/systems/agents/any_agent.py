"""What all agents have: a name, boxes, a start and noise. `LinearAgent` and `Agent` say how they move."""

from __future__ import annotations

import copy
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from ..arguments import box_text, read_only, shortened, shown
from ..backends import is_host, namespace
from ..distributions import Law, declared_noise
from ..expressions import Tree, affine_form, computed, names_in
from .box import Box
from .declaration import SPACES, STARTS

NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
"""Names of agents and propositions: what can stand in a formula."""


NOISE_KEYS = {"noise", "noise_covariance", "noise_std", "noise_axes", "noise_scale"}
"""Arguments that declare noise."""


class AnyAgent(ABC):
    """An agent, however it moves: `x' = mean(x, u) + w` with noise w, outputs, boxes and a start.

    Attributes
    ----------
    name : str
    noise_covariance : np.ndarray, shape (d, d)
    laws : tuple of Law, or None
        Laws of the independent components e of the noise `w = noise_axes @ e`; None where it is Gaussian.
    noise_axes : np.ndarray, shape (d, d)
    noise_scale : tuple of str, or None
        What the noise of each state is multiplied with, as expressions; None where the noise is the same everywhere.
    state_low, state_high : np.ndarray, shape (d,)
        Workspace, a closed box.
    input_low, input_high : np.ndarray, shape (m,)
        Input box, closed.
    initial_low, initial_high : np.ndarray, shape (d,), or None
        Box of the start, which is drawn uniformly from it.
    """

    name: str
    noise_covariance: np.ndarray
    laws: tuple[Law, ...] | None
    noise_axes: np.ndarray
    noise_scale: tuple[str, ...] | None = None
    state_low: np.ndarray
    state_high: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    initial_low: np.ndarray | None
    initial_high: np.ndarray | None

    @property
    def n_states(self) -> int:
        """Number of state components d."""
        return int(self.state_low.size)

    @property
    def n_inputs(self) -> int:
        """Number of input components m."""
        return int(self.input_low.size)

    @property
    @abstractmethod
    def n_outputs(self) -> int:
        """Number of output components p."""

    @cached_property
    def has_identity_output(self) -> bool:
        """Whether y = x exactly."""
        return self.n_outputs == self.n_states and self._begins_with_states

    needed_keys: ClassVar[tuple[str, ...]]
    other_keys: ClassVar[tuple[str, ...]]

    is_affine: ClassVar[bool]
    """Whether means are known to be affine in state and input, `A x + B u + c`: matrices say how it moves."""

    @property
    def is_linear_gaussian(self) -> bool:
        """Whether means are affine and the noise is Gaussian: states are then Gaussian under linear feedback."""
        return self.is_affine and self.laws is None

    @property
    def has_full_rank(self) -> bool:
        """Whether B is known to have full row rank: every mean can be commanded."""
        return False

    added_outputs: int = 0
    """How many of the last outputs are there for shapes alone; the others are those that the agent has without them."""

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states; empty where they have numbers alone, as those of linear agents."""
        return ()

    @property
    def output_names(self) -> tuple[str, ...]:
        """Outputs as they are written, those that were added for shapes left out; empty where matrices say them."""
        return ()

    angles: tuple[str, ...] = ()
    """Names of the states that are angles: points of a circle, which workspaces hold once."""

    @property
    def wrapped_axes(self) -> np.ndarray:
        """Which states (d,) are angles."""
        return np.zeros(self.n_states, dtype=bool)

    @property
    def angle_outputs(self) -> tuple[int, ...]:
        """Outputs that are angles; all others are the same a turn further on."""
        axes = [self.output_axis(k) for k in np.arange(self.n_outputs).tolist()] if self.angles else []
        return tuple(k for k, axis in enumerate(axes) if axis is not None and self.wrapped_axes[axis[0]])

    @property
    def state_outputs(self) -> int:
        """How many outputs, from the first on, are read as the states that they are: d if y = x but for added ones."""
        return self.n_states if self.n_outputs - self.added_outputs == self.n_states and self._begins_with_states else 0

    @cached_property
    def _begins_with_states(self) -> bool:
        """Whether the first d outputs, of at least as many, are the states."""
        return all(self.output_axis(k) == (k, 1.0) for k in range(self.n_states))

    @property
    @abstractmethod
    def motion_key(self) -> tuple[bytes, ...]:
        """What determines how the agent moves, apart from noise, boxes and names of agents: for comparisons."""

    @property
    def stack_key(self) -> tuple[object, ...]:
        """What agents of equal sizes have in common that move in one stack of arrays: all that is written."""
        return (self.motion_key, self.output_key)

    @property
    @abstractmethod
    def motion_text(self) -> str:
        """How it moves, in symbols."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    """Names in trees; those of linear agents have numbers."""

    @property
    @abstractmethod
    def trees(self) -> tuple[Tree, ...]:
        """Dynamics as expression trees of states, inputs and unknowns; ValueError where they name the time."""

    @property
    def scale_trees(self) -> tuple[Tree, ...]:
        """The same of what the noise of each state is multiplied with; empty for nothing."""
        return ()

    @property
    @abstractmethod
    def timed_trees(self) -> tuple[Tree, ...]:
        """Dynamics as expression trees of states, inputs, unknowns and the time."""

    @property
    @abstractmethod
    def output_trees(self) -> tuple[Tree, ...]:
        """Outputs as expression trees of states."""

    @property
    def timed_scale_trees(self) -> tuple[Tree, ...]:
        """What the noise of each state is multiplied with; empty for nothing."""
        return ()

    @property
    def others(self) -> tuple[str, ...]:
        """States and inputs of other agents that the dynamics name, such as `leader.position`."""
        return ()

    @property
    def has_straight_outputs(self) -> bool:
        """Whether every output is a multiple of a single state, or linear in all of them."""
        return all(self.output_axis(k) is not None for k in range(self.n_outputs))

    neighbour_inputs: tuple[bool, ...] = ()
    """Which of these are inputs."""

    communicated: tuple[str, ...] = ()
    """Agents whose states it is told."""

    disturbances: Mapping[str, tuple[float, float]]
    """Ends of what moves it besides, by name."""

    @property
    def unknowns(self) -> Mapping[str, tuple[float, float]]:
        """Intervals of everything that moves the mean besides state and input, by names in trees."""
        return self.disturbances

    def with_clock(self, horizon: int) -> AnyAgent:
        """Return the agent with the time as its last input; itself where it does not name the time."""
        return self

    def unrolled_by(self, turns: int) -> AnyAgent:
        """Return the agent with angles that go on for some turns; itself where it has none."""
        return self

    @property
    def names_time(self) -> bool:
        """Whether the dynamics, or the scale of the noise, name the time `t`."""
        return False

    has_clock: bool = False
    """Whether the last input is the time, which nobody may choose (see `problem.unrolled_in_time`)."""

    @property
    def chosen_box(self) -> Box:
        """Box of the inputs that are chosen: all but a clock."""
        if not self.has_clock:
            return self.input_box
        return Box(self.input_low[:-1], self.input_high[:-1], allow_flat=True)

    def at(self, time: int) -> Self:
        """Return the agent as it moves at one control step, 0 to T - 1; itself where no expression names the time."""
        return self

    @property
    def model_key(self) -> tuple[bytes, ...]:
        """What determines finite models of the agent apart from relation, cells and labels, as bytes."""
        arrays = (self.state_low, self.state_high, self.input_low, self.input_high)
        return (*self.motion_key, *self.noise_key, *(array.tobytes() for array in arrays))

    @property
    @abstractmethod
    def output_key(self) -> tuple[bytes, ...]:
        """What determines its outputs."""

    @abstractmethod
    def mean(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the means ``(d, *S)`` of the next states from states ``(d, *S)`` under inputs ``(m, *S)``."""

    @abstractmethod
    def outputs(self, x: np.ndarray) -> np.ndarray:
        """Return the outputs ``(p, *S)`` at states ``(d, *S)``: the same bits for one state and for many."""

    @abstractmethod
    def output_range(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds around the outputs of closed state boxes (S, d), rounded outwards: two arrays (S, p)."""

    @cached_property
    def output_ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Bounds (p,) around the outputs on the whole workspace, rounded outwards; a fleet asks once for each pair."""
        low, high = self.output_range(self.state_low[None], self.state_high[None])
        return read_only(low[0]), read_only(high[0])

    @abstractmethod
    def output_axis(self, k: int) -> tuple[int, float] | None:
        """Return state and factor of output k if it is a multiple of a single state, or None."""

    def output_row(self, k: int) -> np.ndarray:
        """Return the row (d,) of an output that is linear in the states."""
        found = self.output_axis(k)
        assert found is not None  # outputs that bend have no row
        return np.asarray(found[1] * np.eye(self.n_states)[found[0]])

    def straight_output(self, k: int) -> tuple[np.ndarray, float] | None:
        """Return row (d,) and offset of an output that is seen to be linear in the states (rounded); None of others."""
        form = affine_form(self.output_trees[k : k + 1], self.states)
        if form is None or any(map(names_in, (*form.factors[0], *form.rests))):
            return None
        *row, offset = (float(value[0]) for value in computed((*form.factors[0], *form.rests), {}))
        return np.array(row), offset

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return the agent as plain values, keyed as in problem files (exact)."""

    def replace(self, **changes: Any) -> Self:
        """Return a copy with some constructor arguments changed; a new start or noise replaces the whole old one."""
        # A new start may be a point or a box: drop both old corners, not just the one that is named.
        data = self.to_dict()
        if {"start", *STARTS} & {*changes}:
            data.pop("initial_low", None)
            data.pop("initial_high", None)
        for space in SPACES.keys() & {*changes}:
            data = {key: value for key, value in data.items() if key not in SPACES[space]}
        if self.laws is not None:
            data["noise"] = self.laws
        if NOISE_KEYS & {*changes}:
            data = {key: value for key, value in data.items() if key not in NOISE_KEYS}
        return type(self)(**{**data, **changes})

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
    def noise_factor(self) -> np.ndarray:
        """L, shape (d, d), with `w = L e`: the axes of laws, else `L L' = Sigma` up to rounding, e standard normal.

        Square roots are exact where Sigma is diagonal.
        """
        if self.laws is not None:
            return self.noise_axes
        # Diagonal covariances are the common case, and square roots are exact where Cholesky would round.
        covariance = self.noise_covariance
        if (covariance == np.diag(np.diag(covariance))).all():
            # the check of covariances lets variances through that rounding has pushed a little below zero
            return read_only(np.diag(np.sqrt(np.maximum(np.diag(covariance), 0.0))))
        try:
            factor = np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:  # a singular covariance has no Cholesky factor, but it has eigenvectors
            spectrum, vectors = np.linalg.eigh(covariance)
            # what rounding leaves of an eigenvalue 0 is no source of noise
            spectrum[spectrum < len(spectrum) * np.finfo(float).eps * spectrum.max()] = 0.0
            factor = vectors * np.sqrt(spectrum)
        return read_only(factor)

    @property
    def noise_key(self) -> tuple[bytes, ...]:
        """What determines the noise, for comparisons."""
        laws = b"" if self.laws is None else repr([law.to_dict() for law in self.laws]).encode()
        return (self.noise_covariance.tobytes(), self.noise_axes.tobytes(), laws)

    def noise_data(self) -> dict[str, Any]:
        """Return the keys of problem files that declare the noise."""
        if self.laws is None:
            return {"noise_covariance": self.noise_covariance.tolist()}
        data: dict[str, Any] = {"noise": [law.to_dict() for law in self.laws]}
        if self.noise_scale is not None:
            data["noise_scale"] = list(self.noise_scale)
        if (self.noise_axes != np.eye(self.n_states)).any():
            data["noise_axes"] = self.noise_axes.tolist()
        return data

    def with_noise_times(self, factor: float) -> Self:
        """Return a copy whose noise is multiplied by a factor of at least 0."""
        if self.laws is None or factor == 0.0:
            return self.replace(noise_covariance=factor * factor * self.noise_covariance)
        laws = [law.scaled(factor) for law in self.laws]
        if self.noise_scale is not None:
            return self.replace(noise=laws, noise_scale=self.noise_scale)
        return self.replace(noise=laws, noise_axes=self.noise_axes)

    @cached_property
    def still_axes(self) -> np.ndarray:
        """Which states (d,) have no noise at all: the law has the deviation 0, or the row of the covariance is 0."""
        if self.laws is None:
            return read_only(~np.any(self.noise_covariance, axis=1))
        # Laws with a deviation of 0 are those of states; the square of a tiny one may be 0 as well.
        return read_only(np.array([law.std == 0.0 for law in self.laws]))

    @property
    def has_independent_noise(self) -> bool:
        """Whether the noise of every state is independent of that of all others."""
        if self.laws is not None:
            return bool(np.array_equal(self.noise_axes, np.eye(self.n_states)))
        return not np.any(self.noise_covariance - np.diag(np.diag(self.noise_covariance)))

    @property
    def has_plain_noise(self) -> bool:
        """Whether every state has noise, and the noise is the same everywhere."""
        return self.noise_scale is None and not bool(np.any(self.still_axes))

    def components(self, z: Any) -> Any:
        """Return the components ``(d, *S)`` of noise for standard normal numbers ``(d, *S)``; Gaussian ones stay.

        A quantile of each law is taken, the same bits for one number and for many.
        """
        if self.laws is None:
            return z
        rows = (np.asarray(row) if is_host(row) else row for row in z)
        found = [law.ppf_of_normal(row) for law, row in zip(self.laws, rows)]
        return namespace(found[0]).stack(found)

    def copies(self, n: int) -> tuple[Self, ...]:
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


def shared_fields(d: int, m: int, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what all agents declare, checked: name, noise, boxes and start, from arguments of these names.

    Parameters
    ----------
    d, m : int
        Numbers of states and inputs.
    given : mapping
        Arguments of a constructor; others than these are passed over.
    """
    workspace = Box(given["state_low"], given["state_high"], names=("state_low", "state_high"), length=d)
    names = ("input_low", "input_high")
    input_box = Box(given["input_low"], given["input_high"], allow_flat=True, names=names, length=m)
    start = checked_start(given["initial_state"], given["initial_low"], given["initial_high"], d)
    noise = declared_noise(given["noise"], given["noise_covariance"], given["noise_axes"], d)
    return {
        "name": checked_name(given["name"], "name"),
        "noise_covariance": noise.covariance,
        "laws": noise.laws,
        "noise_axes": noise.axes,
        "state_low": workspace.low,
        "state_high": workspace.high,
        "input_low": input_box.low,
        "input_high": input_box.high,
        "initial_low": None if start is None else start.low,
        "initial_high": None if start is None else start.high,
    }


def checked_added(value: Any, n_outputs: int) -> int:
    """Return the number of outputs that were added for shapes, or raise ValueError."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    if not whole or not 0 <= value <= n_outputs:
        raise ValueError(f"`added_outputs`: expected a whole number from 0 to {n_outputs}, got {shown(value)}")
    return int(value)


IDLE = "idle"
"""Name of the input of an agent that nobody steers."""


def is_passive(inputs: Any, given: Mapping[str, Any]) -> bool:
    """Return whether an agent declares no inputs, and so no input box; raise ValueError if it has a box alone.

    Such an agent gets one input that is 0 and moves nothing: spaces of actions, controllers and files are as for all.
    """
    if inputs is not None and np.size(inputs):
        return False
    for key in ("input_low", "input_high"):
        if given[key] is not None and np.size(given[key]):
            raise ValueError(
                f"`{key}`: expected nothing for an agent without inputs, got {shown(given[key])}; give `inputs` (or "
                "`B`), or leave the box out"
            )
    return True


def checked_start(state: Any, low: Any, high: Any, d: int) -> Box | None:
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


def summary_rows(agent: AnyAgent) -> list[tuple[str, object]]:
    """Return the rows of an agent's `repr` that all agents have."""
    deviations = [f"{x:g}" for x in np.sqrt(np.maximum(np.diag(agent.noise_covariance), 0.0))]
    each = deviations[:1] if len(set(deviations)) == 1 else deviations
    noise = f"standard deviation {shortened(', '.join(each))}"
    if agent.laws is not None:
        noise = f"{', '.join(law.name for law in agent.laws)}; {noise}"
    if agent.noise_scale is not None:
        noise += f" in the middle of the workspace; times {shortened(', '.join(agent.noise_scale), 60)}"
    return [
        ("workspace", box_text(agent.state_low, agent.state_high)),
        ("inputs", box_text(agent.input_low, agent.input_high)),
        ("start", "none" if agent.initial_low is None else _start_text(agent.initial)),
        ("noise", noise),
    ]
