"""What is tried, and what is certified, does not depend on how fast the machine is: work is counted, not measured."""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import count
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info

import certigym as cg
from problems import cart, cart_reach


def robots(n_agents: int) -> cg.Problem:
    """Robots that turn while they drive, all to be at their goals at once, beside their walls."""
    team = cg.LinearAgent(
        name="robot",
        A=[[0.95, 0.1], [-0.1, 0.95]],
        B=[[0.5, 0.0], [0.0, 0.5]],
        noise_covariance=[[0.1, 0.0], [0.0, 0.1]],
        state_low=[-3.5, -3.5],
        state_high=[3.5, 3.5],
        input_low=[-2.0, -2.0],
        input_high=[2.0, 2.0],
        initial_state=[-0.5, -1.5],
    ).copies(n_agents)
    walls = {f"wall_{i}": cg.Proposition(f"robot_{i}", [-0.5, -0.5], [0.5, 0.5]) for i in range(n_agents)}
    goals = {f"goal_{i}": cg.Proposition(f"robot_{i}", [1.0, -1.0], [3.0, 2.0]) for i in range(n_agents)}
    avoid, reach = " & ".join(f"!{name}" for name in walls), " & ".join(goals)
    return cg.Problem(
        name="robots",
        horizon=2,
        agents=team,
        propositions={**walls, **goals},
        specification=cg.Specification(f"({avoid}) U ({reach})", "co-safe"),
    )


def slowed(seconds: float) -> Iterator[float]:
    """Yield times of a clock that goes on by so many seconds whenever it is read."""
    return (seconds * k for k in count())


def certified(monkeypatch: pytest.MonkeyPatch, look: float, problem: Any, **options: Any) -> cg.Synthesis:
    """Synthesize under a clock of which each look takes so many seconds."""
    with monkeypatch.context() as patch:
        for name in ("perf_counter", "monotonic", "process_time", "time"):
            patch.setattr(time, name, slowed(look).__next__)
        return cg.synthesize(problem, **options)


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("problem", "options"),
    [
        (lambda: robots(1), {"effort": 0.2}),
        (lambda: robots(1), {"cells": 10}),
        (lambda: cart_reach(cart(), horizon=9), {"cells": 40}),
    ],
)
def test_slow_and_fast_machines_certify_the_same(
    problem: Any, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    slow, fast = (certified(monkeypatch, look, problem(), **options) for look in (100.0, 1e-6))
    assert slow.certificate.lower_bound == fast.certificate.lower_bound > 0.0
    assert slow.stats.get("tried") == fast.stats.get("tried")
    for one, other in zip(slow.certificate.proof.agents, fast.certificate.proof.agents, strict=True):
        np.testing.assert_array_equal(one.policy, other.policy)


@pytest.mark.thorough
def test_only_seconds_that_are_given_look_at_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first certificate is returned in any case; what comes after it is left out when the seconds are over."""
    quick = certified(monkeypatch, 100.0, robots(1), seconds=10.0)
    patient = certified(monkeypatch, 1e-6, robots(1), seconds=10.0, effort=0.1)
    usual = cg.synthesize(robots(1), effort=0.1)
    assert 0.0 < quick.certificate.lower_bound < usual.certificate.lower_bound == patient.certificate.lower_bound
    tried: Any = quick.stats["tried"]
    assert any("`seconds`" in str(outcome) for outcome in tried.values())
    assert cg.check(quick.certificate)


@pytest.mark.thorough
def test_more_effort_certifies_no_less_and_says_what_was_left_out() -> None:
    little, more = (cg.synthesize(robots(1), effort=effort) for effort in (0.05, 0.1))
    assert little.certificate.lower_bound < more.certificate.lower_bound
    tried: Any = little.stats["tried"]
    assert any("ask for more `effort`" in str(outcome) for outcome in tried.values())
    assert little.certificate.settings["relations_tried"] == tried


@pytest.mark.parametrize("name", ["effort", "seconds"])
@pytest.mark.parametrize("value", [0.0, -1.0, "much", True])
def test_budgets_are_positive_numbers(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"`{name}`: expected a positive number"):
        cg.synthesize(robots(2), **{name: value})


@pytest.mark.thorough
def test_linear_algebra_has_one_thread_and_gets_its_threads_back() -> None:
    """The order of sums would depend on the number of cores."""
    cg.synthesize(cart_reach(cart(), horizon=4), 24)  # loads all libraries that it needs
    before, seen = threads(), list[dict[str, int]]()
    cg.synthesize(cart_reach(cart(), horizon=4), 24, progress=lambda *_: seen.append(threads()))
    assert seen and {count for each in seen for count in each.values()} == {1}
    assert threads() == before


def threads() -> dict[str, int]:
    """Return how many threads each library of linear algebra uses."""
    return {
        library["filepath"]: library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }
