"""Proofs, in ball arithmetic, of what the check states: one function for every kind of statement.

Numbers of the problem and of the certificate are the doubles that they are; everything that follows from them is
computed anew with python-flint, each result being a ball that holds the true number. A function returns how many
numbers it looked at, and what is wrong in words. What laws of noise mean is said by themselves (``Law.exact_above``);
no special function of scipy or numpy is used, and what is guessed in doubles is proved.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from flint import arb, arb_mat
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ...envs.agents import AnyAgent, LinearAgent
from ..cells import FloatArray, lattice_axes
from ..certificates import AgentPart, Certificate, axis_tables, kernel_key
from ..relations import CoupledRelation, ExactRelation
from .ball_spans import balls, unproved
from .geometry import cell_boxes
from .linear_check import places_of
from .relation_check import MOST_TERMS

UNIT = 2.0**-53

READ = 1e-9
"""Share of the largest value that reading a lattice may lose to rounding: a third of what readings take off for it."""

LATEST = 10_000
"""Places whose tails are remembered."""

Balls = Any
"""Array of balls; numpy adds, multiplies and compares them as objects."""

Proof = tuple[int, list[str]]
"""Numbers that were proved, and what is wrong."""


class Memory:
    """What was proved before: which rows of tables are known, what they lack at most, and what sums may have gained."""

    def __init__(self) -> None:
        self.rows: dict[tuple[object, int], set[int]] = {}
        self.deficits: dict[tuple[object, int], Any] = {}
        self.hats: dict[object, Any] = {}
        self.sums = self.differences = 0.0

    def missing(self, agent: AnyAgent, part: AgentPart) -> Any:
        """What the rows of an agent that were proved lack at most, all axes together."""
        key = kernel_key(agent, part)
        return sum((self.deficits.get((key, k), arb(0)) for k in range(len(part.grid.shape))), arb(0))


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


# --- masses ----------------------------------------------------------------------------------------------------
class Normal:
    """The normal law with a deviation that is a ball; tails near each other are read from one of them.

    With ``|h| <= 2^-31``, Q the tail and p the density, ``Q(c + h) = Q - p (h - c h^2 / 2)`` up to ``|D^2 p| |h|^3 /
    6`` in between, and ``p(c + h) = p (1 - c h + (c^2 - 1) h^2 / 2)`` up to ``|D^3 p| |h|^3 / 6``; p grows by less than
    twice.
    """

    def __init__(self, deviation: Any) -> None:
        self.deviation, self.known = deviation, dict[int, tuple[Any, Any, Any]]()
        self.latest = dict[int, tuple[Any, Any, Any]]()

    def _near(self, x: Any) -> tuple[Any, Any]:
        """Tail and density at ``|x|``, in deviations; the same ball is often asked about again."""
        if id(x) in self.latest:
            return self.latest[id(x)][1:]
        at = abs(x) / self.deviation
        number = round(math.ldexp(float(at), 30))
        if number not in self.known:
            c = arb(number) / 2**30
            self.known[number] = c, (c / arb(2).sqrt()).erfc() / 2, (-c * c / 2).exp() / (2 * arb.pi()).sqrt()
        c, tail, density = self.known[number]
        h = at - c
        square, end = h * h / 2, abs(h) + c
        off = (2 * density * abs(h) * square / 3).upper() * arb(0, 1)
        tail = tail - density * (h - c * square) + off * (end * end + 1)
        density = density * (1 - c * h + (c * c - 1) * square) + off * end * (end * end + 3)
        if len(self.latest) > LATEST:
            self.latest.clear()
        self.latest[id(x)] = x, tail, density  # x is kept, so that no other ball has its number
        return tail, density

    def exact_above(self, x: Any) -> Any:
        """Probability of more than x."""
        tail = self._near(x)[0]
        if x > 0:
            return tail
        return 1 - tail if x < 0 else tail.union(1 - tail)

    def exact_below(self, x: Any) -> Any:
        """Probability of at most x."""
        return self.exact_above(-x)

    def exact_mean(self, a: Any, b: Any) -> Any:
        """Expectation between a and b."""
        return self.deviation * (self._near(a)[1] - self._near(b)[1])


def _laws(agent: AnyAgent, part: AgentPart) -> list[Any]:
    """The law of the noise along every grid axis; deviations of normal ones are balls."""
    if agent.laws is not None:
        return list(agent.laws)
    inverse = np.array(arb_mat(part.coordinates.tolist()).inv().tolist(), dtype=object)
    variances = np.diag(inverse @ balls(agent.noise_covariance) @ inverse.T)
    return [Normal(variance.sqrt()) for variance in variances]


def masses(memory: Memory, agent: AnyAgent, part: AgentPart, tables: Sequence[FloatArray]) -> Proof:
    """Masses of cells are below the truth, in all rows that a policy reads; how much rows lack is remembered."""
    key, used = kernel_key(agent, part), _used(part)
    points = dict(zip(((axis.kind, axis.state) for axis in lattice_axes(agent)), part.lattice, strict=True))
    total, failures = 0, []
    for k, (law, edges, table) in enumerate(zip(_laws(agent, part), part.grid.edges, tables, strict=True)):
        known = memory.rows.setdefault((key, k), set())
        asked = range(len(table)) if used is None else used[k].tolist()
        new = [row for row in asked if row not in known]
        known.update(new)
        if ("cell", k) in points:
            wrong = [r for r in new if not np.array_equal(table[r], points["cell", k][r] == np.arange(len(edges) - 1))]
            failures += ["a state without noise moves to another cell than its mean"] if wrong else []
            continue
        means = points["mean", k].tolist()
        scales = [arb(x).exp() for x in points["scale", k].tolist()] if ("scale", k) in points else [arb(1)]
        sides = [arb(edge) for edge in edges.tolist()]
        for row in new:
            scale, mean = scales[row // len(means)], arb(means[row % len(means)])
            count, deficit = _row(law, [(side - mean) / scale for side in sides], table[row].tolist())
            total += count
            if deficit is None:
                failures.append(f"a cell mass of agent `{agent.name}` along axis {k} was not proved")
                break
            memory.deficits[key, k] = max(memory.deficits.get((key, k), arb(0)), deficit.upper())
    return total, failures


def _used(part: AgentPart) -> list[NDArray[np.int64]] | None:
    """Lattice points of every axis that policies read; None if they read between them."""
    if not part.is_additive:
        return None
    points = np.concatenate([np.unique(part.points(t, q)) for t in range(len(part.policy))
                             for q in range(part.policy.shape[1])])  # fmt: skip
    index = np.unravel_index(np.unique(points[points >= 0]), part.lattice_shape)
    return [np.unique(axis) for axis in index]


def _row(law: Any, x: Sequence[Any], row: Sequence[float]) -> tuple[int, Any]:
    """How many masses of a row are not 0, and what all of them lack; None if one may be above the truth."""
    tails, total, count = _Tails(law, x), arb(0), 0
    for s, mass in enumerate(row):
        if mass != 0.0:
            count, total = count + 1, total + mass
            if not mass <= tails.between(s, s + 1):
                return count, None
    return count, tails.between(0, len(x) - 1) - total


class _Tails:
    """Tails of a law at increasing places, computed when they are asked for, each on the side where it is small."""

    def __init__(self, law: Any, x: Sequence[Any]) -> None:
        self.law, self.x, self.known = law, x, dict[int, tuple[bool, Any]]()

    def _at(self, k: int) -> tuple[bool, Any]:
        if k not in self.known:
            right = bool(self.x[k] > 0)
            self.known[k] = right, self.law.exact_above(self.x[k]) if right else self.law.exact_below(self.x[k])
        return self.known[k]

    def between(self, a: int, b: int) -> Any:
        """Probability between two places."""
        (first, left), (last, right) = self._at(a), self._at(b)
        if first == last:
            return left - right if first else right - left
        return 1 - left - right


def lost(memory: Memory, agent: AnyAgent, part: AgentPart, value: float) -> Proof:
    """What rows of masses lack is no more than is said."""
    count, failures = masses(memory, agent, part, axis_tables(agent, part, {}))
    if not memory.missing(agent, part) <= value:
        failures.append(f"masses of agent `{agent.name}` lack more than is said")
    return count, failures


def spare(memory: Memory, certificate: Certificate, value: float) -> Proof:
    """Undecided mass, which is pushed forward by masses from below, lacks no more than is said, at any time."""
    missing = arb(0)
    for agent, part in zip(certificate.problem.agents, certificate.agents, strict=True):
        missing += memory.missing(agent, part)
    total = certificate.problem.horizon * missing + arb(_gamma(_operations(certificate)))
    return 1, [] if total <= value else ["the undecided mass lacks more than is said"]


def hats(memory: Memory, agent: AnyAgent, part: AgentPart, tables: Sequence[FloatArray], value: float) -> Proof:
    """Masses of both hats of every cell are below the truth, and rows lack no more than is said."""
    # Agents with equal noise and cells have equal tables.
    key = (kernel_key(agent, part), *(table.tobytes() for table in tables))
    if key in memory.hats:
        return 0, [] if memory.hats[key] <= value else [f"hats of agent `{agent.name}` lack more than is said"]
    count, missing = 0, arb(0)
    for law, edges, axis, table in zip(_laws(agent, part), part.grid.edges, part.lattice, tables, strict=True):
        sides, worst = [arb(edge) for edge in edges.tolist()], arb(0)
        widths = [b - a for a, b in itertools.pairwise(sides)]
        for mean, row in zip(axis.tolist(), table.reshape(len(axis), -1, 2).tolist(), strict=True):
            tails, x = _Tails(law, [side - arb(mean) for side in sides]), [side - arb(mean) for side in sides]
            whole = tails.between(0, len(x) - 1)
            for s, (left, right) in enumerate(row):
                if left == 0.0 and right == 0.0:
                    continue
                mass = tails.between(s, s + 1)
                above = (law.exact_mean(x[s], x[s + 1]) - x[s] * mass) / widths[s]
                count, whole = count + 2, whole - left - right
                if not ((left == 0.0 or left <= mass - above) and (right == 0.0 or right <= above)):
                    return count, [f"a mass of a hat of agent `{agent.name}` was not proved"]
            worst = max(worst, whole.upper())
        missing += worst
    memory.deficits[kernel_key(agent, part), 0] = memory.hats[key] = missing
    return count, [] if missing <= value else [f"hats of agent `{agent.name}` lack more than is said"]


def near(memory: Memory, points: Any, variances: Any, box: Any, from_below: bool, bounds: FloatArray) -> Proof:
    """Probabilities that two agents are near, with room for the rounding of their states and of the difference."""
    (mine, theirs), (low, high) = points, box
    law = Normal(sum((arb(own) for own in variances), arb(0)).sqrt())
    size = float(np.abs(mine).max() + np.abs(theirs).max() + abs(low) + abs(high))
    wider = arb(1e-14) * size * (-1 if from_below else 1)
    for z, row in zip(mine.tolist(), bounds.tolist(), strict=True):
        for other, bound in zip(theirs.tolist(), row, strict=True):
            gap = arb(z) - arb(other)
            if bound == (0.0 if from_below else 1.0):
                continue
            truth = _Tails(law, [low - wider - gap, high + wider - gap]).between(0, 1)
            if not (bound <= truth if from_below else truth <= bound):
                return bounds.size, ["a probability that two agents are near was not proved"]
    return bounds.size, []


# --- numbers ---------------------------------------------------------------------------------------------------
def charge(memory: Memory, exact: Callable[..., Any], law: Any, step: float, value: float) -> Proof:
    """What interpolation adds: the same formula in balls."""
    return 1, [] if value == math.inf or exact(law, step, Functions()) <= value else [
        f"a charge of {law} was not proved"
    ]


def error_function(memory: Memory, x: float, value: float) -> Proof:
    """The error function is at most a number."""
    return 1, [] if arb(float(x)).erf() <= value else ["a distance between two normal laws was not proved"]


def tails(memory: Memory, z: FloatArray, values: FloatArray) -> Proof:
    """Tails ``erfc(z) / 2`` are at most some numbers; without noise they are 0, or 1."""
    pairs = {*zip(np.ravel(z).tolist(), np.ravel(values).tolist(), strict=True)}
    wrong = [x for x, value in pairs if value < 1.0 and x != math.inf and not arb(x).erfc() / 2 <= value]
    return len(pairs), ["the tail of a path was not proved"] if wrong else []


def any_of(memory: Memory, each: FloatArray, value: float) -> Proof:
    """The probability that one of several independent things happens is at most a number."""
    none = arb(1)
    for x in each.tolist():
        none *= 1 - arb(x)
    return len(each), [] if value >= 1.0 or 1 - none <= value else ["a probability of failing was not proved"]


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


def start(memory: Memory, part: AgentPart, at: FloatArray, points: FloatArray, own: NDArray[np.bool_]) -> Proof:
    """A start is in the cell that it is taken to be in; coordinates that are states are read as they are."""
    exact = np.array(arb_mat(part.coordinates.tolist()).inv().tolist(), dtype=object) @ balls(at)
    for edges, x, point, is_state in zip(part.grid.edges, exact, points.tolist(), own.tolist(), strict=True):
        k = int(np.searchsorted(edges, point, side="right"))
        if not is_state and np.any(at) and not ((k == 0 or edges[k - 1] < x) and (k == len(edges) or x < edges[k])):
            return len(points), ["the cell of a start was not proved"]
    return len(points), []


# --- relations -------------------------------------------------------------------------------------------------
def aims(memory: Memory, agent: LinearAgent, part: AgentPart, relation: ExactRelation, off: FloatArray) -> Proof:
    """Means ``A x + B (R (z - d - A_r x) + mid) + c`` miss z by no more than is said."""
    C = balls(part.coordinates)
    inverse = np.array(arb_mat(part.coordinates.tolist()).inv().tolist(), dtype=object)
    A, B, c = inverse @ balls(agent.A) @ C, inverse @ balls(agent.B), inverse @ balls(agent.offset)
    A_r, R = balls(relation.A), balls(relation.right_inverse)
    drift, middle = balls(relation.drift), balls(relation.input_centre)
    x = balls([max(abs(edges[0]), abs(edges[-1])) for edges in part.grid.edges])
    z = balls([np.max(np.abs(axis)) for axis in part.lattice])
    asked = abs(R) @ (z + abs(drift) + abs(A_r) @ x) + abs(middle)
    # A quarter of what is charged for rounding is left for computing this in doubles.
    moved, unit = B @ R, arb((3 * sum(agent.B.shape) + 12) * UNIT)
    missed = abs(A - moved @ A_r) @ x + abs(moved - balls(np.eye(len(off)))) @ z + abs(c + B @ middle - moved @ drift)
    missed = missed + unit * (abs(A) @ x + abs(B) @ asked + abs(c) + z)
    right = all(own <= most for own, most in zip(missed, off.tolist(), strict=True))
    return len(off), [] if right else [f"what the targets of agent `{agent.name}` are missed by was not proved"]


def targets(
    memory: Memory, agent: LinearAgent, part: AgentPart, relation: ExactRelation, choices: Any, rounding: FloatArray
) -> Proof:
    """Every target of every cell takes inputs of the box only, from all points of the cell."""
    A = balls(relation.A) - balls(relation.gain * np.eye(agent.n_states))
    A_r, R = balls(relation.A), balls(relation.right_inverse)
    points, rows = int(np.prod(part.lattice_shape)), choices.reshape(-1, choices.shape[-1]).astype(np.int64)
    cell, target = np.divmod(np.unique((rows + np.arange(rows.shape[1]) * points)[rows >= 0]), points)
    low, high = map(balls, cell_boxes(part))
    centre, half = (low + high) / 2, (high - low) / 2
    base = balls(relation.input_centre) - (centre @ A_r.T + balls(relation.drift)) @ R.T
    spread = half @ abs(R @ A).T + balls(rounding)
    places = zip(part.lattice, np.unravel_index(target, part.lattice_shape), strict=True)
    # Targets are few along each axis: what they add to inputs is the sum of what their coordinates add.
    moved: Balls = 0
    for (axis, k), column in zip(places, R.T, strict=True):
        moved = moved + np.array([own * column for own in balls(axis)] or [column])[k]
    inputs = base[cell] + moved
    inside = (inputs - spread[cell] >= balls(agent.input_box.low)) & (
        inputs + spread[cell] <= balls(agent.input_box.high)
    )
    return len(cell), [] if np.all(inside) else [f"agent `{agent.name}` is asked for inputs beyond its input box"]


def disturbance(
    memory: Memory, part: AgentPart, relation: CoupledRelation, rounding: FloatArray, value: FloatArray
) -> Proof:
    """Half the widest cell, what means are snapped by, and rounding."""
    assert part.menu is not None
    low, high = map(balls, cell_boxes(part))
    stays = (low + high) / 2 @ balls(relation.A).T + balls(relation.drift)
    moves, index = balls(relation.inputs) @ balls(relation.B).T, np.unravel_index(part.menu, part.lattice_shape)
    right = True
    for k, (axis, places) in enumerate(zip(part.lattice, index, strict=True)):
        room = arb(value[k]) - arb(rounding[k]) - max((high - low)[:, k]) / 2
        off = abs(balls(axis)[places] - stays[:, None, k] - moves[None, :, k])
        right &= bool(np.all(off <= room))
    return part.menu.size, [] if right else ["what a coupled state is pushed by was not proved"]


def tube(memory: Memory, relation: CoupledRelation, half: FloatArray, rows: FloatArray, value: FloatArray) -> Proof:
    """Supports of an invariant zonotope, by the sum of its first powers over what is left of the next one."""
    closed, forms = balls(relation.A) + balls(relation.B) @ balls(relation.feedback), balls(rows)
    width, open_rows = balls(half), [*range(len(rows))]
    power, total = np.diag(width) * arb(1), forms[:, 0] * 0
    for _ in range(MOST_TERMS):
        total = total + abs(forms @ power).sum(axis=1)
        power = closed @ power
        alpha = max(own.upper() for own in abs(power).sum(axis=1) / width)
        if alpha < 1:
            open_rows = [k for k in open_rows if not total[k] / (1 - alpha) <= value[k]]
        if not open_rows:
            return len(rows), []
    return len(rows), [] if not np.all(np.isfinite(value)) else ["a tube was not proved invariant"]


def ellipsoid_support(memory: Memory, shape: FloatArray, epsilon: float, rows: FloatArray, value: FloatArray) -> Proof:
    """Supports of an ellipsoid: ``epsilon sqrt(row D^-1 row')``."""
    inverse = np.array(arb_mat(shape.tolist()).inv().tolist(), dtype=object)
    squares = [row @ inverse @ row for row in balls(rows)]
    right = all(arb(epsilon) ** 2 * s <= arb(v) ** 2 for s, v in zip(squares, value.tolist(), strict=True))
    return len(rows), [] if right else ["how far an ellipsoid reaches was not proved"]


def ellipsoid(
    memory: Memory, relation: CoupledRelation, half: FloatArray, variances: FloatArray, value: float
) -> Proof:
    """An ellipsoid is invariant (S-lemma), and its coupling fails with at most some probability."""
    assert relation.shape is not None
    D, d = balls(relation.shape), len(relation.shape)
    closed = balls(relation.A) + balls(relation.B) @ balls(relation.feedback) - balls(relation.coupling)
    square, epsilon, failures = closed.T @ D @ closed, arb(relation.epsilon), []
    for signs in itertools.product((1.0, -1.0), repeat=d - 1):
        vertex = balls(half * np.array([1.0, *signs]))
        cross, corner = closed.T @ D @ vertex, epsilon**2 - vertex @ D @ vertex
        if not _is_mapped_inside(D, square, cross, corner, epsilon):
            failures.append("an ellipsoid was not proved invariant")
            break
    if np.any(relation.coupling) and value < 1.0:
        # With a distance r whose error function is below the value: r^2 D - epsilon^2 F' Sigma^-1 F is not negative.
        distance = _distance(value)
        moved = balls(relation.coupling).T @ np.diag(1 / balls(variances)) @ balls(relation.coupling)
        if not _is_positive(distance**2 * D - epsilon**2 * moved):
            failures.append("how often a coupling fails was not proved")
    return 2 ** (d - 1), failures


def _is_mapped_inside(D: Balls, square: Balls, cross: Balls, corner: Any, epsilon: Any) -> bool:
    """Whether ``lambda (epsilon^2 - e'De) <= epsilon^2 - (M e + v)'D(M e + v)`` for all e, with some lambda >= 0."""

    def matrix(share: float) -> Balls:
        result = np.empty((len(D) + 1, len(D) + 1), dtype=object)
        result[:-1, :-1] = share * D - square
        result[:-1, -1] = result[-1, :-1] = -cross
        result[-1, -1] = corner - arb(share) * epsilon**2
        return result

    def smallest(share: float) -> float:
        # Scaled to a unit diagonal of the ellipsoid: only a guess, which is proved below.
        scale = np.array([*(1.0 / math.sqrt(float(own)) for own in np.diag(D)), 1.0 / float(epsilon)])
        return -float(np.linalg.eigvalsh(np.vectorize(float)(matrix(share)) * np.outer(scale, scale))[0])

    share = float(minimize_scalar(smallest, bounds=(0.0, 1.0), method="bounded", options={"xatol": 1e-12}).x)
    return _is_positive(matrix(share))


def _is_positive(matrix: Balls) -> bool:
    """Whether a symmetric matrix of balls is positive definite: all pivots of its elimination are."""
    matrix = matrix.copy()
    for k in range(len(matrix)):
        if not matrix[k, k] > 0:
            return False
        for i in range(k + 1, len(matrix)):
            matrix[i, k:] = matrix[i, k:] - matrix[k, k:] * (matrix[i, k] / matrix[k, k])
    return True


def _distance(value: float) -> Any:
    """A number r with ``erf(r / sqrt 8) <= value``, nearly the largest one."""
    low, high = arb(0), arb(40)
    for _ in range(100):
        middle = ((low + high) / 2).mid()
        low, high = (middle, high) if (middle / arb(8).sqrt()).erf() <= value else (low, middle)
    return low


# --- sums ------------------------------------------------------------------------------------------------------
def _operations(certificate: Certificate) -> int:
    """Operations that any number of a value, or of a mass, goes through from one end of the horizon to the other."""
    total, horizon = len(certificate.agents) + max(certificate.rank, len(certificate.start_target)) + 1000, 0
    for part in certificate.agents:
        total += places_of(part) + 8 * len(part.grid.shape)  # its start
        horizon += _smoothed(part)
    for step in certificate.skeleton:
        total += 2 * max((len(merges.into) for merges in step.merges), default=0)
        total += max((len(kept) for kept in step.kept), default=0)
    return total + certificate.problem.horizon * horizon


def _smoothed(part: AgentPart) -> int:
    """Operations of a step of one agent: its tables, and reading between lattice points."""
    sides = 2 if part.is_linear else 1
    return sum(sides * n + 2 for n in part.grid.shape) + 64 * 2 ** len(part.grid.shape)


def _gamma(count: int) -> float:
    return count * UNIT / (1.0 - count * UNIT) * (1.0 + 1e-9)


def sums(memory: Memory, certificate: Certificate, recomputed: float, loss: float) -> Proof:
    """What the sums and products of a value may have gained by rounding is remembered; readings lose what they allow.

    All numbers are nonnegative, so that each is off by ``gamma(n) = n u / (1 - n u)`` of its size after n operations.
    Trains carry what they are off by; their start is read with fewer operations than are counted.
    """
    failures = []
    for agent, part in zip(certificate.problem.agents, certificate.agents, strict=True):
        if not part.is_additive:
            d, reach = len(part.grid.shape), max(part.relation.get("reach", [1]))
            axes = [(axis, (axis[-1] - axis[0]) / (len(axis) - 1)) for axis in part.lattice]
            places = max(float(np.abs(axis).max() / step) + len(axis) for axis, step in axes)
            # Values, second differences with the weights of steps of up to ``reach``, and positions between points.
            step, missing = 2.0 * reach / part.relation.get("parts", 1), float(memory.missing(agent, part).upper())
            weights = d * d * (1.0 + step * step)
            # Boxes take off what rows lack, of which second differences of neighbours need a quarter per axis.
            lacking = missing * (weights if part.is_linear else max(0.0, 0.25 * d - 1.0))
            off = _gamma(_smoothed(part)) * (2.0 + weights) + lacking
            if off + 64 * d * UNIT * (places + 1) > READ:
                failures.append(f"agent `{agent.name}` is read on a lattice with more rounding than is allowed for")
    memory.sums = max(memory.sums, _gamma(_operations(certificate)) * (recomputed + loss))
    return 1, failures


def differences(memory: Memory, base: Certificate, pairs: int, factor: float) -> Proof:
    """Sums that charge pairs are off by less than a factor; what differences of masses may gain is remembered."""
    # The masses of a pair are summed, and summed against tables; both are taken from one another.
    lattice = max(int(np.prod(part.lattice_shape)) + sum(part.lattice_shape) for part in base.agents)
    # At every time masses of all products sum to 1 at most, for every pair.
    memory.differences += 3.0 * base.problem.horizon * pairs * _gamma(lattice + 16)
    gained = _gamma(_operations(base) + 4 * lattice)
    return 1, [] if 1.0 + gained <= factor else ["sums of masses of pairs round more than is allowed for"]


PROOFS: dict[str, Callable[..., Proof]] = {
    "masses": masses, "lost": lost, "hats": hats, "near": near, "charge": charge, "erf": error_function,
    "tails": tails, "any": any_of, "function": function, "spans": spans, "aims": aims, "targets": targets,
    "disturbance": disturbance, "tube": tube, "ellipsoid support": ellipsoid_support, "ellipsoid": ellipsoid,
    "spare": spare, "angles": angles, "start": start, "sums": sums, "differences": differences,
}  # fmt: skip
"""By the names of statements."""
