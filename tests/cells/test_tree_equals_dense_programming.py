"""The value tree is the dense joint dynamic program: equal in exact rationals, and below it where terms are dropped."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from certigym import LinearAgent, Problem, Proposition, Specification
from certigym.synthesis.abstraction.kernels import kernel
from certigym.synthesis.abstraction.kernels.kernel import AxisTable, Kernel
from certigym.synthesis.abstraction.models import gather
from certigym.synthesis.abstraction.models.finite_models import AgentModel
from certigym.synthesis.abstraction.models.guards import compile_guards
from certigym.synthesis.abstraction.models.joint import cell_masks, join, start_of
from certigym.synthesis.abstraction.models.target_windows import TargetWindows
from certigym.synthesis.certificates.value_functions.terms import Terms
from certigym.synthesis.policy_search.ascent.coordinate_ascent import resting_policies, sweep
from certigym.synthesis.policy_search.ascent.limits import Limits
from certigym.synthesis.policy_search.ascent.occupancy import forward
from certigym.synthesis.policy_search.ascent.tree import assemble, candidates, terminal_terms
from certigym.synthesis.policy_search.bounds.dense import dense_optimum, dense_value
from certigym.synthesis.verbs.abstract import abstract
from problems import exact_model, fractions, scalar_agent

FORMULAS = [
    ("(!p0 | !p2) U p1", "co-safe"),
    ("F (p0 & F p2) | X p3", "co-safe"),
    ("F (p1 & p3) & F (p0 | p2)", "co-safe"),
    ("p0 -> X (p2 U p1)", "co-safe"),
    ("G (p0 -> F p2)", "finite-trace"),
    ("G !(p1 & p3) & F p2", "finite-trace"),
    ("(p0 <-> p3) R (p1 | X p2)", "finite-trace"),
]


def problem_of(n_agents: int, formula: str, semantics: str, horizon: int) -> Problem:
    names = [f"r{i}" for i in range(n_agents)]
    regions = [([-4.0], [0.0]), ([-2.0], [2.0]), ([0.0], [4.0]), ([-3.0], [1.0])]
    propositions = {f"p{k}": Proposition(names[k * n_agents // 4], *regions[k]) for k in range(4)}
    return Problem(
        name="random",
        horizon=horizon,
        agents=[scalar_agent(n) for n in names],
        propositions=propositions,
        specification=Specification(formula, semantics),
    )


@st.composite
def exact_problems(draw: Any) -> tuple[Problem, list[AgentModel], tuple[np.ndarray, ...]]:
    """Problems with random exact kernels, random label sets per cell (robust automaton) and random policies."""
    n_agents = draw(st.integers(1, 3))
    formula, semantics = draw(st.sampled_from(FORMULAS))
    horizon = draw(st.integers(1, 4))
    problem = problem_of(n_agents, formula, semantics, horizon)
    models, policies = [], []
    for i in range(n_agents):
        n_cells, n_lattice = draw(st.integers(2, 4)), draw(st.integers(1, 3))
        row = st.lists(st.integers(0, 5), min_size=n_cells, max_size=n_cells)
        weights = draw(st.lists(row, min_size=n_lattice, max_size=n_lattice))
        n_classes = len(problem.labeling.classes[i])
        some = st.lists(st.booleans(), min_size=n_classes, max_size=n_classes).filter(any)
        sets = draw(st.lists(some, min_size=1, max_size=3, unique_by=tuple))
        labels = draw(st.lists(st.integers(-1, len(sets) - 1), min_size=n_cells, max_size=n_cells))
        models.append(exact_model(problem, i, fractions(weights, 5 * n_cells), labels, sets))
        shape = (horizon, problem.automaton.n_states, n_cells)
        size = int(np.prod(shape))
        policy = draw(st.lists(st.integers(-1, n_lattice - 1), min_size=size, max_size=size))
        policies.append(np.array(policy, dtype=np.int32).reshape(shape))
    return problem, models, tuple(policies)


def tree_value(problem: Problem, models: list[AgentModel], policies: tuple[np.ndarray, ...]) -> Terms:
    """The value tree without pruning, on whatever numbers the kernels hold."""
    automaton = problem.automaton
    guards = compile_guards(problem, [model.labels.sets for model in models])
    masks = cell_masks(guards, [model.labels for model in models])
    n_cells = [model.n_cells for model in models]
    terms = terminal_terms(automaton.accepting, n_cells, dtype=object)
    for t in reversed(range(problem.horizon)):
        options = candidates(guards, masks, models, terms)
        parts = []
        for q in range(automaton.n_states):
            if automaton.semantics == "co-safe" and automaton.accepting[q]:
                parts.append(
                    ([np.ones((1, n), dtype=object) for n in n_cells], np.zeros((1, len(models)), dtype=np.int64))
                )
            else:
                parts.append(
                    ([gather(s, policies[i][t, q]) for i, s in enumerate(options.backed_up)], options.index[q])
                )
        terms = assemble(parts, n_cells, dtype=object)
    return terms


@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(exact_problems())
def test_the_tree_is_the_dense_value_in_exact_rationals(
    case: tuple[Problem, list[AgentModel], tuple[np.ndarray, ...]],
) -> None:
    problem, models, policies = case
    dense = dense_value(problem, models, policies)
    terms = tree_value(problem, models, policies)
    joint = np.stack(np.meshgrid(*(np.arange(m.n_cells) for m in models), indexing="ij"), axis=-1).reshape(
        -1, len(models)
    )
    for q in range(problem.automaton.n_states):
        if problem.automaton.dead[q]:
            continue
        values = terms.at(q, joint)
        for cells, value in zip(joint, values):
            expected = dense[(q, *cells)]
            assert isinstance(expected, int | Fraction)
            assert value == expected


@pytest.mark.parametrize(("formula", "semantics"), FORMULAS)
@pytest.mark.parametrize("n_agents", [1, 2])
def test_the_ascent_reports_the_value_of_the_policy_it_returns(formula: str, semantics: str, n_agents: int) -> None:
    problem = problem_of(n_agents, formula, semantics, 4)
    abstraction = abstract(problem, 24)
    joint = join(problem, abstraction)
    start = start_of(problem, joint)
    found = sweep(joint, resting_policies(joint), None, Limits(0, 0, 0, 10**6), improve=True)
    found = sweep(joint, found.policies, start, Limits(0, 0, 0, 10**6), improve=True)
    dense = dense_value(problem, abstraction.models, found.policies)
    q = problem.initial_q
    cells = tuple(int(np.flatnonzero(f[0])[0]) for f in start.terms.factors)
    assert found.value == pytest.approx(dense[(q, *cells)], rel=1e-12, abs=1e-300)
    assert found.value <= dense_optimum(problem, abstraction.models)[(q, *cells)] * (1 + 1e-12)


def random_law(model: AgentModel, policy: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Admissible targets drawn at random wherever there are any."""
    windows = model.choices
    assert isinstance(windows, TargetWindows)
    drawn = rng.integers(windows.low[:, 0], windows.high[:, 0], size=policy.shape)
    return np.asarray(np.where(policy < 0, policy, drawn).astype(np.int32))


