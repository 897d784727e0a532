"""``describe`` says which ways a problem will be certified in, and which do not apply and why, before any search."""

from __future__ import annotations

from pathlib import Path

import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.synthesis.abstraction.models import Settings
from certigym.synthesis.policy_search.portfolio import first_cells, linear_work, refinement_levels
from certigym.synthesis.relations.grids import RelationRefused
from certigym.synthesis.verbs.synthesize import strategies_ahead

OWN = Path(__file__).parents[2] / "examples" / "own"


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[str]:
    assert main(["describe", *arguments]) == 0
    return [line for line in capsys.readouterr().out.splitlines() if line.startswith(("way", "not"))]


def test_ways_stand_in_the_order_in_which_they_are_tried(capsys: pytest.CaptureFixture[str]) -> None:
    lines = said(capsys, str(OWN / "unicycle.toml"))
    assert lines[0].startswith("way 1: along a path, about ")
    assert lines[1].startswith("way 2: vertices") and lines[2].startswith("way 3: other relations")
    # told from fewer cells, as there are millions
    assert lines[-1].startswith("way 5: `linear`, level by level, about 2.")


def test_cells_that_nobody_gave_fit() -> None:
    """Four states, of which narrow cells would be a thousand million: refused in words, or default cells."""
    axes = {"state_low": [-3, -3, -1, -3], "state_high": [3, 3, 1, 3], "input_low": [-2], "input_high": [2]}
    cart = cg.Agent(
        name="cart", states=["x", "v", "th", "w"], inputs=["u"], initial_state=[0, 0, 0, 0], **axes,
        dynamics=["x + 0.1*v", "v + 0.1*u", "th + 0.1*w", "w + 0.1*(sin(th) - u*cos(th))"],
        noise=[{"law": "gaussian", "std": 0.01}] * 4,
    )  # fmt: skip
    goal = cg.Proposition("cart", [2, -3, -1, -3], [3, 3, 1, 3])
    task = cg.Specification("F goal", "co-safe")
    problem = cg.Problem(name="far", horizon=5, agents=[cart], propositions={"goal": goal}, specification=task)
    with pytest.raises(RelationRefused, match=r"grids hold 2e\+07 at most") as refusal:
        linear_work(problem, Settings(), lambda *models: cg.synthesize(problem))
    assert "fewer" not in str(refusal.value)
    assert first_cells(problem) is None


def test_who_asks_for_cells_is_told_to_ask_for_fewer() -> None:
    with pytest.raises(ValueError, match="ask for fewer `cells`"):
        cg.synthesize(cg.load(OWN / "unicycle.toml"), (60, 60, 60), relation="linear")


def test_laws_without_paths_are_named(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    text = (
        (OWN / "heat_pump.toml")
        .read_text()
        .replace(
            'law = "uniform", low = -0.4, high = 0.4',
            'law = "scipy", name = "gumbel_r", scale = 0.2, cdf_error = 1e-9, variation = 4.0',
        )
    )
    file = tmp_path / "scipy.toml"
    file.write_text(text)
    (line,) = [line for line in said(capsys, str(file)) if line.startswith("not along a path")]
    assert "exponential moments are known, got scipy" in line


@pytest.mark.thorough
def test_what_is_said_is_what_is_tried() -> None:
    problem = cg.load(OWN / "response.toml")
    ((task, strategies),) = strategies_ahead(problem)
    assert task is problem
    tried = cg.synthesize(problem).stats["tried"]
    assert isinstance(tried, dict)
    assert {strategy.name for strategy in strategies} - {"others", "finer cells"} <= {*tried}
    assert strategies[0].name in tried and isinstance(tried[strategies[0].name], float)


def test_nothing_is_counted_for_boxes_of_no_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """Decisions of automata of thousands of states take long to count."""
    monkeypatch.setattr(refinement_levels, "count_of_decisions", lambda problem: pytest.fail("counted"))
    assert refinement_levels.box_work(cg.make_problem("reach-avoid-v0"), {}) == 0.0


@pytest.mark.parametrize("dynamics", [["0.9*x + 0.8*u", "0.9*y + 0.5*x"], ["0.9*x + 0.8*u", "0.9*y + 0.5*sin(x)"]])
def test_correlated_noise_which_no_grid_knows_gets_a_path(dynamics: list[str]) -> None:
    agent = cg.Agent(
        states=["x", "y"], inputs=["u"], dynamics=dynamics, noise_covariance=[[7e-4, 3e-4], [3e-4, 7e-4]],
        state_space=(-4, 4), input_space=(-1, 1), start=(1.46, 0.21),
    )  # fmt: skip
    goal = {"goal": {"low": [-0.4, 0.1], "high": [0.9, 1.6]}}
    found = cg.synthesize(cg.Problem(agents=agent, horizon=4, propositions=goal, specification="F goal"))
    assert found.certificate.proof.kind == "path" and found.lower_bound > 0.9 and cg.check(found).valid
