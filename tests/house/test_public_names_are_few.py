"""The surface: some 45 names, and each verb for everything that it makes sense for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import certigym as cg
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


def test_run_has_ten_options() -> None:
    commands = next(action for action in build_parser()._actions if hasattr(action, "choices") and action.choices)
    assert commands.choices is not None
    options = [action.dest for action in commands.choices["run"]._actions if action.option_strings]  # type: ignore[index]
    assert len({*options} - {"help", "verbose"}) <= 10, options
