"""Coordinates in which noise that moves several states is noise along one axis each.

*Two states, any laws.* Let two states have noise N w, N (2, m), where the *pivot* p has one source j alone, and the
other state o that one, and at most one more, l. With s a power of 2, A = s N_pj and B = s N_oj, let

    z_p = x_p,    z_o = A x_o - B x_p.

**Theorem.** The noise of z_p is N_pj w_j, and that of z_o is A N_ol w_l, independent of it, or none. The map has an
inverse, x_o = (z_o + B z_p) / A, so that runs of z are those of x, and a controller of z is one of x.

*Proof.* In z_o the source j has the factor A N_oj - B N_pj = s (N_pj N_oj - N_oj N_pj) = 0, exactly. QED

*Normal noise of up to three states.* Let z = M x, where M has ones on its diagonal and nothing above it, and S be the
covariance of M N w, in fractions. Runs of z are taken for runs with the independent deviations s_k, near the roots of
S_kk.

**Theorem.** What is proved of these is off by at most T |R| / 2, with R = (S_ij / (s_i s_j)) - I and |R| the root of
the sum of its squares, if |R| <= 1/2. *Proof.* Let l be the eigenvalues of R. Each step's noise has the divergence
(Kullback and Leibler) ``sum (l - log(1 + l)) / 2 <= sum l^2 / 2`` from the other one, and so is at most |R| / 2 from
it in total variation (Pinsker). Runs under one controller are no further apart than their steps together. QED

With M from a factorization of the covariance R is of the size of rounding: some 1e-15.

Dynamics, outputs and starts are written in z: names of x_o become the tree of its inverse. What is rounded stays in
trees, which the check evaluates on intervals: A N_ol multiplies the noise as its scale. The workspace of x is no box
of z; the grid is one around it, and values are 0 in cells that are not inside of it. Where A x_o and B x_p nearly
cancel z_o is no number to interpolate at: what controllers round it by has to be less than 1e-9 of inputs
(``closed_loops.INPUT_OFF``), so cells have a least width (``FINEST``).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from typing import Any

import numpy as np

from ...checker import CheckedAgent, CheckedProblem, Refused, value_on
from ...checker.distributions import NORMAL, Envelope
from ...checker.rigorous import Array, Truth

FINEST = 1e6  # how many sides of a cell terms of a coordinate may be long
MOST_STATES = 3  # of normal noise that is taken apart: the more states, the more cells lie across faces
LEAST = 1e-6  # share of a state's variance that is left beside other states, else its noise is theirs
MOST_LOST = 1e-9  # probability that is given up for coordinates


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
    lost : float
        Upper bound on what probabilities of runs are off by.
    """

    matrix: Array
    inverse: tuple[Any, ...]
    workspace: Array
    lost: float = 0.0

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
    agent, used = problem.agents[0], problem.agents[0].noise != 0.0
    if len(problem.agents) > 1 or problem.pairs or agent.angles or agent.scale or agent.shared_noise.any():
        return problem
    if not (np.any(used.sum(axis=0) > 1) or np.any(used.sum(axis=1) > 1)):
        return problem
    return _of_two(problem) if len(agent.states) == 2 else _of_normal(problem)


def _of_two(problem: CheckedProblem) -> CheckedProblem:
    agent, used = problem.agents[0], problem.agents[0].noise != 0.0
    if not (np.any(used.sum(axis=0) > 1) and np.any(used.sum(axis=1) == 1)):
        return _of_normal(problem)
    # of two pivots the one with more noise, for its range
    pivots = [k for k in (0, 1) if used[k].sum() == 1]
    size = np.abs(agent.noise).max(axis=1) / (agent.state_box[1] - agent.state_box[0])
    p = max(pivots, key=lambda k: float(size[k]))
    o, j = 1 - p, int(np.argmax(used[p]))
    rest = np.flatnonzero(used[o] & (np.arange(used.shape[1]) != j))
    if len(rest) > 1:
        return _of_normal(problem)
    shift = -math.frexp(abs(float(agent.noise[p, j])))[1]
    if abs(shift) > 500:
        return problem
    A, B = (math.ldexp(float(agent.noise[k, j]), shift) for k in (p, o))
    if not math.isfinite(B) or B == 0.0 or math.ldexp(B, -shift) != float(agent.noise[o, j]):
        return problem
    return _written(problem, p, (A, B), j, int(rest[0]) if len(rest) else None)


