"""Under a shield every proposer succeeds with the probability that is promised; without a sound budget it does not."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.certificates.proofs import ProductProof
from certigym.synthesis.extended_check.shields import ProductShield, Shield, shield_of
from certigym.synthesis.extended_check.shields.noise_probabilities import NoiseAxis
from kinds import mostly_thorough
from shield_trials import anything, episodes, the_worst
from team_problems import pairs

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""

EPISODES = 6_000
"""A rate that is .04 below p is refuted with probability above .99."""

START = [-14.0, -4.0]
"""Far enough from the target for a bound in the middle: .80 at 60 cells."""

KINDS = {"exact": 60, "linear": 40, "boxes": 60}


@pytest.fixture(scope="module", params=[*KINDS])
def certificate(request: pytest.FixtureRequest) -> cg.Certificate:
    problem = cg.make_problem("reach-avoid-v0", horizon=5).replace(initial_state=START)
    kind = str(request.param)
    found = cg.synthesize(problem, KINDS[kind], relation=kind).certificate
    assert isinstance(found, cg.Certificate)
    assert found.lower_bound > 0.3
    return found


def refuted(success: np.ndarray, p: float) -> bool:
    """Whether so few successes have a probability below the false alarm if each has probability p or more."""
    return bool(binom.cdf(success.sum(), len(success), p) < FALSE_ALARM)


# --- masses and values -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("hats", [False, True])
def test_masses_around_any_mean_are_below_30_digits_and_near_them(hats: bool) -> None:
    mpmath.mp.dps = 30
    edges = np.array([-3.0, -1.0, -0.99, 0.0, 0.5, 4.0])
    axis = NoiseAxis(edges, 0.37, hats)
    for mean in (-3.2, -1.0, 0.1, 0.493, 3.9):
        found = axis.masses(np.array([mean]))[0]
        for k in range(len(edges) - 1):
            truth = true_masses(mean, edges[k], edges[k + 1], 0.37, hats)
            got = found[2 * k : 2 * k + 2] if hats else found[k : k + 1]
            for number, exact in zip(got, truth, strict=True):
                assert number <= exact
                assert exact - number < 3e-9  # what lies beyond the reach


def true_masses(mean: float, low: float, high: float, std: float, hats: bool) -> list[Any]:
    """Mass of a cell, or of its hats, by quadrature with 30 digits."""
    density = lambda x: mpmath.npdf(x, mean, std)  # noqa: E731
    inside = [low, *(m for m in (mean - std, mean, mean + std) if low < m < high), high]
    if not hats:
        return [mpmath.quad(density, inside)]
    upper = mpmath.quad(lambda x: (x - low) / (mpmath.mpf(high) - low) * density(x), inside)
    return [mpmath.quad(density, inside) - upper, upper]


def test_certified_inputs_are_worth_what_their_states_are(certificate: cg.Certificate) -> None:
    shield = shield_of(certificate, 0.5 * certificate.lower_bound)
    assert isinstance(shield, Shield)
    states, q = somewhere(shield, 300)
    for time in range(certificate.problem.horizon):
        here = shield.certified_inputs(states, q, time)
        q_values = shield.values.of_inputs(time, q, states, here)
        value = shield.values.of_states(states, np.full(300, q), np.full(300, time))
        assert np.all(q_values >= value - 1e-8)  # less what the reach leaves out
        if certificate.proof.agents[0].relation["kind"] == "exact":
            np.testing.assert_allclose(q_values, value, atol=1e-8)


def somewhere(shield: Shield, count: int) -> tuple[tuple[np.ndarray, ...], int]:
    """Random states of all agents, and the automaton state that is undecided."""
    rng = np.random.default_rng(0)
    boxes = [agent.workspace for agent in shield.problem.agents]
    states = tuple(b.low[:, None] + (b.high - b.low)[:, None] * rng.random((len(b.low), count)) for b in boxes)
    return states, int(np.flatnonzero(~shield.problem.automaton.absorbing)[0])


def test_inputs_are_worth_no_more_than_the_next_state_on_average(certificate: cg.Certificate) -> None:
    """20 inputs, 4000 next states each, Hoeffding's limit at 1e-6 for all of them together."""
    shield = shield_of(certificate, 0.5 * certificate.lower_bound)
    assert isinstance(shield, Shield)
    problem, rng, count = certificate.problem, np.random.default_rng(3), 4000
    states, q = somewhere(shield, 20)
    time = 2
    inputs = anything(shield, states, np.full(20, q), np.full(20, time), rng)
    q_values = shield.values.of_inputs(time, q, states, inputs)
    assert q_values.max() > 0.1
    limit = np.sqrt(np.log(20 / FALSE_ALARM) / (2 * count))
    for k in range(20):
        after = []
        for agent, x, u in zip(problem.agents, states, inputs, strict=True):
            mean = agent.mean(x[:, k], u[:, k])
            after.append((mean + rng.standard_normal((count, len(mean))) @ agent.noise_factor.T).T)
        holds = np.concatenate([problem.labeling.class_at(i, x) for i, x in enumerate(after)])
        following = problem.automaton.next_state(np.full(count, q), holds)
        value = shield.values.of_states(tuple(after), following, np.full(count, time + 1))
        assert q_values[k] <= value.mean() + limit


