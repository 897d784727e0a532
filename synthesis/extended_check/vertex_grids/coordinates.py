"""Coordinates of two states in which noise that moves both is noise along one axis each.

Let two states have noise N w, N (2, m), where the *pivot* p has one source j alone, and the other state o that one, and
at most one more, l. With s a power of 2, A = s N_pj and B = s N_oj, let

    z_p = x_p,    z_o = A x_o - B x_p.

**Theorem.** The noise of z_p is N_pj w_j, and that of z_o is A N_ol w_l, independent of it, or none. The map has an
inverse, x_o = (z_o + B z_p) / A, so that runs of z are those of x, and a controller of z is one of x.

*Proof.* In z_o the source j has the factor A N_oj - B N_pj = s (N_pj N_oj - N_oj N_pj) = 0, exactly. QED

Dynamics, outputs and starts are written in z: names of x_o become the tree of its inverse. What is rounded stays in
trees, which the check evaluates on intervals: A N_ol multiplies the noise as its scale. The workspace of x is no box
of z; the grid is one around it, and values are 0 in cells that are not inside of it. Where A x_o and B x_p nearly
cancel z_o is no number to interpolate at: what controllers round it by has to be less than 1e-9 of inputs
(``closed_loops.INPUT_OFF``), so cells have a least width (``FINEST``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ...checker import CheckedAgent, CheckedProblem, Refused, value_on
from ...checker.rigorous import Array, Truth

FINEST = 1e6  # how many sides of a cell terms of a coordinate may be long


@dataclass(frozen=True, eq=False)
class Independent(CheckedProblem):
    """A problem of one agent in coordinates in which its noise is independent along each axis.

    Attributes
    ----------
    matrix : (d, d) array
        z = matrix x.
    inverse : trees
        The states x, from z.
    workspace : (2, d) array
        That of x.
    """

    matrix: Array
    inverse: tuple[Any, ...]
    workspace: Array

    def inside(self, low: Array, high: Array) -> Truth:
        """Return which boxes (S, d) of z lie in the workspace of x."""
        names = {name: np.stack([low[:, k], high[:, k]]) for k, name in enumerate(self.agents[0].states)}
        ends = np.stack([value_on(tree, names) for tree in self.inverse])
        return np.all((self.workspace[0][:, None] <= ends[:, 0]) & (ends[:, 1] <= self.workspace[1][:, None]), axis=0)

    def refuse_fine(self, edges: tuple[Array, ...]) -> None:
        """Raise ``Refused`` where cells are so narrow that what controllers round coordinates by counts."""
        terms = np.abs(self.matrix) @ np.abs(self.workspace).max(axis=0)
        widths = np.array([np.diff(axis, axis=-1).min() for axis in edges])
        if not np.all(widths * FINEST >= terms):
            raise Refused("cells are too narrow for coordinates that are rounded")


def independent(problem: CheckedProblem) -> CheckedProblem:
    """Return a problem in coordinates in which its noise is independent, or itself where there are none, or it is."""
    agent = problem.agents[0]
    if len(problem.agents) > 1 or problem.pairs or len(agent.states) != 2 or agent.angles or agent.scale:
        return problem
    used = agent.noise != 0.0
    if agent.shared_noise.any() or not (np.any(used.sum(axis=0) > 1) and np.any(used.sum(axis=1) == 1)):
        return problem
    # of two pivots the one with more noise, for its range
    pivots = [k for k in (0, 1) if used[k].sum() == 1]
    size = np.abs(agent.noise).max(axis=1) / (agent.state_box[1] - agent.state_box[0])
    p = max(pivots, key=lambda k: float(size[k]))
    o, j = 1 - p, int(np.argmax(used[p]))
    rest = np.flatnonzero(used[o] & (np.arange(used.shape[1]) != j))
    if len(rest) > 1:
        return problem
    shift = -math.frexp(abs(float(agent.noise[p, j])))[1]
    if abs(shift) > 500:
        return problem
    A, B = (math.ldexp(float(agent.noise[k, j]), shift) for k in (p, o))
    if not math.isfinite(B) or B == 0.0 or math.ldexp(B, -shift) != float(agent.noise[o, j]):
        return problem
    return _written(problem, p, (A, B), j, int(rest[0]) if len(rest) else None)


def _written(problem: CheckedProblem, p: int, factors: tuple[float, float], j: int, other: int | None) -> Independent:
    agent, o, (A, B) = problem.agents[0], 1 - p, factors
    names = agent.states
    of_other: Any = ("/", ("+", names[o], ("*", B, names[p])), A)

    def in_z(tree: Any) -> Any:
        if isinstance(tree, tuple):
            return (tree[0], *map(in_z, tree[1:]))
        return of_other if tree == names[o] else tree

    means = [in_z(tree) for tree in agent.dynamics]
    dynamics, scale, noise = [means[p]] * 2, list[Any]([1.0] * 2), np.zeros_like(agent.noise)
    dynamics[o] = ("-", ("*", A, means[o]), ("*", B, means[p]))
    noise[p, j], scale[p] = np.sign(agent.noise[p, j]), abs(float(agent.noise[p, j]))
    if other is not None:
        noise[o, other] = np.sign(A * agent.noise[o, other])
        scale[o] = ("*", abs(A), abs(float(agent.noise[o, other])))
    matrix, inverse = np.eye(2), list[Any](names)
    matrix[o, o], matrix[o, p], inverse[o] = A, -B, of_other
    forward = ("-", ("*", A, names[o]), ("*", B, names[p]))
    box, start = agent.state_box.copy(), agent.start.copy()
    for own in (box, start):
        own[:, o] = value_on(forward, {name: own[:, [k]] for k, name in enumerate(names)})[:, 0]
    if not np.array_equal(agent.start[0], agent.start[1]):
        raise Refused(f"`{agent.name}` starts anywhere in a box, and its noise is not independent")
    written = replace(
        agent, dynamics=tuple(dynamics), outputs=tuple(map(in_z, agent.outputs)), scale=tuple(scale), noise=noise,
        state_box=box, start=start,
    )  # fmt: skip
    rest: dict[str, Any] = {field.name: getattr(problem, field.name) for field in fields(CheckedProblem)}
    rest |= {"agents": (written,), "matrix": matrix, "inverse": tuple(inverse), "workspace": agent.state_box}
    return Independent(**rest)


def start_points(agent: CheckedAgent) -> list[Array]:
    """Return points (2, d) at the corners of a start that is known up to rounding."""
    return [np.array([corner, corner]) for corner in np.stack(np.meshgrid(*agent.start.T), axis=-1).reshape(-1, 2)]
