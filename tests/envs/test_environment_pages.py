"""The pages of the environments say what the code does: written again, they are the files in docs."""

from __future__ import annotations

import numpy as np
import pytest

import certigym as cg
import environment_pages
import numbers_of_pages
from certigym.envs.interfaces import edges
from certigym.envs.simulation import batch_simulator as core


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    return environment_pages.pages()


def test_pages_have_not_drifted(texts: dict[str, str]) -> None:
    present = {path.name for path in environment_pages.FOLDER.iterdir()}
    filmed = environment_pages.filmed()
    films, cards = ({name for name in present if name.endswith(ending)} for ending in (".gif", ".png"))
    assert films == {f"{id}.gif" for id in filmed}, "run `python docs/draw_gallery.py`"
    assert cards == {f"{id}.png" for id in filmed}, "run `python docs/draw_cards.py`"
    assert present - films - cards == set(texts)
    for name, text in texts.items():
        written = (environment_pages.FOLDER / name).read_text(encoding="utf-8")
        assert written == text, f"{name} has drifted; run `python docs/environment_pages.py`"


def test_every_id_has_a_place_on_one_page(texts: dict[str, str]) -> None:
    """A variant is a row on the page of its base, and no base is a variant."""
    for id in cg.problem_ids():
        page = environment_pages.page_of_id(id)
        assert environment_pages.page_of_id(page) == page
        assert id in environment_pages.variants_of(page)
        assert f"`{id}`" in texts[f"{page}.md"] or f"certigym/{id}" in texts[f"{page}.md"]


def test_measured_numbers_are_about_these_problems() -> None:
    kept = numbers_of_pages.table("defaults")
    assert set(kept) == set(cg.problem_ids())
    for id, entry in kept.items():
        remedy = f"{id} has changed; run `python benchmarks/defaults.py {id}`"
        assert entry["fingerprint"] == cg.make_problem(id).fingerprint, remedy
        assert numbers_of_pages.verdict(entry) in ("confirmed", "consistent")
        assert entry["rollouts"]["episodes"] >= 100_000 and entry["check"] == "valid"
        most = entry["these models"]  # unknown under mean boxes
        assert entry["certified"] <= (1.0 if most is None else most)


@pytest.mark.parametrize("id", ["reach-avoid-v0", "meeting-v0", "door-formation-v0", "patrol-recharge-v0"])
def test_the_table_of_an_automaton_has_every_transition_that_points_can_take(id: str) -> None:
    problem = cg.make_problem(id)
    dynamics = core.Dynamics.of(problem)
    rng = np.random.default_rng(0)
    low = np.concatenate([agent.state_low for agent in problem.agents])
    high = np.concatenate([agent.state_high for agent in problem.agents])
    points = low + (high - low) * rng.random((20_000, low.size))
    letters = core.letters(dynamics, core.split_joint(dynamics, points))
    seen = {(edge.source, edge.target) for edge in edges(problem)}
    for q in range(problem.automaton.n_states):
        targets = problem.automaton.next_state(np.full(len(points), q), letters)
        assert {(q, int(target)) for target in targets} <= seen