# --- the guarantee ---------------------------------------------------------------------------------------------
@mostly_thorough(("share", "form"), [(0.5, "joint"), (0.99, "decentralised")])
def test_whoever_proposes_succeeds_as_promised(certificate: cg.Certificate, form: str, share: float) -> None:
    shield = shield_of(certificate, share * certificate.lower_bound, form)
    assert isinstance(shield, Shield)
    for number, propose in enumerate((anything, the_worst)):
        found = episodes(shield, propose, EPISODES, number)
        assert not refuted(found["success"], shield.probability)
        assert found["slack"] >= 0.0  # the budget never exceeds the value
        assert np.all(found["budget"] <= found["success"])
        assert 0.0 < found["overridden"] < 1.0


@pytest.mark.thorough
def test_the_adversary_is_left_no_more_than_promised(synthesized: Any) -> None:
    """Where values are the truth the judgement is neither lax nor wasteful: 20,000 episodes, standard error .003."""
    shield = sabotaged(synthesized, 0.99)
    rate = float(episodes(shield, the_worst, 20_000, 5)["success"].mean())
    assert abs(rate - shield.probability) < 0.012


@pytest.mark.thorough
def test_budgets_are_paid_back_on_average(certificate: cg.Certificate) -> None:
    """The mean of the last budgets is at least the first one, up to Hoeffding's limit at 1e-6."""
    shield = shield_of(certificate, 0.9 * certificate.lower_bound)
    assert isinstance(shield, Shield)
    last = episodes(shield, the_worst, EPISODES, 7)["budget"]
    assert last.mean() >= shield.risk_budget - np.sqrt(np.log(1 / FALSE_ALARM) / (2 * EPISODES))


# --- sabotage --------------------------------------------------------------------------------------------------
def one_step_late(shield: Shield, step: dict[str, Any]) -> np.ndarray:
    """The budget from the value of the state before."""
    return np.asarray(step["ratio"] * step["before"])


def one_step_short(shield: Shield, step: dict[str, Any]) -> np.ndarray:
    """The budget from the value with one step less to go."""
    time = np.minimum(step["time"] + 1, shield.problem.horizon)
    return shield.next_budget(step["ratio"], step["states"], step["q"], time)[0]


def never_moved(shield: Shield, step: dict[str, Any]) -> np.ndarray:
    """The same threshold at all times: what luck has given is wasted, what it has taken is not made up for."""
    return np.asarray(step["budget"])


@mostly_thorough("sabotage", [one_step_late, one_step_short, never_moved], first=2)
def test_a_budget_that_is_read_wrongly_is_caught(sabotage: Any, synthesized: Any) -> None:
    shield = sabotaged(synthesized)
    assert refuted(episodes(shield, the_worst, EPISODES, 11, sabotage)["success"], shield.probability)


def test_a_budget_that_is_not_reset_is_caught(synthesized: Any) -> None:
    """Worlds go on with what their last episode has left them: 1 or 0."""
    shield = sabotaged(synthesized)
    last = episodes(shield, the_worst, EPISODES, 12)["budget"]
    again = episodes(shield, the_worst, EPISODES, 13, first=last)
    assert refuted(again["success"], shield.probability)


