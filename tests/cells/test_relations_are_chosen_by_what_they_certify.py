"""By default relations are compared where more than one may be best: the largest bound is kept, all are reported."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.envs.tasks.problem import groups as independent
from certigym.synthesis.abstraction.models import ellipsoid_search
from certigym.synthesis.abstraction.models.joint import join, start_of
from certigym.synthesis.policy_search.ascent.relaxation import relax, upper_bound
from certigym.synthesis.policy_search.portfolio import relation_choice
from certigym.synthesis.relations.grids.agent_grids import DEFAULT_CELLS
from certigym.synthesis.verbs import task_strategies
from certigym.synthesis.verbs.abstract import abstract
from certigym.validation.statistical_tests.binomial import REFUTED
from problems import cart, cart_reach, scalar_agent

NEEDS_SOLVER = "cvxpy"

MAY_BE_LINEAR = task_strategies.may_be_linear


def team(n_carts: int = 1, formula: str = "F (home & {carts})", semantics: str = "co-safe") -> cg.Problem:
    """A scalar agent whose every mean can be commanded, and carts with one input for two states."""
    names = [f"cart_{k}" for k in range(n_carts)]
    regions = {f"goal_{k}": cg.Proposition(name, [0.0, -3.0], [5.0, 3.0]) for k, name in enumerate(names)}
    task = formula.format(carts=" & ".join(regions))
    return cg.Problem(
        name="mixed",
        horizon=5,
        agents=[scalar_agent("car"), *(cart(name=name) for name in names)],
        propositions={"home": cg.Proposition("car", [1.0], [3.0]), **regions},
        specification=cg.Specification(task, semantics),
    )


@pytest.fixture(autouse=True)
def without_linear_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare the relations with one target per cell alone, unless a test asks for more."""
    monkeypatch.setattr(task_strategies, "may_be_linear", lambda problem, plan: False)


