"""Value trees of agents with different relations: factors are stored as low as the check, which rounds its own way."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.policy_search.cell_certificates import certification


def mixed_team(horizon: int) -> cg.Problem:
    box: dict[str, Any] = {"input_low": [-1], "input_high": [1]}
    scaled = cg.Agent(
        name="a", states=["x"], inputs=["u"], dynamics=["x + 0.5*u"], noise_std=[0.2], noise_scale=["0.5 + 0.5*x^2"],
        state_low=[-3], state_high=[3], initial_state=[2.0], **box,
    )  # fmt: skip
    heavy = cg.Agent(
        name="b", states=["y"], inputs=["v"], dynamics=["0.9*y + 0.6*v"], state_low=[-6], state_high=[6],
        noise=[{"law": "student-t", "scale": 0.2, "df": 4.0}], initial_state=[-2.0], **box,
    )  # fmt: skip
    places = {
        "home_a": cg.Proposition("a", [-0.4], [0.4]),
        "safe_b": cg.Proposition("b", [-3], [3]),
        "home_b": cg.Proposition("b", [0.5], [1.5]),
    }
    task = "F home_a & (safe_b U home_b)"
    return cg.Problem(name="team", agents=[scaled, heavy], propositions=places, specification=task, horizon=horizon)


def test_unions_from_below_lower_the_factors_of_all_agents(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, stored = [], certification._stored

    def spied(problem: Any, joint: Any, terms: Any) -> Any:
        result = stored(problem, joint, terms)
        seen.append(([model.is_additive for model in joint.models], terms, result))
        return result

    monkeypatch.setattr(certification, "_stored", spied)
    kinds = {"a": "boxes", "b": "exact"}
    found = cg.synthesize(mixed_team(5), cells={"a": (8,), "b": (8,)}, relation=kinds)
    (additive, terms, lower) = seen[-1]
    assert additive == [False, True] and cg.check(found.certificate)
    # A remainder of the additive agent is as much a difference as one of the other.
    for before, after in zip(terms.factors, lower.factors, strict=True):
        positive = before > 1e-3
        assert positive.any() and np.all(after[positive] < before[positive] - 4e-10)


@pytest.mark.thorough
def test_a_team_of_mixed_relations_is_proved() -> None:
    cells = {"a": (60,), "b": (60,)}
    assert cg.check(cg.synthesize(mixed_team(15), cells=cells, relation={"a": "boxes", "b": "exact"}).certificate)
