"""Noise that is larger in some places, and states without any: simulated as declared, certified from below, checked."""

from __future__ import annotations

import dataclasses
import json
import pickle
from typing import Any

import numpy as np
import pytest
import scipy.stats
from numpy.typing import NDArray

import certigym as cg
from certigym.envs.simulation import Dynamics, SingleSimulator
from certigym.envs.simulation import batch_simulator as core
from certigym.envs.systems.distributions import Law
from certigym.envs.systems.distributions.noise import laws_of
from certigym.envs.tasks.problem import problem_from_dict
from certigym.synthesis.abstraction.kernels import box_kernel
from certigym.synthesis.abstraction.models import box_choices
from certigym.synthesis.certificates.cell_probabilities import scale_charge
from certigym.synthesis.certificates.proofs import changed, value_of
from certigym.synthesis.certificates.value_functions import Terms
from certigym.synthesis.extended_check.claims.regrown_tree import regrow
from certigym.synthesis.extended_check.steps import boxes_check
from certigym.synthesis.relations.grids import CellAxis, MeanAxis, RelationRefused, ScaleAxis, lattice_axes
from certigym.synthesis.relations.kinds import BoxRelation, MeanBoxes
from kinds import mostly_thorough

GAUSSIAN = {"law": "gaussian", "std": 1.0}

LAWS: list[dict[str, Any]] = [
    GAUSSIAN,
    {"law": "laplace", "scale": 0.7},
    {"law": "uniform", "low": -1.0, "high": 1.5},
    {"law": "uniform", "low": 0.5, "high": 1.5},
    {"law": "triangular", "low": -1.0, "mode": 0.2, "high": 1.5},
    {"law": "logistic", "scale": 0.5},
    {"law": "student-t", "scale": 0.7, "df": 5.0},
    {"law": "truncated-gaussian", "spread": 1.0, "low": -1.5, "high": 2.0},
    {"law": "mixture", "parts": [{"weight": 0.5, "mean": -0.4, **GAUSSIAN}, {"weight": 0.5, "mean": 0.4, **GAUSSIAN}]},
]


def walker(law: Any = GAUSSIAN, scale: str = "0.1 + 0.05*abs(x)", **changes: Any) -> cg.Agent:
    """A state with noise that grows away from 0, and a clock without any."""
    keys: dict[str, Any] = {
        "name": "walker",
        "states": ["x", "clock"],
        "inputs": ["u"],
        "dynamics": ["x + 0.4*u", "clock + 0.11"],
        "noise": [law, {"law": "gaussian", "std": 0.0}],
        "noise_scale": [scale, "1"],
        "state_low": [-2.0, 0.0],
        "state_high": [2.0, 1.0],
        "input_low": [-1.0],
        "input_high": [1.0],
        "initial_state": [1.2, 0.05],
    }
    return cg.Agent(**{**keys, **changes})


def task(
    agent: cg.Agent, formula: str = "F goal", horizon: int = 6, clock: tuple[float, float] = (0.45, 0.85)
) -> cg.Problem:
    """Be near 0 while the clock stands between two numbers."""
    return cg.Problem(
        name="uneven",
        horizon=horizon,
        agents=[agent],
        propositions={"goal": cg.Proposition("walker", [-0.3, clock[0]], [0.3, clock[1]])},
        specification=cg.Specification(formula, "co-safe"),
    )


def drifter(**changes: Any) -> cg.LinearAgent:
    """Matrices: the position has no noise of its own, the velocity has."""
    keys: dict[str, Any] = {
        "name": "walker",
        "A": [[1.0, 0.2], [0.0, 0.9]],
        "B": [[0.0], [0.5]],
        "noise_covariance": [[0.0, 0.0], [0.0, 0.01]],
        "state_low": [-2.0, -1.5],
        "state_high": [2.0, 1.5],
        "input_low": [-1.0],
        "input_high": [1.0],
        "initial_state": [-1.0, 0.0],
    }
    return cg.LinearAgent(**{**keys, **changes})


