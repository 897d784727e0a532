"""What pairs may spoil is bounded from above: against a dense enumeration, sabotage, and an independent simulation."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import certigym as cg
from certigym.synthesis.abstraction.models import Settings, abstraction_of, join
from certigym.synthesis.certificates.proofs import Certificate, UnionBoundProof, changed
from certigym.synthesis.composition import CollisionProbability, relevant_pairs, usual_values, without_pairs
from certigym.synthesis.composition import collision_probability as near_module
from certigym.synthesis.extended_check.claims.pairs_check import wrong_pairs
from certigym.synthesis.relations.grids import RelationRefused
from certigym.synthesis.verbs.upper_bounds import bound_above
from certigym.validation.statistical_tests.binomial import clopper_pearson
from kinds import mostly_thorough
from pair_problems import followers, mover, random_pairs, simulated

APART = "G !any(near) & F G goal"
PHASES = "!any(near) U (home & (!any(near) U goal))"


def dense(problem: cg.Problem, certificate: Certificate[UnionBoundProof]) -> float:
    """Return the sum over steps and pairs of the probability of being near, on the product of all cells.

    Every joint cell, letter by letter, with normal distribution functions: nothing here knows of products or modes.
    """
    base, agents = certificate.proof.base, problem.agents
    grids = [part.grid.centres[:, 0] for part in base.proof.agents]
    edges = [part.grid.edges[0] for part in base.proof.agents]
    spread = [float(np.sqrt(agent.noise_covariance[0, 0])) for agent in agents]
    automaton, first = problem.automaton, problem.labeling.first_pair
    mass, total = dict[tuple[int, tuple[int, ...]], float](), 0.0
    for k, pair in enumerate(problem.labeling.pairs):
        if asks(problem, automaton.initial, first + k):
            near = near_at_start(agents[pair.first].initial, agents[pair.second].initial, pair)
            total += 1.0 - near if certificate.proof.usual[k] else near
    shares = [overlaps(e, agent.initial) for e, agent in zip(edges, agents)]
    for cells in itertools.product(*(np.flatnonzero(share).tolist() for share in shares)):
        letter = base.problem.labeling.letter([[g[s]] for g, s in zip(grids, cells)])
        q = int(base.problem.automaton.next_state(automaton.initial, letter))
        if not base.problem.automaton.absorbing[q]:
            mass[q, cells] = float(np.prod([share[s] for share, s in zip(shares, cells)]))
    for t in range(problem.horizon):
        following: dict[tuple[int, tuple[int, ...]], float] = {}
        for (q, at), weight in mass.items():
            points = [int(part.points(t, q)[s]) for part, s in zip(base.proof.agents, at)]
            means = [part.lattice[0][z] for part, z in zip(base.proof.agents, points)]
            for k, pair in enumerate(problem.labeling.pairs):
                # Does the automaton ask for this pair in q? Try all letters.
                if asks(problem, q, first + k):
                    gap = means[pair.first] - means[pair.second]
                    std = np.hypot(spread[pair.first], spread[pair.second])
                    near = norm.cdf((pair.high[0] - gap) / std) - norm.cdf((pair.low[0] - gap) / std)
                    total += weight * float(1.0 - near if certificate.proof.usual[k] else near)
            rows = [np.diff(norm.cdf((e - m) / s)) for e, m, s in zip(edges, means, spread)]
            joint = weight * rows[0]
            for row in rows[1:]:
                joint = np.multiply.outer(joint, row)
            for at_next, arrived in np.ndenumerate(joint):
                if arrived > 1e-12:
                    letter = base.problem.labeling.letter([[g[s]] for g, s in zip(grids, at_next)])
                    target = int(base.problem.automaton.next_state(q, letter))
                    if not base.problem.automaton.absorbing[target]:
                        key = target, tuple(int(s) for s in at_next)
                        following[key] = following.get(key, 0.0) + float(arrived)
        mass = following
    return total


def near_at_start(first: Any, second: Any, pair: Any) -> float:
    """Return how likely two scalar agents with starts drawn from boxes are near: a mean over starts of the first."""
    x = first.low[0] + (np.arange(100_000) + 0.5) / 100_000 * (first.high[0] - first.low[0])
    low, high = x - pair.high[0], x - pair.low[0]
    if second.high[0] == second.low[0]:
        return float(np.mean((low < second.low[0]) & (second.low[0] <= high)))
    inside = np.clip(high, second.low[0], second.high[0]) - np.clip(low, second.low[0], second.high[0])
    return float(np.mean(inside) / (second.high[0] - second.low[0]))


def overlaps(edges: Any, start: Any) -> Any:
    """Return the share of a scalar start in each cell."""
    if start.high[0] == start.low[0]:
        return (edges[:-1] <= start.low[0]) & (start.low[0] < edges[1:])
    return np.diff(np.clip(edges, start.low[0], start.high[0])) / (start.high[0] - start.low[0])


def asks(problem: cg.Problem, q: int, p: int) -> bool:
    """Whether some letter leads elsewhere from q if proposition p is changed."""
    n = len(problem.labeling.names)
    letters = (np.arange(1 << n)[None] >> np.arange(n)[:, None] & 1).astype(bool)
    flipped = letters.copy()
    flipped[p] = ~flipped[p]
    states = np.full(1 << n, q)
    return bool(np.any(problem.automaton.next_state(states, letters) != problem.automaton.next_state(states, flipped)))


def spread_starts(problem: cg.Problem, reach: float) -> cg.Problem:
    """Return the problem with starts that are drawn from boxes around those that it has."""
    low = {agent.name: agent.initial.low - reach for agent in problem.agents}
    high = {agent.name: agent.initial.high + reach for agent in problem.agents}
    return problem.replace(initial_low=low, initial_high=high)


@mostly_thorough(
    ("problem", "is_tight"),
    [
        (followers(APART, near=([-2.9], [1.0]), horizon=4), True),
        (followers("!any(near) U goal", near=([-2.4], [1.0]), semantics="co-safe", horizon=4), False),
        (followers(PHASES, near=([-2.0], [1.0]), semantics="co-safe", horizon=4), False),
        (followers("G any(near) & F G goal", near=([-3.9], [-1.0]), horizon=4), True),
        (followers("(home | any(near)) U goal", near=([-3.9], [-1.0]), semantics="co-safe", horizon=4), False),
        (followers(APART, near=([-1.4], [-0.5]), horizon=3, starts=((-2.5,), (-0.5,), (1.5,))), True),
        (spread_starts(followers(APART, near=([-2.9], [1.0]), horizon=3), 0.2), True),
        (spread_starts(followers(PHASES, near=([-2.0], [1.0]), semantics="co-safe", horizon=3), 1.0), False),
        (spread_starts(followers("G any(near) & F G goal", near=([-3.9], [-1.0]), horizon=3), 0.5), True),
    ],
    first=3,
)
def test_masses_are_those_of_a_dense_enumeration(problem: cg.Problem, is_tight: bool) -> None:
    """Where one mode covers all undecided states nothing is lost; elsewhere the bound is larger, never smaller."""
    certificate: Any = cg.synthesize(problem, 16, relation="exact", search=cg.SearchOptions(max_sweeps=0)).certificate
    truth = dense(problem, certificate)
    failures, again = wrong_pairs(certificate, problem)
    assert failures == [] and truth > 1e-6
    for bound in (certificate.proof.near, again):
        assert bound >= min(1.0, truth) * (1.0 - 1e-9)
    if is_tight:
        assert again <= truth * (1.0 + 1e-6) + 1e-9
        assert certificate.proof.near <= truth * (1.0 + 1e-6) + 1e-9
    assert cg.check(certificate)


def test_bounds_are_tight_enough_to_be_used() -> None:
    """Two planar robots that swap places: the bound is within .02 of what rollouts show."""
    found = cg.synthesize(cg.make_problem("swarm-v0", n_agents=2), 32)
    report = cg.validate(found, episodes=20_000)
    assert not report.refuted
    assert found.certificate.lower_bound >= report.estimate - 0.02
    assert found.stats["tried"]["exact"] == found.certificate.lower_bound  # type: ignore[index]


def certificate_of(problem: cg.Problem) -> Certificate[UnionBoundProof]:
    certificate: Any = cg.synthesize(problem, 16, relation="exact", search=cg.SearchOptions(max_sweeps=0)).certificate
    return certificate


def near_of(
    certificate: Certificate[UnionBoundProof],
    problem: cg.Problem,
    masses: type[CollisionProbability] = CollisionProbability,
) -> float:
    """Return what another problem's pairs, or a broken bound, say of the policies of a certificate."""
    usual = usual_values(problem)
    base = without_pairs(problem, usual)
    kinds = ["exact"] * problem.n_agents
    abstraction = abstraction_of(base, 16, kinds, Settings())
    bound = masses(problem, base, join(base, abstraction), relevant_pairs(problem), usual)
    return bound.bound(tuple(part.policy for part in certificate.proof.base.proof.agents))


