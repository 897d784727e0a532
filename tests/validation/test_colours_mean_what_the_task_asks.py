"""Regions are drawn by what the task asks of them, as the automaton tells, in colours and hatches that stay apart."""

from __future__ import annotations

from itertools import combinations, product
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.envs.logic import translate
from certigym.envs.pictures import AGENTS, AGENTS_ON_DARK, AVOIDED, FREE, KEPT, LOOKS, MIXED, REACHED, Picture, roles
from certigym.envs.pictures.palette import rgb
from certigym.envs.pictures.scene import panels
from certigym.envs.pictures.task_roles import joined, proposition_roles
from certigym.validation.reports.page_style import PATTERNS, STYLE

CASES = [
    ("!wall U goal", "co-safe", {"wall": AVOIDED, "goal": REACHED}),
    ("safe U goal", "co-safe", {"safe": KEPT, "goal": REACHED}),
    ("G safe & F goal", "finite-trace", {"safe": KEPT, "goal": REACHED}),
    ("G !wall", "finite-trace", {"wall": AVOIDED}),
    ("G (a | b)", "finite-trace", {"a": KEPT, "b": KEPT}),
    ("F G a", "finite-trace", {"a": REACHED}),
    ("X a", "co-safe", {"a": REACHED}),
    # Nested: what comes later has the role that it has there.
    ("!a U (b & (!c U d))", "co-safe", {"a": AVOIDED, "b": REACHED, "c": AVOIDED, "d": REACHED}),
    ("F (a & (!b U c))", "co-safe", {"a": REACHED, "b": AVOIDED, "c": REACHED}),
    ("(!p | !q) U r", "co-safe", {"p": AVOIDED, "q": AVOIDED, "r": REACHED}),
    # Both signs: a proposition that is asked for and against at different times, or that chooses between ways.
    ("!b U a & F b", "co-safe", {"a": REACHED, "b": MIXED}),
    ("F a & F !a", "co-safe", {"a": MIXED}),
    ("(p & F a) | (!p & F b)", "co-safe", {"p": MIXED, "a": REACHED, "b": REACHED}),
    # The same in words that cancel: what does not matter has no role.
    ("F ((a & b) | (a & !b))", "co-safe", {"a": REACHED, "b": FREE}),
]


@pytest.mark.parametrize(("formula", "semantics", "expected"), CASES, ids=[case[0] for case in CASES])
def test_roles_are_those_that_a_reader_gives(formula: str, semantics: str, expected: dict[str, str]) -> None:
    assert proposition_roles(translate(formula, list(expected), semantics)) == expected


def test_turning_every_sign_round_turns_roles_round() -> None:
    """A role that came from the letters of the formula instead of its words would not follow."""
    for formula in ("!wall U goal", "F (a & (!b U c))"):
        names = sorted(set("".join(c if c.isalpha() else " " for c in formula).split()) - {"U", "F"})
        plain = proposition_roles(translate(formula, names, "co-safe"))
        turned = formula
        for name in names:
            turned = turned.replace(f"!{name}", f"#{name}").replace(name, f"!{name}").replace(f"#!{name}", name)
        other = proposition_roles(translate(turned, names, "co-safe"))
        for name in names:
            assert {plain[name], other[name]} <= {REACHED, AVOIDED, KEPT} and plain[name] != other[name]


def test_letters_that_no_point_has_do_not_tell() -> None:
    """By the automaton alone, a robot in `pickup` and in `loss` at once would make both of them good and bad."""
    told = roles(cg.make_problem("cyclic-delivery-v0"))
    assert (told["pickup"], told["loss"], told["delivery"]) == (REACHED, AVOIDED, REACHED)
    automaton = cg.make_problem("cyclic-delivery-v0").automaton
    assert proposition_roles(automaton)["loss_0"] == MIXED


def test_members_that_are_drawn_as_one_have_one_role() -> None:
    for a, b in product((REACHED, AVOIDED, KEPT, MIXED, FREE), repeat=2):
        assert joined([a, b]) == joined([b, a])
    assert joined([]) == FREE and joined([AVOIDED, REACHED]) == MIXED and joined([AVOIDED, FREE]) == AVOIDED


@pytest.mark.parametrize("id", ["meeting-v0", "invariance-b-100-v0", "patrol-recharge-v0", "fleet-v0"])
def test_every_region_that_is_drawn_has_a_role(id: str) -> None:
    for panel in panels(cg.make_problem(id)):
        assert {region.role for region in panel.regions} <= {REACHED, AVOIDED, KEPT}


