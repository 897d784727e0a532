"""Values on grids whose vertices have inputs: below the truth at every state, for any values one step later."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import beta

import certigym as cg
from certigym.synthesis.certificates.proofs import canonical_problem
from certigym.synthesis.checker import CheckedProblem, Refused, read_problem
from certigym.synthesis.extended_check.vertex_grids import (
    Backups,
    Lattice,
    LatticeImages,
    backups,
    closed_loops,
    failure_of,
    features,
    images,
    lattices,
    noise_bounds,
)
from certigym.synthesis.extended_check.vertex_grids.noise_bounds import Normal, Tabled
from certigym.synthesis.policy_search.vertex_values import input_choice, sampled_runs, value_iteration
from certigym.synthesis.policy_search.vertex_values.counted_backups import Counted
from certigym.synthesis.trajectories.planning import CountedWork
from kinds import mostly_thorough

DYNAMICS: dict[str, dict[str, Any]] = {
    "one state, its noise grows with it": {
        "states": ["x"], "dynamics": ["x + 0.3*u - 0.1*sin(2*x)"], "noise_std": [1.0], "noise_scale": ["0.1 + 0.1*x^2"],
        "state_low": [-1.5], "state_high": [2.0],
    },
    "one state, other noise": {
        "states": ["x"], "dynamics": ["x + 0.3*u - 0.1*sin(2*x)"], "noise_std": [1.0], "noise_scale": ["0.5 + 0.5*x^2"],
        "state_low": [-1.6], "state_high": [2.0],
    },
    "two states": {
        "states": ["x", "y"], "dynamics": ["x + 0.2*y", "0.9*y + 0.4*sin(x) + 0.5*u"], "noise_std": [0.12, 0.2],
        "state_low": [-2, -1.5], "state_high": [2, 1.5],
    },
    "two states, noise by state and input": {
        "states": ["x", "y"], "dynamics": ["x*exp(-0.3*y) + 0.2*u", "y + 0.3*(x - y*y)"], "noise_std": [1, 1],
        "noise_scale": ["0.1 + 0.1*u^2", "0.2 + 0.1*cos(x + y)"], "state_low": [-1, -1], "state_high": [1, 1.4],
    },
    "a state without noise": {
        "states": ["x", "y"], "dynamics": ["0.6*x + 0.25*y", "0.9*y - 0.2*x + 0.4*u"], "noise_std": [0.0, 0.2],
        "state_low": [-2, -1], "state_high": [2, 1],
    },
    "two states that bend": {
        "states": ["x", "y"], "dynamics": ["0.4*x + 0.9*y*y", "0.5*y + 0.6*sin(3*x) + 0.3*u"], "noise_std": [0.1, 0.1],
        "state_low": [-1.2, -1.2], "state_high": [1.2, 1.2],
    },
    "two states with kinks": {
        "states": ["x", "y"], "dynamics": ["max(x + 0.4*y - 0.5*u, -0.8)", "0.7*abs(y - x) - 0.3 + min(u, 0.3*x)"],
        "noise_std": [0.03, 0.05], "state_low": [-1, -1], "state_high": [1, 1],
    },
    "noise with kinks, and none": {
        "states": ["x", "y"], "dynamics": ["0.6*max(x, 0.7*y) - 0.1*abs(u)", "0.8*y + 0.2*u"], "noise_std": [0, 1],
        "noise_scale": ["1.0", "max(0.05, 0.3*abs(x - y))"], "state_low": [-1, -1.2], "state_high": [1, 1],
    },
    "three states": {
        "states": ["x", "y", "z"], "dynamics": ["x + 0.1*y", "y + 0.2*z - 0.1*x*y", "0.8*z + 0.5*u"],
        "noise_std": [0.2, 0.25, 0.2], "state_low": [-1, -1, -1], "state_high": [1, 1, 1],
    },
}  # fmt: skip


def problem_of(name: str, **more: Any) -> cg.Problem:
    options = {"inputs": ["u"], "input_low": [-1], "input_high": [1], **DYNAMICS[name], **more}
    if "noise" in more:
        del options["noise_std"]
    d = len(options["states"])
    agent = cg.Agent(name="a", **{"initial_state": [0.9] * d, **options})
    goal = cg.Proposition("a", [-0.5] * d, [0.5] * d)
    return cg.Problem(name="p", agents=[agent], propositions={"goal": goal}, specification="F goal", horizon=6)


def on_grid(name: str, seed: int, **more: Any) -> tuple[CheckedProblem, tuple[np.ndarray, ...], np.random.Generator]:
    problem = read_problem({"problem": canonical_problem(problem_of(name, **more))})
    rng, edges = np.random.default_rng(seed), []
    low, high = problem.agents[0].state_box
    for a, b in zip(low, high, strict=True):
        axis = np.linspace(a, b, {1: 60, 2: 30, 3: 14}[len(low)])
        axis[1:-1] += 0.3 * (axis[1] - axis[0]) * rng.uniform(-1.0, 1.0, len(axis) - 2)
        edges.append(axis)
    return problem, tuple(edges), rng


def truth(steps: Backups, W: np.ndarray, inputs: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return F (M,) at states x (d, M): means of W around images, along one axis after the other."""
    agent, d = steps.agent, len(x)
    u = interpolated(steps.edges, inputs, x)
    y, sizes = simulated(agent.name, steps, x, u)
    total: Any = W[None]
    for k, axis in enumerate(steps.edges):
        if not steps.noisy[k]:
            hats, _ = images.hats_at(y[k], sizes[k], axis, None)
            hats = hats * ((y[k] >= axis[0]) & (y[k] <= axis[-1]))[:, None]
        else:
            z = (axis - y[k][:, None]) / sizes[k][:, None]
            mass, phi = np.diff(ndtr(z), axis=1), np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
            rising = (phi[:, :-1] - phi[:, 1:] - z[:, :-1] * mass) / np.diff(z, axis=1)
            if isinstance(steps.noises[k], Tabled):
                mass, rising = hats_of(steps.noises[k], z)
            hats = np.stack([mass - rising, rising], axis=-1).reshape(len(mass), -1)
        total = np.einsum("na,na...->n...", hats, np.broadcast_to(total, (x.shape[1], *total.shape[1:])))
    assert total.shape == (x.shape[1],) and d == W.ndim
    return np.asarray(total)


