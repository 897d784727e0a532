"""A claim that stands in balls stands in exact arithmetic: all of it is computed once more, every rounding counted."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.synthesis.checking import check_rigorous
from test_controllers_carry_out_what_is_certified import ordinary

flint = pytest.importorskip("flint")

from certigym.synthesis.checking import rigorous  # noqa: E402
from certigym.synthesis.checking.ball_facts import decimal, facts_of  # noqa: E402


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


def test_the_command_line_proves_and_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "own.npz"
    cg.save_certificate(synthesized("reach-avoid-v0", 40), file)
    assert main(["check", str(file), "--rigorous"]) == 0
    assert "proved in balls" in capsys.readouterr().out
    cg.save_certificate(synthesized("reach-avoid-v0", 40, value="train"), file)
    assert main(["check", str(file), "--rigorous"]) == 2
