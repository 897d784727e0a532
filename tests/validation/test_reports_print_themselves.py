"""Reports print themselves in plain English, shortly as `repr`, and as small escaped tables in notebooks."""

from __future__ import annotations

from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.baselines import IdleController, RandomController
from certigym.synthesis.certificates import Synthesis
from certigym.validation.audits import AuditReport
from certigym.validation.audits.audit_report import Finding
from certigym.validation.policies import Comparison
from certigym.validation.simulation import Loop, Rollouts, html_table, labelled_lines
from certigym.validation.statistics import CONFIRMED, CONSISTENT, REFUTED
from certigym.validation.verdicts import FieldReport, StressReport, ValidationReport, tried_lines
from problems import scalar_agent

MOST_CHARACTERS, MOST_LINES = 1500, 12
EPISODES = 200


def pairs(n: int) -> cg.Problem:
    """Every pair of agents has to meet: `n` independent tasks."""
    meetings = " & ".join(f"F (goal_left_{k} & goal_right_{k})" for k in range(n))
    return cg.Problem(
        name="<b>pairs & more</b>",
        horizon=2,
        agents=[scalar_agent(f"{side}_{k}") for k in range(n) for side in ("left", "right")],
        propositions={f"goal_{side}": cg.Proposition(f"{side}_*", [0.0], [1.0]) for side in ("left", "right")},
        specification=cg.Specification(meetings, "finite-trace"),
    )


@pytest.fixture(scope="module")
def small() -> Synthesis:
    return cg.synthesize(cg.make_problem("reach-avoid-v0", horizon=4, initial_state=[-10.0, -3.0]), 40)


@pytest.fixture(scope="module")
def large() -> Synthesis:
    return cg.synthesize(pairs(20), 30)


def reports(result: Synthesis) -> list[Any]:
    """One report of every kind about a synthesis."""
    problem = result.certificate.problem
    starts = np.concatenate([agent.initial.low for agent in problem.agents])
    policies = {f"idle {k}": IdleController() for k in range(10)} if not problem.groups else {}
    comparison = cg.compare(problem, {"certified": result, **policies}, EPISODES)
    return [
        cg.validate(result, EPISODES),
        cg.validate(result, EPISODES, mismatch=cg.Mismatch(noise_scale=1.5)),
        cg.validate_field(result, [starts] * 3, 20),
        cg.audit(result, EPISODES),
        cg.stress(result, EPISODES),
        comparison,
        comparison.entries[0],
        cg.rollout(problem, result, EPISODES),
        Loop(problem, result.controller, 0, starts=np.array([starts] * 3)),
    ]


