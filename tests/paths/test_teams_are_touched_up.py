"""Small moves of one agent beside the others: what pairs ask moves with it, and the team fails no more often."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.trajectories.chance_constraints.pair_costs import pair_limits
from certigym.synthesis.trajectories.planning import CountedWork
from certigym.synthesis.trajectories.planning.team_search import TeamFound, TeamSearch
from fleet_problems import mixed, path_of, swap

pytestmark = pytest.mark.thorough

PROBLEM = swap(3, 0.04, 0.4)


@pytest.fixture(scope="module")
def planned() -> tuple[TeamSearch, np.ndarray, TeamFound]:
    """A team after the search without small moves."""
    search = TeamSearch(PROBLEM, CountedWork())
    letters = path_of(PROBLEM).proof.letters
    quick = search.quick(letters)
    assert quick is not None
    return search, letters, search.full(letters, quick)


def test_what_pairs_ask_moves_with_an_agent(planned: tuple[TeamSearch, np.ndarray, TeamFound]) -> None:
    """Rows of a path that was moved are those that are found anew, with directions as they were."""
    search, letters, team = planned
    asking, rng = search._asking(team)[0], np.random.default_rng(4)
    inputs = asking.inputs[None] + 0.02 * rng.standard_normal((3, *asking.inputs.shape))
    states = np.stack([_rolled(search, asking.states[0], one) for one in inputs])
    moved = asking.many(states, inputs)
    assert asking.pairs and pair_limits(PROBLEM, letters)
    for k, path in enumerate(moved):
        np.testing.assert_array_equal(path.states, states[k])
        for t, asked in path.pairs.items():
            nearer = asked.forms @ (path.outputs[0][t] - asking.outputs[0][t])
            np.testing.assert_allclose(asked.low, asking.pairs[t].low + nearer, atol=1e-12)
            np.testing.assert_allclose(asked.high, asking.pairs[t].high - nearer, atol=1e-12)
            assert asked.forms is asking.pairs[t].forms
        # Derivatives that were computed together are those of each path.
        alone = type(path)(path.model, path.limits, path.states, path.inputs)
        for mine, other in zip(path.linear, alone.linear, strict=True):
            np.testing.assert_allclose(mine, other, rtol=1e-12)


def _rolled(search: TeamSearch, start: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    states = [start]
    for t, u in enumerate(inputs):
        states.append(search.searches[0].model.step(states[-1][:, None], u[:, None], t)[:, 0])
    return np.array(states)


@pytest.mark.thorough
def test_a_team_fails_less_often_after_small_moves(planned: tuple[TeamSearch, np.ndarray, TeamFound]) -> None:
    search, letters, team = planned
    assert team.failure > 1e-4
    touched = search.touched_up(letters, team.found)
    assert touched.failure < 0.8 * team.failure
    # What is said of it is what is found when it is judged once more.
    again = search.judged(touched.found, touched.faces, pair_limits(PROBLEM, letters))
    assert again.failure == pytest.approx(touched.failure, rel=1e-9)


@pytest.mark.thorough
def test_claims_are_proved_and_not_refuted(planned: tuple[TeamSearch, np.ndarray, TeamFound]) -> None:
    certificate = path_of(PROBLEM)
    assert certificate.proof.failure < 0.9 * planned[2].failure
    assert cg.check(certificate, PROBLEM)
    done = cg.rollout(PROBLEM, certificate.controller, 20_000, seed=3)
    assert binom.cdf(done.successes, 20_000, certificate.lower_bound) > 1e-6


@pytest.mark.thorough
def test_teams_of_unlike_agents_are_touched_up() -> None:
    """A unicycle, a cart and a walker, with three times the noise; one pair keeps apart and one meets."""
    problem = mixed().replace(disturbance_scale=3.0)
    search, letters = TeamSearch(problem, CountedWork()), path_of(problem).proof.letters
    quick = search.quick(letters)
    assert quick is not None
    touched = search.touched_up(letters, quick.found)
    assert touched.failure < 0.9 * quick.failure
