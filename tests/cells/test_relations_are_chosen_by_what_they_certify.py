"""By default relations are compared where more than one may be best: the largest bound is kept, all are reported."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.envs.tasks.problem import groups as independent
from certigym.synthesis.abstraction.models.joint import join, start_of
from certigym.synthesis.policy_search.ascent.relaxation import relax, upper_bound
from certigym.synthesis.relations.kinds import check_description
from certigym.synthesis.verbs.abstract import abstract
from certigym.validation.statistical_tests.binomial import REFUTED
from problems import cart, scalar_agent


def team(formula: str = "F (home & goal)", semantics: str = "co-safe") -> cg.Problem:
    """A scalar agent whose every mean can be commanded, and a cart with one input for two states."""
    regions = {"home": cg.Proposition("car", [1.0], [3.0]), "goal": cg.Proposition("cart", [0.0, -3.0], [5.0, 3.0])}
    return cg.Problem(
        name="mixed",
        horizon=5,
        agents=[scalar_agent("car"), cart()],
        propositions=regions,
        specification=cg.Specification(formula, semantics),
    )


CELLS = {"car": 60, "cart": 40}


@cache
def chosen() -> cg.Synthesis:
    return cg.synthesize(team(), CELLS, relation="best")


def tried_of(found: cg.Synthesis) -> dict[str, float | str]:
    return dict(found.stats["tried"])  # type: ignore[call-overload]


def kinds_of(certificate: Any) -> list[str]:
    return [part.relation["kind"] for part in certificate.proof.agents]


@pytest.mark.thorough
def test_nothing_else_is_tried_where_exact_leaves_the_inputs_to_the_policy() -> None:
    found = cg.synthesize(cg.make_problem("reach-avoid-v0"), 100)
    assert found.certificate.lower_bound > 0.9
    assert str(tried_of(found)["linear"]).startswith("skipped")
    tried = tried_of(cg.synthesize(cg.make_problem("reach-avoid-v0"), 100, relation="best"))
    assert {"exact", "linear"} <= set(tried)


@pytest.mark.thorough
def test_linear_cells_are_tried_on_given_cells_where_much_is_left_open() -> None:
    found = cg.synthesize("car-park-v0", 60)
    tried = tried_of(found)
    assert {"exact", "linear"} <= set(tried) and kinds_of(found.certificate) == ["linear"]
    assert tried["linear"] == found.certificate.lower_bound > float(tried["exact"]) + 0.05
    assert cg.check(found.certificate)
    again = cg.synthesize("car-park-v0", 60, effort=1e-3)
    assert kinds_of(again.certificate) == ["exact"] and "ask for more `effort`" in str(tried_of(again)["linear"])


@pytest.mark.thorough
def test_agents_of_one_team_have_different_relations(tmp_path: Path) -> None:
    found = cg.synthesize(team(), CELLS, relation={"car": "exact", "cart": "linear"})
    assert kinds_of(found.certificate) == ["exact", "linear"] and found.certificate.lower_bound > 0.1
    assert tried_of(chosen())["exact for car, linear for cart"] == found.certificate.lower_bound
    assert cg.check(found.certificate)
    assert cg.validate(found, 20_000, confidence=1 - 1e-6).verdict != REFUTED
    cg.save(chosen().certificate, tmp_path / "c.npz")
    assert cg.load(tmp_path / "c.npz").settings["relations_tried"] == tried_of(chosen())


@pytest.mark.thorough
def test_bounds_from_above_hold_for_combinations() -> None:
    """Also where cells have several labels, of which the worst counts."""
    problem, cells, relation = team(), {"car": 40, "cart": 24}, {"car": "exact", "cart": "linear"}
    found = cg.synthesize(problem, cells, relation=relation)
    joint = join(problem, abstract(problem, cells, relation=relation))
    most = upper_bound(joint, start_of(problem, joint), relax(problem, joint))
    assert 0.0 < found.certificate.lower_bound <= most


def test_relations_can_be_named_per_agent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem, cells = team(), {"car": 40, "cart": 24}
    models = abstract(problem, cells, relation={"car": "linear"}).models
    assert [m.relation.kind for m in models] == ["linear", "linear"]
    with pytest.raises(ValueError, match="`relation`: expected names of agents among car, cart, got 'bus'"):
        cg.synthesize(problem, cells, relation={"bus": "linear"})
    with pytest.raises(ValueError, match="`relation`: expected one of auto, boxes"):
        cg.synthesize(problem, cells, relation={"car": "exakt"})
    out = str(tmp_path / "c.npz")
    scalar = ["synthesize", "reach-avoid-v0", "--horizon", "2", "--cells", "40", "--out", out]
    assert main([*scalar, "--relation", "agent_0=boxes", "agent_1=exact"]) == 0
    assert kinds_of(cg.load(out)) == ["boxes", "exact"]
    assert main([*scalar, "--relation", "boxes", "exact"]) == 2
    assert "`--relation`: expected one name, or AGENT=NAME once per agent" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["tube", "ellipsoid", "coupled"])
def test_relations_of_before_say_what_to_write(name: str) -> None:
    with pytest.raises(ValueError, match=rf"`relation`: '{name}' is gone since 0.4; write 'linear'"):
        cg.synthesize(team(), 10, relation=name)
    if name != "coupled":  # no certificate had that one
        with pytest.raises(ValueError, match="synthesize anew, relation='linear'"):
            check_description({"kind": name}, team().agents[0])


@pytest.mark.thorough
def test_independent_tasks_choose_for_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(independent, "MOST_STATES", 0)
    problem = team(formula="(F home) & (F goal)", semantics="finite-trace")
    assert problem.groups
    found = cg.synthesize(problem, {"car": 60, "cart": 24})
    first, second = found.certificate.proof.parts
    assert kinds_of(first) == ["exact"] and kinds_of(second) == ["linear"]
    named = cg.synthesize(problem, {"car": 60, "cart": 24}, relation={"car": "boxes", "cart": "boxes"})
    assert [kinds_of(part) for part in named.certificate.proof.parts] == [["boxes"], ["boxes"]]


def test_a_failure_probability_is_refused_beside_relations_that_are_never_lost() -> None:
    for relation in ("auto", "exact", {"car": "linear"}):
        with pytest.raises(ValueError, match=r"`delta`: expected none .* ask for `paper`"):
            cg.synthesize(team(), CELLS, relation=relation, search=cg.SearchOptions(delta=0.1))
