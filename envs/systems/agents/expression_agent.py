"""One continuous stochastic agent whose dynamics are written as expressions.

Model (docs/theory/boxes.md, "Boxes of expressions"), with noise w independent over time and agents:

    x' = f(x, u, v) + w,      y = g(x),      x in the workspace,      u in the input box,      v in the disturbance box.

`f` may also name states and inputs of other agents, such as `leader.position` and `boiler.heat` (see ``neighbours``),
and the time: `t` is the number of control steps taken before this one, 0 to T - 1, unless something declared has this
name. At each step such an agent is one with a number in the place of `t` (`at`).

`f` and `g` are functions of real numbers; simulations compute them in double precision.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from ..arguments import counted, names_text, read_only, shortened, shown, tree_text
from ..backends import double, is_host, namespace
from ..distributions import Law, ScipyLaw, laws_of
from ..expressions import Affine, Name, Number, Tree, computed, enclosed, names_in, read_expression, substituted
from .angles import TURN, checked_angles, refuse_uneven
from .any_agent import IDLE, AnyAgent, checked_added, is_passive, shared_fields, summary_rows
from .declaration import declared
from .declared_names import MOST_OUTPUTS, TIME, checked_names, checked_numbers, checked_ranges, checked_texts
from .neighbours import neighbour, states_of_others

MOST_TIMES = 4096
"""Steps for which the agent is remembered as it moves then: beyond them the memory starts afresh."""

MOST_SHOWN = 4
"""Dynamics that are written out when an agent prints itself."""

_ARRAYS = (
    "state_low",
    "state_high",
    "input_low",
    "input_high",
    "initial_low",
    "initial_high",
)
"""Fields that hold arrays, in the order of problem files."""


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Agent(AnyAgent):
    """An agent whose dynamics are expressions, with noise, a workspace and an input box.

    Expressions hold numbers, names, `+ - * / **`, brackets, `pi`, and `sin cos tan atan exp log sqrt tanh abs min max
    clip`. They are read, never run.

    Parameters
    ----------
    name : str
        Letters, digits and underscores, not starting with a digit.
    states, inputs : sequences of str
        Names of the d states and m inputs, at least one of each.
    dynamics : sequence of str
        The mean of each state one step later, in states, inputs, parameters and disturbances, in states and inputs
        of other agents of the problem (`leader.position`, `boiler.heat`), and in the time `t` of the step, 0 to T - 1.
    parameters : mapping from str to float, optional
        Numbers by name.
    disturbances : mapping from str to (low, high), optional
        Bounded unknowns by name: anything in the closed interval, at every step anew. Certificates hold for all of
        them; environments say how they behave.
    noise : number, array_like, laws or mapping
        Noise, independent over time. A number, or one for each state: **standard deviations** of Gaussian noise, also
        as expressions (`["0.03 + 0.05*x", 0.1]`), as `scale` below has them. A
        matrix (d, d): its **covariance**, exactly symmetric and positive semidefinite. A law such as `{"law":
        "uniform", "low": -0.1, "high": 0.1}`, or one for each state. A mapping: `{"laws": ..., "axes": ...}`, where the
        columns of `axes`, shape (d, d), are the directions of the components with those laws; or `{"std": ...,
        "scale": ...}`, or `laws` in place of `std`, where `scale` is what the noise of each state is multiplied with,
        such as `0.1 + 0.05*abs(x)`: expressions in states, inputs, parameters, disturbances and `t`, positive in the
        workspace.
    state_space : pair (low, high) of array_like, shape (d,)
        Workspace, a closed box; one number stands for all axes. An agent that leaves it violates every task.
    input_space : pair (low, high) of array_like, shape (m,)
        Input box, closed. An agent that nobody steers has neither inputs nor a box, and is given an input that is 0.
    start : array_like, shape (d,), or pair (low, high) of these, optional
        Start: a point, or a box from which it is drawn uniformly.
    outputs : sequence of str, optional
        Expressions in states and parameters that propositions are about; the states by default.
    angles : sequence of str, optional
        States that are angles, in radians: they wrap, so that nothing leaves the workspace by turning. Their workspace
        is one turn, from -pi to pi or from 0 to 2 pi, and the dynamics must be the same a turn further on.
    **keys
        Keys of problem files: `state_low` and `state_high`, `input_low` and `input_high` for the spaces;
        `initial_state`, or `initial_low` and `initial_high`, for the start; `noise_std`, `noise_covariance`,
        `noise_axes` and `noise_scale` for the noise. `added_outputs`: how many of the last outputs are there for
        shapes only; problems say it of the agents that they make.
        `communicated`: names of the other agents whose states the agent is told at every step. Controllers then cancel
        what these do where an input reaches it. Of all others certificates assume anything in their workspaces, and of
        inputs anything in their boxes.

    Raises
    ------
    ValueError
        If an argument is wrong. The message names it; for expressions it points at the place.

    Examples
    --------
    >>> agent = Agent(
    ...     name="pendulum", states=["angle", "rate"], inputs=["torque"], parameters={"damping": 0.2},
    ...     dynamics=["angle + 0.1*rate", "rate + 0.1*(sin(angle) - damping*rate + 2*torque)"],
    ...     noise=[0.05, 0.05], state_space=([-1.5, -2], [1.5, 2]), input_space=(-1, 1), start=[0.8, 0],
    ... )
    >>> agent.mean(np.array([0.0, 1.0]), np.array([0.5]))
    array([0.1 , 1.08])
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    dynamics: tuple[str, ...]
    parameters: Mapping[str, float]
    disturbances: Mapping[str, tuple[float, float]]
    noise_covariance: np.ndarray
    laws: tuple[Law, ...] | None
    noise_axes: np.ndarray
    noise_scale: tuple[str, ...] | None
    state_low: np.ndarray
    state_high: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    initial_low: np.ndarray | None
    initial_high: np.ndarray | None
    output_expressions: tuple[str, ...]
    communicated: tuple[str, ...]
    neighbour_ranges: tuple[tuple[float, float], ...] | None
    neighbour_inputs: tuple[bool, ...]
    has_clock: bool
    added_outputs: int
    angles: tuple[str, ...]
    unrolled: tuple[str, ...]

    needed_keys: ClassVar[tuple[str, ...]] = ("name", "states", "dynamics", "state_low", "state_high")
    """Keys that it must have in problem files."""

    other_keys: ClassVar[tuple[str, ...]] = (
        *("inputs", "input_low", "input_high", "parameters", "disturbances", "noise", "noise_covariance", "noise_std"),
        *("noise_axes", "noise_scale", "initial_state", "initial_low", "initial_high", "communicated", "outputs"),
        *("added_outputs", "angles"),
    )
    """Keys that it may have there."""

    def __init__(
        self,
        *,
        name: str = "agent",
        states: Any,
        inputs: Any = None,
        dynamics: Any,
        parameters: Any = None,
        disturbances: Any = None,
        noise: Any = None,
        state_space: Any = None,
        input_space: Any = None,
        start: Any = None,
        outputs: Any = None,
        angles: Any = None,
        **keys: Any,
    ) -> None:
        named = {key: value for key, value in locals().items() if key not in ("self", "keys")}
        state_names = checked_names(states, "states")
        given = declared("Agent", len(state_names), named, keys, ("noise_scale", "communicated", "added_outputs"))
        if is_passive(inputs, given):
            inputs = [next(name for name in (IDLE + "_" * k for k in count()) if name not in state_names)]
            given |= {"input_low": [0.0], "input_high": [0.0]}
        input_names = checked_names(inputs, "inputs")
        d, m = len(state_names), len(input_names)
        scale, told = given["noise_scale"], given["communicated"]
        values = {
            **shared_fields(d, m, given),
            "states": state_names,
            "inputs": input_names,
            "dynamics": checked_texts(dynamics, "dynamics", d),
            "parameters": MappingProxyType(checked_numbers(parameters)),
            "disturbances": MappingProxyType(checked_ranges(disturbances)),
            "communicated": () if not told else checked_texts(told, "communicated", None),
            "neighbour_ranges": None,
            "neighbour_inputs": (),
            "has_clock": False,
            "angles": checked_angles(angles, state_names),
            "unrolled": (),
            "output_expressions": state_names
            if outputs is None
            else checked_texts(outputs, "outputs", None, MOST_OUTPUTS),
            "noise_scale": None if scale is None else checked_texts(scale, "noise_scale", d),
        }
        values["added_outputs"] = checked_added(given["added_outputs"], len(values["output_expressions"]))
        for key, value in values.items():
            object.__setattr__(self, key, value)  # the record is frozen
        self._check_names()
        # Read all expressions now, so that mistakes show where they are made.
        assert self.timed_trees and self.output_trees
        if self.noise_scale is not None:
            self._scale_noise(given["noise"])
        refuse_uneven(self)

    def _scale_noise(self, noise: Any) -> None:
        """Keep the laws of noise that is multiplied, and the covariance that it has in the middle of the workspace."""
        if noise is None or np.any(self.noise_axes != np.eye(self.n_states)):
            raise ValueError("`noise_scale`: expected beside `noise`, a law for each state, and without `noise_axes`")
        laws = laws_of(noise, self.n_states)
        if any(isinstance(law, ScipyLaw) for law in laws):
            raise ValueError("`noise_scale`: expected laws that can be scaled, got one of scipy")
        # A scale of 1 everywhere, however it is written, is none: nothing is charged for what does not vary.
        if set(self.timed_scale_trees) == {Number(1.0)}:
            del self.__dict__["timed_scale_trees"]
            object.__setattr__(self, "noise_scale", None)
            return
        # As laws even where all are Gaussian: what is made for Gaussian noise counts on a covariance everywhere.
        object.__setattr__(self, "laws", laws)
        middle = np.array(self.workspace.center)
        scale = self.scales(middle, np.array(self.input_box.center), time=0)
        usable = np.where(np.isfinite(scale) & (scale > 0.0), scale, 1.0)
        variances = np.array([law.std for law in laws]) * usable
        object.__setattr__(self, "noise_covariance", read_only(np.diag(variances**2)))

    def _check_names(self) -> None:
        """Raise ValueError if a name means two things."""
        seen: set[str] = set()
        for argument in ("states", "inputs", "parameters", "disturbances"):
            for name in getattr(self, argument):
                if name in seen:
                    raise ValueError(f"`{argument}`: expected different names, got {name!r} twice; rename one")
                seen.add(name)
        owners = [name.split(".")[0] for name in self.others]
        if self.name in owners:
            raise ValueError(f"`dynamics`: expected states of other agents, or inputs, got one of {self.name!r} itself")
        for name in self.communicated:
            if name not in owners:
                raise ValueError(f"`communicated`: expected agents whose states `dynamics` name, got {shown(name)}")

    # Copy and pickle the arguments alone: what is cached can be computed again.
    def __getstate__(self) -> dict[str, Any]:
        return self.to_dict()

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(**state)  # type: ignore[misc]

    def __repr__(self) -> str:
        sizes = (counted(self.n_states, "state"), counted(self.n_inputs, "input"), counted(self.n_outputs, "output"))
        named = [(f"{shortened(state, 30)}'", shortened(text, 80)) for state, text in zip(self.states, self.dynamics)]
        rows = named[:MOST_SHOWN]
        if len(named) > MOST_SHOWN:
            rows.append(("...", f"{len(named) - MOST_SHOWN} more"))
        numbers = [f"{name} = {value:g}" for name, value in self.parameters.items()]
        ranges = [f"{name} in [{low:g}, {high:g}]" for name, (low, high) in self.disturbances.items()]
        rows += [("parameters", names_text(numbers))] if numbers else []
        rows += [("unknown", names_text(ranges))] if ranges else []
        rows += [("beside", names_text(list(self.others)))] if self.others else []
        rows += [("told by", names_text(list(self.communicated)))] if self.communicated else []
        return tree_text(f"Agent {self.name!r}: {', '.join(sizes)}", [*rows, *summary_rows(self)])

    @cached_property
    def trees(self) -> tuple[Tree, ...]:
        """Dynamics as expression trees, the parameters put in; ValueError where they name the time (see `at`)."""
        self._refuse_time()
        return self.timed_trees

    @cached_property
    def scale_trees(self) -> tuple[Tree, ...]:
        """What the noise of each state is multiplied with, the parameters put in; empty without a `noise_scale`.

        What has no names and is 1 is the number 1, whatever it was written as. ValueError where the agent names the
        time (see `at`).
        """
        self._refuse_time()
        return self.timed_scale_trees

    @cached_property
    def names_time(self) -> bool:
        """Whether the dynamics, or the scale of the noise, name the time `t`."""
        return bool(self._time) and any(TIME in names_in(tree) for tree in (*self.timed_trees, *self.timed_scale_trees))

    @cached_property
    def _time(self) -> tuple[str, ...]:
        """The name of the time, unless something that is declared has it."""
        declared = (*self.states, *self.inputs, *self.parameters, *self.disturbances)
        return () if TIME in declared else (TIME,)

    def with_clock(self, horizon: int) -> Agent:
        """Return the agent with the time as its last input, a *clock* from 0 to T - 1 (`unrolled_in_time`)."""
        data = self.to_dict()
        data |= {
            "inputs": [*self.inputs, TIME],
            "input_low": [*self.input_low.tolist(), 0.0],
            "input_high": [*self.input_high.tolist(), float(horizon - 1)],
        }
        agent = type(self)(**data)
        object.__setattr__(agent, "has_clock", True)
        return agent

    @cached_property
    def wrapped_axes(self) -> np.ndarray:
        """Which states (d,) are angles."""
        return read_only(np.array([state in self.angles for state in self.states]))

    def unrolled_by(self, turns: int) -> Agent:
        """Return the agent whose angles are numbers, with this many turns more on either side of the workspace.

        Searches plan paths for it; the angles are kept within half a turn of a nominal path.
        """
        more = np.where(self.wrapped_axes, TURN * turns, 0.0)
        data = self.to_dict() | {"state_low": self.state_low - more, "state_high": self.state_high + more}
        agent = type(self)(**{key: value for key, value in data.items() if key != "angles"})
        object.__setattr__(agent, "unrolled", self.angles)
        return agent

    def at(self, time: int) -> Agent:
        """Return the agent as it moves at one control step, 0 to T - 1: the time becomes one of its parameters.

        Raises
        ------
        ValueError
            If an expression is not defined at this time, such as `1/t` at 0.
        """
        if not self.names_time:
            return self
        if time not in self._at_times:
            if len(self._at_times) >= MOST_TIMES:
                self._at_times.clear()
            data = {**self.to_dict(), "parameters": {**self.parameters, TIME: float(time)}}
            try:
                agent = type(self)(**data)
            except ValueError as error:
                raise ValueError(f"agent `{self.name}` at t = {time}: {error}") from None
            tied_to = () if self.neighbour_ranges is None else (self.neighbour_ranges, self.neighbour_inputs)
            self._at_times[time] = agent.tied_to(*tied_to) if tied_to else agent
        return self._at_times[time]

    @cached_property
    def _at_times(self) -> dict[int, Agent]:
        """The agent at the steps that were asked for."""
        return {}

    def _refuse_time(self) -> None:
        """Raise ValueError if the agent moves otherwise at every time: it has no expressions of its own then."""
        if self.names_time:
            raise ValueError(
                f"agent `{self.name}`: expected dynamics that are the same at every step, got some that name the time "
                "`t`; ask for the agent `at` a step, and certify with the relation `path`, or `boxes`"
            )

    @cached_property
    def timed_trees(self) -> tuple[Tree, ...]:
        """Dynamics as expression trees, the parameters put in; they may name the time, `t`."""
        names = (*self.states, *self.inputs, *self.disturbances, *self.others, *self._time)
        inside: dict[str, Tree] = {name: Name(neighbour(k)) for k, name in enumerate(self.others)}
        trees = (self._tree(text, "dynamics", k, names) for k, text in enumerate(self.dynamics))
        return tuple(substituted(tree, inside) if inside else tree for tree in trees)

    @cached_property
    def timed_scale_trees(self) -> tuple[Tree, ...]:
        """What the noise is multiplied with, as `scale_trees`; it may name the time."""
        names = (*self.states, *self.inputs, *self.disturbances, *self._time)
        trees = [self._tree(text, "noise_scale", k, names) for k, text in enumerate(self.noise_scale or ())]
        return tuple(
            Number(1.0) if not names_in(tree) and computed([tree], {})[0][0] == 1.0 else tree for tree in trees
        )

    @cached_property
    def others(self) -> tuple[str, ...]:
        """States and inputs of other agents that the dynamics name, such as `leader.position`."""
        return states_of_others(self.dynamics)

    @cached_property
    def measured(self) -> frozenset[str]:
        """Names in trees of those states of others that the agent is told."""
        told = [name.split(".")[0] in self.communicated for name in self.others]
        # Inputs are chosen in the same step: nobody can be told of them.
        chosen = self.neighbour_inputs or (False,) * len(told)
        return frozenset(neighbour(k) for k, is_told in enumerate(told) if is_told and not chosen[k])

    def tied_to(self, ranges: tuple[tuple[float, float], ...], inputs: tuple[bool, ...]) -> Agent:
        """Return the agent in a problem where `others` lie in these intervals; `inputs` says which are inputs."""
        if (ranges, inputs) == (self.neighbour_ranges, self.neighbour_inputs):
            return self
        agent = type(self)(**self.to_dict())
        object.__setattr__(agent, "has_clock", self.has_clock)
        object.__setattr__(agent, "unrolled", self.unrolled)
        object.__setattr__(agent, "neighbour_ranges", ranges)
        object.__setattr__(agent, "neighbour_inputs", inputs)
        return agent

    @property
    def unknowns(self) -> dict[str, tuple[float, float]]:
        """Intervals of everything that moves the mean besides state and input, by names in trees.

        Raises
        ------
        ValueError
            If the agent names states or inputs of others and does not belong to a problem.
        """
        if len(self.neighbour_ranges or ()) != len(self.others):
            raise ValueError(
                f"`agent`: expected an agent of a problem, as {self.name!r} names states or inputs of others"
            )
        named = {neighbour(k): ends for k, ends in enumerate(self.neighbour_ranges or ())}
        return {**self.disturbances, **named}

    @cached_property
    def output_trees(self) -> tuple[Tree, ...]:
        """Outputs as expression trees, the parameters put in."""
        return tuple(self._tree(text, "outputs", k, self.states) for k, text in enumerate(self.output_expressions))

    def _tree(self, text: str, argument: str, k: int, names: Sequence[str]) -> Tree:
        try:
            return read_expression(text, names, self.parameters)
        except ValueError as error:
            timed = argument == "outputs" and "unknown name 't'" in str(error)
            more = "; outputs are the same at all times, but ends of their regions may name `t`" if timed else ""
            told, *place = str(error).split("\n", 1)
            if "unknown name" in told and not timed and "did you mean" not in told:
                name = told.split("'")[1]
                more = f"; a number goes into `parameters`, such as {{ {name} = 0.1 }}" if "." not in name else ""
                if argument != "outputs" and more:
                    more += f", a bounded unknown into `disturbances`, such as {{ {name} = [-0.1, 0.1] }}"
            raise ValueError("\n".join([f"`{argument}[{k}]`: {told}{more}", *place])) from None

    is_affine = False  # as far as is known: affine expressions are expressions

    @property
    def motion_text(self) -> str:
        """How it moves, in symbols."""
        named = [f"{name} = {value:g}" for name, value in self.parameters.items()]
        named += [f"{name} in [{low:g}, {high:g}]" for name, (low, high) in self.disturbances.items()]
        return ", ".join([*(f"{x}' = {text} + w" for x, text in zip(self.states, self.dynamics, strict=True)), *named])

    @property
    def n_outputs(self) -> int:
        """Number of output components p."""
        return len(self.output_expressions)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states."""
        return self.states

    @property
    def output_names(self) -> tuple[str, ...]:
        """Outputs as they are written, those that were added for shapes left out."""
        return self.output_expressions[: self.n_outputs - self.added_outputs]

    @property
    def disturbance_low(self) -> np.ndarray:
        """Lower ends of the disturbances, shape (k,)."""
        return np.array([low for low, _ in self.disturbances.values()], dtype=float)

    @property
    def disturbance_high(self) -> np.ndarray:
        """Upper ends of the disturbances, shape (k,)."""
        return np.array([high for _, high in self.disturbances.values()], dtype=float)

    @cached_property
    def motion_key(self) -> tuple[bytes, ...]:
        """What determines how the agent moves, apart from noise, boxes and names of agents; it serves comparisons."""
        parts: tuple[object, ...] = (
            self.states,
            self.inputs,
            self.dynamics,
            tuple(self.parameters.items()),
            tuple(self.disturbances.items()),
        )
        if self.noise_scale is not None:
            parts = (*parts, self.noise_scale)
        if self.has_clock:
            parts = (*parts, "clock")
        if self.angles:
            parts = (*parts, "angles", self.angles)
        if self.others:  # agents in equal places are equal, though their neighbours have other names
            beside = (self.neighbour_ranges, self.neighbour_inputs, tuple(sorted(self.measured)))
            parts = (*parts[:2], repr(self.timed_trees), *parts[3:], *beside)
        return (b"expressions", repr(parts).encode())

    @cached_property
    def output_key(self) -> tuple[bytes, ...]:
        """What determines its outputs."""
        parts: tuple[object, ...] = (self.states, self.output_expressions, tuple(self.parameters.items()))
        parts = (*parts, self.added_outputs) if self.added_outputs else parts
        return (b"expressions", repr(parts).encode())

    def mean(
        self,
        x: np.ndarray,
        u: np.ndarray,
        disturbances: np.ndarray | None = None,
        neighbours: np.ndarray | None = None,
        time: Any = None,
    ) -> np.ndarray:
        """Return the means ``(d, *S)`` of the next states from states ``(d, *S)`` under inputs ``(m, *S)`` (rounded).

        `disturbances` ``(k, *S)`` are those of the step; by default each is the number of its interval nearest to 0.
        `neighbours` ``(l, *S)`` are the states and inputs of `others`; by default the middles of their intervals.
        `time` is the step, a number or an array ``(S[-1],)``; ValueError without one if the dynamics name the time.
        """
        disturbances = self._calm(x) if disturbances is None else disturbances
        if neighbours is None and self.others:
            middles = [0.5 * low + 0.5 * high for low, high in list(self.unknowns.values())[len(self.disturbances) :]]
            neighbours = np.broadcast_to(
                np.array(middles).reshape(-1, *[1] * (x.ndim - 1)), (len(middles), *x.shape[1:])
            )
        arrays = (x, u, disturbances, () if neighbours is None else neighbours)
        values = {name: _one_axis(row) for names, rows in self._rows(*arrays) for name, row in zip(names, rows)}
        values |= self._at(time, x)
        return namespace(x).stack(computed(self.timed_trees, values)).reshape(x.shape)

    def _at(self, time: Any, x: np.ndarray) -> dict[str, np.ndarray]:
        """Return the time by its name, beside states ``(d, *S)``; nothing if nothing names it."""
        if not self.names_time:
            return {}
        if time is None:
            self._refuse_time()
        return {TIME: _times(time, x)}

    def scales(
        self, x: np.ndarray, u: np.ndarray, disturbances: np.ndarray | None = None, time: Any = None
    ) -> np.ndarray:
        """Return what the noise of each state is multiplied with ``(d, *S)``, arguments as for `mean` (rounded)."""
        disturbances = self._calm(x) if disturbances is None else disturbances
        named = zip((self.states, self.inputs, tuple(self.disturbances)), (x, u, disturbances))
        values = {name: _one_axis(row) for names, rows in named for name, row in zip(names, rows)}
        values |= self._at(time, x)
        return namespace(x).stack(computed(self.timed_scale_trees, values)).reshape(x.shape)

    def _calm(self, x: np.ndarray) -> np.ndarray:
        """Return the disturbances ``(k, *S)`` that are nearest to 0, for states ``(d, *S)``."""
        calm = np.clip(0.0, self.disturbance_low, self.disturbance_high)
        return np.broadcast_to(calm.reshape(-1, *[1] * (x.ndim - 1)), (len(calm), *x.shape[1:]))

    def _rows(self, *arrays: Any) -> list[tuple[Sequence[str], Any]]:
        beside = [neighbour(k) for k in range(len(self.others))]
        return list(zip((self.states, self.inputs, tuple(self.disturbances), beside), arrays))

    def outputs(self, x: np.ndarray) -> np.ndarray:
        """Return the outputs ``(p, *S)`` at states ``(d, *S)``: the same bits for one state and for many."""
        if self.has_identity_output:
            return x
        values = {name: _one_axis(row) for name, row in zip(self.states, x)}
        return namespace(x).stack(computed(self.output_trees, values)).reshape(self.n_outputs, *x.shape[1:])

    def output_range(self, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return bounds around the outputs of closed state boxes (S, d), rounded outwards: two arrays (S, p).

        They are infinite where an output is not defined on the whole box.
        """
        names = {state: Affine(np.zeros(1), {k: np.ones(1)}) for k, state in enumerate(self.states)}
        ranges = enclosed(self.output_trees, names, [*zip(low.T, high.T)])
        lows, highs = (np.stack([np.broadcast_to(ends[side], len(low)) for ends in ranges], axis=1) for side in (0, 1))
        return np.where(np.isnan(lows), -np.inf, lows), np.where(np.isnan(highs), np.inf, highs)

    def output_axis(self, k: int) -> tuple[int, float] | None:
        """Return state and factor of output k if it is a single state, or None."""
        tree = self.output_trees[k]
        return (self.states.index(tree.name), 1.0) if isinstance(tree, Name) else None

    def to_dict(self) -> dict[str, Any]:
        """Return the agent as plain values, keyed as in problem files (exact)."""
        data: dict[str, Any] = {"name": self.name}
        data |= {key: list(getattr(self, key)) for key in ("states", "inputs", "dynamics")}
        if self.parameters:
            data["parameters"] = dict(self.parameters)
        if self.disturbances:
            data["disturbances"] = {name: list(ends) for name, ends in self.disturbances.items()}
        if self.communicated:
            data["communicated"] = list(self.communicated)
        data |= self.noise_data()
        data |= {key: getattr(self, key).tolist() for key in _ARRAYS if getattr(self, key) is not None}
        if not self.has_identity_output:
            data["outputs"] = list(self.output_expressions)
        if self.added_outputs:
            data["added_outputs"] = self.added_outputs
        if self.angles:
            data["angles"] = list(self.angles)
        return data


def with_expressions(agent: AnyAgent) -> Agent:
    """Return an agent that is known to have expressions (TypeError if it has not)."""
    if not isinstance(agent, Agent):
        raise TypeError(f"agent `{agent.name}`: expected expressions, got matrices")
    return agent


def _times(time: Any, x: np.ndarray) -> np.ndarray:
    """Return times, a number or one for each place of the last axis of states ``(d, *S)``, as doubles ``S``."""
    row = _one_axis(x[0])
    xp = namespace(row)
    # Not 0 times the states: these may be infinite.
    return xp.zeros_like(row) + (xp.full_like(row, float(time)) if np.ndim(time) == 0 else double(time))


def _one_axis(row: np.ndarray) -> np.ndarray:
    """Return numbers as an array of at least one axis, as expressions take them."""
    return np.atleast_1d(np.asarray(row, dtype=float)) if is_host(row) else row
