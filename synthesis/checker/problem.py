"""The problem that a certificate is about, in canonical form: what moves, what happens by chance, what is asked.

At time t agent i has a state x_i (d_i,) and applies an input u_i in its closed box. With independent numbers w,
standard normal or of other distributions, and disturbances v, which are anywhere in their closed intervals, whatever
happened before, and do not know the noise of their step,

    x_i(t + 1) = f_i(x, u, v, t) + scale_i(x_i, u_i, v_i, t) * (N_i w_i) + M_i w_shared,

where f_i may name states and inputs of other agents. Runs start at a point that is drawn uniformly from the box of
starts. A run fails when a state leaves its closed workspace at a time 1 .. T. Proposition p holds at time t if
``low <= y < high`` for all outputs y of its agent (a region), or for the differences of the outputs of two agents (a
pair), or if the difference is shorter than a radius. ``null`` stands for no limit. The letters of times 0 .. T are a
word; the formula says which words are right.

All of it is in the header of the file (docs/reference/certificate_format.md); nothing is expanded, guessed or completed
here. Families, shapes, units and moving corners are written out before the file is made.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import fields
from .automaton import Automaton
from .distributions import NORMAL, STOPPED, Envelope, read_distribution
from .expressions import Tree, affine, names_in, read_expression
from .fields import Unreadable
from .formula import Formula, parse
from .rigorous import Array

MOST_STATES, MOST_STEPS = 5000, 100_000
"""States of all agents together, and control steps."""


@dataclass(frozen=True, eq=False)
class Agent:
    """One agent: names, dynamics and outputs as trees, boxes (2, .), factors of its noise.

    ``envelopes`` are those of the sources of its noise, ``scale`` multiplies the noise of each state (none: 1).
    ``states_of_others`` and ``inputs_of_others`` say which variable of which agent a dotted name is.
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    disturbances: dict[str, tuple[float, float]]
    dynamics: tuple[Tree, ...]
    outputs: tuple[Tree, ...]
    state_box: Array
    input_box: Array
    start: Array
    noise: Array
    envelopes: tuple[Envelope, ...]
    scale: tuple[Tree, ...]
    shared_noise: Array
    angles: tuple[str, ...]
    states_of_others: dict[str, tuple[int, int]]
    inputs_of_others: dict[str, tuple[int, int]]


@dataclass(frozen=True, eq=False)
class Region:
    """A proposition about one agent: corners (T + 1, p), infinite where there is no limit."""

    name: str
    agent: int
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class Pair:
    """A proposition about the difference of outputs of two agents: corners (T + 1, p), or radii (T + 1,)."""

    name: str
    agents: tuple[int, int]
    outputs: tuple[tuple[int, ...], tuple[int, ...]]
    low: Array
    high: Array
    radius: Array | None


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that a claim is about."""

    horizon: int
    agents: tuple[Agent, ...]
    regions: tuple[Region, ...]
    pairs: tuple[Pair, ...]
    automaton: Automaton
    formula: Formula | None
    """None where the automaton itself is the task."""

    @property
    def slices(self) -> list[slice]:
        """Where the states of each agent are in the joint state."""
        first = np.concatenate([[0], np.cumsum([len(agent.states) for agent in self.agents])])
        return [slice(int(a), int(b)) for a, b in zip(first, first[1:])]

    @property
    def noise(self) -> Array:
        """The factor L (D, W) of the noise of the joint state, before it is scaled.

        Sources stand agent by agent, in deviations of what is above them, then come the shared ones.
        """
        own = sum(agent.noise.shape[1] for agent in self.agents)
        factor = np.zeros((self.slices[-1].stop, own + self.agents[0].shared_noise.shape[1]))
        column = 0
        for agent, here in zip(self.agents, self.slices, strict=True):
            last = column + agent.noise.shape[1]
            factor[here, column:last] = agent.noise * np.array([own.deviation for own in agent.envelopes])
            factor[here, own:] = agent.shared_noise
            column = last
        return factor

    @property
    def kinds(self) -> NDArray[np.int64]:
        """What is known of the tails of each source (W,) of noise."""
        own = [_kind(agent, envelope) for agent in self.agents for envelope in agent.envelopes]
        return np.array([*own, *[NORMAL] * self.agents[0].shared_noise.shape[1]], dtype=np.int64)


def _kind(agent: Agent, envelope: Envelope) -> int:
    """Return what is known of a source's tails; a scale that names the time only is a number at each step."""
    depends = names_in(agent.scale) & {*agent.states, *agent.inputs, *agent.disturbances}
    return STOPPED if depends and envelope.tail == NORMAL else envelope.tail


