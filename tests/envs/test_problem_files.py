"""Any text is a problem or a ValueError of one line that names file, table and field; problems round-trip."""

from __future__ import annotations

import copy
import json
import pickle
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import certigym as cg
from certigym.envs.tasks.problem import load_problem
from certigym.envs.tasks.problem.problem_file import problem_from_dict, problem_from_toml
from kinds import ALL_IDS
from problems import linear
from sample_problems import TOML, mixed_problem

HOA = """HOA: v1
States: 2
Start: 0
AP: 1 "p1"
acc-name: Buchi
Acceptance: 1 Inf(0)
properties: deterministic complete
--BODY--
State: 0
[0] 1
[!0] 0
State: 1 {0}
[t] 1
--END--
"""
BY_HAND = """semantics = "co-safe"
states = ["start", "done", "lost"]
initial = "start"
accepting = ["done"]
transitions = [["start", "!p1 & all(safe)", "start"], ["start", "p1", "done"], ["done", "true", "done"]]
otherwise = "lost"
"""
HEAD = TOML[: TOML.index("[specification]")] + "[specification]\n"


def write(tmp_path: Path, text: str, name: str = "task.toml") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_the_example_of_the_readme_of_files(tmp_path: Path) -> None:
    problem = cg.load(write(tmp_path, TOML))
    assert problem.agent_names == ("left", "drone_0", "drone_1", "drone_2")
    assert problem.horizon == 12 and problem.name == "my-task"
    assert problem.automaton.propositions == ("p1", "safe_0", "safe_1", "safe_2")
    assert problem.families == {"safe": ("safe_0", "safe_1", "safe_2")}
    drone = linear(problem.agents[2])
    assert drone.A.shape == (2, 2) and drone.B.shape == (2, 1) and drone.offset.tolist() == [0.5, 0.0]
    assert drone.initial.low.tolist() == [-1.0, 0.0]
    assert not drone.has_identity_output and problem.agents[0].has_identity_output
    assert problem.automaton.accepts([{"safe_0", "safe_1", "safe_2"}, {"p1"}])
    assert not problem.automaton.accepts([{"safe_0", "safe_1"}, {"p1"}])


def test_automata_by_hand_and_from_hoa_equal_the_formula(tmp_path: Path) -> None:
    reach = cg.load(write(tmp_path, HEAD + 'formula = "F p1"\nsemantics = "co-safe"\n'))
    inline = cg.load(write(tmp_path, HEAD + f"hoa = '''{HOA}'''\n"))
    write(tmp_path, HOA, "reach.hoa")
    file = cg.load(write(tmp_path, HEAD + 'hoa = "reach.hoa"\n'))
    for problem in (inline, file):
        assert problem.automaton.semantics == "co-safe"
        words: list[list[set[str]]] = [[set()], [{"p1"}], [{"safe_0"}, {"p1"}], [{"p1"}, set()], []]
        for word in words:
            assert problem.automaton.accepts(word) == reach.automaton.accepts(word)
    by_hand = cg.load(write(tmp_path, HEAD + BY_HAND))
    assert by_hand.automaton.n_states == 3
    assert not by_hand.automaton.accepts([{"safe_0"}, {"p1"}])
    assert by_hand.automaton.accepts([{"safe_0", "safe_1", "safe_2"}, {"p1"}])