class OneStepEarly(CollisionProbability):
    """Occupancy of the wrong step: the masses of the last step are not charged, those of the first one twice."""

    def course(self, policies: Any) -> Any:
        terms, points = super().course(policies)
        return [terms[0], *terms[:-1]], [points[0], *points[:-1]]


class OnlyTheFirstPair(CollisionProbability):
    """A pair is left out."""

    def _near(self, asked: Any, masses: Any) -> float:
        return super()._near(asked[:1], masses)


class Negated(CollisionProbability):
    """The difference is that of the second agent less the first."""

    def tables(self, pair: Any, from_below: bool = False) -> Any:
        return super().tables(replace(pair, low=-pair.high, high=-pair.low), from_below)


class Halved(CollisionProbability):
    """Only one of the two agents has noise."""

    def tables(self, pair: Any, from_below: bool = False) -> Any:
        lattices = [self.joint.models[i].lattice[0] for i in (pair.first, pair.second)]
        std = float(np.sqrt(self.problem.agents[pair.first].noise_covariance[0, 0]))
        first, second = lattices
        return [near_module._near_table(first, second, std, (float(pair.low[0]), float(pair.high[0])))]


THREE = ((-2.5,), (-0.5,), (1.5,))
TRIPLE = followers("G !any(near)", near=([-1.2], [0.4]), horizon=4, starts=THREE)


