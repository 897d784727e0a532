"""States that are angles wrap: runs, regions through pi, masses over all windings and paths are those of a circle."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import certigym as cg
from certigym.envs.systems.agents import expression_agent
from certigym.envs.systems.expressions import read_expression, turns
from certigym.synthesis.abstraction.kernels import box_kernel
from certigym.synthesis.certificates.controllers import path_controller
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.extended_check.shields import shield_of
from kinds import mostly_thorough

ROTOR: dict[str, Any] = {
    "name": "rotor", "states": ["theta"], "angles": ["theta"], "inputs": ["turn"],
    "dynamics": ["theta + turn + 0.1*sin(theta)"], "noise": [{"law": "gaussian", "std": 0.2}],
    "state_low": [-np.pi], "state_high": [np.pi], "input_low": [-0.6], "input_high": [0.6], "initial_state": [2.5],
}  # fmt: skip
WEST = {"of": "theta", "from": "pi - 0.5", "to": "-pi + 0.5"}
SOUTH = {"of": "theta", "from": "-0.65*pi", "to": "-0.35*pi"}
EAST = {"of": "theta", "from": -0.7, "to": 0.7}


def problem_of(formula: str, horizon: int, **changes: Any) -> cg.Problem:
    names = {"west": WEST, "south": SOUTH, "east": EAST}
    return cg.Problem(
        name="circle", horizon=horizon, agents=[cg.Agent(**{**ROTOR, **changes})],
        propositions={name: cg.Proposition("rotor", heading=arc) for name, arc in names.items()},
        specification=cg.Specification(formula, "co-safe"),
    )  # fmt: skip


@pytest.fixture(scope="module")
def around() -> cg.Problem:
    """From the west on through pi to the south, and not by way of the east."""
    return problem_of("!east U (west & X (!east U south))", 7)


@pytest.fixture(scope="module")
def on_grid(around: cg.Problem) -> Any:
    return cg.synthesize(around, 48, relation="boxes")


def ship(**changes: Any) -> cg.Problem:
    agent = {
        "name": "ship", "states": ["x", "theta"], "angles": ["theta"], "inputs": ["turn"],
        "dynamics": ["x + 0.3*cos(theta)", "theta + turn"],
        "noise": [{"law": "gaussian", "std": 0.02}, {"law": "gaussian", "std": 0.03}],
        "state_low": [-4, 0], "state_high": [4, 2 * np.pi], "input_low": [-1], "input_high": [1],
        "initial_state": [0, 0.8],
    } | changes  # fmt: skip
    propositions = {
        "there": cg.Proposition("ship", box={"low": [0.3], "high": [2.0], "of": ["x"]}),
        "aside": cg.Proposition("ship", heading={"of": "theta", "from": -1.4, "to": -0.9}),
        "wrong": cg.Proposition("ship", heading={"of": "theta", "from": 1.3, "to": 4.5}),
    }
    specification = cg.Specification("!wrong U (there & aside)", "co-safe")
    return cg.Problem(
        name="turning", horizon=5, agents=[cg.Agent(**agent)], propositions=propositions, specification=specification
    )


@pytest.fixture(scope="module")
def on_path() -> Any:
    return cg.synthesize(ship(), relation="path")


def test_turns_of_expressions_are_proved_or_unknown() -> None:
    names = ("a", "b")
    whole = [
        "a + 0.1*b",
        "sin(a)*b",
        "2*(0.5*a)",
        "a + tan(0.5*a)",
        "max(a, a + 1) - b",
        "cos(3*a)/(2 + sin(a))",
        "-a/1",
    ]
    assert [turns(read_expression(text, names), "a") for text in whole] == [1, 0, 1, 1, 1, 0, -1]
    unknown = ["a*b", "a**2", "sin(0.5*a)", "exp(a)", "clip(a, -1, 1)", "abs(a)", "b/a"]
    assert [turns(read_expression(text, names), "a") for text in unknown] == [None] * len(unknown)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"dynamics": ["0.9*theta + turn"]}, "name angles in sums, and elsewhere in `sin` and `cos`"),
        ({"dynamics": ["theta + turn*theta"]}, r"`dynamics\[0\]`: expected what grows by whole turns"),
        ({"state_high": [3.0]}, 'from "-pi" to "pi"'),
        ({"outputs": ["theta**2"]}, r"`outputs\[0\]`: expected the angle 'theta' itself"),
        ({"noise_scale": ["1 + theta**2"]}, r"`noise_scale\[0\]`"),
        ({"angles": ["phi"]}, "`angles`: expected names of states"),
    ],
)
def test_what_is_not_of_a_circle_is_refused_in_words(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        cg.Agent(**{**ROTOR, **changes})


@pytest.mark.parametrize(
    ("proposition", "words"),
    [
        ({"low": [2.9], "high": [3.5]}, "say it as `heading"),
        ({"low": ["0.1*t"], "high": ["0.1*t + 1"]}, "stand still along the angle"),
    ],
)
def test_regions_of_angles_are_arcs(proposition: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        cg.Problem(
            name="arc", horizon=2, agents=[cg.Agent(**ROTOR)],
            propositions={"p": cg.Proposition("rotor", **proposition)},
            specification=cg.Specification("F p", "co-safe"),
        )  # fmt: skip


def test_angles_of_pairs_are_refused_in_words() -> None:
    two = cg.Agent(**ROTOR).copies(2)
    with pytest.raises(ValueError, match="whose differences wrap"):
        cg.Problem(
            name="pair", horizon=2, agents=two, propositions={"near": cg.Pair("rotor_*", [-1], [1])},
            specification=cg.Specification("G !any(near)", "finite-trace"),
        )  # fmt: skip


def test_headings_hold_on_the_arc_and_nowhere_else(around: cg.Problem) -> None:
    """Compared with the angle between directions, at points near and far from the place where a turn ends."""
    for angle in np.linspace(-np.pi, np.pi, 721)[1:-1]:
        letter = around.labeling.letter([np.array([angle])])
        held = {name for name, holds in zip(around.labeling.names, letter, strict=True) if holds}
        told = around.told(held)
        off = abs(np.angle(np.exp(1j * (angle - np.pi))))
        assert ("west" in told) == (off < 0.5) or abs(off - 0.5) < 1e-9


@mostly_thorough("deviation", [0.2, 1.0, 3.0])
def test_a_step_has_the_mass_of_all_windings(deviation: float) -> None:
    """The wrapped normal law is known: what is certified is below its mass, and near it, however many turns it goes."""
    problem = problem_of("X west", 1, noise=[{"law": "gaussian", "std": deviation}], input_low=[0.0], input_high=[0.0])
    mean = 2.5 + 0.1 * np.sin(2.5)
    ends = np.array([np.pi - 0.5, np.pi + 0.5])
    copies = [norm.cdf((ends + 2.0 * np.pi * k - mean) / deviation) for k in range(-20, 21)]
    truth = float(sum(high - low for low, high in copies))
    result = cg.synthesize(problem, 240, relation="boxes")
    assert truth - 0.04 <= result.certificate.lower_bound <= truth
    assert cg.check(result.certificate, problem)


def test_a_grid_goes_on_where_a_turn_ends(around: cg.Problem, on_grid: Any) -> None:
    assert on_grid.certificate.lower_bound > 0.9 and cg.check(on_grid.certificate, around)
    report = cg.validate(on_grid, 20_000, seed=1, confidence=1.0 - 1e-6)
    assert report.ci_high >= on_grid.certificate.lower_bound


def test_a_path_goes_on_where_a_turn_ends(on_path: Any) -> None:
    """Its angle goes down through 0 to copies of regions a turn below, and the claim stands in rollouts that wrap."""
    problem = ship()
    assert on_path.certificate.lower_bound > 0.99 and cg.check(on_path.certificate, problem)
    assert on_path.certificate.proof.paths[0].states[-1, 1] < 0.0
    report = cg.validate(on_path, 20_000, seed=1, confidence=1.0 - 1e-6)
    assert report.ci_high >= on_path.certificate.lower_bound


# Sabotage: the check refuses what is not so.


def test_a_winding_that_counts_twice_is_refused_and_one_left_out_is_not(
    around: cg.Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    law_table = box_kernel.law_table

    def twice(means: Any, edges: Any, law: Any) -> Any:
        table, loss = law_table(means, edges, law)
        return (box_kernel.AxisTable.dense(1.5 * table.toarray()), loss) if means[-1] < np.pi else (table, loss)

    monkeypatch.setattr(box_kernel, "WINDINGS", 0)
    fewer = cg.synthesize(around, 48, relation="boxes")
    assert cg.check(fewer.certificate, around)
    monkeypatch.setattr(box_kernel, "WINDINGS", 1)
    monkeypatch.setattr(box_kernel, "law_table", twice)
    assert not cg.check(cg.synthesize(around, 48, relation="boxes").certificate, around)


def test_a_shifted_period_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """With turns of another length the masses beyond the end of a turn are those of other cells."""
    problem = problem_of("F south", 2, initial_state=[2.9])
    assert cg.check(cg.synthesize(problem, 48, relation="boxes").certificate, problem)
    monkeypatch.setattr(box_kernel, "TURN", 5.5)
    assert not cg.check(cg.synthesize(problem, 48, relation="boxes").certificate, problem)


@pytest.mark.parametrize("kind", ["grid", "path"])
def test_dynamics_that_are_not_those_of_a_circle_are_refused(
    kind: str, on_grid: Any, on_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even where problems would let them through."""
    monkeypatch.setattr(expression_agent, "refuse_uneven", lambda agent: None)
    certificate = on_grid.certificate if kind == "grid" else on_path.certificate
    agent = certificate.problem.agents[0]
    texts = [text.replace("theta +", "0.999*theta +") for text in agent.dynamics]
    uneven = agent.replace(dynamics=texts, outputs=list(agent.states))
    problem = cg.Problem(
        name="uneven", horizon=certificate.problem.horizon, agents=[uneven],
        propositions=certificate.problem.declared, specification=certificate.problem.specification,
    )  # fmt: skip
    report = cg.check(replace(certificate, problem=problem), problem)
    assert not report and "a turn further on" in str(report)