@pytest.fixture(autouse=True)
def with_rougher_ellipsoids(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer semidefinite programs: how good ellipsoids are is tested where relations are, not where they are chosen."""
    shares = (8.0, 4.0, 2.0, 1.3, 1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05)
    monkeypatch.setattr(ellipsoid_search, "LABEL_SHARES", shares)
    monkeypatch.setattr(ellipsoid_search, "FIRST_MULTIPLIERS", (0.2, 0.5, 0.8, 0.95))


@cache
def chosen() -> cg.Synthesis:
    return cg.synthesize(team(), {"car": 60, "cart_0": 40})


def tried_of(found: cg.Synthesis) -> dict[str, float | str]:
    return dict(found.stats["tried"])  # type: ignore[call-overload]


def kinds_of(certificate: Any) -> list[str]:
    return [part.relation["kind"] for part in certificate.proof.agents]


@pytest.mark.thorough
def test_nothing_else_is_tried_where_exact_leaves_the_inputs_to_the_policy(monkeypatch: pytest.MonkeyPatch) -> None:
    found = cg.synthesize(cg.make_problem("reach-avoid-v0"), 100)
    assert found.certificate.lower_bound > 0.9
    assert "tried" not in found.stats and "relations_tried" not in found.certificate.settings
    assert "tried " not in str(cg.validate(found, 200))
    monkeypatch.setattr(relation_choice, "SETTLED", 0.0)
    tried = tried_of(cg.synthesize(cg.make_problem("reach-avoid-v0"), 100))
    assert {"exact", "tube", "ellipsoid"} == set(tried)


@pytest.mark.thorough
def test_linear_cells_are_tried_on_given_cells_where_much_is_left_open(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(task_strategies, "may_be_linear", MAY_BE_LINEAR)
    found = cg.synthesize("car-park-v0", 60)
    tried = tried_of(found)
    assert {"exact", "linear"} <= set(tried) and kinds_of(found.certificate) == ["linear"]
    assert tried["linear"] == found.certificate.lower_bound > float(tried["exact"]) + 0.05
    assert cg.check(found.certificate)
    again = cg.synthesize("car-park-v0", 60, effort=1e-3)
    assert kinds_of(again.certificate) == ["exact"] and "ask for more `effort`" in str(tried_of(again)["linear"])


@pytest.mark.thorough
def test_a_tube_is_kept_where_it_certifies_more_than_exact() -> None:
    """On coarse cells the reserve of ``exact`` takes an eighth of the inputs, and rounding to one target takes more."""
    problem = cg.make_problem("car-park-planar-v0", horizon=12)
    quick, found = (
        cg.synthesize(problem, 100, relation=relation, search=cg.SearchOptions(targets_per_cell=1))
        for relation in ("quick", "auto")
    )
    assert kinds_of(quick.certificate) == ["exact"] and kinds_of(found.certificate) == ["tube"]
    assert found.certificate.lower_bound > quick.certificate.lower_bound + 0.005
    assert cg.check(found.certificate), str(cg.check(found.certificate))


@pytest.mark.thorough
def test_an_ellipsoid_is_kept_where_it_certifies_more_than_a_tube() -> None:
    """Two agents of position and velocity share it; the bound is checked and not refuted at 1e-6."""
    pytest.importorskip(NEEDS_SOLVER)
    problem = cg.make_problem("reach-avoid-kinematic-v0").replace(horizon=10)
    tube, found = (
        cg.synthesize(problem, 50, relation=relation, search=cg.SearchOptions(max_sweeps=1))
        for relation in ("tube", "auto")
    )
    assert kinds_of(found.certificate) == ["ellipsoid", "ellipsoid"]
    assert found.certificate.lower_bound > tube.certificate.lower_bound + 0.05
    tried = tried_of(found)
    assert tried["ellipsoid"] == found.certificate.lower_bound
    most = re.fullmatch(r"at most (0\.\d+), not computed", str(tried["tube"]))
    assert most is not None and float(most[1]) >= tube.certificate.lower_bound
    assert cg.check(found.certificate)
    assert cg.validate(found, 20_000, confidence=1 - 1e-6).verdict != REFUTED


@pytest.mark.thorough
def test_agents_of_one_team_have_different_relations(tmp_path: Path) -> None:
    found = chosen()
    kinds = kinds_of(found.certificate)
    assert kinds[0] == "exact" and kinds[1] in ("tube", "ellipsoid") and found.certificate.lower_bound > 0.1
    assert f"exact for car, {kinds[1]} for cart_0" in tried_of(found)
    assert cg.check(found.certificate)
    assert cg.validate(found, 20_000, confidence=1 - 1e-6).verdict != REFUTED
    cg.save(found.certificate, tmp_path / "c.npz")
    loaded = cg.load(tmp_path / "c.npz")
    assert loaded.settings["relations_tried"] == tried_of(found)
    assert f"tried         exact for car, {kinds[1]} for cart_0: P >= " in str(cg.validate(loaded, 200))


@pytest.mark.thorough
def test_what_is_passed_over_would_not_have_been_better() -> None:
    found = chosen()
    for kind in ("tube", "ellipsoid"):
        if kind == "ellipsoid":
            pytest.importorskip(NEEDS_SOLVER)
        other = cg.synthesize(team(), {"car": 60, "cart_0": 40}, relation={"cart_0": kind})
        assert kinds_of(other.certificate) == ["exact", kind]
        assert other.certificate.lower_bound <= found.certificate.lower_bound + relation_choice.LEAST_GAIN
        outcome = tried_of(found)[f"exact for car, {kind} for cart_0"]
        if isinstance(outcome, str) and outcome.startswith("at most"):
            assert other.certificate.lower_bound <= float(outcome.split()[2].rstrip(","))
        else:
            assert outcome == other.certificate.lower_bound


@pytest.mark.thorough
def test_bounds_from_above_hold_for_every_combination() -> None:
    """Also where cells have several labels, of which the worst counts."""
    problem, cells = team(), {"car": 40, "cart_0": 24}
    for car in ("exact", "tube"):
        relation = {"car": car, "cart_0": "tube"}
        found = cg.synthesize(problem, cells, relation=relation)
        joint = join(problem, abstract(problem, cells, relation=relation))
        most = upper_bound(joint, start_of(problem, joint), relax(problem, joint))
        assert 0.0 < found.certificate.lower_bound <= most


def test_relations_can_be_named_per_agent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem, cells = team(), {"car": 40, "cart_0": 24}
    assert [m.relation.kind for m in abstract(problem, cells, relation={"car": "tube"}).models] == ["tube", "tube"]
    with pytest.raises(ValueError, match="`relation`: expected names of agents among car, cart_0, got 'bus'"):
        cg.synthesize(problem, cells, relation={"bus": "tube"})
    with pytest.raises(ValueError, match="`relation`: expected one of auto, boxes"):
        cg.synthesize(problem, cells, relation={"car": "exakt"})
    out = str(tmp_path / "c.npz")
    scalar = ["synthesize", "reach-avoid-v0", "--horizon", "2", "--cells", "40", "--out", out]
    assert main([*scalar, "--relation", "agent_0=tube", "agent_1=exact"]) == 0
    assert kinds_of(cg.load(out)) == ["tube", "exact"]
    assert main([*scalar, "--relation", "tube", "exact"]) == 2
    assert "`--relation`: expected one name, or AGENT=NAME once per agent" in capsys.readouterr().err


@pytest.mark.thorough
def test_independent_tasks_choose_for_themselves(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(independent, "MOST_STATES", 0)
    problem = team(formula="(F home) & (F {carts})", semantics="finite-trace")
    assert problem.groups
    found = cg.synthesize(problem, {"car": 60, "cart_0": 24})
    first, second = found.certificate.proof.parts
    assert kinds_of(first) == ["exact"] and kinds_of(second)[0] in ("tube", "ellipsoid")
    assert all(name.endswith(", task of cart_0") for name in tried_of(found))
    named = cg.synthesize(problem, {"car": 60, "cart_0": 24}, relation={"car": "tube", "cart_0": "tube"})
    assert [kinds_of(part) for part in named.certificate.proof.parts] == [["tube"], ["tube"]]


@pytest.mark.thorough
def test_default_cells_are_doubled_where_no_relation_applies() -> None:
    """With twice the inputs the second level applies; the integrators of the literature need the third."""
    chain = cg.make_problem("integrator-chain-v0", horizon=2)
    problem = cg.Problem(
        name="strong",
        horizon=2,
        agents=[agent.replace(input_low=[-2.0], input_high=[2.0]) for agent in chain.agents],
        propositions=chain.declared,
        specification=chain.specification,
    )
    first, second = cg.synthesize(problem, horizon=[1, 2], relation="best")
    shapes = {part.grid.shape for part in first.certificate.proof.agents}
    assert len(shapes) == 1 and min(next(iter(shapes))) > DEFAULT_CELLS[2]
    assert {part.grid.shape for part in second.certificate.proof.agents} == shapes
    with pytest.raises(ValueError, match="ask for more `cells`"):
        cg.synthesize(problem, DEFAULT_CELLS[2])
    with pytest.raises(ValueError, match="ask for more `cells`"):
        cg.synthesize(problem, dict.fromkeys(problem.agent_names, DEFAULT_CELLS[2]))


def test_agents_that_nothing_fits_are_refused_with_the_first_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    runaway = cart(A=[[1.3, 0.0], [0.0, 0.5]], B=[[0.0], [1.0]], initial_state=[0.0, 0.0])
    with pytest.raises(ValueError, match="no feedback stabilises"):
        cg.synthesize(cart_reach(runaway, horizon=2), 80)
    # Linear cells, which are tried where cells are left out, need no feedback; and no run without noise goes anywhere.
    monkeypatch.setattr(task_strategies, "may_be_linear", MAY_BE_LINEAR)
    tried = tried_of(cg.synthesize(cart_reach(runaway, horizon=2), effort=1.4))
    assert "linear" in {name for name, outcome in tried.items() if isinstance(outcome, float)}
    assert "no nominal path satisfies the task" in str(tried["path"])


def reach(agent: Any) -> cg.Problem:
    """One agent is to come to its goal."""
    return cg.Problem(
        name="one", horizon=3, agents=[agent], propositions={"goal": cg.Proposition("one", [1.0], [3.0])},
        specification=cg.Specification("F goal", "co-safe"),
    )  # fmt: skip


@pytest.mark.thorough
def test_coupled_keeps_the_best_of_its_three_sets() -> None:
    problem = reach(scalar_agent("one"))
    found = cg.synthesize(problem, 40, relation="coupled")
    alone = {kind: cg.synthesize(problem, 40, relation=kind).certificate.lower_bound for kind in ("tube", "paper")}
    tried = tried_of(found)
    assert {*tried} == {"tube", "ellipsoid", "paper"} and tried["tube"] == alone["tube"]
    assert found.certificate.lower_bound >= max(alone.values()) > 0.0 and cg.check(found.certificate)
    again = cg.synthesize(problem, start=found, relation="coupled").certificate
    assert kinds_of(again) == kinds_of(found.certificate) and again.lower_bound >= found.certificate.lower_bound
    bent = cg.Agent(
        name="one", states=["x"], inputs=["u"], dynamics=["sin(x) + u"], noise=[{"law": "gaussian", "std": 0.3}],
        state_low=[-3.0], state_high=[3.0], input_low=[-1.0], input_high=[1.0], initial_state=[0.0],
    )  # fmt: skip
    with pytest.raises(ValueError, match="the relation `coupled` is for linear dynamics"):
        cg.synthesize(reach(bent), 20, relation="coupled")