BAD = [
    ("name = ", "task.toml: expected TOML, got: "),
    ("", "task.toml: the problem: `agents` is missing"),
    (f'formula = "F goal"\n{TOML}', "unknown key 'formula'; it stands in the table `[specification]`, or above all"),
    (TOML.replace("horizon = 12", "horizon = 1.5"), "task.toml: `horizon`: expected a whole number"),
    (
        TOML.replace("noise_covariance = [[0.25]]", ""),
        "number 1 ('left'): `noise`: expected `noise`, `noise_covariance` or `noise_std`, got none",
    ),
    (TOML.replace("copies = 3", "copies = 0"), "number 2 ('drone'): `copies`: expected a whole number from 1 to 9999"),
    (TOML.replace('"drone_*"', '"dron_*"'), "`propositions.safe`: expected a pattern that matches an agent"),
    (TOML.replace("low = [0.0], ", ""), "task.toml: [propositions] 'p1': `low` is missing"),
    (TOML.replace("all(safe) U p1", "all(safe) U p2"), "task.toml: [specification]: `formula`: "),
    (TOML.replace('"co-safe"', '"safe"'), "[specification]: `semantics`: expected 'co-safe' or 'finite-trace'"),
    (
        TOML.replace('formula = "all(safe) U p1"', ""),
        "expected exactly one of formula, hoa, states, automaton, got none",
    ),
    (HEAD + 'hoa = "HOA: v1"', "task.toml: [specification] `hoa`: "),
    (HEAD + BY_HAND.replace('"!p1 & all(safe)"', '"all(safe)"'), "task.toml: [specification]: "),
    ("a = " + "[" * 5000, "expected TOML"),
    ("a = " + "9" * 5000, "expected TOML"),
]


@pytest.mark.parametrize(("text", "message"), BAD)
def test_errors_name_file_table_and_field(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError) as caught:
        cg.load(write(tmp_path, text))
    said = str(caught.value)
    assert message in said
    assert said.startswith("task.toml: ") and len(said.splitlines()) == 1


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="expected a readable problem file, got: No such file"):
        load_problem(tmp_path / "none.toml")
    with pytest.raises(ValueError, match="expected a readable problem file"):
        load_problem(tmp_path)
    with pytest.raises(ValueError, match="expected a readable problem file"):
        load_problem("a\0b")
    (tmp_path / "bytes.toml").write_bytes(b"name = '\xff'")
    with pytest.raises(ValueError, match="expected UTF-8 text, got an invalid byte at 8"):
        load_problem(tmp_path / "bytes.toml")


# Fuzzing: arbitrary text; arbitrary values at arbitrary places of a good file; arbitrary formulas.
scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.integers(-(10**400), 10**400),
    st.floats(),
    st.text(max_size=20),
    st.sampled_from(["left", "drone_*", "*", "co-safe", "finite-trace", "p1", "start", "true", 1e308, -1e100, 0, 1]),
    st.dates(),
    st.times(),
    st.datetimes(),
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
bases: list[dict[str, Any]] = [tomllib.loads(text) for text in (TOML, HEAD + BY_HAND, HEAD + f"hoa = '''{HOA}'''")]
fuzz = settings(suppress_health_check=list(HealthCheck))


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    found = [path] if path else []
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in inner:
        found += places(item, (*path, key))
    return found


def is_problem_or_one_line(make: Any) -> None:
    try:
        problem = make()
    except ValueError as error:
        # Below the line there may be an expression, with a caret under the mistake.
        said, _, below = str(error).partition("\n    ")
        assert len(said.splitlines()) == 1 and len(str(error)) < 2000, str(error)
        assert not below or below.endswith("^"), str(error)
    else:
        assert isinstance(problem, cg.Problem)
        assert problem.initial_q is None or 0 <= problem.initial_q < problem.automaton.n_states
        assert len(problem.fingerprint) == 64 and problem.labeling.classes
        cg.parallel_env(problem).reset(seed=0)


@fuzz
@given(st.one_of(st.text(), st.lists(st.sampled_from([*TOML.split(), "\n", "[", "]", "{", "}"])).map(" ".join)))
@example("\0")
@example("[[agents]]\n" * 3)
def test_any_text_is_a_problem_or_a_one_line_error(text: str) -> None:
    is_problem_or_one_line(lambda: problem_from_toml(text))


