"""Certificates in which inputs that move several agents depend on automaton state and time alone are below the truth,
and the check refuses what claims that and is not so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

import certigym as cg
from boiler_problems import boiler, boiler_problem, room
from certigym.envs.simulation import Dynamics, batch_simulator
from certigym.envs.tasks.problem.problem_file import problem_from_toml
from certigym.synthesis.abstraction.models import JointModel, join, start_of
from certigym.synthesis.certificates.proofs import GridProof, OnGrid, changed
from certigym.synthesis.extended_check.shields import shield_of
from certigym.synthesis.policy_search.ascent import Search, find_policies
from certigym.synthesis.policy_search.ascent.relaxation import relax
from certigym.synthesis.relations.kinds import CommonInputs
from certigym.synthesis.verbs.abstract import abstract
from kinds import mostly_thorough

FALSE_ALARM = 1e-6
"""Probability that a true claim is refuted here; the seeds are fixed."""

EXAMPLE = Path(__file__).parents[2] / "examples" / "boiler_and_zones.toml"


def switching(n: int = 2, horizon: int = 8) -> cg.Problem:
    """Rooms that are to get warm and then cold again, all of them at the same time."""
    names = [f"{word}_{i}" for word in ("warm", "cold") for i in range(n)]
    regions = {
        name: cg.Proposition(f"room_{name[-1]}", *([20], [23]) if name[0] == "w" else ([17], [19])) for name in names
    }
    every = {word: " & ".join(f"{word}_{i}" for i in range(n)) for word in ("warm", "cold")}
    return cg.Problem(
        name="switching",
        horizon=horizon,
        agents=[boiler(), *(room(i, initial_state=[19.5]) for i in range(n))],
        propositions={**regions, "cool": cg.Proposition("boiler", [0.0], [70.0])},
        specification=cg.Specification(f"F ({every['warm']} & F ({every['cold']})) & G cool", "finite-trace"),
    )


def certified(problem: cg.Problem, cells: Any = 24, **options: Any) -> OnGrid:
    certificate = cg.synthesize(
        problem, cells=cells, relation="boxes", search=cg.SearchOptions(common=True, **options)
    ).certificate
    assert isinstance(certificate.proof, GridProof)
    return certificate


@pytest.fixture(scope="module")
def boiled() -> OnGrid:
    return certified(boiler_problem(2))


def numbers_of(certificate: OnGrid) -> np.ndarray:
    """The heat (T, Q) that the boiler applies."""
    part = certificate.proof.agents[0]
    return np.array(part.relation["menu"])[part.policy.max(axis=2), 0]


# The bound is below the truth.


@pytest.mark.thorough
def test_the_bound_is_below_the_truth_which_is_a_product_here() -> None:
    """With one undecided automaton state the heat is a sequence: given it, agents are independent chains.

    Their probabilities are integrated by the midpoint rule on 2000 points per agent, which is off by less than 1e-4.
    """
    problem = boiler_problem(2, horizon=4)
    certificate = certified(problem, 16)
    q = int(problem.automaton.next_state(np.asarray(problem.automaton.initial), np.array([True, True, True])))
    truth = 1.0
    for i, agent in enumerate(problem.agents):
        assert isinstance(agent, cg.Agent)
        low, high = (0.0, 60.0) if i == 0 else (18.0, 21.5)
        std = float(np.sqrt(agent.noise_covariance[0, 0]))
        points = low + (high - low) * (np.arange(2000) + 0.5) / 2000
        value, controller = np.ones(2000), certificate.controller.agents[i]
        for t in reversed(range(problem.horizon)):
            at = points if t else np.asarray(agent.initial.low)
            inputs = controller.act(at[None, None], np.array([q] * len(at)), t, None)[0][:, 0]
            heat = np.full((1, len(at)), numbers_of(certificate)[t, q])
            means = agent.mean(at[None], inputs, None, heat if i else None)[0]
            edges = low + (high - low) * np.arange(2001) / 2000
            masses = np.diff(ndtr((edges[None] - means[:, None]) / std), axis=1)
            value = masses @ value
        truth *= float(value[0])
    assert certificate.lower_bound <= truth + 1e-4
    assert certificate.lower_bound >= truth - 0.05


def sequences_of(problem: cg.Problem, joint: JointModel) -> dict[tuple[int, ...], float]:
    """The best value at the start for every sequence of numbers of the one group: a program of each agent alone."""
    (group,), start = joint.common, start_of(problem, joint)
    assert int((~joint.absorbing).sum()) == 1
    values = {}
    inside = [np.any(mask, axis=0) for mask in joint.masks]
    for sequence in product(range(len(group.numbers)), repeat=joint.horizon):
        total = 1.0
        for i, model in enumerate(joint.models):
            value = np.ones((1, model.n_cells))
            for number in reversed(sequence):
                choices = model.choices.parts[group.parts[i][number]]
                table = model.kernel.backup(value * inside[i])
                best = choices.best(np.ones((1, 1)), table, np.full(model.n_cells, -1, dtype=np.int32))
                value = choices.read(table, best)
            total *= float(start.terms.factors[i][0] @ value[0])
        values[sequence] = total
    return values


@pytest.mark.thorough
def test_the_search_finds_the_best_sequence_of_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """All sequences of small problems are tried: no other is better by a hundredth, and mostly none is better at all.

    The ascent answers time by time, and may stay where no change at a single time helps.
    """
    monkeypatch.setattr("certigym.synthesis.abstraction.models.common_choices.INPUT_LEVELS", {1: 4})
    solved = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        start = {f"room_{i}": [float(rng.uniform(18.2, 21.2))] for i in range(2)}
        problem = boiler_problem(2, horizon=3).replace(initial_state=start)
        joint = join(problem, abstract(problem, 10, relation="boxes", search=cg.SearchOptions(common=True)))
        values = sequences_of(problem, joint)
        found = find_policies(problem, joint, Search(good_share=1.0)).best
        best = max(values.values())
        assert 0.99 * best <= found.value <= best * (1.0 + 1e-9)
        solved += found.value >= best * (1.0 - 1e-9)
        assert best > float(np.median([*values.values()])) + 0.05
    assert solved >= 3


@pytest.mark.thorough
def test_relaxations_are_above_what_any_number_attains() -> None:
    problem = boiler_problem(2, horizon=3)
    joint = join(problem, abstract(problem, 10, relation="boxes", search=cg.SearchOptions(common=True)))
    start, above = start_of(problem, joint), 1.0
    relaxations = relax(problem, joint)
    [q] = [q for q in range(joint.n_states) if not joint.absorbing[q] and len(start.terms.index[q])]
    for masses, relaxation in zip(start.terms.factors, relaxations, strict=True):
        above *= float(masses[0] @ relaxation.values[q])
    assert certified(problem, 10).lower_bound <= above


@pytest.mark.thorough
@pytest.mark.parametrize("problem", [boiler_problem(2), switching(1, 5)], ids=["stay", "switch"])
def test_rollouts_do_not_refute_the_bound(problem: cg.Problem) -> None:
    """20,000 rollouts of the continuous system; the heat follows the automaton state."""
    certificate = certified(problem, 20, max_sweeps=2)
    assert cg.check(certificate)
    report = cg.validate(certificate, 20_000, seed=0, confidence=1.0 - FALSE_ALARM)
    assert report.verdict != "refuted"
    assert certificate.lower_bound > 0.5
    if problem.automaton.n_states > 3:
        heat = numbers_of(certificate)
        assert np.any(heat[:, 1:] != heat[:, :1])


@pytest.mark.thorough
def test_rooms_may_have_noise_whose_scale_depends_on_their_state() -> None:
    problem = boiler_problem(1, noise_scale=["1 + 0.1*(warmth - 19)"])
    certificate = certified(problem, 16)
    assert cg.check(certificate) and certificate.lower_bound > 0.5
    assert cg.validate(certificate, 10_000, seed=2, confidence=1.0 - FALSE_ALARM).verdict != "refuted"


@pytest.mark.thorough
def test_the_example_holds_and_a_joint_agent_does_better() -> None:
    """A joint agent of both zones looks at both of them when it chooses the heat; five zones have no joint grid."""
    building = cg.load(EXAMPLE).replace(horizon=4)
    certificate = certified(building, 48)
    assert cg.check(certificate)
    five = with_zones(5).replace(horizon=3)
    assert five.n_states == 6
    more = certified(five, 32, max_sweeps=1)
    assert cg.check(more) and more.lower_bound > 0.5
    names = ("left", "right")
    joint = cg.Agent(
        name="zones",
        states=list(names),
        inputs=["heat", "left_valve", "right_valve"],
        dynamics=[f"{name} + 0.1*(12 - {name}) + 0.6*heat + {name}_valve" for name in names],
        noise=[{"law": "gaussian", "std": 0.25}] * 2,
        state_low=[16] * 2,
        state_high=[24] * 2,
        input_low=[0, -0.15, -0.15],
        input_high=[3, 0.15, 0.15],
        initial_state=[19.5] * 2,
    )
    problem = cg.Problem(
        name="zones",
        horizon=4,
        agents=[joint],
        propositions={"comfort": cg.Proposition("zones", [19.0] * 2, [21.0] * 2)},
        specification=cg.Specification("G comfort", "finite-trace"),
    )
    seen = cg.synthesize(problem, cells=48, relation="linear").certificate
    assert seen.lower_bound > certificate.lower_bound > 0.9


def with_zones(n: int) -> cg.Problem:
    """The problem of the example with n zones."""
    return problem_from_toml(EXAMPLE.read_text(encoding="utf-8").replace("copies = 2", f"copies = {n}"))


# What is stored, said and carried out.


def test_certificates_say_what_was_assumed_known(boiled: OnGrid, tmp_path: Any) -> None:
    assert "in common" in repr(boiled) and "boiler.heat" in repr(boiled)
    path = tmp_path / "boiled.cert"
    cg.save(boiled, path)
    again = cg.load(path)
    assert cg.check(again) and again.proof.agents[1].relation == boiled.proof.agents[1].relation
    assert set(boiled.proof.agents[1].relation["common"]) == {"names", "numbers"}


def test_controllers_act_alike_in_environments_and_batches(boiled: OnGrid) -> None:
    problem, controller = boiled.problem, boiled.controller
    env = cg.parallel_env(problem, actions="input")
    observations, infos = env.reset(seed=3)
    controller.reset(observations, infos)
    dynamics = Dynamics.of(problem)
    batch = controller.batch(dynamics)
    for time in range(problem.horizon):
        actions = controller.act(observations, infos)
        states = np.concatenate([infos[name]["state"] for name in problem.agent_names])[None]
        here = replace(batch_simulator.initial_at(dynamics, states), time=time)
        inputs, _ = batch.act(here, batch.begin(here, np.random.default_rng(0)))
        for i, name in enumerate(problem.agent_names):
            block, place = dynamics.position[i]
            assert inputs[block][:, place, 0].tolist() == actions[name].tolist()
        q = int(infos["boiler"]["automaton_state"])
        assert float(actions["boiler"][0]) == numbers_of(boiled)[time, q]
        observations, _, _, _, infos = env.step(actions)


@pytest.mark.thorough
def test_both_ways_are_tried_and_the_better_one_is_kept() -> None:
    """A boiler that has to look at its own state, and hardly matters to the room, is better left alone."""
    problem = boiler_problem(1)
    found = cg.synthesize(problem, cells=24)
    assert found.certificate.lower_bound == certified(problem).lower_bound
    assert "inputs of others in common" in found.stats["tried"]  # type: ignore[operator]
    runaway = boiler(dynamics=["1.5*water - 20 + 8*(heat - 1.5)"], initial_state=[40], input_low=[-3], input_high=[6])
    little = room(0, dynamics=["warmth + 0.1*(19.5 - warmth) + 0.001*boiler.heat + trim"])
    problem = cg.Problem(
        name="runaway",
        horizon=8,
        agents=[runaway, little],
        propositions={"comfort": cg.Proposition("room_0", [18.0], [21.5])},
        specification=cg.Specification("G comfort", "finite-trace"),
    )
    found = cg.synthesize(problem, cells=24)
    tried = found.stats["tried"]
    assert isinstance(tried, dict)
    assert tried["inputs of others unknown"] > tried["inputs of others in common"] + 0.1
    assert found.certificate.lower_bound == tried["inputs of others unknown"]
    assert all("common" not in part.relation for part in found.certificate.proof.agents)
    assert cg.check(found.certificate)


@pytest.mark.thorough
def test_unknown_inputs_count_as_disturbances() -> None:
    """Without a common choice the bound is the product of those of rooms that are disturbed by any heat."""
    problem = boiler_problem(2)
    whole = cg.synthesize(
        problem, cells=24, relation="boxes", search=cg.SearchOptions(common=False)
    ).certificate.lower_bound
    product_of_all = 1.0
    alone: list[Any] = [boiler()]
    for i in range(2):
        means = [f"warmth + {0.1 + 0.01 * i}*(12 - warmth) + 0.6*heat + trim"]
        alone.append(room(i, dynamics=means, disturbances={"heat": [0.0, 3.0]}))
    for agent in alone:
        low, high = ([0.0], [60.0]) if agent.name == "boiler" else ([18.0], [21.5])
        one = cg.Problem(
            name="one",
            horizon=5,
            agents=[agent],
            propositions={"fine": cg.Proposition(agent.name, low, high)},
            specification=cg.Specification("G fine", "finite-trace"),
        )
        product_of_all *= cg.synthesize(one, cells=24, relation="boxes").certificate.lower_bound
    assert 0.0 < whole == pytest.approx(product_of_all, rel=1e-6)


@pytest.mark.thorough
def test_policies_go_on_from_certificates_and_without_a_clock(boiled: OnGrid) -> None:
    longer = boiler_problem(2, horizon=6)
    for settings in ({"start": boiled}, {"search": cg.SearchOptions(stationary=True, common=True)}):
        certificate = cg.synthesize(longer, cells=24, relation="boxes", **settings).certificate
        assert cg.check(certificate) and certificate.lower_bound > 0.9
        assert "common" in certificate.proof.agents[0].relation
    assert certificate.proof.stationary


def test_what_knows_nothing_of_common_inputs_refuses_them(boiled: OnGrid) -> None:
    with pytest.raises(ValueError, match=r"chosen in common.*`common=False`"):
        shield_of(boiled, 0.5)
    with pytest.raises(ValueError, match="`common`"):
        cg.certify(boiled.problem, boiled.controller, 24, relation="boxes", search=cg.SearchOptions(common=True))
    with pytest.raises(ValueError, match="`common`"):
        cg.synthesize(boiled.problem, search=cg.SearchOptions(common="yes"))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="under the relation `boxes` alone"):
        cg.synthesize(
            boiler_problem(1),
            cells=24,
            relation={"boiler": "exact", "room_0": "boxes"},
            search=cg.SearchOptions(common=True),
        )


# Groups of other shapes.


def two_boilers() -> cg.Problem:
    """Boilers that know each other's heat, one of them with a fan of its own, and a room that both of them warm."""
    first = boiler(
        inputs=["heat", "fan"],
        dynamics=["0.6*water + 8*heat + 2*fan + 0.5*second.heat"],
        input_low=[0, -1],
        input_high=[3, 1],
    )
    second = boiler(name="second", dynamics=["0.5*water + 8*heat + 0.5*boiler.heat"], initial_state=[20])
    warm = room(0, dynamics=["warmth + 0.1*(12 - warmth) + 0.3*boiler.heat + 0.3*second.heat + trim"])
    apart = room(1, dynamics=["warmth + 0.1*(19 - warmth) + trim"])
    return cg.Problem(
        name="two boilers",
        horizon=3,
        agents=[warm, first, apart, second],
        propositions={
            "comfort": cg.Proposition("room_*", [18.0], [21.5]),
            "cool": cg.Proposition("boiler", [0.0], [60.0]),
        },
        specification=cg.Specification("G (all(comfort) & cool)", "finite-trace"),
    )


