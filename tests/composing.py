"""Rows and columns of the matrix: small problems of every kind, what can be asked of them, and a dense program.

A *row* is a way in which agents move and are certified: inputs as functions of the state, how values are read on
cells, dynamics, noise. A *column* is something that a user asks of a certificate. Columns return the numbers that they
claim, as ``Claims``; the dense program knows what no policy exceeds.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.special import ndtri

import certigym as cg
from balls import check_rigorous
from certigym.baselines import RandomController
from certigym.envs.systems.agents import LinearAgent
from certigym.synthesis.certificates.proofs import certificate_from, changed, with_claims
from certigym.synthesis.composition import horizons
from certigym.synthesis.relations.kinds import Network
from certigym.synthesis.verbs.upper_bounds import bound_above
from certigym.validation.policies.actors import SharedActor
from certigym.validation.policies.views import SharedView

RESOLUTION = 0.03
"""What the dense program may be off by: bins of a sixtieth of the workspace, thirteen inputs, noise at quantiles."""

FALSE_ALARM = 1e-6
"""Probability that a test of rollouts fails although the claim is true."""

EPISODES = 400


NORMAL = {"law": "gaussian", "std": 0.45}


# --- rows ------------------------------------------------------------------------------------------------------
def matrices(name: str = "one", **changes: Any) -> LinearAgent:
    """A scalar agent with matrices."""
    arguments: dict[str, Any] = {
        "A": [[0.9]], "B": [[0.8]], "noise_covariance": [[0.2]], "state_low": [-3.0], "state_high": [3.0],
        "input_low": [-1.5], "input_high": [1.5], "initial_state": [-1.2],
    }  # fmt: skip
    return LinearAgent(name=name, **{**arguments, **changes})


def expressions(name: str = "one", **changes: Any) -> cg.Agent:
    """A scalar agent with a bent drift."""
    arguments: dict[str, Any] = {
        "states": ["x"], "inputs": ["u"], "dynamics": ["0.9*x + 0.1*sin(x) + 0.8*u"],
        "noise": [NORMAL], "state_low": [-3.0], "state_high": [3.0], "input_low": [-1.5],
        "input_high": [1.5], "initial_state": [-1.2],
    }  # fmt: skip
    return cg.Agent(name=name, **{**arguments, **changes})


def task(*agents: Any, formula: str | None = None, horizon: int = 3) -> cg.Problem:
    """Every agent is to come to its goal at the same time, the first one past a hole."""
    regions: dict[str, Any] = {}
    for agent in agents:
        low, high = np.array(agent.state_low), np.array(agent.state_high)
        low[0] = 0.6
        regions[f"goal_{agent.name}"] = cg.Proposition(agent.name, low, high)
    low, high = np.array(agents[0].state_low), np.array(agents[0].state_high)
    high[0] = -2.0
    regions["hole"] = cg.Proposition(agents[0].name, low, high)
    goals = " & ".join(f"goal_{agent.name}" for agent in agents)
    text = formula or f"(!hole) U ({goals})"
    semantics = "finite-trace" if text.startswith("G") else "co-safe"
    return cg.Problem(
        name="composing", horizon=horizon, agents=agents, propositions=regions,
        specification=cg.Specification(text, semantics),
    )  # fmt: skip


def timed(agent: Any) -> cg.Problem:
    """The goal comes nearer, and the hole moves."""
    regions = {
        "goal": cg.Proposition("one", ["1.2 - 0.3*t"], [3.0]),
        "hole": cg.Proposition("one", [-3.0], ["-2 - 0.2*t"]),
    }
    return cg.Problem(
        name="composing", horizon=3, agents=[agent], propositions=regions,
        specification=cg.Specification("(!hole) U goal", "co-safe"),
    )  # fmt: skip


def told(name: str) -> cg.Agent:
    """A follower that the state of the first agent drags along, and is told of it."""
    return expressions(name, dynamics=["0.8*x + 0.1*one.x + 0.8*u"], communicated=["one"], initial_state=[-0.8])


def apart(**changes: Any) -> cg.Problem:
    """Two scalar agents, of which one passes the other: they must not be near."""
    agents = matrices("one"), matrices("two", initial_state=[1.5])
    regions: dict[str, Any] = {
        "goal_one": cg.Proposition("one", [-0.2], [0.8]),
        "near": cg.Pair(["one", "two"], [-0.3], [0.3]),
    }
    return cg.Problem(
        name="apart", horizon=3, agents=agents, propositions=regions,
        specification=cg.Specification("(!near) U goal_one", "co-safe"),
    )  # fmt: skip


@dataclass(frozen=True)
class Row:
    """A problem and the options under which it is certified."""

    problem: Callable[[], cg.Problem]
    cells: Any
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def settings(self) -> dict[str, Any]:
        """Arguments of ``synthesize`` but the problem."""
        return {**({} if self.cells is None else {"cells": self.cells}), **self.options}


LAPLACE = {"law": "laplace", "scale": 0.32}


def lawful() -> LinearAgent:
    """The scalar agent with noise that is not normal."""
    arguments = {key: value for key, value in matrices().to_dict().items() if key not in ("name", "noise_covariance")}
    return LinearAgent(name="one", noise=[LAPLACE], **arguments)


ROWS: dict[str, Row] = {
    "exact matrices": Row(lambda: task(matrices()), 24, {"relation": "exact"}),
    "exact Laplace": Row(lambda: task(lawful()), 24, {"relation": "exact"}),
    "exact expressions": Row(lambda: task(expressions()), 24, {"relation": "exact"}),
    "paper": Row(
        lambda: task(matrices()), 60, {"relation": "paper", "search": cg.SearchOptions(epsilon=0.1, inputs=10)}
    ),
    "linear matrices": Row(lambda: task(matrices()), 24, {"relation": "linear"}),
    "linear expressions": Row(lambda: task(expressions()), 24, {"relation": "linear"}),
    "boxes matrices": Row(lambda: task(matrices()), 24, {"relation": "boxes"}),
    "boxes expressions": Row(lambda: task(expressions()), 24, {"relation": "boxes"}),
    "boxes Laplace": Row(lambda: task(lawful()), 24, {"relation": "boxes"}),
    "boxes disturbance": Row(
        lambda: task(expressions(dynamics=["0.9*x + 0.8*u + v"], disturbances={"v": [-0.1, 0.1]})),
        24,
        {"relation": "boxes"},
    ),
    "boxes coupled": Row(lambda: task(expressions(), told("two"), horizon=2), 8, {"relation": "boxes"}),
    "boxes noise scale": Row(lambda: task(expressions(noise_scale=["0.8 + 0.1*cos(x)"])), 24, {"relation": "boxes"}),
    "boxes no noise": Row(
        lambda: task(
            expressions(
                states=["x", "charge"],
                dynamics=["0.9*x + 0.8*u", "charge - 0.1*abs(u)"],
                noise=[NORMAL, {"law": "gaussian", "std": 0.0}],
                state_low=[-3.0, 0.0],
                state_high=[3.0, 1.0],
                initial_state=[-1.2, 0.95],
            )
        ),
        16,
        {"relation": "boxes"},
    ),
    "exact in time": Row(lambda: timed(matrices()), 24, {"relation": "exact"}),
    "linear in time": Row(
        lambda: timed(expressions(dynamics=["0.9*x + 0.8*u + 0.3*sin(t)"])), 24, {"relation": "linear"}
    ),
    "path in time": Row(
        lambda: timed(expressions(dynamics=["0.9*x + 0.8*u + 0.3*sin(t)"], noise=[{"law": "gaussian", "std": 0.1}])),
        None,
        {"relation": "path"},
    ),
    "path": Row(lambda: task(matrices(noise_covariance=[[0.01]])), None, {"relation": "path"}),
    "subtraction": Row(lambda: apart(), 24, {"relation": "exact"}),
    "train": Row(
        lambda: task(matrices(), matrices("two")), 24, {"relation": "exact", "search": cg.SearchOptions(value="train")}
    ),
}


def searched(row: str, **options: Any) -> dict[str, Any]:
    """Arguments of a row with other options of its search."""
    settings = ROWS[row].settings
    return {**settings, "search": replace(settings.get("search", cg.SearchOptions()), **options)}


@cache
def problem_of(row: str) -> cg.Problem:
    return ROWS[row].problem()


@cache
def synthesis_of(row: str) -> cg.Synthesis:
    # Where nothing else is asked for, these are also what the column `tree` is about.
    is_open = row != "path" and searched(row)["search"].value == "auto"
    return cg.synthesize(problem_of(row), **(searched(row, value="tree") if is_open else ROWS[row].settings))


def certificate_of(row: str) -> Any:
    return synthesis_of(row).certificate


# --- the dense program -----------------------------------------------------------------------------------------
def optimum(row: str, start: NDArray[Any] | None = None) -> float:
    """What no policy exceeds, up to ``RESOLUTION``: dynamic programming on the joint states, all inputs in one hand."""
    problem = problem_of(row)
    if problem.fingerprint not in KNOWN:
        KNOWN[problem.fingerprint] = _dense(problem)
    return KNOWN[problem.fingerprint](initial_state(problem) if start is None else start)


KNOWN: dict[str, Callable[[NDArray[Any]], float]] = {}
"""Optimal values of problems by their fingerprints: several rows are about one problem."""


def initial_state(problem: cg.Problem) -> NDArray[Any]:
    return np.concatenate([agent.initial.low for agent in problem.agents])


def _dense(problem: cg.Problem) -> Callable[[NDArray[Any]], float]:
    """The optimal value as a function of the joint start, its letter read."""
    agents, automaton = problem.agents, problem.automaton
    low = np.concatenate([agent.state_low for agent in agents])
    high = np.concatenate([agent.state_high for agent in agents])
    d, count = len(low), 60 if len(low) == 1 else 40
    axes = [a + (np.arange(count) + 0.5) * (b - a) / count for a, b in zip(low, high, strict=True)]
    points = np.stack([mesh.ravel() for mesh in np.meshgrid(*axes, indexing="ij")])
    parts = [points[columns] for columns in problem.columns]
    noises = _noises(problem, d)
    value = np.repeat(np.asarray(automaton.accepting, dtype=float)[:, None], points.shape[1], axis=1)
    for t in reversed(range(problem.horizon)):
        if t == problem.horizon - 1 or problem.names_time:
            # Motions are those of t, letters those of t + 1.
            letters = _letters(problem, parts, t + 1)
            following = np.stack(
                [automaton.next_state(np.full(points.shape[1], q), letters) for q in range(automaton.n_states)]
            )
            means = [_means(problem, parts, inputs, t) for inputs in _inputs(problem)]
        arriving = np.take_along_axis(value, following, axis=0)
        new = np.empty_like(value)
        for q in range(automaton.n_states):
            if automaton.finished[q]:
                new[q] = float(automaton.accepting[q])
                continue
            table = arriving[q].reshape([count] * d)
            read = RegularGridInterpolator(axes, table, method="nearest", bounds_error=False, fill_value=0.0)
            lattice = _averaged(read, axes, low, high, noises, points)
            new[q] = np.max([lattice(mean.T, scale) for mean, scale in means], axis=0)
        value = new

    def at(state: NDArray[Any]) -> float:
        own = [state[columns][:, None] for columns in problem.columns]
        q = int(automaton.next_state(np.array([automaton.initial]), _letters(problem, own, 0))[0])
        cell = tuple(
            int(np.clip((x - a) / (b - a) * count, 0, count - 1)) for x, a, b in zip(state, low, high, strict=True)
        )
        return float(value[q].reshape([count] * d)[cell])

    return at


def _letters(problem: cg.Problem, parts: list[NDArray[Any]], t: int) -> NDArray[np.bool_]:
    holds = [problem.labeling.at(t).class_at(i, part) for i, part in enumerate(parts)]
    for pair in problem.labeling.pairs:
        gap = parts[pair.first][0] - parts[pair.second][0]
        holds.append(((pair.low[0] <= gap) & (gap < pair.high[0]))[None])
    return np.concatenate(holds)


def _inputs(problem: cg.Problem) -> list[list[NDArray[Any]]]:
    """Inputs of all agents, from evenly spaced ones of each."""
    each = []
    for agent in problem.agents:
        n = 13 if problem.n_inputs == 1 else 7
        axes = [np.linspace(a, b, n) for a, b in zip(agent.input_low, agent.input_high, strict=True)]
        each.append([np.array(u) for u in itertools.product(*axes)])
    return [list(joint) for joint in itertools.product(*each)]


def _means(problem: cg.Problem, parts: list[NDArray[Any]], inputs: list[NDArray[Any]], t: int) -> tuple[Any, Any]:
    """Means (D, n) of the next joint states of a step, and what noise is multiplied with; disturbances are calm."""
    n, means, scales = parts[0].shape[1], [], []
    rows = [np.repeat(u[:, None], n, axis=1) for u in inputs]
    for agent, x, u in zip(problem.agents, parts, rows, strict=True):
        if not isinstance(agent, cg.Agent):
            means.append(agent.mean(x, u))
            scales.append(np.ones_like(x))
            continue
        named = {f"{a.name}.{s}": row for a, p in zip(problem.agents, parts, strict=True) if isinstance(a, cg.Agent)
                 for s, row in zip(a.states, p, strict=True)}  # fmt: skip
        named |= {f"{a.name}.{s}": row for a, p in zip(problem.agents, rows, strict=True) if isinstance(a, cg.Agent)
                  for s, row in zip(a.inputs, p, strict=True)}  # fmt: skip
        beside = np.array([named[name] for name in agent.others]) if agent.others else None
        calm = np.zeros((len(agent.disturbances), n)) if agent.disturbances else None
        means.append(agent.mean(x, u, calm, beside, t))
        scales.append(np.ones_like(x) if agent.noise_scale is None else agent.scales(x, u, calm, t))
    return np.concatenate(means), np.concatenate(scales)


def _noises(problem: cg.Problem, d: int) -> NDArray[Any]:
    """Noise (K, D) at quantiles of its laws, all of one weight."""
    n = 200 if d == 1 else 24
    normal = ndtri((np.arange(n) + 0.5) / n)
    grid = np.stack([mesh.ravel() for mesh in np.meshgrid(*[normal] * d, indexing="ij")])
    rows = []
    for agent, columns in zip(problem.agents, problem.columns, strict=True):
        z = agent.components(grid[columns])
        normal_axes = agent.laws is None  # a covariance, of which states without noise have rows of zeros
        width, axes = np.linalg.eigh(agent.noise_covariance)
        root = axes * np.sqrt(np.maximum(width, 0.0)) if normal_axes else agent.noise_axes
        rows.append(root @ z)
    return np.concatenate(rows).T


def _averaged(read: Any, axes: Any, low: Any, high: Any, noises: NDArray[Any], points: NDArray[Any]) -> Any:
    """The mean of a table over the noise, as a function of means; scales are taken at the nearest point."""
    wide = [np.linspace(a - 0.2 * (b - a), b + 0.2 * (b - a), 85 if len(axes) == 1 else 57) for a, b in zip(low, high)]
    mesh = np.stack([own.ravel() for own in np.meshgrid(*wide, indexing="ij")], axis=1)

    def of_scale(scale: NDArray[Any]) -> Any:
        total = sum(read(mesh + noise * scale) for noise in noises) / len(noises)
        return RegularGridInterpolator(
            wide, total.reshape([len(axis) for axis in wide]), bounds_error=False, fill_value=0.0
        )

    plain = of_scale(np.ones(len(axes)))

    def lattice(means: NDArray[Any], scale: NDArray[Any]) -> NDArray[Any]:
        if np.all(scale == 1.0):
            return np.asarray(plain(means))
        return np.mean([read(means + noise * scale.T) for noise in noises], axis=0)

    return lattice


# --- columns ---------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Claims:
    """What a column claims: probabilities that some policy attains, and probabilities that none exceeds."""

    attained: tuple[float, ...] = ()
    exceeded_by_none: tuple[float, ...] = ()
    start: NDArray[Any] | None = None


def tree(row: str, folder: Path) -> Claims:
    """A certificate whose value is a tree."""
    if searched(row)["search"].value == "auto":
        return Claims((certificate_of(row).lower_bound,))
    return Claims((cg.synthesize(problem_of(row), **searched(row, value="tree")).certificate.lower_bound,))


def train(row: str, folder: Path) -> Claims:
    """A certificate whose value is a tensor train."""
    return Claims((cg.synthesize(problem_of(row), **searched(row, value="train")).certificate.lower_bound,))


def own_upper_end(row: str, folder: Path) -> Claims:
    """What the policies attain at most: part of the certificate, saved with it and met by rollouts."""
    return ended(bound_above(certificate_of(row)), folder)


def ended(certificate: Any, folder: Path) -> Claims:
    """Both ends of a claim, and a file that keeps them; ValueError where there is no upper one."""
    if certificate.gap is None:
        raise ValueError("no upper end of its own")
    report = cg.check(certificate)
    assert report and certificate.lower_bound <= report.above <= certificate.upper_bound
    cg.save(certificate, folder / "ends.npz")
    loaded: Any = certificate_from(folder / "ends.npz")
    assert loaded.upper_bound == certificate.upper_bound and cg.check(loaded).above == report.above
    validation = cg.validate(certificate, EPISODES, confidence=1.0 - FALSE_ALARM)
    assert not validation.refuted
    return Claims((certificate.lower_bound,))


def opposite_end(row: str, folder: Path) -> Claims:
    """What the policies attain at most by the opposite task, also where nothing is lost and the end is known anyway.

    Where something is lost, this is the column before.
    """
    if certificate_of(row).gap is None:
        return own_upper_end(row, folder)
    bare = with_claims(certificate_of(row), lambda one: changed(one, gap=None))
    return ended(bound_above(bare), folder)


def checked(row: str, folder: Path) -> Claims:
    report = cg.check(certificate_of(row))
    assert report, report.failures
    return Claims((report.recomputed,))


def rigorous(row: str, folder: Path) -> Claims:
    report = check_rigorous(certificate_of(row))
    assert report and report.numbers >= 10, report  # nothing is proved by a check that states nothing
    return Claims((float(report.low),))


def shield(row: str, folder: Path) -> Claims:
    """Random inputs behind a shield: as good as was promised, by rollouts."""
    certificate = certificate_of(row)
    promised = 0.8 * certificate.lower_bound
    policy = cg.shield(RandomController(), certificate, probability=promised)
    report = cg.compare(certificate.problem, {"shielded": policy}, EPISODES, confidence=1.0 - FALSE_ALARM)
    assert report.entries[0].ci_high >= promised
    return Claims((promised,))


def certified_policy(row: str, folder: Path) -> Claims:
    """A policy of the user's own, on the cells of the relation: inputs towards the goal."""
    problem, options = problem_of(row), searched(row, value="auto")
    policy = {agent.name: constantly(0.4 * agent.input_high) for agent in problem.agents}
    result = cg.certify(problem, policy, **options)
    assert cg.check(result.certificate)
    return Claims((result.certificate.lower_bound,))


