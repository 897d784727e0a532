"""Certificates along paths are reported like any other, with the tube along the path; what they do not know is said."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.certificates.proofs import KEPT, AlongPath, tube_along
from certigym.validation.statistical_tests import Loop, paths

FOLDER = Path(__file__).parents[2] / "benchmarks" / "arch"


@pytest.fixture(scope="module")
def building() -> AlongPath:
    """A building with four states, two of which are drawn."""
    found: Any = cg.synthesize(FOLDER / "bas_4_deviation.toml", relation="path").certificate
    return found


@pytest.fixture(scope="module")
def saved(building: AlongPath, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = str(tmp_path_factory.mktemp("saved") / "building.npz")
    cg.save(building, path)
    return path


@pytest.mark.thorough
def test_a_page_shows_claim_rollouts_and_tube(saved: str, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    content = cg.report(saved, page, episodes=2000)
    text = page.read_text(encoding="utf-8")
    assert not content.refuted and content.audit is None and content.field is None
    assert "0.99977" in text and text.count('<polygon class="tube') == 2 * 6 and "kept with probability 0.99" in text
    assert "Other starts" not in text and "Step by step" not in text


@pytest.mark.parametrize("axes", [(0,), (1, 0), (3,)])
def test_tubes_are_kept_as_often_as_they_say(building: AlongPath, axes: tuple[int, ...]) -> None:
    """20,000 rollouts; false alarm 1e-6. Inputs are cut off with probability below 2.2e-4, as the certificate says."""
    rows = np.eye(4)[list(axes)]
    tube = tube_along(building, rows)
    assert tube is not None and tube.middle.shape == (7, len(axes))
    states, _ = paths(Loop(building.problem, building.controller, 3, 20_000), 20_000)
    away = states[1:] @ rows.T - tube.middle[1:, None]
    distances = np.einsum("tmi,tij,tmj->tm", away, np.linalg.inv(tube.covariances[1:]), away)
    # Of episodes that ended early only what was seen counts; they are failures, fewer than the certificate allows.
    kept = np.all(~(distances > tube.radius**2), axis=0).sum()
    assert binom.cdf(kept, 20_000, KEPT - building.proof.failure) > 1e-6
    # Half the radius is left often: the tube is not merely large.
    assert np.all(~(distances > 0.25 * tube.radius**2), axis=0).mean() < 0.9


@pytest.mark.thorough
def test_no_probability_is_said_of_tubes_of_noise_that_is_not_normal(tmp_path: Path) -> None:
    """Other noise has other tails. Discs and polygons are drawn by their roles."""
    law = {"law": "laplace", "scale": 0.03}
    agent = cg.Agent(
        name="robot", states=["x", "y"], inputs=["u", "v"], dynamics=["x + u", "y + 0.5*x + v"], noise=[law, law],
        state_low=[-6, -6], state_high=[6, 6], input_low=[-1, -1], input_high=[1, 1], initial_state=[-3, 0],
    )  # fmt: skip
    task = cg.Specification("!rock U goal", "co-safe")
    regions = {
        "goal": cg.Proposition("robot", disc={"centre": [3, 1], "radius": 2}),
        "rock": cg.Proposition("robot", polygon={"corners": [[-2, 3], [0, 3], [-1, 5]]}),
    }
    problem = cg.Problem(name="far", horizon=8, agents=[agent], propositions=regions, specification=task)
    cg.report(cg.synthesize(problem, relation="path"), tmp_path / "page.html", episodes=50)
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "standard deviations around" in text and "kept with" not in text and "keep with" not in text
    drawn = re.findall(r'<(?:path|rect) class="(region[^"]*)"', text)
    assert {*drawn} == {"region r-reached", "region r-avoided"}


def test_agents_on_grids_have_no_tube() -> None:
    certificate: Any = cg.synthesize("reach-avoid-v0", 20).certificate
    assert tube_along(certificate, np.eye(certificate.problem.n_states)[:1]) is None