@pytest.mark.parametrize("broken", [OneStepEarly, OnlyTheFirstPair, Negated, Halved])
def test_the_check_refuses_what_a_broken_bound_claims(broken: type[CollisionProbability]) -> None:
    certificate = certificate_of(TRIPLE)
    assert cg.check(certificate) and 1e-6 < certificate.proof.near < 1.0
    wrong = near_of(certificate, TRIPLE, broken)
    assert wrong < certificate.proof.near
    report = cg.check(changed(certificate, near=wrong))
    assert not report and "pairs spoil" in str(report)


def with_base(change: Callable[[cg.Problem], cg.Problem]) -> Certificate[UnionBoundProof]:
    """A certificate whose base is that of a changed problem."""
    certificate = certificate_of(TRIPLE)
    other = certificate_of(change(TRIPLE))
    return changed(certificate, base=other.proof.base, near=1e-3)


def formula(problem: cg.Problem, text: str) -> cg.Problem:
    return cg.Problem(
        name="other",
        horizon=problem.horizon,
        agents=problem.agents,
        propositions=problem.declared,
        specification=cg.Specification(text, "finite-trace"),
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda problem: problem.replace(horizon=3), "horizon"),
        (lambda problem: problem.replace(disturbance_scale=0.5), "agents of its base"),
        (lambda problem: formula(problem, "G (!any(near) & !goal)"), "automaton of its base"),
        (lambda problem: problem.replace(initial_state={"agent_0": [-1.0]}), "agents of its base"),
    ],
)
def test_the_check_refuses_the_base_of_another_problem(change: Any, message: str) -> None:
    report = cg.check(with_base(change))
    assert not report and message in str(report)


