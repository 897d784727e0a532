"""Search for the ellipsoid, the feedback and the coupling of an ``ellipsoid`` relation by semidefinite programs.

With ``X = epsilon^2 D^-1``, ``L = K X`` and ``Q = F X`` everything is linear in ``(X, L, Q)`` for fixed lambdas:

    for every vertex v of W     [ lambda X   0           (A X + B L - Q)' ]
                                [ 0          1 - lambda  v'               ]   >= 0      (invariance, S-lemma)
                                [ A X + B L - Q   v      X                ]
    for every input j           [ X  L_j' ; L_j  (share * room_j)^2 ]         >= 0      (K E in a share of the inputs)
    for all axes together       [ X  Q' ; Q  r^2 Sigma ]                      >= 0      (delta <= 2 Phi(r/2) - 1)
    minimise                    max_k X_kk / labels_k^2, in state coordinates           (what labels lose)

Among the shares and lambdas (one per vertex; opposite vertices share theirs) that a coarse grid and then a pattern
search try, the answer is the one whose input share plus label share is least, the measure by which the tube chooses its
feedback. The solver is not trusted: of the multiples of its answer the smallest is taken that the
verifier (``verify_ellipsoid``) proves invariant.
"""

from __future__ import annotations

import contextlib
import itertools
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from ..envs.agent import LinearAgent
from .grid import Grid
from .relation_ellipsoid import Ellipsoid
from .relation_tube import disturbance_of
from .verify_ellipsoid import ellipsoid_failure, ellipsoid_is_invariant

FloatArray = NDArray[Any]

Point = tuple[float, ...]
"""An input share and one lambda per vertex."""

Answer = tuple[FloatArray, FloatArray, FloatArray]
"""X, K and F in grid coordinates."""

SHARES = (0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8)
"""Shares of the inputs that the feedback may use, tried first."""

MULTIPLIERS = (0.03, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.96)
"""Values of lambda tried first."""

SIDE = 0.02
"""Weight of the axes that do not decide the objective; it keeps the ellipsoid from being long where that is free."""


def find_ellipsoid(
    agent: LinearAgent,
    grid: Grid,
    coordinates: FloatArray,
    room_for_labels: FloatArray,
    delta: float = 0.0,
    snap: FloatArray | None = None,
    share: float | None = None,
) -> Ellipsoid:
    """A proved ellipsoid whose coupling fails with probability at most ``delta``, in grid coordinates.

    Parameters
    ----------
    agent : LinearAgent
    grid : Grid
        Cells in grid coordinates.
    coordinates : (d, d) array
        Grid coordinates to state.
    room_for_labels : (d,) array
        Half width, per state, of the narrowest region that labels are to be kept in.
    delta : float
        In [0, 1); 0 means F = 0.
    snap : (d,) array, optional
        Half lattice spacings that means are rounded by; default 0.
    share : float, optional
        Share of the input half widths that the feedback may use, in [0, 1); default: chosen.

    Raises
    ------
    ValueError
        If cvxpy is missing, a number is out of range, noise that F needs is missing, or no ellipsoid was found.
    """
    for name, value in (("delta", delta), ("share", 0.0 if share is None else share)):
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value < 1.0:
            raise ValueError(f"`{name}`: expected a number of at least 0 and below 1, got {value!r}")
    inverse = np.linalg.inv(coordinates)
    noise = np.diag(inverse @ agent.noise_covariance @ inverse.T)
    if delta > 0 and np.any(noise <= 0):
        raise ValueError(
            f"agent `{agent.name}`: `delta` > 0 needs a positive definite `noise_covariance`, got a singular one; "
            "give every state some noise or ask for `delta` = 0"
        )
    half = disturbance_of(grid, snap)
    program = _Program(agent, coordinates, half, room_for_labels, delta)
    best = _best(program, SHARES if share is None else (float(share),))
    if best is None:
        raise ValueError(
            f"agent `{agent.name}`: expected a pair `A`, `B` with an ellipsoid that the inputs can keep at `delta` = "
            f"{delta:g}, got one for which none was found; ask for more `cells`, a larger `delta`, or give the agent "
            "inputs that stabilise it"
        )
    return _proved(agent, coordinates, half, noise, best, delta)


