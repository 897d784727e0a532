"""``relation="best"`` tries every relation that applies, keeps the largest bound, and says what each gave."""

from __future__ import annotations

import pytest

import certigym as cg
from problems import cart, cart_reach, scalar_agent


def task() -> cg.Problem:
    return cg.Problem(
        name="one",
        horizon=4,
        agents=[scalar_agent("a")],
        propositions={"goal": cg.Proposition("a", [1.0], [3.0])},
        specification=cg.Specification("F goal", "co-safe"),
    )


def test_the_largest_bound_is_kept_and_all_are_listed() -> None:
    found = cg.synthesize(task(), 40, relation="best")
    tried = found.stats["tried"]
    assert isinstance(tried, dict) and {"exact", "tube", "paper", "linear"} <= set(tried)
    numbers = {name: bound for name, bound in tried.items() if isinstance(bound, float)}
    assert len(numbers) >= 3 and len(set(numbers.values())) > 1
    assert found.certificate.lower_bound == max(numbers.values())
    alone = cg.synthesize(task(), 40, relation="tube").certificate.lower_bound
    assert numbers["tube"] == alone
    report = cg.validate(found, 2000)
    assert "tried         tube: P >= " in str(report) and "tried         linear: P >= " in str(report)


def test_a_relation_that_does_not_apply_says_why() -> None:
    problem = cg.make_problem("reach-avoid-kinematic-v0", horizon=1)
    found = cg.synthesize(problem, 40, relation="best", max_sweeps=0)
    tried = found.stats["tried"]
    assert isinstance(tried, dict)
    assert isinstance(tried["exact"], str) and "rank" in tried["exact"]
    assert isinstance(tried["tube"], float)


@pytest.mark.thorough
def test_where_relations_do_not_apply_their_reasons_are_kept() -> None:
    """Nobody reaches the second state of the agent: linear cells ask for nothing of the kind."""
    adrift = cart(A=[[1.0, 0.5], [0.0, 1.2]], B=[[0.5], [0.0]])
    for relation in ("auto", "best"):
        result = cg.synthesize(cart_reach(adrift), 40, relation=relation)
        assert result.certificate.settings["relation"] == "linear" and cg.check(result.certificate)
        why = str(result.stats["tried"]["others"])  # type: ignore[index]
        assert "applies to agent `cart`, got none: " in why and "tube: " in why and "; ellipsoid: " in why
    with pytest.raises(ValueError, match="`delta`: expected a number of at least 0 and below 1, got 2"):
        cg.synthesize(task(), 40, relation="best", delta=2.0)
