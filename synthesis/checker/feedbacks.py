"""Feedbacks that are written as expressions of states and the time, and cut off at the box of inputs.

**Theorem** (``enclosed_feedback``). The input is within ``u + J e + rho`` for every error e of the tube. *Proof.* An
expression is a row, and something between ends, on the tube (``jets.expanded``); what is cut off, inside of it
or last of all, leaves a line by no more than ``networks._line`` says. QED

The claim is for every controller within ``OFF * (1 + |u|)`` of the expressions, before it is cut off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from .expressions import Tree, read_expression
from .fields import Entry
from .intervals import add, interval, mul, neg, up
from .jets import expanded
from .networks import _Forms
from .problem import Agent
from .rigorous import Array, U

OFF = 1e-9  # share of inputs, and one, that controllers may be off by: far above what numpy's functions round by


@dataclass(frozen=True, eq=False)
class Feedback:
    """Inputs of one agent as expressions (m,) of its states and ``t``, cut off at ends (2, m)."""

    inputs: tuple[Tree, ...]
    ends: Array


def read_feedback(entry: Entry, agent: Agent) -> Feedback:
    """Return the feedback of an agent in a file; raise ``Unreadable`` if it does not fit."""
    names, entries = (*agent.states, *(() if "t" in agent.states else ("t",))), entry.entries(len(agent.inputs))
    trees = [own.made(partial(read_expression, own.value, names, {})) for own in entries]
    ends = agent.input_box.copy()
    for k, tree in enumerate(trees):
        # what is cut off at numbers, last of all, is cut off once, at the narrower ends
        match tree:
            case ("min", ("max", inner, float(low)), float(high)) if low <= high:
                trees[k], (first, last) = inner, np.clip(ends[:, k], low, high)
                ends[:, k] = np.clip((low, high), *ends[:, k]) if first == last else (first, last)
    return Feedback(tuple(trees), ends)


def enclosed_feedback(
    feedback: Feedback, agent: Agent, at: Array, t: int, ends: Array, reach: Callable[[Array], Array]
) -> tuple[Array, Array, Array]:
    """Return u (m,), J (m, d) and ends (2, m) of rho, for errors between ends (2, d) around a state ``at`` (d,)."""
    tube = _Tube(agent, at, t, ends, reach)
    plain = _joined([tube.form(tree) for tree in feedback.inputs])
    most = np.abs(plain.h) + np.abs(plain.rest()).max(axis=0) + np.abs(plain.C) @ plain.far
    spare = OFF * (1.0 + most)
    plain = _Forms(plain.h, plain.C, (*plain.parts, (None, np.stack([-spare, spare]))), most, plain.far)
    forms = plain.through("clip", feedback.ends[0], feedback.ends[1], reach)
    return forms.h, forms.C, forms.rest()


@dataclass(frozen=True, eq=False)
class _Tube:
    """Where expressions are looked at: around a state at a time, for errors between ends (2, d)."""

    agent: Agent
    at: Array
    t: int
    ends: Array
    reach: Callable[[Array], Array]

    def form(self, tree: Tree) -> _Forms:
        """Return an expression as ``h + C e`` and a rest: kinks by lines, as in networks, all else by jets."""
        match tree:
            case (("+" | "-") as name, left, right) if _has_kink(tree):
                a, b = self.form(left), self.form(right)
                sign = 1.0 if name == "+" else -1.0
                return self._made(
                    a.h + sign * b.h, a.C + sign * b.C, add(a.rest(), b.rest() if sign > 0 else neg(b.rest()))
                )
            case ("negative", inner) if _has_kink(tree):
                a = self.form(inner)
                return self._made(-a.h, -a.C, neg(a.rest()))
            case ("*", left, right) if _has_kink(tree):
                a, b = self.form(left), self.form(right)
                a, b = (b, a) if np.any(b.C) else (a, b)
                if not np.any(b.C):  # a number at this time
                    factor = add(interval(b.h), b.rest())
                    middle = 0.5 * (factor[0] + factor[1])
                    size = np.abs(a.h) + np.abs(a.C) @ a.far + np.abs(a.rest()).max(axis=0)
                    off = up(size * (up(factor[1] - factor[0]) + 8.0 * U * np.abs(middle)))
                    rest = add(mul(interval(middle), a.rest()), np.stack([-off, off]))
                    return self._made(middle * a.h, middle[:, None] * a.C, rest)
            case (("min" | "max") as name, inner, float(end)) | (("min" | "max") as name, float(end), inner):
                low, high = (-np.inf, end) if name == "min" else (end, np.inf)
                return self.form(inner).through("clip", np.full(1, low), np.full(1, high), self.reach)
            case ("tanh", inner):
                return self.form(inner).through("tanh", np.zeros(1), np.zeros(1), self.reach)
        places = {name: k for k, name in enumerate(self.agent.states)}
        matrix, rest = expanded((tree,), self.at, places, self.ends, self.t, len(places))
        middle = 0.5 * (rest[0] + rest[1])
        return self._made(middle, matrix, add(rest, neg(interval(middle))))

    def _made(self, h: Array, C: Array, rest: Array) -> _Forms:
        """Return a form; numbers that were added or multiplied here are rounded."""
        far = np.abs(self.ends).max(axis=0)
        off = 8.0 * U * (np.abs(h) + np.abs(C) @ far) + 1e-290
        return _Forms(h, C, ((None, add(rest, np.stack([-off, off]))),), np.abs(h), far)


def _has_kink(tree: Tree) -> bool:
    """Return whether an expression holds an operation that lines are for."""
    return isinstance(tree, tuple) and (tree[0] in ("min", "max", "tanh") or any(map(_has_kink, tree[1:])))


def _joined(forms: list[_Forms]) -> _Forms:
    """Return forms of one number each as one of several."""
    rest = np.concatenate([own.rest() for own in forms], axis=1)
    h, C = np.concatenate([own.h for own in forms]), np.concatenate([own.C for own in forms])
    return _Forms(h, C, ((None, rest),), np.abs(h), forms[0].far)