@fuzz
@given(data=st.data())
def test_any_value_anywhere_is_a_problem_or_a_one_line_error(data: st.DataObject) -> None:
    table = copy.deepcopy(data.draw(st.sampled_from(bases)))
    for _ in range(data.draw(st.integers(1, 2))):
        path = data.draw(st.sampled_from(places(table)))
        parent = table
        for key in path[:-1]:
            parent = parent[key]
        if data.draw(st.booleans()):
            parent[path[-1]] = data.draw(values)
        elif isinstance(parent, dict):
            del parent[path[-1]]
            parent[data.draw(st.text(max_size=10))] = data.draw(values)
        else:
            parent.append(data.draw(values))
    is_problem_or_one_line(lambda: problem_from_dict(table))


ROUND_TRIPS = [*ALL_IDS, "mixed", "toml", "by hand"]


def problem_of(name: str) -> cg.Problem:
    texts = {"toml": TOML, "by hand": HEAD + BY_HAND}
    if name in texts:
        return problem_from_toml(texts[name])
    return mixed_problem() if name == "mixed" else cg.make_problem(name)


@pytest.mark.parametrize("name", ROUND_TRIPS)
def test_problems_round_trip_through_json_and_pickle(name: str) -> None:
    problem = problem_of(name)
    for twin in (problem_from_dict(json.loads(json.dumps(problem.to_dict()))), pickle.loads(pickle.dumps(problem))):
        assert twin.fingerprint == problem.fingerprint and twin.name == problem.name
        assert twin.to_dict() == problem.to_dict()
        assert (twin.automaton.root == problem.automaton.root).all()


def test_fingerprints_tell_problems_apart() -> None:
    problem = cg.make_problem("reach-avoid-v0")
    same = [cg.make_problem("reach-avoid-v0"), problem.replace(name="other"), problem.replace(horizon=7)]
    assert {twin.fingerprint for twin in same} == {problem.fingerprint}
    agents = list(problem.agents)
    others = [
        problem.replace(horizon=6),
        problem.replace(initial_state=[-10.0, -3.0]),
        problem.replace(initial_state={"agent_0": [-10.0]}),
        *(
            cg.Problem(
                name=problem.name,
                horizon=7,
                agents=[agents[0].replace(**change), agents[1]],
                propositions=problem.propositions,
                specification=problem.specification,
            )
            for change in (
                {"A": [[np.nextafter(0.9, 1.0)]]},
                {"noise_covariance": [[0.5]]},
                {"input_high": [4.0]},
                {"state_high": [6.0]},
                {"offset": [1e-9]},
                {"output_matrix": [[0.5]]},
            )
        ),
        cg.Problem(
            name=problem.name,
            horizon=7,
            agents=agents,
            propositions={**problem.propositions, "p3": cg.Proposition("agent_1", [-20.0], [-14.0])},
            specification=problem.specification,
        ),
        cg.Problem(
            name=problem.name,
            horizon=7,
            agents=agents,
            propositions=problem.propositions,
            specification=cg.Specification("(!p2 | !p3) U p1", "finite-trace"),
        ),
    ]
    prints = [problem.fingerprint, *(other.fingerprint for other in others)]
    assert len(set(prints)) == len(prints)


def test_replace_takes_three_forms_of_a_start() -> None:
    problem = mixed_problem()
    flat = problem.replace(initial_state=[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    vectors = problem.replace(initial_state=[[1.0], [2.0, 3.0], [4.0], np.array([5.0, 6.0])])
    mapping = problem.replace(
        initial_state={"a_0": [1.0], "planar": [2.0, 3.0], "a_1": [4.0], "watcher": [5.0, 6.0]}, horizon=6
    )
    assert flat.fingerprint == vectors.fingerprint == mapping.fingerprint != problem.fingerprint
    assert flat.automaton is problem.automaton
    box = problem.replace(initial_low={"a_0": [0.0]}, initial_high={"a_0": [1.0]})
    assert not box.agents[0].initial.is_point
    assert box.agents[1] is problem.agents[1]