class _Program:
    """The semidefinite program in units of W (errors) and of half the input box (inputs), compiled once."""

    def __init__(
        self, agent: LinearAgent, coordinates: FloatArray, half: FloatArray, room: FloatArray, delta: float
    ) -> None:
        self.cp = cp = _solver()
        inverse, self.units = np.linalg.inv(coordinates), half
        self.room = np.maximum(0.5 * (agent.input_box.high - agent.input_box.low), 1e-9)
        self.A = inverse @ agent.A @ coordinates / half[:, None] * half
        self.B = inverse @ agent.B / half[:, None] * self.room
        self.deviations = np.sqrt(np.diag(inverse @ agent.noise_covariance @ inverse.T)) / half
        self.labels = coordinates * half / room[:, None]
        # the distance of means that delta allows, a little less so that enlarging the answer does not exceed it
        self.distance = 2.0 * float(ndtri(0.5 * (1.0 + delta))) * (1.0 - 1e-6)
        signs = itertools.product((1.0, -1.0), repeat=len(half) - 1)
        self.vertices = [np.array([[1.0, *own]]) for own in signs]
        self.multipliers = [cp.Parameter(nonneg=True) for _ in self.vertices]
        self.squared_share = cp.Parameter(nonneg=True)
        self.programs = {uses: self._compile(uses) for uses in (False, True)}
        self.known: dict[Point, tuple[float, Answer | None]] = {}

    def _compile(self, uses_feedback: bool) -> tuple[Any, Any, Any, Any]:
        """Program with or without a feedback, and its variables."""
        cp, (d, m) = self.cp, self.B.shape
        X, worst = cp.Variable((d, d), PSD=True), cp.Variable()
        L = cp.Variable((m, d)) if uses_feedback else np.zeros((m, d))
        Q = cp.Variable((d, d)) if self.distance > 0 else np.zeros((d, d))
        moved = self.A @ X + self.B @ L - Q
        nothing, constraints = np.zeros((1, d)), []
        for v, multiplier in zip(self.vertices, self.multipliers, strict=True):
            rest = cp.reshape(1.0 - multiplier, (1, 1), order="F")
            rows = [[multiplier * X, nothing.T, moved.T], [nothing, rest, v], [moved, v.T, X]]
            constraints.append(cp.bmat(rows) >> 0)
        if uses_feedback:
            corner = cp.reshape(self.squared_share, (1, 1), order="F")
            constraints += [cp.bmat([[X, L[[j]].T], [L[[j]], corner]]) >> 0 for j in range(m)]
        if self.distance > 0:
            scaled = Q / (self.distance * self.deviations)[:, None]
            constraints.append(cp.bmat([[X, scaled.T], [scaled, np.eye(d)]]) >> 0)
        scale = np.max(np.sum(self.labels**2, axis=1))  # label shares are small numbers; the solver sees numbers near 1
        shares = [cp.sum(cp.multiply(np.outer(row, row) / scale, X)) for row in self.labels]
        constraints += [worst >= own for own in shares]
        return cp.Problem(cp.Minimize(worst + SIDE / d * sum(shares)), constraints), X, L, Q

    def cost(self, point: Point) -> float:
        """Input share plus label share of the best ellipsoid; infinite if there is none."""
        return self.solve(point)[0]

    def solve(self, point: Point) -> tuple[float, Answer | None]:
        """Cost and answer at an input share and one lambda per vertex; an inaccurate answer counts, it is verified."""
        if point in self.known:
            return self.known[point]
        share, *multipliers = point
        problem, *variables = self.programs[share > 0]
        self.squared_share.value = share**2
        for parameter, value in zip(self.multipliers, multipliers, strict=True):
            parameter.value = value
        answer = None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with contextlib.suppress(self.cp.error.SolverError):  # no answer then
                problem.solve(solver=self.cp.CLARABEL)
        values = [v if isinstance(v, np.ndarray) else v.value for v in variables]
        found = problem.status in ("optimal", "optimal_inaccurate") and values[0] is not None
        if found and np.min(np.linalg.eigvalsh(values[0])) > 0:
            X, K, F = values[0], *(np.linalg.solve(values[0], v.T).T for v in values[1:])
            answer = X * np.outer(self.units, self.units), self.room[:, None] * K / self.units, self._units(F)
        cost = np.inf if answer is None else share + float(np.sqrt(np.max(np.diag(self.labels @ X @ self.labels.T))))
        self.known[point] = cost, answer
        return cost, answer

    def _units(self, coupling: FloatArray) -> FloatArray:
        return self.units[:, None] * coupling / self.units