def test_the_check_refuses_certificates_that_know_nothing_of_pairs() -> None:
    certificate = certificate_of(TRIPLE)
    report = cg.check(replace(certificate.proof.base, problem=TRIPLE))
    assert not report and "of which it knows nothing" in str(report)
    assert not cg.check(changed(certificate, near=0.0))
    assert not cg.check(certificate, TRIPLE.replace(horizon=5))


def test_pairs_that_are_near_at_the_start_spoil_everything() -> None:
    certificate = certificate_of(followers("G !any(near)", starts=((0.0,), (0.5,))))
    assert certificate.proof.near == 1.0 and certificate.lower_bound == 0.0
    assert not cg.check(changed(certificate, near=0.5))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"output_matrix": [[2.0]]}, "compares states"),
        ({"noise": [{"law": "uniform", "low": -0.3, "high": 0.3}], "noise_covariance": None}, "Gaussian"),
        ({"B": [[0.0]]}, "full row rank"),
    ],
)
def test_what_subtraction_cannot_say_is_refused_in_words(changes: dict[str, Any], message: str) -> None:
    problem = cg.Problem(
        name="refused",
        horizon=2,
        agents=[mover("agent_0", [-2.5], **changes), mover("agent_1", [2.0])],
        propositions={"near": cg.Pair("agent_*", [-1.0], [1.0])},
        specification=cg.Specification("G !any(near)", "finite-trace"),
    )
    with pytest.raises(RelationRefused, match=message):
        cg.synthesize(problem, 8, relation="exact")


@pytest.mark.thorough
def test_claims_about_random_problems_survive_an_independent_simulation() -> None:
    """12 problems, fixed seeds, 3000 episodes each; false alarm 1e-6 over all claims; gaps of .03 would be seen.

    Claims are tested from both sides where they have two.
    """
    informative, two_sided = 0, 0
    for seed in range(12):
        problem = random_pairs(np.random.default_rng(seed))
        certificate: Any = cg.synthesize(
            problem, 12, relation="exact", search=cg.SearchOptions(max_sweeps=2)
        ).certificate
        assert cg.check(certificate), seed
        successes = simulated(problem, certificate.controller, 3000, seed)
        least, most = clopper_pearson(successes, 3000, 1.0 - 1e-6 / 12)
        assert certificate.lower_bound <= most, seed
        assert certificate.gap is None or least <= certificate.lower_bound + certificate.gap, seed
        informative += 0.02 < certificate.lower_bound < 0.999
        two_sided += certificate.gap is not None and certificate.lower_bound + certificate.gap < 0.999
    assert informative >= 3 and two_sided >= 2


def test_upper_ends_are_claimed_and_checked_where_pairs_can_save_nothing() -> None:
    certificate = certificate_of(TRIPLE)
    report = cg.check(certificate)
    assert certificate.gap is not None and report.above is not None
    assert report.above <= certificate.lower_bound + certificate.gap
    wanted = certificate_of(followers("F any(near)", near=([-1.2], [0.4]), horizon=4, starts=THREE))
    assert wanted.gap is None and cg.check(wanted)
    forged = changed(wanted, base=changed(wanted.proof.base, gap=0.25))
    assert "an upper end" in str(cg.check(forged))


