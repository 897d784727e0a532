"""The Python blocks of the how-to pages run, in order, and what the pages claim of them holds."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

PAGES = Path(__file__).parents[1] / "docs" / "how-to"


def run(page: str) -> dict[str, Any]:
    """Execute all Python blocks of a page in one namespace."""
    text = (PAGES / page).read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    for block in re.findall(r"^```python\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL):
        exec(compile(block, page, "exec"), names)
    return names


def test_bring_your_own_controller(capsys: pytest.CaptureFixture[str]) -> None:
    names = run("bring_your_own_controller.md")
    raw, wrapped = names["result"].entries
    assert raw.lower_bound is None and wrapped.lower_bound > 0.7
    assert wrapped.ci_high >= wrapped.lower_bound and abs(raw.rate - wrapped.rate) < 0.05
    assert raw.inadmissible == 0
    assert names["improved"].certificate.lower_bound > 0.8
    for other in ("mixed", "again"):
        assert names[other].certificate.lower_bound > 0.0
    assert "common random numbers" in capsys.readouterr().out


def test_learned_policies(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")
    names = run("learned_policies.md")
    raw, certified, improved = names["result"].entries
    assert raw.lower_bound is None
    assert 0.0 < certified.lower_bound <= improved.lower_bound
    assert "information" in capsys.readouterr().out
