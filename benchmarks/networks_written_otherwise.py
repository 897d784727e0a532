"""Networks in time and in pairs, against their rollouts: ``python benchmarks/networks_written_otherwise.py``.

Networks are made by hand or drawn with a fixed seed, so that rows take seconds; those of three robots a minute.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import certigym as cg
from certigym.envs.agents import LinearAgent
from certigym.synthesis.certificates import rounded_down
from certigym.synthesis.raw_networks import _less_nearness, _of_given, _on_grids, _policies, _written
from certigym.synthesis.relations import Network
from certigym.validation.policies.actors import SharedActor, TeamActor
from certigym.validation.policies.views import SharedView

EPISODES = 100_000

SCALAR: dict[str, Any] = {
    "state_low": [-3.0], "state_high": [3.0], "input_low": [-1.5], "input_high": [1.5], "initial_state": [-1.2]
}  # fmt: skip


def matrices(name: str, **changes: Any) -> LinearAgent:
    """A scalar agent with matrices."""
    return LinearAgent(name=name, A=[[0.9]], B=[[0.8]], noise_covariance=[[0.2]], **{**SCALAR, **changes})


def expressions(**changes: Any) -> cg.Agent:
    """A scalar agent with expressions."""
    noise = [{"law": "gaussian", "std": 0.45}]
    dynamics = changes.pop("dynamics", ["0.9*x + 0.1*sin(x) + 0.8*u"])
    return cg.Agent(name="one", states=["x"], inputs=["u"], dynamics=dynamics, noise=noise, **{**SCALAR, **changes})


def reaching(agent: Any, moves: bool) -> cg.Problem:
    """A goal and a hole, which may move."""
    goal = cg.Proposition("one", ["1.2 - 0.3*t"], [3.0]) if moves else cg.Proposition("one", [0.6], [3.0])
    hole = cg.Proposition("one", [-3.0], ["-2 - 0.2*t"]) if moves else cg.Proposition("one", [-3.0], [-2.0])
    return cg.Problem(
        name="reaching", horizon=3, agents=[agent], propositions={"goal": goal, "hole": hole},
        specification=cg.Specification("(!hole) U goal", "co-safe"),
    )  # fmt: skip


def passing() -> cg.Problem:
    """Two agents that must not be near each other until one of them is at its goal."""
    regions: Any = {"goal": cg.Proposition("one", [-0.2], [0.8]), "near": cg.Pair(["one", "two"], [-0.3], [0.3])}
    return cg.Problem(
        name="passing", horizon=3, agents=[matrices("one"), matrices("two", initial_state=[1.5])], propositions=regions,
        specification=cg.Specification("(!near) U goal", "co-safe"),
    )  # fmt: skip


def drawn(problem: cg.Problem) -> SharedActor:
    """Four hidden units with weights of a fixed seed."""
    view, rng = SharedView(problem), np.random.default_rng(0)
    first = 0.2 * rng.normal(size=(4, view.size)).astype(np.float32)
    last = np.full((view.n_actions, 4), 0.2, dtype=np.float32)
    return SharedActor(
        problem, Network((first, last), (np.full(4, 0.5, np.float32), np.zeros(1, np.float32)), "tanh", False)
    )


def robots() -> tuple[cg.Problem, TeamActor]:
    """Three planar robots that go home and keep apart, each with a network of its own."""
    starts, goals = [[-2.0, -2.0], [2.0, -1.0], [0.0, 2.0]], [[-1.2, -1.2], [1.0, -1.0], [0.0, 1.2]]
    agents = [
        LinearAgent(
            name=f"r{i}", A=np.eye(2), B=np.eye(2), noise_covariance=0.02 * np.eye(2), state_low=[-3.0, -3.0],
            state_high=[3.0, 3.0], input_low=[-0.6, -0.6], input_high=[0.6, 0.6], initial_state=start,
        )
        for i, start in enumerate(starts)
    ]  # fmt: skip
    regions: dict[str, Any] = {
        f"home{i}": cg.Proposition(f"r{i}", [x - 0.6, y - 0.6], [x + 0.6, y + 0.6]) for i, (x, y) in enumerate(goals)
    }
    regions |= {f"near{i}{j}": cg.Pair([f"r{i}", f"r{j}"], [-0.4] * 2, [0.4] * 2) for i in range(3) for j in range(i)}
    text = "G !(near10 | near20 | near21) & F G (home0 & home1 & home2)"
    problem = cg.Problem(
        name="robots", horizon=5, agents=agents, propositions=regions,
        specification=cg.Specification(text, "finite-trace"),
    )  # fmt: skip
    view, networks = SharedView(problem), []
    for goal in goals:
        first = np.zeros((2, view.size), dtype=np.float32)
        first[:, :2] = 1.5 * np.eye(2)
        shift = (-0.5 * np.array(goal)).astype(np.float32)
        layers = (first, (-3.0 * np.eye(2)).astype(np.float32)), (shift, np.zeros(2, np.float32))
        networks.append(Network(*layers, "tanh", False))
    return problem, TeamActor(problem, tuple(networks))


def row(name: str, problem: cg.Problem, actor: Any, found: Any, seconds: float) -> None:
    """Print one row: what is claimed of a network, and how often it succeeds."""
    began = time.perf_counter()
    report = cg.check(found)
    assert report, report
    runs = cg.rollout(problem, cg.as_controller(problem, actor), EPISODES, seed=0)
    certificate, proof = found.certificate, found.certificate.proof
    charged = f"{proof.base.lower_bound:.5f} - {proof.near:.2g}" if proof.kind == "subtraction" else ""
    most = "" if certificate.upper_bound is None else f"{certificate.upper_bound:.5f}"
    rate, of_check = runs.successes / EPISODES, time.perf_counter() - began
    print(f"| {name} | {rounded_down(certificate.lower_bound, 5)} | {most} | {charged} | {rate:.4f} | "
          f"{seconds:.1f} | {of_check:.1f} |", flush=True)  # fmt: skip


def main() -> None:
    """Print all rows."""
    print("| | P >= | P <= | without pairs, charged | rollouts | s | check, rollouts |\n|---|---|---|---|---|---|---|")
    timed = expressions(dynamics=["0.9*x + 0.8*u + 0.3*sin(t)"])
    for name, problem, cells, relation in (
        ("regions move, linear cells", reaching(matrices("one"), True), 200, "linear"),
        ("dynamics name t, boxes", reaching(timed, True), 200, "boxes"),
        ("dynamics name t, linear cells", reaching(timed, True), 100, "linear"),
        ("expressions, boxes", reaching(expressions(), False), 100, "boxes"),
        ("expressions, linear cells", reaching(expressions(), False), 24, "linear"),
        ("expressions, linear cells", reaching(expressions(), False), 100, "linear"),
    ):
        actor, began = drawn(problem), time.perf_counter()
        found = cg.certify(problem, actor, cells, as_is=True, above=True, relation=relation)
        row(f"{name}, {cells}", problem, actor, found, time.perf_counter() - began)
    problem = passing()
    actor, began = drawn(problem), time.perf_counter()
    base, policies, cells = _written(problem, _policies(problem, actor), 60)
    joint = _of_given(problem, _on_grids(base, policies, cells, "linear", None)[0])
    row("two agents, joint, 60 x 60", problem, actor, joint, time.perf_counter() - began)
    for count in (24, 100):
        began = time.perf_counter()
        found = _less_nearness(problem, _policies(problem, actor), count, "linear", None)
        row(f"two agents, {count} each", problem, actor, found, time.perf_counter() - began)
    problem, team = robots()
    for count in (24, 100):
        began = time.perf_counter()
        found = cg.certify(problem, team, count, as_is=True)
        row(f"three robots, {count} x {count} each", problem, team, found, time.perf_counter() - began)


if __name__ == "__main__":
    main()