@pytest.mark.parametrize("seed", range(8))
def test_without_pruning_a_sweep_never_lowers_the_value(seed: int) -> None:
    formula, semantics = FORMULAS[seed % len(FORMULAS)]
    problem = problem_of(2, formula, semantics, 5).replace(initial_state=[3.5, -3.5])
    joint = join(problem, abstract(problem, 24))
    start = start_of(problem, joint)
    rng = np.random.default_rng(seed)
    policies = tuple(random_law(model, policy, rng) for policy, model in zip(resting_policies(joint), joint.models))
    values = [sweep(joint, policies, start, Limits(0, 0, 0, 10**6), improve=False).value]
    for _ in range(4):
        result = sweep(joint, policies, start, Limits(0, 0, 0, 10**6), improve=True)
        policies = result.policies
        values.append(result.value)
    assert all(b >= a * (1 - 1e-12) for a, b in zip(values, values[1:])), values
    assert (
        values[-1] > values[0] or (problem.automaton.accepting & (np.arange(joint.n_states) == problem.initial_q)).any()
    )


def test_a_single_agent_reaches_the_optimum_of_its_abstraction() -> None:
    problem = problem_of(1, "(!p0 | !p2) U p1", "co-safe", 6).replace(initial_state=[3.5])
    abstraction = abstract(problem, 40)
    joint = join(problem, abstraction)
    start = start_of(problem, joint)
    found = sweep(joint, resting_policies(joint), start, Limits(), improve=True)
    best = dense_optimum(problem, abstraction.models)[
        problem.initial_q, int(np.flatnonzero(start.terms.factors[0][0])[0])
    ]
    assert found.rank <= 2
    assert found.value == pytest.approx(best, rel=1e-12)


