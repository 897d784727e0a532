"""A claim of 0 is vacuous wherever a verdict is given, and what fails its check is never called proved."""

from __future__ import annotations

from pathlib import Path

import pytest

import certigym as cg
from certigym.cli.colors import colored
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
