"""Expressions are read and never run, mean the same for one number and for many, and lie inside their enclosures."""

from __future__ import annotations

import re
import time
from typing import Any

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

from certigym.envs.systems.agents import Agent
from certigym.envs.systems.expressions import Affine, ExpressionError, computed, enclosed, read_expression
from certigym.envs.systems.expressions.expression_tree import Name, Number, Tree, whole_exponent
from certigym.synthesis.extended_check.steps.mean_enclosures import enclosed_means
from certigym.synthesis.relations.kinds import SymbolicMeans

TEXTS = (
    "x + 0.1*y",
    "x*x - y",
    "(1 - x**2)*y",
    "sin(x)*cos(y)",
    "tan(x/3)",
    "atan(x*y)",
    "exp(x) - exp(y)",
    "log(x + 4) + sqrt(abs(y))",
    "abs(x) - abs(y)",
    "min(x, y)*max(x, 2*y, 1)",
    "clip(x*y, -1, 1)",
    "tanh(3*x)*y",
    "x**3 - 3*x",
    "x**-2",
    "(x + 5)**1.5",
    "(x + 4)**y",
    "1/(2 + x*x)",
    "x/(y + 1)",
    "sqrt(x)",
    "log(y)",
    "x**5*y**4",
    "sqrt(x*x + y*y)",
    "sin(20*x)",
    "-x + pi",
    "(x + 4)**-0.5",
    "x**0 + y**1",
)
"""Every operation, and names that occur more than once."""


def boxes(seed: int, n: int = 150) -> tuple[NDArray[Any], NDArray[Any]]:
    """Boxes (n, 2) of all sizes around the origin, points among them."""
    rng = np.random.default_rng(seed)
    low = rng.uniform(-3.0, 3.0, (n, 2))
    low[::7] = 0.0
    width = 10.0 ** rng.uniform(-9, 0.7, (n, 2)) * (rng.random((n, 2)) < 0.9)
    return low, low + width


def agent_of(*texts: str, **changes: Any) -> Agent:
    values: dict[str, Any] = {
        "name": "a",
        "states": ["x", "y"],
        "inputs": ["u"],
        "dynamics": texts,
        "noise_covariance": np.eye(2),
        "state_low": [-9, -9],
        "state_high": [9, 9],
        "input_low": [-1],
        "input_high": [1],
        "initial_state": [0, 0],
    }
    return Agent(**{**values, **changes})


def fifty_digits(tree: Tree, values: dict[str, Any]) -> Any:
    """The value of an expression with fifty digits, by a library that knows nothing of ours; None where undefined."""
    if isinstance(tree, Number):
        return mpmath.mpf(tree.value)
    if isinstance(tree, Name):
        return values[tree.name]
    arguments = [fifty_digits(argument, values) for argument in tree.arguments]
    if tree.name == "**" and whole_exponent(tree.arguments[1]) is not None:
        return arguments[0] ** whole_exponent(tree.arguments[1])
    operations: dict[str, Any] = {
        "+": lambda a, b: a + b,
        "-": lambda a, b: a - b,
        "*": lambda a, b: a * b,
        "/": lambda a, b: a / b,
        "**": lambda a, b: a**b,
        "negative": lambda a: -a,
        "abs": abs,
        "min": min,
        "max": max,
    }
    function = operations.get(tree.name) or getattr(mpmath, tree.name)
    return function(*arguments)


