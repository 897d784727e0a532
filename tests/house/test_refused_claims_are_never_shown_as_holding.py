"""Whoever prints a bound asks the check first: a claim that it refuses is called one, in words, status and JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import certigym as cg
from certigym.baselines import Sources
from certigym.cli.main import main
from certigym.synthesis.certificates.proofs import OnGrid, changed
from certigym.synthesis.policy_search.bounds.certified import Bound, nominal_bound
from certigym.synthesis.policy_search.cell_certificates import agreement, certification
from certigym.validation.policies import page_of
from certigym.validation.policies.actors import save_actor
from certigym.validation.policies.tier_rule import known_of
from kinds import mostly_thorough
from network_problems import proportional

PROBLEM = cg.make_problem("reach-avoid-v0").replace(horizon=3)
QUICK = ["--episodes", "100"]
NOT = "claimed, NOT valid: the bound 0.9"


@pytest.fixture
def boastful(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that claims .9 more than it proves."""

    def boasting(*arguments: Any, **named: Any) -> Bound:
        honest = nominal_bound(*arguments, **named)
        return Bound(honest.name, min(0.999, honest.lower + 0.9))

    monkeypatch.setattr(certification, "nominal_bound", boasting)


@pytest.fixture
def files(tmp_path: Path) -> dict[str, str]:
    """An honest certificate of a problem of the suite, a forged one, and a network."""
    problem = cg.make_problem("reach-avoid-v0")
    honest: OnGrid = cg.synthesize(problem, 20, relation="exact", above=False).certificate
    forged = changed(honest, lower_bound=0.9999, gap=None, bounds={"nominal": 0.9999})
    places = {"honest": tmp_path / "h.npz", "forged": tmp_path / "reach-avoid-v0.npz", "actor": tmp_path / "a.npz"}
    cg.save(honest, places["honest"])
    cg.save(forged, places["forged"])
    save_actor(proportional(problem), places["actor"])
    return {name: str(place) for name, place in places.items()}


def named(files: dict[str, str], words: list[str]) -> list[str]:
    return [files.get(word, word) for word in words]


@pytest.mark.thorough
def test_results_carry_the_verdict(boastful: None, monkeypatch: pytest.MonkeyPatch) -> None:
    several = cg.synthesize(PROBLEM, 20, relation="exact", horizon=[1, 2])
    actor = proportional(PROBLEM)
    for found in (
        cg.synthesize(PROBLEM, 20, relation="exact"),
        *several,
        cg.certify(PROBLEM, actor, 20, relation="exact"),
        cg.certify(PROBLEM, actor, 20),
        cg.improve(PROBLEM, actor, 20, relation="exact", search=cg.SearchOptions(max_sweeps=1)),
    ):
        assert found.checked is not None and not found.checked
        assert NOT in repr(found) and NOT in found._repr_html_()
        with pytest.raises(ValueError, match="refuses"):
            cg.shield(PROBLEM, found, probability=0.1)
    report = cg.validate(found, 100)
    assert report.is_invalid and "certified  " not in str(report)

    def broken_off(certificate: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(agreement, "checked_once", broken_off)
    found = cg.synthesize(PROBLEM, 20, relation="exact")
    assert found.checked is None and "claimed, not checked" in repr(found)


def test_results_that_hold_are_told_as_before() -> None:
    found = cg.synthesize(PROBLEM, 20, relation="exact")
    assert found.checked and "claimed" not in repr(found)
    assert cg.validate(found, 100).details["check"] == {"valid": True, "failures": []}


COMMANDS = [
    ["synthesize", "reach-avoid-v0", "--cells", "20", "--relation", "exact", "--out", "new.npz"],
    ["run", "reach-avoid-v0", "--cells", "20", "--relation", "exact", *QUICK],
    ["run", "reach-avoid-v0", "--cells", "20", "--relation", "exact", "--horizon", "2", "3", *QUICK],
    ["certify", "actor", "--cells", "20", "--relation", "exact", "--improve", *QUICK],
    ["certify", "actor", "--cells", "20", *QUICK],
]


@mostly_thorough("words", COMMANDS, first=2, ids=lambda words: " ".join(words[:6]))
def test_commands_that_make_a_bound_end_with_status_1(
    boastful: None, files: dict[str, str], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(tmp_path / word) if word == "new.npz" else word for word in named(files, words)]
    assert main([*words, "--json", str(tmp_path / "r.json")]) == 1
    printed = capsys.readouterr().out
    assert NOT in printed or "invalid" in printed
    assert "holds for the deployed network" not in printed and "bounds hold" not in printed
    told = json.loads((tmp_path / "r.json").read_text())
    assert "exceeds the recomputed value" in json.dumps(told)
    for entry in told.get("entries", []) if isinstance(told, dict) else []:
        assert entry["lower_bound"] is None


READING = [
    ["validate", "forged", *QUICK],
    ["validate-field", "forged", "--random", "2", "--episodes", "20"],
    ["audit", "forged", *QUICK],
    ["stress", "forged", "--episodes", "20"],
    ["compare", "reach-avoid-v0", "--policies", "forged,random", *QUICK],
]


@pytest.mark.parametrize("words", READING, ids=lambda words: words[0])
def test_commands_that_read_a_file_check_it(
    files: dict[str, str], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replaced = [word.replace("forged", files["forged"]) for word in words]
    assert main([*replaced, "--json", str(tmp_path / "r.json")]) == 1
    assert "the bound 0.9999 exceeds the recomputed value" in capsys.readouterr().out.splitlines()[0] + json.dumps(
        json.loads((tmp_path / "r.json").read_text())
    )
    replaced = [word.replace("forged", files["honest"]) for word in words]
    assert main(replaced) == 0
    assert "NOT valid" not in capsys.readouterr().out


def test_leaderboards_have_no_bound_of_a_forged_file(files: dict[str, str], tmp_path: Path) -> None:
    board = cg.leaderboard(["reach-avoid-v0"], ["certified"], 200, sources=Sources(tmp_path))
    (row,) = board.rows
    assert (
        row.lower_bound is None and row.refused is not None and row.refused.startswith("claimed, NOT valid: the bound")
    )
    assert known_of(board.rows) == row.low
    assert "| claimed, NOT valid |" in page_of(board) and ".9999" not in page_of(board)
    words = ["leaderboard", "reach-avoid-v0", "--policies", "certified", "--episodes", "200"]
    assert main([*words, "--certificates", str(tmp_path), "--out", str(tmp_path / "board.html")]) == 1
    with pytest.raises(ValueError, match="refuses"):
        cg.probe("reach-avoid-v0", files["forged"], steps=100)
