"""Values on cells are never above the truth: one step by closed forms, several in one dimension by quadrature.

A factor is taken one step back for random cells, lattices, noise, dynamics and choices, and compared with the truth at
many points of each cell. Maps of cells hold the means of all their points under all disturbances and neighbours; shares
of starts are compared with rational numbers, labels with points.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from canonical_simulator import FUNCTIONS
from certigym.synthesis.checker import cells, read_problem
from certigym.synthesis.checker.cells import Kernel, start_weights
from certigym.synthesis.checker.distributions import normal_table
from certigym.synthesis.checker.fields import Refused
from certigym.synthesis.checker.motions import cell_labels, check_targets, maps_of_inputs
from certigym.synthesis.checker.problem import Agent, Problem
from kinds import mostly_thorough

ACCEPTS = {"initial": 0, "accepting": [True], "root": [-1], "variable": [], "low": [], "high": []}
SPARE = 1e-13
"""What closed forms and quadrature in double precision are off by."""


def problem_of(agents: list[dict[str, Any]], regions: list[dict[str, Any]] | None = None) -> Problem:
    task = {"semantics": "co-safe", "automaton": ACCEPTS}
    return read_problem(
        {"problem": {"horizon": 3, "agents": agents, "regions": regions or [], "pairs": [], "task": task}}
    )


def agent(dynamics: list[str], low: list[float], high: list[float], **more: Any) -> dict[str, Any]:
    d = len(dynamics)
    return {
        "name": "a", "states": [f"x{k}" for k in range(d)], "inputs": ["u"], "dynamics": dynamics,
        "outputs": [f"x{k}" for k in range(d)], "state_low": low, "state_high": high, "input_low": [-5.0],
        "input_high": [5.0], "start_low": low, "start_high": low, "noise": np.eye(d).tolist(), **more,
    }  # fmt: skip


DYNAMICS: dict[int, list[list[str]]] = {
    1: [
        ["0.8*x0 + u"], ["x0 + 0.3*sin(x0) + u"], ["x0 + 0.2*(u - x0*x0*x0/9)"], ["0.7*x0 + u + 0.2*abs(x0)"],
        ["x0 + 0.1*max(u, x0) - 0.1*min(x0, 1)"], ["0.9*x0 + u*cos(0.3*x0)"], ["x0 + u + v"], ["-1.1*x0 + u*v"],
    ],
    2: [
        ["0.9*x0 + 0.2*x1", "0.8*x1 - 0.2*x0 + u"], ["x0 + 0.2*sin(x1)", "x1 + u"], ["0.5*x1 + u", "0.5*x0"],
        ["x0 + 0.1*x0*x1 + v", "0.9*x1 + u"],
    ],
    3: [["0.9*x0 + 0.1*x1", "0.9*x1 + 0.1*x2", "0.8*x2 + u"], ["x0 + 0.1*x1*x2", "x1 + 0.1*u", "x2 + u + 0.5*v"]],
}  # fmt: skip


@dataclass
class Case:
    """An agent on cells, its kernel, and how its means and its noise are computed at points."""

    agent: Agent
    edges: list[np.ndarray]
    lattice: list[np.ndarray]
    deviations: np.ndarray
    inputs: np.ndarray
    kernel: Kernel
    dynamics: list[str]

    def means(self, x: np.ndarray, u: np.ndarray, v: float) -> np.ndarray:
        """Means (d, n) at points (d, n)."""
        local = {**FUNCTIONS, "u": u, "v": v, **{f"x{k}": own for k, own in enumerate(x)}}
        return np.array([np.broadcast_to(eval(text, {}, local), x.shape[1]) for text in self.dynamics])


def random_case(rng: np.random.Generator, d: int, corners: bool) -> Case:
    dynamics = DYNAMICS[d][int(rng.integers(len(DYNAMICS[d])))]
    most = {1: 20, 2: 6, 3: 3}[d]
    width = float(rng.choice((0.5, 2.0, 6.0)))
    edges, lattice = [], []
    for _ in range(d):
        n = int(rng.integers(2, most))
        inner = rng.random(n - 1) * 0.9 + 0.05 if rng.random() < 0.5 else np.arange(1, n) / n
        edges.append(width * (np.unique(np.concatenate([[0.0, 1.0], inner])) - rng.choice((0.5, 0.3))))
        span = 1.0 if rng.random() < 0.5 else 1.5
        points = np.linspace(edges[-1][0] * span, edges[-1][-1] * span, {1: 81, 2: 41, 3: 21}[d])
        if rng.random() < 0.3:  # a lattice that is not even
            share = (points - points[0]) / (points[-1] - points[0])
            points = points + 10.0 ** rng.uniform(-9, -3) * width * np.sin(np.pi * share) ** 2
        lattice.append(points)
    deviations = width * 10.0 ** rng.uniform({1: -1.2, 2: -0.9, 3: -0.5}[d], 0.0, d)
    low, high = [float(e[0]) for e in edges], [float(e[-1]) for e in edges]
    disturbed = {"disturbances": {"v": [-0.1 * width, 0.05 * width]}} if "v" in "".join(dynamics) else {}
    own = problem_of([agent(dynamics, low, high, noise=np.diag(deviations).tolist(), **disturbed)]).agents[0]
    inputs = rng.normal(size=(int(rng.integers(1, 4)), 1)) * width * 0.3
    inputs = np.clip(inputs, -5.0, 5.0)
    return Case(
        own,
        edges,
        lattice,
        deviations,
        inputs,
        kernel_of(own, edges, lattice, deviations, inputs, corners, rng),
        dynamics,
    )


def kernel_of(
    own: Agent, edges: Any, lattice: Any, deviations: Any, inputs: Any, corners: bool, rng: np.random.Generator
) -> Kernel:
    S = int(np.prod([len(e) - 1 for e in edges]))
    numbers = np.arange(S * len(inputs))
    tables = [normal_table(z, e, float(s), corners) for z, e, s in zip(lattice, edges, deviations, strict=True)]
    with np.errstate(all="ignore"):
        maps = maps_of_inputs(own, [own], edges, inputs, numbers)
    grid = tuple(edges), tuple(lattice), corners, int(rng.integers(1, 4))
    made, lack = tuple(table for table, _ in tables), float(sum(lack for _, lack in tables))
    return Kernel(*grid, np.array(deviations), made, lack, len(inputs), maps, np.zeros(len(edges)))


def axis_means(mean: np.ndarray, edges: np.ndarray, s: float, corners: bool) -> np.ndarray:
    """For means (n,): probabilities (n, S) of cells along an axis, or means (n, 2 S) of their two hats."""
    u, v = ((e[None] - mean[:, None]) / s for e in (edges[:-1], edges[1:]))
    mass = np.where(u + v > 0, ndtr(-u) - ndtr(-v), ndtr(v) - ndtr(u))
    if not corners:
        return np.asarray(mass)
    density = [np.exp(-0.5 * x * x) / math.sqrt(2 * math.pi) for x in (u, v)]
    rising = (density[0] - density[1] - u * mass) / (v - u)
    return np.stack([mass - rising, rising], axis=-1).reshape(len(mean), -1)


def truth(case: Case, factor: np.ndarray, x: np.ndarray, u: np.ndarray, v: float) -> np.ndarray:
    """E l(next state) at points (d, n), where ``factor`` has an axis for each state."""
    mean = case.means(x, u, v)
    value = factor
    table = [
        axis_means(own, e, float(s), case.kernel.corners)
        for own, e, s in zip(mean, case.edges, case.deviations, strict=True)
    ]
    value = np.einsum("na,a...->n...", table[0], value)
    for own in table[1:]:
        value = np.einsum("na,na...->n...", own, value)
    return value


def multilinear(case: Case, result: np.ndarray, cell: int, share: np.ndarray) -> np.ndarray:
    """A factor (places,) at points of a cell, shares (n, d) along its sides."""
    d, shape = len(case.edges), case.kernel.shape
    if not case.kernel.corners:
        return np.full(len(share), result[cell])
    table = result.reshape([n for size in shape for n in (size, 2)])
    place = np.unravel_index(cell, shape)
    values = table[tuple(k for p in place for k in (p, slice(None)))]
    total = np.zeros(len(share))
    for corner in itertools.product((0, 1), repeat=d):
        weight = np.prod(np.where(np.array(corner) == 1, share, 1.0 - share), axis=1)
        total += weight * values[corner]
    return total


def points_in(case: Case, cell: int, share: np.ndarray) -> np.ndarray:
    """Points (d, n) of a cell."""
    place = np.unravel_index(cell, case.kernel.shape)
    return np.array([e[k] + s * (e[k + 1] - e[k]) for e, k, s in zip(case.edges, place, share.T, strict=True)])


@mostly_thorough("corners", [False, True], ids=["cells", "corners"])
@mostly_thorough("d", [1, 2, 3])
def test_a_step_back_is_below_the_truth_on_all_of_a_cell(d: int, corners: bool) -> None:
    rng, positive, gaps = np.random.default_rng(10 * d + corners), 0, []
    for _ in range({1: 200, 2: 100, 3: 30}[d]):
        case = random_case(rng, d, corners)
        S, kernel = int(np.prod(case.kernel.shape)), case.kernel
        places = S * (2**d if corners else 1)
        factors = rng.random((2, places)) * rng.choice([0.0, 1.0], (2, places), p=[0.3, 0.7])
        if rng.random() < 0.3:
            factors[1] = 1.0
        policy = rng.integers(-1, len(case.inputs), S)
        with np.errstate(all="ignore"):
            result = kernel.backup(kernel.values(factors), factors.max(axis=1), policy)
        assert result.shape == factors.shape and np.all(result >= 0.0)
        share = np.concatenate([rng.random((12, d)), np.array(list(itertools.product((0.0, 0.5, 1.0), repeat=d)))])
        shape = [n * 2 if corners else n for n in kernel.shape]
        for cell in range(S) if S < 60 else rng.choice(S, 60, replace=False):
            if policy[cell] < 0:
                assert not np.any(multilinear(case, result[0], cell, share))
                continue
            x, u = points_in(case, cell, share), np.full(len(share), case.inputs[policy[cell], 0])
            for j in range(2):
                got = multilinear(case, result[j], cell, share)
                worst = np.min([truth(case, factors[j].reshape(shape), x, u, v) for v in disturbances(case)], axis=0)
                assert np.all(got <= worst + SPARE), (case.dynamics, cell, float((got - worst).max()))
                positive += int((got > 0).sum())
                gaps.append(float((worst - got).mean()))
    assert positive > 1000 and np.median(gaps) < 0.3


def disturbances(case: Case) -> list[float]:
    low, high = case.agent.disturbances.get("v", (0.0, 0.0))
    return [low, 0.5 * (low + high), high] if low < high else [0.0]


@pytest.mark.parametrize("corners", [False, True], ids=["cells", "corners"])
def test_targets_are_worth_no_more_than_the_truth_at_any_mean_that_is_off(corners: bool) -> None:
    rng, positive = np.random.default_rng(3 + corners), 0
    for _ in range(60):
        d = int(rng.integers(1, 3))
        case = random_case(rng, d, corners)
        rest = 10.0 ** rng.uniform(-9, -1, d) * case.deviations
        kernel = replace(case.kernel, target_rest=rest, inputs=0)
        S, Z = int(np.prod(kernel.shape)), [len(axis) for axis in case.lattice]
        places = S * (2**d if corners else 1)
        factor = rng.random((1, places)) * 3.0
        policy = rng.integers(-1, int(np.prod(Z)), S)
        result = kernel.backup(kernel.values(factor), factor.max(axis=1), policy)[0]
        shape = [n * 2 if corners else n for n in kernel.shape]
        for cell in range(S):
            got = multilinear(case, result, cell, rng.random((3, d)))
            if policy[cell] < 0:
                assert not got.any()
                continue
            index = np.unravel_index(policy[cell], Z)
            z = np.array([axis[k] for axis, k in zip(case.lattice, index, strict=True)])
            signs = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=d)))
            means = (z + signs * rest).T
            still = replace(case, dynamics=[f"x{k}" for k in range(d)])
            worst = truth(still, factor[0].reshape(shape), means, np.zeros(means.shape[1]), 0.0).min()
            assert np.all(got <= worst + SPARE)
            positive += bool((got > 0).any())
    assert positive > 100


@pytest.mark.parametrize("corners", [False, True], ids=["cells", "corners"])
def test_several_steps_in_one_dimension_are_below_quadrature(corners: bool) -> None:
    """Up to four steps: stay in some cells until a goal; the truth is integrated on panels no longer than the noise."""
    rng, positive, tight = np.random.default_rng(20 + corners), 0, []
    nodes, weights = np.polynomial.legendre.leggauss(16)
    for _ in range(60):
        case = random_case(rng, 1, corners)
        if any(word in case.dynamics[0] for word in ("abs", "max", "v")):
            continue
        edges, s, S = case.edges[0], float(case.deviations[0]), case.kernel.shape[0]
        goal = np.zeros(S, dtype=bool)
        goal[int(rng.integers(S)) :: 3] = True
        stay = ~goal & (rng.random(S) < 0.9)
        policy = rng.integers(0, len(case.inputs), S)
        steep = max(1.0, float(np.abs(case.kernel.maps.G).max()))
        pieces = np.maximum(1, np.ceil(np.diff(edges) * steep * 2.0 / s).astype(int))
        panels = np.concatenate([np.linspace(a, b, k + 1)[:-1] for a, b, k in zip(edges[:-1], edges[1:], pieces)])
        ends = np.append(panels[1:], edges[-1])
        x = (0.5 * (panels + ends)[:, None] + 0.5 * (ends - panels)[:, None] * nodes).ravel()
        w = (0.5 * (ends - panels)[:, None] * weights).ravel()
        cell = np.repeat(np.arange(S), pieces * 16)
        mean = case.means(x[None], case.inputs[policy[cell], 0], 0.0)[0]
        density = np.exp(-0.5 * ((x[None] - mean[:, None]) / s) ** 2) / (s * math.sqrt(2 * math.pi)) * w
        hit = axis_means(mean, edges, s, False) @ goal
        exact, sides = np.zeros(len(x)), 2 if corners else 1
        factor = np.zeros((1, S * sides))
        for _step in range(4):
            exact = hit + density @ (exact * stay[cell])
            cut = np.where(np.repeat(stay, sides), factor[0], 0.0) + np.repeat(goal, sides)
            factor = case.kernel.backup(case.kernel.values(cut[None]), np.array([cut.max()]), policy)
            share = (x - edges[cell]) / (edges[cell + 1] - edges[cell])
            own = factor.reshape(S, sides)
            got = own[cell, 0] * (1 - share) + own[cell, 1] * share if corners else own[cell, 0]
            assert np.all(got <= exact + 1e-11), (case.dynamics, float((got - exact).max()))
            positive += int((got > 0).sum())
            tight.append(float((exact - got).max()))
    assert positive > 5000 and np.median(tight) < 0.5


def test_lattices_that_are_not_even_are_charged() -> None:
    """Points far off an even lattice: still below the truth, where interpolation takes them for even."""
    rng = np.random.default_rng(5)
    for warp in (1e-6, 1e-3, 1e-2, 0.1):
        edges, points = [np.linspace(-1.0, 1.0, 9)], np.linspace(-1.0, 1.0, 41)
        points = points + warp * np.sin(np.pi * (points + 1.0) / 2.0) ** 2
        own = problem_of([agent(["0.9*x0 + u"], [-1.0], [1.0])]).agents[0]
        inputs = np.array([[0.05]])
        for corners in (False, True):
            kernel = kernel_of(own, edges, [points], [0.1], inputs, corners, rng)
            case = Case(own, edges, [points], np.array([0.1]), inputs, kernel, ["0.9*x0 + u"])
            factor = (rng.random((1, 16 if corners else 8)) > 0.5).astype(float)
            result = kernel.backup(kernel.values(factor), np.ones(1), np.zeros(8, dtype=int))[0]
            share = np.linspace(0.0, 1.0, 21)[:, None]
            for cell in range(8):
                x = points_in(case, cell, share)
                exact = truth(case, factor[0], x, np.full(21, 0.05), 0.0)
                assert np.all(multilinear(case, result, cell, share) <= exact + SPARE), (warp, corners, cell)


def test_cells_of_a_few_units_in_the_last_place_are_below_the_truth() -> None:
    """Dynamics so steep that what the middle of a cell is rounded by moves the mean by the size of the noise."""
    last = 2.0**30
    unit = float(np.spacing(last))
    edges = [np.array([last, last + unit, last + 2 * unit, last + 5 * unit])]
    steep = 2.0**22
    s = steep * unit
    own = problem_of([agent([f"{steep}*(x0 - {last})"], [last], [last + 5 * unit], noise=[[s]])]).agents[0]
    points = np.linspace(-20.0 * s, 20.0 * s, 2001)
    for corners in (False, True):
        table, lack = normal_table(points, np.array([-2.0 * s, 0.0, s, 2.0 * s]), s, corners)
        maps = maps_of_inputs(own, [own], edges, np.zeros((1, 1)), np.arange(3))
        kernel = Kernel(tuple(edges), (points,), corners, 2, np.array([s]), (table,), lack, 1, maps, np.zeros(1))
        for chosen in range(3):
            factor = np.zeros((1, 6 if corners else 3))
            factor[0, chosen * (2 if corners else 1)] = 1.0
            result = kernel.backup(kernel.values(factor), np.ones(1), np.zeros(3, dtype=int))[0]
            for cell, (a, b) in enumerate(zip(edges[0][:-1], edges[0][1:], strict=True)):
                for share in (0.0, 1.0):
                    mean = np.array([steep * ((b if share else a) - last)])
                    exact = axis_means(mean, np.array([-2.0 * s, 0.0, s, 2.0 * s]), s, corners)[0] @ factor[0]
                    got = result.reshape(3, -1)[cell, int(share) if corners else 0]
                    assert got <= exact + SPARE, (corners, chosen, cell, share)


# Maps.


def test_maps_hold_the_means_of_all_points_under_all_that_is_not_known() -> None:
    """z + G (x - c) + r for points of cells, disturbances and neighbours anywhere in their boxes."""
    rng, count = np.random.default_rng(6), 0
    texts = [
        ["0.9*x0 + u + 0.2*v", "x1 + 0.1*b.y"],
        ["x0*x1 + u*v", "sin(x0) + x1/(2 + x0*x0)"],
        ["max(x0, x1) + u", "abs(x0 - 0.1) + 0.3*b.w"],
        ["x0 + exp(0.2*x1)*u", "atan(x1) + b.y*v"],
        ["x0", "u"],
    ]
    for _ in range(40):
        text = texts[int(rng.integers(len(texts)))]
        first = agent(text, [-1.0, 0.0], [1.0, 2.0], disturbances={"v": [-0.2, 0.5]})
        second = agent(["0.5*y"], [-0.4], [0.6], states=["y"], inputs=["w"], outputs=[], name="b", input_low=[-0.3])
        second["input_high"] = [0.7]
        problem = problem_of([first, second])
        edges = [np.unique(np.concatenate([[a, b], rng.uniform(a, b, 3)])) for a, b in ((-1.0, 1.0), (0.0, 2.0))]
        inputs = rng.uniform(-1.0, 1.0, (2, 1))
        S = int(np.prod([len(e) - 1 for e in edges]))
        numbers = np.flatnonzero(rng.random(S * 2) < 0.8)
        maps = maps_of_inputs(problem.agents[0], problem.agents, edges, inputs, numbers)
        share = np.concatenate([rng.random((30, 5)), np.rint(rng.random((30, 5)))])
        for k, (cell, choice) in enumerate(np.stack(np.divmod(numbers, 2), axis=1).tolist()):
            place = np.unravel_index(cell, [len(e) - 1 for e in edges])
            low = np.array([e[p] for e, p in zip(edges, place, strict=True)])
            high = np.array([e[p + 1] for e, p in zip(edges, place, strict=True)])
            x = low + share[:, :2] * (high - low)
            v, y, w = (a + s * (b - a) for (a, b), s in zip(((-0.2, 0.5), (-0.4, 0.6), (-0.3, 0.7)), share[:, 2:].T))
            local = {**FUNCTIONS, "x0": x[:, 0], "x1": x[:, 1], "u": inputs[choice, 0], "v": v, "y": y, "w": w}
            means = np.stack(
                [np.broadcast_to(eval(row.replace("b.", ""), {}, local), len(share)) for row in text], axis=1
            )
            rest = means - maps.z[k] - (x - 0.5 * (low + high)) @ maps.G[k].T
            assert np.all(np.abs(rest) <= maps.rho[k] + 1e-14), (text, cell)
            count += len(share)
    assert count > 20_000


def test_maps_refuse_inputs_outside_their_box_and_means_that_know_the_time() -> None:
    own = problem_of([agent(["x0 + u"], [-1.0], [1.0])]).agents[0]
    edges = [np.array([-1.0, 1.0])]
    for u in (5.1, -5.1):
        with pytest.raises(Refused):
            maps_of_inputs(own, [own], edges, np.array([[0.0], [u]]), np.array([0]))
    timed = problem_of([agent(["x0 + 0.1*t"], [-1.0], [1.0])]).agents[0]
    with pytest.raises(Refused):
        maps_of_inputs(timed, [timed], edges, np.zeros((1, 1)), np.array([0]))
    # what is not defined on a cell is worth nothing there
    root = problem_of([agent(["sqrt(x0)"], [-1.0], [1.0])]).agents[0]
    maps = maps_of_inputs(root, [root], edges, np.zeros((1, 1)), np.array([0]))
    table, lack = normal_table(np.linspace(-2, 2, 41), edges[0], 0.5, False)
    lattice = (np.linspace(-2, 2, 41),)
    kernel = Kernel(tuple(edges), lattice, False, 2, np.array([0.5]), (table,), lack, 1, maps, np.zeros(1))
    with np.errstate(all="ignore"):
        assert kernel.backup(kernel.values(np.ones((1, 1))), np.ones(1), np.zeros(1, dtype=int))[0, 0] == 0.0


def test_targets_are_reached_up_to_their_rest_by_inputs_in_their_box() -> None:
    """In rational numbers, for corners of cells: the input is in its box, and the mean is the target up to the rest."""
    rng, refused, allowed = np.random.default_rng(7), 0, 0
    for _ in range(150):
        d = int(rng.integers(1, 3))
        A, B = rng.normal(size=(d, d)) * 0.7, rng.normal(size=(d, d)) + 2.0 * np.eye(d)
        b = rng.normal(size=d)
        shift = float(rng.choice((0.0, 1e6)))
        edges = [shift + np.linspace(-1.0, 1.0, 4) for _ in range(d)]
        inverse = np.linalg.inv(B) * (1.0 + 1e-6 * rng.normal() * (rng.random() < 0.3))
        room = float(rng.uniform(0.5, 6.0)) + 2.0 * shift
        own = agent([""] * d, [shift - 1.0] * d, [shift + 1.0] * d, A=A.tolist(), B=B.tolist(), c=b.tolist())
        own |= {"inputs": [f"u{k}" for k in range(d)], "input_low": [-room] * d, "input_high": [room] * d}
        del own["dynamics"]
        reader = problem_of([own]).agents[0]
        cells_of = rng.integers(0, 3**d, 4)
        targets: Any = shift + rng.normal(size=(4, d))
        try:
            rest = check_targets(reader, edges, np.asarray(inverse, dtype=np.float64), cells_of, targets)
        except Refused:
            refused += 1
            continue
        allowed += 1
        F = [[Fraction(x) for x in row] for row in A.tolist()]
        for cell, z in zip(cells_of, targets.tolist(), strict=True):
            place = np.unravel_index(cell, (3,) * d)
            for side in itertools.product((0, 1), repeat=d):
                x = [Fraction(float(e[p + k])) for e, p, k in zip(edges, place, side, strict=True)]
                drift: list[Any] = [
                    sum(f * y for f, y in zip(row, x, strict=True)) + Fraction(c) for row, c in zip(F, b.tolist())
                ]
                u: list[Any] = [
                    sum(Fraction(p) * (Fraction(t) - m) for p, t, m in zip(row, z, drift, strict=True))
                    for row in inverse.tolist()
                ]
                assert all(Fraction(room) >= abs(own_u) for own_u in u)
                mean: list[Any] = [
                    m + sum(Fraction(q) * own_u for q, own_u in zip(row, u, strict=True))
                    for m, row in zip(drift, B.tolist(), strict=True)
                ]
                assert all(abs(m - Fraction(t)) <= Fraction(r) for m, t, r in zip(mean, z, rest.tolist(), strict=True))
    assert refused > 20 and allowed > 20


def test_inputs_of_targets_keep_in_their_box_up_to_the_faces_of_cells() -> None:
    """``x' = x + u`` reaches 1 from [-1, 0] by inputs from 1 to 2: the middle of the cell alone says nothing."""
    cell, target, edges = np.zeros(1, dtype=int), np.ones((1, 1)), [np.array([-1.0, 0.0, 1.0])]
    for room, low, is_allowed in ((1.6, -3.0, False), (2.0 + 1e-9, -3.0, True), (3.0, 1.2, False), (3.0, 0.9, True)):
        own = agent([""], [-1.0], [1.0], A=[[1.0]], B=[[1.0]], c=[0.0], input_low=[low], input_high=[room])
        del own["dynamics"]
        with contextlib.nullcontext() if is_allowed else pytest.raises(Refused, match="leaves its box in cell 0"):
            check_targets(problem_of([own]).agents[0], edges, np.eye(1), cell, target)


