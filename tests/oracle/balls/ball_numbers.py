"""Numbers by themselves in balls: charges, tails, functions, boxes of expressions, angles, and the cell of a start."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from flint import arb, arb_mat
from numpy.typing import NDArray

from certigym.synthesis.cells import FloatArray
from certigym.synthesis.masses import AgentPart

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


def light(memory: Memory, z: FloatArray, values: FloatArray) -> Proof:
    """Tails ``exp(-z^2)`` are at most some numbers; 1 where z is not positive."""
    pairs = {*zip(np.ravel(z).tolist(), np.ravel(values).tolist(), strict=True)}
    wrong = [x for x, value in pairs if value < 1.0 and not (x > 0.0 and (-(arb(x) ** 2)).exp() <= value)]
    return len(pairs), ["the tail of a path was not proved"] if wrong else []


def long(memory: Memory, z: FloatArray, powers: FloatArray, values: FloatArray) -> Proof:
    """Powers of ``(1 + r) exp(1 - r) / 2`` with ``r^2 = 1 + 4 z^2`` are at most some numbers; 1 unless z is above 0."""
    triples = {*zip(*(np.ravel(part).tolist() for part in (z, powers, values)), strict=True)}

    def tail(x: float, power: float) -> Any:
        root = (1 + 4 * arb(x) ** 2).sqrt()
        return (arb(power) * (((1 + root) / 2).log() + 1 - root)).exp()

    wrong = [x for x, power, value in triples if value < 1.0 and not (x > 0.0 and tail(x, power) <= value)]
    return len(triples), ["the tail of a path was not proved"] if wrong else []


def moments(memory: Memory, law: Any, found: Any) -> Proof:
    """A number is off the mean of a law by no more than ``off``, and a law of a deviation is above it.

    Above its noise up to ``cut``, if it has one, which fails with a probability of at most ``lost``.
    """
    data = law.to_dict()
    if data["law"] == "student-t":
        at, least, lost = arb(0), _cut_deviation(data, found.cut), 2 * law.exact_above(arb(found.cut))
    else:
        (at, least), lost = _moments(data), arb(0)
    is_proved = abs(at - arb(found.mean)) <= found.off and least <= found.deviation and lost <= found.lost
    return 1, [] if is_proved else [f"the moments of the law `{law.name}` were not proved"]


def _cut_deviation(data: dict[str, Any], cut: float) -> Any:
    """Return a ball around the deviation of a Laplace law that is above Student's law without what exceeds ``cut``."""
    scale, df, most = arb(float(data["scale"])), arb(float(data["df"])), arb(cut)
    shares, far = scale**2 * df / ((df - 2) * most**2), 60
    # Beyond the last order the share counts as 1, and factorials alone make it smaller.
    each = [(shares / arb(2 * j + 1).gamma()) ** (arb(1) / j) for j in range(1, far)]
    each.append((1 / arb(2 * far + 1).gamma()) ** (arb(1) / far))
    return most * (2 * max(each, key=float)).sqrt()


def _moments(data: dict[str, Any]) -> tuple[Any, Any]:
    """Return balls around the mean of a law and a deviation of which it is sub-Gaussian."""
    number = {key: arb(float(value)) for key, value in data.items() if isinstance(value, int | float)}
    match data["law"]:
        case "gaussian":
            return arb(0), number["std"]
        case "uniform":
            return (number["low"] + number["high"]) / 2, (number["high"] - number["low"]) / arb(12).sqrt()
        case "triangular":
            low, mode, high = number["low"], number["mode"], number["high"]
            is_even = data["mode"] - data["low"] == data["high"] - data["mode"]
            return (low + mode + high) / 3, (high - low) / (arb(24).sqrt() if is_even else 2)
        case "truncated-gaussian":
            spread, low, high = number["spread"], number["low"], number["high"]
            half = (high - low) / 2
            if data["low"] == -data["high"]:
                return arb(0), spread if data["spread"] <= 0.5 * (data["high"] - data["low"]) else half
            a, b, root = low / spread, high / spread, arb(2).sqrt()
            share = ((b / root).erf() - (a / root).erf()) / 2
            return spread * ((-a * a / 2).exp() - (-b * b / 2).exp()) / ((2 * arb.pi()).sqrt() * share), half
        case "laplace":
            return arb(0), arb(2).sqrt() * number["scale"]
        case "logistic":
            return arb(0), arb.pi() / arb(3).sqrt() * number["scale"]
    parts = [_moments(part) for part in data["parts"]]
    weights = [arb(float(part["weight"])) for part in data["parts"]]
    means = [arb(float(part["mean"])) + own for part, (own, _) in zip(data["parts"], parts, strict=True)]
    mean = sum(w * m for w, m in zip(weights, means)) / sum(weights)
    half = (max(means, key=float) - min(means, key=float)) / 2
    widest = max((deviation for _, deviation in parts), key=float)
    return mean, (half * half + widest * widest).sqrt()


def any_of(memory: Memory, each: FloatArray, value: float) -> Proof:
    """The probability that one of several independent things happens is at most a number."""
    none, total = arb(1), arb(0)
    for x in each.tolist():
        none *= 1 - arb(x)
        total += arb(x)
    # Next to 1 a product has no digits left of tiny probabilities, and their sum is as small as a number can be.
    is_proved = value >= 1.0 or 1 - none <= value or total <= value
    return len(each), [] if is_proved else ["a probability of failing was not proved"]


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
