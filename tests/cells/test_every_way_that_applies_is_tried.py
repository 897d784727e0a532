"""Ways to certify a task are tried with the cheapest first while the effort lasts, and the best one is kept."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.policy_search.cell_certificates.agreement import agreed
from certigym.synthesis.policy_search.portfolio import Effort, Results, Strategy, best_of, leading
from certigym.synthesis.relations.grids import RelationRefused
from certigym.synthesis.trajectories.planning import CountedWork, path_certificate
from certigym.synthesis.verbs.synthesize import strategies_ahead


def result(bound: float, has_cells: bool = True, above: float | None = None) -> cg.Synthesis:
    """Return what a way gives, as far as the scheduler looks at it."""
    certificate: Any = SimpleNamespace(lower_bound=bound, proof=SimpleNamespace(has_cells=has_cells), settings={})
    return cg.Synthesis(certificate, certificate, {"continuous_upper_bound": above})


class Table:
    """Ways that note when they are run."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.run: list[str] = []
        monkeypatch.setattr(
            "certigym.synthesis.policy_search.portfolio.strategies.with_settings", lambda found, more: found
        )

    def strategy(self, name: str, outcome: float | str, work: float = 0.0, **options: Any) -> Strategy:
        """Return a way that certifies a bound, or is refused with a text."""

        def run(results: Results) -> cg.Synthesis:
            self.run.append(name)
            if isinstance(outcome, str):
                raise RelationRefused(outcome)
            return result(outcome)

        return Strategy(name, run, work, **options)


@pytest.fixture
def table(monkeypatch: pytest.MonkeyPatch) -> Table:
    return Table(monkeypatch)


def tried_of(found: cg.Synthesis) -> dict[str, Any]:
    return dict(found.stats["tried"])  # type: ignore[call-overload]


@pytest.mark.full_search
def test_the_cheapest_is_first_and_the_best_is_kept(table: Table) -> None:
    found = best_of(
        [table.strategy("long", 0.5, 3.0), table.strategy("short", 0.6, 1.0), table.strategy("middle", 0.4, 2.0)],
        Effort(),
    )
    assert table.run == ["short", "middle", "long"] and found.certificate.lower_bound == 0.6
    assert tried_of(found) == {"short": 0.6, "middle": 0.4, "long": 0.5}


def test_what_the_effort_does_not_reach_is_left_out_but_the_first_is_computed(table: Table) -> None:
    strategies = [table.strategy("first", 0.3, 5.0), table.strategy("second", 0.9, 6.0)]
    found = best_of(strategies, Effort(2.0))
    assert table.run == ["first"] and "ask for more `effort`" in tried_of(found)["second"]
    assert best_of(strategies, Effort(11.0)).certificate.lower_bound == 0.9


def test_a_refusal_is_no_certificate_and_does_not_end_the_search(table: Table) -> None:
    found = best_of([table.strategy("one", "it has no grid"), table.strategy("other", 0.2, 9.0)], Effort(1.0))
    assert tried_of(found) == {"one": "it has no grid", "other": 0.2}
    with pytest.raises(RelationRefused, match=r"^one: it has no grid; other: it has no path$"):
        best_of([table.strategy("one", "it has no grid", 2.0), table.strategy("other", "it has no path")], Effort())
    with pytest.raises(RelationRefused, match=r"^too coarse$"):
        best_of([table.strategy("one", "too coarse"), table.strategy("other", "too coarse")], Effort())


def test_what_leaves_nothing_to_gain_ends_the_search(table: Table) -> None:
    strategies = [table.strategy("path", 0.99, ends=0.99), table.strategy("grid", 1.0, 1.0)]
    assert "is left to gain after `path`" in tried_of(best_of(strategies, Effort()))["grid"]
    strategies = [
        table.strategy("path", 0.95, ends=0.99),
        table.strategy("rare", 1.0, 1.0, enough=0.9),
        table.strategy("grid", 0.97, 2.0),
    ]
    found = best_of(strategies, Effort())
    assert found.certificate.lower_bound == 0.97 and "0.95 was certified already" in tried_of(found)["rare"]


