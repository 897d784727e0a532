"""Search for the ellipsoid, the feedback and the coupling of an ``ellipsoid`` relation.

A semidefinite program (``ellipsoid_program``) answers for given lambdas of its vertices, and for a given share of the
inputs or given limits on what labels lose. A coarse grid and a pattern search find the lambdas.

Unless the caller gives the share, limits are tried one after the other. Labels are judged at cell centres: a region
loses whole cells, as many as have their centre within the reach of E from its edge, so that only limits of an odd
number of half cells are worth trying. Among them the answer has the least sum of what labels lose, as a share of their
room, and ``INPUT_SHARE_PRICE`` times the input share: what labels lose is lost once, what the feedback takes from the
inputs is missing at every step.

The solver is not trusted: the smallest multiple of its answer is taken that ``ellipsoid_is_invariant`` proves
invariant.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ....envs.systems.agents import LinearAgent
from ...relations.grids import FloatArray, Grid, RelationRefused, in_grid_coordinates
from ...relations.kinds import Ellipsoid, disturbance_of, ellipsoid_failure, ellipsoid_is_invariant
from .ellipsoid_program import Answer, EllipsoidProgram

INPUT_SHARE_PRICE = 2.0
"""Weight of the input share next to the label share."""

LABEL_SHARES = (8.0, 4.0, 2.0, 1.3, 1.0, 0.9, 0.8, 0.7, 0.6, 0.55, 0.5, 0.45, 0.4, 0.35, 0.3, 0.25, 0.2, 0.17, 0.14,
                0.12, 0.1, 0.08, 0.06, 0.05, 0.04)  # fmt: skip
"""Shares of the room of labels that the ellipsoid may take, tried in turn; from 1 on, narrow regions are given up."""

FIRST_MULTIPLIERS = (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.96)
"""Values of lambda tried first, the same for all vertices: the whole range from 0 to 1, closer together near 1."""

FIRST_STEP, LAST_STEP = 0.05, 2e-3
"""Steps of the pattern search over lambdas, halved from the first to the last."""

LARGEST_FACTOR, FACTOR_PRECISION = 1.001, 1e-9
"""Largest multiple of the solver's answer that is tried for a proof, and how closely the smallest one is found."""


