"""Every id passes the checkers of PettingZoo, Gymnasium and Stable-Baselines3 (``benchmarks/conformance.py``)."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import pytest

import certigym as cg
import conformance
from kinds import ALL_IDS

pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")


@pytest.mark.parametrize("id", ALL_IDS)
def test_every_checker_accepts_every_id(id: str) -> None:
    said = {name: conformance.outcome(check, id) for name, check in conformance.CHECKS.items()}
    assert said == dict.fromkeys(conformance.CHECKS, "")


def test_a_seed_that_does_nothing_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    make = cg.central_env

    class Forgetful(gymnasium.Wrapper[Any, Any, Any, Any]):
        """An environment that takes a seed and forgets it."""

        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
            return self.env.reset(options=options)

    monkeypatch.setattr(cg, "central_env", lambda id: Forgetful(make(id)))
    assert "AssertionError" in conformance.outcome(conformance.episodes, "reach-avoid-v0")


def test_warnings_are_failures() -> None:
    assert conformance.outcome(lambda id: warnings.warn(f"{id} is odd", stacklevel=1), "it") == "UserWarning: it is odd"