def read_problem(header: dict[str, Any]) -> Problem:
    """Return the problem in the header of a file; raise ``Unreadable`` if it is not in canonical form."""
    data = fields.table(header["problem"], "problem", ("horizon", "agents", "regions", "pairs", "task"))
    horizon = fields.whole(data["horizon"], "problem.horizon", 1, MOST_STEPS)
    agents = _read_agents(data["agents"])
    regions = tuple(fields.each(data["regions"], "problem.regions", lambda r, at: _region(r, at, agents, horizon)))
    pairs = tuple(fields.each(data["pairs"], "problem.pairs", lambda r, at: _pair(r, at, agents, horizon)))
    names = (*(region.name for region in regions), *(pair.name for pair in pairs))
    fields.distinct([names], "problem.regions")
    task = fields.table(data["task"], "problem.task", ("semantics", "automaton"), ("formula",))
    automaton = _automaton(task, names)
    formula = None
    if "formula" in task:
        try:
            formula = parse(fields.text(task["formula"], "problem.task.formula"))
        except ValueError as error:
            raise Unreadable(f"problem.task.formula: {error}") from error
    return Problem(horizon, agents, regions, pairs, automaton, formula)


# Agents.

TURN = 6.283185307179586
"""The double below a turn."""

REQUIRED = (
    "name", "states", "inputs", "outputs", "state_low", "state_high", "input_low", "input_high", "start_low",
    "start_high", "noise",
)  # fmt: skip
OPTIONAL = (
    "dynamics", "A", "B", "c", "disturbances", "parameters", "shared_noise", "distributions", "noise_scale", "angles",
)  # fmt: skip
STANDARD = Envelope(0.0, 0.0, 1.0, NORMAL)
"""Noise is standard normal unless a file says otherwise."""


def _read_agents(value: Any) -> tuple[Agent, ...]:
    tables = fields.each(value, "problem.agents", lambda own, at: fields.table(own, at, REQUIRED, OPTIONAL))
    if not tables:
        raise Unreadable("problem.agents: there is no agent")
    names = fields.names([own["name"] for own in tables], "problem.agents.name")
    # Names of all states and inputs come first: dynamics may name those of agents that follow.
    variables = [
        (fields.names(own["states"], f"{name}.states"), fields.names(own["inputs"], f"{name}.inputs"))
        for name, own in zip(names, tables, strict=True)
    ]
    if not 0 < sum(len(states) for states, _ in variables) <= MOST_STATES or not all(s for s, _ in variables):
        raise Unreadable(f"problem.agents: every agent has a state, and all together at most {MOST_STATES}")
    agents = tuple(_agent(i, own, names, variables) for i, own in enumerate(tables))
    if len({agent.shared_noise.shape[1] for agent in agents}) > 1:
        raise Unreadable("problem.agents: `shared_noise` has different numbers of columns")
    return agents