class Table(HTMLParser):
    """Counts rows and cells; every tag has to be closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows: list[int] = []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.open.append(tag)
        if tag == "tr":
            self.rows.append(0)
        if tag in ("td", "th"):
            self.rows[-1] += 1

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.parametrize("size", ["small", "large"])
def test_every_report_is_short(size: str, request: pytest.FixtureRequest) -> None:
    for record in reports(request.getfixturevalue(size)):
        text = repr(record)
        assert 0 < len(text) <= MOST_CHARACTERS and len(text.splitlines()) <= MOST_LINES, text
        assert "array(" not in text and max(map(len, text.splitlines())) <= 200, text
        if isinstance(record, ValidationReport | FieldReport | AuditReport | StressReport | Comparison):
            table = record._repr_html_()
            assert len(table) <= 3 * MOST_CHARACTERS and "<b>" not in table, table
            assert len(set(Table(table).rows)) == 1, table


def test_a_page_prints_what_it_shows(small: Synthesis, tmp_path: Path) -> None:
    content = cg.report(small, tmp_path / "page.html", EPISODES)
    assert repr(content).splitlines()[0] == "ReportContent: reach-avoid-v0, horizon 4"
    assert "check      valid" in repr(content) and len(repr(content)) < MOST_CHARACTERS


def test_a_training_prints_what_it_learned() -> None:
    pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")
    training = cg.train(cg.make_problem("reach-avoid-v0", horizon=3), "ppo", 512, worlds=16)
    text = repr(training)
    assert text.startswith("Training of 'ppo' on 'reach-avoid-v0'\n") and "own state, automaton state, time" in text
    assert "layers of 64 x 64 x 1 numbers, tanh" in text and len(text.splitlines()) <= 5


def test_a_validation_reads_like_english(small: Synthesis) -> None:
    report = replace(cg.validate(small, EPISODES), seconds={"abstract": None, "synthesize": 1.0, "validate": 0.25})
    details = {"abstract_upper_bound": 0.25, "continuous_upper_bound": 0.5, "unilateral_gain": 0.0}
    shown = replace(report, lower_bound=0.125, gap=None, details={**report.details, **details, "inadmissible": 1})
    words = str(shown)
    for line in (
        "problem       reach-avoid-v0, horizon 4, from the initial state",
        "certified     P >= 0.1250",
        "these models  no policy of these finite models does better than 0.250000",
        "any policy    no policy of the continuous system does better than 0.500000",
        "alone         no single agent can gain more than about 0 by changing one step",
        "inputs        inadmissible in 1 episode; there actuators saturated",
        "times         synthesize 1.00 s, validate 0.25 s",
    ):
        assert line in words, words
    assert "interrupted" not in words and "mismatch" not in words
    certain = replace(shown, details={**shown.details, "continuous_upper_bound": 1.0, "interrupted": True})
    assert "any policy" not in str(certain) and "interrupted   by Ctrl-C; this is about the episodes" in str(certain)
    for verdict, meaning in ((CONFIRMED, "if the claim were false"), (REFUTED, "if the claim were true")):
        assert f"verdict       {verdict}: such rollouts would be unlikely {meaning}" in str(
            replace(shown, verdict=verdict)
        )
    assert "neither confirm nor refute" in str(replace(shown, verdict=CONSISTENT))
    sequential = cg.validate(small, EPISODES, sequential=True)
    assert ", tested after every episode: " in str(sequential)


def test_relations_are_told_only_where_there_was_a_choice() -> None:
    searched: dict[str, Any] = {"exact": 0.5, "tube": "at most 0.25, not computed", "paper": "x " * 200}
    exact, tube, paper = tried_lines({"tried": searched})
    assert exact.startswith("exact: P >= 0.5") and tube == "tube: passed over, it certifies at most 0.25"
    assert paper.startswith("paper: x x") and len(paper) < 120
    assert tried_lines({"tried": {"a": 0.5, "b": "2.9e-09 after one sweep, not gone on with"}})[1] == (
        "b: given up after one sweep, which reached 2.9e-09"
    )
    assert tried_lines({"tried": {"exact": 0.9999, "tube": "at most 1.000000, not computed"}}) == []
    assert tried_lines({}) == []


def test_an_audit_names_time_state_and_agent(small: Synthesis) -> None:
    finding = Finding(3, "q1", 300, -0.0125, 20.0, 1e-6, "agent_0", "p1", 120, -0.025, 15.0, 0)
    assert str(finding) == (
        "at time 3 in task state q1 the value changes by -0.0125 on average over 300 episodes (adjusted p = 1e-06); "
        "most of it is due to agent_0 in p1 (-0.025 over 120 episodes)"
    )
    assert "guards or labels are wrong in 7 of them" in str(replace(finding, contradictions=7))
    audit = cg.audit(small, EPISODES)
    assert "verdict       consistent: nothing contradicts the certificate" in str(audit)
    wrong = replace(audit, findings=(finding,) * 20, interrupted=True)
    assert str(wrong).count("finding       at time 3") == 8 and "findings      12 more" in str(wrong)
    assert "contradict the certificate" in str(wrong) and "interrupted" in str(wrong)
    assert len(repr(wrong)) <= MOST_CHARACTERS and len(repr(wrong).splitlines()) <= MOST_LINES


def test_fields_and_stress_tests_say_where(small: Synthesis) -> None:
    field = cg.validate_field(small, [[-10.0, -3.0], [-19.0, -3.0]], 50)
    assert str(field).startswith(
        "field         2 initial states, 100 episodes in all\nrefuted       at 0 states (0.0 %)"
    )
    assert "weakest       at (" in str(field) and "verdict       " in str(field)
    assert "interrupted   by Ctrl-C" in str(replace(field, interrupted=True))
    windy = {"wind": [cg.Mismatch(noise_scale=1.01), cg.Mismatch(noise_scale=500.0)], "calm": [cg.Mismatch()]}
    stressed = cg.stress(small, 2000, ladders=windy)
    assert "survived      wind: up to noise_scale=1.01" in str(stressed) and "survived      calm: every rung" in str(
        stressed
    )
    assert str(stressed).count("episodes per mismatch") == 1


def test_a_comparison_is_a_table(small: Synthesis) -> None:
    problem = small.certificate.problem
    comparison = cg.compare(problem, {"certified": small, "random": [RandomController(), IdleController()]}, EPISODES)
    text = str(comparison)
    assert text.startswith(
        f"reach-avoid-v0, horizon 4: {EPISODES} episodes per policy, common random numbers (seed 0)\n"
    )
    assert "certified against random (seed 0): " in text and " episodes won by the first alone, " in text
    assert "random: mean " in text and "Entry 'certified'\n|-- success" in repr(comparison.entries[0])
    assert "seconds" not in repr(comparison.entries[1]) and "certified" not in repr(comparison.entries[1])


def test_the_pieces_of_these_texts() -> None:
    assert labelled_lines([("these models", "x"), ("a", "y")]) == "these models  x\na             y"
    table = html_table("<i>", [("a&b", "1", "<"), ("c", "2", ">")], ("h", "i", "j"))
    assert Table(table).rows == [3, 3, 3] and "<i>" not in table and "a&amp;b" in table
    rollouts = Rollouts(np.array([True, False]), 3, 100, inadmissible=1)
    assert repr(rollouts).splitlines() == [
        "Rollouts: 2 episodes",
        "|-- satisfied  1, a share of 0.500000",
        "|-- seed       3, 100 worlds per chunk",
        "`-- inputs     inadmissible in 1 episode (they saturated)",
    ]
