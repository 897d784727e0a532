"""Inputs that are computed from large inner terms are off by what these lose, and bounds are charged for it."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.systems.expressions import Affine, Number, Operation, Tree, computed, read_expression, roundings
from certigym.synthesis.extended_check.steps import target_enclosures
from certigym.synthesis.extended_check.steps.step_intervals import Span, computed_off
from certigym.synthesis.relations.kinds import inverse_means

NAMES = ("x", "y")


def exact(tree: Tree, values: dict[str, Fraction]) -> Fraction:
    """An expression of the four operations in rational numbers."""
    if isinstance(tree, Number):
        return Fraction(tree.value)
    if not isinstance(tree, Operation):
        return values[tree.name]
    parts = [exact(argument, values) for argument in tree.arguments]
    if tree.name == "negative":
        return -parts[0]
    first, second = parts
    return {"+": first + second, "-": first - second, "*": first * second}.get(tree.name) or (
        first / second if tree.name == "/" else Fraction(0)
    )


def random_text(rng: np.random.Generator, depth: int) -> str:
    if depth == 0:
        return str(rng.choice(["x", "y", "1e13", "3.7", "1e-9", "0.3"]))
    parts = [random_text(rng, depth - 1) for _ in range(2)]
    operation = str(rng.choice(["+", "-", "*", "-", "+"]))
    return f"({parts[0]} {operation} {parts[1]})" if rng.random() < 0.9 else f"({parts[0]} / (2 + x*x))"


def both_bounds(tree: Tree, box: list[tuple[float, float]]) -> tuple[float, float]:
    """What the search and what the check allow for."""
    names = {name: Affine(np.zeros(1), {k: np.ones(1)}) for k, name in enumerate(NAMES)}
    of_search = roundings([tree], names, [(np.array([low]), np.array([high])) for low, high in box])[0]
    leaves = {
        name: Span(np.array([[low], [high]]), np.zeros((2, 0, 1))) for name, (low, high) in zip(NAMES, box, strict=True)
    }
    return float(np.max(of_search)), float(computed_off(tree, leaves)[1][0])


@pytest.mark.thorough
def test_what_is_computed_is_off_by_no_more_than_is_said() -> None:
    """Random expressions with terms from 1e-9 to 1e26 against rational arithmetic; the search allows for more."""
    rng, tight = np.random.default_rng(0), []
    for _ in range(300):
        tree = read_expression(random_text(rng, int(rng.integers(1, 5))), NAMES)
        low = rng.uniform(-3.0, 3.0, 2)
        box = [(float(a), float(a + rng.random() * 0.1)) for a in low]
        of_search, of_check = both_bounds(tree, box)
        assert of_check <= of_search
        for _ in range(10):
            x = [float(rng.uniform(*ends)) for ends in box]
            found = float(computed([tree], dict(zip(NAMES, (np.array([v]) for v in x), strict=True)))[0][0])
            off = abs(Fraction(found) - exact(tree, dict(zip(NAMES, map(Fraction, x), strict=True))))
            assert off <= Fraction(of_check)
            if off:
                tight.append(float(off) / of_check)
    assert max(tight) > 0.05  # it is no number that nothing could exceed


@pytest.mark.parametrize(
    "text", ["sin(1e6*x)", "exp(3*x) - exp(3*x + 1e-9)", "sqrt(2 + x*x)**3", "max(x, y) / (4 + x)"]
)
def test_functions_pass_on_what_their_arguments_lose(text: str) -> None:
    tree = read_expression(text, NAMES)
    of_search, of_check = both_bounds(tree, [(0.5, 0.6), (0.1, 0.2)])
    assert 0.0 < of_check <= of_search < 1e-8


def agent(rest: str, **changes: Any) -> cg.Agent:
    keys: dict[str, Any] = {
        "name": "lossy", "states": ["x"], "inputs": ["u"], "dynamics": [f"0.9*x + {rest} + u"], "state_low": [-2.0],
        "noise": [{"law": "gaussian", "std": 0.02}], "state_high": [2.0], "input_low": [-0.5], "input_high": [0.5],
        "initial_state": [-1.5],
    }  # fmt: skip
    return cg.Agent(**{**keys, **changes})


def reaches(mover: cg.Agent) -> cg.Problem:
    task = cg.Specification("F goal", "co-safe")
    regions = {"goal": cg.Proposition("lossy", [0.5], [1.5])}
    return cg.Problem(name="lossy", horizon=8, agents=[mover], propositions=regions, specification=task)


LOSSY = "1e10*(x+1) - 1e10*x - 1e10"


def test_exact_targets_are_charged_for_inner_terms() -> None:
    plain = cg.synthesize(reaches(agent("0*x")), 100, relation="exact").certificate
    lossy = cg.synthesize(reaches(agent(LOSSY)), 100, relation="exact").certificate
    assert plain.lower_bound > 0.999999 and cg.check(plain)
    assert 0.9 < lossy.lower_bound < 0.99 and cg.check(lossy)
    hopeless = cg.synthesize(reaches(agent("1e13*(x+1) - 1e13*x - 1e13")), 100, relation="exact").certificate
    assert hopeless.lower_bound == 0.0


def forgetful(*_: Any) -> list[np.ndarray]:
    return [np.zeros(1) for _ in _[0]]


def test_the_check_refuses_searches_that_forget_inner_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(inverse_means, "roundings", forgetful)
        forged = cg.synthesize(reaches(agent(LOSSY)), 100, relation="exact").certificate
    assert forged.lower_bound > 0.999999 and not cg.check(forged)
    # Its eye for inner terms is what refuses: without it the forgery passes.
    monkeypatch.setattr(target_enclosures, "inner_losses", lambda relation, low, high: np.zeros(low.shape))
    assert cg.check(forged)


def test_a_root_of_what_is_exact_at_0_is_known() -> None:
    """Where nothing is rounded ends stay: moved below 0 they would have no root, and cells at 0 no inputs."""
    tank = cg.Agent(
        name="tank", states=["h"], inputs=["u"], dynamics=["h + 0.4*(u - 0.6*sqrt(max(h, 0)))"],
        noise=[{"law": "uniform", "low": -0.35, "high": 0.35}], state_low=[0], state_high=[4], input_low=[0],
        input_high=[1.5], initial_state=[1.0],
    )  # fmt: skip
    relation, low = inverse_means.symbolic_targets(tank), np.array([[0.0], [0.002]])
    with np.errstate(all="ignore"):
        losses = target_enclosures.inner_losses(relation, low, low + 0.002)
    assert np.all((losses > 0.0) & (losses < 1e-12))
    full = {"full": cg.Proposition("tank", [2.2], [2.9])}
    problem = cg.Problem(name="tank", agents=[tank], propositions=full, specification="F full", horizon=8)
    certificate = cg.synthesize(problem, relation="exact", effort=5.0).certificate
    assert cg.check(certificate) and certificate.lower_bound > 0.97
