"""The same work done by other programs, measured in the same run: ``python benchmarks/others.py [--json PATH]``.

Dense joint dynamic programming, Storm on the explicit joint model (extra `storm`), the paper's algorithm one vertex
after the other, and an episode loop over the PettingZoo environment. Every row first compares the results.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import importlib.util
import tracemalloc
from collections.abc import Callable
from typing import TypeVar

import numpy as np

import certigym as cg
from certigym.synthesis.bounds.dense import MAX_ENTRIES, dense_value
from certigym.synthesis.models.abstraction import abstract
from certigym.synthesis.models.choices import Policies
from certigym.synthesis.models.joint import JointModel, join, start_of
from certigym.synthesis.search.ascent import resting_policies, sweep
from certigym.synthesis.search.limits import Limits
from certigym.synthesis.values.terms import Terms
from certigym.validation.paper.heuristics import paper_steps
from explicit_product import Explicit, chain_under, decision_process
from measuring import Row, Rows, cpu, once, options, save, show
from per_vertex import per_vertex_steps, value_at
from storm_check import storm_model, storm_reach_within

T = TypeVar("T")
EVERYTHING = Limits(0, 0, 0, 10**6)


def peak_mib(work: Callable[[], T]) -> float:
    """Return the peak memory of a call in MiB."""
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 2**20


def spread(terms: Terms, n_cells: tuple[int, ...], q: int) -> np.ndarray:
    """Return the values of a state at all joint cells, flat."""
    where = np.stack(np.meshgrid(*map(np.arange, n_cells), indexing="ij"), axis=-1).reshape(-1, len(n_cells))
    return np.concatenate([terms.at(q, part) for part in np.array_split(where, 1 + len(where) // 20_000)])


def evaluated(joint: JointModel, policies: Policies, problem: cg.Problem) -> Terms:
    """Return the value of given policies as a tree from which nothing is dropped."""
    return sweep(joint, policies, start_of(problem, joint), EVERYTHING, improve=False).terms


def dense_row(n_agents: int, cells: int) -> Row:
    """Evaluate the same policies by the tree and on the joint grid; if the grid is too large, say what it needs."""
    problem = cg.make_problem("reach-avoid-n-v0", n_agents=n_agents)
    joint = join(problem, abstract(problem, cells, relation="exact"))
    policies = sweep(joint, resting_policies(joint), None, Limits(), improve=True).policies

    def by_tree() -> Terms:
        return evaluated(joint, policies, problem)

    def on_grid() -> np.ndarray:
        return dense_value(problem, joint.models, policies)

    tree, terms = cpu(by_tree, 1)
    row = {"agents": n_agents, "cells": cells, "rank": terms.rank, "tree ms": 1e3 * tree, "tree MiB": peak_mib(by_tree)}
    entries = joint.n_states * float(cells) ** n_agents
    if entries > MAX_ENTRIES:
        return row | {"dense / tree": None, "dense MiB": f"> {8 * entries / 2**20:.3g}", "difference": None}
    dense, value = once(on_grid)
    q = problem.automaton.initial
    difference = float(np.max(np.abs(spread(terms, joint.n_cells, q) - value[q].ravel())))
    return row | {"dense / tree": dense / tree, "dense MiB": peak_mib(on_grid), "difference": difference}


def against_dense() -> Rows:
    """Compare reach-avoid tasks with increasing numbers of agents and cells."""
    sizes = [(2, 50), (2, 200), (2, 800), (3, 20), (3, 50), (3, 100), (4, 20), (5, 20), (6, 20), (8, 20), (20, 20)]
    return [dense_row(*size) for size in sizes]


def storm_rows(cells: int, horizon: int) -> Rows:
    """Compare bounded reachability on the chain of our policies and, if small, on the decision process.

    On the process Storm computes the optimum over joint policies; we take one sweep of a search for decentralised ones.
    """
    problem = cg.make_problem("reach-avoid-v0", horizon=horizon)
    joint = join(problem, abstract(problem, cells, relation="exact"))
    ours, policies = cpu(lambda: sweep(joint, resting_policies(joint), None, EVERYTHING, improve=True).policies, 1)
    tree, terms = cpu(lambda: evaluated(joint, policies, problem))
    value = np.concatenate([spread(terms, joint.n_cells, q) for q in range(joint.n_states)])
    row = {"model": "chain", "cells": cells, "T": horizon, "ours ms": 1e3 * tree}
    rows = [row | _in_storm(lambda: chain_under(problem, joint.models, policies), horizon, tree, value)]
    if cells <= 12:
        plain = decision_process(problem, joint.models).reach_within(horizon)
        row = {"model": "process", "cells": cells, "T": horizon, "ours ms": 1e3 * ours}
        rows.append(row | _in_storm(lambda: decision_process(problem, joint.models), horizon, ours, plain))
    return rows


def against_storm() -> Rows:
    """Compare products of two agents' cells, as long as they can be written out."""
    if importlib.util.find_spec("stormpy") is None:
        print("stormpy is not installed: no comparison with Storm")
        return []
    return [row for size in [(8, 4), (10, 6), (12, 6), (20, 6)] for row in storm_rows(*size)]


