"""Teams on grids of vertices: bounds below the truth of the chain they form, forgeries, rollouts of the team."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

import certigym as cg
from certigym.synthesis.certificates.controllers import VertexController
from certigym.synthesis.checker import Refused
from certigym.synthesis.extended_check.vertex_grids import Backups, VertexKernel, teams
from certigym.synthesis.policy_search.vertex_values import team_refinement
from rollout_limits import most_by_rollouts

HORIZON, STD = 5, (0.35, 0.3)


def line(name: str, std: Any, **more: Any) -> dict[str, Any]:
    """An agent on a line, in noise."""
    return {
        "name": name, "states": ["x"], "inputs": ["u"], "dynamics": ["x + u - 0.05*x*abs(x)"], "noise_std": [std],
        "state_low": [-3], "state_high": [3], "input_low": [-0.6], "input_high": [0.6], "initial_state": [-1.0],
    } | more  # fmt: skip


def pair(task: str = "!(rock & edge) U (goal & home)", **more: Any) -> cg.Problem:
    """Two agents that have to be at their places at one time."""
    agents = [cg.Agent(**line("a", STD[0], **more)), cg.Agent(**line("b", STD[1], initial_state=[1.2]))]
    places = {
        "goal": cg.Proposition("a", [0.4], [1.6]), "rock": cg.Proposition("a", [-0.4], [0.1]),
        "home": cg.Proposition("b", [-0.8], [0.5]), "edge": cg.Proposition("b", [0.5], [1.0]),
    }  # fmt: skip
    return cg.Problem(name="pair", agents=agents, propositions=places, specification=task, horizon=HORIZON)


@pytest.fixture(scope="module")
def certificate() -> cg.Certificate:
    return cg.synthesize(pair(), relation="vertices", effort=1.5).certificate


def chain_value(problem: cg.Problem, controller: VertexController, cells: int) -> float:
    """Return about what a team of two on lines attains, on a fine chain of both together (no bound)."""
    edges = np.linspace(-3.0, 3.0, cells + 1)
    x = 0.5 * (edges[1:] + edges[:-1])
    holds = {p: (low <= x) & (x < high) for p, low, high in _places(problem)}
    automaton, names = problem.automaton, list(problem.labeling.names)
    letters = np.zeros((len(names), cells, cells), dtype=bool)
    for k, name in enumerate(names):
        own = holds[name]
        letters[k] = own[:, None] if name in ("goal", "rock") else own
    n_q = len(automaton.accepting)
    after = np.stack([automaton.next_state(np.full((cells, cells), q), letters) for q in range(n_q)])
    value = np.broadcast_to(np.asarray(automaton.accepting, dtype=float)[:, None, None], (n_q, cells, cells)).copy()
    for t in range(problem.horizon - 1, -1, -1):
        read = np.stack([np.take_along_axis(value, own[None], axis=0)[0] for own in after])
        for q in range(n_q):
            if automaton.absorbing[q]:
                continue
            moves = []
            for i, std in enumerate(STD):
                u = controller.inputs(i, x[None], np.full(cells, q), t)[0]
                y = x + u - 0.05 * x * np.abs(x)
                moves.append(np.diff(ndtr((edges - y[:, None]) / std), axis=1))
            value[q] = moves[0] @ read[q] @ moves[1].T
    start = [int(np.argmin(np.abs(x - own))) for own in (-1.0, 1.2)]
    q = int(after[automaton.initial][tuple(start)])
    # the start lies on a face of the chain: the mean over cells beside it
    return float(value[q][start[0] - 1 : start[0] + 2, start[1] - 1 : start[1] + 2].mean())


def _places(problem: cg.Problem) -> list[tuple[str, float, float]]:
    labeling, found = problem.labeling, list[tuple[str, float, float]]()
    for i, positions in enumerate(labeling.agent_propositions):
        for column, position in enumerate(positions.tolist()):
            low, high = labeling.at(0).low[i][:, column], labeling.at(0).high[i][:, column]
            found.append((labeling.names[position], float(low[0]), float(high[0])))
    return found


def test_bounds_are_below_the_truth_and_near_it(certificate: cg.Certificate) -> None:
    true = chain_value(certificate.problem, certificate.controller, 240)
    assert certificate.proof.kind == "vertex-grids" and cg.check(certificate)
    assert true - 0.05 < certificate.lower_bound <= true + 2e-3


def test_certificates_stand_rollouts_and_files(certificate: cg.Certificate, tmp_path: Any) -> None:
    assert certificate.lower_bound <= most_by_rollouts(certificate, 5)
    cg.save(certificate, tmp_path / "c.npz")
    again = cg.load(tmp_path / "c.npz")
    assert cg.check(again) and again.lower_bound == certificate.lower_bound
    environment = cg.parallel_env(certificate.problem)
    observations, infos = environment.reset(seed=0)
    actions = again.controller.act(observations, infos)
    assert {name: own.shape for name, own in actions.items()} == {"a": (1,), "b": (1,)}


def forged(proof: Any, how: str) -> Any:
    """Return a proof that claims what does not follow."""
    first, *others = proof.grids
    vertices, unions, kept = proof.tree
    source, target, sets = proof.guards
    changes: dict[str, dict[str, Any]] = {
        "failure": {"failure": 0.5 * proof.failure},
        "a grid of another workspace": {"grids": (replace(first, edges=(2.0 * first.edges[0],)), *others)},
        "inputs beyond their box": {"grids": (replace(first, inputs=first.inputs + 5.0), *others)},
        "no law": {"grids": (replace(first, laws=first.laws + 1000), *others)},
        "less noise is seen": {"grids": (replace(first, near=-1.0), *others)},
        "one grid": {"grids": (first,)},
        "other coordinates": {"grids": (replace(first, matrix=np.eye(1)), *others)},
        "all sets hold everything": {"sets": tuple(np.ones_like(own) for own in proof.sets)},
        "sets of other kinds": {"sets": tuple(own[:, :-1] for own in proof.sets)},
        "guards lead on": {"guards": (source, np.full_like(target, 1), sets)},
        "another start": {"start": ((proof.start[0] + 1) % 3, proof.start[1])},
        "a child of another state": {"tree": (vertices - [0, 0, 0, 1], unions, kept)},
        "guards from the end": {"guards": (source, target, sets - sets.max() - 1)},
        "vertices twice": {"tree": (np.repeat(vertices, 2, axis=0), unions, kept)},
        "kept twice": {"tree": (vertices, unions, np.repeat(kept, 2, axis=0))},
    }
    return replace(proof, **changes[how])


FORGERIES = (
    "failure", "a grid of another workspace", "inputs beyond their box", "no law", "less noise is seen", "one grid",
    "other coordinates", "all sets hold everything", "sets of other kinds", "guards lead on", "another start",
    "a child of another state", "guards from the end", "vertices twice", "kept twice",
)  # fmt: skip


@pytest.mark.parametrize("how", FORGERIES)
def test_forgeries_are_refused(certificate: cg.Certificate, how: str) -> None:
    report = cg.check(replace(certificate, proof=forged(certificate.proof, how)))
    assert not report
    assert how not in ("a child of another state", "guards from the end") or "below 0" in str(report)


def test_the_check_notices_what_the_search_gets_wrong(certificate: cg.Certificate, monkeypatch: Any) -> None:
    """Where values one step earlier are those of the step itself, another number is recomputed."""
    monkeypatch.setattr(VertexKernel, "backup", lambda self, values, largest, policy: values)
    report = cg.check(certificate)
    assert not report or abs(report.recomputed - certificate.lower_bound) > 1e-3


def test_factors_are_scaled_without_error() -> None:
    problem = team_refinement.refuse_vertex_team(pair())
    edges = (np.linspace(-3.0, 3.0, 41),)
    kernel = VertexKernel(Backups(teams.alone(problem, 0), edges, (True,), 6.0), np.zeros((1, 41, 1)))
    W = np.random.default_rng(7).uniform(0.6, 1.0, (1, 80))
    policy = np.array([0, 0])
    one = kernel.backup(W, W.max(axis=1), policy)
    tiny = kernel.backup(2.0**-300 * W, 2.0**-300 * W.max(axis=1), policy)
    assert one.max() > 0.5 and np.array_equal(tiny, 2.0**-300 * one)
    assert not kernel.backup(2.0**-950 * W, 2.0**-950 * W.max(axis=1), policy).any()


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"angles": ["x"], "state_low": [-np.pi], "state_high": [np.pi]}, "angle"),
        ({"dynamics": ["x + u + 0.1*b.x"], "communicated": ["b"]}, "name other agents"),
        ({"noise_std": [0.0]}, "has no noise"),
    ],
)
def test_what_has_no_grid_is_refused_in_words(more: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        cg.synthesize(pair(**more), relation="vertices", effort=1.0)


def test_disturbances_are_the_worst(certificate: cg.Certificate) -> None:
    disturbed = pair(dynamics=["x + u - 0.05*x*abs(x) + w"], disturbances={"w": [-0.1, 0.1]})
    found = cg.synthesize(disturbed, relation="vertices", effort=1.5).certificate
    assert cg.check(found) and 0.2 < found.lower_bound < certificate.lower_bound
    for behaviour in ("zero", "random", "periodic"):
        rollouts = cg.rollout(disturbed, found.controller, episodes=20_000, seed=3, disturbance=behaviour)
        assert found.lower_bound <= rollouts.successes / 20_000 + 0.02  # six deviations of the estimate


def test_regions_and_dynamics_may_name_the_time() -> None:
    """A goal that runs away, and an engine that fades: what was true at the start would promise more."""
    agents = [
        cg.Agent(**line("a", STD[0], dynamics=["x + u*(1 - 0.2*t)"])),
        cg.Agent(**line("b", STD[1], initial_state=[1.2])),
    ]
    places = dict(pair().propositions) | {"goal": cg.Proposition("a", ["0.4 + 0.3*t"], ["1.6 + 0.3*t"])}
    task = "!(rock & edge) U (goal & home)"
    problem = cg.Problem(name="pair", agents=agents, propositions=places, specification=task, horizon=HORIZON)
    found = cg.synthesize(problem, relation="vertices", effort=1.5).certificate
    most = most_by_rollouts(found, 5)
    assert cg.check(found) and most - 0.1 < found.lower_bound <= most < 0.6


def test_what_agents_alone_are_refused_for() -> None:
    problem = team_refinement.refuse_vertex_team(pair())
    assert [region.name for region in teams.alone(problem, 1).regions] == ["home", "edge"]
    with pytest.raises(Refused, match="pairs of agents"):
        teams.alone(replace(problem, pairs=problem.regions[:1]), 0)


def test_the_automaton_is_proved_against_the_formula(certificate: cg.Certificate) -> None:
    proof: Any = certificate.proof
    problem = team_refinement.refuse_vertex_team(certificate.problem)
    always = replace(problem.automaton, accepting=(True,) * len(problem.automaton.accepting))
    guards, sets = (proof.guards, proof.start), (proof.sets, proof.start_sets)
    with pytest.raises(Refused, match="not that of the formula"):
        teams.team_failure(replace(problem, automaton=always), proof.grids, sets, guards, proof.tree, [None, None])


def test_a_refusal_of_the_check_reaches_who_asks() -> None:
    problem = team_refinement.refuse_vertex_team(pair())
    with pytest.raises(Refused, match="another number of grids"):
        teams.team_value(problem, [], [], ([], []), ((), ()), ())
