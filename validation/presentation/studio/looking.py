"""What the page shows of a text: its error, and a picture of what can be read of it, while it is not whole, too.

Runs in a process of its own (`work`), as what users write may take long to read.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ....envs.interfaces import AGENTS, Curve, Panel, Region, panels
from ....envs.systems.agents import LinearAgent
from ....envs.tasks.problem import Problem, problem_from_dict, problem_from_toml
from ....envs.tasks.regions import Proposition
from .carets import line_and_column, mark
from .toml_edits import formula_of

MOST_PANELS = 6
"""Panels that are drawn."""

MOST_REGIONS = 40
"""Regions that are tried one by one where the task cannot be read as a whole."""

ANYTHING = {
    "semantics": "finite-trace",
    "states": ["any"],
    "initial": "any",
    "accepting": ["any"],
    "transitions": [["any", "true", "any"]],
}
"""A task that every run satisfies: it stands for one that cannot be read."""

WHOLE = "whole workspace"
"""A region for agents of which there are none yet; nobody sees it."""


def look(text: str, source: str, folder: Path) -> dict[str, Any]:
    """Return what the page shows of a text: ``error`` (None if there is none), ``picture`` (None if nothing can be
    drawn), ``facts`` about the task, and the ``formula``."""
    seen: dict[str, Any] = {"error": None, "picture": None, "facts": None, "formula": "", "fingerprint": None}
    data: Any = None
    problem: Problem | None = None
    try:
        data = tomllib.loads(text)
        seen["formula"] = formula_of(data)
        problem = problem_from_toml(text, source, folder)
        seen["facts"], seen["fingerprint"] = _facts(problem), problem.fingerprint
        if missing := [agent.name for agent in problem.agents if agent.initial_low is None]:
            raise ValueError(f"{source}: `initial_state`: expected a start for agent {missing[0]!r}, got none")
    except (ValueError, RecursionError) as error:
        said = str(error) if data is not None else _toml_error(error, text, source, folder)
        seen["error"] = error_in(text, said)
        problem = None if data is None else _as_far_as_it_goes(data, folder)
    if problem is not None:
        seen["picture"] = {"panels": list(_panels(problem, data)), "horizon": problem.horizon}
    return seen


def error_in(text: str, message: str) -> dict[str, Any]:
    """Return an error with the characters that it is about."""
    place = mark(text, message)
    line, column = (None, None) if place is None else line_and_column(text, place[0])
    return {"message": message, "mark": place, "line": line, "column": column}


def _toml_error(error: Exception, text: str, source: str, folder: Path) -> str:
    """Return the error of a text that is no TOML, in the words of the command line."""
    try:
        problem_from_toml(text, source, folder)
    except ValueError as told:
        return str(told)
    return str(error)


def _facts(problem: Problem) -> dict[str, Any]:
    """Return the sizes of a problem."""
    tasks = problem.tasks
    return {
        "name": problem.name,
        "agents": problem.n_agents,
        "horizon": problem.horizon,
        "semantics": problem.specification.semantics,
        "states": [task.automaton.n_states for task in tasks][:3],
        "tasks": len(tasks),
    }


def _as_far_as_it_goes(data: Mapping[str, Any], folder: Path) -> Problem | None:
    """Return the problem of a text without what cannot be read; None if the agents cannot."""
    horizon = data.get("horizon")
    base = {
        "name": "draft",
        "horizon": horizon if isinstance(horizon, int) and 0 < horizon < 1000 else 10,
        "agents": data.get("agents"),
        "specification": ANYTHING,
    }
    named = data.get("propositions")
    written = dict(named) if isinstance(named, Mapping) else {}
    if whole := _read(base, written, folder):
        return whole
    kept: dict[str, Any] = {}
    for name, table in [*written.items()][:MOST_REGIONS]:
        if _read(base, {**kept, name: table}, folder) is not None:
            kept[name] = table
    return _read(base, kept, folder) or _read(base, {WHOLE: _everywhere(data)}, folder)


def _read(base: Mapping[str, Any], propositions: Mapping[str, Any], folder: Path) -> Problem | None:
    try:
        return problem_from_dict({**base, "propositions": dict(propositions)}, folder)
    except (ValueError, RecursionError):
        return None


def _everywhere(data: Mapping[str, Any]) -> Any:
    """Return the whole workspace of the first agent as a region; nonsense if there is none."""
    agents = data.get("agents")
    try:
        name, table = next(iter(agents.items())) if isinstance(agents, Mapping) else (agents[0]["name"], agents[0])  # type: ignore[index]
        own = f"{name}_0" if "copies" in table else name
        return {"agent": own, "box": {"low": table["state_low"], "high": table["state_high"]}}
    except (LookupError, TypeError, StopIteration):
        return {}


# The picture.


def _panels(problem: Problem, data: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield what the page draws of each panel, and what can be moved in it."""
    for panel in panels(problem)[:MOST_PANELS]:
        axes = [_axes_of(problem, curve.rows) for curve in panel.curves]
        yield {
            "map": panel.is_map,
            "low": list(panel.low),
            "high": list(panel.high),
            "names": list(panel.names),
            "proportion": panel.proportion,
            "regions": [_drawn(panel, region) for region in panel.drawn if region.name != WHOLE],
            "curves": [{"name": curve.name, "color": curve.number % len(AGENTS)} for curve in panel.curves],
            "starts": [s for curve, on in zip(panel.curves, axes) for s in _starts(problem, data, curve, on)],
            "shapes": list(_shapes(problem, data, panel, axes)),
            "new": _new(problem, axes),
        }


