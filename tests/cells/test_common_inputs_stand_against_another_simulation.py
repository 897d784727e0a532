"""Random teams with inputs chosen in common do at least as well as certified in a simulation that shares no code.

Dynamics are nested tuples whose values numpy computes here; cells, choices, numbers and targets are looked up in the
arrays of the certificate.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from tuple_expressions import Expression, text_of, value_of

pytestmark = pytest.mark.thorough

SEEDS, EPISODES = 6, 4000

FALSE_ALARM = 1e-6
"""Probability that one of all true claims is refuted here, divided among them; the seeds are fixed."""


class Team:
    """A random team: owners of inputs, and agents that name these, some of which own inputs that others name."""

    def __init__(self, seed: int) -> None:
        rng = self.rng = np.random.default_rng([20261124, seed])
        owners, followers = int(rng.integers(1, 3)), int(rng.integers(1, 3))
        names = [f"owner_{k}" for k in range(owners)] + [f"follower_{k}" for k in range(followers)]
        self.dynamics: dict[str, Expression] = {}
        agents, propositions = [], {}
        for name in names:
            may_name = [f"{other}.u" for other in names[:owners] if other != name]
            named: list[str] = []
            if may_name and (name.startswith("follower") or rng.random() < 0.3):
                named = [str(x) for x in rng.permutation(may_name)[: int(rng.integers(1, 3))]]
            self.dynamics[name] = self.mean(named)
            width = float(rng.uniform(3.0, 5.0))
            reach = float(rng.uniform(0.4, 1.0))
            agents.append(
                cg.Agent(
                    name=name,
                    states=["x"],
                    inputs=["u"],
                    dynamics=[text_of(self.dynamics[name])],
                    noise=[{"law": "gaussian", "std": float(rng.uniform(0.2, 0.4))}],
                    state_low=[-width],
                    state_high=[width],
                    input_low=[-reach],
                    input_high=[reach * float(rng.uniform(0.5, 1.0))],
                    initial_state=[float(rng.uniform(-1.0, 1.0))],
                )
            )
            low, high = rng.uniform(1.2, 2.0, 2).tolist()
            propositions[f"in_{name}"] = cg.Proposition(name, [-low], [high])
        self.is_safety = bool(rng.random() < 0.6)
        together = " & ".join(propositions)
        task = (f"G ({together})", "finite-trace") if self.is_safety else (f"F (!({together}))", "co-safe")
        self.problem = cg.Problem(
            name="team",
            horizon=int(rng.integers(2, 4)),
            agents=agents,
            propositions=propositions,
            specification=cg.Specification(*task),
        )

    def mean(self, named: list[str]) -> Expression:
        """A mean that is affine in the agent's own input, and bent in its state and in the inputs of others."""
        rng = self.rng
        total: Expression = ("*", float(rng.uniform(0.6, 1.0)), "x")
        if rng.random() < 0.5:
            total = ("-", total, ("*", float(rng.uniform(0.05, 0.2)), ("tanh", "x")))
        total = ("+", total, ("*", ("+", 1.0, ("*", 0.1, ("sin", "x"))), "u") if rng.random() < 0.4 else "u")
        for name in named:
            moved: Expression = name
            if rng.random() < 0.5:
                moved = ("*", ("+", 1.0, ("*", 0.2, ("cos", "x"))), name)
            if rng.random() < 0.3:
                moved = ("-", moved, ("*", 0.3, ("**", name, 2.0)))
            total = ("+", total, ("*", float(rng.uniform(-0.8, 0.8)), moved))
        return total