def _solver() -> Any:
    """The cvxpy module.

    Raises
    ------
    ValueError
        If it is not installed; it comes with the extra ``lmi``.
    """
    try:
        import cvxpy
    except ImportError as error:
        raise ValueError(
            "`relation`: expected the package cvxpy for `ellipsoid`, got none; install it with "
            '`pip install "certigym[lmi]"` or choose the relation `tube`'
        ) from error
    return cvxpy


def _best(program: _Program, shares: tuple[float, ...]) -> Answer | None:
    """The answer of least cost over a grid of shares and common lambdas, refined around the best of them."""
    n = len(program.vertices)
    tried = [(share, *[multiplier] * n) for share, multiplier in itertools.product(shares, MULTIPLIERS)]
    cost, point = min((program.cost(pair), pair) for pair in tried)
    if not np.isfinite(cost):
        return None
    moves = [np.array([0.0, *[0.05] * n]), *np.diag([0.0, *[0.05] * n])[1:]]
    if len(shares) > 1:
        moves.append(np.array([max(0.5 * point[0], 0.01), *[0.0] * n]))
    size = 1.0
    for _ in range(60):
        around = [tuple((point + sign * size * move).tolist()) for move in moves for sign in (1, -1)]
        inside = [p for p in around if 0 <= p[0] < 1 and all(0 < x < 1 for x in p[1:])]
        following = min(((program.cost(p), p) for p in inside), default=(np.inf, point))
        if following[0] < cost:
            cost, point = following
        elif size < 0.05:
            break
        else:
            size *= 0.5
    return program.solve(point)[1]


def _proved(
    agent: LinearAgent,
    coordinates: FloatArray,
    half: FloatArray,
    noise: FloatArray,
    answer: Answer,
    delta: float,
) -> Ellipsoid:
    """The smallest multiple of an answer that is proved invariant, with D scaled to the distance of outputs."""
    X, feedback, coupling = answer
    inverse = np.linalg.inv(coordinates)
    closed = inverse @ agent.A @ coordinates + inverse @ agent.B @ feedback - coupling
    outputs = agent.output_matrix @ coordinates
    farthest = float(np.sqrt(np.max(np.linalg.eigvalsh(outputs @ X @ outputs.T))))
    shape = np.linalg.inv(X) * farthest**2
    shape = 0.5 * (shape + shape.T)
    found = Ellipsoid(shape, farthest, feedback, coupling)
    smallest = _smallest(found, closed, half)
    if smallest is not None and ellipsoid_failure(shape, smallest.epsilon, coupling, noise) <= delta:
        return smallest
    raise ValueError(
        f"agent `{agent.name}`: expected an ellipsoid that can be proved invariant at `delta` = {delta:g}, got one "
        "from the solver that cannot; ask for other `cells` or another `delta`"
    )


def _smallest(found: Ellipsoid, closed: FloatArray, half: FloatArray) -> Ellipsoid | None:
    """The least epsilon, to 1e-9 of it and at most 1e-3 above the solver's, at which invariance is proved.

    Larger multiples of an invariant set are invariant too.
    """

    def holds(factor: float) -> bool:
        return ellipsoid_is_invariant(found.shape, found.epsilon * factor, closed, half)

    low, high = 0.5, 1.001
    if not holds(high):
        return None
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return replace(found, epsilon=found.epsilon * high)
