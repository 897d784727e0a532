"""Coupled agents have one automaton: as large as it is when it is built, and not as the product of its parts fears."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

import certigym as cg
from certigym.envs.tasks.automata import AutomatonSizeError, translate
from certigym.envs.tasks.problem import groups
from certigym.validation.statistical_tests import clopper_pearson
from kinds import mostly_thorough

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "eight_zones.toml"

EXPLODING = {
    "windows apart": " & ".join(f"F[{2 + i},{12 + i}] comfort_{i}" for i in range(8)),
    "nested windows": " & ".join(f"F[2,12] (comfort_{i} & F[1,5] !comfort_{i})" for i in range(8)),
    "answers": " & ".join(f"G (comfort_{i} -> F[1,9] !comfort_{i})" for i in range(8)),
}

SECONDS = 5.0
"""What a refusal may take: on one core it takes about a second, and what is counted is states and nodes."""


def data(formula: str) -> dict[str, Any]:
    return {**cg.load(EXAMPLE).to_dict(), "specification": {"formula": formula, "semantics": "finite-trace"}}


def made(formula: str) -> cg.Problem:
    from certigym.envs.tasks.problem import problem_from_dict

    return problem_from_dict(data(formula))


def test_a_window_of_eight_zones_has_few_states() -> None:
    problem = cg.load(EXAMPLE)
    assert problem.groups == () and problem.automaton.n_states == 23
    # 20 states for each of eight zones: the product is far above the limit that was compared with it.
    alone = translate("G[8,20] a", ["a"], "finite-trace")
    assert alone.n_states**8 > groups.MOST_STATES


@pytest.mark.thorough
def test_its_bound_needs_no_options_and_holds_in_rollouts() -> None:
    """Fixed seed, n = 20,000, false alarm 1e-6."""
    result = cg.synthesize(EXAMPLE)
    assert result.certificate.lower_bound > 0.5 and cg.check(result.certificate)
    runs = cg.rollout(result.certificate.problem, result.controller, episodes=20_000, seed=1)
    low, high = clopper_pearson(runs.successes, runs.episodes, 1 - 1e-6)
    assert result.certificate.lower_bound <= high
    assert low <= result.certificate.lower_bound + (result.certificate.gap or 1.0)


@mostly_thorough("name", EXPLODING, first=2)
def test_what_explodes_is_refused_in_time(name: str) -> None:
    began = time.process_time()
    with pytest.raises(ValueError, match=r"joint automaton has more than 1000 states"):
        made(EXPLODING[name])
    assert time.process_time() - began < SECONDS


@pytest.mark.thorough
def test_nodes_are_counted_as_well_as_states() -> None:
    """Two states may need many nodes: pairs that stand far apart in the order of variables do."""
    formula = "G (" + " | ".join(f"(a{i} & b{i})" for i in range(14)) + ")"
    names = [f"a{i}" for i in range(14)] + [f"b{i}" for i in range(14)]  # the worst order: 2^14 nodes
    assert translate(formula, names, "finite-trace").n_states == 2
    with pytest.raises(AutomatonSizeError, match=r"more than 10000 nodes"):
        translate(formula, names, "finite-trace", max_nodes=10_000)


def test_pairs_of_windows_are_one_task_too() -> None:
    """Agents that pairs compare: windows that open together are counted once for them as well."""
    agents = [cg.LinearAgent(
        name=f"a{i}", A=[[1.0]], B=[[1.0]], noise_covariance=[[0.01]], state_low=[-4.0], state_high=[4.0],
        input_low=[-0.5], input_high=[0.5], initial_state=[2.0 * i - 2.0],
    ) for i in range(3)]  # fmt: skip
    problem = cg.Problem(
        name="windows",
        horizon=20,
        agents=agents,
        propositions={"home": cg.Proposition("a*", [-4.0], [4.0]), "near": cg.Pair(["a0", "a1"], [-0.5], [0.5])},
        specification=cg.Specification("G !near & G[8,20] all(home)", "finite-trace"),
    )
    assert problem.groups == () and problem.automaton.n_states < 40