def applied(certificate: Any, team: Team, i: int, x: np.ndarray, t: int, q: int) -> np.ndarray:
    """The inputs of agent i at states (M,), read off the arrays of its certificate."""
    agent, part = team.problem.agents[i], certificate.proof.agents[i]
    edges, relation = part.grid.edges[0], part.relation
    cells = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    choices = part.policy[min(t, len(part.policy) - 1), q, cells]
    input_set, steer = np.array(relation["menu"])[:, 0], np.array(relation["steer"])
    u = input_set[choices]
    values = {"x": x}
    if "common" in relation:
        numbers = np.array(relation["common"]["numbers"])[
            choices // (len(input_set) // len(relation["common"]["numbers"]))
        ]
        values |= {name: numbers[:, k] for k, name in enumerate(relation["common"]["names"])}
    if steer.any():
        # A target is what the menu's input leads to from the centre; the mean is affine in the input.
        tree = team.dynamics[agent.name]
        centre = 0.5 * (edges[cells] + edges[cells + 1])
        aim = value_of(tree, {**values, "x": centre, "u": u})
        rest, full = (value_of(tree, {**values, "u": np.full(len(x), float(k))}) for k in (0, 1))
        u = np.where(steer[choices], (aim - rest) / (full - rest), u)
    return np.clip(u, agent.input_low[0], agent.input_high[0])


def successes(certificate: Any, team: Team) -> int:
    """Satisfied episodes out of EPISODES."""
    problem, rng = team.problem, np.random.default_rng(0)
    [q] = np.flatnonzero(~problem.automaton.absorbing).tolist()
    states = [np.full(EPISODES, float(agent.initial.low[0])) for agent in problem.agents]
    regions = [problem.propositions[f"in_{agent.name}"] for agent in problem.agents]

    def all_in() -> np.ndarray:
        pairs = zip(states, regions)
        return np.logical_and.reduce([(r.low[0] <= x) & (x < r.high[0]) for x, r in pairs])

    alive, accepted = np.ones(EPISODES, dtype=bool), np.zeros(EPISODES, dtype=bool)
    safe = all_in()
    accepted = ~safe if not team.is_safety else accepted
    for t in range(problem.horizon):
        inputs = [applied(certificate, team, i, x, t, q) for i, x in enumerate(states)]
        others = {f"{agent.name}.u": u for agent, u in zip(problem.agents, inputs)}
        moved = []
        for agent, x, u in zip(problem.agents, states, inputs):
            mean = value_of(team.dynamics[agent.name], {**others, "x": x, "u": u})
            moved.append(mean + np.sqrt(agent.noise_covariance[0, 0]) * rng.standard_normal(EPISODES))
        states[:] = moved
        inside = np.logical_and.reduce([np.abs(x) <= agent.state_high[0] for x, agent in zip(states, problem.agents)])
        alive &= inside | accepted
        safe &= all_in()
        accepted |= alive & ~all_in() if not team.is_safety else False
    return int((safe & alive).sum() if team.is_safety else accepted.sum())


@cache
def certified(seed: int) -> tuple[Team, Any]:
    """A random team and its certificate."""
    team = Team(seed)
    found = cg.synthesize(team.problem, cells=8, relation="boxes", search=cg.SearchOptions(common=True, max_sweeps=1))
    return team, found.certificate


@pytest.mark.parametrize("seed", range(SEEDS))
def test_random_teams_reach_what_is_certified(seed: int) -> None:
    """Fixed seeds, 4000 episodes each; seen is a claim that is too large by some .04."""
    team, certificate = certified(seed)
    assert any("common" in part.relation for part in certificate.proof.agents)
    assert cg.check(certificate)
    met = successes(certificate, team)
    assert binom.cdf(met, EPISODES, certificate.lower_bound) >= FALSE_ALARM / SEEDS


def test_the_teams_are_worth_a_look() -> None:
    """Claims are neither all trivial nor all empty, and some choices steer."""
    certificates = [certified(seed)[1] for seed in range(SEEDS)]
    assert sum(0.1 < certificate.lower_bound < 0.999 for certificate in certificates) >= SEEDS // 3
    parts = [part for certificate in certificates for part in certificate.proof.agents]
    assert any(np.array(part.relation["steer"])[part.policy[part.policy >= 0]].any() for part in parts)
