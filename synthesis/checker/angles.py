"""Angles along trajectories: states that are the same after a whole turn, which wrap into one turn.

A trajectory has angles that are numbers, and goes on where a turn ends. Its controller applies its feedback to the
error less whole turns: the number nearest to 0 of all that the error stands for.

**Theorem.** Let dynamics, sizes of noise and outputs be those of points of a circle: ``f(x + 2 pi e) = f(x) + 2 pi j``
with whole j, and the same outputs. Then a proof of the agent whose angles are numbers is one of the agent with angles,
if the tube of every angle is within half a turn, where workspaces limit no angle, a region that is to hold is one copy
of its interval, and one that is not to hold, along an angle, is avoided between one copy and the next.

*Proof.* docs/theory/angles.md, Theorem Angles.2.

That f is so is proved by its form: an expression is c times the angle, c a rational number, plus what repeats.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from .expressions import Tree
from .fields import Refused
from .letters import Demand
from .problem import TURN, Problem
from .rigorous import Array

OFF = 1e-13  # what angles are off by at most: where they wrap, where copies are, and where the nearest number is taken
FARTHEST = 200.0  # largest nominal angle: so many turns are off by a tenth of ``OFF`` at most
HALF_TURN = 3.14  # half width of a tube: less than half a turn


def check_angles(problem: Problem) -> None:
    """Raise ``Refused`` unless dynamics, noise and outputs are those of points of a circle."""
    for i, agent in enumerate(problem.agents):
        for angle in agent.angles:
            slopes = {name: _slope(tree, angle) for name, tree in zip(agent.states, agent.dynamics, strict=True)}
            for name, slope in slopes.items():
                if slope is None or slope.denominator != 1 or (slope and name not in agent.angles):
                    raise Refused(f"the dynamics of `{name}` are not the same a turn further on along `{angle}`")
            repeat = [*agent.scale, *(tree for tree in agent.outputs if tree != angle)]
            if any(_slope(tree, angle) != 0 for tree in repeat):
                raise Refused(f"an output, or the noise, is not the same a turn further on along `{angle}`")
            named = f"{agent.name}.{angle}"
            if any(_slope(tree, named) != 0 for other in problem.agents for tree in other.dynamics):
                raise Refused(f"another agent's dynamics are not the same a turn further on along `{named}`")
        compared = {k for pair in problem.pairs for j, axes in zip(pair.agents, pair.outputs) if i == j for k in axes}
        if compared & set(agent.angle_outputs):
            raise Refused(f"a pair compares an angle of `{agent.name}`")


def of_copies(problem: Problem, demand: Demand, states: Array) -> Demand:
    """Return what is asked of an output, near nominal ``states`` (D,), with limits of the nearest copy of a region."""
    i, k, _ = demand.parts[0]
    agent = problem.agents[i]
    if len(demand.parts) > 1 or k not in agent.angle_outputs:
        return demand
    axis = agent.states.index(str(agent.outputs[k]))
    value = float(states[problem.slices[i].start + axis])
    first, last = agent.state_box[:, axis].tolist()
    if not abs(value) <= FARTHEST:
        raise Refused(f"the nominal angle of `{agent.name}` is beyond {FARTHEST} for {demand.label}")
    low, high = demand.avoided or (demand.low, demand.high)
    low, high = max(low, first), min(high, last)  # a region without a limit ends where the turn does
    if demand.avoided:  # between the end of one copy and the beginning of the next
        low, high = high, low + TURN
    elif high - low >= TURN - OFF:
        return Demand(demand.parts, -np.inf, np.inf, demand.label)
    turns = round((value - 0.5 * (low + high)) / TURN)
    return Demand(demand.parts, low + TURN * turns + OFF, high + TURN * turns - OFF, demand.label)


def _slope(tree: Tree, angle: str) -> Fraction | None:
    """Return c if an expression is c times an angle plus what repeats with its turns (exact); None if unknown."""
    if not isinstance(tree, tuple):
        return Fraction(int(tree == angle))
    name, *arguments = tree
    slopes = [_slope(argument, angle) for argument in arguments]
    known = [slope for slope in slopes if slope is not None]
    if len(known) < len(slopes):
        return None
    if not any(known):
        return Fraction(0)
    a, b = known[0], known[-1]
    if name in ("sin", "cos", "tan"):  # tangents repeat after half a turn
        return Fraction(0) if (2 * a if name == "tan" else a).denominator == 1 else None
    if name == "negative":
        return -a
    if name in ("+", "-"):
        return a + b if name == "+" else a - b
    if name in ("min", "max"):
        return a if a == b else None
    # products with numbers, and quotients by them
    factor = next((other for other in arguments[: 2 if name == "*" else 0] if isinstance(other, float)), None)
    if name == "/" and isinstance(arguments[1], float) and arguments[1]:
        return a / Fraction(arguments[1])
    return None if factor is None else Fraction(factor) * (b if factor is arguments[0] else a)
