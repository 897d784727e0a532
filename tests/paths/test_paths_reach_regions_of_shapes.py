"""Paths through discs and cones are found: which regions never hold together is known, small ones are not missed."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.trajectories.planning.coarse_routes import guesses
from certigym.synthesis.trajectories.words.exclusions import exclusions


def rover(regions: dict[str, Any], formula: str, horizon: int = 12, **changes: Any) -> cg.Problem:
    """One agent with a velocity, or without."""
    values: dict[str, Any] = {
        "name": "rover", "A": np.eye(2), "B": np.eye(2), "noise_covariance": 1e-4 * np.eye(2), "state_low": [-4, -4],
        "state_high": [4, 4], "input_low": [-1, -1], "input_high": [1, 1], "initial_state": [0, -3],
    }  # fmt: skip
    semantics = "finite-trace" if "G" in formula else "co-safe"
    return cg.Problem(
        name="rover", horizon=horizon, agents=[cg.LinearAgent(**{**values, **changes})],
        propositions={name: cg.Proposition("rover", **{key: value}) for name, (key, value) in regions.items()},
        specification=cg.Specification(formula, semantics),
    )  # fmt: skip


DISCS = {
    "a": ("disc", {"centre": [-2, 0], "radius": 0.8}),
    "b": ("disc", {"centre": [2, 0], "radius": 0.8}),
    "c": ("disc", {"centre": [1.0, 0.5], "radius": 0.8}),
    "west": ("halfspace", {"normal": [1, 0], "offset": -1.5}),
    "wedge": ("cone", {"tip": [0, 1], "axis": [0, 1], "angle": 1.0}),
}


def test_regions_without_a_common_point_are_known_and_no_others() -> None:
    problem = rover(DISCS, "F (a | b | c | west | wedge)")
    names, apart = list(problem.labeling.names), exclusions(problem)
    rng = np.random.default_rng(0)
    points = rng.uniform(-4.0, 4.0, (2, 200_000))
    holds = problem.labeling.class_at(0, points)
    together = {(p, q) for p, q in combinations(range(len(names)), 2) if np.any(holds[p] & holds[q])}
    known = {(p, q) for p, q in combinations(range(len(names)), 2) if apart[p, q]}
    assert not known & together
    assert {tuple(sorted((names[p], names[q]))) for p, q in known} >= {
        ("a", "b"), ("a", "c"), ("a", "wedge"), ("b", "west"), ("b", "wedge"), ("c", "west"),
    }  # fmt: skip
    assert np.array_equal(apart, apart.T) and not apart.diagonal().any()


def test_random_regions_that_meet_are_never_taken_for_apart() -> None:
    rng = np.random.default_rng(4)
    found = 0
    for _ in range(12):
        regions = {f"d{k}": ("disc", {"centre": rng.uniform(-3, 3, 2).tolist(), "radius": float(rng.uniform(0.3, 1.5))})
                   for k in range(4)}  # fmt: skip
        problem = rover(regions, "F (d0 | d1 | d2 | d3)")
        apart, centres = exclusions(problem), [data["centre"] for _, data in regions.values()]
        for p, q in combinations(range(4), 2):
            gap = np.hypot(*np.subtract(centres[p], centres[q]))
            reach = regions[f"d{p}"][1]["radius"] + regions[f"d{q}"][1]["radius"]
            if gap < reach:
                assert not apart[p, q]
            elif gap > reach + 0.6:  # the boxes are .2 wide
                assert apart[p, q]
                found += 1
    assert found > 10


def test_a_region_between_the_middles_of_cells_is_found() -> None:
    problem = rover({"goal": ("disc", {"centre": [2.03, 1.97], "radius": 0.05})}, "F goal")
    agent = problem.agents[0]
    letters = np.zeros((9, 1), dtype=np.int8)
    letters[8, 0] = 1
    ways = list(guesses(problem, agent, letters, np.array([0.0, -3.0])))
    assert ways
    points = [way[-1][:2] for way in ways]
    assert min(np.hypot(*(point - [2.03, 1.97])) for point in points) < 0.3
