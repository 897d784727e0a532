"""Whoever leaves its workspace satisfies the opposite task, so that upper ends are near the truth where many leave."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom, norm

import certigym as cg
from certigym.baselines import RandomController
from certigym.envs.tasks.automata import Automaton
from certigym.envs.tasks.problem import complement_inside, complement_of
from certigym.synthesis.abstraction.models import JointModel, join, start_of, surrounded
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.extended_check.claims import wrong_complement
from certigym.synthesis.policy_search.ascent import FINAL, sweep
from certigym.synthesis.policy_search.cell_certificates.certification import certificate_of
from certigym.synthesis.relations.grids import CellLabels
from certigym.synthesis.verbs.upper_bounds import abstraction_again, bound_above, evaluated
from kinds import mostly_thorough
from problems import two_agents

FALSE_ALARM = 1e-6
"""Probability with which a statistical test here fails although all is right."""

TASKS = {
    "co-safe": ("F (a & F c) & G[0,2] !b", "co-safe"),
    "until": ("(!b | !c) U a", "co-safe"),
    "trace": ("G (b -> X d)", "finite-trace"),
    "reach": ("F a", "finite-trace"),
}
"""Formulas in which agents depend on each other, under both semantics."""


def at_the_edge(task: str) -> cg.Problem:
    """Two agents that start near the edge, with noise that is large: every second run leaves."""
    return two_agents(*TASKS[task], horizon=5, noise_covariance=[[2.0]], initial_state=[3.0])


@cache
def certified(task: str, relation: str) -> Any:
    """The controllers of a task, without any upper end."""
    options = cg.SearchOptions(epsilon=0.3, feedback=-0.8) if relation == "paper" else None
    return changed(cg.synthesize(at_the_edge(task), 30, relation=relation, search=options).certificate, gap=None)


@cache
def ended(task: str, relation: str) -> Any:
    return bound_above(certified(task, relation))


def dense(certificate: Any) -> float:
    """What policies attain that put their means where they say, by programming over all pairs of cells."""
    problem, parts = certificate.problem, certificate.proof.agents
    automaton, centres = problem.automaton, [part.grid.centres[:, 0] for part in parts]
    first, second = np.meshgrid(*centres, indexing="ij")
    letter = np.concatenate([problem.labeling.class_at(i, x[None]) for i, x in enumerate((first, second))])
    after = [automaton.next_state(np.full(first.shape, q), letter) for q in range(automaton.n_states)]
    values = [np.full(first.shape, float(accepted)) for accepted in automaton.accepting]
    for t in reversed(range(problem.horizon)):
        arriving = [np.choose(after[q], values) for q in range(len(values))]
        for q in np.flatnonzero(~automaton.absorbing).tolist():
            masses = []
            for agent, part in zip(problem.agents, parts, strict=True):
                means = part.lattice[0][part.points(t, q)]
                below = norm.cdf((part.grid.edges[0][None] - means[:, None]) / np.sqrt(agent.noise_covariance[0, 0]))
                masses.append(np.diff(below, axis=1))
            values[q] = masses[0] @ arriving[q] @ masses[1].T
    starts = [agent.initial.low for agent in problem.agents]
    q = int(automaton.next_state(automaton.initial, problem.labeling.letter(starts)))
    return float(values[q][tuple(part.grid.cell_of(x[:, None])[0] for part, x in zip(parts, starts, strict=True))])


@mostly_thorough("task", TASKS, first=3)
def test_the_upper_end_is_what_the_controllers_attain(task: str) -> None:
    """Where policies are followed exactly: no less than the truth, and no more than a millionth above it."""
    end, truth = ended(task, "exact"), dense(certified(task, "exact"))
    assert 0.2 < truth < 0.8 and abs(certified(task, "exact").lower_bound - truth) < 1e-6
    assert truth <= end.upper_bound + 1e-12 < truth + 1e-6
    above = cg.check(end).above
    assert above is not None and truth <= above <= end.upper_bound


@mostly_thorough("relation, room", [("linear", 0.01), ("boxes", 0.1)])
@mostly_thorough("task", ["co-safe", "trace"])
def test_rollouts_lie_below_and_near_upper_ends(task: str, relation: str, room: float) -> None:
    end = ended(task, relation)
    report = cg.check(end)
    assert report and report.above <= end.upper_bound
    successes = cg.rollout(end.problem, end.controller, episodes=20_000, seed=5).successes
    assert binom.sf(successes - 1, 20_000, end.upper_bound) > FALSE_ALARM
    assert binom.cdf(successes, 20_000, end.upper_bound - room) > FALSE_ALARM
    # Where exits count as if runs might have succeeded, the end is far off.
    assert old_end(certified(task, relation)).upper_bound > end.upper_bound + 0.2


def words(problem: cg.Problem, count: int, seed: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Random walks of all agents: states (T + 1, I, n), and which of them are outside."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=(problem.horizon + 1, problem.n_agents, count)) * 1.5
    states = np.cumsum(steps, axis=0)
    return states, np.abs(states) > 4.0


def verdicts(automaton: Automaton, letters: NDArray[Any], ended_by: NDArray[Any] | None) -> NDArray[np.bool_]:
    """Which words are satisfied; a run fails where it is ``ended_by`` an exit before it is accepted."""
    q = np.full(letters.shape[2], automaton.initial)
    failed, done = np.zeros(len(q), dtype=bool), automaton.finished[q]
    for t, letter in enumerate(letters):
        if ended_by is not None:
            failed |= ended_by[t] & ~done
        q = np.where(failed, q, automaton.next_state(q, letter))
        done |= automaton.finished[q] & ~failed
    return np.asarray(~failed & (done | automaton.accepting[q]))


@pytest.mark.parametrize("task", TASKS)
def test_every_run_satisfies_exactly_one_of_both(task: str) -> None:
    """2000 random walks, most of which leave at some time: exits decide as they do in runs."""
    problem = at_the_edge(task)
    other = complement_of(problem)
    assert wrong_complement(problem, other) == []
    states, outside = words(problem, 2000, 3)
    letters = np.concatenate([problem.labeling.class_at(i, states[None, :, i]) for i in range(2)]).swapaxes(0, 1)
    own = verdicts(problem.automaton, letters, np.asarray(outside.any(axis=1)))
    places = {name: k for k, name in enumerate(problem.labeling.names)}
    owner = {name: other.agent_names.index(region.agent) for name, region in other.propositions.items()}
    # Outside, nothing holds; inside, there is one proposition more, which holds.
    theirs = np.stack(
        [
            (letters[:, places[name]] if name in places else True) & ~outside[:, owner[name]]
            for name in other.labeling.names
        ],
        axis=1,
    )
    assert np.array_equal(own, ~verdicts(other.automaton, theirs, None))
    assert 0 < own.sum() < 2000 and outside.any(axis=(0, 1)).sum() > 1000


def test_opposites_are_not_simulated() -> None:
    with pytest.raises(ValueError, match="simulate the task itself"):
        cg.rollout(complement_of(at_the_edge("reach")), RandomController(), episodes=1)


def forged(certificate: Any, change: Any = lambda joint: joint, labels: Any = lambda labels: labels) -> Any:
    """An upper end, and the tree's number, from other guards or labels than those of the opposite task."""
    problem, abstraction = certificate.problem, abstraction_again(certificate)
    other = complement_of(problem)
    beyond, policies = surrounded(other, abstraction, tuple(part.policy for part in certificate.proof.agents))
    models = tuple(dataclasses.replace(model, labels=labels(model.labels)) for model in beyond.models)
    beyond = dataclasses.replace(beyond, models=models)
    joint = change(join(other, beyond))
    best = sweep(joint, policies, start_of(other, joint), FINAL, improve=False)
    found = changed(certificate_of(other, beyond, joint, best, certificate.settings, "forged"), gap=None)
    above = 1.0 - found.lower_bound
    return changed(certificate, complement=found, gap=max(0.0, above - certificate.lower_bound) + 1e-12), above