@pytest.mark.thorough
def test_groups_may_have_several_owners_and_inputs() -> None:
    problem = two_boilers()
    joint = join(problem, abstract(problem, 12, relation="boxes", search=cg.SearchOptions(common=True)))
    [group] = joint.common
    assert group.members == (0, 1, 3) and group.names == ("boiler.heat", "second.heat") and len(group.numbers) == 25
    certificate = certified(problem, 12)
    assert cg.check(certificate)
    assert cg.validate(certificate, 10_000, seed=1, confidence=1.0 - FALSE_ALARM).verdict != "refuted"
    # The fan is left to the boiler: it follows its own state, at least somewhere.
    part = certificate.proof.agents[1]
    used = np.array(part.relation["menu"])[part.policy]
    assert np.ptp(used[..., 0], axis=2).max() == 0.0 and np.ptp(used[..., 1], axis=2).max() > 0.0


@pytest.mark.thorough
def test_rooms_alike_beside_other_boilers_are_told_apart() -> None:
    """Equal rooms of equal boilers: their choices agree with their own boiler's, and these are two groups."""
    agents = [boiler(name=f"boiler_{k}") for k in range(2)]
    agents += [room(k, dynamics=[f"warmth + 0.1*(12 - warmth) + 0.6*boiler_{k}.heat + trim"]) for k in range(2)]
    problem = cg.Problem(
        name="pairs",
        horizon=4,
        agents=agents,
        propositions={"comfort": cg.Proposition("room_*", [18.0], [21.5])},
        specification=cg.Specification("G all(comfort)", "finite-trace"),
    )
    joint = join(problem, abstract(problem, 16, relation="boxes", search=cg.SearchOptions(common=True)))
    assert [group.members for group in joint.common] == [(0, 2), (1, 3)]
    assert cg.check(certified(problem, 16))