def test_paths_that_may_be_half_a_turn_off_are_refused(on_path: Any) -> None:
    path = on_path.certificate.proof.paths[0]
    strips = path.strips.copy()
    strips[2, 1] = np.inf
    forged = changed(on_path.certificate, paths=(replace(path, strips=strips),))
    assert not cg.check(forged, ship())


def test_a_jump_of_a_turn_and_another_copy_are_refused(on_path: Any) -> None:
    certificate, path = on_path.certificate, on_path.certificate.proof.paths[0]
    states = path.states.copy()
    states[3:, 1] += 1.0
    assert not cg.check(changed(certificate, paths=(replace(path, states=states),)), ship())
    # The region that is passed is met where the path ends, a turn below.
    letters = -np.abs(certificate.proof.letters)
    assert not cg.check(changed(certificate, letters=letters, faces=np.where(letters < 0, 2, -1)), ship())


def test_a_controller_that_does_not_wrap_is_found_out_by_rollouts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Around the end of a turn half of all runs are on either side."""
    agent = cg.Agent(**{**ROTOR, "noise": [{"law": "gaussian", "std": 0.05}]})
    problem = cg.Problem(
        name="stay", horizon=6, agents=[agent], propositions={"west": cg.Proposition("rotor", heading=WEST)},
        specification=cg.Specification("F G west", "finite-trace"),
    )  # fmt: skip
    result = cg.synthesize(problem, relation="path")
    assert result.certificate.lower_bound > 0.99 and cg.check(result.certificate, problem)
    assert cg.validate(result, 5_000, seed=1, confidence=1.0 - 1e-6).ci_high >= result.certificate.lower_bound
    monkeypatch.setattr(path_controller, "wrapped", lambda x, low: x)
    assert cg.validate(result, 5_000, seed=1, confidence=1.0 - 1e-6).ci_high < result.certificate.lower_bound


def test_what_knows_no_windings_says_so(on_grid: Any, around: cg.Problem) -> None:
    with pytest.raises(ValueError, match="knows no masses over windings"):
        shield_of(on_grid, 0.5)
    with pytest.raises(ValueError, match="which wraps; ask for `boxes` or `path`"):
        cg.synthesize(around, 40, relation="linear")
