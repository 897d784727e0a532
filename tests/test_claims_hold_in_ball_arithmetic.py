"""A claim that stands in balls stands in exact arithmetic: all of it is computed once more, every rounding counted."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from inspect import get_annotations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.synthesis.certificates import AgentPart
from certigym.synthesis.checking import check_rigorous
from test_controllers_carry_out_what_is_certified import ordinary

flint = pytest.importorskip("flint")

from certigym.synthesis.checking import rigorous  # noqa: E402
from certigym.synthesis.checking.ball_facts import decimal, facts_of, unreached  # noqa: E402


def synthesized(name: str, cells: int, **options: Any) -> Any:
    problem = cg.make_problem(name)
    problem = problem.replace(horizon=options.pop("horizon", min(6, problem.horizon)))
    return cg.synthesize(problem, cells, **options).certificate


KINDS: dict[str, tuple[str, int, dict[str, Any]]] = {
    "scalar agents": ("reach-avoid-v0", 60, {}),
    "a tube": ("reach-avoid-v0", 100, {"relation": "tube"}),
    "a tube in the plane": ("car-park-planar-v0", 24, {"relation": "tube", "horizon": 20}),
    "independent tasks": ("invariance-4-v0", 40, {}),
    "twenty agents": ("reach-avoid-20-v0", 40, {"relation": "exact"}),
}


@pytest.mark.parametrize("kind", KINDS)
def test_honest_claims_stand(kind: str) -> None:
    name, cells, options = KINDS[kind]
    certificate = synthesized(name, cells, **options)
    plain, report = cg.check(certificate), check_rigorous(certificate)
    assert plain and report and report.low > 0.1, (plain, report)
    assert report.low <= report.high <= report.low + 1e-13
    # The allowances of double precision are on the safe side of the truth, and near it.
    assert certificate.lower_bound <= report.low
    assert plain.recomputed == pytest.approx(report.low, abs=1e-8)


def test_coupled_axes_stand() -> None:
    certificate = cg.synthesize(ordinary(), 24, relation="exact").certificate
    report = check_rigorous(certificate)
    assert report and report.low == pytest.approx(certificate.lower_bound, abs=1e-8) and report.low > 0.5


def test_a_start_box_is_averaged_in_balls() -> None:
    agent = cg.LinearAgent(
        name="robot", A=[[0.9]], B=[[1.0]], noise_covariance=[[0.04]], state_low=[-1.0], state_high=[1.0],
        input_low=[-0.5], input_high=[0.5], initial_low=[-0.3], initial_high=[0.7],
    )  # fmt: skip
    problem = cg.Problem(
        name="box",
        horizon=3,
        agents=[agent],
        propositions={"goal": cg.Proposition("robot", [0.2], [0.6])},
        specification=cg.Specification("F goal", "co-safe"),
    )
    certificate = cg.synthesize(problem, 30).certificate
    report = check_rigorous(certificate)
    assert report and report.low == pytest.approx(certificate.lower_bound, abs=1e-8)


def test_masses_are_those_of_the_normal_law() -> None:
    mpmath = pytest.importorskip("mpmath")
    certificate = synthesized("reach-avoid-v0", 60)
    part, agent = certificate.agents[0], certificate.problem.agents[0]
    variance = agent.noise_covariance[0, 0]
    kernel = rigorous._Kernel(part, np.array([own.sqrt() for own in decimal([variance])]))
    edges = part.grid.edges[0]
    with mpmath.workdps(40):
        deviation = mpmath.sqrt(mpmath.mpf(repr(float(variance))))
        for point in (0, len(part.lattice[0]) // 2):
            z = mpmath.mpf(repr(float(part.lattice[0][point])))
            for cell, mass in enumerate(kernel.row(0, point)):
                ends = [mpmath.mpf(repr(float(e))) for e in edges[cell : cell + 2]]
                true = mpmath.ncdf((ends[1] - z) / deviation) - mpmath.ncdf((ends[0] - z) / deviation)
                assert abs(mpmath.mpf(mass.mid().str(35, radius=False)) - true) < mpmath.mpf("1e-20")


def test_a_claim_above_the_ball_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    certificate = synthesized("reach-avoid-v0", 60)
    top = check_rigorous(certificate).high
    monkeypatch.setattr(rigorous, "check", lambda *_: cg.check(certificate))  # as if double precision let it pass
    for claimed, stands in ((certificate.lower_bound, True), (math.nextafter(top, 1.0), False), (top + 1e-9, False)):
        raised = replace(certificate, lower_bound=claimed, bounds={"nominal": claimed})
        assert bool(check_rigorous(raised)) == stands, claimed


@pytest.mark.parametrize("relation", ["exact", "tube"])
def test_inputs_and_tubes_are_judged_in_balls(relation: str) -> None:
    """Sabotage: a box that is smaller by a billionth, an agent that is less stable, noise of another size."""
    certificate = synthesized("reach-avoid-v0", 60, relation=relation)
    agent, part = certificate.problem.agents[0], certificate.agents[0]
    own = certificate.controller.agents[0].relation
    honest = facts_of(agent, part, own)
    assert honest.failures == () and honest.loss < 1e-9
    narrow = agent.replace(input_low=0.9 * agent.input_box.low, input_high=0.9 * agent.input_box.high)
    assert facts_of(narrow, part, own).failures
    moved = agent.replace(A=agent.A + 1e-7)
    assert facts_of(moved, part, own).loss > 1e-9


def test_what_balls_do_not_reach_is_refused_in_words() -> None:
    trains = synthesized("reach-avoid-v0", 40, value="train")
    with pytest.raises(ValueError, match=r"tensor trains"):
        check_rigorous(trains)
    lossy = synthesized("reach-avoid-v0", 40, relation="paper", epsilon=0.5, delta=0.5)
    with pytest.raises(ValueError, match=r"`exact` and `tube`"):
        check_rigorous(lossy)


def robot(**changes: Any) -> cg.Problem:
    """One agent that is to reach a goal and keep its workspace."""
    agent: dict[str, Any] = {
        "name": "robot", "A": [[0.9]], "B": [[1.0]], "state_low": [-1.0], "state_high": [1.0],
        "input_low": [-0.6], "input_high": [0.6], "initial_state": [-0.3],
    }  # fmt: skip
    return cg.Problem(
        name="laws",
        horizon=3,
        agents=[cg.LinearAgent(**agent, **changes)],
        propositions={"goal": cg.Proposition("robot", [0.2], [0.6])},
        specification=cg.Specification("F goal", "co-safe"),
    )


OTHER_LAWS: list[dict[str, Any]] = [
    {"law": "laplace", "scale": 0.1},
    {"law": "uniform", "low": -0.2, "high": 0.2},
    {"law": "triangular", "low": -0.2, "mode": 0.0, "high": 0.2},
    {"law": "logistic", "scale": 0.1},
    {"law": "student-t", "scale": 0.1, "df": 4.0},
    {"law": "truncated-gaussian", "spread": 0.2, "low": -0.3, "high": 0.3},
    {"law": "mixture", "parts": [{"weight": 1.0, "law": "gaussian", "std": 0.2}]},
]


@pytest.mark.parametrize("law", OTHER_LAWS, ids=lambda law: law["law"])
def test_laws_without_balls_are_refused_by_name(law: dict[str, Any]) -> None:
    """Sabotage: balls of the normal law of the same variance would speak of another system."""
    certificate = cg.synthesize(robot(noise=[law]), 40, relation="exact").certificate
    assert cg.check(certificate)
    with pytest.raises(ValueError, match=rf"normal noise, got other laws of agent `robot` \({law['law']}\)"):
        check_rigorous(certificate)
    # The facts about an agent refuse it, too, for whoever asks for them.
    agent, part = certificate.problem.agents[0], certificate.agents[0]
    assert isinstance(agent, cg.LinearAgent)
    with pytest.raises(ValueError, match="normal noise"):
        facts_of(agent, part, certificate.controller.agents[0].relation)


def test_normal_laws_given_by_their_deviation_are_proved() -> None:
    certificate = cg.synthesize(robot(noise=[{"law": "gaussian", "std": 0.2}]), 40, relation="exact").certificate
    report = check_rigorous(certificate)
    assert report and report.low == pytest.approx(certificate.lower_bound, abs=1e-8)


def test_states_without_noise_and_uneven_noise_are_refused() -> None:
    certificate = cg.synthesize(robot(noise_covariance=[[0.04]]), 40, relation="exact").certificate
    agent, part = certificate.problem.agents[0], certificate.agents[0]
    assert unreached(agent, part) is None
    assert "in every state" in str(unreached(agent.replace(noise_covariance=[[0.0]]), part))
    uneven = agent.replace()
    object.__setattr__(uneven, "noise_scale", ("1 + x0",))  # no linear agent has one today
    assert "noise_scale" in str(unreached(uneven, part))
    assert "expressions" in str(unreached(cg.make_problem("van-der-pol-v0").agents[0], part))


READ, LEFT_TO_CHECK, REFUSED = "read in balls", "answered by the check, which comes first", "refused unless plain"

FIELDS: dict[type, dict[str, str]] = {
    cg.LinearAgent: {
        "name": LEFT_TO_CHECK, "A": READ, "B": READ, "offset": READ, "noise_covariance": READ, "laws": REFUSED,
        "noise_axes": REFUSED, "noise_scale": REFUSED, "state_low": LEFT_TO_CHECK, "state_high": LEFT_TO_CHECK,
        "input_low": READ, "input_high": READ, "initial_low": READ, "initial_high": READ,
        "output_matrix": LEFT_TO_CHECK,
    },
    cg.Problem: {
        "name": LEFT_TO_CHECK, "agents": READ, "declared": LEFT_TO_CHECK, "specification": LEFT_TO_CHECK,
        "horizon": READ, "groups": LEFT_TO_CHECK, "propositions": LEFT_TO_CHECK, "families": LEFT_TO_CHECK,
        "labeling": LEFT_TO_CHECK, "_automaton": READ,
    },
    AgentPart: {
        "grid": READ, "coordinates": REFUSED, "relation": READ, "lattice": READ, "masks": READ, "start_masks": READ,
        "policy": READ, "menu": READ,
    },
    cg.Certificate: {
        "problem": READ, "method": LEFT_TO_CHECK, "bound": LEFT_TO_CHECK,
        "bounds": READ, "start": READ, "lower_bound": READ,
        "gap": LEFT_TO_CHECK, "exact": LEFT_TO_CHECK, "relative_rounding": LEFT_TO_CHECK, "agents": READ,
        "guard_source": LEFT_TO_CHECK, "guard_target": READ, "guard_mask": READ, "start_target": READ,
        "start_mask": READ, "skeleton": READ, "terms": LEFT_TO_CHECK, "rank": LEFT_TO_CHECK,
        "settings": LEFT_TO_CHECK, "rounding": REFUSED,
    },
}  # fmt: skip
"""What becomes of every field of what a certificate rests on. Guards, labels and workspaces are questions of comparing
numbers; terms, gap and the reserve for rounding belong to claims that balls do not speak of. All bounds are one where
relations are never lost."""


@pytest.mark.parametrize("record", FIELDS, ids=lambda record: record.__name__)
def test_no_field_is_left_out_in_silence(record: type) -> None:
    """A field that is added fails here until it is said whether balls read or refuse it."""
    names = {name for kind in record.__mro__ for name in get_annotations(kind)}
    assert names == {*FIELDS[record]}


def test_agents_with_lattices_of_their_own_are_judged_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sabotage: the second agent asks for targets beyond its inputs, on the cells and with the policy of the first."""
    certificate = synthesized("reach-avoid-20-v0", 40, relation="exact")
    first, second = certificate.agents[:2]
    shared = replace(second, grid=first.grid, policy=first.policy, relation=first.relation)
    honest = (first, replace(shared, lattice=first.lattice), *certificate.agents[2:])
    # All targets of the second agent move outside by the workspace's width; numbers of points stay.
    far = replace(shared, lattice=tuple(axis + 30.0 for axis in first.lattice))
    monkeypatch.setattr(rigorous, "check", lambda *_: cg.check(certificate))  # as if double precision let it pass
    for parts, wrong in ((honest, False), ((first, far, *certificate.agents[2:]), True)):
        report = check_rigorous(replace(certificate, agents=parts))
        assert any("beyond its input box" in text for text in report.failures) == wrong, report