# Machado, Oliveira and Fernandes (2009), severity 1, on linear rgb.
BLINDNESS = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    "none": np.eye(3),
}
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def linear(color: str) -> np.ndarray:
    share = np.array(rgb(color)) / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def lab(light: np.ndarray) -> np.ndarray:
    x = TO_XYZ @ np.clip(light, 0.0, 1.0) / np.array([0.95047, 1.0, 1.08883])
    f = np.where(x > 216 / 24389, np.cbrt(x), (24389 / 27 * x + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def apart(a: str, b: str) -> float:
    """The smallest distance in CIELAB that two colours have for any reader; about 2 can just be seen."""
    views = [np.array(matrix) for matrix in BLINDNESS.values()]
    return min(float(np.linalg.norm(lab(view @ linear(a)) - lab(view @ linear(b)))) for view in views)


def test_the_distance_knows_what_is_known() -> None:
    """Red and green of equal lightness are far apart, and near for readers without one kind of cone."""
    assert apart("#000000", "#ffffff") > 90 and apart("#b22222", "#5a6b00") < 15
    assert np.linalg.norm(lab(linear("#b22222")) - lab(linear("#5a6b00"))) > 60


@pytest.mark.parametrize("agents", [AGENTS, AGENTS_ON_DARK], ids=["light", "dark"])
def test_readers_with_any_colour_deficiency_tell_agents_and_roles_apart(agents: tuple[str, ...]) -> None:
    roles_told = [LOOKS[role].color for role in (REACHED, AVOIDED, KEPT, MIXED)]
    assert min(apart(a, b) for a, b in combinations(agents, 2)) > 15
    assert min(apart(a, b) for a, b in combinations(roles_told, 2)) > 15
    assert min(apart(a, b) for a, b in product(AGENTS, roles_told)) > 10


def test_agents_stand_out_from_the_page() -> None:
    """Contrast of at least 3 with white, and on dark pages with their cards, as for graphics in WCAG 2.1."""

    def light(color: str) -> float:
        return float(linear(color) @ np.array([0.2126, 0.7152, 0.0722]))

    assert min(1.05 / (light(color) + 0.05) for color in AGENTS) >= 3.0
    assert min((light(color) + 0.05) / (light("#1c222a") + 0.05) for color in AGENTS_ON_DARK) >= 3.0


def test_roles_are_told_without_colour() -> None:
    hatches = [LOOKS[role].hatch for role in (REACHED, AVOIDED, KEPT, MIXED, FREE)]
    assert len(set(hatches)) == 5
    assert all(f'id="look-{role}"' in PATTERNS and f".r-{role}{{" in STYLE for role in LOOKS)
    # Of frames in grey: regions of two roles differ in more than their lightness.
    picture = Picture(cg.make_problem("reach-avoid-v0"))
    masks = {hatch: np.asarray(mask) > 0 for hatch, mask in picture._hatches.items()}
    for a, b in combinations(masks, 2):
        assert (masks[a] != masks[b]).mean() > 0.05, (a, b)


def test_frames_show_the_colours_of_the_roles() -> None:
    env = cg.parallel_env("reach-avoid-v0", render_mode="rgb_array")
    env.reset(seed=0)
    frame = env.render()
    assert isinstance(frame, np.ndarray)
    seen = {tuple(color) for color in frame.reshape(-1, 3).tolist()}
    assert {LOOKS[role].rgb for role in (REACHED, AVOIDED)} <= seen  # rims and legend
    assert LOOKS[KEPT].rgb not in seen


def test_agents_of_different_workspaces_share_a_map_if_a_pair_is_about_both() -> None:
    def flyer(name: str, side: float) -> cg.LinearAgent:
        return cg.LinearAgent(
            name=name,
            A=np.eye(2),
            B=np.eye(2),
            noise_covariance=0.01 * np.eye(2),
            state_low=[-side, -side],
            state_high=[side, side],
            input_low=[-1.0, -1.0],
            input_high=[1.0, 1.0],
            initial_state=[0.5 * side, 0.0],
        )

    def pictured(pairs: bool) -> list[tuple[tuple[float, ...], int]]:
        near: dict[str, Any] = {"near": cg.Pair(("small", "large"), [-1.0, -1.0], [1.0, 1.0])} if pairs else {}
        home: dict[str, Any] = {"home": cg.Proposition("small", [0.0, 0.0], [1.0, 1.0])}
        problem = cg.Problem(
            name="two",
            horizon=3,
            agents=[flyer("small", 3.0), flyer("large", 6.0)],
            propositions=home | near,
            specification=cg.Specification("!near U home" if pairs else "F home", "co-safe"),
        )
        return [(panel.low, len(panel.curves)) for panel in panels(problem)]

    assert pictured(False) == [((-3.0, -3.0), 1), ((-6.0, -6.0), 1)]
    assert pictured(True) == [((-6.0, -6.0), 2)]
