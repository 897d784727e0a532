"""Cells within a budget: numbers that fit regions and lattice, memory as predicted, and an honest record."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.synthesis.cells import RelationRefused
from certigym.synthesis.certificates import changed, with_claims
from certigym.synthesis.choosing.cell_budget import MOST_COMBINATIONS, cells_at, snapping_loss
from certigym.synthesis.choosing.cell_choice import Budget, refine
from certigym.synthesis.models.abstraction import abstract
from problems import two_agents


@pytest.mark.parametrize("resolution", [2.3, 3.0, 4.1])
def test_means_of_position_and_velocity_fall_on_the_lattice(resolution: float) -> None:
    """All cells equal, regions on edges, and as few lattice points per cell as were foreseen."""
    problem = cg.make_problem("reach-avoid-kinematic-v0")
    found = cells_at(problem, resolution, ["auto"] * problem.n_agents)["agent_0"]
    model = abstract(problem, found.shape).models[0]
    assert max(found.per_cell) <= 2
    for edges, lattice, n, per_cell in zip(model.grid.edges, model.lattice, found.shape, found.per_cell, strict=True):
        np.testing.assert_allclose(np.diff(edges), (edges[-1] - edges[0]) / n, rtol=1e-6)
        spacing = (edges[-1] - edges[0]) / n / per_cell
        assert np.min(np.diff(lattice)) >= spacing * (1 - 1e-6)
    np.testing.assert_allclose(found.shape, np.array([50, 20]) * resolution, rtol=0.26)
    assert np.isin([-15.0, -5.0, 0.0], np.round(model.grid.edges[0], 9)).all()


def test_lattices_of_numbers_that_do_not_fit_are_larger() -> None:
    problem = cg.make_problem("reach-avoid-kinematic-v0", horizon=2)
    sizes = [np.prod([len(axis) for axis in abstract(problem, n).models[0].lattice]) for n in ([50, 20], [53, 23])]
    assert 3 * sizes[0] < sizes[1]


def test_equal_agents_get_equal_cells_and_share_their_kernel() -> None:
    """Their regions differ; the numbers fit the regions of both."""
    problem = two_agents()
    cells = cells_at(problem, 3.0, ["auto"] * problem.n_agents)
    assert cells["one"] == cells["two"]
    models = abstract(problem, {name: own.shape for name, own in cells.items()}).models
    assert models[0].kernel is models[1].kernel


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("id", "horizon", "memory", "relation"),
    [
        ("reach-avoid-v0", 7, 10e6, "auto"),
        ("car-park-planar-v0", 4, 20e6, "exact"),
        ("reach-avoid-kinematic-v0", 2, 10e6, "tube"),
    ],
)
def test_memory_is_used_and_kept(id: str, horizon: int, memory: float, relation: str) -> None:
    """Predictions after the first run within a factor of 3, the peak within a quarter of the budget, by tracemalloc."""
    problem, search = cg.make_problem(id, horizon=horizon), cast(Any, cg.synthesize).__wrapped__
    tracemalloc.start()
    try:
        # the search alone: the check of what it found knows no budget
        found = search(problem, memory=memory, relation=relation, max_sweeps=1)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    record = found.stats["cells"]
    assert isinstance(record, dict) and record["stopped"] == "finer cells need more memory"
    for entry in record["tried"][1:]:
        assert entry["predicted_bytes"] / 3 < entry["measured_bytes"] < 3 * entry["predicted_bytes"]
    assert memory / 4 < record["tried"][-1]["measured_bytes"] <= peak < 1.25 * memory + 5e6
    assert found.certificate.lower_bound == max(entry["lower_bound"] for entry in record["tried"])


@pytest.mark.thorough
def test_runs_end_when_the_bound_changes_little(tmp_path: Path) -> None:
    problem = cg.make_problem("reach-avoid-v0", horizon=6)
    found = cg.synthesize(problem, accuracy=0.0005)
    record = found.stats["cells"]
    assert isinstance(record, dict) and record["stopped"] == "the bound changed by less than 0.0005"
    bounds = [entry["lower_bound"] for entry in record["tried"]]
    assert (
        abs(bounds[-1] - bounds[-2]) < 0.0005 <= min(abs(a - b) for a, b in zip(bounds[:-2], bounds[1:-1], strict=True))
    )
    path = tmp_path / "c.npz"
    cg.save(found.certificate, path)
    assert cg.load(path).settings["cells_chosen"] == record
    assert cg.check(found.certificate, problem)


@pytest.mark.thorough
def test_relations_that_need_finer_cells_are_recorded_and_passed() -> None:
    """The integrator chain has no tube on coarse cells."""
    problem = cg.make_problem("integrator-chain-v0", horizon=2)
    with pytest.raises(ValueError, match=r"no cells within 8e.06 bytes gave a certificate: agent `chain_0`: the tube"):
        cg.synthesize(problem, memory=8e6, max_sweeps=0)


def test_the_cost_of_snapping_is_bounded_from_above() -> None:
    """By hand: 40 cells of .2 with two targets each are .1 apart, so r = .05 / .5 = .1 whitened units at most."""
    problem = two_agents(horizon=1)
    cells = cells_at(problem, 2.5, ["auto"] * problem.n_agents)
    assert cells["one"].shape == (40,)
    eta = 0.0398776  # 2 Phi(.05) - 1
    assert snapping_loss(problem, cells) == pytest.approx(1 - (1 - eta) ** 2, rel=1e-4)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"memory": 1000.0}, "`memory`: expected at least .* bytes, what the coarsest cells need, got 1e.03"),
        ({"memory": -1.0}, "`memory`: expected a positive number"),
        ({"accuracy": 0.0}, "`accuracy`: expected a positive number"),
        ({"accuracy": True}, "`accuracy`: expected a positive number"),
        ({"cells": 50, "accuracy": 0.1}, "`cells`: expected either cells or a budget"),
    ],
)
def test_impossible_budgets_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cg.synthesize(two_agents(), **settings)


def test_budgets_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "c.npz"
    assert main(["synthesize", "reach-avoid-v0", "--horizon", "2", "--memory", "2M", "--out", str(out)]) == 0
    assert cg.load(out).settings["cells_chosen"]["memory"] == 2 * 2**20
    assert "finer cells need more memory" in capsys.readouterr().out
    assert main(["synthesize", "reach-avoid-v0", "--memory", "much", "--out", str(out)]) == 2
    assert "`--memory`: expected a number of bytes such as 500M or 2G, got 'much'" in capsys.readouterr().err


def test_the_largest_bound_of_all_runs_is_kept() -> None:
    problem, bounds = cg.make_problem("reach-avoid-v0"), iter([0.3, 0.5, 0.4])
    found = cg.synthesize(problem, 8, horizon=1, max_sweeps=0)

    def run(cells: object) -> Any:
        try:
            bound = next(bounds)
        except StopIteration:
            raise RelationRefused("no more") from None
        return replace(found, certificate=with_claims(found.certificate, lambda one: changed(one, lower_bound=bound)))

    best = refine(problem, run, ["auto"] * 2, Budget(memory=2e7))
    record: Any = best.stats["cells"]
    assert best.certificate.lower_bound == record["lower_bound"] == 0.5
    assert best.certificate.settings["cells_chosen"] == record


def test_many_axes_are_not_compared_in_all_combinations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve axes with three numbers each would make half a million combinations."""
    compared = list[tuple[int, ...]]()

    def counted(agent: cg.LinearAgent, shape: np.ndarray, even: Sequence[bool]) -> tuple[int, ...]:
        compared.append(tuple(shape.tolist()))
        return (1,) * len(shape)

    monkeypatch.setattr("certigym.synthesis.choosing.cell_budget._points_per_cell", counted)
    chain = cg.LinearAgent(
        name="chain", A=np.eye(12), B=np.eye(12)[:, :1], noise_covariance=0.01 * np.eye(12), state_low=[-5] * 12,
        state_high=[5] * 12, input_low=[-1], input_high=[1], initial_state=[0] * 12,
    )  # fmt: skip
    problem = cg.Problem(
        name="chain", horizon=3, agents=[chain], propositions={"rest": cg.Proposition("chain", [-1], [1], of=[0])},
        specification=cg.Specification("F rest", "co-safe"),
    )  # fmt: skip
    cells = cells_at(problem, 0.2, ["linear"])["chain"]
    assert cells.shape in compared
    assert len(compared) <= MOST_COMBINATIONS