def find_ellipsoid(
    agent: LinearAgent,
    grid: Grid,
    coordinates: FloatArray,
    room_for_labels: FloatArray,
    delta: float = 0.0,
    snap: FloatArray | None = None,
    share: float | None = None,
) -> Ellipsoid:
    """Return a proved ellipsoid whose coupling fails with probability at most ``delta``, in grid coordinates.

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
    noise = np.diag(in_grid_coordinates(agent, coordinates).covariance)
    if delta > 0 and np.any(noise <= 0):
        raise RelationRefused(
            f"agent `{agent.name}`: `delta` > 0 needs a positive definite `noise_covariance`, got a singular one; "
            "give every state some noise or ask for `delta` = 0"
        )
    half = disturbance_of(grid, snap)
    program = EllipsoidProgram(agent, coordinates, half, room_for_labels, delta)
    if share is None:
        best = _best(program, grid, coordinates, room_for_labels)
    else:
        # The widest limits: with the share given, what labels lose is minimised.
        limits = np.full(len(half), LABEL_SHARES[0])
        best = _refined(program, float(share), limits, _coarse(program, float(share), limits))
    if best is None:
        raise RelationRefused(
            f"agent `{agent.name}`: expected a pair `A`, `B` with an ellipsoid that the inputs can keep at `delta` = "
            f"{delta:g}, got one for which none was found; ask for more `cells`, a larger `delta`, or give the agent "
            "inputs that stabilise it"
        )
    return _proved(agent, coordinates, half, noise, best, delta)


def _best(program: EllipsoidProgram, grid: Grid, coordinates: FloatArray, room: FloatArray) -> Answer | None:
    """Return the answer of least cost over all limits worth trying, its lambdas refined; None if there is no answer."""
    distinct_limits: dict[bytes, FloatArray] = {}
    for level in LABEL_SHARES:
        limits = _whole_cells(level, grid, coordinates, room)
        distinct_limits.setdefault(limits.tobytes(), limits)

    def cost(answer: Answer | None, limits: FloatArray) -> float:
        return np.inf if answer is None else INPUT_SHARE_PRICE * answer.input_share + float(np.max(limits))

    # Limits become tighter: after the first without an answer no other one has any.
    answers = []
    for limits in distinct_limits.values():
        begin = _coarse(program, None, limits)
        if begin[0] is None:
            break
        answers.append((begin, limits))
    # Refine the lambdas of the two cheapest only: each refinement solves dozens of programs.
    answers = sorted(answers, key=lambda pair: cost(pair[0][0], pair[1]))[:2]
    refined = [(_refined(program, None, limits, begin), limits) for begin, limits in answers]
    return min(refined, key=lambda pair: cost(*pair))[0] if refined else None


def _whole_cells(level: float, grid: Grid, coordinates: FloatArray, room: FloatArray) -> FloatArray:
    """Return limits (d,), as shares of ``room``: the largest odd number of half cells up to ``level``, at least one."""
    limits = np.full(len(room), level)
    for k, edges in enumerate(grid.edges):
        if np.count_nonzero(coordinates[k]) == 1:
            # Slivers between two boundaries are no measure for the cells of an axis.
            widths = np.diff(edges) * abs(coordinates[k, k])
            half = 0.5 * float(np.min(widths[widths > 0.5 * np.max(widths)])) / room[k]
            limits[k] = max(1.0, 2.0 * np.floor(0.5 * (level / half - 1.0)) + 1.0) * half
    return limits * (1.0 - 1e-5)  # a little less, so that rounding does not cost a cell


def _coarse(program: EllipsoidProgram, share: float | None, limits: FloatArray) -> tuple[Answer | None, float]:
    """Return the best answer with one lambda for all vertices, and that lambda."""
    n = len(program.vertices)
    tried = [(program.solve(share, limits, [x] * n), x) for x in FIRST_MULTIPLIERS]
    return min(tried, key=lambda pair: _objective(pair[0], share))


def _objective(answer: Answer | None, share: float | None) -> float:
    """Return what is minimised: the input share, or with that given the label share; infinite without an answer."""
    if answer is None:
        return np.inf
    return answer.input_share if share is None else answer.label_share


def _refined(
    program: EllipsoidProgram, share: float | None, limits: FloatArray, begin: tuple[Answer | None, float]
) -> Answer | None:
    """Return the best answer of a pattern search over one lambda per vertex, moved together and one by one."""
    best, multiplier = begin
    if best is None:
        return None
    point, size = np.full(len(program.vertices), multiplier), FIRST_STEP
    moves = np.unique(np.concatenate([np.ones((1, len(point))), np.eye(len(point))]), axis=0)
    while size > LAST_STEP:
        around = [p for p in (point + s * size * move for move in moves for s in (1, -1)) if np.all((0 < p) & (p < 1))]
        tried = [(program.solve(share, limits, p.tolist()), p) for p in around]
        answer, following = min(tried, key=lambda pair: _objective(pair[0], share), default=(None, point))
        # Go to the best neighbour while it is better, else look closer.
        if answer is not None and _objective(answer, share) < _objective(best, share) * (1 - 1e-6):
            best, point = answer, following
        else:
            size *= 0.5
    return best


def _proved(
    agent: LinearAgent,
    coordinates: FloatArray,
    half: FloatArray,
    noise: FloatArray,
    answer: Answer,
    delta: float,
) -> Ellipsoid:
    """Return the smallest multiple of an answer that is proved invariant, with D scaled to the distance of outputs."""
    X, feedback, coupling = answer.X, answer.feedback, answer.coupling
    moves = in_grid_coordinates(agent, coordinates)
    closed = moves.A + moves.B @ feedback - coupling
    # X = epsilon^2 D^-1: scale D such that epsilon is the largest distance of related outputs.
    outputs = agent.output_matrix @ coordinates
    farthest = float(np.sqrt(np.max(np.linalg.eigvalsh(outputs @ X @ outputs.T))))
    shape = np.linalg.inv(X) * farthest**2
    shape = 0.5 * (shape + shape.T)
    smallest = _smallest(Ellipsoid(shape, farthest, feedback, coupling), closed, half)
    if smallest is not None and ellipsoid_failure(shape, smallest.epsilon, coupling, noise) <= delta:
        return smallest
    raise RelationRefused(
        f"agent `{agent.name}`: expected an ellipsoid that can be proved invariant at `delta` = {delta:g}, got one "
        "from the solver that cannot; ask for other `cells` or another `delta`"
    )


def _smallest(ellipsoid: Ellipsoid, closed: FloatArray, half: FloatArray) -> Ellipsoid | None:
    """Return the ellipsoid with the least epsilon at which invariance is proved; None if there is no proof.

    Epsilon is found to a share of ``FACTOR_PRECISION``, and is at most ``LARGEST_FACTOR`` times the solver's. Larger
    multiples of an invariant set are invariant too, so that bisection applies.
    """

    def holds(factor: float) -> bool:
        return ellipsoid_is_invariant(ellipsoid.shape, ellipsoid.epsilon * factor, closed, half)

    low, high = 0.5, LARGEST_FACTOR
    if not holds(high):
        return None
    while high - low > FACTOR_PRECISION:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return replace(ellipsoid, epsilon=ellipsoid.epsilon * high)
