"""Which state of an agent says where it points on a map: pictures draw such an agent as an arrow.

Nothing that is certified depends on it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from ...systems.agents import Agent
from ...systems.expressions import Name, Operation, Tree
from .shapes import Shape


def heading_of(agent: Any, across: int | None, up: int | None, shapes: Iterable[Shape]) -> int | None:
    """Return the state that is the heading of an agent, None if none is, or several may be.

    It is the one state that the agent names as an angle; else the one of which a region is a `heading`; else the one
    whose cosine moves the state `across` the map, and whose sine moves the state `up` it.

    Parameters
    ----------
    agent : Agent or LinearAgent
    across, up : int or None
        States that are the axes of the map; None for axes that are no states. They are no headings.
    shapes : iterable of Shape
        The shapes of the agent's regions.

    Examples
    --------
    >>> car = Agent(
    ...     name="car", states=["x", "y", "theta"], inputs=["turn"],
    ...     dynamics=["x + 0.1*cos(theta)", "y + 0.1*sin(theta)", "theta + turn"],
    ...     noise=[{"law": "gaussian", "std": 0.1}] * 3,
    ...     state_low=[-4, -4, -4], state_high=[4, 4, 4], input_low=[-1], input_high=[1],
    ... )
    >>> heading_of(car, 0, 1, []), heading_of(car, 1, 0, []), heading_of(car, 0, 2, [])
    (2, None, None)
    """
    if not isinstance(agent, Agent):
        return None
    named = {agent.states.index(name) for name in agent.angles}
    asked = {_state(agent, of) for shape in shapes for of in _asked(shape.key, shape.data)}
    for found in (named, asked, _driving(agent, across, up)):
        if len(found) == 1 and not found & {across, up}:
            return found.pop()
    return None


def _asked(key: str, data: Any) -> Iterator[Any]:
    """Yield the states of which headings are asked for in a shape, as they are written."""
    if key == "heading":
        yield data["of"]
    if key not in ("union", "intersection", "complement"):
        return
    # Parts that are names of other regions are among the shapes themselves.
    for part in data if isinstance(data, list | tuple) else [data]:
        for inner, table in part.items() if isinstance(part, Mapping) else ():
            yield from _asked(inner, table)


def _state(agent: Agent, of: Any) -> int:
    """Return the number of a state that is written as its name, its number, or a list of one of them."""
    (state,) = of if isinstance(of, Sequence) and not isinstance(of, str) else (of,)
    return agent.states.index(state) if isinstance(state, str) else int(state)


def _driving(agent: Agent, across: int | None, up: int | None) -> set[int]:
    """Return the states whose cosine moves one state, and whose sine moves another one."""
    if across is None or up is None:
        return set()
    trees = agent.timed_trees
    both = _under("cos", trees[across]) & _under("sin", trees[up])
    return {k for k, name in enumerate(agent.states) if name in both}


def _under(function: str, tree: Tree) -> set[str]:
    """Return the names of which a tree has the value of a function."""
    if not isinstance(tree, Operation):
        return set()
    here = {tree.arguments[0].name} if tree.name == function and isinstance(tree.arguments[0], Name) else set()
    return here.union(*(_under(function, argument) for argument in tree.arguments))