def test_pairs_may_compare_different_states_of_one_agent() -> None:
    """Tables of both pairs are equal, but one is read along x of the second agent, the other along y."""
    one: dict[str, Any] = {
        "A": np.eye(2), "B": np.eye(2), "noise_covariance": 0.01 * np.eye(2), "state_low": [-2, -2],
        "state_high": [2, 2], "input_low": [-1, -1], "input_high": [1, 1],
    }  # fmt: skip
    agents = [
        cg.LinearAgent(name="a", initial_state=[-1.0, -1.0], **one),
        cg.LinearAgent(name="b", initial_state=[1.3, -0.5], **one),
    ]
    regions: dict[str, Any] = {
        "goal": cg.Proposition("a", [0.5, -2.0], [2.0, 2.0]),
        "far": cg.Pair(["a", "b"], [-0.2], [0.2], outputs=[[1], [0]]),
        "close": cg.Pair(["a", "b"], [-0.2], [0.2], outputs=[[1], [1]]),
    }
    task = cg.Specification("(!(far | close)) U goal", "co-safe")
    problem = cg.Problem(name="axes", horizon=3, agents=agents, propositions=regions, specification=task)
    certificate = cg.synthesize(problem, 20, relation="exact", search=cg.SearchOptions(max_sweeps=0)).certificate
    assert isinstance(certificate.proof, UnionBoundProof) and 1e-4 < certificate.proof.near < 1.0
    report = cg.check(certificate)
    assert report and report.recomputed - certificate.lower_bound < 1e-6


def test_upper_ends_count_the_runs_that_cells_lose_from_sight() -> None:
    """A disc cuts through cells: runs there are failed for the lower bound, and a pair makes a success of them."""
    agents = [
        cg.LinearAgent(
            name=name, A=np.eye(2), B=np.eye(2), noise_covariance=4e-4 * np.eye(2), state_low=[-3.0, -3.0],
            state_high=[3.0, 3.0], input_low=[-0.4, -0.4], input_high=[0.4, 0.4], initial_state=[x, 0.0],
        )
        for name, x in (("stays", -0.6), ("comes", -1.6))
    ]  # fmt: skip
    problem = cg.Problem(
        name="lost from sight", horizon=8, agents=agents,
        propositions={
            "hazard": cg.Proposition("stays", disc={"centre": [0.0, 0.0], "radius": 0.5}),
            "goal": cg.Proposition("stays", [2.5, 2.5], [3.0, 3.0]),
            "near": cg.Pair(["stays", "comes"], distance=0.6),
        },
        specification=cg.Specification("!hazard U (goal | near)", "co-safe"),
    )  # fmt: skip
    policy = {"stays": lambda x, q, t: np.zeros(2), "comes": lambda x, q, t: np.array([0.3, 0.0])}
    certificate: Any = bound_above(cg.certify(problem, policy, 24, relation="exact").certificate)
    assert certificate.gap is None and not cg.validate(certificate, 1000).refuted
    base = certificate.proof.base
    ended = replace(certificate, proof=replace(certificate.proof, base=bound_above(base)))
    assert (
        ended.upper_bound < 0.01 and cg.compare(problem, {"certified": ended.controller}, 1000).entries[0].rate > 0.99
    )
    report = cg.check(ended)
    assert not report and "no certain class" in report.failures[0]


def test_masses_that_are_next_to_nothing_charge_next_to_nothing() -> None:
    """Their product is below all numbers: it may not be divided by."""
    problem = followers(APART)
    usual = usual_values(problem)
    base = without_pairs(problem, usual)
    abstraction = abstraction_of(base, 16, ["exact"] * 2, Settings())
    masses = CollisionProbability(problem, base, join(base, abstraction), relevant_pairs(problem), usual)
    sizes = [len(model.lattice[0]) for model in masses.joint.models]
    tiny = [np.full(size, 1e-200) for size in sizes]
    assert masses._near(np.array([0]), tiny) == 0.0
    assert masses._near(np.array([0]), [np.full(size, 1.0 / size) for size in sizes]) > 0.0