@pytest.mark.parametrize("text", TEXTS)
def test_true_values_lie_in_both_enclosures(text: str) -> None:
    """Fifty digits at random points and corners of 150 boxes; where the enclosure knows nothing it says so."""
    agent = agent_of(text, "y")
    tree, (low, high), rng = agent.trees[0], boxes(1), np.random.default_rng(2)
    first, last = SymbolicMeans(agent, 1).around(low, high, np.zeros((1, 1)))
    own_first, own_last = enclosed_means(agent, low, high, np.zeros((len(low), 1)), 1)
    unknown = np.isnan(first[:, 0, 0])
    assert not unknown.all() and np.array_equal(unknown, np.isnan(own_first[:, 0]))
    for s in np.flatnonzero(~unknown):
        for share in (np.zeros(2), np.ones(2), rng.random(2), rng.integers(0, 2, 2)):
            x, y = np.where(share == 1, high[s], low[s] + share * (high[s] - low[s]))
            with mpmath.workdps(50):
                value = fifty_digits(tree, {"x": mpmath.mpf(float(x)), "y": mpmath.mpf(float(y))})
                assert first[s, 0, 0] <= value <= last[s, 0, 0]
                assert own_first[s, 0] <= value <= own_last[s, 0]
    # The box of the search holds that of the check: otherwise honest certificates would be refused.
    known = ~unknown
    assert np.all(first[known, 0, 0] <= own_first[known, 0]) and np.all(own_last[known, 0] <= last[known, 0, 0])


@pytest.mark.parametrize("text", [t for t in TEXTS if "sqrt(x)" not in t and "log(y)" not in t and "-2" not in t])
def test_enclosures_of_small_boxes_are_tight(text: str) -> None:
    """On boxes a hundredth wide they are at most a third wider than the values at 900 points, and mostly equal."""
    agent, rng = agent_of(text, "y"), np.random.default_rng(3)
    low = rng.uniform(0.5, 2.5, (50, 2))
    low[:25] *= -1.0
    low[:, 1] = np.abs(low[:, 1])
    high = low + 0.01
    first, last = (ends[:, 0, 0] for ends in SymbolicMeans(agent, 1).around(low, high, np.zeros((1, 1))))
    share = np.stack([axis.ravel() for axis in np.meshgrid(np.linspace(0, 1, 30), np.linspace(0, 1, 30))])
    points = low[..., None] + 0.01 * share
    values = agent.mean(np.moveaxis(points, 1, 0), np.zeros((1, 50, 900)))[0]
    spread = values.max(axis=1) - values.min(axis=1)
    known = ~np.isnan(first)
    assert known.mean() > 0.9
    width = (last - first)[known]
    assert (
        np.all(width <= 1.35 * spread[known] + 1e-9) and np.median(width - spread[known]) <= 0.02 * spread.max() + 1e-9
    )


def test_parts_hold_the_means() -> None:
    """Cells cut into parts, and a disturbance: no mean is outside."""
    agent = agent_of(
        "x + 0.1*y*x + v",
        "y + 0.3*sin(3*x)*y + u - 0.5*v*x",
        disturbances={"v": [-0.2, 0.1]},
    )
    rng = np.random.default_rng(4)
    low = rng.uniform(-3, 3, (200, 2))
    high, input_set = low + rng.uniform(0.01, 1.0, (200, 2)), np.array([[-1.0], [0.5]])
    widths = []
    for parts in (1, 3):
        first, last = SymbolicMeans(agent, parts).around(low, high, input_set)
        widths.append(float((last - first).mean()))
        for choice, u in enumerate(input_set[:, 0]):
            own = enclosed_means(agent, low, high, np.full((200, 1), u), parts)
            assert np.all(first[:, choice] <= own[0]) and np.all(own[1] <= last[:, choice])
            for _ in range(40):
                share = rng.random((200, 2)) if rng.random() < 0.5 else rng.integers(0, 2, (200, 2))
                states = (low + share * (high - low)).T
                v = rng.choice([-0.2, 0.1, 0.03], (1, 200))
                means = agent.mean(states, np.full((1, 200), u), v).T
                assert np.all((own[0] - 1e-12 <= means) & (means <= own[1] + 1e-12))
    assert widths[1] < widths[0]