def _of_normal(problem: CheckedProblem) -> CheckedProblem:
    """Return the problem in coordinates from a factorization of the covariance; itself where noise is not normal."""
    agent, d = problem.agents[0], len(problem.agents[0].states)
    normal = [own.tail == NORMAL and not (own.mean or own.off or own.lost) for own in agent.envelopes]
    if d > MOST_STATES or not all(normal):
        return problem
    factor = [[Fraction(own) * Fraction(e.deviation) for own, e in zip(row, agent.envelopes, strict=True)]
              for row in agent.noise.tolist()]  # fmt: skip
    covariance = [[sum((a * b for a, b in zip(u, v, strict=True)), Fraction(0)) for v in factor] for u in factor]
    # rows of M, one after the other: what is left of a state beside those before
    M, variances = np.eye(d), list[float]()
    for k in range(d):
        for j in range(k - 1, -1, -1):
            own = float(_of_rows(covariance, M[k], M[j]))
            M[k] -= own / variances[j] * M[j]
        variances.append(float(_of_rows(covariance, M[k], M[k])))
        if not variances[-1] > LEAST * float(covariance[k][k]):
            return problem
    s = [math.sqrt(own) for own in variances]
    square = Fraction(0)
    for i, j in itertools.product(range(d), repeat=2):
        square += (_of_rows(covariance, M[i], M[j]) / (Fraction(s[i]) * Fraction(s[j])) - (i == j)) ** 2
    lost = problem.horizon * 0.5 * math.sqrt(float(square)) * (1.0 + 2.0**-40)
    if not lost <= MOST_LOST:
        return problem
    inverse = list[Any]()
    for k, name in enumerate(agent.states):
        tree: Any = name
        for j in range(k):
            tree = ("-", tree, ("*", float(M[k, j]), inverse[j]))
        inverse.append(tree)

    def in_z(tree: Any) -> Any:
        if isinstance(tree, tuple):
            return (tree[0], *map(in_z, tree[1:]))
        return inverse[agent.states.index(tree)] if tree in agent.states else tree

    means = [in_z(tree) for tree in agent.dynamics]
    dynamics, forward = list[Any](), list[Any]()
    for k in range(d):
        for trees, of in ((dynamics, means), (forward, agent.states)):
            tree = of[k]
            for j in range(k):
                tree = ("+", tree, ("*", float(M[k, j]), of[j]))
            trees.append(tree)
    if not np.array_equal(agent.start[0], agent.start[1]):
        raise Refused(f"`{agent.name}` starts anywhere in a box, and its noise is not independent")
    names = [{name: own[:, [k]] for k, name in enumerate(agent.states)} for own in (agent.state_box, agent.start)]
    box, start = (np.stack([value_on(tree, own)[:, 0] for tree in forward], axis=1) for own in names)
    written = replace(
        agent, dynamics=tuple(dynamics), outputs=tuple(map(in_z, agent.outputs)), noise=np.diag(s), state_box=box,
        start=start, envelopes=(Envelope(0.0, 0.0, 1.0, NORMAL),) * d,
    )  # fmt: skip
    rest: dict[str, Any] = {field.name: getattr(problem, field.name) for field in fields(CheckedProblem)}
    rest |= {"agents": (written,), "matrix": M, "inverse": tuple(inverse), "workspace": agent.state_box, "lost": lost}
    return Independent(**rest)


def _of_rows(covariance: list[list[Fraction]], a: Array, b: Array) -> Fraction:
    """Return the covariance of two sums of states, exactly."""
    pairs = itertools.product(enumerate(a.tolist()), enumerate(b.tolist()))
    return sum((Fraction(x) * Fraction(y) * covariance[i][j] for (i, x), (j, y) in pairs), Fraction(0))


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
    return [
        np.array([corner, corner])
        for corner in np.stack(np.meshgrid(*agent.start.T), axis=-1).reshape(-1, agent.start.shape[1])
    ]
