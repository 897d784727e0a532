"""Examples run, and together show every public name."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path
from typing import Any

import pytest

import certigym as cg
from certigym.validation.policies import imitation, probing, training

FOLDER = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted(FOLDER.glob("*.py"))
NEEDS = {"09_learn_and_certify.py": "stable_baselines3", "10_many_workers.py": "dask"}
QUICKER: dict[str, dict[str, str]] = {
    "09_learn_and_certify.py": {"steps=10_000": "steps=2_000", "cells=500": "cells=80",
                                "episodes=4_000": "episodes=1_000", "steps=1_000": "steps=500"},
    "12_horizons_and_deadlines.py": {"100, horizon=(5": "40, horizon=(5", "horizon=6), 100": "horizon=6), 40",
                                     "problem, 60, horizon": "problem, 30, horizon",
                                     '("car-park-v0", above': '("car-park-v0", 40, above',
                                     '"invariance-b-20-v0", 100': '"invariance-b-20-v0", 40'},
    "05_cells_and_relations.py": {"(25, 100, 400)": "(25, 50)", "range(1, 8)": "range(1, 4)",
                                  "100, horizon": "50, horizon", "episodes=4_000": "episodes=1_000"},
}  # fmt: skip
"""Numbers of examples that say how long something takes, and smaller ones with which it is run here."""

SHORTENED = 10
"""A tenth of the regression of clones is run."""


@pytest.mark.pages
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_examples_run(script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needed = NEEDS.get(script.name)
    if needed is not None and importlib.util.find_spec(needed) is None:
        pytest.skip(f"needs {needed} (extra `rl` or `distributed`)")
    monkeypatch.chdir(tmp_path)
    shorten_cloning(monkeypatch)
    text = script.read_text(encoding="utf-8")
    for usual, small in QUICKER.get(script.name, {}).items():
        assert usual in text, "it is no longer in the example"
        text = text.replace(usual, small)
    exec(compile(text, str(script), "exec"), {"__name__": "__main__", "__file__": str(script)})


def shorten_cloning(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make regressions shorter, whose time is proportional to their rounds."""
    clone, rounds = training.clone, imitation.ROUNDS // SHORTENED

    def shorter(*arguments: Any, **settings: Any) -> float:
        return clone(*arguments, **{"rounds": rounds, **settings})

    monkeypatch.setattr(training, "clone", shorter)
    monkeypatch.setattr(probing, "clone", shorter)


def used_names(script: Path) -> set[str]:
    """Names `cg.NAME` in the code of a script (not in its comments)."""
    tree = ast.parse(script.read_text(encoding="utf-8"))
    names = (node for node in ast.walk(tree) if isinstance(node, ast.Attribute))
    return {node.attr for node in names if isinstance(node.value, ast.Name) and node.value.id == "cg"}


def test_together_they_show_every_public_name() -> None:
    shown = set().union(*map(used_names, SCRIPTS))
    assert set(cg.__all__) - {"__version__"} - shown == set()