@pytest.mark.parametrize("share", [1e-6, 1e-3, 1e-1])
def test_pruning_only_lowers_the_value_and_by_no_more_than_it_says(share: float) -> None:
    problem = problem_of(2, "(!p0 | !p2) U p1", "co-safe", 7).replace(initial_state=[3.5, 0.2])
    joint = join(problem, abstract(problem, 32))
    start = start_of(problem, joint)
    policies = sweep(joint, resting_policies(joint), None, Limits(), improve=True).policies
    full = sweep(joint, policies, start, Limits(0, 0, 0, 10**6), improve=False)
    pruned = sweep(joint, policies, start, Limits(share, 1.0, share, 10**6), improve=False)
    assert pruned.rank < full.rank
    assert pruned.value <= full.value <= pruned.value + pruned.dropped
    assert pruned.dropped <= 20 * share


def test_alive_mass_never_exceeds_one_and_counts_what_it_drops() -> None:
    problem = problem_of(2, "(!p0 | !p2) U p1", "co-safe", 6).replace(initial_state=[3.5, 0.2])
    joint = join(problem, abstract(problem, 32))
    start = start_of(problem, joint)
    policies = resting_policies(joint)
    whole = forward(joint, policies, start, Limits(0, 0, 0, 10**6))
    cut = forward(joint, policies, start, Limits(0, 0, 1e-2, 10**6))
    for a, b in zip(whole, cut):
        mass = [sum(o.masses(q).sum() for q in range(joint.n_states)) for o in (a, b)]
        assert mass[1] * (1 - 1e-12) <= mass[0] <= min(1.0, mass[1] + b.leftover) * (1 + 1e-12)
    assert cut[-1].leftover > 0


def test_kernels_take_rows_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    table, rng = AxisTable.dense, np.random.default_rng(3)
    maker = Kernel((table(rng.random((5, 4)) / 4), table(rng.random((6, 3)) / 3)))
    values, policy = rng.random((9, 12)), rng.integers(-1, 30, 12)
    whole = maker.backup(values), maker.propagate(values, policy)
    for numbers in (1, 70, 200):
        monkeypatch.setattr(kernel, "NUMBERS_AT_ONCE", numbers)
        for one, other in zip(whole, (maker.backup(values), maker.propagate(values, policy)), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-14)


def test_two_dimensional_agents_agree_with_dense_programming() -> None:
    agent = LinearAgent(
        name="plane",
        A=[[0.9, 0.1], [-0.1, 0.8]],
        B=[[0.5, 0.0], [0.0, -0.4]],
        noise_covariance=[[0.2, 0.0], [0.0, 0.1]],
        state_low=[-2, -2],
        state_high=[2, 2],
        input_low=[-3, -3],
        input_high=[3, 3],
        initial_state=[-1.2, -1.1],
    )
    other = scalar_agent("line")
    problem = Problem(
        name="plane",
        horizon=3,
        agents=[agent, other],
        propositions={"goal": Proposition("plane", [0.5, 0.0], [2.0, 1.0]), "safe": Proposition("line", [-1.0], [1.0])},
        specification=Specification("safe U (goal & safe)", "co-safe"),
    )
    abstraction = abstract(problem, {"plane": [8, 8], "line": 8})
    joint = join(problem, abstraction)
    start = start_of(problem, joint)
    found = sweep(joint, resting_policies(joint), start, Limits(0, 0, 0, 10**6), improve=True)
    dense = dense_value(problem, abstraction.models, found.policies)
    cells = tuple(int(np.flatnonzero(f[0])[0]) for f in start.terms.factors)
    assert found.value == pytest.approx(dense[(problem.initial_q, *cells)], rel=1e-12)
    assert found.value > 0.05
