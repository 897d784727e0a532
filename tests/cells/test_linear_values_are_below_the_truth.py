"""The value of a linear agent is below the truth at every point of every cell, not only at corners."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import certigym as cg
from certigym.synthesis.checking import regrow
from certigym.synthesis.readings.corner_forms import SubLattice, best_below
from certigym.synthesis.step_checking import linear_check
from certigym.synthesis.values import Terms
from kinds import mostly_thorough
from problems import cart, cart_reach, linear, scalar_agent

DATA = Path(__file__).parents[1] / "data"


def random_case(rng: np.random.Generator, d: int, parts: int, rough: float = 0.5) -> tuple[Any, ...]:
    """A smooth function on a cell, its values at a sub-lattice, at the corners, and how much it may lack between."""
    sub = SubLattice.of(d, parts)
    a, c = rough * rng.normal(size=(3, d)), rng.uniform(0.0, 2.0, size=3)
    shift = rng.uniform(-1.0, 1.0, size=3)

    def f(x: NDArray) -> NDArray:
        return np.asarray(0.02 * c[0] + (c[:, None] * np.exp(-((a @ x.T + shift[:, None]) ** 2))).sum(axis=0))

    # |second derivative of exp(-s^2)| <= 2 along a unit of s; steps of 2 / parts along each axis.
    bend = float(sum(2.0 * c @ a[:, k] ** 2 * (2.0 / parts) ** 2 / 8.0 for k in range(d)))
    return sub, f, f(sub.points)[None, None], f(sub.points[sub.corners])[None, None], np.array([[bend]])


def interpolated(corners: NDArray, points: NDArray) -> NDArray:
    """The multilinear function with values (2^d,) at the corners of [-1, 1]^d, at points (M, d)."""
    sides = np.array(list(product((0, 1), repeat=points.shape[1])))
    share = 0.5 * (points[:, None] + 1.0)
    return np.asarray(np.prod(np.where(sides, share, 1.0 - share), axis=2) @ corners)


def below(code: str, values: NDArray, corners: NDArray, bend: NDArray, sub: SubLattice) -> NDArray:
    """Lower bounds (2^d,) by the code of the search or by that of the check."""
    if code == "search":
        return np.asarray(best_below(values, corners, bend, sub.interpolation)[0, 0])
    return linear_check._below(values, corners, corners @ sub.interpolation, bend)[0, 0]


@pytest.mark.parametrize("code", ["search", "check"])
@pytest.mark.parametrize(("d", "parts"), [(1, 2), (1, 4), (2, 2), (2, 4), (3, 2)])
def test_best_below_is_below_everywhere(code: str, d: int, parts: int) -> None:
    rng = np.random.default_rng([d, parts])
    points, helped = rng.uniform(-1.0, 1.0, size=(400, d)), 0
    for _ in range(150):
        sub, f, values, corners, bend = random_case(rng, d, parts)
        lower = below(code, values, corners, bend, sub)
        assert np.all(lower >= 0.0)
        assert np.all(interpolated(lower, points) <= f(points) + 1e-14)
        helped += bool(lower.max() > 0.0)
    assert helped > 50


@pytest.mark.parametrize("code", ["search", "check"])
@pytest.mark.parametrize("kink", [0.02, 0.08, 0.16, 0.3])
def test_values_that_are_0_at_a_corner_do_not_begin_too_early(code: str, kink: float) -> None:
    """As under uniform noise: 0 at a corner, up to a kink before the next point. The worst line is .0095 too high."""
    sub = SubLattice.of(1, 8)
    x, width = np.linspace(-1.0, 1.0, 2001)[:, None], 1.0 / 8.0
    f = np.maximum(0.5 * (x[:, 0] + 1.0) - kink * width, 0.0)
    values = np.interp(sub.points[:, 0], x[:, 0], f)[None, None]
    # What the chord of the first part is above f, at the kink.
    bend = np.array([[kink * (1.0 - kink) * width]])
    lower = below(code, values, values[..., sub.corners], bend, sub)
    assert np.all(interpolated(lower, x) <= f + 1e-14)
    # Mirrored, and raised until nothing is 0: the same function is then used to scale.
    raised = below(code, values + 0.5, values[..., sub.corners] + 0.5, bend, sub)
    assert raised.max() > 1.0 and np.all(interpolated(raised, x) <= f + 0.5 + 1e-14)


def test_clipping_single_corners_would_be_caught() -> None:
    """Sabotage: the additive form with negative corners set to 0 exceeds f in many cases."""
    rng = np.random.default_rng(7)
    points, wrong = rng.uniform(-1.0, 1.0, size=(400, 2)), 0
    for _ in range(300):
        sub, f, values, corners, bend = random_case(rng, 2, 4, rough=1.0)
        shift = np.maximum(corners @ sub.interpolation - values, 0.0).max() + bend[0, 0]
        clipped = np.maximum(corners[0, 0] - shift, 0.0)
        wrong += bool(np.any(interpolated(clipped, points) > f(points) + 1e-6))
    assert wrong > 5


def turner() -> cg.LinearAgent:
    """Two states, correlated noise: its cells are parallelograms."""
    return cg.LinearAgent(
        name="cart",
        A=[[0.9, 0.1], [-0.1, 0.9]],
        B=[[0.5, 0.0], [0.1, 0.5]],
        noise_covariance=[[0.05, 0.01], [0.01, 0.06]],
        state_low=[-2.0, -2.0],
        state_high=[2.0, 2.0],
        input_low=[-1.0, -1.5],
        input_high=[1.0, 1.0],
        initial_state=[-1.0, 0.3],
        offset=[0.02, -0.05],
    )


def scalar_reach(semantics: str, goal: float = 1.0) -> cg.Problem:
    """A scalar agent that is to reach one region and to avoid another."""
    return cg.Problem(
        name="scalar",
        horizon=4,
        agents=[scalar_agent("one", noise_covariance=[[0.06]])],
        propositions={"goal": cg.Proposition("one", [goal], [2.0]), "bad": cg.Proposition("one", [-2.0], [-1.0])},
        specification=cg.Specification("!bad U goal", semantics),
    )


PROBLEMS: dict[str, tuple[cg.Problem, Any]] = {
    "targets": (scalar_reach("co-safe"), 37),
    "finite traces": (scalar_reach("finite-trace"), 24),
    "slivers": (scalar_reach("co-safe", 1.0 + 1e-10), 32),
    "menu": (cart_reach(cart(), horizon=8), [24, 12]),
    "correlated": (
        cg.Problem(
            name="turner",
            horizon=3,
            agents=[turner()],
            propositions={"goal": cg.Proposition("cart", [0.0, -1.0], [1.5, 1.0])},
            specification=cg.Specification("F goal", "co-safe"),
        ),
        [14, 13],
    ),
}
"""Problems of one agent, and cells."""


def value_of(certificate: cg.Certificate, terms: Terms | None, q: NDArray, states: NDArray) -> NDArray:
    """Value in automaton states (M,) at states (M, d): interpolated terms, or who accepts where nothing is left."""
    automaton, part = certificate.problem.automaton, certificate.proof.agents[0]
    if terms is None:
        return automaton.accepting[q].astype(float)
    places, weights = part.places_at(np.linalg.solve(part.coordinates, states.T))
    result = np.zeros(len(q))
    for state in np.unique(q):
        here = q == state
        result[here] = terms.products_between(int(state), [places[here]], [weights[here]]).sum(axis=1)
    return result


def expected(certificate: cg.Certificate, terms: Terms | None, q: int, mean: NDArray) -> float:
    """Expected value after the next letter from a mean: Gauss-Legendre in every cell, 12 nodes per deviation."""
    problem, part = certificate.problem, certificate.proof.agents[0]
    agent = problem.agents[0]
    inverse = np.linalg.inv(part.coordinates)
    noise = np.diag(inverse @ agent.noise_covariance @ inverse.T)
    centre, axes, weights = inverse @ mean, [], []
    for edges, variance, m in zip(part.grid.edges, noise, centre, strict=True):
        std = float(np.sqrt(variance))
        near = edges[(edges > m - 9 * std) & (edges < m + 9 * std)]
        ends = np.unique(np.concatenate([[max(edges[0], m - 9 * std)], near, [min(edges[-1], m + 9 * std)]]))
        ends = np.concatenate(
            [np.linspace(a, b, int((b - a) / std) + 2)[:-1] for a, b in zip(ends, ends[1:])] + [ends[-1:]]
        )
        node, weight = np.polynomial.legendre.leggauss(12)
        half = 0.5 * np.diff(ends)[:, None]
        y = (0.5 * (ends[1:] + ends[:-1])[:, None] + half * node).ravel()
        axes.append(y)
        weights.append((half * weight).ravel() * np.exp(-0.5 * ((y - m) / std) ** 2) / (std * np.sqrt(2 * np.pi)))
    points = np.stack([y.ravel() for y in np.meshgrid(*axes, indexing="ij")])
    share = weights[0]
    for weight in weights[1:]:
        share = np.multiply.outer(share, weight)
    states = part.coordinates @ points
    inside = np.all((agent.workspace.low[:, None] <= states) & (states <= agent.workspace.high[:, None]), axis=0)
    following = problem.automaton.next_state(np.full(states.shape[1], q), problem.labeling.class_at(0, states))
    return float(share.ravel() @ (inside * value_of(certificate, terms, following, states.T)))


@mostly_thorough("name", PROBLEMS)
def test_values_at_interior_points_are_below_quadrature(name: str) -> None:
    """One step at a time: the value at a random point is at most the mean of the next one under its controller."""
    problem, cells = PROBLEMS[name]
    below_quadrature(cg.synthesize(problem, cells, relation="linear").certificate)


def below_quadrature(certificate: cg.Certificate) -> None:
    """Check a certificate, and compare its values at random points with the means of the next ones."""
    problem = certificate.problem
    assert cg.check(certificate) and certificate.lower_bound > 0.1
    values: dict[int, Terms] = {}
    regrow(certificate, values.__setitem__)
    agent, controller = problem.agents[0], certificate.controller.agents[0]
    rng, tight = np.random.default_rng(3), 0.0
    states = rng.uniform(agent.workspace.low, agent.workspace.high, size=(40, agent.n_states))
    states[0] = agent.initial.low
    for t in reversed(range(problem.horizon)):
        for q in np.flatnonzero(~problem.automaton.finished):
            claimed = value_of(certificate, values[t], np.full(len(states), q), states)
            if t == 0:
                stored = value_of(certificate, certificate.proof.tree, np.full(len(states), q), states)
                claimed = np.maximum(claimed, stored)
            inputs, _ = controller.act(states.T[:, None], np.full(len(states), q), t, None)
            for x, u, claim in zip(states, inputs[:, 0].T, claimed, strict=True):
                if claim > 1e-3:
                    truth = expected(certificate, values.get(t + 1), int(q), linear(agent).mean(x, u))
                    assert claim <= truth + 1e-7
                    tight = max(tight, claim / truth)
    assert tight > 0.9
