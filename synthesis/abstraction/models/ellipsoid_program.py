"""The semidefinite program of an ``ellipsoid`` relation.

With ``X = epsilon^2 D^-1``, ``L = K X`` and ``Q = F X`` everything is linear in ``(X, L, Q)`` for fixed lambdas:

    for every vertex v of W     [ lambda X   0           (A X + B L - Q)' ]
                                [ 0          1 - lambda  v'               ]   >= 0      (invariance, S-lemma)
                                [ A X + B L - Q   v      X                ]
    for every input j           [ X  L_j' ; L_j  (share * room_j)^2 ]         >= 0      (K E in a share of the inputs)
    for all axes together       [ X  Q' ; Q  r^2 Sigma ]                      >= 0      (delta <= 2 Phi(r/2) - 1)
    for every state k           X_kk <= limit_k^2, in state coordinates                 (what labels lose)

Opposite vertices share a lambda. Two questions are asked: which ellipsoid loses the fewest labels for a given input
share, and which one needs the smallest input share within given limits. Nothing here is trusted: the answer is verified
by ``ellipsoid_is_invariant`` (docs/theory/relations.md, "Ellipsoids").
"""

from __future__ import annotations

import contextlib
import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from ....envs.systems.agents import LinearAgent
from ...relations.grids import FloatArray, RelationRefused, in_grid_coordinates

MOST_CELLS_PER_ROOM = 1e6
"""Most half cells per half width of a region for which an ellipsoid is looked for: labels are lost long before."""

OTHER_STATES_WEIGHT = 0.02
"""Weight of states that do not decide the objective: it keeps the ellipsoid short also where length costs nothing."""

LABEL_WEIGHT = 0.002
"""Weight of labels when the input share is minimised, for the same reason."""

DISTANCE_SHARE = 1.0 - 1e-6
"""Share of the distance of means that delta allows: enlarging the answer must not exceed it."""


@dataclass(frozen=True)
class Answer:
    """An ellipsoid as the solver returns it, in grid coordinates: X, K, F, and its shares of inputs and labels."""

    X: FloatArray
    feedback: FloatArray
    coupling: FloatArray
    input_share: float
    label_share: float


