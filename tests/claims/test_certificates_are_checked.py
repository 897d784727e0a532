"""Every certificate survives the independent check, on disk too, and no tampered one does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import OnGrid, changed, delta_of
from certigym.synthesis.certificates.value_functions.terms import Terms
from certigym.synthesis.relations.grids import Grid
from kinds import mostly_thorough
from problems import scalar_agent, two_agents


@pytest.fixture(scope="module")
def certificate() -> OnGrid:
    return cg.synthesize(two_agents(horizon=5).replace(initial_state=[3.6, 0.4]), 64).certificate


def with_agent(certificate: OnGrid, i: int, **changes: Any) -> OnGrid:
    agents = list(certificate.proof.agents)
    agents[i] = replace(agents[i], **changes)
    return changed(certificate, agents=tuple(agents))


@mostly_thorough(
    "problem",
    [
        two_agents(horizon=5),
        two_agents("F (a & F c) & G[0,2] !b", horizon=5),
        two_agents("G (b -> X d)", "finite-trace", horizon=3),
        two_agents(horizon=3, initial_state=None, initial_low=[-3.0], initial_high=[-1.0]),
        cg.make_problem("reach-avoid-n-v0", n_agents=3),
        cg.make_problem("invariance-4-v0"),
    ],
    first=2,
    ids=lambda problem: f"{problem.specification.formula}-{problem.agents[0].initial.low}",
)
def test_certificates_check_and_survive_the_disk(problem: cg.Problem, tmp_path: Path) -> None:
    certificate = cg.synthesize(problem, 48).certificate
    report = cg.check(certificate, problem)
    assert report, report
    assert certificate.lower_bound <= report.recomputed <= certificate.lower_bound + 1e-8
    cg.save(certificate, tmp_path / "c.npz")
    loaded = cg.load(tmp_path / "c.npz")
    assert cg.check(loaded, problem)
    assert loaded.lower_bound == certificate.lower_bound
    assert loaded.fingerprint == problem.fingerprint
    state = np.concatenate([agent.initial.low for agent in problem.agents])
    np.testing.assert_array_equal(loaded.at(state), certificate.at(state))


def test_the_bound_elsewhere_is_that_of_the_dense_value(certificate: OnGrid) -> None:
    from certigym.synthesis.policy_search.bounds.dense import dense_value
    from certigym.synthesis.verbs.abstract import abstract

    problem = certificate.problem
    models = abstract(problem, 64).models
    dense = dense_value(problem, models, tuple(part.policy for part in certificate.proof.agents))
    rng = np.random.default_rng(1)
    states = rng.uniform(-4, 4, size=(200, 2))
    bounds = certificate.at(states)
    for state, bound in zip(states, bounds):
        letter = problem.labeling.letter([state[:1], state[1:]])
        q = int(problem.automaton.next_state(problem.automaton.initial, letter))
        cells = tuple(int(m.grid.cell_of(x[:, None])[0]) for m, x in zip(models, (state[:1], state[1:])))
        assert bound <= dense[(q, *cells)]
    assert certificate.at([[9.0, 0.0]])[0] == 0.0
    grid = np.array([[a, b] for a in np.arange(1.03125, 3, 0.125) for b in np.arange(0.0625, 1, 0.125)])
    assert certificate.mean([1.0, 0.0], [3.0, 1.0]) == pytest.approx(np.mean(certificate.at(grid)), rel=1e-9)
    assert certificate.min([1.0, 0.0], [3.0, 1.0]) == pytest.approx(np.min(certificate.at(grid)), rel=1e-9)


def raise_the_bound(c: OnGrid) -> OnGrid:
    return changed(c, lower_bound=c.lower_bound + 1e-6)


def command_beyond_the_inputs(c: OnGrid) -> OnGrid:
    return with_agent(c, 0, policy=np.where(c.proof.agents[0].policy >= 0, 0, -1).astype(np.int32))


def use_another_policy(c: OnGrid) -> OnGrid:
    policies = c.proof.agents[0].policy.copy()
    policies[:, :, 20:50] = np.maximum(policies[:, :, 20:50] - 1, policies[:, :, 20:50].min())
    return with_agent(c, 0, policy=policies)


def narrow_the_cells(c: OnGrid) -> OnGrid:
    grid = Grid((c.proof.agents[0].grid.edges[0] * 0.99,))
    return with_agent(c, 0, grid=grid)


def let_guards_overlap(c: OnGrid) -> OnGrid:
    return with_agent(c, 0, masks=np.ones_like(c.proof.agents[0].masks))


def swap_targets(c: OnGrid) -> OnGrid:
    return changed(c, guard_target=c.proof.guard_target[::-1].copy())


def count_a_vertex_twice(c: OnGrid) -> OnGrid:
    first = c.proof.merge_log[0]
    kept = tuple(np.concatenate([rows, rows[:1]]) for rows in first.kept)
    return changed(c, merge_log=(replace(first, kept=kept), *c.proof.merge_log[1:]))


def inflate_the_value_elsewhere(c: OnGrid) -> OnGrid:
    factors = (c.proof.tree.factors[0] * 1.001, c.proof.tree.factors[1])
    return changed(c, terms=Terms(factors, c.proof.tree.index))


def hide_factors_behind_signs(c: OnGrid) -> OnGrid:
    return changed(c, terms=Terms(tuple(np.full_like(own, -5.0) for own in c.proof.tree.factors), c.proof.tree.index))


def turn_the_reserve_for_rounding_around(c: OnGrid) -> OnGrid:
    return changed(c, rank=-(10**16), lower_bound=1.0)


def keep_no_reserve_for_rounding(c: OnGrid) -> OnGrid:
    return changed(c, relative_rounding=0.0)


def list_a_larger_bound(c: OnGrid) -> OnGrid:
    return changed(c, bounds={**c.proof.bounds, "robust tree": 1.0})


def keep_no_tree(c: OnGrid) -> OnGrid:
    return changed(c, merge_log=(), terms=replace(c.proof.tree, index=tuple(rows[:1] for rows in c.proof.tree.index)))


def drop_the_last_step(c: OnGrid) -> OnGrid:
    problem = c.problem.replace(horizon=c.problem.horizon - 1)
    return replace(c, problem=problem)


@pytest.mark.parametrize(
    "tamper",
    [
        raise_the_bound,
        command_beyond_the_inputs,
        use_another_policy,
        narrow_the_cells,
        let_guards_overlap,
        swap_targets,
        count_a_vertex_twice,
        inflate_the_value_elsewhere,
        drop_the_last_step,
        hide_factors_behind_signs,
        turn_the_reserve_for_rounding_around,
        keep_no_reserve_for_rounding,
        keep_no_tree,
        list_a_larger_bound,
    ],
)
def test_tampered_certificates_are_refused(certificate: OnGrid, tamper: Callable[[OnGrid], OnGrid]) -> None:
    original = certificate.problem
    assert cg.check(certificate, original)
    report = cg.check(tamper(certificate), original)
    assert not report
    assert report.failures


@pytest.mark.parametrize("value", ["tree", "train"])
def test_bounds_that_forget_lost_relations_are_refused(value: str) -> None:
    """The value of an abstraction alone, under any name, is no bound where relations can be lost."""
    problem = cg.Problem(
        name="one",
        horizon=3,
        agents=[scalar_agent("one", A=[[1.1]])],
        propositions={"goal": cg.Proposition("one", [1.0], [3.0])},
        specification=cg.Specification("F goal", "co-safe"),
    )
    certificate = cg.synthesize(
        problem, 200, relation="paper", search=cg.SearchOptions(epsilon=0.3, value=value)
    ).certificate
    assert delta_of(certificate) > 0 and certificate.lower_bound > 0.1 and cg.check(certificate)
    assert not cg.check(changed(certificate, lower_bound=certificate.lower_bound + 0.01))
    refused = ["nominal", "none", ""] + ["robust tree"] * (value == "train")
    for bound in refused:
        assert not cg.check(changed(certificate, bound=bound))
        assert not cg.check(changed(certificate, bound=bound, lower_bound=certificate.lower_bound + 0.01))


def test_correlated_noise_is_refused_on_cells() -> None:
    """The search makes no such cells; a certificate whose problem gets correlated noise afterwards does not check."""
    values: dict[str, Any] = {
        "A": np.eye(2), "B": np.eye(2), "state_low": [-1, -1], "state_high": [1, 1], "input_low": [-1, -1],
        "input_high": [1, 1], "initial_state": [0, 0],
    }  # fmt: skip
    alone, together = (
        cg.Problem(
            name="one",
            horizon=2,
            agents=[cg.LinearAgent(name="one", noise_covariance=[[0.1, c], [c, 0.1]], **values)],
            propositions={"g": cg.Proposition("one", [0, 0], [1, 1])},
            specification=cg.Specification("F g", "co-safe"),
        )
        for c in (0.0, 1e-6)
    )
    certificate = cg.synthesize(alone, 8, relation="exact").certificate
    assert cg.check(certificate) and "not independent" in str(cg.check(replace(certificate, problem=together)))
    for relation in ("exact", "linear", "boxes"):
        with pytest.raises(ValueError, match="correlated noise"):
            cg.synthesize(together, 8, relation=relation)


def test_a_certificate_for_another_noise_is_refused(certificate: OnGrid) -> None:
    agents = [agent.replace(noise_covariance=[[0.3]]) for agent in certificate.problem.agents]
    other = two_agents(horizon=5)
    other = cg.Problem(
        name="two", horizon=5, agents=agents, propositions=other.propositions, specification=other.specification
    )
    assert not cg.check(certificate, other)
    assert not cg.check(replace(certificate, problem=other))
