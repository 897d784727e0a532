"""The surface: some 45 names, and each verb for everything that it makes sense for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.cli.parser import build_parser


@pytest.fixture(scope="module")
def problem() -> cg.Problem:
    return cg.make_problem("reach-avoid-v0", horizon=3)


@pytest.fixture(scope="module")
def result(problem: cg.Problem) -> cg.Synthesis:
    return cg.synthesize(problem, 24, relation="exact")


def test_there_are_few_names() -> None:
    assert len(cg.__all__) <= 46


def test_other_names_are_unknown() -> None:
    with pytest.raises(AttributeError, match="synthesise"):
        _ = cg.synthesise  # type: ignore[attr-defined]


def test_what_has_a_file_is_saved_loaded_and_checked(result: cg.Synthesis, tmp_path: Path) -> None:
    claims: dict[str, Any] = {"c.npz": result, "d.npz": result.certificate}
    for name, claim in claims.items():
        path = cg.save(claim, tmp_path / name)
        loaded = cg.load(path)
        assert cg.check(loaded) and cg.check(path) and cg.check(str(path), "reach-avoid-v0").valid is False
        assert loaded.lower_bound == getattr(claim, "certificate", claim).lower_bound
    with pytest.raises(ValueError, match="`agent`: expected none"):
        cg.save(result, tmp_path / "c.npz", agent="agent_0")
    assert cg.load(Path(__file__).parents[2] / "examples" / "own" / "disc.toml").name == "disc"


def test_shields_take_environments_and_policies(problem: cg.Problem, result: cg.Synthesis) -> None:
    probability = 0.9 * result.certificate.lower_bound
    env = cg.shield(problem, result, probability=probability)
    told = env.reset(seed=0)[1]["agent_0"]
    assert 0.0 < told["budget"] <= told["value"]
    policy = cg.shield(lambda x, q, t: np.zeros(1), result, probability=probability)
    rate = cg.rollout(problem, policy, 500, seed=1)
    # A guarded policy fails its promise in 500 episodes with a probability below 1e-6 where it keeps so much more.
    assert rate.successes / 500 >= probability - 5.0 * np.sqrt(0.25 / 500)
    with pytest.raises(ValueError, match="shield the environment first"):
        cg.shield(type("Wrapped", (), {"reset": None, "step": None})(), result, probability=probability)


@pytest.mark.parametrize("horizon", ["soon", [], 2.5])
def test_other_horizons_are_refused(problem: cg.Problem, horizon: Any) -> None:
    with pytest.raises(ValueError, match="`horizon`: expected control steps"):
        cg.synthesize(problem, 24, horizon=horizon)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--restarts", "4"], "`certigym synthesize` and `certigym validate` have all options"),
        (["--nothing"], "unrecognized arguments: --nothing\n"),
    ],
)
def test_run_says_where_its_other_options_are(words: list[str], says: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["run", "reach-avoid-v0", *words])
    assert says in capsys.readouterr().err


def test_run_has_ten_options() -> None:
    commands = next(action for action in build_parser()._actions if hasattr(action, "choices") and action.choices)
    assert commands.choices is not None
    options = [action.dest for action in commands.choices["run"]._actions if action.option_strings]  # type: ignore[index]
    assert len({*options} - {"help", "verbose"}) <= 10, options