def hats_of(own: Any, z: np.ndarray, points: int = 50) -> tuple[np.ndarray, np.ndarray]:
    """Return probabilities of intervals, and means of hats that rise on them, from tails of the package's own laws."""
    within = z[:, :-1, None] + np.diff(z, axis=1)[..., None] * (np.arange(points) + 0.5) / points
    above, mean = own.law.tails(z * own.unit)[1], own.law.tails(within * own.unit)[1].mean(axis=-1)
    return above[:, :-1] - above[:, 1:], mean - above[:, 1:]


def simulated(name: str, steps: Backups, x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return means and sizes (d, M) by the expressions, evaluated by Python alone."""
    given = next(own for own in DYNAMICS.values() if own["states"] == [*steps.agent.states]
                 and np.array_equal(own["state_low"], steps.agent.state_box[0])
                 and np.array_equal(own["state_high"], steps.agent.state_box[1]))  # fmt: skip
    names = {**dict(zip(given["states"], x, strict=True)), "u": u[0], "sin": np.sin, "cos": np.cos, "exp": np.exp}
    names |= {"max": np.maximum, "min": np.minimum, "abs": np.abs}
    means = [eval(text.replace("^", "**"), {}, names) for text in given["dynamics"]]
    scale = given.get("noise_scale", ["1.0"] * len(x))
    units = [
        own.unit if isinstance(own, Tabled) else std for own, std in zip(steps.noises, given["noise_std"], strict=True)
    ]
    pairs = zip(units, scale, strict=True)
    sizes = [np.abs(std * eval(text.replace("^", "**"), {}, names)) + 0.0 * x[0] for std, text in pairs]
    return np.stack(means), np.stack(sizes)


def interpolated(edges: tuple[np.ndarray, ...], table: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return multilinear interpolations (m, M) of numbers (V, m) at states (d, M)."""
    hats = [images.hats_at(own, own, axis, None)[0] for own, axis in zip(x, edges, strict=True)]
    weights = []
    for own in hats:
        pairs = own.reshape(len(own), -1, 2)
        whole = np.zeros((len(own), pairs.shape[1] + 1))
        whole[:, :-1] += pairs[:, :, 0]
        whole[:, 1:] += pairs[:, :, 1]
        weights.append(whole)
    joint = reduce(lambda a, b: (a[:, :, None] * b[:, None]).reshape(len(a), -1), weights)
    return np.asarray((joint @ table).T)


def below_and_true(
    name: str, seed: int, saddle: bool = False, near: float = 6.8, on_lattice: bool = False, **more: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return values of a backup and the truth at random states of cells that are kept, for random values later."""
    problem, edges, rng = on_grid(name, seed, **more)
    laws = problem_of(name, **more).agents[0].laws
    window = np.array([[axis[0] - 0.5, axis[-1] + 0.5] for axis in edges]).T if on_lattice else None
    steps = Backups(problem, edges, tuple(rng.random(len(edges)) < 0.7), near, laws, window)
    at = np.stack(np.meshgrid(*edges, indexing="ij")).reshape(len(edges), -1)
    # Inputs and values that are smooth, but for single vertices and cells.
    inputs = np.cos(rng.normal(size=(1, len(at))) @ at).T + 0.05 * rng.normal(size=(at.shape[1], 1))
    inputs = np.clip(inputs, -1.0, 1.0)
    bumps = 0.6 + 0.4 * np.cos(rng.normal(size=(1, len(at))) @ at + rng.uniform(0, 6))[0]
    bumps = 0.5 + 0.2 * at[0] * at[-1] if saddle else bumps
    W = steps.on_cells(bumps.reshape(tuple(len(axis) for axis in edges)), rng.random(steps.shape) < 0.01 * (not saddle))
    W = W if saddle else np.where(rng.random(W.shape) < 0.01, rng.random(W.shape), W)
    values, nothing = steps.below(W, steps.images_of(inputs, 0))
    x = np.stack([rng.uniform(axis[0], axis[-1], 600 if more else 4000) for axis in edges])
    cells = tuple(np.searchsorted(axis, own, side="right") - 1 for axis, own in zip(edges, x, strict=True))
    x = x[:, ~nothing[cells]]
    for k, jumps in enumerate(steps.jumps):  # what is read may be less than W there
        if not (jumps and steps.noisy[k]):
            W = backups._continuous(W, k)
    return interpolated(edges, values.reshape(-1, 1), x)[0], truth(steps, W, inputs, x)


@pytest.mark.parametrize("name", DYNAMICS)
@pytest.mark.parametrize("seed", range(2))
def test_backups_are_below_the_truth(name: str, seed: int) -> None:
    found, true = below_and_true(name, seed)
    assert len(found) > 100 and np.all(found <= true + 1e-13)


OF_ONE_SIZE = ["two states", "two states with kinks", "two states that bend", "a state without noise", "three states"]


@pytest.mark.parametrize("name", OF_ONE_SIZE)
@pytest.mark.parametrize("saddle", [False, True])
@mostly_thorough("seed", range(2))
def test_backups_on_a_lattice_are_below_the_truth(name: str, seed: int, saddle: bool) -> None:
    found, true = below_and_true(name, seed, saddle, on_lattice=True)
    assert len(found) > 100 and np.all(found <= true + 1e-13)


KINKED = ["two states with kinks", "noise with kinks, and none"]


@pytest.mark.parametrize("name", KINKED)
def test_images_with_kinks_are_near_those_of_corners(name: str) -> None:
    problem, edges, rng = on_grid(name, 5)
    steps, at = Backups(problem, edges, (True, True)), closed_loops.vertices_of(edges)
    inputs = np.clip(np.cos(rng.normal(size=(1, 2)) @ at).T + 0.1 * rng.normal(size=(at.shape[1], 1)), -1.0, 1.0)
    loop = closed_loops.closed_loop(steps.agent, edges, inputs, 0)
    x = np.stack([rng.uniform(axis[0], axis[-1], 200_000) for axis in edges])
    cells = np.ravel_multi_index(tuple(np.searchsorted(a, b) - 1 for a, b in zip(edges, x, strict=True)), steps.shape)
    means, sizes = simulated(steps.agent.name, steps, x, interpolated(edges, inputs, x))
    missed = np.abs(np.concatenate([means, sizes]) - interpolated(edges, loop.centre.T, x))
    bent = 0.125 * loop.bends.sum(axis=0)  # where nothing has a kink images bend
    allowed = (loop.off + bent)[:, cells]
    assert np.all(missed <= allowed + 1e-8)
    kinked, sides = loop.off[:, cells] > 0.0, loop.centre.reshape(4, *(len(axis) for axis in edges))
    assert np.max(missed[kinked] / allowed[kinked]) > 0.45  # one in two directions: half of what both may leave
    for k in range(2):
        rise = np.diff(sides, axis=1 + k)
        each = np.stack([np.take(rise, range(own, rise.shape[2 - k] - 1 + own), axis=2 - k) for own in (0, 1)])
        low, high = loop.slopes[k].reshape(2, 4, *steps.shape)
        assert np.all(low <= each.min(axis=0) + 1e-8) and np.all(each.max(axis=0) <= high + 1e-8)


@pytest.mark.parametrize("name", KINKED)
def test_what_kinks_of_images_leave_is_charged(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    across = closed_loops._across_kinks

    def exact(loop: closed_loops.ClosedLoop) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        own = across(loop)
        assert np.any(own[2] > 0.0)
        return own[0], own[1], 0.0 * own[2]

    monkeypatch.setattr(closed_loops, "_across_kinks", exact)
    pairs = (below_and_true(name, seed) for seed in range(8))
    assert any(np.any(found > true + 1e-13) for found, true in pairs)


@pytest.mark.parametrize("part", ["kinks", "terms", "slopes", "varies", "bends"])
def test_what_a_lattice_leaves_out_is_noticed(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if part == "kinks":
        monkeypatch.setattr(LatticeImages, "_kinks", lambda self, W, k: 0.0 * self._planes(k))
    elif part == "terms":  # no second derivatives along single axes
        whole = Lattice.orders
        monkeypatch.setattr(Lattice, "orders", lambda self: [own for own in whole(self) if max(own) < 2])
    else:  # images that stand still, or move as in the middle of cells
        of, key = LatticeImages.of, {"slopes": "p", "varies": "q", "bends": "bends"}[part]

        def still(*arguments: Any) -> LatticeImages:
            own = of(*arguments)
            return replace(own, **{key: 0.0 * getattr(own, key)})

        monkeypatch.setattr(LatticeImages, "of", still)
    name = {"kinks": "a state without noise", "bends": "two states that bend"}.get(part, "two states")
    monkeypatch.setattr(LatticeImages, "_between", lambda self, orders: 0.0)
    # until one of them shows it
    pairs = (below_and_true(name, seed, saddle, on_lattice=True) for seed in range(8) for saddle in (False, True))
    assert any(np.any(found > true + 1e-13) for found, true in pairs)


@pytest.mark.parametrize("is_whole", [True, False])
def test_what_lies_between_points_is_noticed(is_whole: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    # Points far apart: second derivatives at them alone are too few.
    monkeypatch.setattr(lattices, "STEPS", (2.0,))
    monkeypatch.setattr(lattices, "MOST_LOOKED", 10**9)
    if not is_whole:
        monkeypatch.setattr(LatticeImages, "_between", lambda self, orders: 0.0)
    pairs = (below_and_true("two states", seed, seed % 2 == 0, on_lattice=True) for seed in range(10))
    assert is_whole != any(np.any(found > true + 1e-13) for found, true in pairs)


@pytest.mark.parametrize(
    ("name", "on_lattice"),
    [
        *((name, True) for name in OF_ONE_SIZE if "without" not in name and name not in KINKED),
        ("two states, noise by state and input", False),
        ("three states", False),
    ],
)
def test_second_derivatives_are_bounded_on_a_lattice_and_feature_by_feature(name: str, on_lattice: bool) -> None:
    problem, edges, rng = on_grid(name, 3)
    window = np.array([[axis[0] - 0.5, axis[-1] + 0.5] for axis in edges]).T if on_lattice else None
    steps = Backups(problem, edges, (True,) * len(edges), 6.8, None, window)
    at, d = np.stack(np.meshgrid(*edges, indexing="ij")).reshape(len(edges), -1), len(edges)
    inputs = np.clip(np.cos(rng.normal(size=(1, d)) @ at).T, -1.0, 1.0)
    W = rng.random(tuple(2 * n for n in steps.shape)) ** 4
    if not on_lattice:  # in size features do not cancel: few of them
        W = np.all(np.indices(W.shape) >= len(edges[0]), axis=0).astype(float)
    seen = steps.images_of(inputs, 0)
    assert isinstance(seen, LatticeImages if on_lattice else images.Images) and all(steps.noisy)
    places, bends = np.flatnonzero(seen.known), seen.cost(W)[1]
    cells = np.stack(np.unravel_index(places, steps.shape))
    low, high = (np.stack([axis[own + side] for axis, own in zip(edges, cells, strict=True)]) for side in (0, 1))
    for k in range(d):
        # differences along axis k inside of cells
        share, h = rng.uniform(0.1, 0.9, low.shape), 1e-3
        each = [low + (share + side * h * (np.arange(d) == k)[:, None]) * (high - low) for side in (-1, 0, 1)]
        F = [truth(steps, W, inputs, x) for x in each]
        found = (F[0] - 2.0 * F[1] + F[2]) / h**2
        some = np.any(found > 0.2 * bends[k, places])
        assert np.all(found <= bends[k, places] + 1e-5) and some
    assert np.all(bends[:, ~seen.known] == 0.0)


@pytest.mark.parametrize("width", [0.02, 0.1, 0.5, 2.0])
def test_tables_of_a_lattice_are_as_exact_as_is_said(width: float) -> None:
    mpmath.mp.dps = 40
    rng, normal = np.random.default_rng(5), mpmath.mp
    edges = np.cumsum(np.concatenate([[-1.0], width * rng.uniform(1.0, 1.5, 60)]))
    for z in rng.uniform(-3.0, edges[-1] + 2.0, 4):
        found, (a, e) = lattices._tables(np.array([z]), edges), (mpmath.mpf(z), [mpmath.mpf(x) for x in edges])
        phi = [normal.npdf(x - a) for x in e]
        mass = [normal.ncdf(y - a) - normal.ncdf(x - a) for x, y in itertools.pairwise(e)]
        for order, table in enumerate(found):
            off = mpmath.mpf(0)
            for k, (x, y) in enumerate(itertools.pairwise(e)):
                w, (f, g) = y - x, phi[k : k + 2]
                rising = (f - g - (x - a) * mass[k]) / w, mass[k] / w - g, (f - g) / w - (y - a) * g
                both = mass[k], f - g, (x - a) * f - (y - a) * g
                off += abs(table[0, 2 * k + 1] - rising[order]) + abs(table[0, 2 * k] - both[order] + rising[order])
            assert off <= 0.1 * lattices.GRAIN / min(1.0, width) ** 2


def test_noise_whose_size_varies_has_no_lattice() -> None:
    with pytest.raises(Refused, match="one size"):
        problem, edges, _ = on_grid("one state, its noise grows with it", 0)
        Backups(problem, edges, (True,), 6.8, None, np.array([[-2.0], [2.0]])).lattice(0).step.hex()
    with pytest.raises(Refused, match="numbers"):
        problem, edges, _ = on_grid("two states", 0)
        Backups(problem, edges, (True, True), 6.8, None, np.array([[-1e5, -1], [1e5, 1]])).lattice(0).step.hex()


@pytest.mark.parametrize("size", ["0.25 + 0.1*u^2", "0.25 + 0.02*t"])
def test_a_lattice_is_not_for_noise_whose_size_inputs_or_the_time_decide(size: str) -> None:
    more = {"noise_std": [1.0, 1.0], "noise_scale": ["0.25", size]}
    problem, edges, _ = on_grid("two states", 0, **more)
    window = np.array([[-1.0, -1.0], [1.0, 1.0]])
    with pytest.raises(Refused, match="whatever inputs are"):
        Backups(problem, edges, (True, True), 6.8, None, window).lattice(0).step.hex()
    # and by default it proves something
    found = cg.synthesize(problem_of("two states", **more), relation="vertices", effort=4.0)
    assert found.lower_bound > 0.05 and cg.check(found.certificate)


def test_edges_lie_where_dynamics_have_corners() -> None:
    more = {"dynamics": ["x + 0.2*y", "0.9*y - 0.3*max(2*y, 0.7) + 0.5*u - 0.1*y*abs(0.2 - x)"]}
    problem = read_problem({"problem": canonical_problem(problem_of("two states", **more))})
    spreads = value_iteration.spreads_of(problem)
    edges = value_iteration.grid_of(problem, spreads, 400, problem.agents[0].state_box)
    assert 0.2 in edges[0] and 0.35 in edges[1]


LAWS: dict[str, dict[str, Any]] = {
    "student-t": {"law": "student-t", "scale": 0.1, "df": 3.5},
    "laplace": {"law": "laplace", "scale": 0.1},
    "logistic": {"law": "logistic", "scale": 0.08},
    "uniform": {"law": "uniform", "low": -0.15, "high": 0.25},
    "triangular": {"law": "triangular", "low": -0.3, "mode": 0.1, "high": 0.2},
    "a ramp": {"law": "triangular", "low": -0.2, "mode": -0.2, "high": 0.3},
    "cut": {"law": "truncated-gaussian", "spread": 0.2, "low": -0.1, "high": 0.3},
    "mixture": {"law": "mixture", "parts": [
        {"weight": 0.7, "mean": -0.05, "law": "gaussian", "std": 0.1},
        {"weight": 0.3, "mean": 0.1, "law": "laplace", "scale": 0.05},
    ]},
}  # fmt: skip


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", [pytest.param("two states", marks=pytest.mark.thorough), "one state, other noise"])
def test_backups_are_below_the_truth_for_other_laws(name: str, law: str) -> None:
    states = len(DYNAMICS[name]["states"])
    pairs = [below_and_true(name, seed, near=12.0, noise=[LAWS[law]] * states) for seed in range(2)]
    # the truth is a sum over points of each interval
    assert all(np.all(found <= true + 1e-5) for found, true in pairs)
    assert any(np.median(true - found) < 0.3 for found, true in pairs)


@pytest.mark.parametrize("law", LAWS)
def test_tables_of_laws_bound_what_they_say(law: str) -> None:
    own = problem_of("one state, its noise grows with it", noise=[LAWS[law]]).agents[0].laws[0]  # type: ignore[index]
    table, rng = Tabled(own, 1.3 * own.std), np.random.default_rng(7)
    axis = np.sort(rng.uniform(-4.0, 4.0, (300, 2)), axis=1)
    y = np.sort(rng.uniform(-1.0, 1.0, (2, 300)), axis=0)
    size = np.sort(rng.uniform(0.5, 1.5, (2, 300)), axis=0)
    seen = table.seen(axis - y[1][:, None], axis - y[0][:, None], size[0][:, None], size[1][:, None])
    for _ in range(50):
        tau = (axis - rng.uniform(y[0], y[1])[:, None]) / rng.uniform(size[0], size[1])[:, None]
        step = 1e-5
        above = [own.tails((tau + k * step) * table.unit)[1] for k in (-1, 0, 1)]
        jumps = [abs(tau - at) < 2e-5 for at, _ in table.jumps]
        smooth = ~np.any(jumps, axis=0) if jumps else np.ones(tau.shape, dtype=bool)
        dens = (above[0] - above[2]) / (2.0 * step)
        for p in range(3):
            assert np.all((np.abs(tau) ** p * dens <= seen.dens[p] + 1e-4)[smooth])
        assert np.all(above[1][:, 0] - above[1][:, 1] <= seen.mass[:, 0] + 1e-15)
    t = rng.uniform(-6.0, 6.0, 100)
    fine = np.linspace(-30.0, 30.0, 120_001)
    dens = -np.gradient(own.tails(fine * table.unit)[1], fine)
    slope = np.abs(np.gradient(dens, fine))
    near = [np.abs(fine - at) < 2e-3 for at, _ in table.jumps]
    slope[np.any(near, axis=0) if near else []] = 0.0
    rest = np.cumsum((fine * dens)[::-1])[::-1] * (fine[1] - fine[0])
    none = np.zeros((len(fine), 1))
    at = table.seen(fine[:, None] - 2e-3, fine[:, None] + 2e-3, none + 1.0, none + 1.0)
    for p in range(3):
        # differences of differences: seen from both sides of corners, and rounded
        assert np.all(np.abs(fine) ** p * slope <= at.slope[p][:, 0] * (1.0 + 1e-3) + 2e-3 * (1.0 + np.abs(fine) ** p))
    assert at.rest is not None and np.all(np.abs(rest) <= at.rest[:, 0] + 1e-3)
    assert np.all(table.beyond(np.abs(t), np.ones(100), 1) >= own.tails(np.abs(t) * table.unit)[1])
    assert np.all(table.beyond(np.abs(t), np.ones(100), -1) >= own.tails(-np.abs(t) * table.unit)[0])
    edges = np.linspace(-5.0, 5.0, 30) + 0.1 * rng.uniform(-1.0, 1.0, 30)
    hats, lack = table.hats(t / 2.0, np.full(100, 0.7), edges)
    mass, rising = hats_of(table, (edges - t[:, None] / 2.0) / 0.7, 1000)
    true = np.stack([mass - rising, rising], axis=-1).reshape(100, -1)
    assert np.all(hats <= true + 2e-7) and np.all(true.sum(axis=1) - hats.sum(axis=1) <= lack + 1e-6) and lack < 1e-6


@pytest.mark.parametrize("part", ["dens", "slope", "mass", "leaps"])
def test_what_is_left_out_of_a_law_is_noticed(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, law = Tabled.seen, LAWS["uniform" if part == "leaps" else "logistic"]

    def less(*arguments: Any) -> Any:
        seen = whole(*arguments)
        value: Any = {"dens": [0.02 * own for own in seen.dens], "slope": [0.02 * own for own in seen.slope],
                 "mass": 0.02 * seen.mass, "leaps": None}[part]  # fmt: skip
        return seen._replace(**{part: value})

    monkeypatch.setattr(Tabled, "seen", less)
    name = "one state, other noise" if part == "leaps" else "two states"
    states = len(DYNAMICS[name]["states"])
    pairs = (below_and_true(name, seed, near=12.0, noise=[law] * states) for seed in range(8))
    assert any(np.any(found > true + 1e-3) for found, true in pairs)


@pytest.mark.parametrize("name", ["one state, its noise grows with it", "two states", "three states"])
def test_backups_are_not_much_below_where_cells_are_narrow(name: str) -> None:
    problem = read_problem({"problem": canonical_problem(problem_of(name))})
    low, high = problem.agents[0].state_box
    d = len(low)
    edges = tuple(np.linspace(a, b, {1: 200, 2: 60, 3: 14}[d]) for a, b in zip(low, high, strict=True))
    steps = Backups(problem, edges, (True,) * d)
    W = np.ones(tuple(2 * n for n in steps.shape))
    inputs = np.zeros((int(np.prod([len(axis) for axis in edges])), 1))
    values, nothing = steps.below(W, steps.images_of(inputs, 0))
    x = np.stack([np.random.default_rng(1).uniform(0.5 * axis[0], 0.5 * axis[-1], 1000) for axis in edges])
    true = truth(steps, W, inputs, x)
    assert not nothing.all() and np.median(true - interpolated(edges, values.reshape(-1, 1), x)[0]) < 0.02 * d


@pytest.mark.parametrize("part", ["single", "mixed", "sizes", "jumps", "means"])
def test_what_is_left_out_is_noticed(part: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Sabotage: bends, mixed derivatives, sizes that vary, jumps, or means that are too high; some seed shows it.
    name = "one state, its noise grows with it" if part == "sizes" else "two states"
    if part == "means":
        means = images.Means.below
        monkeypatch.setattr(images.Means, "below", lambda self, W: means(self, W) + 1e-3)
    elif part == "sizes":
        still = lambda self, some: features.Moves(self.y[some], *(0.0 * own[some] for own in self[1:]))  # noqa: E731
        monkeypatch.setattr(features.Moves, "of", still)
    elif part == "jumps":
        monkeypatch.setattr(features, "_jumps", lambda ends: np.zeros((*ends.shape[:-1], ends.shape[-1] // 2 + 1)))
    else:
        whole = getattr(features, f"_{part}")
        less = {"single": lambda *given: (whole(*given)[0], 0.02 * whole(*given)[1])}
        monkeypatch.setattr(features, f"_{part}", less.get(part, lambda *given: 0.02 * whole(*given)))
    pairs = (below_and_true(name, seed, saddle=part == "mixed") for seed in range(6))
    assert any(np.any(found > true + 1e-13) for found, true in pairs)


@mostly_thorough(
    ("name", "deviations"),
    [
        *itertools.product(["two states", "two states, noise by state and input"], [0.8, 2.0]),
        ("three states", 2.0),
        ("three states", 0.8),
    ],
    first=2,
)
def test_what_is_far_from_images_costs_its_probability(
    name: str, deviations: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(images, "BESIDE", 100.0)  # blocks of a few cells
    pairs = [below_and_true(name, seed, near=deviations) for seed in range(1 if deviations < 1.0 else 2)]
    assert all(np.all(found <= true + 1e-13) for found, true in pairs)
    assert deviations < 1.0 or any(len(found) > 100 for found, _ in pairs)


def test_probabilities_beyond_are_noticed_when_they_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    # Corners see all of W, and what bends is looked for in a box alone.
    means = images.Means.of
    monkeypatch.setattr(images, "BESIDE", 100.0)
    monkeypatch.setattr(Normal, "beyond", lambda self, distance, sigma, side: np.zeros(len(distance)))

    monkeypatch.setattr(images.Means, "of", lambda loop, edges, noisy, near: means(loop, edges, noisy, 8.0))
    # Nothing but two places far apart, so that means in between are convex.
    problem, edges, rng = on_grid("two states", 0)
    steps = Backups(problem, edges, (True, True), 0.3)
    W = np.zeros(tuple(2 * n for n in steps.shape))
    W[(abs(edges[0]) > 0.4).repeat(2)[1:-1]] = 1.0
    inputs = np.zeros((math.prod(len(axis) for axis in edges), 1))
    values, nothing = steps.below(W, steps.images_of(inputs, 0))
    x = np.stack([rng.uniform(axis[0], axis[-1], 40_000) for axis in edges])
    cells = tuple(np.searchsorted(axis, own, side="right") - 1 for axis, own in zip(edges, x, strict=True))
    x = x[:, ~nothing[cells]]
    assert np.any(interpolated(edges, values.reshape(-1, 1), x)[0] > truth(steps, W, inputs, x) + 1e-13)


@pytest.mark.parametrize("name", ["two states", "a state without noise"])
def test_blocks_change_nothing_but_rounding(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    quiet = [0.04 * (std > 0.0) for std in DYNAMICS[name]["noise_std"]]
    problem, edges, rng = on_grid(name, 5, noise_std=quiet)
    at, each = np.stack(np.meshgrid(*edges, indexing="ij")).reshape(len(edges), -1), []
    inputs = np.cos(rng.normal(size=(1, len(at))) @ at).T
    W = rng.random([2 * (len(axis) - 1) for axis in edges])
    for beside in (1.0, 1e18):
        monkeypatch.setattr(images, "BESIDE", beside)
        steps = Backups(problem, edges, (True,) * len(edges), 8.0)
        seen = steps.images_of(inputs, 0)
        assert isinstance(seen, images.Images)
        each.append((seen.vertices.below(W), *seen.cost(W), seen.known, len(seen.blocks)))
    many, one = each
    assert many[-1] > 4 and one[-1] == 1 and np.array_equal(many[-2], one[-2]) and many[-2].any()
    for a, b in zip(many[:2], one[:2], strict=True):
        assert np.allclose(a, b, rtol=1e-9, atol=1e-9)
    # kinks are rounded by the width of the narrowest cell that is near
    assert np.allclose(many[2], one[2], rtol=1e-4, atol=1e-6)  # single precision, rounded up by the length of sums


@pytest.mark.parametrize("unit", [2.0**-60, 2.0**27, 2.0**60])
def test_units_of_states_change_nothing(unit: float) -> None:
    name, each = "a state without noise", []
    for scale in (1.0, unit):
        own = {key: scale * np.array(DYNAMICS[name][key]) for key in ("state_low", "state_high", "noise_std")}
        more = {"initial_state": [0.5 * scale] * 2, "input_low": [-scale], "input_high": [scale]}
        goal = cg.Proposition("a", [-0.5 * scale] * 2, [0.5 * scale] * 2)
        agent = cg.Agent(name="a", inputs=["u"], **{**DYNAMICS[name], **own, **more})
        task = cg.Problem(name="p", agents=[agent], propositions={"goal": goal}, specification="F goal", horizon=6)
        edges = tuple(np.linspace(a, b, 20) for a, b in zip(own["state_low"], own["state_high"], strict=True))
        steps = Backups(read_problem({"problem": canonical_problem(task)}), edges, (True, True))
        inputs = scale * np.random.default_rng(3).uniform(-1.0, 1.0, (400, 1))
        seen = steps.images_of(inputs, 0)
        each.append(seen.cost(np.random.default_rng(4).random((38, 38)))[1])
    assert np.allclose(each[0], each[1], rtol=1e-5, atol=1e-12) and each[0].max() > 0.0


def test_tables_of_densities_and_tails_enclose_what_scipy_computes() -> None:
    t = np.concatenate([np.random.default_rng(0).uniform(0.0, 9.0, 20_000), np.arange(12.0), np.sqrt([1.0, 2.0, 3.0])])
    place = (t * noise_bounds.FINE).astype(int)
    for p, table in enumerate(noise_bounds._densities()):
        true = t**p * np.exp(-0.5 * t * t) / np.sqrt(2.0 * np.pi)
        assert np.all(true <= table[place] * (1.0 + 1e-13)) and np.all(table[place] <= true * 1.02 + 1e-3)
    low, high = noise_bounds._tails(t)
    assert np.all(low <= ndtr(-t) * (1.0 + 1e-12)) and np.all(ndtr(-t) <= high * (1.0 + 1e-12))
    assert np.all(high - low <= 1e-3) and noise_bounds._tails(np.array([50.0]))[0] == 0.0


@pytest.fixture(scope="module")
def certificate() -> cg.Certificate:
    problem = problem_of("one state, its noise grows with it")
    found = cg.synthesize(problem, relation="vertices", effort=5.0)
    return found.certificate


def test_certificates_are_checked_and_stand_rollouts(certificate: cg.Certificate, tmp_path: Path) -> None:
    assert certificate.proof.kind == "vertex-grid" and certificate.lower_bound > 0.5
    assert cg.check(certificate)
    rollouts, alarm = 20_000, 1e-6
    result = cg.rollout(certificate.problem, certificate.controller, episodes=rollouts, seed=3)
    assert 0.99 < result.successes / rollouts
    failures = rollouts - result.successes
    most = 1.0 if not failures else beta.ppf(1.0 - alarm, result.successes + 1, failures)
    assert certificate.lower_bound <= most
    cg.save(certificate, tmp_path / "c.npz")
    again = cg.load(tmp_path / "c.npz")
    assert cg.check(again) and again.lower_bound == certificate.lower_bound


@pytest.mark.thorough
def test_noise_of_other_laws_is_certified_checked_and_stands_rollouts() -> None:
    problem = cg.load(Path(__file__).parents[2] / "examples" / "own" / "inventory.toml")
    told = list[tuple[str, float]]()
    found = cg.synthesize(problem, relation="vertices", effort=1.0, progress=lambda *own: told.append(own))
    hoped = [value for text, value in told if text == "hoped for"]
    assert hoped and abs(hoped[-1] - found.lower_bound) < 1e-3  # coarse values are told before anything is proved
    proof: Any = found.certificate.proof
    assert proof.kind == "vertex-grid" and proof.failure < 1e-3 and cg.check(found.certificate)
    rollouts, alarm = 20_000, 1e-6
    successes = cg.rollout(problem, found.policy, episodes=rollouts, seed=3).successes
    most = 1.0 if successes == rollouts else beta.ppf(1.0 - alarm, successes + 1, rollouts - successes)
    assert found.certificate.lower_bound <= most
    checked, laws = read_problem({"problem": canonical_problem(problem)}), problem.agents[0].laws or ()
    held = proof.grid.edges, proof.grid.inputs, proof.grid.laws, proof.grid.jumps, proof.grid.near
    assert failure_of(checked, *held, laws) <= proof.failure
    # The law is that of the problem: a narrower one proves another number, and none proves nothing.
    narrow: Any = next(iter(laws))
    assert failure_of(checked, *held, [replace(narrow, low=-1.6, high=1.6)]) != failure_of(checked, *held, laws)
    with pytest.raises(Refused, match="which law"):
        failure_of(checked, *held, None)


@pytest.mark.parametrize("forge", ["failure", "inputs", "edges", "no number", "laws", "jumps"])
def test_forgeries_are_refused(certificate: cg.Certificate, forge: str) -> None:
    proof: Any = certificate.proof
    axis = proof.grid.edges[0]
    changed: dict[str, Any] = {
        "inputs": {"inputs": 3.0 * proof.grid.inputs + 1.0},
        "edges": {"edges": (np.concatenate([axis[:-1], [axis[-1] + 1.0]]),)},
        "no number": {"edges": (np.concatenate([axis[:2], [np.nan], axis[3:]]),)},
        "laws": {"laws": proof.grid.laws + 1000},
        "jumps": {"jumps": ()},
    }
    forged = replace(proof, grid=replace(proof.grid, **changed.get(forge, {})))
    if forge == "failure":
        forged = replace(proof, failure=0.5 * proof.failure)
    assert not cg.check(replace(certificate, proof=forged))


def test_the_automaton_is_proved_against_the_formula(certificate: cg.Certificate) -> None:
    proof: Any = certificate.proof
    problem = read_problem({"problem": canonical_problem(certificate.problem)})
    always = replace(problem.automaton, accepting=(True,) * len(problem.automaton.accepting))
    forged = replace(problem, automaton=always)
    with pytest.raises(Refused, match="not that of the formula"):
        failure_of(
            forged, proof.grid.edges, proof.grid.inputs, proof.grid.laws, proof.grid.jumps, proof.grid.near, None
        )


def test_more_agents_or_other_noise_are_refused_in_words() -> None:
    problem = problem_of(
        "two states", noise={"laws": [{"law": "laplace", "scale": 0.1}] * 2, "axes": [[1, 1], [-1, 1]]}
    )
    with pytest.raises(ValueError, match="not independent"):
        cg.synthesize(problem, relation="vertices")
    assert failure_of.__doc__


def test_noise_far_from_0_is_refused() -> None:
    # Its density is beyond all bins, where it would count as next to nothing.
    far = [{"law": "uniform", "low": 10.0, "high": 10.1}, {"law": "mixture", "parts": [
        {"weight": 0.5, "mean": 30.0, "law": "laplace", "scale": 0.1},
        {"weight": 0.5, "mean": 30.2, "law": "laplace", "scale": 0.1},
    ]}]  # fmt: skip
    for law in far:
        with pytest.raises(ValueError, match="add it to the dynamics"):
            cg.synthesize(problem_of("one state, other noise", noise=[law]), relation="vertices")


def test_what_was_found_is_returned_at_ctrl_c(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def iterated(*arguments: Any, **more: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 4:  # two coarse grids, the first one, and the next one, which is broken off
            raise KeyboardInterrupt
        return found(*arguments, **more)

    found = value_iteration.iterated
    monkeypatch.setattr(value_iteration, "iterated", iterated)
    work = CountedWork(1e3)
    problem = problem_of("one state, its noise grows with it", noise_std=[2.5])
    result = value_iteration.vertex_grid_certificate(problem, work)
    assert len(calls) == 4 and work.is_interrupted and cg.check(result.certificate)


def test_inputs_for_larger_noise_leave_room_for_what_is_charged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nearly all runs stay in a band, values say little of inputs, and much is charged near its ends."""
    agent = cg.Agent(
        name="a", states=["x"], inputs=["u"], dynamics=["x + 0.3*u"], noise_std=[1.0],
        noise_scale=["0.06*(1 + 0.2*x^2)"], state_low=[-1.5], state_high=[1.5], input_low=[-1], input_high=[1],
        initial_state=[0.6],
    )  # fmt: skip
    band = cg.Proposition("a", [-1.0], [1.0])
    task = cg.Problem(name="p", agents=[agent], propositions={"band": band}, specification="G band", horizon=30)
    checked, edges = read_problem({"problem": canonical_problem(task)}), (np.linspace(-1.5, 1.5, 17),)
    failures = []
    for crossed in (0.0, 1.0):
        monkeypatch.setattr(input_choice, "CROSSED", crossed)
        failures.append(value_iteration.iterated(Counted(checked, edges, (True,)), None)[2])
    assert failures[1] < 0.5 * failures[0]


def test_inputs_that_act_only_beside_others_do_not_jump_between_vertices() -> None:
    """With a pump that is off its share moves nothing, and still it has to change little by little."""
    agent = cg.Agent(
        name="roof", states=["a", "b"], inputs=["pump", "share"],
        dynamics=["0.9*a + 0.3*pump*share", "0.92*b + 0.3*pump*(1 - share)"],
        noise_std=["0.03 + 0.05*a", "0.03 + 0.04*b"], state_low=[-0.5, -0.5], state_high=[3, 3],
        input_low=[0, 0], input_high=[1, 1], initial_state=[1, 1],
    )  # fmt: skip
    alive, moist = cg.Proposition("roof", [0.5, 0.5], [2, 2]), cg.Proposition("roof", [0.9, 0.9], [1.5, 1.5])
    task = cg.Problem(
        name="p", agents=[agent], propositions={"alive": alive, "moist": moist},
        specification="G alive & F[6,10] moist", horizon=10,
    )  # fmt: skip
    result = value_iteration.vertex_grid_certificate(task, CountedWork(2.0))
    assert result.certificate.lower_bound >= 0.999 and cg.check(result.certificate)


@pytest.mark.parametrize(("m", "shape"), [(1, (41, 23)), (2, (17, 30))])
def test_where_values_say_nothing_inputs_are_smooth(m: int, shape: tuple[int, ...]) -> None:
    """They join what is wanted at two ends of a grid without jumps, however fine it is."""
    choice: Any = object.__new__(input_choice.Choice)
    choice.m, choice.count, choice.axis = m, 5, np.linspace(0.0, 1.0, 5)
    choice.levels = input_choice._levels(shape)
    # no input loses anything inside; at the first and the last place of an axis one end of each input is much better
    table = np.zeros((*[5] * m, *shape))
    for j in range(m):
        share = choice.axis.reshape(-1, *(1,) * (m - 1 - j + len(shape)))
        table[..., 0, :] += np.broadcast_to(share, table.shape)[..., 0, :]
        table[..., -1, :] -= np.broadcast_to(share, table.shape)[..., -1, :]
    shares = choice._smooth(table.reshape(*[5] * m, -1), np.ones((math.prod(shape), m))).reshape(*shape, m)
    assert np.all(shares[0] > 0.9) and np.all(shares[-1] < 0.1)
    assert np.abs(np.diff(shares, axis=0)).max() < 0.2


@pytest.mark.parametrize(
    ("limit", "least", "most"), [(1e4, 400, 400), (60.0, 1500, 1700), (30.0, 1150, 1250), (1.0, 400, 400)]
)
def test_dear_grids_begin_with_cells_that_prove_something(limit: float, least: float, most: float) -> None:
    """40 x 40 cells of 1.6 deviations where 1000 vertices took 14 core seconds; wide ones where these are cheap."""
    window, spreads = np.array([[-1.0, -1.0], [1.0, 1.0]]), np.full((2, 3), 0.032)
    assert least <= value_iteration._first(400.0, window, spreads, 14.0, CountedWork(limit)) <= most


def test_cells_are_narrow_wherever_a_region_comes_by() -> None:
    agent = cg.Agent(
        name="a", states=["x"], inputs=["u"], dynamics=["x + u"], noise_std=[0.1], state_low=[-1], state_high=[9],
        input_low=[-1.5], input_high=[1.5], initial_state=[0],
    )  # fmt: skip
    near = cg.Proposition("a", ["4*sin(0.4*t) - 0.5"], ["4*sin(0.4*t) + 0.5"])
    problem = cg.Problem(name="p", agents=[agent], propositions={"near": near}, specification="G near", horizon=8)
    checked = read_problem({"problem": canonical_problem(problem)})
    low, high = value_iteration._alive(checked, (np.linspace(-1.0, 9.0, 101),))
    assert low[0] <= -0.5 and 4.4 <= high[0] <= 4.7


def test_runs_may_go_beyond_those_of_a_guess(monkeypatch: pytest.MonkeyPatch) -> None:
    """A guess says where cells are narrow at first; cells whose images leave its window for good would be worth 0."""
    agent = cg.Agent(
        name="cart", states=["x", "v"], inputs=["u"], dynamics=["x + 0.3*v", "0.9*v + 0.4*u"], noise_std=[0.1, 0.2],
        state_low=[-3, -2], state_high=[3, 2], input_low=[-1], input_high=[1], initial_state=[-1, 0],
    )  # fmt: skip
    goal = {"goal": cg.Proposition("cart", [0.5, -2], [2.5, 2])}
    problem = cg.Problem(name="p", agents=[agent], propositions=goal, specification="F goal", horizon=10)
    controller = cg.synthesize(problem, relation="path", effort=1.0).controller
    free = value_iteration.vertex_grid_certificate(problem, CountedWork(3.0)).certificate.lower_bound
    under = sampled_runs.Runs.under

    def narrow(problem: cg.Problem, controller: Any) -> sampled_runs.Runs:
        runs = under(problem, controller)
        middle = np.median(runs.states, axis=(0, 2))[None, :, None]
        return replace(runs, states=middle + 0.05 * (runs.states - middle), failure=0.2)

    monkeypatch.setattr(sampled_runs.Runs, "under", narrow)
    led = value_iteration.vertex_grid_certificate(problem, CountedWork(3.0), controller).certificate.lower_bound
    assert free > 0.7 and led > free - 0.05


def test_sums_of_nothing_are_nothing() -> None:
    """``einsum`` has been seen to leave what stood in memory in sums over no features, of any sign."""
    table, none = np.full((874, 39), np.nan, dtype=np.float32), np.array([], dtype=int)
    for _ in range(20):
        sums = features._rows(table[:, none], table[:, :0])
        assert np.array_equal(sums, np.full(874, features.LOST))