def test_the_table_of_the_page_names_every_problem() -> None:
    """Each with what came out, or with the reason why it was refused or left out."""
    text = (Path(__file__).parents[1] / "docs" / "trusted-base.md").read_text(encoding="utf-8")
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if re.match(r"\| [\w-]+-v\d+ \|", line)]
    assert {row[0] for row in rows} == {*cg.problem_ids()}
    assert all(re.match(r"proved$|refused: |left out: |no relation ", row[-1]) for row in rows), rows


def test_joint_agents_are_proved_and_subtractions_refused() -> None:
    from pair_problems import followers

    joint: Any = cg.synthesize(followers("G !any(near)", ([-0.5], [0.5])), 24, relation="joint").certificate
    assert joint.base.agents[0].relation["kind"] == "exact"
    report = check_rigorous(joint)
    assert report and report.low == pytest.approx(joint.lower_bound, abs=1e-8), report
    subtracted = cg.synthesize(followers("G !any(near)", ([-0.5], [0.5])), 24, relation="exact").certificate
    with pytest.raises(ValueError, match="by subtraction, whose masses of near pairs have no balls"):
        check_rigorous(subtracted)
    # Sabotage: a team that is another one is refused before a ball is computed.
    other = replace(joint, problem=joint.problem.replace(disturbance_scale=0.5))
    assert not check_rigorous(other)


def test_the_command_line_proves_and_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "own.npz"
    cg.save_certificate(synthesized("reach-avoid-v0", 40), file)
    assert main(["check", str(file), "--rigorous"]) == 0
    assert "proved in balls" in capsys.readouterr().out
    cg.save_certificate(synthesized("reach-avoid-v0", 40, value="train"), file)
    assert main(["check", str(file), "--rigorous"]) == 2