# Starts and labels.


def test_shares_of_starts_are_below_rational_ones() -> None:
    """Points on faces, boxes, flat ones and those of a few units in the last place; cells and corners."""
    rng, count = np.random.default_rng(8), 0
    for _ in range(300):
        d = int(rng.integers(1, 3))
        edges, ends = [], []
        for _axis in range(d):
            e = np.unique(np.round(rng.normal(size=6) * 10.0 ** rng.integers(-3, 4), int(rng.integers(0, 6))))
            if rng.random() < 0.2:
                e = 2.0**30 + np.spacing(2.0**30) * np.cumsum(rng.integers(1, 4, 4))
            e = e if len(e) > 2 else np.array([0.0, 1.0, 2.0])
            a = float(rng.choice(e)) if rng.random() < 0.5 else float(rng.uniform(e[0], e[-1]))
            b = a if rng.random() < 0.4 else float(rng.choice([*e, rng.uniform(e[0], e[-1]), np.nextafter(a, np.inf)]))
            edges.append(e)
            ends.append(sorted((a, min(b, float(e[-1])))))
        for corners in (False, True):
            got = start_weights(np.array(ends).T, edges, corners)
            exact = [
                math.prod(row)
                for row in itertools.product(*(shares(e, a, b, corners) for e, (a, b) in zip(edges, ends)))
            ]
            assert len(got) == len(exact)
            assert all(Fraction(w) <= x for w, x in zip(got.tolist(), exact, strict=True)), (edges, ends, corners)
            assert sum(got) > 0.999 or any(e[0] > 1e9 for e in edges)
            count += len(exact)
    assert count > 8000


