"""States that are angles, for the check: dynamics are those of points of a circle, and regions come once a turn.

A path has angles that are numbers: they go on where a turn ends. With ``f(x + 2 pi e) = f(x) + 2 pi j``, j whole,
the angle of the path less whole turns moves as the state does, so that inequalities on the path are those on runs
(docs/theory/angles.md, "Along paths"). That f is so is proved here: an expression is a whole multiple of the angle,
plus what repeats. The controller takes the nearest of all numbers that an angle stands for, which is the right one as
long as the tube is narrower than a turn; a region of an angle is not met where the path is between two of its copies.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from ...envs.agents import AnyAgent
from ...envs.expressions import Name, Number, Operation, Tree
from ...envs.problem import Problem
from ..cells import FloatArray

TURN = 6.283185307179586
"""A turn, rounded down: by less than ``ROUNDED``."""

ROUNDED = 1e-13
"""What an angle is off by at most: where it wraps, where copies of regions are, where the nearest number is taken."""

HALF_TURN = 3.14
"""Half width of a tube, less than half a turn."""


def wrong_angles(problem: Problem) -> list[str]:
    """Return what is wrong with the angles of a problem: dynamics, noise or outputs that are not those of a circle."""
    failures = []
    for agent in problem.agents:
        failures += [f"agent `{agent.name}`: {text}" for angle in agent.angles for text in _wrong(agent, angle)]
    return failures


def _wrong(agent: AnyAgent, angle: str) -> list[str]:
    k = agent.states.index(angle)
    low, high = float(agent.state_low[k]), float(agent.state_high[k])
    if not TURN - ROUNDED <= high - low <= TURN or max(abs(low), abs(high)) > 7.0:
        return [f"the workspace of the angle `{angle}` is not one turn"]
    for state, tree in zip(agent.states, agent.timed_trees, strict=True):
        slope = _slope(tree, angle)
        if slope is None or slope.denominator != 1 or (slope and state not in agent.angles):
            return [f"the dynamics of `{state}` are not the same a turn further on along `{angle}`"]
    if any(_slope(tree, angle) != 0 for tree in agent.timed_scale_trees):
        return [f"its noise is not the same a turn further on along `{angle}`"]
    if any(tree != Name(angle) and _slope(tree, angle) != 0 for tree in agent.output_trees):
        return [f"an output is not the same a turn further on along `{angle}`"]
    return []


def _slope(tree: Tree, angle: str) -> Fraction | None:
    """Return c if an expression is c times an angle plus what repeats with its turns (exact); None if unknown."""
    match tree:
        case Number() | Name():
            return Fraction(int(tree == Name(angle)))
        case Operation("sin" | "cos", (inner,)):
            slope = _slope(inner, angle)
            return None if slope is None or slope.denominator > 1 else Fraction(0)
        case Operation("tan", (inner,)):
            slope = _slope(inner, angle)
            return None if slope is None or (2 * slope).denominator > 1 else Fraction(0)
        case Operation("negative", (inner,)):
            slope = _slope(inner, angle)
            return None if slope is None else -slope
    parts = [_slope(part, angle) for part in tree.arguments]
    if None in parts:
        return None
    if not any(parts):
        return Fraction(0)
    first, second = (parts[0] or Fraction(0), (parts[-1] or Fraction(0)))
    match tree:
        case Operation("+", _):
            return first + second
        case Operation("-", (_, _)):
            return first - second
        case Operation("min" | "max", _):
            return first if first == second else None
        case Operation("*", (left, right)):
            constant = (_constant(left), second) if first == 0 else (_constant(right), first)
            return None if constant[0] is None or (first and second) else constant[0] * constant[1]
        case Operation("/", (_, right)):
            divisor = _constant(right)
            return None if not divisor else first / divisor
    return None


def _constant(tree: Tree) -> Fraction | None:
    """Return the number that an expression of numbers is (exact)."""
    if isinstance(tree, Number):
        return Fraction(tree.value)
    if isinstance(tree, Name):
        return None
    parts = [_constant(part) for part in tree.arguments]
    if any(part is None for part in parts):
        return None
    first, second = parts[0] or Fraction(0), parts[-1] or Fraction(0)
    match tree.name:
        case "negative":
            return -first
        case "+":
            return first + second
        case "-":
            return first - second
        case "*":
            return first * second
        case "/":
            return first / second if second else None
    return None


def copy_of(low: float, high: float, value: float) -> tuple[float, float]:
    """Return the ends of the copy of a region of an angle in which a value is, or to which it is nearest (rounded)."""
    turns = round((value - 0.5 * (low + high)) / TURN)
    return low + TURN * turns, high + TURN * turns


def gap_of(low: float, high: float, value: float) -> tuple[float, float]:
    """Return the ends of the gap between two copies of a region of an angle that is nearest to a value (rounded)."""
    return copy_of(high, low + TURN, value)


def axes_of_angles(agent: AnyAgent) -> FloatArray:
    """Return 1 for states (d,) that are angles, and 0 for others."""
    return np.array([float(name in agent.angles) for name in agent.states])