def docking() -> cg.Problem:
    return cg.Problem(
        name="docking",
        horizon=12,
        agents=[drifter()],
        propositions={"goal": cg.Proposition("walker", [-0.4, -0.5], [0.4, 0.5])},
        specification=cg.Specification("F goal", "co-safe"),
    )


# ---------------------------------------------------------------- declared, kept and simulated


def test_axes_of_lattices_say_what_they_stand_for() -> None:
    assert lattice_axes(walker()) == (ScaleAxis(0), MeanAxis(0), CellAxis(1))
    assert lattice_axes(drifter()) == (CellAxis(0), MeanAxis(1))
    assert lattice_axes(walker(scale="1")) == (MeanAxis(0), CellAxis(1))


def test_agents_keep_their_scales() -> None:
    agent = walker(parameters={"growth": 0.05}, scale="0.1 + growth*abs(x)")
    again = cg.Agent(**agent.to_dict())
    assert again.noise_scale == agent.noise_scale and again.laws == agent.laws
    assert again.motion_key == agent.motion_key != walker().motion_key
    louder = agent.with_noise_times(2.0)
    assert louder.noise_scale == agent.noise_scale and louder.laws is not None and louder.laws[0].std == 2.0
    assert agent.replace(noise=[GAUSSIAN, GAUSSIAN]).noise_scale is None
    assert "times 0.1 + growth*abs(x), 1" in repr(agent)
    problem = task(agent)
    read = problem_from_dict(json.loads(json.dumps(problem.to_dict())))
    assert read.fingerprint == problem.fingerprint != task(walker()).fingerprint
    assert pickle.loads(pickle.dumps(agent)).noise_scale == agent.noise_scale


def test_one_world_and_many_give_the_same_bits() -> None:
    """With a scale of state, input and disturbance; and the noise has the size that is declared."""
    agent = walker(scale="0.1 + 0.05*abs(x) + 0.02*u + wind", disturbances={"wind": [0.0, 0.05]})
    dynamics = Dynamics.of(task(agent), "random")
    worlds, rng = core.initial(dynamics, np.random.default_rng(1), 5), np.random.default_rng(2)
    normals, inputs = core.noise(dynamics, rng, 5), (np.linspace(-1, 1, 5).reshape(1, 1, 5),)
    after = core.transition(dynamics, worlds, inputs, normals)
    single = SingleSimulator.of(dynamics)
    for k in range(5):
        one = core.initial(dynamics, np.random.default_rng(1), 1)
        drawn = [float(z) for block in normals for z in block[..., k].ravel()]
        world = single.step(single.begin(one), [[float(inputs[0][0, 0, k])]], drawn)
        assert world.states[0] == after.states[0][:, 0, k].tolist()
    many = np.random.default_rng(3).standard_normal((2, 1, 200_000))
    calm = Dynamics.of(task(walker()))
    crowd = core.initial(calm, np.random.default_rng(1), 200_000)
    moved = core.transition(calm, crowd, (np.zeros((1, 1, 200_000)),), (many,)).states[0][:, 0]
    # A variance of 200,000 numbers is off by more than 5 of its deviations, .3 %, once in a million times.
    assert np.std(moved[0]) == pytest.approx(0.1 + 0.05 * 1.2, rel=0.01)
    assert np.all(moved[1] == 0.05 + 0.11)


# ---------------------------------------------------------------- certified from below


