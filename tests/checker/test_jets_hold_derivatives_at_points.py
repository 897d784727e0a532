"""Jets of the checker hold values, slopes, second derivatives, and the distance from a linear function on a box.

Random expressions are computed at points with the derivatives of each operation, in extended precision, by a program of
its own. Points are corners, faces and inner ones; kinks and ties of two arguments are among them.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest

from certigym.synthesis.checker import jets
from certigym.synthesis.checker.error_system import Seen
from certigym.synthesis.checker.expressions import Tree
from certigym.synthesis.checker.intervals import add, interval
from certigym.synthesis.checker.jets import Jet, off_linear
from kinds import mostly_thorough

Long = np.longdouble
NAMES = ("x", "y", "u")
BOXES, POINTS = 10, 30

Derivatives = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Value (P,), slopes (3, P) and second derivatives (3, 3, P) at points."""

NUMBERS = (0.0, 1.0, 2.0, -1.0, 0.5, -3.0, 10.0, 1e-3)
EXPONENTS = (2.0, 3.0, 4.0, 5.0, -1.0, -2.0, 0.5, 1.5, 0.0, 1.0, 2.5, -0.5)
FUNCTIONS = ("sin", "cos", "exp", "log", "sqrt", "tan", "tanh", "atan", "abs")


def random_tree(rng: np.random.Generator, depth: int) -> Tree:
    r = rng.random()
    if depth == 0 or r < 0.12:
        return str(rng.choice(NAMES)) if rng.random() < 0.8 else float(rng.choice([*NUMBERS, rng.normal()]))
    kind = rng.random()
    if kind < 0.5:
        return (str(rng.choice(("+", "-", "*", "/"))), random_tree(rng, depth - 1), random_tree(rng, depth - 1))
    if kind < 0.6:
        return (str(rng.choice(("min", "max"))), random_tree(rng, depth - 1), random_tree(rng, depth - 1))
    if kind < 0.69:
        return ("**", random_tree(rng, depth - 1), float(rng.choice(EXPONENTS)))
    if kind < 0.72:
        return ("negative", random_tree(rng, depth - 1))
    return (str(rng.choice(FUNCTIONS)), random_tree(rng, depth - 1))


def chained(x: Derivatives, value: np.ndarray, first: np.ndarray, second: np.ndarray) -> Derivatives:
    return value, first * x[1], first * x[2] + second * x[1][:, None] * x[1][None]


def product(x: Derivatives, y: Derivatives) -> Derivatives:
    cross = x[1][:, None] * y[1][None]
    return x[0] * y[0], x[0] * y[1] + y[0] * x[1], x[0] * y[2] + y[0] * x[2] + cross + cross.swapaxes(0, 1)


def raised(x: Derivatives, p: float) -> Derivatives:
    v, q = x[0], Long(p)

    def power(e: np.longdouble) -> np.ndarray:
        return np.ones_like(v) if e == 0 else v**e

    first = q * power(q - 1) if p else 0 * v
    return chained(x, power(q), first, q * (q - 1) * power(q - 2) if p not in (0.0, 1.0) else 0 * v)


