"""The value of an agent with mean boxes is below the truth at every state of a cell, for every mean of its boxes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

import certigym as cg
from certigym.envs.agents import Gaussian
from certigym.synthesis.cells.grid import Grid
from certigym.synthesis.certificates import value_of
from certigym.synthesis.checking.regrown_tree import regrow
from certigym.synthesis.models.box_model import box_model
from certigym.synthesis.readings.box_kernel import box_kernel_of
from certigym.synthesis.readings.box_minima import least_over_boxes
from certigym.synthesis.readings.kernel import Kernel
from certigym.synthesis.step_checking import boxes_check
from certigym.synthesis.values import Terms
from kinds import mostly_thorough
from problems import cart, cart_reach, linear, two_agents


def masses(edges: NDArray, mean: float, std: float) -> NDArray:
    """Masses of cells around a mean."""
    return np.diff(norm.cdf((edges - mean) / std))


def truth(factor: NDArray, edges: list[NDArray], deviations: NDArray, mean: NDArray) -> float:
    """Expected value of a factor on cells around a mean, axis by axis."""
    result = factor.reshape([len(e) - 1 for e in edges])
    for axis, m, s in zip(edges, mean, deviations, strict=True):
        result = np.tensordot(masses(axis, float(m), float(s)), result, axes=(0, 0))
    return float(result)


def interpolated(table: NDArray, position: NDArray) -> float:
    """Multilinear interpolant of a table at a position in lattice steps."""
    result = table
    for p in position:
        k = min(int(np.floor(p)), result.shape[0] - 2)
        result = (1.0 - (p - k)) * result[k] + (p - k) * result[k + 1]
    return float(result)


@pytest.mark.parametrize("d", [1, 2])
@pytest.mark.parametrize("ratio", [0.15, 0.6])
def test_interpolants_are_below_the_expectation_everywhere(d: int, ratio: float) -> None:
    """Less the charge, not without it: between points of a coarse lattice the bare interpolant is often too large."""
    rng = np.random.default_rng(d)
    edges = [np.sort(np.concatenate([[-2.0, 2.0], rng.uniform(-1.9, 1.9, 5)])) for _ in range(d)]
    deviations = rng.uniform(0.2, 0.5, d)
    grid = Grid(tuple(edges))
    lattice = tuple(np.arange(-12, 13) * ratio * s for s in deviations)
    kernel = box_kernel_of(grid, lattice, [Gaussian(float(deviation)) for deviation in deviations])
    factors = rng.uniform(0.0, 1.0, (4, grid.n_cells)) * (rng.random((4, grid.n_cells)) < 0.6)
    charged, bare = kernel.smooth(factors), Kernel.smooth(kernel, factors)
    wrong = 0
    for factor, numbers, plain in zip(factors, charged, bare, strict=True):
        checked = boxes_check.below(plain.reshape(kernel.lattice_shape), np.zeros(1), tuple(range(d)))
        for position in rng.uniform(1.0, 23.0, (150, d)):
            mean = np.array([axis[0] + p * (axis[1] - axis[0]) for axis, p in zip(lattice, position, strict=True)])
            expected = truth(factor, edges, deviations, mean)
            assert interpolated(numbers.reshape(kernel.lattice_shape), position) <= expected + 1e-14
            wrong += interpolated(plain.reshape(kernel.lattice_shape), position) > expected + 1e-4
            # Second differences alone, without the slack for fourth derivatives, are nearly enough.
            assert interpolated(checked, position) <= expected + factor.max() * kernel.slack + 1e-14
    assert wrong > 20
    # What is taken off is of the order of what is lost: never more than a few times the plain bound.
    assert float((bare - charged).max()) < 3.0 * d * 0.484 * ratio**2 / 8.0


@pytest.mark.parametrize("shape", [(40,), (13, 17), (7, 8, 6)])
def test_least_values_over_boxes_are_those_of_all_points(shape: tuple[int, ...]) -> None:
    """Windows, faces and corners: equal to trying a fine set of points that holds all ends and lattice points."""
    rng, d = np.random.default_rng(0), len(shape)
    table = rng.normal(size=(2, int(np.prod(shape))))
    ends = np.sort(rng.uniform(0, np.array(shape) - 1.0, (2, 60, d)), axis=0)
    ends[0, :10], ends[1, 10:20] = np.floor(ends[0, :10]), np.floor(ends[1, 10:20])
    ends[1] = np.maximum(ends[0], ends[1])
    ends[1, 20:25] = ends[0, 20:25]
    ends[:, 25] = np.array(shape) - 1.0
    low, high = ends
    found = least_over_boxes(table, shape, low, high)
    for row, numbers in zip(found, table, strict=True):
        np.testing.assert_allclose(boxes_check.least(numbers.reshape(shape), low[:25], high[:25]), row[:25], atol=1e-14)
        for k in range(60):
            axes = [
                np.unique(np.concatenate([[a, b], np.arange(np.ceil(a), np.floor(b) + 1), np.linspace(a, b, 5)]))
                for a, b in zip(low[k], high[k], strict=True)
            ]
            points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
            least = min(interpolated(numbers.reshape(shape), point) for point in points)
            assert row[k] == pytest.approx(least, abs=1e-12)


def turner() -> cg.LinearAgent:
    """Three states, two inputs, correlated noise: its cells are parallelepipeds."""
    return cg.LinearAgent(
        name="cart",
        A=[[0.9, 0.1, 0.0], [-0.1, 0.9, 0.2], [0.0, 0.0, 0.8]],
        B=[[0.0, 0.1], [0.5, 0.0], [0.1, 0.5]],
        noise_covariance=[[0.15, 0.03, 0.0], [0.03, 0.16, 0.0], [0.0, 0.0, 0.2]],
        state_low=[-2.0, -2.0, -2.0],
        state_high=[2.0, 2.0, 2.0],
        input_low=[-1.0, -1.5],
        input_high=[1.0, 1.0],
        initial_state=[-0.5, 0.1, 0.3],
        offset=[0.02, -0.05, 0.01],
    )


@pytest.mark.parametrize("agent", [cart(), turner()], ids=["cart", "turner"])
def test_boxes_hold_the_means_of_all_points_of_their_cells(agent: cg.LinearAgent) -> None:
    """Also at corners; inputs are admissible there; and the box is no larger than the points fill."""
    rng, d = np.random.default_rng(1), agent.n_states
    coordinates = np.eye(d) if d == 2 else np.array([[1.0, 0, 0], [0.2, 1.0, 0], [0, 0, 1.0]])
    span = np.abs(np.linalg.inv(coordinates)) @ agent.workspace.high
    grid = Grid(tuple(np.linspace(-s, s, 21 - 4 * d) for s in span))
    relation, _, _, choices = box_model(agent, grid, coordinates)
    assert np.any(relation.gains)
    cells = rng.integers(grid.n_cells, size=40)
    boxes = relation.mean_boxes(grid.low[cells], grid.high[cells])
    sides = np.stack(np.meshgrid(*[[0.0, 0.5, 1.0]] * d, indexing="ij"), axis=-1).reshape(-1, d)
    reached = []
    for share in sides:
        points = grid.low[cells] + share * (grid.high[cells] - grid.low[cells])
        for a in range(relation.n_choices):
            inputs = relation.inputs(np.full(len(cells), a), (points - grid.centres[cells]).T)
            assert np.all(inputs >= agent.input_box.low[:, None]) and np.all(inputs <= agent.input_box.high[:, None])
            states = coordinates @ points.T
            mean = np.linalg.solve(coordinates, agent.A @ states + agent.B @ inputs + agent.offset[:, None]).T
            assert np.all(boxes.low[:, a] <= mean) and np.all(mean <= boxes.high[:, a])
            reached.append(mean)
    means = np.array(reached).reshape(len(sides), relation.n_choices, len(cells), d)
    np.testing.assert_allclose(means.min(axis=0).transpose(1, 0, 2), boxes.low, atol=1e-9)
    np.testing.assert_allclose(means.max(axis=0).transpose(1, 0, 2), boxes.high, atol=1e-9)
    assert np.all(boxes.admissible) and np.all(choices.resting_choice >= 0)


PROBLEMS: dict[str, tuple[cg.Problem, Any]] = {
    "cart": (cart_reach(cart(), horizon=8), [30, 15]),
    "finite traces": (
        cg.Problem(
            name="kept",
            horizon=4,
            agents=[cart(initial_state=[0.1, 0.1])],
            propositions={"safe": cg.Proposition("cart", [-3.0, -3.0], [3.0, 3.0])},
            specification=cg.Specification("G safe", "finite-trace"),
        ),
        [24, 15],
    ),
    "correlated": (
        cg.Problem(
            name="turner",
            horizon=2,
            agents=[turner()],
            propositions={"goal": cg.Proposition("cart", [-1.0, -1.0, -2.0], [1.5, 1.0, 2.0])},
            specification=cg.Specification("G goal", "finite-trace"),
        ),
        [9, 9, 6],
    ),
}
"""Problems of one agent, and cells."""


@mostly_thorough("name", PROBLEMS)
def test_values_are_below_the_expectation_of_the_next_ones(name: str) -> None:
    """One step at a time, at random states under the certificate's controller."""
    problem, cells = PROBLEMS[name]
    certificate = cg.synthesize(problem, cells, relation="boxes").certificate
    assert cg.check(certificate) and certificate.lower_bound > 0.05
    part, agent, automaton = certificate.proof.agents[0], problem.agents[0], problem.automaton
    values: dict[int, Terms] = {}
    regrow(certificate, values.__setitem__)

    def per_cell(t: int, q: int) -> NDArray:
        if t == problem.horizon:
            return np.full(part.grid.n_cells, float(automaton.accepting[q]))
        terms = value_of(certificate) if t == 0 else values[t]
        assert isinstance(terms, Terms)
        return np.asarray(terms.factors[0][terms.index[q][:, 0]].sum(axis=0))

    inverse = np.linalg.inv(part.coordinates)
    deviations = np.sqrt(np.diag(inverse @ agent.noise_covariance @ inverse.T))
    rng, tight = np.random.default_rng(3), 0.0
    states = rng.uniform(agent.workspace.low, agent.workspace.high, size=(60, agent.n_states))
    states[0] = agent.initial.low
    own = part.grid.cell_of(inverse @ states.T)
    for t in range(problem.horizon):
        for q in np.flatnonzero(~automaton.finished):
            inputs, _ = certificate.controller.agents[0].act(states.T[:, None], np.full(len(states), q), t, None)
            means = inverse @ agent.mean(states.T, inputs[:, 0])
            # What arriving in a cell is worth: the guards of the certificate say where its letter leads.
            arriving = np.zeros(part.grid.n_cells)
            for source, target, mask in zip(
                certificate.proof.guard_source,
                certificate.proof.guard_target,
                certificate.proof.guard_mask[:, 0],
                strict=True,
            ):
                if source == q:
                    arriving += part.masks[mask] * per_cell(t + 1, int(target))
            claimed = per_cell(t, int(q))[own]
            for claim, mean in zip(claimed, means.T, strict=True):
                if claim > 1e-3:
                    expected = truth(arriving, list(part.grid.edges), deviations, mean)
                    assert claim <= expected + 1e-9
                    tight = max(tight, claim / expected)
    assert tight > 0.8


