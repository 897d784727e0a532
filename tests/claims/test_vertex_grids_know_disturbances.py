"""Grids of vertices with disturbances: values are below the truth for whatever these do, and hardly more than that."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import beta

import certigym as cg
from certigym.synthesis.certificates.proofs import canonical_problem
from certigym.synthesis.checker import read_problem
from certigym.synthesis.extended_check.claims import greedy_disturbance
from certigym.synthesis.extended_check.vertex_grids import Backups, LatticeImages, any_disturbance, backups, images
from certigym.synthesis.policy_search.vertex_values.counted_backups import Counted
from certigym.synthesis.policy_search.vertex_values.value_iteration import iterated
from test_vertex_grids_are_below_the_truth import interpolated

# dynamics, sizes of the noise, disturbances
KINDS: dict[str, tuple[list[str], list[str], dict[str, list[float]]]] = {
    "additive": (["0.9*x + 0.3*u - 0.1*sin(2*x) + d"], ["0.2"], {"d": [-0.2, 0.3]}),
    "times states": (
        ["x*(0.8 + d) + 0.2*e", "0.9*y + 0.4*sin(x)*d + 0.3*u"], ["0.15", "0.2"], {"d": [-0.3, 0.2], "e": [-1, 1]}
    ),
    "in the noise": (
        ["0.8*x + 0.2*u + 0.3*d", "0.7*y + 0.2*x"], ["0.1 + 0.1*x^2 + 0.2*d^2", "0.2 + 0.1*d"], {"d": [-0.5, 0.5]}
    ),
    "with kinks": (
        ["0.8*x + 0.4*abs(d) - 0.2*max(d, 0.4*x)", "0.8*y + 0.3*min(u, d)"], ["0.1", "0.15"], {"d": [-0.4, 0.5]}
    ),
    "without noise": (["0.6*x + 0.25*y + 0.3*d", "0.9*y - 0.2*x + 0.3*u - 0.3*d"], ["0", "0.2"], {"d": [-0.3, 0.4]}),
}  # fmt: skip


def steps_of(kind: str, seed: int, on_lattice: bool, near: float) -> tuple[Backups, np.random.Generator]:
    dynamics, sizes, unknown = KINDS[kind]
    d, rng = len(dynamics), np.random.default_rng(seed)
    agent = cg.Agent(
        name="a", states=["x", "y"][:d], inputs=["u"], dynamics=dynamics, disturbances=unknown,
        noise_std=[float(own != "0") for own in sizes], noise_scale=[own if own != "0" else "1" for own in sizes],
        state_low=[-1.2] * d, state_high=[1.4] * d, input_low=[-1], input_high=[1], initial_state=[0.1] * d,
    )  # fmt: skip
    goal = cg.Proposition("a", [-0.5] * d, [0.5] * d)
    task = cg.Problem(name="p", agents=[agent], propositions={"goal": goal}, specification="F goal", horizon=3)
    edges = tuple(np.sort(np.append(rng.uniform(-1.15, 1.35, 70 if d == 1 else 26), [-1.2, 1.4])) for _ in range(d))
    edges = tuple(axis[np.append(True, np.diff(axis) > 0.01)] for axis in edges)
    window = np.array([[-2.5] * d, [2.5] * d]) if on_lattice else None
    problem = read_problem({"problem": canonical_problem(task)})
    return Backups(problem, edges, (True,) * d, near, None, window), rng


def truth(steps: Backups, kind: str, W: np.ndarray, inputs: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the least means (M,) at states x over many disturbances, by expressions that Python evaluates."""
    dynamics, sizes, unknown = KINDS[kind]
    shares, least = np.random.default_rng(1).random((40, len(unknown))), np.full(x.shape[1], np.inf)
    corners = [*itertools.product((0.0, 0.5, 1.0), repeat=len(unknown))]
    names: dict[str, Any] = dict(zip(steps.agent.states, x, strict=True)) | {
        "u": interpolated(steps.edges, inputs, x)[0]
    }
    names |= {"sin": np.sin, "abs": np.abs, "max": np.maximum, "min": np.minimum}
    for share in (*corners, *shares):
        names |= {name: a + (b - a) * s for (name, (a, b)), s in zip(unknown.items(), share, strict=True)}
        y, sigma = (
            [eval(text.replace("^", "**"), {}, names) + 0.0 * x[0] for text in own] for own in (dynamics, sizes)
        )
        total: Any = np.broadcast_to(W, (x.shape[1], *W.shape))
        for k, axis in enumerate(steps.edges):
            z = (axis - y[k][:, None]) / np.maximum(sigma[k], 1e-9)[:, None]
            mass, phi = np.diff(ndtr(z), axis=1), np.exp(-0.5 * np.minimum(z * z, 1e3)) / np.sqrt(2.0 * np.pi)
            rising = (phi[:, :-1] - phi[:, 1:] - z[:, :-1] * mass) / np.diff(z, axis=1)
            hats = np.stack([mass - rising, rising], axis=-1).reshape(len(z), -1)
            total = np.einsum("na,na...->n...", hats, total)
        least = np.minimum(least, total)
    return least