@pytest.mark.parametrize("entry", LAWS, ids=[f"{n}-{law['law']}" for n, law in enumerate(LAWS)])
def test_between_two_scales_interpolation_adds_no_more_than_the_charge(entry: dict[str, Any]) -> None:
    """Over random sets of arrival, whose expectation is known; and search and check charge alike."""
    [law] = laws_of([entry], 1)
    rng, largest, step = np.random.default_rng(5), 0.0, 0.05
    for _ in range(400):
        edges = np.sort(rng.normal(0.0, 2.0, 2 * int(rng.integers(1, 4))))
        base, share, mean = float(rng.uniform(-1, 1)), float(rng.uniform(0, 1)), float(rng.uniform(-1, 1))

        def within(level: float, edges: NDArray = edges, mean: float = mean) -> float:
            below = law.tails((edges - mean) / np.exp(level))[0]
            return float(np.sum(below[1::2] - below[::2]))

        middle = within(base + share * step)
        largest = max(largest, (1 - share) * within(base) + share * within(base + step) - middle)
    assert 0.003 * law.scale_charge(step) < largest <= law.scale_charge(step)
    assert scale_charge(law, step) == pytest.approx(law.scale_charge(step), rel=1e-4)
    assert law.scale_charge(law.scale_step(1e-4)) == pytest.approx(1e-4, rel=1e-6)


@mostly_thorough(
    "problem, cells, least",
    [
        (task(walker()), [40, 40], 0.85),
        (task(walker(scale="0.15 + 0.05*u")), [40, 40], 0.8),
        (task(walker(LAWS[1])), [40, 40], 0.8),
        (docking(), [80, 40], 0.8),
    ],
    ids=["scale of the state", "scale of the input", "laplace", "drifter"],
)
def test_values_are_below_the_expectation_of_the_next_ones(problem: cg.Problem, cells: list[int], least: float) -> None:
    """One step at a time, at random states under the certificate's controller, with scipy's distribution functions."""
    certificate = cg.synthesize(problem, cells, relation="boxes").certificate
    assert cg.check(certificate) and certificate.lower_bound > least
    part, agent, automaton = certificate.proof.agents[0], problem.agents[0], problem.automaton
    values: dict[int, Terms] = {}
    regrow(certificate, values.__setitem__)
    rng, tight = np.random.default_rng(3), 0.0
    states = rng.uniform(agent.workspace.low, agent.workspace.high, size=(200, 2))
    states[0] = agent.initial.low
    own, centres = part.grid.cell_of(states.T), part.grid.centres
    [undecided] = np.flatnonzero(~automaton.finished).tolist()
    goal = np.all((problem.propositions["goal"].low <= centres) & (centres < problem.propositions["goal"].high), axis=1)
    for t in range(problem.horizon):
        last = t + 1 == problem.horizon
        later = np.zeros(part.grid.n_cells) if last else worth(values[t + 1], undecided)
        following = np.where(goal, 1.0, later).reshape(part.grid.shape)
        now = worth(value_of(certificate) if t == 0 else values[t], undecided)
        inputs, _ = certificate.controller.agents[0].act(states.T[:, None], np.full(200, undecided), t, None)
        expected = expectation(agent, part.grid.edges, following, states, inputs[:, 0].T)
        assert np.all(now[own] <= expected + 1e-12)
        tight = max(tight, float(np.max(now[own] / np.maximum(expected, 1e-9))))
    assert tight > 0.97


def worth(terms: Any, q: int) -> NDArray:
    """Values of the cells in an automaton state."""
    return np.asarray(terms.factors[0][terms.index[q][:, 0]].sum(axis=0))


def expectation(agent: Any, edges: Any, following: NDArray, states: NDArray, inputs: NDArray) -> NDArray:
    """Expected values (M,) of values of cells, one step after states (M, 2) under inputs (M, 1)."""
    means = agent.mean(states.T, inputs.T).T
    scales = np.ones_like(states) if agent.noise_scale is None else agent.scales(states.T, inputs.T).T
    laws = {"gaussian": scipy.stats.norm(), "laplace": scipy.stats.laplace(scale=0.7)}
    tables = []
    for k, own in enumerate(edges):
        if agent.still_axes[k]:
            cell = np.searchsorted(own, means[:, k], side="right") - 1
            tables.append((cell[:, None] == np.arange(len(own) - 1)).astype(float))
            continue
        law = scipy.stats.norm(scale=0.1) if agent.laws is None else laws[agent.laws[k].name]
        tables.append(np.diff(law.cdf((own - means[:, k, None]) / scales[:, k, None]), axis=1))
    return np.einsum("ma,mb,ab->m", *tables, following)