@pytest.mark.full_search
def test_a_bound_that_is_enough_ends_the_search(table: Table) -> None:
    strategies = [table.strategy("short", 0.6, 1.0), table.strategy("long", 0.8, 2.0), table.strategy("last", 0.9, 3.0)]
    found = best_of(strategies, Effort(until=0.7))
    assert table.run == ["short", "long"] and found.certificate.lower_bound == 0.8
    assert "`long` has the bound that was asked for" in tried_of(found)["last"]
    assert best_of(strategies, Effort(until=0.95)).certificate.lower_bound == 0.9


@pytest.mark.parametrize("until", [0.0, -0.5, 1.5, "0.9", True])
def test_what_is_no_bound_is_enough_for_nothing(until: Any) -> None:
    with pytest.raises(ValueError, match="`until`: expected a lower bound above 0, 1 at most"):
        cg.synthesize("invariance-v0", until=until)


@pytest.mark.thorough
@pytest.mark.full_search
def test_searches_along_paths_end_with_the_bound() -> None:
    """Defaults go on to a failure of 1e-9."""
    found = cg.synthesize("car-slalom-v0", relation="path", until=0.3)
    assert 0.3 <= found.certificate.lower_bound < 0.9999999 and cg.check(found.certificate)


@pytest.mark.parametrize("value", ["tree", "train"])
def test_sweeps_end_with_the_bound(value: str) -> None:
    """Not only ways: the first sweep has it, and no other one is made."""
    search = cg.SearchOptions(value=value)
    first = cg.synthesize("reach-avoid-v0", 24, relation="exact", search=search, until=0.5)
    whole = cg.synthesize("reach-avoid-v0", 24, relation="exact", search=search)
    assert len(list(first.stats["sweeps"])) == 1 < len(list(whole.stats["sweeps"]))  # type: ignore[call-overload]
    assert 0.5 < first.certificate.lower_bound <= whole.certificate.lower_bound


@pytest.mark.full_search
def test_what_needs_another_way_comes_after_it(table: Table) -> None:
    strategies = [
        table.strategy("finer", 0.7, after="coarse"),
        table.strategy("coarse", 0.5, 4.0),
        table.strategy("path", 0.1, 2.0),
    ]
    best_of(strategies, Effort())
    assert table.run == ["path", "coarse", "finer"]


def test_a_grid_is_kept_where_a_path_certifies_hardly_more() -> None:
    path, grid = result(0.95, has_cells=False), result(0.948)
    assert leading({"path": path, "grid": grid}) is grid
    assert leading({"path": path, "grid": result(0.947)}) is path
    assert leading({"path": path}) is path and leading({}) is None


@pytest.mark.thorough
def test_a_path_that_leaves_hardly_anything_to_gain_spares_the_grids() -> None:
    found = cg.synthesize("integrator-chain-v0")
    assert not found.certificate.proof.has_cells and found.certificate.lower_bound > 0.993
    assert "is left to gain after `path`" in tried_of(found)["linear"]
    assert cg.check(found.certificate)
    first, second = cg.synthesize("integrator-chain-v0", horizon=[4, 5])
    assert second.certificate.lower_bound == found.certificate.lower_bound < first.certificate.lower_bound


def test_a_path_comes_before_trees_of_many_agents() -> None:
    """Six robots and 32 automaton states: the path takes a second, and to compare other relations minutes."""
    samples = cg.load(Path(__file__).parents[2] / "examples" / "own" / "samples.toml")
    ((_, ways),) = strategies_ahead(samples)
    assert next(own.name for own in ways) == "path"


def test_vertices_come_before_boxes_where_linear_cells_take_more_than_is_left() -> None:
    """An automaton of 29 states: boxes take seven minutes."""
    folder = Path(__file__).parents[2] / "examples" / "own"
    names = [[own.name for own in ways(cg.load(folder / f"{name}.toml"))] for name in ("oscillator", "hopper")]
    assert names[0].index("vertices") < names[0].index("others") and "vertices" not in names[1]


