"""A claim of 0 is vacuous wherever a verdict is given, and what fails its check is never called proved."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import certigym as cg
from certigym.cli.colors import colored
from certigym.cli.main import main
from certigym.synthesis.certificates.proofs import CheckReport, OnGrid, changed
from certigym.validation.statistical_tests import CONFIRMED, REFUTED, VACUOUS, stress, validate_field, verdict


@pytest.fixture(scope="module")
def sound() -> OnGrid:
    return cg.synthesize(cg.make_problem("reach-avoid-v0", horizon=2), 40, relation="exact").certificate


@pytest.fixture(scope="module")
def empty(sound: OnGrid) -> OnGrid:
    """The same certificate, of which nothing is claimed at the start."""
    return changed(sound, lower_bound=0.0, gap=None)


@pytest.fixture(scope="module")
def broken(sound: OnGrid) -> OnGrid:
    """A claim that is too high for its own tables, but within the limits of few rollouts."""
    return changed(sound, lower_bound=sound.lower_bound + 0.003, gap=None)


def test_a_bound_of_0_is_vacuous_and_its_upper_end_may_be_refuted() -> None:
    assert verdict(0.0, None, 0.5, 0.6) == VACUOUS
    assert verdict(0.0, 0.9, 0.5, 0.6) == VACUOUS
    assert verdict(0.0, 0.1, 0.5, 0.6) == REFUTED
    assert verdict(1e-9, None, 0.5, 0.6) == CONFIRMED


def test_every_report_about_a_claim_of_0_says_so(empty: OnGrid, tmp_path: Path) -> None:
    content = cg.report(empty, tmp_path / "page.html", 500, checked=CheckReport(True, 0.0, 0.0, ()))
    audit = cg.audit(empty, 200)
    rungs = stress(empty, 200).rungs
    found = [
        cg.validate(empty, 500).verdict,
        cg.validate(empty, 500, sequential=True).verdict,
        content.validation.verdict,
        content.to_dict()["verdict"],
        audit.to_dict()["verdict"],
        *(rung.verdict for rung in rungs),
    ]
    assert set(found) == {VACUOUS}
    assert "vacuous" in str(cg.compare(empty.problem, {"own": empty}, 200))
    page = (tmp_path / "page.html").read_text()
    assert "which says nothing" in page and "proved for the model" not in page
    assert stress(empty, 200).survives("delay") is None


def test_maps_do_not_confirm_where_nothing_is_claimed(sound: OnGrid) -> None:
    """From x1 = 15 no policy is in the target after two steps."""
    field = validate_field(sound, [[15.0, 5.0], [-5.0, -4.0]], 200)
    assert field.lower_bounds[0] == 0.0 < field.lower_bounds[1]
    assert field.vacuous.tolist() == [True, False] and not field.confirmed[0]
    alone = validate_field(sound, [[15.0, 5.0]], 200)
    assert alone.verdict == VACUOUS and alone.to_dict()["fraction_vacuous"] == 1.0


def test_a_failed_check_is_the_headline_of_reports_and_pages(broken: OnGrid, tmp_path: Path) -> None:
    outcome = cg.check(broken)
    assert not outcome
    report = cg.validate(broken, 300).with_check(outcome)
    first = str(report).splitlines()[1]
    assert first.startswith("invalid") and "nothing is certified" in first
    assert "\ncertified " not in str(report) and "\nverdict       invalid" in str(report)
    assert colored(first).startswith("\033[31m")
    assert report.to_dict()["check"]["valid"] is False
    content = cg.report(broken, tmp_path / "page.html", 300, checked=outcome)
    page = (tmp_path / "page.html").read_text()
    assert content.refuted and content.verdict == "invalid"
    assert "is-invalid" in page and "Not certified" in page and "proved for the model" not in page
    assert page.index("Not certified") < page.index("Separate check")


def test_the_command_fails_with_the_check(broken: OnGrid, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "c.npz"
    cg.save(broken, file)
    assert main(["report", str(file), "--out", str(tmp_path / "p.html"), "--episodes", "300"]) == 1
    assert "nothing is certified" in capsys.readouterr().out


def test_advice_speaks_of_cells_only_where_there_are_some() -> None:
    """Certificates along a path have none; with few cells a grid is advised to have more."""
    agent = cg.LinearAgent(
        name="robot", A=[[1.0]], B=[[1.0]], noise_covariance=[[0.04]], state_low=[-3.0], state_high=[3.0],
        input_low=[-1.0], input_high=[1.0], initial_state=[-1.0],
    )  # fmt: skip
    problem = cg.Problem(
        name="one", horizon=3, agents=[agent], propositions={"g": cg.Proposition("robot", [0.4], [1.6])},
        specification=cg.Specification("X[3] g", "finite-trace"),
    )  # fmt: skip
    for relation, has_cells in (("path", False), ("exact", True)):
        certificate = cg.synthesize(problem, None if relation == "path" else 9, relation=relation).certificate
        report = cg.validate(certificate, 5000)
        loose = replace(report, lower_bound=0.1, gap=None, verdict="confirmed")
        assert report.details["has_cells"] is has_cells
        assert ("--cells" in str(loose)) is has_cells