def constantly(u: NDArray[Any]) -> Callable[..., NDArray[Any]]:
    """A policy that applies one input."""
    return lambda x, q, time: u


def network(row: str, folder: Path) -> Claims:
    """A network, certified as it is on cells."""
    problem = problem_of(row)
    view = SharedView(problem)
    rng = np.random.default_rng(0)
    first = 0.2 * rng.normal(size=(4, view.size)).astype(np.float32)
    last = np.full((view.n_actions, 4), 0.2, dtype=np.float32)
    layers = Network((first, last), (np.full(4, 0.5, np.float32), np.zeros(view.n_actions, np.float32)), "tanh", False)
    # A network of a problem along a path is on cells like any other.
    result = cg.certify(problem, SharedActor(problem, layers), ROWS[row].cells or 24)
    assert cg.check(result.certificate)
    return Claims((result.certificate.lower_bound,))


def elsewhere(row: str, folder: Path) -> Claims:
    """The bound at other starts."""
    certificate = certificate_of(row)
    start = initial_state(certificate.problem)
    values = certificate.at(np.stack([start, start + 0.1]))
    assert abs(values[0] - certificate.lower_bound) < 1e-3
    return Claims((float(values[1]),), start=start + 0.1)


def values_in_time(row: str, folder: Path) -> Claims:
    """The bound in the middle of a run."""
    certificate = certificate_of(row)
    value = cg.value_in_time(certificate)
    start = initial_state(certificate.problem)[None]
    q = np.array([certificate.problem.initial_q])
    left = certificate.problem.horizon
    return Claims(tuple(float(value.at(start, q, np.array([n]))[0]) for n in (left, left - 1)))


