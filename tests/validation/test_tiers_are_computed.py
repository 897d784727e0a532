"""Tiers of the suite follow from the recorded leaderboard by one rule, and say the same wherever they are shown."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

import certigym as cg
import rate_problems
from certigym.envs.suite.tiers import NAMES, TIERS
from certigym.synthesis.interop import stored
from certigym.validation.policies import Leaderboard, Standing, page_of, tier_of
from certigym.validation.policies.competitors import published
from certigym.validation.policies.tier_rule import ALONE, left_of


def row(policy: str, successes: int, low: float = 0.0, lower_bound: float | None = None) -> Standing:
    """A row of 1000 episodes."""
    limits: dict[str, Any] = {"low": low, "high": 1.0, "confidence": 0.999}
    rest: dict[str, Any] = {"information": "", "steps": None, "seconds": None}
    rest |= {"seeds": (), "successes": (successes,), "lower_bound": lower_bound}
    return Standing("p", "f", policy, episodes=1000, **limits, **rest)


def test_the_table_is_what_the_rule_makes_of_the_record() -> None:
    assert rate_problems.computed_tiers() == TIERS, "run `python docs/rate_problems.py`"
    assert set(TIERS) == set(cg.problem_ids()) and set(TIERS.values()) <= set(NAMES)


def test_every_row_of_a_learner_has_its_actors() -> None:
    """Seeds, steps and problem of the record are those of the files, which take at most 8 MB."""
    actors = rate_problems.RECORDED.parent / "actors"
    rows = [row for row in Leaderboard.load(rate_problems.RECORDED).rows if row.policy in ALONE]
    listed = {(row.problem, row.policy): row.seeds for row in rows}
    assert listed == {(id, name): seeds for id in cg.problem_ids() for name, seeds in published(actors, id).items()}
    for row in rows:
        files = [actors / row.problem / row.policy / f"seed-{seed}.npz" for seed in row.seeds]
        facts = [stored(file, cg.make_problem(row.problem).n_agents)[0] for file in files]
        assert {fact["fingerprint"] for fact in facts} == {row.fingerprint}, row.problem
        assert [fact["seed"] for fact in facts] == [*row.seeds] and sum(fact["steps"] for fact in facts) == row.steps
    assert sum(path.stat().st_size for path in actors.rglob("*.npz")) <= 8_000_000


def test_the_rule_by_hand() -> None:
    certified = row("certified", 950, 0.92, 0.9)
    assert tier_of([certified]) == tier_of([certified, row("warm-ppo", 990)]) == "unrated"  # nobody without help
    assert tier_of([certified, row("ppo", 911)]) == "solved"  # .92 is known, .911 is within .01 of it
    assert tier_of([certified, row("ppo", 909)]) == "open"
    assert tier_of([certified, row("ppo", 100), row("sac", 909)]) == "open"  # the best of them counts
    assert tier_of([certified, row("ppo", 459)]) == "hard"
    assert tier_of([replace(certified, low=0.0, lower_bound=None), row("ppo", 0)]) == "hard"  # nothing is known
    # What a helped learner is known to reach is known to be possible.
    assert tier_of([certified, row("warm-ppo", 999, 0.99), row("ppo", 930)]) == "open"


def test_what_is_left_and_the_middle_of_seeds_by_hand() -> None:
    certified = row("certified", 950, 0.92, 0.9)
    assert left_of([certified]) is None and left_of([certified, row("ppo", 950)]) == 0.0
    assert left_of([certified, row("ppo", 420), row("warm-ppo", 900)]) == pytest.approx(0.5)
    # Of five seeds the best and the worst are left out; of three none is.
    seeds = replace(row("ppo", 0), seeds=(0, 1, 2, 3, 4), successes=(0, 900, 600, 300, 1000))
    assert seeds.middle_rate == pytest.approx(0.6) and seeds.rate == pytest.approx(0.56)
    assert replace(seeds, successes=(0, 900, 600)).middle_rate == pytest.approx(0.5)
    page = page_of(Leaderboard((certified, seeds)))
    assert "| 0.5600 | [0.0000, 1.0000] | 0.6000 |" in page and "| 0.9500 | [0.9200, 1.0000] | - |" in page