def _agent(i: int, own: dict[str, Any], names: tuple[str, ...], variables: list[Any]) -> Agent:
    name, (states, inputs) = names[i], variables[i]
    d, m = len(states), len(inputs)
    disturbances = _numbers(own.get("disturbances", {}), f"{name}.disturbances", _ends)
    parameters = _numbers(own.get("parameters", {}), f"{name}.parameters", fields.number)
    fields.distinct([states, inputs, tuple(disturbances)], name)
    # Dotted names: which state or input of which agent they are.
    others = [
        {f"{names[j]}.{key}": (j, k) for j in range(len(names)) if j != i for k, key in enumerate(variables[j][kind])}
        for kind in (0, 1)
    ]
    if others[0].keys() & others[1].keys():
        raise Unreadable(f"{name}: a name of another agent stands for two things")
    # `t` is the time unless the agent has something of this name.
    local = (*states, *inputs, *disturbances)
    readable = (*local, *others[0], *others[1], *(() if "t" in (*local, *parameters) else ("t",)))
    # Noise: factors, distributions of what they multiply, and scales.
    shared, noise = own.get("shared_noise"), fields.matrix(own["noise"], f"{name}.noise", d)
    envelopes = [STANDARD] * noise.shape[1]
    if "distributions" in own:
        envelopes = fields.each(own["distributions"], f"{name}.distributions", read_distribution, len(envelopes))
    timed = (*local, *(() if "t" in (*local, *parameters) else ("t",)))
    scale = _trees(own.get("noise_scale", []), f"{name}.noise_scale", timed, parameters)
    if len(scale) not in (0, d):
        raise Unreadable(f"{name}.noise_scale: expected {d} expressions, got {len(scale)}")
    return Agent(
        name,
        states,
        inputs,
        disturbances,
        _dynamics(own, name, states, inputs, readable, parameters),
        _trees(own["outputs"], f"{name}.outputs", states, parameters),
        _workspace(own, name, d),
        fields.box(own, name, "input_low", "input_high", m),
        fields.box(own, name, "start_low", "start_high", d),
        noise,
        tuple(envelopes),
        scale,
        np.zeros((d, 0)) if shared is None else fields.matrix(shared, f"{name}.shared_noise", d),
        _angles(own, name, states),
        *others,
    )


def _angles(own: dict[str, Any], name: str, states: tuple[str, ...]) -> tuple[str, ...]:
    """Return the states that wrap, whose workspaces are one turn."""
    angles = fields.names(own.get("angles", []), f"{name}.angles")
    for angle in angles:
        if angle not in states:
            raise Unreadable(f"{name}.angles: `{angle}` is no state")
        low, high = (own[key][states.index(angle)] for key in ("state_low", "state_high"))
        if not TURN - 1e-13 <= high - low <= TURN or abs(low) > 7.0:
            raise Unreadable(f"{name}: the workspace of the angle `{angle}` is not one turn")
    return angles