@mostly_thorough("entry", LAWS, ids=[f"{n}-{law['law']}" for n, law in enumerate(LAWS)])
def test_certificates_are_valid_and_below_rollouts(entry: dict[str, Any]) -> None:
    """False alarm 1e-6, all tests together."""
    problem = task(walker(entry))
    # Noise that always blows one way leaves few inputs to coarse cells.
    cells = [40 if entry["law"] == "uniform" else 20, 20]
    certificate = cg.synthesize(problem, cells, relation="boxes").certificate
    report = cg.check(certificate, problem)
    assert report.valid, report.failures
    assert certificate.lower_bound > 0.1
    verdict = cg.validate(certificate, 20_000, seed=3, confidence=1.0 - 1e-6 / len(LAWS))
    assert verdict.verdict != "refuted"


def test_nothing_moves_without_noise() -> None:
    """A single state without noise: what is certain is certified to be."""
    still = cg.Agent(
        name="walker", states=["x"], inputs=["u"], dynamics=["0.9*x + 0.3*u"], noise_covariance=[[0.0]],
        state_low=[-2.0], state_high=[2.0], input_low=[-1.0], input_high=[1.0], initial_state=[1.5],
    )  # fmt: skip
    problem = cg.Problem(
        name="still", horizon=6, agents=[still], propositions={"goal": cg.Proposition("walker", [-0.2], [0.2])},
        specification=cg.Specification("F goal", "co-safe"),
    )  # fmt: skip
    certificate = cg.synthesize(problem, 100).certificate
    assert cg.check(certificate) and 1.0 - 1e-6 < certificate.lower_bound <= 1.0
    # The face of the workspace belongs to the last cell, and to regions that reach it: what is capped there stays.
    late = cg.Problem(
        name="capped", horizon=1, agents=[still.replace(dynamics=["min(x + 0.5, 2.0)"], initial_state=[1.6])],
        propositions={"goal": cg.Proposition("walker", [1.5], [2.0])},
        specification=cg.Specification("X goal", "co-safe"),
    )  # fmt: skip
    landed = cg.synthesize(late, 40).certificate
    assert cg.check(landed) and landed.lower_bound > 1.0 - 1e-6 and cg.validate(landed, 10).estimate == 1.0
    beyond = cg.Problem(
        name="beyond", horizon=1, agents=[still.replace(dynamics=["min(x + 0.5, 2.001)"], initial_state=[1.6])],
        propositions=late.declared, specification=late.specification,
    )  # fmt: skip
    assert cg.synthesize(beyond, 40).certificate.lower_bound == 0.0


@pytest.mark.parametrize("relation", ["exact", "linear", "paper"])
def test_other_relations_refuse_such_noise_in_words(relation: str) -> None:
    for problem in (task(walker()), docking()):
        with pytest.raises(RelationRefused, match="ask for `boxes`"):
            cg.synthesize(problem, 40, relation=relation)


def test_noise_too_small_to_be_squared_is_refused() -> None:
    """Its variance is 0 in floating point; a state next to an edge may cross it all the same."""
    with pytest.raises(ValueError, match="expected a std of at least 1e-100"):
        walker(noise=[GAUSSIAN, {"law": "gaussian", "std": 1e-170}])
    assert not np.any(walker(noise=[GAUSSIAN, {"law": "gaussian", "std": 1e-90}]).still_axes)


def test_pairs_by_subtraction_refuse_such_noise() -> None:
    """Masses of nearness are computed from covariances, which say nothing of scales."""
    agents = tuple(walker(name=name) for name in ("left", "right"))
    near = cg.Pair(agents=["left", "right"], low=[-0.1, -0.1], high=[0.1, 0.1])
    problem = cg.Problem(
        name="apart", horizon=3, agents=agents,
        propositions={"near": near, "goal": cg.Proposition("left", [-0.3, 0.0], [0.3, 1.0])},
        specification=cg.Specification("!near U (goal & !near)", "co-safe"),
    )  # fmt: skip
    with pytest.raises(RelationRefused):
        cg.synthesize(problem, 20)


