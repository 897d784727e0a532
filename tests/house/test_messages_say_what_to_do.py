"""Mistakes are answered at once, by messages that name the argument, what was expected, what came, and a way out.

Each case is a mistake that a new user makes. Read aloud: the argument in backticks, "expected", "got", and the words
that say what to do (the last column).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.tasks.automata import automaton_from_hoa

PROBLEM = cg.make_problem("reach-avoid-v0", horizon=3)
PLANAR: dict[str, Any] = {
    "A": [[1.0, 0.5], [0.0, 1.0]],
    "B": [[0.0], [0.5]],
    "noise_covariance": np.eye(2) * 0.1,
    "state_low": [-10, -5],
    "state_high": [10, 5],
    "input_low": [-1],
    "input_high": [1],
    "initial_state": [0, 0],
}
STRIP = {"goal": cg.Proposition("cart", [4, -5], [6, 5])}


def agent(**changes: Any) -> cg.LinearAgent:
    given: dict[str, Any] = {
        "name": "cart",
        "A": [[0.9]],
        "B": [[0.5]],
        "noise_covariance": [[0.04]],
        "state_low": [-10],
        "state_high": [10],
        "input_low": [-3],
        "input_high": [3],
        "initial_state": [-6],
    }
    return cg.LinearAgent(**{**given, **changes})


def problem(
    who: cg.LinearAgent | None = None, propositions: Any = None, formula: str = "F goal", **changes: Any
) -> Any:
    given: dict[str, Any] = {
        "name": "task",
        "horizon": 5,
        "agents": [who or agent()],
        "propositions": propositions or {"goal": cg.Proposition("cart", [4], [6])},
        "specification": cg.Specification(formula, "co-safe"),
    }
    return cg.Problem(**{**given, **changes})


@cache
def result() -> cg.Synthesis:
    return cg.synthesize(PROBLEM, cells=20)


def stepped(actions: Any) -> Any:
    env = cg.parallel_env(PROBLEM)
    env.reset(seed=0)
    return env.step(actions)


def rendered(env: Any) -> Any:
    env.reset(seed=0)
    return env.render()


MISTAKES: list[tuple[Callable[[], Any], str, str]] = [
    # shapes and numbers of agents
    (lambda: agent(A=[0.9]), "A", "such as [[0.9]]"),
    (lambda: agent(input_low=[4]), "input_low", "exchange or correct the two"),
    (lambda: cg.Proposition("cart", [6], [4]), "low", "exchange or correct the two"),
    # regions, names, horizons
    (
        lambda: problem(propositions={"goal": cg.Proposition("cart", [40], [60])}),
        "propositions.goal",
        "correct the region",
    ),
    (lambda: problem(specification=3), "specification", "expected a Specification"),
    (lambda: cg.make_problem("reach-avoid"), "id", "did you mean 'reach-avoid-v0'?"),
    # synthesis
    (lambda: cg.synthesize(3), "problem", "make one with `make_problem`"),
    (lambda: cg.synthesize(PROBLEM, cell=10), "cell", "did you mean `cells`?"),
    (lambda: cg.synthesize(PROBLEM, relation="exakt"), "relation", "one of auto, boxes"),
    (lambda: automaton_from_hoa("hello", ["a"]), "hoa", "HOA: v1 at the beginning"),
    # environments
    (lambda: stepped({"agent_0": [0.0]}), "actions", "one for every agent"),
    # certificates and policies
    *(
        (lambda verb=verb: verb(PROBLEM), "certificate", "make one with `synthesize`")
        for verb in (cg.validate, cg.check, cg.audit, cg.stress)
    ),
    (lambda: cg.load("nowhere.npz"), "nowhere.npz", "write one with `save`"),
    (lambda: cg.rollout(PROBLEM, 3, 10), "controller", "`as_policy`"),
    (lambda: cg.rollout(PROBLEM, result(), 0), "episodes", "at least 1"),
    (lambda: cg.validate(result(), executor="tcp://here:8786"), "executor", "open one with `executor_for`"),  # type: ignore[arg-type]
    (lambda: cg.validate(result(), 10, confidence=99), "confidence", "strictly between 0 and 1"),
    (lambda: cg.validate(result(), 0), "episodes", "at least 1"),
    (lambda: cg.compare(PROBLEM, {"ours": "c.npz"}), "policies", "`load`"),
    (lambda: cg.Mismatch(noise_family="cauchy"), "noise_family", "one of gaussian"),
]


@pytest.mark.parametrize(("mistake", "argument", "remedy"), MISTAKES)
def test_python(
    mistake: Callable[[], Any], argument: str, remedy: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        mistake()
    message = str(caught.value)
    assert f"`{argument}`" in message, message
    came = any(words in message for words in (", got", "found none", "expected only with"))
    assert "expected" in message and came, message
    assert remedy in message, message
    assert len(message) < 400 and "\n" not in message, "one line that can be read"


AGENTS_THAT_NO_RELATION_TAKES = [
    ({}, "exact", "as many independent inputs as states"),
    ({}, "paper", "take `exact` or `linear`"),
    ({"noise_covariance": np.full((2, 2), 0.01)}, "auto", "ask for `path`"),
]


@pytest.mark.parametrize(("changes", "relation", "remedy"), AGENTS_THAT_NO_RELATION_TAKES)
def test_agents_that_a_relation_does_not_take(changes: dict[str, Any], relation: str, remedy: str) -> None:
    task = problem(agent(**{**PLANAR, **changes}), STRIP)
    with pytest.raises(ValueError, match="cart") as caught:
        cg.synthesize(task, cells=10, relation=relation)
    assert remedy in str(caught.value)


def test_a_certificate_for_another_problem_does_not_check() -> None:
    report = cg.check(result().certificate, PROBLEM.replace(horizon=4))
    assert not report and "made for another problem" in str(report)
    with pytest.raises(ValueError, match=r"is about another problem .* give its controller alone"):
        cg.compare(PROBLEM.replace(horizon=4), {"ours": result()})
    with pytest.raises(ValueError, match="reset the controller of this environment's own problem"):
        result().controller.reset(cg.parallel_env("invariance-4-v0").reset(seed=0)[0])


EXTRAS = [
    ("stable_baselines3", "rl", lambda: cg.train(PROBLEM, "ppo", steps=64)),
    ("PIL", "viz", lambda: rendered(cg.parallel_env(PROBLEM, render_mode="rgb_array"))),
]


@pytest.mark.parametrize(("module", "extra", "use"), EXTRAS)
def test_missing_extras_are_named(
    module: str, extra: str, use: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name == module or name.startswith(f"{module}.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "certigym.validation.policies.learners", raising=False)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises((ValueError, ImportError), match=rf"certigym\[{extra}\]"):
        use()
