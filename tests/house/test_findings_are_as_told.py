"""The findings of docs/field_audit.md come out as its page tells them."""

from __future__ import annotations

from pathlib import Path

import pytest

import field_findings

ROOT = Path(__file__).parents[2]

pytestmark = pytest.mark.thorough


@pytest.fixture(autouse=True)
def at_the_root(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def test_corners_do_not_enclose_the_mean() -> None:
    _, corners, inside, enclosure = field_findings.samples()
    reached, most = float(inside.split(": ")[1].split(",")[0]), float(enclosure.split()[-1])
    assert float(corners.split()[-1]) + 0.007 < reached <= most
    page = (ROOT / "docs" / "field_audit.md").read_text(encoding="utf-8")
    assert corners.split()[-1] in page and enclosure.split()[-1] in page


@pytest.mark.thorough
def test_whole_numbers_leave_no_noise() -> None:
    """Of 20,000 rollouts each: with no noise all succeed; with noise far fewer (a false alarm is past 1e-6)."""
    first, stated, none = field_findings.rooms()
    assert "in C++: 0" in first
    assert "1.0000 of 20000" in none and ", 0.7" in stated


@pytest.mark.thorough
def test_the_two_oscillators_differ() -> None:
    run, meant = (float(line.split(": ")[1].split()[0]) for line in field_findings.oscillator())
    assert run > meant + 0.3