@pytest.mark.thorough
def test_scales_that_may_vanish_are_worth_nothing() -> None:
    """A cell in which the scale is not seen to be positive has no choice; elsewhere nothing changes."""
    certificate = cg.synthesize(task(walker(scale="0.05 + 0.1*x")), [24, 24], relation="boxes").certificate
    part = certificate.proof.agents[0]
    unknown = part.grid.low[:, 0] < -0.5
    assert cg.check(certificate) and np.all(part.policy[:, :, unknown] < 0) and np.any(part.policy >= 0)
    with pytest.raises(RelationRefused, match="no cell is seen to have a positive `noise_scale`"):
        cg.synthesize(task(walker(scale="-0.1")), [40, 40], relation="boxes")


# ---------------------------------------------------------------- sabotage, seen by the check

SCALES, PLACED, CELLS = BoxRelation.scales, box_choices.positions, box_choices.cells_at


def quieter(relation: BoxRelation, low: NDArray, high: NDArray) -> Any:
    found = SCALES(relation, low, high)
    return None if found is None else (0.99 * found[0], 0.99 * found[1])


def narrower(relation: BoxRelation, low: NDArray, high: NDArray) -> Any:
    found = SCALES(relation, low, high)
    return None if found is None else (0.5 * (found[0] + found[1]),) * 2


def one_cell_only(means: NDArray, edges: NDArray, side: int) -> NDArray:
    """The cell of the lower end alone, wherever the upper one is."""
    return CELLS(means, edges, 0) if side == 0 else CELLS(means - 0.999 * np.diff(edges).max(), edges, 0)


def on_the_face(means: NDArray, edges: NDArray, side: int) -> NDArray:
    """What leaves the workspace stays in the outermost cell."""
    return np.clip(CELLS(means, edges, side), 1, len(edges) - 1)


SABOTAGE: dict[str, tuple[Any, str, Any]] = {
    "noise smaller by one per cent": (BoxRelation, "scales", quieter),
    "the scale at the middle of the cell alone": (BoxRelation, "scales", narrower),
    "charges of scales left out": (Law, "scale_charge", lambda law, step: 0.0),
    "one cell instead of all that are touched": (box_choices, "cells_at", one_cell_only),
    "leaving is staying": (box_choices, "cells_at", on_the_face),
}