def audit(row: str, folder: Path) -> Claims:
    assert not cg.audit(certificate_of(row), EPISODES, confidence=1.0 - FALSE_ALARM).refuted
    return Claims()


def fields(row: str, folder: Path) -> Claims:
    certificate = certificate_of(row)
    start = initial_state(certificate.problem)
    report = cg.validate_field(certificate, np.stack([start, start + 0.1]), 200, confidence=1.0 - FALSE_ALARM)
    assert report.verdict != "refuted"
    return Claims()


def stressed(row: str, folder: Path) -> Claims:
    assert cg.stress(certificate_of(row), EPISODES)
    return Claims()


def compared(row: str, folder: Path) -> Claims:
    certificate = certificate_of(row)
    report = cg.compare(certificate.problem, {"certified": certificate.controller}, EPISODES)
    assert report.entries[0].ci_high >= certificate.lower_bound
    return Claims()


def start_box(row: str, folder: Path) -> Claims:
    """A start that is drawn from a box."""
    problem = problem_of(row)
    low = {a.name: (a.initial.low - 0.1).tolist() for a in problem.agents}
    high = {a.name: np.minimum(a.initial.high + 0.1, a.state_high).tolist() for a in problem.agents}
    result = cg.synthesize(problem.replace(initial_low=low, initial_high=high), **ROWS[row].settings)
    assert cg.check(result.certificate)
    return Claims((result.certificate.lower_bound,))


