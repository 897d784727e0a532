"""Records print themselves shortly: sizes and ranges on a few lines, with a thousand agents as with two."""

from __future__ import annotations

import copy
import pickle
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.agents import Box, box_text, checked_count, names_text, shortened, slices_of, tree_text
from certigym.envs.dynamics import Dynamics, OneWorld
from certigym.envs.dynamics import worlds as core
from problems import scalar_agent

MOST_CHARACTERS, MOST_LINES = 1500, 12


def pairs(n: int) -> cg.Problem:
    """Every pair of agents has to meet: `n` independent tasks of two states each."""
    meetings = " & ".join(f"F (goal_left_{k} & goal_right_{k})" for k in range(n))
    return cg.Problem(
        name="pairs",
        horizon=3,
        agents=[scalar_agent(f"{side}_{k}") for k in range(n) for side in ("left", "right")],
        propositions={f"goal_{side}": cg.Proposition(f"{side}_*", [0.0], [1.0]) for side in ("left", "right")},
        specification=cg.Specification(meetings, "finite-trace"),
    )


def many_kinds(n: int) -> cg.Problem:
    """A problem whose agents all differ in their workspaces, and whose name needs escaping in HTML."""
    return cg.Problem(
        name="<b>many & more</b>",
        horizon=5,
        agents=[scalar_agent(f"agent_{i}", state_low=[-1.0 - i], state_high=[1.0 + i]) for i in range(n)],
        propositions={"safe": cg.Proposition("agent_*", [-0.5], [0.5])},
        specification=cg.Specification("G all(safe)", "finite-trace"),
    )


PROBLEMS = {
    "two agents": lambda: cg.make_problem("reach-avoid-v0"),
    "eight agents, automaton by hand": lambda: cg.make_problem("package-delivery-v0"),
    "a hundred agents": lambda: cg.make_problem("invariance-b-100-v0"),
    "a thousand agents": lambda: cg.make_problem("reach-avoid-n-v0", n_agents=1000),
    "long chain": lambda: cg.make_problem("integrator-chain-v0", dimension=6),
    "independent tasks": lambda: pairs(50),
    "thirty agents that keep apart": lambda: cg.make_problem("swarm-v0", n_agents=30),
    "kinds": lambda: many_kinds(40),
}


def records(problem: cg.Problem) -> list[Any]:
    """Every record of the rooms of the problem, and of its dynamics."""
    automata = [group.automaton for group in problem.groups] or [problem.automaton]
    kinds: list[Any] = [
        problem,
        problem.agents[0],
        problem.agents[0].workspace,
        problem.labeling,
        problem.specification,
        *automata[:1],
        *problem.groups[:1],
        *list(problem.propositions.values())[:1],
        *list(problem.propositions.values())[-1:],
        *problem.labeling.pairs[:1],
    ]
    if not problem.groups:
        dynamics = Dynamics.of(problem)
        worlds = core.initial(dynamics, np.random.default_rng(0), 3)
        single = OneWorld.of(dynamics)
        one = single.begin(core.initial(dynamics, np.random.default_rng(0), 1))
        kinds += dynamics.pairs[:1]
        kinds += [dynamics, dynamics.blocks[0], worlds, single, one, *([dynamics.reader] if dynamics.reader else [])]
    return kinds


@pytest.mark.parametrize("name", PROBLEMS)
def test_every_record_is_short(name: str) -> None:
    problem = PROBLEMS[name]()
    for record in records(problem):
        text = repr(record)
        assert 0 < len(text) <= MOST_CHARACTERS and len(text.splitlines()) <= MOST_LINES, text
        assert "array(" not in text and max(map(len, text.splitlines())) <= 250, text
    assert len(problem._repr_html_()) <= 2 * MOST_CHARACTERS


def test_a_small_problem_prints_its_sizes() -> None:
    lines = repr(cg.make_problem("reach-avoid-v0")).splitlines()
    assert lines == [
        "Problem 'reach-avoid-v0'",
        "|-- agents        2 with 1 state and 1 input each: agent_0, agent_1",
        "|-- propositions  3 (p1, p2, p3)",
        "|-- task          (!p2 | !p3) U p1",
        "|-- semantics     co-safe",
        "|-- automaton     3 states",
        "`-- horizon       7 control steps",
    ]


def test_alike_agents_are_counted_together() -> None:
    text = repr(cg.make_problem("invariance-b-100-v0"))
    assert "100 with 1 state and 1 input each: agent_0, agent_1, agent_2, ..., agent_99" in text
    assert "100 (safe)" in text and "7 control steps" in text
    text = repr(cg.make_problem("reach-avoid-n-v0", n_agents=500))
    assert "500 with 1 state" in text and "1000 (safe, target)" in text
    text = repr(many_kinds(40))
    assert text.count("1 with 1 state and 1 input") == 4 and "... and 36 more kinds, 40 in all" in text


def test_independent_tasks_are_counted() -> None:
    problem = pairs(50)
    assert "50 independent tasks of 2 states each" in repr(problem) and "50 independent tasks" in problem._repr_html_()
    assert repr(problem.groups[0]).startswith("Group(2 agents, Automaton(")