@mostly_thorough("sabotage", SABOTAGE)
def test_the_check_refuses_what_a_wrong_search_claims(sabotage: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = task(walker(LAWS[5] if "charges" in sabotage else GAUSSIAN))
    if (
        "one cell" in sabotage
    ):  # one tick of the clock falls into the time of the goal; its cells are known to within two
        problem = task(walker(dynamics=["x + 0.4*u", "clock + 0.13"]), clock=(0.5, 0.6))
    if "staying" in sabotage:  # the clock is over before the goal is reached
        problem = task(walker(dynamics=["x + 0.1*u", "clock + 0.11"]), horizon=16, clock=(0.45, 1.0))
    assert cg.check(cg.synthesize(problem, [30, 30], relation="boxes").certificate)
    with monkeypatch.context() as patch:
        patch.setattr(*SABOTAGE[sabotage])
        broken = cg.synthesize(problem, [30, 30], relation="boxes").certificate
    assert not cg.check(broken, problem)


def test_forged_lattices_are_refused() -> None:
    """Cells that are numbered otherwise; scales that stop short of the largest one; relations that are not for it."""
    certificate = cg.synthesize(task(walker()), [24, 24], relation="boxes").certificate
    (part,) = certificate.proof.agents
    levels, means, numbers = part.lattice
    shifted = dataclasses.replace(part, lattice=(levels, means, numbers + 1.0))
    assert "does not number the cells" in str(cg.check(changed(certificate, agents=(shifted,))).failures)
    quiet = dataclasses.replace(part, lattice=(levels - 0.5, means, numbers))
    assert not cg.check(changed(certificate, agents=(quiet,)))
    # The same policies and lattice for an agent that is louder than the one that was certified.
    louder = task(walker(scale="0.102 + 0.051*abs(x)"))
    assert not cg.check(dataclasses.replace(certificate, problem=louder))


@mostly_thorough("side", [0, 1])
def test_boxes_with_an_end_that_is_not_known_are_worth_nothing(side: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where only one end of the mean of a state without noise is no number."""
    certificate = cg.synthesize(task(walker()), [24, 24], relation="boxes").certificate
    honest = boxes_check.enclosed_means

    def half_known(*of: Any, **more: Any) -> tuple[NDArray, NDArray]:
        ends = [end.copy() for end in honest(*of, **more)]
        ends[side][:, 1] = np.nan
        return ends[0], ends[1]

    assert cg.check(certificate)
    monkeypatch.setattr(boxes_check, "enclosed_means", half_known)
    assert cg.check(certificate).recomputed == 0.0


def test_the_check_makes_its_own_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums of masses are those of the search, to rounding, though none of its code is used."""
    certificate = cg.synthesize(task(walker()), [24, 24], relation="boxes").certificate
    (part,), (agent,) = certificate.proof.agents, certificate.problem.agents
    mine = boxes_check.axis_tables(agent, part, {})
    theirs = box_kernel.box_kernel_of(part.grid, part.lattice, agent.laws, lattice_axes(agent))  # type: ignore[arg-type]
    for table, other in zip(mine, theirs.tables, strict=True):
        np.testing.assert_allclose(table, other.toarray(), atol=1e-13)
    assert MeanBoxes.__dataclass_fields__["scales"].default is None


@mostly_thorough("law", [LAWS[0], LAWS[1], LAWS[2]], ids=lambda law: law["law"])
@mostly_thorough("scale", ["1", "2/2", "p", "exp(0)"])
def test_a_scale_of_one_is_no_scale(law: dict[str, Any], scale: str) -> None:
    """However it is written: search and check charge nothing for what does not vary, and agree on it."""
    keys: dict[str, Any] = {
        "name": "one", "states": ["x"], "inputs": ["u"], "dynamics": ["0.9*x + 0.1*sin(x) + u"], "state_low": [-6.0],
        "state_high": [6.0], "input_low": [-2.5], "input_high": [2.5], "initial_state": [-4.0], "noise": [law],
        "parameters": {"p": 1.0},
    }  # fmt: skip
    plain, scaled = cg.Agent(**keys), cg.Agent(**keys, noise_scale=[scale])
    assert scaled.noise_scale is None and scaled.has_plain_noise and scaled.to_dict() == plain.to_dict()
    if scale != "2/2":  # the same agent is certified alike
        return
    problem = cg.Problem(
        name="one", agents=[scaled], propositions={"goal": cg.Proposition("one", [2.0], [6.0])}, horizon=5,
        specification=cg.Specification("F goal", "co-safe"),
    )  # fmt: skip
    certificate = cg.synthesize(problem, 40, relation="boxes").certificate
    assert certificate.lower_bound > 0.5 and cg.check(certificate, problem)


def test_scales_of_one_beside_others_have_no_axis() -> None:
    agent = walker(noise=[GAUSSIAN, {"law": "gaussian", "std": 0.1}], noise_scale=["0.1 + 0.05*abs(x)", "2/2"])
    assert lattice_axes(agent) == (ScaleAxis(0), MeanAxis(0), MeanAxis(1))
    with pytest.raises(ValueError, match="expected beside `noise`"):
        walker(noise=None, noise_covariance=np.eye(2), noise_scale=["1", "1"])