def whatever_others_do(joint: JointModel) -> JointModel:
    """Let exits count whether or not agents before the one that leaves stay inside: terms are added twice."""
    guards, lost = joint.guards, joint.n_states - 1
    masks, mask = [], guards.mask.copy()
    for i, own in enumerate(joint.masks):
        masks.append(np.concatenate([own, np.ones_like(own[:1])]))
        outside = own[:, 0] & ~own[:, len(own[0]) // 2]  # holds of the first cell, which is outside, and not inside
        leaves = np.flatnonzero(guards.target == lost)
        # Guards of other agents' exits hold wherever this one is.
        others = [g for g in leaves if not outside[guards.mask[g, i]]]
        mask[others, i] = len(own)
    sets = tuple(np.concatenate([s, np.ones_like(s[:1])]) for s in guards.masks)
    return dataclasses.replace(joint, masks=tuple(masks), guards=dataclasses.replace(guards, masks=sets, mask=mask))


def test_exits_that_are_counted_twice_are_refused() -> None:
    """Without "all agents before it stay inside" the upper end would be below the truth."""
    bare = certified("reach", "exact")
    same, above = forged(bare)
    assert cg.check(same) and above == pytest.approx(ended("reach", "exact").upper_bound, abs=1e-9)
    wrong, above = forged(bare, whatever_others_do)
    assert above < dense(bare) - 0.005
    assert any("overlap" in text for text in cg.check(wrong).failures)


def test_cells_that_may_be_inside_are_not_outside() -> None:
    """States related to a cell at the edge may be on either side of it."""

    def surely_outside(labels: CellLabels) -> CellLabels:
        sets = labels.sets.copy()
        sets[sets[:, -1], :-1] = False
        return dataclasses.replace(labels, sets=sets)

    bare = certified("reach", "paper")
    same, above = forged(bare)
    assert cg.check(same)
    wrong, less = forged(bare, labels=surely_outside)
    assert less < above - 0.01
    assert any("does not always lead" in text for text in cg.check(wrong).failures)


def old_end(certificate: Any) -> Any:
    """The upper end of earlier versions, by the opposite task that reads no exits."""
    policies = tuple(part.policy for part in certificate.proof.agents)
    other = complement_inside(certificate.problem)
    found = evaluated(other, abstraction_again(certificate), policies, certificate)
    return changed(certificate, complement=found, gap=1.0 - found.lower_bound - certificate.lower_bound + 1e-12)


def test_upper_ends_of_earlier_versions_hold_as_before() -> None:
    end = old_end(certified("co-safe", "linear"))
    report = cg.check(end)
    assert report and report.above == pytest.approx(end.upper_bound, abs=1e-9)
    assert end.proof.complement.problem.automaton.semantics == "finite-trace"
    # What was certified of one opposite is nothing that is known of the other one.
    new = ended("co-safe", "linear")
    mixed = changed(new, complement=dataclasses.replace(new.proof.complement, problem=end.proof.complement.problem))
    assert not cg.check(mixed)


def test_tasks_that_are_no_opposites_are_told() -> None:
    problem = at_the_edge("co-safe")
    other = complement_of(problem)
    assert wrong_complement(problem, problem) != []
    assert wrong_complement(problem, complement_inside(problem)) == []
    assert wrong_complement(problem, complement_of(at_the_edge("until"))) != []
    lost, second = other.automaton.n_states - 1, other.automaton.propositions.index("inside_two")
    changes: list[tuple[str, Any]] = [
        ("accepting", np.append(other.automaton.accepting[:-1], False)),
        ("root", np.where(np.arange(lost + 1) == problem.initial_q, -1 - lost, other.automaton.root)),
        ("high", np.roll(other.automaton.high, 1)),
        # Exits of the second agent change nothing.
        ("low", np.where(other.automaton.variable == second, other.automaton.high, other.automaton.low)),
    ]
    for name, value in changes:
        entries: dict[str, Any] = {name: value}
        try:
            automaton = dataclasses.replace(other.automaton, **entries)
        except ValueError:  # no automaton at all
            continue
        wrong = cg.Problem(
            name="wrong", horizon=problem.horizon, agents=other.written_agents, propositions=dict(other.declared),
            specification=cg.Specification(automaton=automaton),
        )  # fmt: skip
        assert wrong_complement(problem, wrong) != [], name


@pytest.mark.parametrize("relation, gap", [("exact", 1e-6), ("boxes", 0.3)])
def test_starts_on_the_upper_face_are_inside(relation: str, gap: float) -> None:
    """Workspaces are closed: cells around them begin at the next number."""
    problem = two_agents("G !b", "finite-trace", horizon=2, initial_state=[4.0])
    end: Any = bound_above(changed(cg.synthesize(problem, 30, relation=relation).certificate, gap=None))
    assert cg.check(end) and 0.3 < end.lower_bound and end.gap < gap


@pytest.mark.thorough
def test_ends_are_those_that_separate_code_finds_too() -> None:
    """Unions from below rest on ratios of small numbers, which the check does not find here: it has no part in them."""
    certificate = cg.synthesize("decoupled-chain-v0", above=True).certificate
    assert certificate.gap is not None and certificate.gap < 5e-4
    assert cg.check(certificate)
