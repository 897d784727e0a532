"""Stable-Baselines3 accepts the centralised environment with any options, without a warning."""

from __future__ import annotations

from typing import Any

import pytest

import certigym as cg
from kinds import IDS_OF_KINDS

env_checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="needs the extra `rl`")


@pytest.mark.parametrize("options", [{"dtype": "float32"}, {"reward": "shaped"}], ids=str)
@pytest.mark.parametrize("id", IDS_OF_KINDS)
def test_options_change_nothing_that_is_checked(id: str, options: dict[str, Any]) -> None:
    env_checker.check_env(cg.central_env(id, **options), warn=True)
