"""The check's own recursion on tensor trains: as close to dense programming as it says, and apart from the search."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import canonical, changed, verdict_of
from certigym.synthesis.certificates.proofs.canonical import TRAINS
from certigym.synthesis.certificates.value_functions import Rounding
from certigym.synthesis.checker import cell_proofs, trains
from certigym.synthesis.checker.trains import Train
from certigym.synthesis.checker.tree import Team
from certigym.synthesis.extended_check.claims import train_check
from certigym.synthesis.extended_check.claims.train_check import ErrorBoundedTrain, regrown_trains, train_start_value
from certigym.synthesis.policy_search.ascent import train_backward
from certigym.synthesis.policy_search.bounds.certified import SECOND_EVALUATION
from certigym.synthesis.policy_search.bounds.dense import dense_value
from certigym.synthesis.verbs.abstract import abstract
from problems import two_agents

WEAK: dict[str, Any] = {"input_low": [-0.2], "input_high": [0.2]}
"""Inputs too weak for some cells: no target is admissible there."""

PROBLEMS = {
    "two agents": two_agents("F (a & F c) & G[0,2] !b", horizon=4),
    "weak agents": two_agents("F (a & F c)", horizon=4, **WEAK),
    "invariance": two_agents("G (b -> X d)", "finite-trace", horizon=3),
    "three agents": cg.make_problem("reach-avoid-n-v0", n_agents=3).replace(horizon=3),
}


@cache
def honest(name: str, cells: int) -> cg.Synthesis:
    return cg.synthesize(PROBLEMS[name], cells, search=cg.SearchOptions(value="train", max_sweeps=0))


@cache
def trained(name: str, cells: int, tolerance: float = 1e-6) -> cg.Certificate:
    """A certificate on tensor trains, its policies drawn at random, some choices missing."""
    problem = PROBLEMS[name]
    certificate = honest(name, cells).certificate
    rng = np.random.default_rng(3)
    agents = []
    for part in certificate.proof.agents:
        choices = rng.integers(0, len(part.lattice[0]), size=part.policy.shape).astype(np.int32)
        agents.append(replace(part, policy=np.where(rng.random(choices.shape) < 0.1, -1, choices).astype(np.int32)))
    rounding = Rounding(tolerance, (None,) * (problem.horizon + 1))
    return changed(certificate, agents=tuple(agents), rounding=rounding)


def everywhere(train: ErrorBoundedTrain | Train | None, shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
    """The function of a train at every joint cell."""
    if train is None:
        return np.zeros(shape)
    total = np.ones((1, 1))
    for core in train.cores:
        total = np.tensordot(total, core, axes=1)
    return np.asarray(total[0, ..., 0])


def exactly(certificate: cg.Certificate, cells: int) -> Any:
    """Value at time 0 by dense programming, (n_states, S_1, ..)."""
    models = abstract(certificate.problem, cells, relation="exact").models
    return dense_value(certificate.problem, models, tuple(part.policy for part in certificate.proof.agents))


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("tolerance", [1e-9, 1e-3, 0.5])
def test_values_lie_within_their_error_of_dense_programming(name: str, tolerance: float) -> None:
    cells = 6 if name == "three agents" else 16
    certificate = trained(name, cells, tolerance)
    dense = exactly(certificate, cells)
    for q, train in enumerate(regrown_trains(certificate)):
        if not certificate.problem.automaton.dead[q]:
            off = np.max(np.abs(everywhere(train, dense.shape[1:]) - dense[q]))
            assert off <= (0.0 if train is None else train.error) <= max(0.3 * tolerance, 1e-10)


@pytest.mark.parametrize("name", ["two agents", "weak agents", "three agents"])
@pytest.mark.parametrize("seed", range(3))
def test_cells_left_out_fail_below_and_survive_above(name: str, seed: int) -> None:
    cells = 6 if name == "three agents" else 16
    certificate = trained(name, cells)
    rng = np.random.default_rng(seed)
    sizes = [part.grid.n_cells for part in certificate.proof.agents]
    visited = tuple(
        tuple(np.flatnonzero(rng.random(n) < 0.7) for n in sizes) for _ in range(certificate.problem.horizon + 1)
    )
    certificate = changed(certificate, rounding=Rounding(1e-9, visited))
    dense, there = exactly(certificate, cells), np.ix_(*visited[0])
    below, above = regrown_trains(certificate), regrown_trains(certificate, upper=True)
    strict = []
    for q, (low, high) in enumerate(zip(below, above, strict=True)):
        if low is None or high is None or certificate.problem.automaton.dead[q]:
            continue
        truth = dense[q][there]
        assert np.all(everywhere(low, truth.shape) - low.error <= truth)
        assert np.all(everywhere(high, truth.shape) + high.error >= truth)
        strict.append(np.max(everywhere(high, truth.shape) - everywhere(low, truth.shape)))
    assert max(strict) > 1e-3


@pytest.mark.parametrize(("n_agents", "together"), [(4, 1), (4, 3), (6, 3)])
def test_some_of_a_team_of_alike_agents_pass_with_an_error_below_what_claims_leave_for_it(
    n_agents: int, together: int
) -> None:
    """Values whose columns weigh as little as 1e-9 of the first one, in regions that hardly any run comes to."""
    numbers: dict[str, Any] = {"A": [[1.0]], "B": [[1.0]], "noise_covariance": [[0.09]], "initial_state": [-6.0]}
    boxes: dict[str, Any] = {"state_low": [-10], "state_high": [10], "input_low": [-2], "input_high": [2]}
    goals = (" & ".join(chosen) for chosen in combinations([f"g{i}" for i in range(n_agents)], together))
    problem = cg.Problem(
        name="some of them",
        agents=[cg.LinearAgent(name=f"a{i}", **numbers, **boxes) for i in range(n_agents)],
        propositions={f"g{i}": cg.Proposition(f"a{i}", [3.0], [6.0]) for i in range(n_agents)},
        specification=cg.Specification(f"F ({' | '.join(f'({goal})' for goal in goals)})"),
        horizon=8,
    )
    certificate = cg.synthesize(
        problem, 60, relation="exact", search=cg.SearchOptions(value="train", max_sweeps=1)
    ).certificate
    assert certificate.lower_bound > 0.998
    assert cg.check(certificate)
    errors = [train.error for train in regrown_trains(certificate) if train is not None]
    assert 2.0 * max(errors) <= SECOND_EVALUATION * certificate.proof.rounding.tolerance


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("tolerance", [1e-9, 1e-3, 0.5])
def test_the_small_checker_proves_no_more_than_is_true_and_hardly_less(name: str, tolerance: float) -> None:
    cells = 6 if name == "three agents" else 16
    never_cut = (None,) * (PROBLEMS[name].horizon + 1)
    nearly, stated = (
        changed(honest(name, cells).certificate, rounding=Rounding(allowed, never_cut))
        for allowed in (1e-12, tolerance)
    )
    below, above = (train_start_value(nearly, regrown_trains(nearly, upper), upper) for upper in (False, True))
    proved = 1.0 - verdict_of(stated).recomputed
    assert below - TRAINS * tolerance - 1e-9 <= proved <= above


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("tolerance", [1e-9, 1e-3, 0.5])
def test_trains_of_the_small_checker_lie_within_their_error(
    name: str, tolerance: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[list[Train | None]] = []

    def noted(team: Team, tolerance: float) -> float:
        seen.append(trains.trains_at_start(team, tolerance))
        # what was off a step later is off a step earlier, too
        ones = tuple(np.ones((1, own.kernel.places, 1)) for own in team.agents)
        off = [Train(ones, 0.25) for _ in team.automaton.accepting]
        sums = [trains._masked_sum(team, off, q, tolerance) for q in range(len(off))]
        assert min(own.error for own in sums if own is not None) >= 0.25
        return 0.0

    monkeypatch.setattr(cell_proofs, "by_trains", noted)
    monkeypatch.setattr(canonical, "_verdicts", {})
    cells = 6 if name == "three agents" else 16
    certificate = honest(name, cells).certificate
    verdict_of(changed(certificate, rounding=Rounding(tolerance, (None,) * (certificate.problem.horizon + 1))))
    dense = exactly(certificate, cells)
    for q, train in enumerate(seen[0]):
        if not certificate.problem.automaton.dead[q]:
            off = np.max(np.abs(everywhere(train, dense.shape[1:]) - dense[q]))
            assert off <= (0.0 if train is None else train.error) <= 1.1 * TRAINS * tolerance + 1e-9


@pytest.mark.parametrize("upper", [False, True])
def test_the_start_is_read_on_the_side_that_was_asked_for(upper: bool) -> None:
    certificate = honest("two agents", 16).certificate
    value = regrown_trains(certificate, upper)
    bound = train_start_value(certificate, value, upper)
    assert bound > 1e-6
    wrong = tuple(None if train is None else replace(train, error=train.error + bound / 2) for train in value)
    changed = train_start_value(certificate, wrong, upper)
    assert changed == pytest.approx(1.5 * bound if upper else 0.5 * bound, rel=1e-6)


def test_a_start_outside_of_the_covered_cells_counts_for_nothing_below_and_in_full_above() -> None:
    certificate = trained("two agents", 16)
    away = tuple(np.arange(2) for _ in certificate.proof.agents)
    certificate = changed(certificate, rounding=Rounding(1e-6, (away,) * 5))
    for upper, expected in ((False, 0.0), (True, 1.0)):
        value = train_start_value(certificate, regrown_trains(certificate, upper), upper)
        assert value == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("visited", [[[-1, 0]], [[0, 0]], [[3, 2]], [[0, 10**6]], [[]]], ids=str)
def test_cells_that_are_no_cells_are_refused(visited: list[list[int]]) -> None:
    certificate = trained("two agents", 16)
    wrong = (np.array(visited[0], dtype=int), np.arange(2))
    broken = changed(certificate, rounding=Rounding(1e-6, (wrong,) * 5))
    with pytest.raises(train_check.BrokenTrainError, match="no cells"):
        regrown_trains(broken)
    assert not cg.check(broken)
    for rounding in (
        Rounding(1e-6, ((np.arange(2),) * 2,) * 3),
        Rounding(0.0, (None,) * 5),
        Rounding(2.0, (None,) * 5),
    ):
        with pytest.raises(train_check.BrokenTrainError, match="horizon"):
            regrown_trains(changed(certificate, rounding=rounding))


def test_a_mistake_in_the_trains_of_the_search_is_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    """The step of the search multiplies what arrives by a factor: its bound is too large, and the check says so."""
    problem = PROBLEMS["two agents"]
    assert cg.check(honest("two agents", 16))
    arrival = train_backward.arrival

    def wrong(*arguments: Any, **named: Any) -> Any:
        train = arrival(*arguments, **named)
        return train and replace(train, cores=(1.02 * train.cores[0], *train.cores[1:]))

    monkeypatch.setattr(train_backward, "arrival", wrong)
    report = cg.check(cg.synthesize(problem, 16, search=cg.SearchOptions(value="train", max_sweeps=0)))
    assert not report
    assert "exceeds the recomputed value" in str(report)
