"""Numbers of cells that fit regions and lattice."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.policy_search.portfolio.cell_numbers import MOST_COMBINATIONS, cells_at
from certigym.synthesis.verbs.abstract import abstract
from problems import two_agents

pytestmark = pytest.mark.thorough


@pytest.mark.parametrize("resolution", [2.3, 3.0, 4.1])
def test_means_of_position_and_velocity_fall_on_the_lattice(resolution: float) -> None:
    """All cells equal, regions on edges, and as few lattice points per cell as were foreseen."""
    problem = cg.make_problem("reach-avoid-kinematic-v0")
    found = cells_at(problem, resolution, ["auto"] * problem.n_agents)["agent_0"]
    model = abstract(problem, found).models[0]
    for edges, lattice, n in zip(model.grid.edges, model.lattice, found, strict=True):
        np.testing.assert_allclose(np.diff(edges), (edges[-1] - edges[0]) / n, rtol=1e-6)
        # Two lattice points per cell at most.
        assert np.min(np.diff(lattice)) >= (edges[-1] - edges[0]) / n / 2 * (1 - 1e-6)
    np.testing.assert_allclose(found, np.array([50, 20]) * resolution, rtol=0.26)
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
    models = abstract(problem, cells).models
    assert models[0].kernel is models[1].kernel


def test_many_axes_are_not_compared_in_all_combinations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twelve axes with three numbers each would make half a million combinations."""
    compared = list[tuple[int, ...]]()

    def counted(agent: cg.LinearAgent, shape: np.ndarray, even: Sequence[bool]) -> tuple[int, ...]:
        compared.append(tuple(shape.tolist()))
        return (1,) * len(shape)

    monkeypatch.setattr("certigym.synthesis.policy_search.portfolio.cell_numbers._points_per_cell", counted)
    chain = cg.LinearAgent(
        name="chain", A=np.eye(12), B=np.eye(12)[:, :1], noise_covariance=0.01 * np.eye(12), state_low=[-5] * 12,
        state_high=[5] * 12, input_low=[-1], input_high=[1], initial_state=[0] * 12,
    )  # fmt: skip
    problem = cg.Problem(
        name="chain", horizon=3, agents=[chain], propositions={"rest": cg.Proposition("chain", [-1], [1], of=[0])},
        specification=cg.Specification("F rest", "co-safe"),
    )  # fmt: skip
    cells = cells_at(problem, 0.2, ["linear"])["chain"]
    assert cells in compared
    assert len(compared) <= MOST_COMBINATIONS
