"""Coupled agents have one automaton: as large as it is when it is built, and not as the product of its parts fears."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

import certigym as cg
from certigym.envs.tasks.automata import translate
from certigym.envs.tasks.problem import groups
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


@mostly_thorough("name", EXPLODING, first=2)
def test_what_explodes_is_refused_in_time(name: str) -> None:
    began = time.process_time()
    with pytest.raises(ValueError, match=r"joint automaton has more than 1000 states"):
        made(EXPLODING[name])
    assert time.process_time() - began < SECONDS


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
