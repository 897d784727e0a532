"""Regions that are met at some time of a window: exact numbers on a line, letters and faces that are refused."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.stats import norm

import certigym as cg
from certigym.synthesis.certificates.proofs import SOMETIME, AgentPath, AlongPath, Certificate, PathProof, changed
from certigym.synthesis.trajectories.words.accepted_words import is_accepted
from certigym.synthesis.trajectories.words.visits import visits_of, with_windows
from fleet_problems import wrong_paths
from kinds import mostly_thorough

PACE, STEPS = 0.2, 12


def line(width: float, std: float, formula: str = "F goal", sign: float = 1.0) -> cg.Problem:
    """A number that moves as it is pushed, with noise, and a region from 1 on, or from -1 down."""
    agent = cg.Agent(
        name="cart", states=["x"], inputs=["u"], dynamics=["x + u"], noise_covariance=[[std**2]], state_low=[-9],
        state_high=[9], input_low=[-1], input_high=[1], initial_state=[0.0],
    )  # fmt: skip
    ends = {"goal": (1.0, 1.0 + width), "wall": (-9.0, -0.5)}
    regions = {name: cg.Proposition("cart", [min(sign * a, sign * b)], [max(sign * a, sign * b)])
               for name, (a, b) in ends.items()}  # fmt: skip
    return cg.Problem(name="line", horizon=STEPS, agents=[agent], propositions=regions,
                      specification=cg.Specification(formula, "co-safe"))  # fmt: skip


def crossing(problem: cg.Problem, window: tuple[int, int] = (1, STEPS), sign: float = 1.0) -> AlongPath:
    """A certificate that pushes evenly, open loop, and is to meet the goal within a window."""
    x = sign * PACE * np.arange(STEPS + 1)[:, None]
    names = problem.automaton.propositions
    letters, faces = np.zeros((STEPS + 1, len(names)), dtype=np.int8), np.full((STEPS + 1, len(names)), -1)
    p = names.index("goal")
    letters[window[0] : window[1] + 1, p] = SOMETIME
    faces[window[0] : window[1] + 1, p] = 0 if sign > 0.0 else 1
    path = AgentPath(np.full((STEPS, 1), sign * PACE), np.zeros((STEPS, 1, 1)), x, np.full((STEPS + 1, 2), np.inf))
    return Certificate(problem, PathProof((path,), letters, faces, 1.0), {"relation": "path"})


def missed(width: float, std: float) -> float:
    """Probability that a walk of that pace never is in the region, by sums over a fine grid."""
    points = np.linspace(-4.0, 7.0, 3001)
    size = points[1] - points[0]
    step = norm.pdf(points[:, None] - points[None] - PACE, scale=std) * size
    outside = (points < 1.0) | (points >= 1.0 + width)
    density = np.where(outside, norm.pdf(points - PACE, scale=std), 0.0)
    for _ in range(STEPS - 1):
        density = np.where(outside, step @ density, 0.0)
    return float(density.sum() * size)


@mostly_thorough("sign", [1.0, -1.0])
@mostly_thorough("width", [0.5, 0.7, 1.0, 2.0])
def test_failures_are_above_exact_ones_on_a_line(width: float, sign: float) -> None:
    problem = line(width, 0.1, sign=sign)
    failures, failure = wrong_paths(crossing(problem, sign=sign))
    assert not failures
    exact = missed(width, 0.1)
    assert exact <= failure * (1.0 + 1e-3)
    # What is lost: not there at last, or a jump over the region in one of the steps.
    last = norm.cdf((1.0 - STEPS * PACE) / (0.1 * np.sqrt(STEPS)))
    jumps = (STEPS - 1) * norm.sf((width - PACE) / 0.1)
    assert failure == pytest.approx(last + jumps, rel=1e-2)


def test_nominal_states_that_are_off_are_shifted() -> None:
    # A nominal path at half the pace: where the run is, and how far it moves in a step, is told by shifts alone.
    honest = crossing(line(0.6, 0.1))
    (path,) = honest.proof.paths
    assert path.states is not None
    slower = AgentPath(path.inputs, path.gains, 0.5 * path.states, path.strips)
    failures, failure = wrong_paths(changed(honest, paths=(slower,)))
    assert not failures and failure == pytest.approx(wrong_paths(honest)[1], rel=1e-6)


def test_a_region_that_is_narrower_than_a_step_is_not_met_for_sure() -> None:
    assert wrong_paths(crossing(line(0.15, 0.1)))[1] == 1.0
    assert missed(0.15, 0.1) > 0.3


def test_windows_that_end_before_the_path_arrives_are_worth_little() -> None:
    late, early = (wrong_paths(crossing(line(1.0, 0.1), (1, last)))[1] for last in (STEPS, 5))
    assert late < 1e-4 < 0.4 < early
    # Whoever begins beyond the region has not met it.
    assert wrong_paths(crossing(line(1.0, 0.1), (11, STEPS)))[1] > 0.7


def sabotaged(certificate: AlongPath, what: str) -> AlongPath:
    letters, faces = certificate.proof.letters.copy(), certificate.proof.faces.copy()
    p = certificate.problem.automaton.propositions.index("goal")
    if what == "another side":
        faces[:, p] = np.where(letters[:, p] == SOMETIME, 1, -1)
    elif what == "no side":
        faces[:, p] = -1
    elif what == "a side that is none":
        faces[:, p] = 2
    elif what == "a window that is cut":
        letters[6, p] = 0  # none of the two parts says that the region is met in it
    elif what == "sides that change":
        faces[6:, p] = 1
    else:
        letters[letters == SOMETIME] = 3
    return changed(certificate, letters=letters, faces=faces, failure=1e-3)


@pytest.mark.parametrize("what", ["another side", "no side", "a side that is none", "a window that is cut",
                                  "sides that change", "letters that are none"])  # fmt: skip
def test_what_is_changed_is_refused(what: str) -> None:
    honest = crossing(line(1.0, 0.1))
    honest = changed(honest, failure=wrong_paths(honest)[1])
    assert cg.check(honest) and honest.proof.failure < 1e-4
    assert not cg.check(sabotaged(honest, what))


def test_words_are_read_whenever_the_region_is_met() -> None:
    # After the goal nothing may be at the wall: at times of the window this is asked for as well.
    problem = line(1.0, 0.1, "F (goal & G[0,3] !wall)")
    certificate = crossing(problem)
    assert wrong_paths(certificate)[0] == ["a word that agrees with the letters of the trajectory is not accepted"]
    # Met at the last step the three steps after it would not be there: the window has to end before.
    letters = certificate.proof.letters.copy()
    goal, wall = (problem.automaton.propositions.index(name) for name in ("goal", "wall"))
    letters[:, wall] = -1
    faces = np.where(letters == -1, 1, certificate.proof.faces)  # the cart keeps to the right of the wall
    certificate = changed(certificate, faces=faces)
    assert wrong_paths(changed(certificate, letters=letters))[0]
    letters[STEPS - 2 :, goal] = 0
    assert not wrong_paths(changed(certificate, letters=letters))[0]
    assert is_accepted(problem, letters)
    letters[4, wall] = 0
    assert wrong_paths(changed(certificate, letters=letters))[0] and not is_accepted(problem, letters)


def test_windows_ask_for_what_is_asked_before_and_after_a_visit() -> None:
    problem = line(1.0, 0.1, "!wall U goal")
    goal, wall = (problem.automaton.propositions.index(name) for name in ("goal", "wall"))
    letters = np.zeros((6, 2), dtype=np.int8)
    letters[1:5, wall], letters[5, goal] = -1, 1
    assert list(visits_of(problem, letters)) == [(5, goal)]
    wider = with_windows(problem, letters, 2)
    assert wider is not None and len(wider) == 8
    np.testing.assert_array_equal(wider[:, goal], [0, 0, 0, 2, 2, 2, 2, 2])
    np.testing.assert_array_equal(wider[1:, wall], -1)


@cache
def tank() -> cg.Synthesis:
    """A tank whose inflow is noisy, the more so the more it flows: at any fixed step the level is right too seldom."""
    agent = cg.Agent(
        name="tank", states=["h"], inputs=["q"], dynamics=["h + 0.3*q"], noise=[{"law": "gaussian", "std": 1.0}],
        noise_scale=["0.02 + 0.2*q"], state_low=[-1], state_high=[4], input_low=[0], input_high=[1],
        initial_state=[0.0],
    )  # fmt: skip
    regions = {"right": cg.Proposition("tank", [1.0], [1.9]), "spilt": cg.Proposition("tank", [2.9], [4.0])}
    problem = cg.Problem(name="tank", horizon=16, agents=[agent], propositions=regions,
                         specification=cg.Specification("!spilt U right", "co-safe"))  # fmt: skip
    return cg.synthesize(problem, relation="path", effort=10)


@pytest.mark.thorough
def test_search_finds_windows_where_noise_is_large_against_a_region() -> None:
    certificate = tank().certificate
    assert np.any(certificate.proof.letters == SOMETIME)
    assert cg.check(certificate)
    assert cg.validate(certificate, 4000, seed=3).verdict in ("consistent", "confirmed")
    assert not cg.check(changed(certificate, failure=0.5 * certificate.proof.failure))


@pytest.mark.parametrize("along", ["x", "heading"])
def test_agents_with_angles_cross_regions(along: str) -> None:
    agent = cg.Agent(
        name="robot", states=["x", "heading"], inputs=["u", "turn"], dynamics=["x + 0.2*u", "heading + 0.2*turn"],
        noise=[{"law": "gaussian", "std": 0.1}] * 2, angles=["heading"], state_low=[-6, -np.pi], state_high=[6, np.pi],
        input_low=[-1, -1], input_high=[1, 1], initial_state=[0.0, 2.0],
    )  # fmt: skip
    # A place; or a heading beyond the end of the turn, along which nothing is said to be crossed.
    ends = ([-2.9], [-2.0]) if along == "heading" else ([0.9], [1.7])
    problem = cg.Problem(name="robot", horizon=12, agents=[agent], specification=cg.Specification("F there"),
                         propositions={"there": cg.Proposition("robot", *ends, of=[along])})  # fmt: skip
    certificate = crossing_robot(problem, along)
    failures, failure = wrong_paths(certificate)
    if along == "heading":
        assert "along an angle" in failures[0] and failure == 1.0
        return
    assert not failures and failure < 0.1
    honest = changed(certificate, failure=failure)
    assert cg.check(honest) and cg.validate(honest, 4000, seed=2).verdict in ("consistent", "confirmed")
    # The copy is the one that is near: from the other side it is not met.
    assert wrong_paths(changed(certificate, faces=certificate.proof.faces + 1))[1] > 0.9


def crossing_robot(problem: cg.Problem, along: str) -> AlongPath:
    """A certificate that moves along one state at full pace, and is to be in the region at some time."""
    axis = ["x", "heading"].index(along)
    u = np.zeros((12, 2))
    u[:, axis] = 1.0
    states = np.array([0.0, 2.0]) + 0.2 * np.concatenate([np.zeros((1, 2)), np.cumsum(u, axis=0)])
    letters, faces = np.zeros((13, 1), dtype=np.int8), np.full((13, 1), -1)
    letters[1:], faces[1:] = SOMETIME, 2 * axis
    strips = np.full((13, 4), np.inf)
    strips[:, 1] = 2.0  # an angle has to be known up to half a turn
    path = AgentPath(u, np.zeros((12, 2, 2)), states, strips)
    return Certificate(problem, PathProof((path,), letters, faces, 1.0), {"relation": "path"})