class EllipsoidProgram:
    """The semidefinite program in units of W (errors) and of half the input box (inputs), compiled once."""

    def __init__(
        self, agent: LinearAgent, coordinates: FloatArray, half: FloatArray, room: FloatArray, delta: float
    ) -> None:
        self.cp = cp = _solver()
        moves, self.units = in_grid_coordinates(agent, coordinates), half
        self.room = np.maximum(0.5 * (agent.input_box.high - agent.input_box.low), 1e-9)
        self.A = moves.A / half[:, None] * half
        self.B = moves.B / half[:, None] * self.room
        self.useful = np.any(self.B != 0, axis=0) & (agent.input_box.high > agent.input_box.low)
        self.deviations = np.sqrt(np.diag(moves.covariance)) / half
        self.labels = coordinates * half / room[:, None]
        # delta = 2 Phi(r / 2) - 1, solved for the distance r.
        self.distance = 2.0 * float(ndtri(0.5 * (1.0 + delta))) * DISTANCE_SHARE
        # One of each pair of opposite vertices.
        patterns = itertools.product((1.0, -1.0), repeat=len(half) - 1)
        self.vertices = [np.array([[1.0, *signs]]) for signs in patterns]
        self.multipliers = [cp.Parameter(nonneg=True) for _ in self.vertices]
        self.limits = cp.Parameter(len(half), nonneg=True)
        self.squared_share, self.prices = cp.Parameter(nonneg=True), cp.Parameter(2, nonneg=True)
        if not np.max(np.abs(self.labels)) < MOST_CELLS_PER_ROOM:
            raise RelationRefused(
                f"agent `{agent.name}`: its cells are more than {MOST_CELLS_PER_ROOM:g} times as wide as its narrowest "
                "region; no ellipsoid keeps labels in it"
            )
        self.scale = float(np.max(np.sum(self.labels**2, axis=1)))  # the solver sees numbers near 1
        self.programs = {uses: self._compile(uses) for uses in (False, True)}
        # A pattern search comes back to where it was.
        self.solved: dict[tuple[Any, ...], Answer | None] = {}

    def _compile(self, uses_feedback: bool) -> tuple[Any, Any, Any, Any]:
        """Return the program with or without a feedback, and its variables X, L, Q."""
        cp, (d, m) = self.cp, self.B.shape
        X, worst = cp.Variable((d, d), PSD=True), cp.Variable()
        L = cp.Variable((m, d)) if uses_feedback else np.zeros((m, d))
        Q = cp.Variable((d, d)) if self.distance > 0 else np.zeros((d, d))
        # Invariance, one matrix inequality per vertex.
        moved = self.A @ X + self.B @ L - Q
        nothing, constraints = np.zeros((1, d)), []
        for v, multiplier in zip(self.vertices, self.multipliers, strict=True):
            complement = cp.reshape(1.0 - multiplier, (1, 1), order="F")
            rows = [[multiplier * X, nothing.T, moved.T], [nothing, complement, v], [moved, v.T, X]]
            constraints.append(cp.bmat(rows) >> 0)
        # Input reserve, one inequality per input; `spent` is the squared share.
        spent = cp.Variable() if uses_feedback else 0.0
        if uses_feedback:
            corner = cp.reshape(spent, (1, 1), order="F")
            constraints += [cp.bmat([[X, L[[j]].T], [L[[j]], corner]]) >> 0 for j in range(m)]
            constraints.append(spent <= self.squared_share)
        # Failure of the coupling, for all axes together.
        if self.distance > 0:
            scaled = Q / (self.distance * self.deviations)[:, None]
            constraints.append(cp.bmat([[X, scaled.T], [scaled, np.eye(d)]]) >> 0)
        # What labels lose, state by state; `worst` is the largest of these squared shares.
        shares = [cp.sum(cp.multiply(np.outer(row, row) / self.scale, X)) for row in self.labels]
        constraints += [share <= self.limits[k] for k, share in enumerate(shares)] + [worst >= each for each in shares]
        lost = worst + OTHER_STATES_WEIGHT / d * sum(shares)
        return cp.Problem(cp.Minimize(self.prices[0] * spent + self.prices[1] * lost), constraints), X, L, Q

    def solve(self, share: float | None, limits: FloatArray, multipliers: Sequence[float]) -> Answer | None:
        """Return the answer with the least label share at an input ``share``, or with the least input share if None.

        None is returned if the solver finds no answer. One that it calls inaccurate counts: it is verified anyway.
        """
        question = (share, limits.tobytes(), *multipliers)
        if question not in self.solved:
            self.solved[question] = self._solve(share, limits, multipliers)
        return self.solved[question]

    def _solve(self, share: float | None, limits: FloatArray, multipliers: Sequence[float]) -> Answer | None:
        problem, *variables = self.programs[share is None or share > 0]
        self.squared_share.value = 1.0 if share is None else share**2
        largest = float(np.max(limits)) ** 2 / self.scale
        self.prices.value = np.array([1.0, LABEL_WEIGHT / largest] if share is None else [0.0, 1.0])
        self.limits.value = limits**2 / self.scale
        for parameter, value in zip(self.multipliers, multipliers, strict=True):
            parameter.value = value
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with contextlib.suppress(self.cp.error.SolverError):  # the status then says that there is no answer
                problem.solve(solver=self.cp.CLARABEL)
        X, L, Q = (v if isinstance(v, np.ndarray) else v.value for v in variables)
        if problem.status not in ("optimal", "optimal_inaccurate") or X is None or np.linalg.eigvalsh(X)[0] <= 0:
            return None
        K, F = (np.linalg.solve(X, v.T).T for v in (L, Q))
        # Inputs that move nothing get no feedback: what the solver leaves there is noise. Then back to plain units.
        K = np.where(self.useful[:, None], K, 0.0)
        return Answer(
            X=X * np.outer(self.units, self.units),
            feedback=self.room[:, None] * K / self.units,
            coupling=self.units[:, None] * F / self.units,
            input_share=float(np.sqrt(np.max(np.diag(K @ X @ K.T)))),
            label_share=float(np.sqrt(np.max(np.diag(self.labels @ X @ self.labels.T)))),
        )


def _solver() -> Any:
    """Return the module cvxpy.

    Raises
    ------
    ValueError
        If it is not installed; it comes with the extra ``lmi``.
    """
    try:
        import cvxpy
    except ImportError as error:
        raise RelationRefused(
            "`relation`: expected the package cvxpy for `ellipsoid`, got none; install it with "
            '`pip install "certigym[lmi]"` or choose the relation `tube`'
        ) from error
    return cvxpy