def test_too_many_numbers_are_refused() -> None:
    many = boiler(
        inputs=[f"heat_{k}" for k in range(5)],
        dynamics=["0.6*water + heat_0"],
        input_low=[0] * 5,
        input_high=[1] * 5,
    )
    means = "warmth + " + " + ".join(f"0.1*boiler.heat_{k}" for k in range(5))
    problem = cg.Problem(
        name="many",
        horizon=2,
        agents=[many, room(0, dynamics=[means])],
        propositions={"comfort": cg.Proposition("room_0", [17.0], [24.0])},
        specification=cg.Specification("G comfort", "finite-trace"),
    )
    with pytest.raises(ValueError, match="at most 128 numbers"):
        certified(problem)
    assert cg.check(cg.synthesize(problem, cells=16).certificate)


# Sabotage.


def with_part(certificate: OnGrid, i: int, **changes: Any) -> OnGrid:
    parts = list(certificate.proof.agents)
    parts[i] = replace(parts[i], **changes)
    return changed(certificate, agents=tuple(parts))


@pytest.mark.parametrize("i", [0, 1, 2])
def test_one_cell_with_another_number_is_refused(boiled: OnGrid, i: int) -> None:
    """In a single cell at a single time one agent counts with, or applies, the next number."""
    part = boiled.proof.agents[i]
    input_set = part.relation["menu"]
    length = len(input_set) // len(part.relation["common"]["numbers"])
    policy = part.policy.copy()
    t, q, cell = np.argwhere(policy >= 0)[len(policy) // 2]
    policy[t, q, cell] = (policy[t, q, cell] + length) % len(input_set)
    report = cg.check(with_part(boiled, i, policy=policy))
    assert not report and "not the same for all cells and agents" in str(report)


def test_another_menu_than_the_others_assume_is_refused(boiled: OnGrid) -> None:
    relation = boiled.proof.agents[0].relation
    scaled = {"menu": (0.9 * np.array(relation["menu"])).tolist()}
    report = cg.check(with_part(boiled, 0, relation={**relation, **scaled}))
    assert not report and "other inputs than those chosen in common" in str(report)
    numbers = {"names": ["boiler.heat"], "numbers": (0.9 * np.array(relation["common"]["numbers"])).tolist()}
    report = cg.check(with_part(boiled, 0, relation={**relation, **scaled, "common": numbers}))
    assert not report and "not the same for all cells and agents" in str(report)
    without = {name: value for name, value in relation.items() if name != "common"}
    report = cg.check(with_part(boiled, 0, relation={**without, **scaled}))
    assert not report and "not the same for all cells and agents" in str(report)
    assert cg.check(with_part(boiled, 0, relation=without))  # what the owner applies is in its menu


def test_owners_that_look_at_their_state_are_refused(boiled: OnGrid) -> None:
    """The boiler's part is that of a certificate without common choice, under boxes and under exact targets."""
    for relation in ("boxes", "exact"):
        kinds = {"boiler": relation, "room_0": "boxes", "room_1": "boxes"}
        other = cg.synthesize(
            boiled.problem, cells=24, relation=kinds, search=cg.SearchOptions(common=False)
        ).certificate
        mixed = changed(boiled, agents=(other.proof.agents[0], *boiled.proof.agents[1:]))
        report = cg.check(mixed)
        assert not report and "'boiler.heat' is said to be chosen in common" in str(report)


def test_unknown_names_are_refused(boiled: OnGrid) -> None:
    relation = boiled.proof.agents[1].relation
    for name in ("boiler.water", "nobody.heat", "room_1.trim"):
        numbers = {"names": [name], "numbers": relation["common"]["numbers"]}
        report = cg.check(with_part(boiled, 1, relation={**relation, "common": numbers}))
        assert not report and "no input that it names or owns" in str(report)


def _other_number(self: CommonInputs, agent: cg.Agent, number: int) -> dict[str, float]:
    known = KNOWN(self, agent, number)
    return {name: 0.5 * value + 0.5 for name, value in known.items()}


def _not_agreed(groups: Any, offered: Any, policies: Any) -> Any:
    return tuple(policies)


KNOWN = CommonInputs.known
BROKEN: dict[str, tuple[str, Callable[..., Any]]] = {
    "boxes of other numbers": ("certigym.synthesis.relations.kinds.common_means.CommonInputs.known", _other_number),
    "numbers by cell": (
        "certigym.synthesis.policy_search.ascent.coordinate_ascent.Stage._choose_number",
        lambda stage, group: None,
    ),
}


@mostly_thorough("name", BROKEN)
def test_broken_searches_are_caught(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = boiler_problem(2)
    with monkeypatch.context() as patch:
        patch.setattr(*BROKEN[name])
        if name == "numbers by cell":
            patch.setattr("certigym.synthesis.abstraction.models.joint.agreed", _not_agreed)
            patch.setattr(
                "certigym.synthesis.policy_search.ascent.coordinate_ascent.Stage._with_number",
                lambda stage, *_: stage.offered,
            )
        certificate = certified(problem)
        # By the broken rule itself nothing is wrong with the bound: it is the check's own code that refuses it.
    assert not cg.check(certificate)
