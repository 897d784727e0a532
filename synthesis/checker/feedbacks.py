"""Feedbacks that are written as expressions of states and the time, and cut off at the box of inputs.

**Theorem** (``enclosed_feedback``). The input is within ``u + J e + rho`` for every error e of the tube. *Proof.* An
expression is a row, and something between ends, on the tube (``jets.expanded``); what is cut off, inside of it
or last of all, leaves a parabola by no more than ``networks._parabola`` says. QED

The claim is for every controller within ``OFF * (1 + |u|)`` of the expressions, before it is cut off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from .error_system import Seen
from .expressions import Tree, read_expression
from .fields import Entry
from .intervals import add, interval, neg, up
from .jets import expanded
from .networks import Layer
from .problem import Agent
from .rigorous import Array

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


def enclosed_feedback(feedback: Feedback, agent: Agent, at: Array, t: int, seen: Seen) -> tuple[Array, Array, Array]:
    """Return u (m,), J (m, d) and ends (2, m) of rho, for the errors around a state ``at`` (d,) that are seen."""
    plain = _joined([_Tube(agent, at, t, seen).layer(tree) for tree in feedback.inputs])
    plain = plain.off_by(OFF * (1.0 + plain.size))
    cut = plain.through("clip", feedback.ends[0], feedback.ends[1])
    return cut.h, cut.C, cut.rest()


@dataclass(frozen=True, eq=False)
class _Tube:
    """Where expressions are looked at: around a state at a time, for the errors that are seen."""

    agent: Agent
    at: Array
    t: int
    seen: Seen

    def layer(self, tree: Tree) -> Layer:
        """Return an expression as a layer of one number: kinks by lines, as in networks, all else by jets."""
        none = np.zeros(1)
        match tree:
            case (("+" | "-") as name, left, right) if _has_kink(tree):
                signs = np.array([[1.0, 1.0 if name == "+" else -1.0]])
                return _joined([self.layer(left), self.layer(right)]).times(signs, none)
            case ("negative", inner) if _has_kink(tree):
                return self.layer(inner).times(-np.eye(1), none)
            case ("*", left, right) if _has_kink(tree):
                a, b = self.layer(left), self.layer(right)
                a, b = (b, a) if np.any(b.C) else (a, b)  # b is the factor without errors, if there is one
                if not np.any(b.C):  # a number at this time, which is between ends
                    low, high = add(interval(b.h), b.rest())
                    return a.times(0.5 * (low + high)[None], none).off_by(up(a.size * up(high - low)))
            case (("min" | "max") as name, inner, float(end)) | (("min" | "max") as name, float(end), inner):
                low, high = (none - np.inf, none + end) if name == "min" else (none + end, none + np.inf)
                return self.layer(inner).through("clip", low, high)
            case ("tanh", inner):
                return self.layer(inner).through("tanh")
        places, d = {name: k for k, name in enumerate(self.agent.states)}, len(self.at)
        matrix, ends = expanded((tree,), self.at, places, self.seen.ends, self.t, d)
        middle = 0.5 * (ends[0] + ends[1])
        own = add(ends, neg(interval(middle)))
        size = np.abs(middle) + np.abs(matrix) @ self.seen.far + np.abs(own).max(axis=0)
        return Layer(middle, matrix, np.zeros((1, d, d)), (), own, size, self.seen)


def _has_kink(tree: Tree) -> bool:
    """Return whether an expression holds an operation that lines are for."""
    return isinstance(tree, tuple) and (tree[0] in ("min", "max", "tanh") or any(map(_has_kink, tree[1:])))


def _joined(layers: list[Layer]) -> Layer:
    """Return layers of one number each as one of several."""
    h, C, Q, size = (np.concatenate([getattr(own, key) for own in layers]) for key in ("h", "C", "Q", "size"))
    rest = np.concatenate([replace(own, Q=0.0 * own.Q).rest() for own in layers], axis=1)
    return Layer(h, C, Q, (), rest, size, layers[0].seen)