@pytest.mark.parametrize(("name", "is_left"), [("spacecraft", True), ("mountain_car", False)])
def test_a_path_makes_way_for_vertices_where_the_noise_is_large(
    name: str, is_left: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = list[CountedWork]()

    def along_path(problem: cg.Problem, along: CountedWork) -> cg.Synthesis:
        seen.append(along)
        raise RelationRefused("no path")

    monkeypatch.setattr("certigym.synthesis.verbs.task_strategies.along_path", along_path)
    ((_, ways),) = strategies_ahead(cg.load(Path(__file__).parents[2] / "examples" / "own" / f"{name}.toml"))
    with pytest.raises(RelationRefused):
        next(own for own in ways if own.name == "path").run({})
    (along,) = seen
    for spent, bound, is_over in ((1.0, 0.5, False), (16.0, 0.5, is_left), (16.0, 0.995, False)):
        along.spent, along.largest = spent, bound
        assert along.is_broken_off() == is_over


def broken_off(results: Results) -> cg.Synthesis:
    """A way during which the user presses Ctrl-C."""
    raise KeyboardInterrupt


def test_ctrl_c_keeps_the_best_so_far(table: Table) -> None:
    strategies = [table.strategy("first", 0.4), Strategy("second", broken_off, 1.0), table.strategy("third", 0.9, 2.0)]
    found = best_of(strategies, Effort())
    assert found.certificate.lower_bound == 0.4 and table.run == ["first"]
    assert tried_of(found)["second"] == "given up: broken off by Ctrl-C"
    assert tried_of(found)["third"] == "skipped: broken off by Ctrl-C"
    with pytest.raises(KeyboardInterrupt):
        best_of([Strategy("first", broken_off)], Effort())


@pytest.mark.thorough
def test_ctrl_c_keeps_the_best_level() -> None:
    """The second level is broken off: the first one is what there is, and nothing else is begun."""
    seen: list[str] = []

    def told(text: str, value: float) -> None:
        seen.append(text)
        if sum(text.startswith("way: linear, ") for text in seen) == 2:
            raise KeyboardInterrupt

    found = cg.synthesize("car-park-v0", progress=told)
    assert found.certificate.lower_bound > 0.0 and cg.check(found.certificate)
    assert "broken off by Ctrl-C" in str(tried_of(found))


@pytest.mark.thorough
def test_work_along_paths_is_counted_and_kept_to() -> None:
    """Less of it ends earlier, with a first certificate all the same."""
    spent = list[tuple[float, float]]()
    for limit in (np.inf, 1e-9):
        work = CountedWork(limit)
        found = agreed(path_certificate(cg.make_problem("car-slalom-v0"), work))
        assert cg.check(found.certificate) and found.certificate.lower_bound > 0.0
        spent.append((work.spent, found.certificate.lower_bound))
    assert spent[1][0] < spent[0][0] and spent[1][1] <= spent[0][1]
    assert not CountedWork(2.0, spent=1.0).allows(1.5) and CountedWork(2.0, spent=1.0).allows(1.0)


def overdrawn(table: Table, effort: Effort, name: str, takes: float, outcome: float, work: float = 1.0) -> Strategy:
    """Return a way that takes more work than it said."""
    inner = table.strategy(name, outcome)

    def run(results: Results) -> cg.Synthesis:
        table.run.append(f"{name} begins")
        for _ in range(100):
            effort.count(takes / 100)
        return inner.run(results)

    return Strategy(name, run, work)


def test_a_way_that_takes_far_more_than_it_said_is_given_up_for_others(table: Table) -> None:
    effort = Effort()
    strategies = [overdrawn(table, effort, "long", 5000.0, 0.9), table.strategy("path", 0.8, 2.0)]
    found = best_of(strategies, effort)
    assert table.run == ["long begins", "path"]
    assert tried_of(found)["long"] == "given up: it took far more work than was estimated"
    assert found.certificate.lower_bound == 0.8
    # Half of what there was is left for the others, of which one took 2.
    assert effort.spent == 0.5 * effort.limit + 2.0


@pytest.mark.parametrize(("outcome", "taken"), [("no path", 40.0), (0.0, 40.0), (0.2, 1.0)])
def test_what_a_way_took_that_gave_nothing_is_shown_and_charged(
    table: Table, outcome: float | str, taken: float
) -> None:
    """It took 60 of 80 and said 1: half of the effort is left for the others, and what is shown never falls."""
    seen: list[str] = []
    effort = Effort(80.0, progress=lambda text, bound: seen.append(text))
    inner = table.strategy("path", outcome)

    def run(results: Results) -> cg.Synthesis:
        effort.tell_again(60.0)
        return inner.run(results)

    best_of([Strategy("path", run, 1.0), table.strategy("grid", 0.5, 2.0)], effort)
    assert effort.spent == taken + 2.0
    assert [re.findall(r"effort (\d+)", text)[0] for text in seen] == ["0", "60", "60"]


def test_where_nothing_else_gives_anything_it_may_take_what_it_takes(table: Table) -> None:
    effort = Effort()
    found = best_of([overdrawn(table, effort, "long", 5000.0, 0.9), table.strategy("path", "no path", 2.0)], effort)
    assert table.run == ["long begins", "path", "long begins", "long"]
    assert found.certificate.lower_bound == 0.9


def with_heavy_noise(dynamics: str, scale: float = 0.2) -> cg.Problem:
    """Return a task of one agent whose noise only vertices, boxes and paths know."""
    agent = cg.Agent(
        name="tank", states=["a", "b"], inputs=["u"], dynamics=[dynamics, "0.9*b + 0.1*a"],
        noise=[{"law": "laplace", "scale": scale}] * 2, state_low=[-4, -4], state_high=[4, 4],
        input_low=[-1], input_high=[1], initial_state=[1, 0],
    )  # fmt: skip
    return cg.Problem(
        agents=[agent],
        propositions={"low": cg.Proposition("tank", [-4, -4], [3, 4])},
        specification="G low",
        horizon=10,
    )


def ways(problem: cg.Problem) -> list[Strategy]:
    return [own for _, strategies in strategies_ahead(problem) for own in strategies]


@pytest.mark.parametrize("dynamics", ["0.9*a + u", "max(0.9*a + u, 0)"])
def test_boxes_are_left_out_beside_vertices(dynamics: str) -> None:
    others = next(own for own in ways(with_heavy_noise(dynamics)) if own.name == "others")
    assert others.why_not is not None and others.why_not({}) is None
    assert "vertices bound values" in (others.why_not({"vertices": result(0.1)}) or "")


def test_a_path_may_take_what_it_takes_where_noise_is_too_small_for_vertices() -> None:
    refusals = [
        next(own.refusal for own in ways(with_heavy_noise("0.9*a + u", scale)) if own.name == "vertices")
        for scale in (0.2, 1e-3)
    ]
    assert not refusals[0] and "the noise is small" in refusals[1]


@pytest.mark.full_search
def test_a_large_team_has_linear_cells_where_vertices_give_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(*_: Any) -> Any:
        raise RelationRefused("no runs satisfy the task")

    monkeypatch.setattr("certigym.synthesis.verbs.vertex_strategies.vertex_team_certificate", nothing)
    robot = {
        "A": np.eye(2), "B": 0.5 * np.eye(2), "noise_std": [0.5, 0.5], "state_low": [-2, -2], "state_high": [2, 2],
        "input_low": [-1, -1], "input_high": [1, 1], "initial_state": [0, 0],
    }  # fmt: skip
    agents = [cg.LinearAgent(name=name, **robot) for name in "abc"]
    goals = {f"goal_{name}": cg.Proposition(name, [0.2, 0.2], [1.8, 1.8]) for name in "abc"}
    task = "F (goal_a & goal_b & goal_c)"
    problem = cg.Problem(name="p", agents=agents, propositions=goals, specification=task, horizon=3)
    tried = [way.name for _, ways in strategies_ahead(problem) for way in ways if not way.refusal]
    assert tried.index("vertices") < tried.index("linear")
    found = cg.synthesize(problem, effort=8.0)
    outcomes = tried_of(found)
    assert "no runs satisfy" in outcomes["vertices"]
    assert "vertices" not in str(outcomes.get("linear", "vertices")), outcomes
