"""A share of the adversary's campaign (``benchmarks/adversary.py``), with seeds that no campaign has had."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import certigym as cg
from adversary import FALSE_ALARM, arguments_of, claim, drawn, forged, problem_of
from forgeries import forgeries, opened
from kind_trials import forged_cells, trial
from kinds import mostly_thorough
from small_problems import MAKERS, small_spec

CLAIMS, WRITTEN, FIRST, EPISODES = 6, 3, 900_000, 10_000
FORGERIES = 3
SMALL = 1
"""Small problems of every kind."""


@mostly_thorough("seed", range(FIRST, FIRST + CLAIMS), first=2)
def test_random_claims_are_true(seed: int) -> None:
    """An independent simulator agrees with claim, upper ends and check; or the problem is refused in words."""
    row = claim(seed, EPISODES, FALSE_ALARM / (3 * CLAIMS))
    assert row["finding"] == "", row
    assert row["outcome"] in ("refused", "certified", "nothing certified")


@mostly_thorough("kind", ["written", "uneven"])
@mostly_thorough("seed", range(FIRST + 4, FIRST + 4 + WRITTEN))
def test_random_claims_about_written_agents_are_true(seed: int, kind: str) -> None:
    """The same for random expressions, whose values the simulator computes itself, in winds that jump.

    Some have noise of several laws whose size is an expression, and states without noise.
    """
    row = claim(seed, EPISODES, FALSE_ALARM / (6 * WRITTEN), kind)
    assert row["finding"] == "", row
    assert row["outcome"] in ("refused", "certified", "nothing certified")


@mostly_thorough("kind", sorted(MAKERS), first=2)
def test_small_problems_of_every_kind_are_true_and_accepted(kind: str) -> None:
    """Claims of every kind that the simulator does not refute pass the check; false alarm 1e-6 over all kinds."""
    rows = [trial(kind, seed, FALSE_ALARM / (SMALL * len(MAKERS)), 0) for seed in range(FIRST, FIRST + SMALL)]
    assert [row for row in rows if row["finding"]] == []


@mostly_thorough("kind", ["states", "paths", "networks"])
def test_forgeries_of_one_cell_are_refused_or_true(kind: str) -> None:
    """One entry of an honest claim is another: what is false is refused; some are refused, so that the forger works."""
    found = []
    for seed in range(FIRST, FIRST + 40):
        found += forged_cells(kind, seed, 1, FALSE_ALARM / 1000)
        if len(found) >= 4:
            break
    assert [(name, finding) for name, _, finding in found if finding] == []
    assert len(found) >= 4 and any(outcome == "refused" for _, outcome, _ in found)


def _certified(first: int, relation: str | None = None) -> tuple[dict, cg.Certificate]:
    """The first random problem from a seed on whose claim says something."""
    for seed in range(first, first + 200):
        spec = drawn(seed, relation)
        try:
            certificate = cg.synthesize(problem_of(spec), **arguments_of(spec)).certificate
        except ValueError:
            continue
        if isinstance(certificate, cg.Certificate) and 0.05 < certificate.lower_bound < 0.99:
            return spec, certificate
    raise AssertionError("no problem was certified")


@pytest.mark.thorough
@pytest.mark.parametrize(("first", "relation"), [(910_001, None), (910_004, "written"), (910_001, "uneven")])
def test_forgeries_are_refused_or_true(first: int, relation: str | None, tmp_path: Path) -> None:
    spec, certificate = _certified(first, relation)
    file = tmp_path / "own.npz"
    cg.save(certificate, file)
    rng = np.random.default_rng(first)
    every = list(forgeries(*opened(file), rng, 4))
    for k in rng.permutation(len(every))[:FORGERIES]:
        outcome, finding = forged(spec, file, every[k], EPISODES, FALSE_ALARM / 1000)
        assert finding == "", (every[k][0], outcome, finding)


def test_the_campaign_has_the_power_to_see() -> None:
    """Sabotage: a claim that is .05 too large is refuted."""
    from scipy.stats import binom

    from adversary import Deployed
    from independent import successes

    spec, certificate = _certified(920_000)
    number, _ = successes(spec, Deployed(certificate, EPISODES, 1), EPISODES, 1)
    assert binom.cdf(number, EPISODES, number / EPISODES + 0.05) < FALSE_ALARM / 60


@pytest.mark.parametrize("seed", [220, 245])
def test_truths_that_a_check_with_other_blocks_would_refuse_are_accepted(seed: int) -> None:
    """Tighter numbers may choose another form of lower bound, which is not larger everywhere."""
    spec = small_spec("upper", seed)
    certificate = cg.synthesize(problem_of(spec), **arguments_of(spec)).certificate
    assert cg.check(certificate)
    assert any(2 in part.relation["blocks"] for part in certificate.proof.agents)