def test_the_cells_value_in_place_of_the_actions_is_caught(synthesized: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Letting through whatever is proposed where the value of the cell is at least the budget."""
    shield = sabotaged(synthesized)
    values = type(shield.values)

    def cells(self: Any, time: int, q: int, states: Any, inputs: Any) -> np.ndarray:
        count = states[0].shape[1]
        return np.asarray(self.of_states(states, np.full(count, q), np.full(count, time)))

    monkeypatch.setattr(values, "of_inputs", cells)
    assert refuted(episodes(shield, anything, EPISODES, 14)["success"], shield.probability)


def sabotaged(synthesized: Any, share: float = 0.9) -> Shield:
    """A sound shield with exact values, which tests break."""
    problem = cg.make_problem("reach-avoid-v0", horizon=5).replace(initial_state=START)
    certificate = synthesized(problem, 60, relation="exact").certificate
    shield = shield_of(certificate, share * certificate.lower_bound)
    assert isinstance(shield, Shield)
    return shield


# --- starts, tasks, refusals -----------------------------------------------------------------------------------
def test_a_start_in_a_box_keeps_the_mean() -> None:
    problem = cg.make_problem("reach-avoid-v0", horizon=5)
    certificate = cg.synthesize(problem, 60, relation="exact").certificate
    shield = shield_of(certificate, 0.95 * certificate.lower_bound)
    assert isinstance(shield, Shield) and shield.mean is not None
    found = episodes(shield, the_worst, EPISODES, 17)
    assert not refuted(found["success"], shield.probability)
    assert found["slack"] >= 0.0


@pytest.mark.thorough
def test_independent_tasks_share_what_is_kept() -> None:
    certificate = cg.synthesize(
        pairs(10, starts=(-2.0, -1.5)), 24, relation="exact", search=cg.SearchOptions(value="tree")
    ).certificate
    assert isinstance(certificate.proof, ProductProof)
    shield = shield_of(certificate, 0.9 * certificate.lower_bound)
    assert isinstance(shield, ProductShield)
    kept = np.prod([part.probability for part in shield.parts])
    assert shield.probability <= kept <= shield.probability * (1 + 1e-11)
    success = np.ones(4000, dtype=bool)
    for k, part in enumerate(shield.parts):
        success &= episodes(part, anything, 4000, k)["success"]
    assert not refuted(success, shield.probability)


def test_what_is_no_number_is_replaced_by_the_certified_input(certificate: cg.Certificate) -> None:
    for form in ("joint", "decentralised"):
        for p in (1e-9, 0.9 * certificate.lower_bound):
            shield = shield_of(certificate, p, form)
            assert isinstance(shield, Shield)
            states, q = somewhere(shield, 50)
            nothing = tuple(np.full((agent.n_inputs, 50), np.nan) for agent in certificate.problem.agents)
            budget = np.where(np.arange(50) % 2, 0.0, shield.values.of_states(states, np.full(50, q), np.full(50, 1)))
            choice = shield.choose(states, np.full(50, q), np.full(50, 1), budget, nothing)
            for applied, certified in zip(choice.inputs, shield.certified_inputs(states, q, 1), strict=True):
                np.testing.assert_array_equal(applied, certified)
            assert choice.overridden.all()


def test_what_cannot_be_kept_is_refused_in_words(synthesized: Any) -> None:
    problem = cg.make_problem("reach-avoid-v0", horizon=5).replace(initial_state=START)
    certificate = synthesized(problem, 60, relation="exact").certificate
    too_much = 1.0001 * certificate.lower_bound
    for wrong, words in (
        ({"probability": too_much}, "`probability`: expected at most 0"),
        ({"probability": 0.0}, "`probability`: expected a number above 0"),
        ({"probability": True}, "`probability`: expected a number above 0"),
        ({"probability": 0.5, "form": "loose"}, "`form`: expected 'joint' or 'decentralised'"),
    ):
        with pytest.raises(ValueError, match=words):
            shield_of(certificate, **wrong)
    lossy = cg.synthesize(problem, 60, relation="paper", search=cg.SearchOptions(epsilon=0.5)).certificate
    with pytest.raises(ValueError, match="expected relations with"):
        shield_of(lossy, 0.1)
    never_lost = cg.SearchOptions(epsilon=0.5, feedback=-1.0)
    memory = cg.synthesize(problem, 60, relation="paper", search=never_lost).certificate
    with pytest.raises(ValueError, match="without memory, got 'paper'"):
        shield_of(memory, 0.1)
    trains = cg.synthesize(problem, 40, relation="exact", search=cg.SearchOptions(value="train")).certificate
    with pytest.raises(ValueError, match="expected one with a value tree"):
        shield_of(trains, 0.1)
    with pytest.raises(ValueError, match="`certificate`: expected a Synthesis"):
        shield_of(5, 0.1)