@pytest.mark.parametrize("text", TEXTS)
def test_one_number_and_many_have_the_same_bits(text: str) -> None:
    """Arrays of every shape, order and stride; numpy has different loops for them."""
    tree, rng = read_expression(text, ["x", "y"]), np.random.default_rng(5)
    x, y = rng.uniform(0.1, 3.0, (2, 7, 901)) * rng.choice([0.01, 1.0, 30.0], (2, 7, 901))
    [many] = computed([tree], {"x": x, "y": y})
    [turned] = computed([tree], {"x": x.T, "y": y.T})
    [every_third] = computed([tree], {"x": x[:, ::3], "y": y[:, ::3]})
    ones = [computed([tree], {"x": np.array([a]), "y": np.array([b])})[0][0] for a, b in zip(x[2, :99], y[2, :99])]
    assert np.array_equal(many, turned.T, equal_nan=True) and np.array_equal(many[:, ::3], every_third, equal_nan=True)
    assert np.array_equal(many[2, :99], np.array(ones), equal_nan=True)


HOSTILE = {
    "x+": "expected an expression",
    "foo(x)": "unknown function 'foo'",
    "sinn(x)": "did you mean 'sin'",
    "x.__class__": "unknown name",
    "__import__('os').system('true')": "unexpected",
    "x if y else 1": "there are no conditions; use min, max, clip or abs",
    "lambda: 1": "word of Python",
    "(" * 3000: "brackets in one another",
    "-" * 4000 + "x": "signs in a row",
    "x" + "**x" * 1500: "powers",
    "+".join("x" * 2000): "levels of nesting",
    "*".join(["(x+y)"] * 120) + "+" + "*".join(["(x+y)"] * 800): "at most",
    "x" * 6000: "at most 5000 characters",
    "sin": "needs arguments",
    "sin(x, y)": "takes 1 argument",
    "1e400": "at most 1e+100",
    "9" * 4000: "at most 1e+100",
    "1_0": "unexpected",
    "x < y": "comparisons",
    "x^": "expected an expression",
    "x @ y": "unexpected '@'",
    "x, y": "only",
    "": "empty",
    "1/0*x": "division by zero",
    "1e99*1e99*1e99*1e99*x": "too large",
    "True": "word of Python",
    "x\0": "unexpected",
}


@pytest.mark.parametrize("text", HOSTILE)
def test_hostile_texts_are_refused_at_once(text: str) -> None:
    """In a second of computing at most, with a caret under the place where there is one."""
    began = time.process_time()
    with pytest.raises(ExpressionError, match=re.escape(HOSTILE[text])) as caught:
        read_expression(text, ["x", "y", "veloc"])
    assert time.process_time() - began < 1.0  # far from what reading takes, and from exponential time
    assert len(str(caught.value)) < 500


def test_infinite_and_undefined_ends_are_not_taken_for_numbers() -> None:
    """Poles, overflow and domain errors: the mean is unknown, and no warning is shown."""
    one = {"x": Affine(np.zeros(1), {0: np.ones(1)})}
    for text, low, high in (
        ("1/x", -1.0, 1.0),
        ("log(x)", 0.0, 1.0),
        ("sqrt(x)", -1e-9, 1.0),
        ("tan(x)", 1.0, 2.0),
        ("x**-1", 0.0, 1.0),
        ("x**0.5", -1.0, 1.0),
        ("log(x - x)", 1.0, 2.0),
    ):
        [(least, most)] = enclosed([read_expression(text, ["x"])], one, [(np.array([low]), np.array([high]))])
        assert np.isnan(least[0]) or np.isnan(most[0]), text
    [(_, most)] = enclosed([read_expression("exp(exp(x))", ["x"])], one, [(np.array([0.0]), np.array([9.0]))])
    assert not np.isfinite(most[0])


def test_powers_are_written_in_two_ways() -> None:
    assert read_expression("-x^2 + 2*(x + y)^3", ["x", "y"]) == read_expression("-x**2 + 2*(x + y)**3", ["x", "y"])