def below_and_true(kind: str, seed: int, on_lattice: bool, near: float = 6.8) -> tuple[np.ndarray, np.ndarray]:
    """Return values of a backup and the truth at random states of cells that are kept, for random values later."""
    steps, rng = steps_of(kind, seed, on_lattice, near)
    at = np.stack(np.meshgrid(*steps.edges, indexing="ij")).reshape(len(steps.edges), -1)
    inputs = np.clip(np.cos(rng.normal(size=(1, len(at))) @ at).T + 0.05 * rng.normal(size=(at.shape[1], 1)), -1.0, 1.0)
    bumps = 0.6 + 0.4 * np.cos(3.0 * rng.normal(size=(1, len(at))) @ at + rng.uniform(0, 6))[0]
    nothing = rng.random(steps.shape) < 0.01 * (seed % 2)
    W = steps.on_cells(bumps.reshape(tuple(len(axis) for axis in steps.edges)), nothing)
    seen = steps.images_of(inputs, 0)
    assert isinstance(seen, LatticeImages) == on_lattice
    values, lost = steps.below(W, seen)
    x = np.stack([rng.uniform(axis[0], axis[-1], 500) for axis in steps.edges])
    cells = tuple(np.searchsorted(axis, own, side="right") - 1 for axis, own in zip(steps.edges, x, strict=True))
    x = x[:, ~lost[cells]]
    for k, noisy in enumerate(steps.noisy):
        W = W if noisy else backups._continuous(W, k)
    return interpolated(steps.edges, values.reshape(-1, 1), x)[0], truth(steps, kind, W, inputs, x)


CASES = [(kind, on_lattice) for kind in KINDS for on_lattice in (False, True) if not (on_lattice and "in the" in kind)]


@pytest.mark.parametrize(("kind", "on_lattice"), CASES)
@pytest.mark.parametrize(("most", "near"), [(1, 6.8), (1, 3.0), (3, 6.8)])
def test_backups_are_below_the_worst(
    kind: str, on_lattice: bool, most: int, near: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(any_disturbance, "MOST_PIECES", most)
    monkeypatch.setattr(images, "BESIDE", 100.0)  # blocks of a few pieces, so that what is far is left out
    pairs = [below_and_true(kind, seed, on_lattice, near) for seed in range(2)]
    found, true = map(np.concatenate, zip(*pairs, strict=True))
    assert len(found) > 50 and np.all(found <= true + 1e-9 * (kind == "without noise") + 1e-13)


@pytest.mark.parametrize("on_lattice", [False, True])
@pytest.mark.parametrize("part", ["charge", "kinks", "all but the middle"])
def test_what_is_left_out_is_noticed(part: str, on_lattice: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    pieces = any_disturbance.pieces_of

    def of_middle(self: Backups, inputs: np.ndarray, t: int) -> Any:
        loop = backups.closed_loop(self.agent, self.edges, inputs, t)
        return self._seen(replace(loop, rho=0.0 * loop.rho), t)

    def exact(*given: Any) -> Any:
        loop = pieces(*given)
        return replace(loop, off=0.0 * loop.off)

    monkeypatch.setattr(any_disturbance, "MOST_PIECES", 1)
    if part == "charge":
        monkeypatch.setattr(any_disturbance, "between", lambda a, b, bend: np.minimum(a, b))
    elif part == "kinks":  # pieces with kinks, as if they had none
        monkeypatch.setattr(backups, "pieces_of", exact)
    else:
        monkeypatch.setattr(Backups, "image_of", of_middle)
    kind = "with kinks" if part == "kinks" else "additive"
    pairs = (below_and_true(kind, seed, on_lattice) for seed in range(12))
    assert any(np.any(found > true + 1e-9) for found, true in pairs)


def room() -> cg.Problem:
    agent = cg.Agent(
        name="room", states=["T"], inputs=["q"], dynamics=["T + 0.025*(10 - T) + 0.6*q + sun"], noise_std=[0.35],
        disturbances={"sun": [-0.2, 0.2]}, state_low=[16], state_high=[24], input_low=[0], input_high=[1],
        initial_state=[20],
    )  # fmt: skip
    comfort = cg.Proposition("room", [18.2], [21.8])
    return cg.Problem(
        name="p", agents=[agent], propositions={"comfort": comfort}, specification="G comfort", horizon=24
    )


def test_a_bound_is_hardly_below_what_dense_programming_finds() -> None:
    x, y, q = np.linspace(18.2, 21.8, 361), np.linspace(17, 23, 1501), np.linspace(0.0, 1.0, 101)
    faces = np.concatenate([[18.2], 0.5 * (x[1:] + x[:-1]), [21.8]])
    mass = np.diff(ndtr((faces - y[:, None]) / 0.35), axis=1)
    means = (x + 0.025 * (10.0 - x))[:, None, None] + 0.6 * q[:, None] + np.linspace(-0.2, 0.2, 9)
    values = np.ones(len(x))
    for _ in range(24):
        values = np.interp(means, y, mass @ values).min(axis=2).max(axis=1)
    checked = read_problem({"problem": canonical_problem(room())})
    edges = (np.concatenate([[16.0], np.linspace(18.2, 21.8, 181), [24.0]]),)
    failure = iterated(Counted(checked, edges, (True,), 6.8, None, np.array([[15.0], [25.0]])), None)[2]
    best = float(np.interp(20.0, x, values))
    assert best - 0.003 < 1.0 - failure < best + 1e-4


def test_certificates_are_checked_and_stand_a_greedy_adversary() -> None:
    found = cg.synthesize(room(), relation="vertices", effort=3.0)
    assert found.certificate.proof.kind == "vertex-grid" and found.lower_bound > 0.84 and cg.check(found.certificate)
    # It is greedy for the values of cells of the same task.
    against = greedy_disturbance(cg.synthesize(room(), cells=80, relation="boxes"))
    rollouts, alarm = 20_000, 1e-6
    successes = cg.rollout(room(), found.policy, episodes=rollouts, seed=3, disturbance=against).successes
    calm = cg.rollout(room(), found.policy, episodes=rollouts, seed=3).successes
    assert found.lower_bound <= beta.ppf(1.0 - alarm, successes + 1, rollouts - successes)
    assert calm > successes + 1000