def shares(edges: np.ndarray, a: float, b: float, corners: bool) -> list[Fraction]:
    """Weights of the cells of an axis, or of both hats in each, for a start that is uniform in [a, b]."""
    found, low, high = [], Fraction(a), Fraction(b)
    for k, (e, f) in enumerate(itertools.pairwise(edges.tolist())):
        left, right = Fraction(e), Fraction(f)
        if a == b:
            inside = left <= low < right or (k == len(edges) - 2 and low == right)
            mass, middle = Fraction(int(inside)), low
        else:
            first, last = max(left, low), min(right, high)
            mass, middle = max(last - first, Fraction(0)) / (high - low), (first + last) / 2
        rising = min(max((middle - left) / (right - left), Fraction(0)), Fraction(1))
        found += [mass * (1 - rising), mass * rising] if corners else [mass]
    return found


def test_labels_are_those_of_all_points_of_a_cell() -> None:
    rng, decided = np.random.default_rng(9), 0
    for _ in range(120):
        outputs = ["x0", "x1", str(rng.choice(("x0 + x1", "x0*x1", "abs(x0)")))]
        edges = [np.unique(np.concatenate([[-1.0, 1.0], rng.choice([-0.5, 0.0, 0.25, 0.5], 2)])) for _ in range(2)]
        special = (-1.0, -0.5, 0.0, 0.25, 0.5, 1.0)
        regions: list[dict[str, Any]] = []
        for p in range(2):
            low, high = (
                [None if rng.random() < 0.4 else float(rng.choice(special)) for _ in range(3)] for _ in range(2)
            )
            regions.append({"name": f"r{p}", "agent": 1, "low": low, "high": high})
        other = agent(["x0"], [-1.0], [1.0], name="b")
        regions.insert(1, {"name": "other", "agent": 0, "low": [0.0], "high": [1.0]})
        problem = problem_of([other, agent(["x0", "x1"], [-1.0, -1.0], [1.0, 1.0], outputs=outputs)], regions)
        mine, labels = cell_labels(problem, 1, edges)
        assert mine == [0, 2] and set(np.unique(labels).tolist()) <= {-1, 0, 1}
        shape = [len(e) - 1 for e in edges]
        for cell, row in enumerate(labels.tolist()):
            place = np.unravel_index(cell, shape)
            axes = []
            for e, k in zip(edges, place, strict=True):
                a, b = float(e[k]), float(e[k + 1])
                last = [b] if k == len(e) - 2 else []  # half-open, and the last one holds its upper face
                axes.append([a, 0.5 * (a + b), float(np.nextafter(b, a)), *last])
            letters = []
            for x0, x1 in itertools.product(*axes):
                y = [eval(text, {}, {"x0": x0, "x1": x1, "abs": abs}) for text in outputs]
                letters.append(
                    [
                        all((a is None or a <= z) and (b is None or z < b) for z, a, b in zip(y, r["low"], r["high"]))
                        for r in (regions[0], regions[2])
                    ]
                )
            for label, holds in zip(row, zip(*letters, strict=True), strict=True):
                assert label == 0 or all(own == (label > 0) for own in holds)
                decided += label != 0
    assert decided > 1000
    moving = {"name": "r", "agent": 0, "low": [[0.0], [0.0], [0.1], [0.0]], "high": [1.0]}
    with pytest.raises(Refused):
        cell_labels(problem_of([agent(["x0"], [-1.0], [1.0])], [moving]), 0, [np.array([-1.0, 0.0, 1.0])])


