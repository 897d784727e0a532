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
from functools import cached_property, partial
from itertools import accumulate
from typing import Any

import numpy as np

from .automaton import Automaton
from .distributions import NORMAL, Envelope, read_distribution
from .expressions import Tree, affine, read_expression
from .fields import Entry, box, distinct
from .formula import Formula, parse
from .rigorous import Array

Trees = tuple[Tree, ...]

MOST_STATES, MOST_STEPS = 5000, 100_000  # states of all agents together, and control steps


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
    dynamics: Trees
    outputs: Trees
    state_box: Array
    input_box: Array
    start: Array
    noise: Array
    envelopes: tuple[Envelope, ...]
    scale: Trees
    shared_noise: Array
    angles: tuple[str, ...]
    states_of_others: dict[str, tuple[int, int]]
    inputs_of_others: dict[str, tuple[int, int]]

    @property
    def angle_outputs(self) -> list[int]:
        """Return the outputs that are angles themselves."""
        return [k for k, tree in enumerate(self.outputs) if tree in self.angles]


@dataclass(frozen=True, eq=False)
class Proposition:
    """About outputs of one agent (a *region*), or their differences from as many of another one (a *pair*).

    Corners (T + 1, p) are infinite where there is no limit; or there are radii (T + 1,).
    """

    name: str
    agents: tuple[int, ...]
    outputs: tuple[tuple[int, ...], ...]
    low: Array
    high: Array
    radius: Array | None


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything that a claim is about."""

    horizon: int
    agents: tuple[Agent, ...]
    regions: tuple[Proposition, ...]
    pairs: tuple[Proposition, ...]
    automaton: Automaton
    formula: Formula | None
    """None where the automaton itself is the task."""

    @cached_property
    def slices(self) -> list[slice]:
        """Where the states of each agent are in the joint state."""
        return _one_after_the_other([len(agent.states) for agent in self.agents])

    @cached_property
    def input_slices(self) -> list[slice]:
        """Where the inputs of each agent are in the joint input."""
        return _one_after_the_other([len(agent.inputs) for agent in self.agents])

    @cached_property
    def noise(self) -> Array:
        """The factor L (D, W) of the noise of the joint state, before it is scaled.

        Sources stand agent by agent, in deviations of what is above them, then come the shared ones.
        """
        sources = _one_after_the_other([agent.noise.shape[1] for agent in self.agents])
        shared = sources[-1].stop
        factor = np.zeros((self.slices[-1].stop, shared + self.agents[0].shared_noise.shape[1]))
        for agent, here, own in zip(self.agents, self.slices, sources, strict=True):
            factor[here, own] = agent.noise * np.array([envelope.deviation for envelope in agent.envelopes])
            factor[here, shared:] = agent.shared_noise
        return factor


def _one_after_the_other(counts: list[int]) -> list[slice]:
    first = [0, *accumulate(counts)]
    return [slice(a, b) for a, b in zip(first, first[1:])]


def read_problem(header: dict[str, Any]) -> Problem:
    """Return the problem in the header of a file; raise ``Unreadable`` if it is not in canonical form."""
    own = Entry(header["problem"], "problem").table(("horizon", "agents", "regions", "pairs", "task"))
    horizon = own["horizon"].whole(1, MOST_STEPS)
    agents = _read_agents(own["agents"])
    regions = tuple(_region(entry, agents, horizon) for entry in own["regions"].entries())
    pairs = tuple(_pair(entry, agents, horizon) for entry in own["pairs"].entries())
    # Propositions are numbered: regions first, then pairs.
    names = tuple(own.name for own in (*regions, *pairs))
    distinct(names, "problem.regions")
    task = own["task"].table(("semantics", "automaton"), ("formula",))
    automaton, asked = _automaton(task, names), task.get("formula")
    formula = None if asked is None else asked.made(partial(parse, asked.text()))
    return Problem(horizon, agents, regions, pairs, automaton, formula)


TURN = 6.283185307179586  # the double below a turn
REQUIRED = (
    "name", "states", "inputs", "outputs", "state_low", "state_high", "input_low", "input_high", "start_low",
    "start_high", "noise",
)  # fmt: skip
OPTIONAL = (
    "dynamics", "A", "B", "c", "disturbances", "parameters", "shared_noise", "distributions", "noise_scale", "angles",
)  # fmt: skip
STANDARD = Envelope(0.0, 0.0, 1.0, NORMAL)  # noise is standard normal unless a file says otherwise


def _read_agents(entry: Entry) -> tuple[Agent, ...]:
    tables = [own.table(REQUIRED, OPTIONAL) for own in entry.entries()]
    # Names of all states and inputs come first: dynamics may name those of agents that follow.
    names = tuple(own["name"].name() for own in tables)
    distinct(names, entry.place)
    variables = [(own["states"].names(), own["inputs"].names()) for own in tables]
    counts = [len(states) for states, _ in variables]
    if not 0 < sum(counts) <= MOST_STATES or not all(counts):
        raise entry.wrong(f"there is an agent, every one has a state, and all together at most {MOST_STATES}")
    agents = tuple(_agent(i, own, names, variables) for i, own in enumerate(tables))
    if len({agent.shared_noise.shape[1] for agent in agents}) > 1:
        raise entry.wrong("`shared_noise` has different numbers of columns")
    return agents


def _agent(i: int, own: dict[str, Entry], names: tuple[str, ...], variables: list[Any]) -> Agent:
    states, inputs = variables[i]
    d = len(states)
    disturbances = {key: (*entry.vector(2).tolist(),) for key, entry in _numbers(own, "disturbances").items()}
    if any(low > high for low, high in disturbances.values()):
        raise own["disturbances"].wrong("the lower end of one is above its upper end")
    parameters = {key: entry.number() for key, entry in _numbers(own, "parameters").items()}
    local = (*states, *inputs, *disturbances)
    distinct(local, own["name"].place)
    # Dotted names: which state or input of which agent they are.
    others: tuple[dict[str, tuple[int, int]], ...] = {}, {}
    for j, name in enumerate(names):
        for found, own_names in zip(others, variables[j] if j != i else ()):
            found.update({f"{name}.{key}": (j, k) for k, key in enumerate(own_names)})
    if others[0].keys() & others[1].keys():
        raise own["name"].wrong("a name of another agent stands for two things")
    # `t` is the time unless the agent has something of this name.
    timed = local if "t" in (*local, *parameters) else (*local, "t")
    # Noise: factors, distributions of what they multiply, and scales.
    noise = own["noise"].matrix(d)
    shared = own["shared_noise"].matrix(d) if "shared_noise" in own else np.zeros((d, 0))
    envelopes, scale = [STANDARD] * noise.shape[1], Trees()
    if "distributions" in own:
        envelopes = [read_distribution(entry) for entry in own["distributions"].entries(len(envelopes))]
    if "noise_scale" in own and own["noise_scale"].value != []:
        scale = _trees(own["noise_scale"], timed, parameters, d)
    workspace = box(own, "state_low", "state_high", d)
    if np.any(workspace[0] >= workspace[1]):
        raise own["state_low"].wrong("the workspace is flat")
    dynamics = _dynamics(own, (*states, *inputs), (*timed, *others[0], *others[1]), parameters, d)
    outputs, angles = _trees(own["outputs"], states, parameters), _angles(own, states, workspace)
    input_box, start = box(own, "input_low", "input_high", len(inputs)), box(own, "start_low", "start_high", d)
    return Agent(
        names[i], states, inputs, disturbances, dynamics, outputs, workspace, input_box, start,
        noise, tuple(envelopes), scale, shared, angles, *others,
    )  # fmt: skip


def _numbers(own: dict[str, Entry], key: str) -> dict[str, Entry]:
    """Return the entries of a table from names, if there is one."""
    found = own[key].entries_by_name() if key in own else {}
    return {Entry(name, own[key].place).name(): entry for name, entry in found.items()}


def _angles(own: dict[str, Entry], states: tuple[str, ...], workspace: Array) -> tuple[str, ...]:
    """Return the states that wrap, whose workspaces are one turn."""
    angles = own["angles"].names() if "angles" in own else ()
    for angle in angles:
        if angle not in states:
            raise own["angles"].wrong(f"`{angle}` is no state")
        low, high = workspace[:, states.index(angle)].tolist()
        if not TURN - 1e-13 <= high - low <= TURN or abs(low) > 7.0:
            raise own["angles"].wrong(f"the workspace of `{angle}` is not one turn")
    return angles


def _trees(entry: Entry, names: tuple[str, ...], numbers: dict[str, float], count: int | None = None) -> Trees:
    """Return the trees of a list of texts in these names."""
    return tuple(own.made(partial(read_expression, own.value, names, numbers)) for own in entry.entries(count))


def _dynamics(
    own: dict[str, Entry], moved: tuple[str, ...], readable: tuple[str, ...], numbers: dict[str, float], d: int
) -> Trees:
    """Return the means of the next state as trees: texts as they are, or the rows of A x + B u + c."""
    given = {"dynamics", "A", "B", "c"} & own.keys()
    if given == {"dynamics"}:
        return _trees(own["dynamics"], readable, numbers, d)
    if given != {"A", "B", "c"}:
        raise own["name"].wrong("expected either `dynamics`, or `A`, `B` and `c`")
    A, B, c = own["A"].matrix(d, d), own["B"].matrix(d, len(moved) - d), own["c"].vector(d)
    return tuple(affine((*A[k], *B[k]), moved, c[k]) for k in range(d))


def _region(entry: Entry, agents: tuple[Agent, ...], horizon: int) -> Proposition:
    own = entry.table(("name", "agent", "low", "high"))
    agent = own["agent"].whole(0, len(agents))
    outputs = tuple(range(len(agents[agent].outputs)))
    return Proposition(own["name"].name(), (agent,), (outputs,), *_corners(own, horizon, len(outputs)), None)


def _corners(own: dict[str, Entry], horizon: int, count: int) -> tuple[Array, Array]:
    return own["low"].over_time(horizon, count, -np.inf), own["high"].over_time(horizon, count, np.inf)


def _pair(entry: Entry, agents: tuple[Agent, ...], horizon: int) -> Proposition:
    own = entry.table(("name", "agents", "outputs"), ("low", "high", "radius"))
    first, second = own["agents"].wholes(0, len(agents), 2)
    if first == second:  # nothing is said of one agent and itself
        raise own["agents"].wrong("one agent stands there twice")
    # Outputs are compared in order, as many of either agent.
    a, b = own["outputs"].entries(2)
    outputs = a.wholes(0, len(agents[first].outputs)), b.wholes(0, len(agents[second].outputs))
    count = len(outputs[0])
    if not count or len(outputs[1]) != count:
        raise own["outputs"].wrong("expected as many outputs of either agent")
    if ("radius" in own) == ("low" in own) or ("low" in own) != ("high" in own):
        raise entry.wrong("expected either `radius`, or `low` and `high`")
    name, pair = own["name"].name(), (first, second)
    if "radius" not in own:
        return Proposition(name, pair, outputs, *_corners(own, horizon, count), None)
    # A radius for all times, or one for each.
    radius, unlimited = own["radius"], np.full((horizon + 1, count), np.inf)
    radii = radius.vector(horizon + 1) if isinstance(radius.value, list) else np.full(horizon + 1, radius.number())
    return Proposition(name, pair, outputs, -unlimited, unlimited, radii)


def _automaton(task: dict[str, Entry], names: tuple[str, ...]) -> Automaton:
    own = task["automaton"].table(("initial", "accepting", "root", "variable", "low", "high"))
    semantics, initial = task["semantics"].text(), own["initial"].whole(0, 2**31)
    accepting = tuple(entry.truth() for entry in own["accepting"].entries())
    diagrams = [own[key].wholes(-(2**31), 2**31) for key in ("root", "variable", "low", "high")]
    return task["automaton"].made(partial(Automaton, names, semantics, initial, accepting, *diagrams))
