"""Hostile files, formulas and numbers are refused in words, or answered, with little time and memory."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from adversary import arguments_of, problem_of
from certigym.envs.tasks.automata import translate, translation, within
from certigym.validation.presentation.paper import reproduce
from hostile import limited, outcome, problem, scalar
from kinds import mostly_thorough
from random_problems import random_spec

ROOT = Path(__file__).resolve().parents[2]

QUICK = [
    "rank of 400 digits", "rank below 0", "bounds of 400 digits", "gap of 400 digits",
    "feedback 1e308", "paper epsilon 1e308", "region up to 2.66e-239", "noise of 1e-300", "nested header",
    "half a pickle", "bound of 400 digits", "ten thousand brackets",
]  # fmt: skip
GREEDY = ["paper inputs 5e8", "paper, 5e8 inputs", "1e9 cells", "1e9 targets per cell", "long header", "X[999]"]


@pytest.mark.parametrize("name", QUICK)
def test_hostile_input_is_refused_in_words(name: str) -> None:
    row = outcome(name)
    assert not row["outcome"].startswith("crashed"), row


@pytest.mark.thorough
def test_greedy_input_keeps_within_its_limits() -> None:
    """All of these took gigabytes, or minutes; together they get 2 GiB of addresses and 30 seconds."""
    rows = list(limited(GREEDY, seconds=30.0, most=2 * 2**30))
    assert [row["case"] for row in rows] == GREEDY
    assert not [row for row in rows if row["outcome"].startswith("crashed")]


@pytest.mark.thorough
def test_joint_lattice_points_count_for_optional_statistics() -> None:
    """343,000 joint cells are few; their joint lattice points took 20 GiB."""
    (row,) = limited(["many lattice points"], seconds=60.0, most=3 * 2**30)
    assert row["outcome"] == "answered", row


@mostly_thorough("seed", [110, 2868, 3473], first=2)
def test_what_random_problems_found(seed: int) -> None:
    """An agent without propositions crashed the check; means that creep along crashed a synthesis."""
    spec = random_spec(seed)
    try:
        result = cg.synthesize(problem_of(spec), **arguments_of(spec))
    except ValueError:
        return
    assert cg.check(result), cg.check(result)


# --- what lies beyond the horizon ---------------------------------------------------------------------------
@pytest.mark.thorough
def test_states_beyond_the_horizon_are_left_out_and_nothing_else_changes() -> None:
    rng = np.random.default_rng(0)
    tasks = [("X[200] a", "co-safe"), ("F[80,190] a", "co-safe"), ("G[0,150] a", "finite-trace")]
    for text, semantics in tasks:
        whole = translate(text, ["a", "b"], semantics)
        for letters in (1, 5, 100):
            part = within(whole, letters)
            assert part.n_states <= whole.n_states
            for _ in range(50):
                length = int(rng.integers(0, letters + 1))
                word = [{name for name in "ab" if rng.random() < 0.5} for _ in range(length)]
                assert part.accepts(word) == whole.accepts(word), (text, letters, word)
    assert within(translate("X[200] a", ["a"], "co-safe"), 5).n_states <= 8


@pytest.mark.thorough
def test_a_longer_horizon_needs_more_states_and_starts_anew() -> None:
    results = cg.synthesize(problem("X[60] g", horizon=2, noise_covariance=[[1e-4]]), 12, horizon=[2, 65])
    assert [result.certificate.lower_bound > 0 for result in results] == [False, True]


# --- units ---------------------------------------------------------------------------------------------------
def test_noise_is_judged_in_units_of_its_own() -> None:
    """Metres and nanometres: the smallest variance is 1e-18 of the largest, and nothing is singular."""
    covariance = np.diag([0.04, 0.04e-18])
    agent = scalar(A=np.diag([0.9, 0.9]), B=np.diag([1.0, 1e-9]), noise_covariance=covariance)
    agent |= {"state_low": [-1.0, -1e-9], "state_high": [1.0, 1e-9], "initial_state": [0.0, 0.0]}
    agent |= {"input_low": [-0.5, -0.5], "input_high": [0.5, 0.5]}
    own = cg.Problem(
        name="units",
        horizon=3,
        agents=[cg.LinearAgent(**agent)],
        propositions={"g": cg.Proposition("robot", [-0.5, -1e-9], [0.5, 1e-9])},
        specification=cg.Specification("F g", "co-safe"),
    )
    result = cg.synthesize(own, 12)
    assert result.certificate.lower_bound > 0.5
    assert cg.check(result)


# --- files are written whole -----------------------------------------------------------------------------------
def certificate() -> Any:
    return cg.synthesize(problem("F g"), 12).certificate


WRITERS: dict[str, Callable[[Path], object]] = {
    "own.npz": lambda path: cg.save(certificate(), path),
    "own.csv": lambda path: reproduce._write(path, [{"a": 1}]),
    "own.svg": lambda path: reproduce._curves(path, [{"T": 1, "exact": 0.5}], "T", "P", "one"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_the_old_file(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, write = tmp_path / name, WRITERS[name]
    file.write_bytes(b"old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("certigym.envs.systems.arguments.saving.os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write(file)
    assert file.read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_write_bytes_is_the_only_way_to_a_file() -> None:
    """No module of the package opens files for writing."""
    direct = re.compile(
        r"\.write_text\(|\.write_bytes\(|open\([^)]*[\"'][wax]b?[\"']|savefig\(path|\.save\((out|path|target)"
    )
    found = []
    for folder in ("envs", "synthesis", "validation", "src/certigym/cli"):
        for path in sorted((ROOT / folder).rglob("*.py")):
            if path.name != "saving.py" and direct.search(path.read_text(encoding="utf-8")):
                found.append(str(path.relative_to(ROOT)))
    assert found == []


# --- automata that explode -----------------------------------------------------------------------------------
NAMES = [f"p{i}" for i in range(12)]
EXPLODING = {
    "windows of always": (" & ".join(f"F[0,40] G[0,{5 + i}] p{i}" for i in range(4)), "co-safe"),
    "nested windows": ("F[0,60] (p0 & F[0,60] (p1 & F[0,60] p2))", "co-safe"),
    "equivalences": (" <-> ".join(f"F p{i}" for i in range(12)), "finite-trace"),
    "memory": ("G (p0 -> X[40] p1)", "finite-trace"),
}
"""Formulas with automata of thousands of states, or large diagrams; some took a minute and a half to be refused."""


@pytest.mark.thorough
@pytest.mark.parametrize("name", EXPLODING)
def test_exploding_formulas_are_refused_within_seconds(name: str) -> None:
    """By a count of steps, not by a clock; the clock of this test has room for machines with other work."""
    text, semantics = EXPLODING[name]
    began = time.process_time()
    with pytest.raises(ValueError, match=r"too large|max_states|obligations"):
        translate(text, NAMES, semantics)
    assert time.process_time() - began < 5.0


@pytest.mark.thorough
def test_the_limit_is_a_count_and_leaves_room_for_large_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    large = "F[0,99] (p0 & F[0,99] (!p0 & F[0,99] p0))"
    assert translate(large, ["p0"], "co-safe").n_states == 497
    monkeypatch.setattr(translation, "MOST_STEPS", 100_000)
    for _ in range(2):  # the same steps each time
        with pytest.raises(ValueError, match="too many steps"):
            translate(large, ["p0"], "co-safe")


# --- noise that is scaled to nothing, or beyond all numbers ----------------------------------------------------
@pytest.mark.parametrize("scale", ["1e-300", "exp(900*x)", "exp(-900*x)", "x*1e-200", "1e-160", "1e-320"])
@pytest.mark.parametrize("law", [{"law": "gaussian", "std": 0.1}, {"law": "laplace", "scale": 0.1}])
def test_scaled_noise_out_of_range_is_refused_by_name(scale: str, law: dict[str, Any]) -> None:
    """They ended in a division by zero, or in a certificate that failed its check."""
    agent = cg.Agent(
        name="robot", states=["x"], inputs=["u"], dynamics=["0.5*x + u"], noise=[law], noise_scale=[scale],
        state_low=[-1.0], state_high=[1.0], input_low=[-0.5], input_high=[0.5], initial_state=[0.1],
    )  # fmt: skip
    task = cg.Problem(
        name="scaled", horizon=3, agents=[agent], propositions={"g": cg.Proposition("robot", [-0.5], [0.5])},
        specification=cg.Specification("F g", "co-safe"),
    )  # fmt: skip
    for relation in ("auto", "boxes", "linear", "best"):
        with pytest.raises(ValueError, match="noise_scale"):
            cg.synthesize(task, 20, relation=relation)