def _numbers(value: Any, place: str, read: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise fields.expected(place, "a table", value)
    return {fields.name(key, place): read(entry, f"{place}.{key}") for key, entry in value.items()}


def _ends(value: Any, place: str) -> tuple[float, float]:
    low, high = fields.vector(value, place, 2).tolist()
    if low > high:
        raise Unreadable(f"{place}: its lower end is above its upper end")
    return low, high


def _workspace(own: dict[str, Any], name: str, d: int) -> Array:
    ends = fields.box(own, name, "state_low", "state_high", d)
    if np.any(ends[0] >= ends[1]):
        raise Unreadable(f"{name}: its workspace is flat")
    return ends


def _trees(value: Any, place: str, names: tuple[str, ...], parameters: dict[str, float]) -> tuple[Tree, ...]:
    def read(text: Any, at: str) -> Tree:
        try:
            return read_expression(text, names, parameters)
        except ValueError as error:
            raise Unreadable(f"{at}: {error}") from error

    return tuple(fields.each(value, place, read))


def _dynamics(
    own: dict[str, Any],
    name: str,
    states: tuple[str, ...],
    inputs: tuple[str, ...],
    readable: tuple[str, ...],
    parameters: dict[str, float],
) -> tuple[Tree, ...]:
    """Return the means of the next state as trees: texts as they are, or the rows of A x + B u + c."""
    d = len(states)
    if "dynamics" in own and not {"A", "B", "c"} & set(own):
        trees = _trees(own["dynamics"], f"{name}.dynamics", readable, parameters)
        if len(trees) != d:
            raise Unreadable(f"{name}.dynamics: expected {d} expressions, got {len(trees)}")
        return trees
    if "dynamics" in own or not {"A", "B", "c"} <= set(own):
        raise Unreadable(f"{name}: expected either `dynamics`, or `A`, `B` and `c`")
    A = fields.matrix(own["A"], f"{name}.A", d, d)
    B = fields.matrix(own["B"], f"{name}.B", d, len(inputs))
    c = fields.vector(own["c"], f"{name}.c", d)
    return tuple(affine((*A[k], *B[k]), (*states, *inputs), c[k]) for k in range(d))


# Propositions and the task.


def _region(value: Any, place: str, agents: tuple[Agent, ...], horizon: int) -> Region:
    own = fields.table(value, place, ("name", "agent", "low", "high"))
    agent = fields.whole(own["agent"], f"{place}.agent", 0, len(agents))
    low, high = _corners(own, place, horizon, len(agents[agent].outputs))
    return Region(fields.name(own["name"], f"{place}.name"), agent, low, high)


def _corners(own: dict[str, Any], place: str, horizon: int, count: int) -> tuple[Array, Array]:
    low = fields.over_time(own["low"], f"{place}.low", horizon, count, -np.inf)
    return low, fields.over_time(own["high"], f"{place}.high", horizon, count, np.inf)


def _pair(value: Any, place: str, agents: tuple[Agent, ...], horizon: int) -> Pair:
    own = fields.table(value, place, ("name", "agents", "outputs"), ("low", "high", "radius"))
    first, second = fields.each(own["agents"], f"{place}.agents", lambda i, at: fields.whole(i, at, 0, len(agents)), 2)
    if first == second:
        raise Unreadable(f"{place}.agents: one agent stands there twice")
    # Outputs are compared in order, as many of either agent.
    axes = fields.each(own["outputs"], f"{place}.outputs", lambda numbers, _: numbers, 2)
    outputs = _axes(axes[0], place, agents[first]), _axes(axes[1], place, agents[second])
    count = len(outputs[0])
    if not count or len(outputs[1]) != count:
        raise Unreadable(f"{place}.outputs: expected as many outputs of either agent")
    name = fields.name(own["name"], f"{place}.name")
    if ("radius" in own) == ("low" in own) or ("low" in own) != ("high" in own):
        raise Unreadable(f"{place}: expected either `radius`, or `low` and `high`")
    if "radius" in own:
        radius = own["radius"] if isinstance(own["radius"], list) else [own["radius"]] * (horizon + 1)
        radii = fields.vector(radius, f"{place}.radius", horizon + 1)
        unlimited = np.full((horizon + 1, count), np.inf)
        return Pair(name, (first, second), outputs, -unlimited, unlimited, radii)
    return Pair(name, (first, second), outputs, *_corners(own, place, horizon, count), None)


def _axes(value: Any, place: str, agent: Agent) -> tuple[int, ...]:
    return tuple(fields.each(value, place, lambda k, at: fields.whole(k, at, 0, len(agent.outputs))))


def _automaton(task: dict[str, Any], names: tuple[str, ...]) -> Automaton:
    place = "problem.task.automaton"
    keys = "initial", "accepting", "root", "variable", "low", "high"
    own = fields.table(task["automaton"], place, keys)

    def entries(key: str) -> tuple[int, ...]:
        return tuple(fields.each(own[key], f"{place}.{key}", lambda k, at: fields.whole(k, at, -(2**31), 2**31)))

    def truth(value: Any, at: str) -> bool:
        if type(value) is not bool:
            raise fields.expected(at, "true or false", value)
        return value

    try:
        return Automaton(
            names,
            fields.text(task["semantics"], "problem.task.semantics"),
            fields.whole(own["initial"], f"{place}.initial", 0, 2**31),
            tuple(fields.each(own["accepting"], f"{place}.accepting", truth)),
            *(entries(key) for key in keys[2:]),
        )
    except Unreadable:
        raise
    except ValueError as error:
        raise Unreadable(f"{place}: {error}") from error
