"""The leaderboard reads what is there, makes what is missing, judges all by the same episodes, and goes on."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import certigym as cg
from certigym.baselines import Leaderboard, RandomController, Sources
from certigym.cli.main import main
from certigym.synthesis.certificates.proofs import shown_bound
from certigym.synthesis.verbs.as_it_is import AsItIs
from certigym.validation.policies import page_of, publish, ranking, replayed
from certigym.validation.policies.ranking import judging_plan
from certigym.validation.statistical_tests import clopper_pearson, planned

RA2 = cg.make_problem("reach-avoid-v0")
POLICY = """
def towards(x, q, t):
    return -x
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the certificate of the small problem."""
    place: Path = tmp_path_factory.mktemp("certificates")
    cg.save(cg.synthesize(RA2, 60, relation="exact").certificate, place / "reach-avoid-v0.npz")
    return place


def test_rows_hold_what_rollouts_say(folder: Path) -> None:
    board = cg.leaderboard(["reach-avoid-v0"], ["certified", "random"], 500, sources=Sources(folder), seed=4)
    plan = judging_plan(planned(500, {"seed": 4}, 500))
    assert plan.seed != 4, "judging has episodes of its own"
    held = cg.load(folder / "reach-avoid-v0.npz")
    for row, policy in zip(board.rows, (held, RandomController()), strict=True):
        successes = cg.rollout(RA2, policy, plan).successes
        assert row.successes == (successes,) and row.rate == successes / 500
        assert (row.low, row.high) == clopper_pearson(successes, 500, 0.999)
    assert board.rows[0].lower_bound == held.lower_bound and board.rows[1].lower_bound is None


def test_a_leaderboard_goes_on_and_an_older_problem_does_not_count(folder: Path) -> None:
    seen: list[str] = []
    options: dict[str, Any] = {"sources": Sources(folder), "finished": lambda _, row: seen.append(row.policy)}
    first = cg.leaderboard(["reach-avoid-v0"], ["random"], 200, **options)
    more = cg.leaderboard(["reach-avoid-v0"], ["random", "certified"], 200, board=first, **options)
    assert seen == ["random", "certified"] and [row.policy for row in more.rows] == ["certified", "random"]
    stale = Leaderboard((replace(first.rows[0], fingerprint="older"),))
    again = cg.leaderboard(["reach-avoid-v0"], ["random"], 200, board=stale, **options)
    assert again.rows == first.rows and seen[-1] == "random" and len(seen) == 3
    assert len(repr(more).splitlines()) <= 4
    with pytest.raises(ValueError, match="`policies`: expected 'certified', 'ppo'"):
        cg.leaderboard(["reach-avoid-v0"], ["best"], 200)


def test_the_command_writes_page_and_json_and_takes_a_submission(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, own = tmp_path / "board.md", tmp_path / "own.py"
    own.write_text(POLICY)
    words = ["leaderboard", "reach-avoid-v0", "--out", str(page), "--episodes", "200"]
    assert main([*words, "--policies", "certified,random", "--certificates", str(folder)]) == 0
    assert main([*words, "--add", f"mine={own}:towards"]) == 0
    assert "reach-avoid-v0: mine " in capsys.readouterr().out
    board = Leaderboard.load(page.with_suffix(".json"))
    assert board.policies == ("certified", "mine", "random")
    text = page.read_text()
    assert text == page_of(board) and "| id | at least | tier | left | certified | mine | random |" in text
    assert main([*words, "--add", f"certified={own}:towards"]) == 2
    assert main([*words, "--add", "mine"]) == 2
    (tmp_path / "other.json").write_text(json.dumps({"rows": [1]}))
    with pytest.raises(ValueError, match="expected the JSON of a leaderboard"):
        Leaderboard.load(tmp_path / "other.json")


def test_printed_bounds_hold(folder: Path) -> None:
    row = cg.leaderboard(["reach-avoid-v0"], ["certified"], 200, sources=Sources(folder)).rows[0]
    text = page_of(Leaderboard((replace(row, lower_bound=0.99999, low=0.99999, high=0.00001),)))
    assert "| 0.9999 |" in text and "[0.9999, 0.0001]" in text


@pytest.fixture(scope="module")
def actors(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with actors of two learners, trained for a moment."""
    pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")
    place: Path = tmp_path_factory.mktemp("actors")
    for algorithm, seed in (("ppo", 0), ("ppo", 1), ("sac", 0)):
        training = cg.train(RA2, algorithm, 256, seed, worlds=8, hidden=[8])
        publish(training, place / "reach-avoid-v0" / algorithm / f"seed-{seed}.npz")
    return place


def test_published_actors_are_read_and_judged_again(
    actors: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "board.md"
    bounds = iter([AsItIs(0.25), AsItIs(0.75), AsItIs(None, "wide tube", "...")])
    monkeypatch.setattr(ranking, "as_it_is", lambda problem, actor, seconds: next(bounds))
    words = ["leaderboard", "reach-avoid-v0", "--out", str(page), "--episodes", "300", "--learners", str(actors)]
    assert main([*words, "--policies", "ppo", "--train-seeds", "0", "1"]) == 0
    assert main([*words, "--policies", "sac"]) == 0
    board = Leaderboard.load(page.with_suffix(".json"))
    assert [(row.policy, row.seeds) for row in board.rows] == [("ppo", (0, 1)), ("sac", (0,))]
    assert all(row.steps and row.seconds is not None and row.steps >= 256 * len(row.seeds) for row in board.rows)
    assert [row.as_it_is for row in board.rows] == [(0.25, 0.75), ("wide tube",)]
    assert f"| {shown_bound(0.75, None)} | wide tube |" in page.read_text()
    capsys.readouterr()
    assert main([*words, "--replay"]) == 0
    assert capsys.readouterr().out.count("the same episodes succeed as recorded") == 2
    assert [row.successes for row in replayed(actors, ["reach-avoid-v0"], 300).rows] == [
        row.successes for row in board.rows
    ]
    # A record that the actors do not reach is found out.
    table = json.loads(page.with_suffix(".json").read_text())
    table["rows"][0] |= {"successes": [300, 300], "low": 0.98, "high": 1.0}
    page.with_suffix(".json").write_text(json.dumps(table))
    assert main([*words, "--replay"]) == 1 and "OUTSIDE" in capsys.readouterr().out
    assert main([*words[:-1], str(tmp_path / "nowhere"), "--replay"]) == 2


def test_learners_are_made_within_their_budget_of_steps_and_kept(
    actors: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ranking, "SECONDS", 0.1)
    sources = Sources(learners=tmp_path, steps=64, seeds=(3,))
    (row,) = cg.leaderboard(["reach-avoid-v0"], ["ppo"], 100, sources=sources).rows
    path = tmp_path / "reach-avoid-v0" / "ppo" / "seed-3.npz"
    assert row.as_it_is == ("time",) and row.seeds == (3,) and row.steps is not None and 64 <= row.steps <= 512
    before = path.stat().st_mtime_ns
    assert cg.leaderboard(["reach-avoid-v0"], ["ppo"], 100, sources=sources).rows[0].successes == row.successes
    assert path.stat().st_mtime_ns == before
