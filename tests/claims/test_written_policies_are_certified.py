"""Textbook feedback, as expressions of states and the time: certified as it is, from a file or from Python."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.synthesis.relations.kinds import SymbolicPolicy

TEXT = """
name = "brake"
horizon = 14
[[agents]]
name = "cart"
states = ["x", "v"]
inputs = ["u"]
dynamics = ["x + 0.3*v + 0.045*u", "v + 0.3*u - 0.02*v*abs(v)"]
parameters = {k = 0.6}
noise = [{law = "gaussian", std = 0.02}, {law = "gaussian", std = 0.05}]
state_low = [-6, -3]
state_high = [6, 3]
input_low = [-1]
input_high = [1]
initial_state = [-2.5, 0]
[policy]
u = ["clip(-k*x - 1.2*v, -1, 1)"]
[propositions]
goal = {agent = "cart", low = [-0.8, -0.6], high = [0.8, 0.6]}
fast = {agent = "cart", of = ["v"], low = [1.9], high = [3.0]}
[specification]
formula = "!fast U goal"
"""


@pytest.fixture(scope="module")
def brake(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("written") / "brake.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_a_file_says_what_acts_and_is_certified(brake: Path, tmp_path: Path) -> None:
    """It saturates at first: what is cut off is inside what is enclosed."""
    found = cg.certify(str(brake))
    assert found.checked and 1.0 - found.certificate.lower_bound < 1e-6
    again = cg.certify(cg.load(brake), {"u": "max(-1, min(1, -0.6*x - 1.2*v))"})
    assert again.certificate.lower_bound == pytest.approx(found.certificate.lower_bound, abs=1e-6)
    assert cg.validate(found, 20_000, seed=0, confidence=1.0 - 1e-6).verdict != "refuted"
    cg.save(found, tmp_path / "c.npz")
    stored: Any = cg.load(tmp_path / "c.npz")
    assert cg.check(stored) and stored.proof.failure == found.certificate.proof.failure
    # The controller is the expression.
    x = np.random.default_rng(0).uniform(-3.0, 3.0, (2, 50))
    wanted = np.clip(-0.6 * x[0] - 1.2 * x[1], -1.0, 1.0)
    np.testing.assert_allclose(stored.controller.inputs(0, x, np.zeros(50, dtype=int), 3)[0], wanted, rtol=1e-12)
    # Another policy, or more noise, is another claim.
    other = SymbolicPolicy.of(stored.problem.agents[0], ["-0.6*x"])
    assert not cg.check(replace(stored, proof=replace(stored.proof, networks=(other,))))
    windy = cg.load(brake).replace(disturbance_scale=3.0)
    assert not cg.check(replace(stored, problem=windy), windy)


def test_agents_have_lists_of_their_own_which_may_name_the_time() -> None:
    agents = [
        cg.LinearAgent(name=name, A=[[1.0]], B=[[1.0]], noise_covariance=[[0.01]], state_low=[-4], state_high=[4],
                       input_low=[-0.5], input_high=[0.5], initial_state=[start])
        for name, start in (("a", -2.0), ("b", 2.0))
    ]  # fmt: skip
    regions = {"p": cg.Proposition("a", [-0.7], [0.7]), "q": cg.Proposition("b", [-0.7], [0.7])}
    problem = cg.Problem(name="two", horizon=10, agents=agents, propositions=regions,
                         specification=cg.Specification("F (p & q)"))  # fmt: skip
    found = cg.certify(problem, {"a": ["-0.8*x0"], "b": ["-0.8*x0*min(1, t/4 + 0.4)"]})
    assert found.certificate.lower_bound > 0.999 and found.checked
    assert cg.validate(found, 20_000, seed=1, confidence=1.0 - 1e-6).verdict != "refuted"


def test_the_command_line_takes_the_file(brake: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["certify", str(brake), "--episodes", "500", "--out", str(tmp_path / "c.npz")]) == 0
    assert "holds for the deployed policy" in capsys.readouterr().out
    assert main(["certify", "reach-avoid-v0"]) == 2
    assert "[policy]" in capsys.readouterr().err


def test_on_cells_the_claim_is_not_said_to_be_about_what_acts(brake: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Cells certify what expressions become on them, which acts otherwise."""
    main(["certify", str(brake), "--episodes", "500", "--cells", "10"])
    told = capsys.readouterr().out
    assert "not for the raw one" in told and "holds for the deployed policy" not in told