def _in_storm(write: Callable[[], Explicit], horizon: int, ours: float, value: np.ndarray) -> Row:
    """Return times as ratios to ours (writing the product out, loading, checking) and the difference of the values."""
    writing, explicit = once(write)
    loading, model = once(lambda: storm_model(explicit))
    checking, found = cpu(lambda: storm_reach_within(model, horizon), 1)
    difference = float(np.max(np.abs(found[: len(value)] - value)))
    return {
        "states": len(explicit.goal),
        "entries": explicit.transitions.nnz,
        "write": writing / ours,
        "load": loading / ours,
        "check": checking / ours,
        "difference": difference,
    }


def vertex_row(name: str, cells: int, horizon: int, robust: bool) -> Row:
    """Run the paper's method batched and vertex by vertex; compare the values relative to the largest."""
    problem = cg.make_problem(name, horizon=horizon)
    joint = join(problem, abstract(problem, cells, relation="paper", epsilon=max(0.1, 25 / cells)))
    kind = "robust tree" if robust else "base"
    ours, steps = once(lambda: list(paper_steps(joint, kind)))
    plain, vertices = once(lambda: list(per_vertex_steps(joint, robust))[-1])
    where = np.random.default_rng(0).integers(0, cells, (1000, len(joint.models)))
    value = [steps[-1].terms.at(q, where) for q in range(joint.n_states)]
    apart = max(np.abs(value_at(own, where) - v).max() for own, v in zip(vertices, value))
    return {
        "task": name,
        "cells": cells,
        "T": horizon,
        "form": kind,
        "vertices": max(map(len, vertices)),
        "ours ms": 1e3 * ours,
        "per vertex / ours": plain / ours,
        "difference": float(apart / max(v.max() for v in value)),
    }


def against_vertices() -> Rows:
    """Compare the paper's two examples at sizes that the plain program can handle."""
    cases = [
        ("reach-avoid-v0", 1000, 10, True),
        ("reach-avoid-v0", 250, 10, False),
        ("package-delivery-v0", 250, 12, True),
        ("package-delivery-v0", 100, 12, False),
    ]
    return [vertex_row(*case) for case in cases]


def loop_row(name: str, cells: int, episodes: int = 100) -> Row:
    """Compare the CPU time per episode of the PettingZoo environment with that of batched rollouts."""
    problem = cg.make_problem(name)
    controller = cg.synthesize(problem, cells, max_sweeps=1).controller
    env = cg.parallel_env(problem)

    def loop() -> None:
        for seed in range(episodes):
            observations, infos = env.reset(seed=seed)
            controller.reset(observations, infos)
            while env.agents:
                observations, _, _, _, infos = env.step(controller.act(observations, infos))

    alone, _ = once(loop)
    batch, _ = cpu(lambda: cg.rollout(problem, controller, 100_000), 1)
    return {
        "task": name,
        "batch us per episode": 1e6 * batch / 100_000,
        "loop / batch": (alone / episodes) / (batch / 100_000),
    }


def against_loop() -> Rows:
    """Compare two agents over 7 steps, and eight over 20."""
    return [loop_row("reach-avoid-v0", 200), loop_row("package-delivery-v0", 100)]


def main() -> None:
    chosen = options(__doc__)
    results = {}
    works = {
        "dense joint programming": against_dense,
        "Storm, times as ratios to ours": against_storm,
        "one vertex after the other": against_vertices,
        "episode loop": against_loop,
    }
    for title, work in works.items():
        results[title] = work()
        show(title, results[title])
    save(results, chosen.json)


if __name__ == "__main__":
    main()
