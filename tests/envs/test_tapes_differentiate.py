"""Tapes of derivatives enclose true derivatives on boxes, and are derivatives at points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from certigym.envs.systems.expressions import Program, read_expression

NAMES = ("x", "y", "z")
SMOOTH = [
    "x + 0.1*z*cos(y)", "z*tan(y)/(1 + x**2)", "sqrt(2 + x)*exp(y)*atan(z)", "tanh(x*y)/(2 + sin(z))", "x*x*y + x**3/z",
    "z**1.5*log(z) + y", "z**-2*x", "sin(2*x + y) - x**4", "atan(2*x)", "tanh(2*x)", "sqrt(z)", "0*x + 3",
    "x**1 + y**0",    "-(x - y)*z", "x/4 + z/y**2", "log(z)/z", "(x + y)*(x + y)", "2**0.5*x*z",
]  # fmt: skip


def program_of(text: str) -> Program:
    return Program.of([read_expression(text, NAMES, {})], NAMES)


def differences(program: Program, at: np.ndarray, h: float = 1e-4) -> tuple[np.ndarray, np.ndarray]:
    """Return first (3,) and second (3, 3) derivatives by central differences."""

    def value(x: np.ndarray) -> float:
        return float(program.values(x[:, None])[0, 0])

    eye = h * np.eye(3)
    first = np.array([(value(at + e) - value(at - e)) / (2 * h) for e in eye])
    second = [[value(at + e + f) - value(at + e - f) - value(at - e + f) + value(at - e - f) for f in eye] for e in eye]
    return first, np.array(second) / (4 * h * h)


@pytest.mark.parametrize("text", SMOOTH)
def test_derivatives_are_those_of_differences(text: str) -> None:
    program, rng = program_of(text), np.random.default_rng(2)
    for _ in range(5):
        at = rng.uniform([-0.4, 0.3, 0.6], [0.5, 0.9, 1.6])
        first, second = differences(program, at)
        values, slopes = program.slopes(at[:, None])
        np.testing.assert_allclose(values, program.values(at[:, None]), rtol=1e-12)
        np.testing.assert_allclose(slopes[0, :, 0], first, rtol=1e-5, atol=1e-6)
        ((ends, second_derivatives),) = program.curved(np.stack([at, at])[..., None])
        for j in range(3):
            np.testing.assert_allclose(ends.get(j, np.zeros((2, 1)))[:, 0], first[j], rtol=1e-5, atol=1e-6)
            for k in range(j, 3):
                bend = second_derivatives.get((j, k), np.zeros((2, 1)))[:, 0]
                np.testing.assert_allclose(bend, second[j, k], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("text", [*SMOOTH, "abs(z)*y", "max(x, z + 2)*y", "min(x*y, 5)", "x**y + z"])
def test_boxes_enclose_derivatives_at_their_points(text: str) -> None:
    program, rng = program_of(text), np.random.default_rng(3)
    # Many boxes at once, and points in them; x**y has no second derivatives that are known.
    low = rng.uniform([0.1, 0.3, 0.6], [0.5, 0.9, 1.6], (20, 3)).T
    high = low + rng.uniform(0.0, 0.3, (3, 20))
    ((ends, second_derivatives),) = program.curved(np.stack([low, high]))
    for _ in range(50):
        points = low + (high - low) * rng.random((3, 20))
        ((first, second),) = program.curved(np.stack([points, points]))
        parts: list[tuple[dict[Any, Any], dict[Any, Any]]] = [(ends, first), (second_derivatives, second)]
        for place, here in parts:
            for key, (a, b) in here.items():
                c, d = place[key]
                known = np.broadcast_to(~np.isnan(c), a.shape) if a.shape == (20,) else ~np.isnan(c)
                assert np.all((a >= c - 1e-12 * (1 + np.abs(c)))[known] & (b <= d + 1e-12 * (1 + np.abs(d)))[known])


def test_what_is_not_known_is_not_told() -> None:
    """A root at 0, a quotient by 0, and a choice within the box."""
    box = np.array([[[-0.1], [0.2], [0.0]], [[0.1], [0.4], [0.5]]])
    for text, j in (("sqrt(x)", 0), ("y/x", 0), ("log(z)", 2)):
        ((ends, second_derivatives),) = program_of(text).curved(box)
        assert np.isnan(ends[j]).any() and np.isnan(second_derivatives[j, j]).any(), text
    for text in ("abs(x)*y", "max(x, 0)"):
        ((ends, second_derivatives),) = program_of(text).curved(box)
        assert np.isnan(second_derivatives[0, 0]).all() and np.isfinite(ends[0]).all(), text


def test_constants_are_computed_once() -> None:
    """What does not depend on variables is no call of a run: a linear form has none."""
    program = program_of("0.5*x + 2*sin(0.3)*y - z/4")
    ((ends, second_derivatives),) = program.curved(np.zeros((2, 3, 7)))
    assert not second_derivatives and all(slope.shape == (2, 1) for slope in ends.values())
    assert ends[1][0, 0] == pytest.approx(2 * np.sin(0.3)) and ends[2][0, 0] == -0.25
