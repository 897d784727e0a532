"""Coupled agents have one automaton: as large as it is when it is built, and not as the product of its parts fears."""

from __future__ import annotations

from pathlib import Path

import certigym as cg
from certigym.envs.tasks.automata import translate
from certigym.envs.tasks.problem import groups

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "eight_zones.toml"


def test_a_window_of_eight_zones_has_few_states() -> None:
    problem = cg.load(EXAMPLE)
    assert problem.groups == () and problem.automaton.n_states == 23
    # 20 states for each of eight zones: the product is far above the limit that was compared with it.
    alone = translate("G[8,20] a", ["a"], "finite-trace")
    assert alone.n_states**8 > groups.MOST_STATES
