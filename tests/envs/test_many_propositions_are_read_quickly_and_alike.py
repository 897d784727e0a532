"""Chains of a decision diagram are read at once, and pairs run by run: to the same bits as one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.simulation import blocks
from certigym.envs.tasks.automata import Automaton, translate


def one_by_one(automaton: Automaton, q: int, letter: np.ndarray) -> int:
    """The state after a letter (P,), node by node."""
    at = int(automaton.root[q])
    while at >= 0:
        at = int(automaton.high[at] if letter[automaton.variable[at]] else automaton.low[at])
    return -1 - at


@pytest.mark.parametrize(
    "formula",
    [
        "G (" + " & ".join(f"!p{k}" for k in range(40)) + ")",
        "(" + " & ".join(f"!p{k}" if k % 3 else f"p{k}" for k in range(30)) + ") U (p30 | p31)",
        "F (" + " | ".join(f"p{k}" for k in range(25)) + ") & G !p25",
        "(!p0 U p1) & F (" + " & ".join(f"p{k}" for k in range(2, 20)) + ")",
    ],
)
def test_long_chains_lead_where_their_nodes_do(formula: str) -> None:
    names = sorted({word.strip("!") for word in formula.replace("(", " ").replace(")", " ").split() if "p" in word})
    automaton = translate(formula, names, "finite-trace")
    rng = np.random.default_rng(3)
    assert max(len(automaton._chain(int(node))[0]) for node in automaton.root if node >= 0) >= 15
    for share in (0.02, 0.5, 0.98):
        q = rng.integers(automaton.n_states, size=300)
        letters = rng.random((len(automaton.propositions), 300)) < share
        found = automaton.next_state(q, letters)
        assert found.tolist() == [one_by_one(automaton, int(a), letter) for a, letter in zip(q, letters.T, strict=True)]
    # one state alone, and states that a few entries are in
    alone = np.zeros(50, dtype=int)
    alone[7] = automaton.n_states - 1
    letters = np.zeros((len(automaton.propositions), 50), dtype=bool)
    letters[0, ::3] = True
    expected = [one_by_one(automaton, int(a), letter) for a, letter in zip(alone, letters.T, strict=True)]
    assert automaton.next_state(alone, letters).tolist() == expected


@pytest.mark.parametrize("name", ["fleet-v0", "rendezvous-v0"])
def test_pairs_hold_run_by_run_as_all_at_once(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def episode() -> list[Any]:
        envs = cg.vector_env(name, 64)
        envs.action_space.seed(1)
        envs.reset(seed=1)
        return [envs.step(envs.action_space.sample()) for _ in range(30)]

    quick = episode()
    monkeypatch.setattr(blocks, "RUN", 10**9)
    for one, other in zip(quick, episode(), strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one[:4], other[:4], strict=True))


def test_runs_hold_what_is_no_number_to_be_far() -> None:
    problem = cg.make_problem("fleet-v0")
    (pairs, *_), outputs = blocks.pair_blocks(problem, [(0, i) for i in range(problem.n_agents)]), {}
    rng = np.random.default_rng(2)
    y = rng.uniform(-1.0, 1.0, (problem.agents[0].n_outputs, problem.n_agents, 40))
    y[:, ::3, ::4], y[:, 1::3, ::5] = np.inf, np.nan
    outputs = {0: y}
    assert len(pairs._runs) * blocks.RUN <= len(pairs.propositions)
    with np.errstate(invalid="ignore"):
        expected = blocks.holds(pairs.difference(outputs), *pairs.regions(None))
        assert np.array_equal(pairs.hold(outputs, None), expected)