def least_over(values: NDArray, edges: list[NDArray], stds: list[float], boxes: list[tuple[float, float]]) -> float:
    """Least expectation of joint values (S_1, S_2) over 5 means in the box of each scalar agent."""
    tables = [
        np.array([masses(axis, m, s) for m in np.linspace(a, b, 5)])
        for axis, s, (a, b) in zip(edges, stds, boxes, strict=True)
    ]
    return float((tables[0] @ values @ tables[1].T).min())


def test_two_agents_stay_below_dense_programming_with_joint_minima() -> None:
    """The adversary of the oracle chooses all means after seeing the joint state; it has no products and no lattice."""
    problem = two_agents(horizon=3, noise_covariance=[[0.6]])
    certificate = cg.synthesize(problem, 8, relation="boxes").certificate
    assert cg.check(certificate) and certificate.proof.rank > 1
    edges = [part.grid.edges[0] for part in certificate.proof.agents]
    stds = [float(np.sqrt(agent.noise_covariance[0, 0])) for agent in problem.agents]
    automaton, terms = problem.automaton, certificate.proof.tree
    centres = [0.5 * (axis[1:] + axis[:-1]) for axis in edges]
    holds = [problem.labeling.class_at(i, c[None]) for i, c in enumerate(centres)]
    n = [len(c) for c in centres]
    letters = np.concatenate([np.repeat(holds[0], n[1], axis=1), np.tile(holds[1], n[0])])
    value = np.repeat(automaton.accepting.astype(float)[:, None], n[0] * n[1], axis=1)
    for t in reversed(range(problem.horizon)):
        before = value.copy()
        for q in np.flatnonzero(~automaton.finished):
            following = automaton.next_state(np.full(n[0] * n[1], q), letters)
            arriving = value[following, np.arange(n[0] * n[1])].reshape(n)
            for s in np.ndindex(*n):
                boxes = []
                for i, part in enumerate(certificate.proof.agents):
                    # The mean is monotone in the state: the ends of the cell under its input are the ends of the box.
                    choice = part.policy[t, q, s[i]]
                    ends = np.array([edges[i][s[i]], edges[i][s[i] + 1]])
                    gain = part.relation["gains"][choice][0][0]
                    inputs = part.relation["menu"][choice][0] + gain * (ends - ends.mean())
                    agent = linear(problem.agents[i])
                    mean = agent.A[0, 0] * ends + agent.B[0, 0] * inputs
                    boxes.append((float(mean.min()), float(mean.max())))
                before[q, s[0] * n[1] + s[1]] = least_over(arriving, edges, stds, boxes)
        value = before
    for state in range(automaton.n_states):
        tree = sum(
            (np.multiply.outer(terms.factors[0][a], terms.factors[1][b]) for a, b in terms.index[state]), np.zeros(n)
        )
        assert np.all(tree.ravel() <= value[state] + 1e-9)
        if not automaton.dead[state]:
            assert tree.max() > 0.5 * value[state].max()