def no_deadline(row: str, folder: Path) -> Claims:
    options = {**ROWS[row].settings}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(horizons, "LONGEST", 4)
        result = cg.synthesize(problem_of(row), options.pop("cells", None), horizon=None, **options)
    assert cg.check(result.certificate)
    return Claims(exceeded_by_none=(1.0,))


def safety(row: str, folder: Path) -> Claims:
    """The rate at which safety is lost, for a certificate of it."""
    problem = problem_of(row)
    formula = "G !hole" if "hole" in problem.propositions else "G !near"
    same = cg.Problem(
        name="safe", horizon=4, agents=problem.agents, propositions=problem.propositions,
        specification=cg.Specification(formula, "finite-trace"),
    )  # fmt: skip
    rate = cg.safety_rate(cg.synthesize(same, **searched(row, stationary=True)).certificate)
    assert 0.0 <= rate.rate <= 1.0
    return Claims()


def begun(row: str, folder: Path) -> Claims:
    """A search that begins with the policies of a certificate."""
    options = {k: v for k, v in ROWS[row].settings.items() if k not in ("cells", "relation")}
    result = cg.synthesize(problem_of(row), start=certificate_of(row), **options)
    assert result.certificate.lower_bound >= certificate_of(row).lower_bound - 1e-9
    return Claims((result.certificate.lower_bound,))


def reported(row: str, folder: Path) -> Claims:
    cg.report(certificate_of(row), folder / "page.html", EPISODES)
    assert "<svg" in (folder / "page.html").read_text(encoding="utf-8")
    return Claims()


def kept(row: str, folder: Path) -> Claims:
    """Saved, loaded, and checked."""
    cg.save(certificate_of(row), folder / "certificate.npz")
    loaded: Any = certificate_from(folder / "certificate.npz")
    assert loaded.lower_bound == certificate_of(row).lower_bound and cg.check(loaded)
    return Claims((loaded.lower_bound,))


COLUMNS: dict[str, Callable[[str, Path], Claims]] = {
    "tree": tree, "train": train, "own upper end": own_upper_end, "opposite end": opposite_end, "check": checked,
    "rigorous": rigorous, "shield": shield, "certify": certified_policy, "network": network,
    "at": elsewhere, "values in time": values_in_time, "audit": audit, "field": fields, "stress": stressed,
    "compare": compared, "start box": start_box, "no deadline": no_deadline, "safety rate": safety,
    "start=": begun, "report": reported, "file": kept,
}  # fmt: skip