Axis = tuple[int, int] | None
"""An agent and one of its states, if an axis of a panel is a state."""


def _axes_of(problem: Problem, rows: np.ndarray) -> list[Axis]:
    """Return which states the axes of a curve show."""
    axes = list[Axis]()
    for row in rows:
        (column,) = np.flatnonzero(row)[:1] if np.count_nonzero(row) == 1 and row.max() == 1.0 else (None,)
        i = next((i for i, c in enumerate(problem.columns) if column is not None and c.start <= column < c.stop), -1)
        axes.append(None if column is None or i < 0 else (i, int(column) - problem.columns[i].start))
    return axes


def _state_names(agent: Any) -> list[str]:
    """Return what the states of an agent are called."""
    own = getattr(agent, "states", None)
    if own is not None:
        return list(own)
    return [agent.name] if agent.n_states == 1 else [f"{agent.name}[{k}]" for k in range(agent.n_states)]


def _drawn(panel: Panel, region: Region) -> dict[str, Any]:
    """Return a region as the page draws it: polygons on a map, an interval otherwise."""
    drawn: dict[str, Any] = {"name": region.name, "role": region.role, "time": region.time}
    drawn |= {"low": list(region.low), "high": list(region.high)}
    if panel.is_map:
        fills, edges = region.polygons
        drawn |= {"fills": [f.tolist() for f in fills], "edges": [e.tolist() for e in edges]}
    return drawn