def smooth(name: str, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A function and its derivatives."""
    match name:
        case "sin":
            return np.sin(v), np.cos(v), -np.sin(v)
        case "cos":
            return np.cos(v), -np.sin(v), -np.cos(v)
        case "exp":
            return np.exp(v), np.exp(v), np.exp(v)
        case "log":
            return np.log(v), 1 / v, -1 / v**2
        case "sqrt":
            return np.sqrt(v), 0.5 / np.sqrt(v), -0.25 / np.sqrt(v) ** 3
        case "tan":
            return np.tan(v), 1 + np.tan(v) ** 2, 2 * np.tan(v) * (1 + np.tan(v) ** 2)
        case "tanh":
            return np.tanh(v), 1 - np.tanh(v) ** 2, -2 * np.tanh(v) * (1 - np.tanh(v) ** 2)
        case "atan":
            return np.arctan(v), 1 / (1 + v * v), -2 * v / (1 + v * v) ** 2
    assert name == "abs"
    # at a kink there is no slope: chords are asked elsewhere
    return np.abs(v), np.where(v == 0, np.nan, np.sign(v)), 0 * v


def at_points(tree: Tree, leaves: dict[str, Derivatives]) -> Derivatives:
    """A tree and its derivatives at points."""
    if isinstance(tree, str):
        return leaves[tree]
    if isinstance(tree, float):
        v = leaves["x"][0]
        return np.full_like(v, Long(tree)), np.zeros((3, len(v)), Long), np.zeros((3, 3, len(v)), Long)
    name, *arguments = tree
    x = at_points(arguments[0], leaves)
    if name == "**":
        return raised(x, float(arguments[1]))
    if name == "negative":
        return -x[0], -x[1], -x[2]
    if len(arguments) == 1:
        return chained(x, *smooth(str(name), x[0]))
    y = at_points(arguments[1], leaves)
    if name in ("+", "-"):
        sign = 1 if name == "+" else -1
        return x[0] + sign * y[0], x[1] + sign * y[1], x[2] + sign * y[2]
    if name == "*":
        return product(x, y)
    if name == "/":
        return product(x, raised(y, -1.0))
    first, tie = (x[0] >= y[0] if name == "max" else x[0] <= y[0]), x[0] == y[0]
    slope = np.where(tie & (x[1] != y[1]), np.nan, np.where(first, x[1], y[1]))
    return np.where(first, x[0], y[0]), slope, np.where(tie, np.nan, np.where(first, x[2], y[2]))


def points_of(tree: Tree, at: np.ndarray) -> Derivatives:
    """A tree at points (3, N, P): value (N, P), slopes (3, N, P), second derivatives (3, 3, N, P)."""
    flat = at.reshape(3, -1)
    unit = np.eye(3, dtype=Long)
    leaves: dict[str, Derivatives] = {
        name: (flat[k], np.repeat(unit[k][:, None], flat.shape[1], 1), np.zeros((3, 3, flat.shape[1]), Long))
        for k, name in enumerate(NAMES)
    }
    value, slope, bend = at_points(tree, leaves)
    shape = at.shape[1:]
    return value.reshape(shape), slope.reshape(3, *shape), bend.reshape(3, 3, *shape)


def in_a_box(ends: np.ndarray) -> Seen:
    """Errors of which no more is known than their box (2, d)."""
    return Seen(ends, None, lambda rows: np.zeros((2, len(rows))))


class Boxes:
    """Boxes (2, 3, N) around 0 at centres (3, N), whose input follows the states, and points (3, N, P) in them."""

    def __init__(self, rng: np.random.Generator) -> None:
        N, P = BOXES, POINTS
        self.centre = rng.choice([0.0, 1.0, 0.5, -1.0, 2.0, 3.0], (3, N)) + rng.choice([0.0, 1.0], (3, N)) * rng.normal(
            size=(3, N)
        )
        width = 10.0 ** rng.uniform(-8, 0.5, (3, N)) * rng.choice([0.0, 1.0], (3, N), p=[0.1, 0.9])
        low, high = (width * rng.choice([0.0, 1.0, 0.5], (3, N)) for _ in range(2))
        low = -low
        self.gain, self.off = rng.normal(size=2), float(10.0 ** rng.uniform(-12, -1) * rng.choice([0.0, 1.0]))
        corners = [self.gain[k] * np.stack([low[k], high[k]]) for k in (0, 1)]
        low[2] = corners[0].min(axis=0) + corners[1].min(axis=0) - self.off
        high[2] = corners[0].max(axis=0) + corners[1].max(axis=0) + self.off
        spare = 1e-15 + 1e-14 * np.abs(np.stack([low[2], high[2]]))
        low[2], high[2] = low[2] - spare[0], high[2] + spare[1]
        self.box = np.stack([low, high])
        share = rng.random((2, N, P))
        share = np.where(rng.random((2, N, P)) < 0.5, np.rint(share), share)
        ends = self.box[:, :2, :, None].astype(Long)
        e = np.clip(ends[0] + (ends[1] - ends[0]) * share, ends[0], ends[1])
        offset = np.where(rng.random((N, P)) < 0.5, rng.choice([-1.0, 1.0], (N, P)), rng.uniform(-1, 1, (N, P)))
        follows = Long(self.gain[0]) * e[0] + Long(self.gain[1]) * e[1] + Long(self.off) * offset
        self.e = np.concatenate([e, follows[None]])

    def followed(self, centre: Jet, around: Jet, row: np.ndarray) -> np.ndarray:
        """What is left of the row, box by box, where the third variable follows the others."""
        transform, off = np.array([[1.0, 0.0], [0.0, 1.0], self.gain]), np.array([0.0, 0.0, self.off])
        found = []
        for n in range(BOXES):
            some, box = slice(n, n + 1), self.box[..., n]
            bounded = partial(in_a_box(box[:, :2]).followed, np.eye(2, dtype=bool), transform, off, box, [0, 1])
            found.append(off_linear(centre.of(some), around.of(some), self.box[..., some], row[:, some], bounded))
        return np.concatenate(found, axis=1)

    def jets(self, tree: Tree) -> tuple[Jet, Jet]:
        """At the centres, and on the boxes."""
        found = []
        for around in (0.0 * self.box, self.box):
            leaves = {
                name: Jet.variable(
                    add(interval(self.centre[k]), around[:, k]), np.repeat(np.eye(3)[k][:, None], BOXES, 1)
                )
                for k, name in enumerate(NAMES)
            }
            found.append(jets.jet(tree, leaves, {}))
        return found[0], found[1]


def outside(values: np.ndarray, ends: np.ndarray, spare: Any) -> np.ndarray:
    """Which values (.., N, P) are not between ends (2, .., N), which say nothing where they are nan."""
    low, high = (end[..., None].astype(Long) for end in ends)
    known = ~np.isnan(low) & ~np.isnan(high) & np.isfinite(values)
    return np.asarray(known & ((values < low - spare) | (values > high + spare)))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@mostly_thorough("seed", range(3))
def test_random_expressions_stay_within_their_jets(seed: int) -> None:
    rng = np.random.default_rng(seed)
    known = dict.fromkeys(("value", "slope", "bend", "rest", "followed"), 0)
    for _ in range(200):
        tree = random_tree(rng, int(rng.integers(1, 5)))
        boxes = Boxes(rng)
        centre, around = boxes.jets(tree)
        value, slope, bend = points_of(tree, boxes.centre[:, :, None].astype(Long) + boxes.e)
        middle, _, _ = points_of(tree, boxes.centre[:, :, None].astype(Long))
        size = np.abs(np.nan_to_num(np.stack([value, middle + 0 * value]), posinf=0, neginf=0)).max(axis=0)
        # long doubles are off by some 1e-19 of the numbers inside
        assert not outside(value, around.value, 1e-16 * (1e-2 + size)).any(), tree
        assert not undefined(value, around.value).any(), tree
        steep = np.nan_to_num(np.abs(slope), posinf=0).max(axis=(0, 1, 2)) if slope.size else 0.0
        assert not outside(slope, around.slope, 1e-15 * (1.0 + steep)).any(), tree
        sharp = np.nan_to_num(np.abs(bend), posinf=0).max(axis=(0, 1, 2, 3)) if bend.size else 0.0
        assert not outside(bend, around.bend, 1e-14 * (1.0 + sharp)).any(), tree
        row = 0.5 * (centre.slope[0] + centre.slope[1])
        moved = row.astype(Long)[:, :, None] * boxes.e
        rest = value - middle - moved.sum(axis=0)
        inner = np.nan_to_num(np.abs(slope * (1 + np.abs(boxes.centre[:, :, None]) + np.abs(boxes.e))), posinf=0).sum(
            axis=0
        )
        spare = 1e-17 * (1.0 + size + np.nan_to_num(np.abs(moved)).sum(axis=0) + inner)
        defined = ~np.isnan(centre.value).any(axis=0) & np.isfinite(row).all(axis=0)
        rests = {"rest": off_linear(centre, around, boxes.box, row), "followed": boxes.followed(centre, around, row)}
        for key, left in rests.items():
            ends = np.where(defined, left, np.nan)
            assert not outside(rest, ends, spare).any(), (key, tree)
            assert not undefined(rest, ends).any(), (key, tree)
            known[key] += int((~np.isnan(ends).any(axis=0)).sum())
        for key, ends in (("value", around.value), ("slope", around.slope), ("bend", around.bend)):
            known[key] += int((~np.isnan(ends).any(axis=0)).sum())
    assert min(known.values()) > 700, known


def undefined(values: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Where a bounded enclosure is given of what has no value at a point."""
    bounded = np.all(np.isfinite(ends), axis=0)[..., None]
    return np.asarray(bounded & np.isnan(values))


def jet_on(tree: Tree, x: tuple[float, float], y: tuple[float, float] = (0.0, 0.0)) -> Jet:
    leaves = {
        name: Jet.variable(interval(np.array([a]), np.array([b])), np.eye(2)[k][:, None])
        for k, (name, (a, b)) in enumerate({"x": x, "y": y}.items())
    }
    return jets.jet(tree, leaves, {})


def test_difference_quotients_lie_between_slopes_at_kinks_and_ties() -> None:
    """Slopes of all chords, also from a kink, are in the hull that is returned; second derivatives are unknown."""
    kinked: list[Tree] = [
        ("abs", "x"),
        ("max", "x", 0.0),
        ("min", "x", 0.0),
        ("max", ("*", 2.0, "x"), ("negative", "x")),
        ("min", ("max", "x", -0.5), 0.5),
        ("max", ("abs", "x"), 0.5),
        ("abs", ("max", "x", -1.0)),
        ("*", ("abs", "x"), "x"),
    ]
    functions: list[Any] = [
        np.abs,
        lambda x: np.maximum(x, 0),
        lambda x: np.minimum(x, 0),
        lambda x: np.maximum(2 * x, -x),
    ]
    functions += [lambda x: np.clip(x, -0.5, 0.5), lambda x: np.maximum(abs(x), 0.5), lambda x: abs(np.maximum(x, -1))]
    functions += [lambda x: np.abs(x) * x]
    for tree, function in zip(kinked, functions, strict=True):
        for a, b in (
            (-1.0, 1.0),
            (0.0, 0.0),
            (0.5, 0.5),
            (-0.5, 0.5),
            (0.0, 1.0),
            (-2.0, 0.0),
            (-1.0, -1.0),
            (0.5, 2.0),
        ):
            found = jet_on(tree, (a, b))
            points = np.linspace(a, b, 41)
            values = function(points)
            assert np.all(found.value[0] <= values) and np.all(values <= found.value[1]), (tree, a, b)
            x, y = np.meshgrid(points, points)
            apart = x != y
            chords = (function(x) - function(y))[apart] / (x - y)[apart]
            low, high = found.slope[:, 0, 0]
            assert np.all(low <= chords + 1e-12) and np.all(chords - 1e-12 <= high), (tree, a, b)
    # a kink that is somewhere in the box, or at the point itself: either slope may be the one
    for tree, slopes in ((kinked[0], (-1.0, 1.0)), (kinked[1], (0.0, 1.0)), (kinked[2], (0.0, 1.0))):
        for ends in ((-1.0, 1.0), (0.0, 0.0)):
            found = jet_on(tree, ends)
            assert found.slope[:, 0, 0].tolist() == list(slopes)
            assert np.isnan(found.bend[:, 0, 0]).any()


def test_ties_of_two_points_have_the_value_of_both() -> None:
    assert jet_on(("min", ("max", "x", 0.0), 0.0), (-1.0, 1.0)).value.ravel().tolist() == [0.0, 0.0]
    tie = jet_on(("max", "x", "y"), (1.0, 1.0), (1.0, 1.0))
    assert tie.value.ravel().tolist() == [1.0, 1.0]
    assert tie.slope[:, :, 0].tolist() == [[0.0, 0.0], [1.0, 1.0]]
    apart = jet_on(("max", "x", "y"), (2.0, 3.0), (1.0, 1.5))
    assert apart.slope[:, :, 0].tolist() == [[1.0, 0.0], [1.0, 0.0]] and not apart.bend.any()


def test_what_is_not_defined_stays_so() -> None:
    """Also times 0, in a power 0, in the larger of two, and below another function."""
    partly: list[Tree] = [
        ("*", 0.0, ("sqrt", "x")),
        ("*", "y", ("/", 1.0, "x")),
        ("*", "x", ("/", "x", "x")),
        ("max", ("atan", ("/", 1.0, "x")), 0.0),
        ("min", ("log", "x"), 0.0),
        ("**", ("sqrt", "x"), 0.0),
        ("tanh", ("log", "x")),
        ("-", ("tan", ("*", 2.0, "x")), 1.0),
        ("abs", ("**", "x", -1.0)),
        ("atan", ("**", "x", 0.5)),
    ]
    for tree in partly:
        assert np.isnan(jet_on(tree, (-1.0, 1.0)).value).any(), tree
    # the middle of the box is defined and the box is not
    box = np.array([[[-1.0]], [[1.0]]])
    around = Jet.variable(interval(np.array([0.5]) - 1.0, np.array([0.5]) + 1.0), np.ones((1, 1)))
    centre = Jet.variable(interval(np.array([0.5])), np.ones((1, 1)))
    undefined_left: list[Tree] = [("*", 0.0, ("sqrt", "x")), ("sqrt", "x"), ("log", "x")]
    for tree in undefined_left:
        both = [jets.jet(tree, {"x": own}, {}) for own in (centre, around)]
        assert np.isnan(off_linear(both[0], both[1], box, np.zeros((1, 1)))).any(), tree


def test_powers_that_are_rounded_have_no_derivatives() -> None:
    """Exponents p - 1 that are another number are not taken for p - 1."""
    found = jet_on(("**", "x", 5e-17), (1.0, 2.0))
    assert not np.isnan(found.value).any() and np.isnan(found.slope[:, 0]).any()
    assert not np.isnan(jet_on(("**", "x", 2.5), (1.0, 2.0)).bend[:, 0, 0]).any()


def test_the_narrowest_of_three_forms_is_taken() -> None:
    """For x u with u = -x + offset the third one knows that it is -x^2, the first one a slope, the second one both."""
    box = np.array([[[-0.1], [-0.1]], [[0.1], [0.1]]])
    leaves = [
        {name: Jet.variable(np.stack([e[0, k], e[1, k]]), np.eye(2)[k][:, None]) for k, name in enumerate("xy")}
        for e in (0.0 * box, box)
    ]
    centre, around = (jets.jet(("*", "x", "y"), own, {}) for own in leaves)
    zero = np.zeros((2, 1))
    low, high = off_linear(centre, around, box, zero)[:, 0]
    assert -0.0101 < low < -0.01 < 0.01 < high < 0.0101
    for offset in (0.0, 1e-3):
        follow = np.array([[1.0], [-1.0]]), np.array([0.0, offset])
        bounded = partial(in_a_box(box[:, :1, 0]).followed, np.eye(1, dtype=bool), *follow, box[..., 0], [0])
        low, high = off_linear(centre, around, box, zero, bounded)[:, 0]
        most = 0.1 * offset
        assert -0.01 - 3 * most - 1e-9 <= low <= -0.01 - most and most <= high <= 3 * most + 1e-9
    # a slope that is asked of a kink: form 1 alone
    around = Jet.variable(interval(np.array([-1.0]), np.array([1.0])), np.ones((1, 1)))
    centre = Jet.variable(interval(np.array([0.0])), np.ones((1, 1)))
    both = [jets.jet(("abs", "x"), {"x": own}, {}) for own in (centre, around)]
    low, high = off_linear(both[0], both[1], np.array([[[-1.0]], [[1.0]]]), np.zeros((1, 1)))[:, 0]
    assert -1.1 < low <= 0.0 and 1.0 <= high < 1.1