# The parts of a reading.


def test_largest_differences_around_a_block_are_found() -> None:
    rng = np.random.default_rng(11)
    for _ in range(60):
        d = int(rng.integers(1, 4))
        shape = tuple(int(n) for n in rng.integers(3, {1: 40, 2: 14, 3: 8}[d], d))
        table, reach = rng.random((2, *shape)), [int(n) for n in rng.integers(1, 9, d)]
        found, blocks = cells._largest(table, reach), cells._blocks(reach)
        for _point in range(20):
            at = [int(rng.integers(n)) for n in shape]
            around: tuple[Any, ...] = tuple(slice(max(0, p - r), p + r + 1) for p, r in zip(at, reach, strict=True))
            most = table[(slice(None), *around)].max(axis=tuple(range(1, d + 1)))
            block: tuple[Any, ...] = tuple(p // b for p, b in zip(at, blocks, strict=True))
            assert np.all(found[(slice(None), *block)] >= most)


def test_differences_are_those_of_the_values() -> None:
    rng = np.random.default_rng(12)
    values = rng.normal(size=(2, 6, 7))
    reach = [20, 20]  # everything
    seconds = [np.maximum(np.diff(values, 2, axis=k), 0.0).max(axis=(1, 2)) for k in (1, 2)]
    mixed = np.abs(values[:, 1:, 1:] - values[:, 1:, :-1] - values[:, :-1, 1:] + values[:, :-1, :-1]).max(axis=(1, 2))
    firsts = [np.abs(np.diff(values, axis=k)).max(axis=(1, 2)) for k in (1, 2)]
    for table, wanted in zip(cells._differences(values, reach), [*seconds, mixed, *firsts], strict=True):
        assert np.allclose(table.reshape(2, -1), wanted[:, None])


def test_interpolants_are_multilinear_between_lattice_points() -> None:
    rng = np.random.default_rng(13)
    values = rng.random((2, 5, 6))
    position = rng.uniform(0.0, 4.0, (3, 7, 2))
    position[0, :3] = np.round(position[0, :3])
    found = cells._interpolated(values, position)
    for c, q in itertools.product(range(3), range(7)):
        x, y = position[c, q]
        i, j = min(int(x), 3), min(int(y), 4)
        a, b = x - i, y - j
        for n in range(2):
            v = values[n]
            want = v[i, j] * (1 - a) * (1 - b) + v[i + 1, j] * a * (1 - b) + v[i, j + 1] * (1 - a) * b
            want += v[i + 1, j + 1] * a * b
            assert abs(found[n, c, q] - want) < 1e-14


def test_a_multilinear_function_below_is_below_at_all_points_read() -> None:
    rng, kinds = np.random.default_rng(14), set()
    for _ in range(300):
        d, parts = int(rng.integers(1, 3)), int(rng.integers(1, 4))
        share = np.array(list(itertools.product(np.linspace(0.0, 1.0, parts + 1), repeat=d)))
        corners = np.array(list(itertools.product((0.0, 1.0), repeat=d)))
        blend = np.prod(np.where(corners[:, None] == 1.0, share, 1.0 - share), axis=2)
        at, lacking = (
            rng.random((2, 5, len(share))) * rng.choice((1.0, 0.1)),
            rng.random((2, 5)) * rng.choice((0.0, 0.02, 0.3)),
        )
        found = cells._multilinear_below(at, lacking, blend, share)
        assert np.all(found >= 0.0)
        assert np.all(found @ blend <= np.maximum(at - lacking[:, :, None], 0.0) + 1e-15)
        kinds.add(bool((found.max(axis=2) > found.min(axis=2)).any()))
    assert kinds == {True, False}


@pytest.mark.thorough
def test_constants_of_the_theorem_are_at_least_the_numbers_that_they_stand_for() -> None:
    import mpmath

    density = mpmath.npdf
    fourth = mpmath.quad(lambda x: abs(mpmath.diff(density, x, 4)), [-9, -2.334, -0.742, 0, 0.742, 2.334, 9]) / 2
    second = mpmath.quad(lambda x: abs((x * x - 1) * density(x)), [-9, -1, 1, 9])
    assert fourth <= cells.FOURTH <= 1.0001 * fourth
    assert second * second / 2 <= cells.CROSSED <= 1.0001 * second * second / 2
    assert density(0) <= cells.DENSITY <= 1.0001 * density(0)