def _tables(data: Mapping[str, Any]) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yield path and table of each agent that the text writes."""
    agents = data.get("agents")
    listed = agents.items() if isinstance(agents, Mapping) else enumerate(agents or [])
    for key, table in listed:
        yield ("agents", key), table


def _source(problem: Problem, data: Mapping[str, Any], i: int) -> tuple[tuple[str | int, ...], Any]:
    """Return path and table of an agent; copies have one together."""
    name, position = problem.agents[i].name, 0
    for path, table in _tables(data):
        copies = table.get("copies", 1)
        if position <= i < position + copies:
            return path, table
        position += copies
    raise AssertionError(f"agent {name} comes from nowhere")


def _starts(problem: Problem, data: Mapping[str, Any], curve: Curve, axes: list[Axis]) -> Iterator[dict[str, Any]]:
    """Yield the start of a curve, and the values of the text that put it there."""
    if any(axis is None for axis in axes):
        return
    known = [axis for axis in axes if axis is not None]
    if any(problem.agents[i].initial_low is None for i, _ in known):
        return
    ends = [
        [float(box[s]) for i, s in known for box in [getattr(problem.agents[i].initial, end)]]
        for end in ("low", "high")
    ]
    values: dict[str, Any] = {}
    for i, _ in known:
        path, table = _source(problem, data, i)
        for key in ("initial_state", "initial_low", "initial_high"):
            if key in table:
                if not _numbers(table[key]):
                    return
                values["/".join(map(str, path))] = values.get("/".join(map(str, path)), {"path": list(path)}) | {
                    key: table[key]
                }
    tables = ["/".join(map(str, _source(problem, data, i)[0])) for i, _ in known]
    yield {
        "agent": problem.agents[known[0][0]].name,
        "color": curve.number % len(AGENTS),
        "heading": _first_heading(problem, known[0][0], curve),
        "low": ends[0],
        "high": ends[1],
        "axes": [[table, s] for table, (_, s) in zip(tables, known)],
        "tables": values,
    }


def _first_heading(problem: Problem, i: int, curve: Curve) -> float | None:
    """Return where an agent points at its start, or in the middle of its box of starts; None if it has no heading."""
    if curve.heading is None:
        return None
    start, state = problem.agents[i].initial, curve.heading - problem.columns[i].start
    return 0.5 * float(start.low[state] + start.high[state])


def _numbers(value: Any) -> bool:
    """Return whether a value is a list of numbers, or of lists of them."""
    if not isinstance(value, list):
        return isinstance(value, int | float) and not isinstance(value, bool)
    return all(map(_numbers, value))


def _shapes(
    problem: Problem, data: Mapping[str, Any], panel: Panel, curves: list[list[Axis]]
) -> Iterator[dict[str, Any]]:
    """Yield the propositions of a panel that can be moved, as they are written, and which of their axes are shown."""
    shown = {axis[0]: (axes, curve) for axes, curve in zip(curves, panel.curves) for axis in axes if axis is not None}
    for name, table in data.get("propositions", {}).items():
        members = problem.families.get(name, (name,))
        member = problem.written.get(members[0])
        if not isinstance(member, Proposition) or not isinstance(table, Mapping):
            continue
        i = problem.agent_names.index(member.agent)
        if i not in shown:
            continue
        for found in _written_shapes(problem.agents[i], i, table, shown[i][0], table.get("of")):
            if found["kind"] == "box" or None not in found["axes"]:
                yield {"name": name, "id": "/".join([name, *map(str, found["at"][:-1])]), **found}


_MOVED = {
    "box": ("low", "high"),
    "disc": ("centre", "radius"),
    "polygon": ("corners",),
    "halfspace": ("normal", "offset"),
    "cone": ("tip", "axis", "angle"),
}
"""Shapes that can be moved, and the numbers that say where they are."""


def _written_shapes(
    agent: Any, i: int, table: Mapping[str, Any], axes: list[Axis], of: Any
) -> Iterator[dict[str, Any]]:
    """Yield the shape of a table, or those of the parts of which it is a union, intersection or complement.

    ``of`` names the states of parts that name none; ``at`` leads from the proposition to the numbers of a shape;
    ``part`` says whether it is one of several.
    """
    found = _shape(agent, i, table, axes, of)
    if found is not None:
        yield {**found, "part": False}
        return
    inner: list[tuple[tuple[str | int, ...], Any]] = [
        ((kind, k), part) for kind in ("union", "intersection") for k, part in enumerate(table.get(kind) or ())
    ]
    inner += [(("complement",), table["complement"])] if "complement" in table else []
    for path, part in inner:
        if isinstance(part, Mapping):
            for shape in _written_shapes(agent, i, part, axes, of):
                yield {**shape, "at": [*path, *shape["at"]], "part": True}


def _shape(agent: Any, i: int, table: Mapping[str, Any], axes: list[Axis], of: Any) -> dict[str, Any] | None:
    """Return kind, numbers and axes of one shape; None if it is not made of numbers that can be moved."""
    if _numbers(table.get("low")) and _numbers(table.get("high")):
        states = None if of is None else _of(agent, of, "box", table)
        outputs = [_output(agent, axis, i) if states is None else _place(states, axis, i) for axis in axes]
        box = {"low": table["low"], "high": table["high"], "at": []}
        return {"kind": "box", "axes": outputs, **box} if any(k is not None for k in outputs) else None
    for kind, keys in _MOVED.items():
        shape = table.get(kind)
        if isinstance(shape, Mapping) and all(_numbers(shape.get(key)) for key in keys):
            if len(shape.get("normal", shape.get("tip", "xy"))) != 2:
                return None  # in space its edge on a panel is not known
            states = _of(agent, shape.get("of", of), kind, shape)
            shown = [_place(states, axis, i) for axis in axes]
            numbers = {key: shape[key] for key in keys}
            return {"kind": kind, "axes": shown, **numbers, "at": [kind]} if any(k is not None for k in shown) else None
    return None


def _of(agent: Any, of: Any, kind: str, shape: Mapping[str, Any]) -> list[int]:
    """Return the states that a shape is about: the first ones unless it names others."""
    if of is None:
        return list(range(len(shape["low"]) if kind == "box" else 2))
    names = list(_state_names(agent))
    # Outputs that are no states are on no axis of a picture.
    return [
        (names.index(state) if state in names else -1) if isinstance(state, str) else int(state)
        for state in (of if isinstance(of, list) else [of])
    ]


def _place(states: list[int], axis: Axis, i: int) -> int | None:
    """Return which of the states that a shape is about is that of an axis."""
    return states.index(axis[1]) if axis is not None and axis[0] == i and axis[1] in states else None


def _output(agent: Any, axis: Axis, i: int) -> int | None:
    """Return the output that is the state of an axis."""
    if axis is None or axis[0] != i:
        return None
    return next((k for k in range(agent.n_outputs) if agent.output_axis(k) == (axis[1], 1.0)), None)


def _new(problem: Problem, curves: list[list[Axis]]) -> list[dict[str, Any]]:
    """Return for which agents regions can be drawn in a panel, and how they are written."""
    offered = []
    for axes in curves:
        known = [axis for axis in axes if axis is not None]
        if len(known) != len(axes) or len({i for i, _ in known}) != 1:
            continue
        i, states = known[0][0], [s for _, s in known]
        agent = problem.agents[i]
        plain = isinstance(agent, LinearAgent) or not getattr(agent, "outputs", None)
        same = plain and agent.n_outputs >= agent.n_states == len(states) and states == list(range(agent.n_states))
        same = same and all(agent.output_axis(k) == (k, 1.0) for k in states)
        offered.append({"agent": agent.name, "states": states, "plain": bool(same), "all": agent.n_states})
    return offered
