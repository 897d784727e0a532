"""Small problems about pairs of agents for the tests."""

from __future__ import annotations

from typing import Any

import numpy as np

import certigym as cg

Box = tuple[list[float], list[float]]

CLOSE: Box = ([-1.0], [1.0])


def mover(name: str, start: list[float], **changes: Any) -> cg.LinearAgent:
    """An agent that moves each of its states by an input of at most 1, on [-4, 4] unless said otherwise."""
    d = len(start)
    values: dict[str, Any] = {
        "name": name,
        "A": np.eye(d),
        "B": np.eye(d),
        "noise_covariance": 0.04 * np.eye(d),
        "state_low": [-4.0] * d,
        "state_high": [4.0] * d,
        "input_low": [-1.0] * d,
        "input_high": [1.0] * d,
        "initial_state": start,
    }
    return cg.LinearAgent(**{**values, **changes})


def followers(
    task: str, near: Box = CLOSE, horizon: int = 5, semantics: str = "finite-trace", starts: Any = ((-2.5,), (0.5,))
) -> cg.Problem:
    """Scalar agents in a line; the last one has a goal on the right."""
    agents = [mover(f"agent_{i}", [*start]) for i, start in enumerate(starts)]
    propositions: dict[str, Any] = {
        "near": cg.Pair("agent_*", *near),
        "goal": cg.Proposition(agents[-1].name, [1.0], [3.0]),
        "home": cg.Proposition(agents[0].name, [-1.0], [1.0]),
    }
    return cg.Problem(
        name="followers",
        horizon=horizon,
        agents=agents,
        propositions=propositions,
        specification=cg.Specification(task, semantics),
    )


def random_pairs(rng: np.random.Generator) -> cg.Problem:
    """Two or three agents with one or two states, random boxes and one of several tasks."""
    n, d = int(rng.integers(2, 4)), int(rng.integers(1, 3))
    agents, propositions = [], dict[str, Any]()
    starts = np.linspace(-2.5, 2.5, n)
    for i in range(n):
        start = np.full(d, starts[i]) + rng.uniform(-0.3, 0.3, size=d)
        factor, offset = rng.uniform(0.8, 1.05), rng.uniform(-0.1, 0.1, size=d)
        spread = np.diag(rng.uniform(0.02, 0.15, size=d))
        changes = {"A": factor * np.eye(d), "offset": offset, "noise_covariance": spread}
        agents.append(mover(f"agent_{i}", start.tolist(), **changes))
        low = rng.choice(np.arange(-3.0, 2.0, 0.5), size=d)
        propositions[f"goal_{i}"] = cg.Proposition(f"agent_{i}", low, low + rng.choice([1.5, 2.0, 2.5], size=d))
    low, high = -rng.uniform(0.3, 1.2, size=d), rng.uniform(0.3, 1.2, size=d)
    kind = ["all", "neighbours"][int(rng.integers(2))]
    propositions["near"] = cg.Pair("agent_*", low, high, pairs=kind)
    goals = " & ".join(f"goal_{i}" for i in range(n))
    tasks = [
        (f"G !any(near) & F G ({goals})", "finite-trace"),
        ("!any(near) U goal_0", "co-safe"),
        ("!any(near) U (goal_0 & F goal_1)", "co-safe"),
        ("G !any(near)", "finite-trace"),
        ("G (any(near) -> goal_0)", "finite-trace"),
    ]
    text, semantics = tasks[int(rng.integers(len(tasks)))]
    return cg.Problem(
        name="random",
        horizon=int(rng.integers(3, 7)),
        agents=agents,
        propositions=propositions,
        specification=cg.Specification(text, semantics),
    )


def simulated(problem: cg.Problem, controller: Any, n: int, seed: int) -> int:
    """Return how many of n episodes succeed, simulated without the code of the environments.

    States move by the matrices, and every proposition is judged by comparisons that are written out here.
    """
    rng = np.random.default_rng(seed)
    automaton, names = problem.automaton, problem.automaton.propositions
    states = [np.tile(agent.initial.low[:, None], n) for agent in problem.agents]
    q, failed = np.full(n, automaton.initial), np.zeros(n, dtype=bool)
    places = {agent.name: i for i, agent in enumerate(problem.agents)}
    for t in range(problem.horizon + 1):
        for agent, x in zip(problem.agents, states):
            outside = ~((x >= agent.state_low[:, None]) & (x <= agent.state_high[:, None])).all(axis=0)
            failed |= outside & ~(automaton.accepting[q] & automaton.is_co_safe & (t > 0))
        letters = np.zeros((len(names), n), dtype=bool)
        for p, name in enumerate(names):
            region = problem.propositions[name]
            if isinstance(region, cg.Pair):
                first, second = (states[places[agent]] for agent in region.agents)
                y, top = first - second, region.high
            else:
                agent = problem.agents[places[region.agent]]
                y = states[places[region.agent]]
                top = np.where(region.high >= agent.state_high, np.inf, region.high)
            letters[p] = ((y >= region.low[:, None]) & (y < top[:, None])).all(axis=0)
        q = np.where(failed, q, automaton.next_state(q, letters))
        if t < problem.horizon:
            moved = []
            for agent, x, own in zip(problem.agents, states, controller.agents):
                assert isinstance(agent, cg.LinearAgent)
                u = own.act(x[:, None], q.astype(np.int32), t, None, None, None)[0][:, 0]
                noise = rng.multivariate_normal(np.zeros(len(x)), agent.noise_covariance, size=n).T
                moved.append(agent.A @ x + agent.B @ u + agent.offset[:, None] + noise)
            states = moved
    return int((automaton.accepting[q] & ~failed).sum())


def judged_by_hand(states: Any, wanted: Any, formula: str) -> Any:
    """Return which runs (T + 1, n, 4) of two agents in the plane satisfy `!near U there` or `F (near & there)`.

    The first agent is there on [3, 5) x [-1, 1); they are near where `wanted` says so of their difference and the time.
    """
    verdicts = []
    for run in np.moveaxis(states, 1, 0):
        verdict = False
        for t, x in enumerate(run):
            if np.isnan(x).any():
                break
            there, is_near = bool(3 <= x[0] < 5 and -1 <= x[1] < 1), bool(wanted(x[:2] - x[2:], t))
            if there and (is_near or formula.startswith("!")):
                verdict = True
                break
            if is_near and formula.startswith("!"):
                break
        verdicts.append(verdict)
    return np.array(verdicts)
