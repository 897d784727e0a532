"""Numbers by themselves in balls: charges, tails, functions, boxes of expressions, angles, and the cell of a start."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from flint import arb

from certigym.synthesis.relations.grids import FloatArray

from .ball_memory import Memory, Proof
from .ball_spans import balls, unproved


class Functions:
    """Functions of balls, in the place of those of doubles."""

    pi = arb.pi()

    def __getattr__(self, name: str) -> Callable[[Any], Any]:
        return lambda x: getattr(arb, name)(self.number(x))

    @staticmethod
    def number(x: Any) -> Any:
        """Return the ball that is a double."""
        return arb(x)

    @staticmethod
    def betainc(a: Any, b: Any, x: Any) -> Any:
        """Return the regularized incomplete beta function."""
        return x.beta_lower(arb(a), arb(b), True)


def interpolation_error(memory: Memory, exact: Callable[..., Any], law: Any, step: float, value: float) -> Proof:
    """What interpolation adds: the same formula in balls."""
    return 1, [] if value == math.inf or exact(law, step, Functions()) <= value else [
        f"a charge of {law} was not proved"
    ]


def error_function(memory: Memory, x: float, value: float) -> Proof:
    """The error function is at most a number."""
    return 1, [] if arb(float(x)).erf() <= value else ["a distance between two normal laws was not proved"]


def function(memory: Memory, name: str, numbers: Any, x: FloatArray, low: FloatArray, high: FloatArray) -> Proof:
    """Elementary functions lie between ends, which are not numbers where nothing is said."""
    triples, wrong = {*zip(*(np.ravel(own).tolist() for own in (x, low, high)), strict=True)}, 0
    exact: Callable[[Any], Any] = (lambda y: y ** arb(*numbers)) if name == "power" else getattr(arb, name)
    for at, least, most in triples:
        if math.isfinite(least) and math.isfinite(most):
            value = exact(arb(at))
            wrong += not (least <= value and value <= most)
    return len(triples), [f"{wrong} values of the function `{name}` were not proved"] if wrong else []


def spans(memory: Memory, enclosed: Any, cells: Any, unknown: Any, ends: Any) -> Proof:
    """Boxes hold all values of expressions on cells."""
    count, wrong = unproved(enclosed, cells, unknown, ends)
    text = f"{wrong} boxes of agent `{enclosed.agent.name}` were not shown to hold what they are said to hold"
    return count, [text] if wrong else []


def angles(memory: Memory, middle: Any, corners: Any, found: Any, off: FloatArray) -> Proof:
    """Angles of boxes, and from there to their corners, are off by no more than is said."""
    (x, y), (about, ways), wrong = map(balls, middle), found, 0
    room = arb(float(off))
    for i in range(len(x)):
        wrong += not abs(arb.atan2(y[i], x[i]) - arb(about[i])) <= room
        for (a, b), way in zip(corners, ways, strict=True):
            a_i, b_i = arb(a[i]), arb(b[i])
            turn = arb.atan2(x[i] * b_i - y[i] * a_i, x[i] * a_i + y[i] * b_i)
            wrong += not abs(turn - arb(way[i])) <= room
    return len(x) * 5, ["the angle of an input was not proved"] if wrong else []
