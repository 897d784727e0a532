"""Teams whose agents keep apart, or meet, along nonlinear paths: certified below the truth, checked by other code."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, norm

import certigym as cg
from certigym.synthesis.certificates.proofs import AgentPath, AlongPath, PathProof, changed, start_of_claim
from certigym.synthesis.relations.grids import RelationRefused
from certigym.synthesis.trajectories.chance_constraints.limit_rows import Worth
from certigym.synthesis.trajectories.chance_constraints.pair_inequalities import PairRows
from certigym.synthesis.trajectories.words.accepted_words import is_accepted
from certigym.synthesis.trajectories.words.automaton_paths import AutomatonPath, automaton_paths_of
from fleet_problems import mixed, path_of, problem_of, swap, walker
from kinds import mostly_thorough

FALSE_ALARM = 1e-6
"""Probability that a test of rollouts fails although the claim is true."""


PROBLEMS = {"two": swap(std=0.04, horizon=10), "three": swap(3, 0.02, 0.4), "mixed": mixed()}


@pytest.fixture(scope="module")
def certificates() -> dict[str, AlongPath]:
    return {name: path_of(problem) for name, problem in PROBLEMS.items()}


@pytest.mark.parametrize("name", sorted(PROBLEMS))
def test_certificates_are_checked_and_not_refuted(name: str, certificates: dict[str, AlongPath]) -> None:
    certificate = certificates[name]
    report = cg.check(certificate, PROBLEMS[name])
    assert report.valid, report.failures
    assert certificate.lower_bound > 0.9
    done = cg.rollout(PROBLEMS[name], certificate.controller, 20_000, seed=1)
    assert binom.cdf(done.successes, 20_000, certificate.lower_bound) > FALSE_ALARM / 3


def test_agents_see_themselves_alone(certificates: dict[str, AlongPath]) -> None:
    assert certificates["three"].controller.information == "own state, time"


def _with_letters(certificate: AlongPath, first: int, value: int) -> AlongPath:
    letters = certificate.proof.letters.copy()
    letters[:, first:] = value
    return changed(certificate, letters=letters)


def with_first(certificate: AlongPath, path: AgentPath) -> AlongPath:
    """The same with another path of the first agent."""
    return changed(certificate, paths=(path, *certificate.proof.paths[1:]))


FORGERIES = {
    "failure": lambda c: changed(c, failure=0.9 * c.proof.failure),
    "pair dropped": lambda c: _with_letters(c, c.problem.labeling.first_pair, 0),
    "pair turned round": lambda c: _with_letters(c, c.problem.labeling.first_pair, 1),
    "no directions": lambda c: changed(c, normals=None),
    "directions that are 0": lambda c: changed(c, normals=0.0 * c.proof.normals),
    "directions that are no numbers": lambda c: changed(c, normals=np.nan * c.proof.normals),
    "directions of another step": lambda c: changed(c, normals=np.roll(c.proof.normals, 3, axis=0)),
    "directions turned round": lambda c: changed(c, normals=-c.proof.normals),
    "directions that do not fit": lambda c: changed(c, normals=c.proof.normals[:, :1]),
    "agents exchanged": lambda c: changed(c, paths=c.proof.paths[::-1]),
    "one agent without feedback": lambda c: with_first(c, replace(c.proof.paths[0], gains=0 * c.proof.paths[0].gains)),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(FORGERIES))
def test_forgeries_are_refused(name: str, certificates: dict[str, AlongPath]) -> None:
    certificate = certificates["two"]
    assert 1e-9 < certificate.proof.failure
    assert not cg.check(FORGERIES[name](certificate))


@pytest.mark.thorough
def test_a_half_plane_moved_inward_is_refused() -> None:
    """What would be true of a smaller box, claimed of the box, where agents pass each other in a narrow street."""
    honest, smaller = path_of(swap(std=0.03, side=0.9)), swap(std=0.03, near=0.75, side=0.9)
    easier = cg.check(replace(honest, problem=smaller))
    failure = 1.0 - easier.recomputed + 1e-9
    assert cg.check(honest) and failure < 0.9 * honest.proof.failure
    assert cg.check(changed(honest, problem=smaller, failure=failure))
    assert not cg.check(changed(honest, failure=failure))


def test_what_scales_directions_changes_nothing(certificates: dict[str, AlongPath]) -> None:
    certificate = certificates["two"]
    assert certificate.proof.normals is not None
    again = changed(certificate, normals=1024.0 * certificate.proof.normals)
    assert cg.check(again).recomputed == pytest.approx(cg.check(certificate).recomputed, rel=1e-9)


@pytest.fixture(scope="module")
def noisy() -> AlongPath:
    return path_of(swap(std=0.06, horizon=9))


@pytest.mark.thorough
@pytest.mark.usefixtures("search_alone")
def test_one_agent_left_out_of_a_pair_is_refused(noisy: AlongPath, monkeypatch: pytest.MonkeyPatch) -> None:
    totals = PairRows._totals

    def without_the_first(self: PairRows, contributions: Any) -> Any:
        left = (1.0, 0.0, 0.0, 0.0, 1.0)
        drop = {t: tuple(factor * part for factor, part in zip(left, parts, strict=True))
                for t, parts in contributions[0].items()}  # fmt: skip
        return totals(self, [drop, *contributions[1:]])

    assert cg.check(noisy)
    monkeypatch.setattr(PairRows, "_totals", without_the_first)
    forged = path_of(swap(std=0.06, horizon=9))
    assert not cg.check(forged)


def apart(start: float, horizon: int = 1, formula: str = "G !near") -> cg.Problem:
    agents = [walker("first", [0.0], 0.1), walker("second", [start], 0.2)]
    return problem_of(agents, {"near": cg.Pair(["first", "second"], [-1.0], [0.5])}, formula, horizon)


def test_one_step_of_a_pair_is_exact() -> None:
    """Both go apart as far as they choose: the distance less that of the box, in deviations of both."""
    certificate = path_of(apart(1.2, formula="N G !near"))
    (first, second) = certificate.proof.paths
    assert first.states is not None and second.states is not None
    gap = float(second.states[1, 0] - first.states[1, 0])
    truth = norm.cdf((gap - 1.0) / math.hypot(0.1, 0.2))
    assert certificate.lower_bound <= truth
    # Slabs of the workspace are the rest: 9 is 30 deviations away.
    assert certificate.lower_bound == pytest.approx(truth, abs=1e-9)
    assert cg.check(certificate)


def test_one_step_of_a_meeting_is_exact() -> None:
    """Both meet in the middle of the box at best: two limits, half its width in deviations of both."""
    certificate = path_of(apart(1.2, formula="N G near"))
    truth = 2.0 * norm.cdf(0.75 / math.hypot(0.1, 0.2)) - 1.0
    assert truth - 1e-3 < certificate.lower_bound <= truth
    assert cg.check(certificate)
    assert not cg.check(changed(certificate, failure=0.9 * certificate.proof.failure))


@mostly_thorough(("start", "holds"), [(1.0, True), (np.nextafter(1.0, 2.0), False), (-0.5, False),
                                              (np.nextafter(-0.5, 0.0), True), (0.0, True)], first=2)  # fmt: skip
def test_pairs_are_read_at_time_0(start: float, holds: bool) -> None:
    """The difference first - second lies in [-1, .5) or not; G !near is lost before the first control where it does."""
    problem = apart(start)
    safe = apart(3.0)
    certificate = path_of(safe)
    assert cg.check(certificate)
    paths = tuple(
        replace(path, states=path.states + (0.0 if k == 0 else start - 3.0))
        for k, path in enumerate(certificate.proof.paths)
    )
    forged = changed(certificate, problem=problem, paths=paths, failure=0.999999)
    assert problem.labeling.letter([np.zeros(1), np.array([start])])[0] == holds
    if holds:
        assert not cg.check(forged)
        with pytest.raises(ValueError, match="path"):
            cg.synthesize(problem, relation="path")
    else:
        found: Any = cg.synthesize(problem, relation="path").certificate
        assert found.lower_bound > 0.99 and cg.check(found)


def test_pairs_at_a_face_without_noise_are_not_apart() -> None:
    """Without noise a difference on the face of the closed box is not known to be outside."""
    still = {"noise_covariance": [[0.0]], "B": [[0.0]]}
    agents = [walker("first", [0.0], 0.1, **still), walker("second", [1.0], 0.1, **still)]
    problem = problem_of(agents, {"near": cg.Pair(["first", "second"], [-1.0], [0.5])}, "N G !near", 1)
    path = [
        AgentPath(np.zeros((1, 1)), np.zeros((1, 1, 1)), np.full((2, 1), x), np.full((2, 2), np.inf))
        for x in (0.0, 1.0)
    ]
    letters = np.array([[0], [-1]], dtype=np.int8)
    proof = PathProof(tuple(path), letters, np.full((2, 1), -1), 0.999, np.array([[0.0], [-1.0]]))
    assert not cg.check(cg.Certificate(problem, proof, {}))


def test_starts_that_leave_the_first_letter_open_are_refused_in_words() -> None:
    agents = [
        walker("first", [0.0], 0.1),
        walker("second", [3.0], 0.1, initial_state=None, initial_low=[0.9], initial_high=[1.1]),
    ]
    problem = problem_of(agents, {"near": cg.Pair(["first", "second"], [-1.0], [0.5])}, "G !near", 2)
    with pytest.raises(ValueError, match="first letter"):
        cg.synthesize(problem, relation="path")


def test_files_keep_fleets(certificates: dict[str, AlongPath], tmp_path: Path) -> None:
    certificate = certificates["mixed"]
    cg.save(certificate, tmp_path / "fleet.npz")
    again: Any = cg.load(tmp_path / "fleet.npz")
    assert certificate.proof.normals is not None and np.array_equal(again.proof.normals, certificate.proof.normals)
    assert cg.check(again, certificate.problem).valid
    assert cg.report(certificate, tmp_path / "fleet.html", episodes=200)


def test_words_of_many_pairs_are_found() -> None:
    """Forty agents have 780 pairs: ways through the automaton are found in the nodes that still lead somewhere."""
    problem = swap(40, 0.01, 0.01, 3)
    way = next(automaton_paths_of(problem))
    letters = way.letters((3,), 3, len(problem.propositions))
    assert letters is not None and is_accepted(problem, letters)
    assert np.all(letters[1:3, problem.labeling.first_pair :] == -1)


def test_rows_of_a_team_are_counted_once() -> None:
    one, total = Worth(), Worth()
    far, nothing = np.full((2, 3), 2.0), np.full((2, 3), np.inf)
    one.add(far, nothing, nothing, np.ones((2, 3)), ["a at 1", "b at 1", "c at 1"])
    total.extend(one.flattened(["first", "second"]))
    assert total.failures()[0] == pytest.approx(6.0 * norm.sf(2.0), rel=1e-5)
    assert total.weakest() == "agent `first`, a at 1"


def test_nominal_paths_stay_in_the_workspaces() -> None:
    """A task that nobody can do in time: the plan leaves the workspace, and no certificate says that it may."""
    unstable = walker(
        "first", [1.8], 0.1, A=[[1.5]], input_low=[-0.1], input_high=[0.1], state_low=[-2.0], state_high=[2.0]
    )
    other = walker("second", [-5.0], 0.1)
    problem = cg.Problem(
        name="out", horizon=3, agents=[unstable, other],
        propositions={"near": cg.Pair(["first", "second"], [-0.5], [0.5])},
        specification=cg.Specification("G !near", "finite-trace"),
    )  # fmt: skip
    with pytest.raises(RelationRefused, match="agent `first` leaves its workspace at step"):
        cg.synthesize(problem, relation="path")


def from_boxes(width: float, formula: str = "G !near & F there") -> cg.Problem:
    """Return two walkers, of whom the first starts in a box and passes the other one, who meets it half-way."""
    boxes = {"initial_state": None, "initial_low": [-2.0 - width, 1.0], "initial_high": [-2.0 + width, 1.0]}
    agents = [walker("first", [-2.0, 1.0], 0.08, **(boxes if width else {})), walker("second", [2.0, 0.0], 0.05)]
    regions = {
        "near": cg.Pair(["first", "second"], [-0.5, -0.5], [0.5, 0.5]),
        "there": cg.Proposition("first", [1, 0], [3, 2]),
    }
    return problem_of(agents, regions, formula, 6)


@pytest.mark.thorough
def test_pairs_hold_from_every_start_of_a_box() -> None:
    """The set of starts joins the drift of pairs, and claims that forget it are refused."""
    wide, point = path_of(from_boxes(0.3)), path_of(from_boxes(0.0))
    assert cg.check(wide) and start_of_claim(wide) == "mean" and wide.lower_bound > 0.9
    rate = cg.validate(wide, 20_000, seed=4, confidence=1.0 - FALSE_ALARM)
    assert rate.verdict != "refuted" and rate.estimate >= wide.lower_bound - 0.01
    forgotten = replace(point, problem=wide.problem)
    assert cg.check(point) and not cg.check(forgotten)


@pytest.mark.parametrize(
    ("low", "high", "state"), [(-4.0, -3.0, True), (-0.4, 0.4, True), (-0.6, 0.4, False), (-0.49, -0.4, True)]
)
def test_the_first_letter_of_pairs_is_known_where_all_starts_agree(low: float, high: float, state: bool) -> None:
    """Boxes that reach both sides of a face leave open where the automaton is."""
    first = walker("first", [0.0], 0.1, initial_state=None, initial_low=[low], initial_high=[high])
    for pair, there in ((cg.Pair(["first", "second"], [-0.5], [0.5]), state),
                        (cg.Pair(["first", "second"], distance=0.5), state)):  # fmt: skip
        problem = problem_of([first, walker("second", [0.0], 0.1)], {"near": pair}, "near | F G near", 3)
        assert (problem.initial_q is not None) == there


def test_ways_spread_their_jumps_evenly_and_together() -> None:
    stay: Any = ((0, False),)
    way = AutomatonPath((stay, stay, None, stay, ()), (stay, stay, stay, stay))
    assert [[*group] for group in way.groups] == [[0], [1, 2], [3]]
    assert way.spread(13) == (4, 8, 9, 13) and way.spread(4) == (1, 2, 3, 4)
    assert way.moved((4, 8, 9, 13), range(1, 3), 2) == (4, 10, 11, 13)
    assert AutomatonPath((stay,), ()).spread(5) == ()