class Table(HTMLParser):
    """The cells of a table, row by row; every tag has to be closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        elif tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data


def test_notebooks_show_a_table() -> None:
    table = Table(cg.make_problem("reach-avoid-v0")._repr_html_())
    assert table.open == []
    assert table.rows[:2] == [
        ["agents", "states", "inputs", "workspace"],
        ["2: agent_0, agent_1", "1", "1", "[-20, 5]"],
    ]
    facts = {row[0]: row[1] for row in table.rows if len(row) == 2}
    assert facts["task"] == "(!p2 | !p3) U p1" and facts["automaton"] == "3 states"
    assert facts["horizon"] == "7 control steps"


def test_names_and_formulas_are_escaped() -> None:
    text = many_kinds(3)._repr_html_()
    assert "<b>" not in text and "&lt;b&gt;many &amp; more" in text
    assert Table(text).open == []
    text = cg.make_problem("meeting-v0")._repr_html_()
    assert "&amp;" in text and Table(text).open == []


def test_the_other_records() -> None:
    problem = cg.make_problem("reach-avoid-v0")
    assert repr(Box([-1.0, 0.0], [1.0, 4.0])) == "Box([-1, 1] x [0, 4])"
    assert repr(problem.propositions["p1"]) == "Proposition('agent_0', [0, 5))"
    assert repr(problem.specification) == "Specification('(!p2 | !p3) U p1', co-safe)"
    assert repr(cg.make_problem("cyclic-delivery-v0").specification).startswith("Specification(Automaton(3 states")
    assert repr(problem.agents[0]).splitlines() == [
        "LinearAgent 'agent_0': 1 state, 1 input, 1 output",
        "|-- workspace  [-20, 5]",
        "|-- inputs     [-5, 5]",
        "|-- start      uniform in [-20, 0]",
        "`-- noise      standard deviation 0.5",
    ]
    assert "start      none" in repr(problem.agents[0].replace(initial_state=None))
    assert "2 (1 agent), 1 (1 agent)" in repr(problem.labeling)


def test_worlds_print_how_many_there_are() -> None:
    dynamics = Dynamics.of(cg.make_problem("reach-avoid-v0"))
    assert repr(dynamics) == "Dynamics('reach-avoid-v0', 2 agents in 1 block)"
    worlds = core.initial(dynamics, np.random.default_rng(0), 1000)
    assert repr(worlds).splitlines()[0] == "Worlds: 1000" and "(1, 2, 1000)" in repr(worlds)
    inputs = tuple(np.zeros((1, 2, 1000)) for _ in dynamics.blocks)
    moved = core.transition(dynamics, worlds, inputs, core.noise(dynamics, np.random.default_rng(1), 1000))
    which = np.arange(1000) < 10
    restarted = core.restart(dynamics, moved, which, np.random.default_rng(2))
    assert "time      1\n" in repr(moved) and "time      0 to 1\n" in repr(restarted)
    assert f"failed    {int(moved.failed.sum())}\n" in repr(moved)


def test_the_pieces_of_these_texts() -> None:
    assert tree_text("empty", []) == "empty"
    assert shortened("a  b\nc") == "a b c" and len(shortened("a" * 1000, 50)) == 50
    assert names_text(["a", "b", "c", "d"]) == "a, b, c, d" and names_text(list("abcdef")) == "a, b, c, ..., f"
    assert box_text(np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 2.0])) == "[-1, 1]^2 x [0, 2]"
    assert box_text(np.arange(9.0), np.arange(9.0) + 1.0, closed=False).endswith("x [3, 4) x ... (9 axes)")


# --- what the same rooms count and cut ------------------------------------------------------------------------


@pytest.mark.parametrize("value", [True, 1.0, "1", None, np.bool_(True), np.float64(1.0), 0, 11])
def test_counts_are_whole_numbers(value: object) -> None:
    with pytest.raises(ValueError, match=r"`n`: expected a whole number from 1 to 10 \(steps\), got "):
        checked_count(value, "n", most=10, unit="steps")


def test_counts_become_ints() -> None:
    assert checked_count(np.int64(3), "n") == 3 and type(checked_count(np.int64(3), "n")) is int
    with pytest.raises(ValueError, match="`n`: expected a whole number of at least 0, got -1"):
        checked_count(-1, "n", least=0)


def test_columns_cut_joint_vectors() -> None:
    problem = cg.make_problem("building-automation-v0")
    assert problem.columns == (slice(0, 2), slice(2, 4)) and problem.input_columns == (slice(0, 1), slice(1, 2))
    assert problem.n_inputs == 2 and slices_of([]) == ()
    joint = np.arange(float(problem.n_states))
    assert [joint[columns].tolist() for columns in problem.columns] == [[0.0, 1.0], [2.0, 3.0]]


def test_replaced_problems_compute_their_properties_again() -> None:
    problem = cg.make_problem("reach-avoid-v0")
    before = problem.fingerprint, problem.initial_q, problem.tasks
    changed = problem.replace(horizon=3, initial_state=[[-10.0], [-4.0]], disturbance_scale=0.5, name="other")
    assert (changed.name, changed.horizon, changed.n_agents) == ("other", 3, 2)
    assert changed.fingerprint != before[0]
    there = problem.replace(initial_state=[[2.0], [-4.0]])
    assert changed.initial_q == before[1] == problem.automaton.initial and there.initial_q != before[1]
    assert changed.tasks == (changed,) and before[2] == (problem,)
    assert changed.labeling is problem.labeling and changed.automaton is problem.automaton
    assert problem.replace().fingerprint == problem.fingerprint
    for copied in (pickle.loads(pickle.dumps(changed)), copy.deepcopy(changed)):
        assert copied.fingerprint == changed.fingerprint and repr(copied) == repr(changed)
