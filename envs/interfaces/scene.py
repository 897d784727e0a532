"""The scene of a problem: panels, the curves in them and the regions behind them. It holds data and draws nothing.

An agent is shown by the output axes that its regions restrict, at most two of them: one axis gives a track over time,
two axes give a point on a map. Scalar agents named `x_S` and `y_S` are the two coordinates of one robot S and share a
map. Agents share a panel if their panels would have the same axes and the same regions; on maps, equal axes suffice,
and agents of different workspaces share one if a proposition is about both. A region that moves is a region for each
time at which it holds anything. Each has the role that the task gives it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..systems.agents import AnyAgent, Box, LinearAgent
from ..systems.expressions import names_in
from ..tasks.automata import Formula
from ..tasks.problem import Problem
from ..tasks.regions import Pair, Proposition, heading_of
from .outlines import Drawer, Outline, limited_outputs
from .task_roles import FREE, roles

MOST_STRETCHED = 3.0
"""Ratio of the sides of a map up to which both axes have one scale; beyond it the map would be a strip."""

MOST_PLACES = 8
"""Times at which a region that moves is drawn in one picture of a map."""


_ARROW = np.array([(1.0, 0.0), (-0.7, 0.6), (-0.4, 0.0), (-0.7, -0.6)])
"""Corners of an arrow that points along the first axis."""


SIDE = ", from the side"
"""What ends names of agents in second views."""

_CAR = [(1.0, 0.3), (0.8, 0.48), (-0.8, 0.48), (-0.95, 0.35), (-0.95, -0.35), (-0.8, -0.48), (0.8, -0.48), (1.0, -0.3)]
_WINDOW = [(0.45, 0.34), (0.12, 0.38), (0.12, -0.38), (0.45, -0.34)]
_ROUND = [(np.cos(a), np.sin(a)) for a in np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)]
_FIGURES = {
    "car": [(_CAR, True), (_WINDOW, False)],
    "drone": [
        *(([(0.7, 0.55 * s), (0.55, 0.7 * s), (-0.7, -0.55 * s), (-0.55, -0.7 * s)], True) for s in (1, -1)),
        *(([(0.62 * i + 0.4 * x, 0.62 * j + 0.4 * y) for x, y in _ROUND], True) for i in (1, -1) for j in (1, -1)),
        ([(0.4 * x, 0.4 * y) for x, y in _ROUND], True),
        ([(0.35, 0.0), (0.0, 0.25), (0.0, -0.25)], False),
    ],
    "robot": [
        ([(0.8 * x, 0.8 * y) for x, y in _ROUND], True),
        ([(0.75, 0.0), (0.1, 0.4), (0.25, 0.0), (0.1, -0.4)], False),
    ],
}
_WORDS = {
    "robot": "robot|rover|vacuum",
    "car": "car|truck|bus|vehicle|trailer|lift|agv|bicycle|rig",
    "drone": "drone|quad|copter|uav|rotor|hover",
}


def figure(names: Sequence[str], angle: float) -> list[tuple[np.ndarray, bool]]:
    """Return an agent as it looks from above, by its names: polygons (n, 2) about the origin, and which are its body.

    Others stand out from it. The first name with a word for robots, cars or drones tells; without any it is a robot.
    """
    kinds = (kind for name in names for kind, words in _WORDS.items() if re.search(words, name.lower()))
    turns = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return [(np.array(corners) @ turns, is_body) for corners, is_body in _FIGURES[next(kinds, "robot")]]


@dataclass(frozen=True, eq=False)
class Region:
    """A box behind the curves of a panel: its name, or that of its family, and its corners on the panel's axes.

    One that moves has the `time` at which it is there; None for regions that stand still. One that is no box on a map
    has its `outline`, and the corners are those of the box around it. The `role` is what the task asks of it (see
    `task_roles`).
    """

    name: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    time: int | None = None
    outline: Outline | None = None
    role: str = FREE

    @property
    def polygons(self) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
        """What to fill on a map, and the edges: closed polygons (n, 2)."""
        if self.outline is not None:
            return self.outline.fill, self.outline.edges
        (a, c), (b, d) = self.low, self.high
        box = (np.array([(a, c), (b, c), (b, d), (a, d)]),)
        return box, box

    def span(self, horizon: int) -> tuple[float, float]:
        """Return from when to when it is drawn in a track over time: half a step around its time, or always."""
        if self.time is None:
            return 0.0, float(horizon)
        return max(0.0, self.time - 0.5), min(float(horizon), self.time + 0.5)


@dataclass(frozen=True, eq=False)
class Curve:
    """The curve of one agent, or of one robot made of two agents.

    Attributes
    ----------
    name : str
    number : int
        Position among all curves, which selects the colour.
    rows : np.ndarray, shape (k, D)
        Rows that turn a joint state into the k coordinates shown.
    heading : int, optional
        Position in the joint state of the angle, counted from the first axis of the map, at which the agent points.
    """

    name: str
    number: int
    rows: np.ndarray
    heading: int | None = None

    def arrow(self, state: np.ndarray) -> np.ndarray | None:
        """Return the corners (4, 2) of an arrow of length about 1 at the origin, y upwards; None without a heading."""
        if self.heading is None or not np.isfinite(angle := float(state[self.heading])):
            return None
        turns = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        return _ARROW @ turns


@dataclass(frozen=True, eq=False)
class Panel:
    """Axes with one coordinate over time, or two on a map: their limits, regions, curves, and what they are called."""

    low: tuple[float, ...]
    high: tuple[float, ...]
    regions: tuple[Region, ...]
    curves: tuple[Curve, ...]
    names: tuple[str, ...]
    has_angles: bool = False
    """Whether an axis shows an angle: it has no scale in common with a length."""

    @property
    def is_map(self) -> bool:
        """Whether both axes are coordinates."""
        return len(self.low) == 2

    @property
    def proportion(self) -> float | None:
        """Height by width of a map whose axes have one scale.

        None if one axis is much longer than the other or shows an angle, and for tracks over time.
        """
        if not self.is_map or self.has_angles:
            return None
        across, up = (float(b - a) for a, b in zip(self.low, self.high))
        return up / across if 1.0 / MOST_STRETCHED <= up / across <= MOST_STRETCHED else None

    def shows(self, axes: Sequence[int]) -> bool:
        """Return whether this is a map whose axes are two joint coordinates: those of one of its curves."""
        return self.is_map and any(
            all(np.count_nonzero(row) == 1 and row[k] == 1.0 for row, k in zip(curve.rows, axes))
            for curve in self.curves
            if len(axes) == len(curve.rows)
        )

    @property
    def drawn(self) -> tuple[Region, ...]:
        """The regions of a picture of all times: on a map those that move at a few of them, so that they are told."""
        times = sorted({region.time for region in self.regions if region.time is not None})
        if not self.is_map or len(times) <= MOST_PLACES:
            return self.regions
        shown = {times[round(k)] for k in np.linspace(0, len(times) - 1, MOST_PLACES)}
        return tuple(region for region in self.regions if region.time is None or region.time in shown)

    def is_crowded(self, horizon: int) -> bool:
        """Whether the regions, one by one, cover more than the panel: their hatches would hide the curves."""
        across = self.high[0] - self.low[0] if self.is_map else float(horizon)
        whole, areas = across * (self.high[-1] - self.low[-1]), 0.0
        for region in self.drawn:
            first, last = (region.low[0], region.high[0]) if self.is_map else region.span(horizon)
            areas += (last - first) * (region.high[-1] - region.low[-1])
        return areas > whole

    @property
    def named(self) -> tuple[Region, ...]:
        """The regions whose names are written: of one that moves only the first."""
        first: dict[str, Region] = {}
        for region in self.regions:
            if region.time is not None:
                first.setdefault(region.name, region)
        return tuple(r for r in self.regions if r.time is None or first[r.name] is r)


@dataclass(frozen=True, eq=False)
class _Shown:
    """An agent or robot before it is given a panel."""

    curve: Curve
    box: Box
    regions: tuple[Region, ...]


def panels(problem: Problem) -> tuple[Panel, ...]:
    """Return the panels of a problem, in the order in which its agents first appear."""
    shown: dict[str, _Shown] = {}
    # Two scalar agents x_S and y_S become one robot; the first of them waits under its name.
    pairs = {name for name in problem.agent_names if name.startswith("x_") and f"y_{name[2:]}" in problem.agent_names}
    for i, agent in enumerate(problem.agents):
        single = _pointing(problem, i, _agent(problem, i, len(shown)))
        robot = agent.name[2:]
        if agent.name.startswith(("x_", "y_")) and f"x_{robot}" in pairs and len(single.box.low) == 1:
            key = f"robot {robot}"
            shown[key] = _robot(key, shown[key], single) if key in shown else single
        else:
            shown[agent.name] = single
    for i, agent in enumerate(problem.agents):
        if agent.name in shown and (beside := _from_the_side(problem, i, shown[agent.name])) is not None:
            shown[agent.name + SIDE] = beside
    # Over time, a panel also needs equal regions: bands of different agents could not be told apart.
    groups: dict[object, list[_Shown]] = {}
    for key, item in shown.items():
        like = len(item.box.low) == 2 or _signature(item.regions)
        axes = (tuple(item.box.low), tuple(item.box.high), like, key.endswith(SIDE))
        groups.setdefault(axes, []).append(item)
    told = roles(problem)
    return tuple(_panel(problem, group, told) for group in _with_pairs(problem, list(groups.values())))


def _pointing(problem: Problem, i: int, item: _Shown) -> _Shown:
    """Return an agent with its heading, if it is on a map of other states."""
    if len(item.box.low) != 2:
        return item
    columns = problem.columns[i]
    own = item.curve.rows[:, columns]
    across, up = (int(np.argmax(row)) if np.count_nonzero(row) == 1 and row.max() == 1.0 else None for row in own)
    regions = [p for p in problem.written.values() if isinstance(p, Proposition)]
    shapes = [p.shape for p in regions if p.agent == problem.agents[i].name and p.shape is not None]
    heading = heading_of(problem.agents[i], across, up, shapes)
    if heading is None or np.any(own[:, heading]):
        return item
    return replace(item, curve=replace(item.curve, heading=columns.start + heading))


def _with_pairs(problem: Problem, groups: list[list[_Shown]]) -> list[list[_Shown]]:
    """Return the groups, those on maps joined whose agents some proposition is about: they are seen side by side."""
    of = {item.curve.name: k for k, group in enumerate(groups) for item in group if len(item.box.low) == 2}
    for about in problem.propositions.values():
        if isinstance(about, Pair) and all(agent in of for agent in about.agents):
            first, other = sorted(of[agent] for agent in about.agents)
            if first != other:
                groups[first] += groups[other]
                groups[other] = []
                of |= {item.curve.name: first for item in groups[first]}
    return [group for group in groups if group]


def _panel(problem: Problem, group: list[_Shown], told: Mapping[str, str]) -> Panel:
    """Return the panel of agents that share one; equal regions are drawn once, with their roles."""
    regions = {
        (r.name, r.low, r.high, r.time, _edges(r)): replace(r, role=told[r.name])
        for item in group
        for r in item.regions
    }
    return Panel(
        low=tuple(map(float, np.min([item.box.low for item in group], axis=0))),
        high=tuple(map(float, np.max([item.box.high for item in group], axis=0))),
        regions=tuple(regions.values()),
        curves=tuple(item.curve for item in group),
        names=_axis_names(problem, [item.curve.rows for item in group]),
        has_angles=any(_shows_angle(problem, row) for item in group for row in item.curve.rows),
    )


def _axis_names(problem: Problem, rows: list[np.ndarray]) -> tuple[str, ...]:
    """Return what the axes of a panel are called: as its agents call what they show, if all of them say the same."""
    of_agents = [[_state_name(problem, row) for row in own] for own in rows]
    unnamed = ("first coordinate", "second coordinate") if len(rows[0]) == 2 else ("position",)
    shared = [{*names} for names in zip(*of_agents)]
    return tuple(min(own) if len(own) == 1 and own != {""} else other for own, other in zip(shared, unnamed))


def _shows_angle(problem: Problem, row: np.ndarray) -> bool:
    """Return whether an axis shows a state that is an angle."""
    agent, state = _place(problem, int(np.argmax(row != 0.0)))
    return bool(agent.state_names) and agent.state_names[state] in agent.angles


def _state_name(problem: Problem, row: np.ndarray) -> str:
    """Return the name of the one state that an axis shows; "" where it shows more or agents have no names for them."""
    shown = np.flatnonzero(row)
    if len(shown) != 1 or row[shown[0]] != 1.0:
        return ""
    agent, state = _place(problem, int(shown[0]))
    return agent.state_names[state] if agent.state_names else ""


def _edges(region: Region) -> bytes:
    return b"" if region.outline is None else b"".join(edge.tobytes() for edge in region.outline.edges)


def _signature(regions: tuple[Region, ...]) -> tuple[object, ...]:
    return tuple(sorted((r.name, r.low, r.high, -1 if r.time is None else r.time) for r in regions))


def _from_the_side(problem: Problem, i: int, item: _Shown) -> _Shown | None:
    """Return an agent on the first and the third axis, where regions restrict three that are places; None elsewhere.

    States that move the first two are no places, but velocities and headings, and angles are none, either.
    """
    agent, columns = problem.agents[i], problem.columns[i]
    own = item.curve.rows[:, columns]
    if len(own) != 2 or any(np.count_nonzero(row) != 1 for row in own):
        return None
    first = [int(np.argmax(row)) for row in own]
    third = [k for k in _restricted_states(problem, i, agent.n_states) if k not in first]
    moved_by = {name for k in first for name in names_in(agent.timed_trees[k])}
    third = [k for k in third if not agent.wrapped_axes[k] and agent.states[k] not in moved_by]
    third = [k for k in third if item.curve.heading != columns.start + k]
    return _agent(problem, i, item.curve.number, (first[0], third[0])) if third else None


def _agent(problem: Problem, i: int, number: int, seen: tuple[int, int] | None = None) -> _Shown:
    """Return one agent on the axes that its regions restrict, or on two of its states."""
    agent = problem.agents[i]
    shapes = (isinstance(p, Proposition) and p.agent == agent.name and p.shape for p in problem.written.values())
    if not agent.has_straight_outputs or any(shapes) or seen is not None:
        return _shaped(problem, i, number, seen)
    # Regions carry the name of their family, so that all agents' regions of one family share a colour.
    low, high = _output_box(agent)
    families = {member: family for family, members in problem.families.items() for member in members}
    of_agents = {n: p for n, p in problem.propositions.items() if isinstance(p, Proposition)}
    named = [(families.get(n, n), p) for n, p in of_agents.items() if p.agent == agent.name]
    placed = [(name, *place) for name, p in named for place in _places(p, problem.horizon)]
    # Show the first two axes on which some region is smaller than the workspace; the first two at all if none is.
    restricted = np.zeros(agent.n_outputs, dtype=bool)
    for _, _, least, most in placed:
        restricted |= (least > low) | (most < high)
    axes = np.flatnonzero(restricted)[:2] if restricted.any() else np.arange(min(2, agent.n_outputs))
    rows = np.zeros((len(axes), problem.n_states))
    for row, axis in zip(rows, axes):
        row[problem.columns[i]] = agent.output_row(int(axis))
    regions = tuple(
        Region(
            name,
            tuple(np.clip(least, low, high)[axes].tolist()),
            tuple(np.clip(most, low, high)[axes].tolist()),
            time,
        )
        for name, time, least, most in placed
    )
    return _Shown(Curve(agent.name, number, rows), Box(low[axes], high[axes]), regions)


def _shaped(problem: Problem, i: int, number: int, seen: tuple[int, int] | None) -> _Shown:
    """Return an agent on two states, by default the first ones that its regions restrict, whatever its regions are."""
    agent = problem.agents[i]
    own = {n: p for n, p in problem.written.items() if isinstance(p, Proposition) and p.agent == agent.name}
    axes = _restricted_states(problem, i) if seen is None else [*seen]
    low, high = agent.state_low[axes], agent.state_high[axes]
    rows = np.zeros((len(axes), problem.n_states))
    rows[np.arange(len(axes)), problem.columns[i].start + np.array(axes)] = 1.0
    families = {member: family for family, members in problem.families.items() for member in members}
    drawer, regions = Drawer(problem, i, axes, low, high), list[Region]()
    for member in own:
        name = families.get(member, member)
        # What is made of several boxes moves if one of them does.
        boxes = _atoms(problem.meanings[member]) if member in problem.meanings else [member]
        moves = any(problem.propositions[box].moves for box in boxes)
        for time in range(problem.horizon + 1) if moves else (0,):
            when = time if moves else None
            if len(axes) == 1:
                regions += [Region(name, (a,), (b,), when) for a, b in drawer.spans(member, time)]
            elif (outline := drawer.outline(member, time)) is not None:
                least, most = (tuple(map(float, corner)) for corner in outline.corners)
                regions.append(Region(name, least, most, when, outline))
    return _Shown(Curve(agent.name, number, rows), Box(low, high), tuple(regions))


def _restricted_states(problem: Problem, i: int, count: int = 2) -> list[int]:
    """Return the first two states, or more, that regions of an agent restrict."""
    agent = problem.agents[i]
    states = set[int]()
    for name, region in problem.propositions.items():
        if not isinstance(region, Proposition) or region.agent != agent.name:
            continue
        if name in problem.pieces:
            for limit in problem.pieces[name].limits:
                rows = [limit.form.row] if limit.form.row else [row for _, row, _ in limit.form.squares]
                states |= {k for row in rows for k, entry in enumerate(row[: agent.n_states]) if entry}
            continue
        for _, least, most in _places(region, problem.horizon):
            for k in limited_outputs(agent, least, most):
                straight = agent.straight_output(k)
                states |= {0, 1} if straight is None else {*np.flatnonzero(straight[0]).tolist()}
    return sorted(states & {*range(agent.n_states)})[:count] or [*range(min(2, agent.n_states))]


def _atoms(formula: Formula) -> list[str]:
    """Return the propositions of a formula."""
    return [sub.name for sub in formula.subformulas() if sub.operator == "atom"]


def _places(region: Proposition, horizon: int) -> list[tuple[int | None, np.ndarray, np.ndarray]]:
    """Return where a region is: time, lower and upper corner; without the times at which it is empty."""
    if not region.moves:
        return [(None, region.low, region.high)]
    low, high = region.over(np.arange(horizon + 1, dtype=float))
    return [(t, low[:, t], high[:, t]) for t in range(horizon + 1) if np.all(low[:, t] < high[:, t])]


def _robot(name: str, x: _Shown, y: _Shown) -> _Shown:
    """Return two scalar agents as the coordinates of one robot; a region of one of them becomes a band."""
    # A region of x says nothing about y: it reaches over the whole height of the map, and the other way round.
    low, high = np.append(x.box.low, y.box.low), np.append(x.box.high, y.box.high)
    bands = [Region(r.name, (r.low[0], float(low[1])), (r.high[0], float(high[1])), r.time) for r in x.regions]
    bands += [Region(r.name, (float(low[0]), r.low[0]), (float(high[0]), r.high[0]), r.time) for r in y.regions]
    rows = np.concatenate([x.curve.rows, y.curve.rows])
    return _Shown(Curve(name, x.curve.number, rows), Box(low, high), tuple(bands))


def _output_box(agent: AnyAgent) -> tuple[np.ndarray, np.ndarray]:
    """Return the smallest box around the outputs in the workspace (up to rounding)."""
    if not isinstance(agent, LinearAgent):
        return tuple(ends[0] for ends in agent.output_range(agent.state_low[None], agent.state_high[None]))
    ends = np.stack([agent.output_matrix * agent.state_low, agent.output_matrix * agent.state_high])
    return ends.min(axis=0).sum(axis=-1), ends.max(axis=0).sum(axis=-1)


def have_one_scale(problem: Problem, axes: Sequence[int]) -> bool:
    """Return whether two joint coordinates are drawn in one scale: as on the map of an agent, if it is in scale."""
    return any(panel.proportion is not None and panel.shows(axes) for panel in panels(problem))


def coordinate_name(problem: Problem, k: int) -> str:
    """Return the name of coordinate k of the joint state, as expressions write it: `x`, or `car.x` if others are there.

    Agents whose states have no names give their own name, with an index if they have several states.
    """
    agent, state = _place(problem, k)
    if agent.state_names:
        name = agent.state_names[state]
        return name if problem.n_agents == 1 else f"{agent.name}.{name}"
    return agent.name if agent.n_states == 1 else f"{agent.name}[{state}]"


def _place(problem: Problem, k: int) -> tuple[AnyAgent, int]:
    """Return the agent of coordinate k of the joint state, and which of its states it is."""
    for agent, columns in zip(problem.agents, problem.columns):
        if k < columns.stop:
            return agent, k - columns.start
    raise AssertionError("a coordinate beyond the joint state")
