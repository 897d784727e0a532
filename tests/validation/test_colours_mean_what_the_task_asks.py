"""Regions are drawn by what the task asks of them, as the automaton tells, in colours and hatches that stay apart."""

from __future__ import annotations

import numpy as np
import pytest

import certigym as cg
from certigym.envs.interfaces import AVOIDED, FREE, KEPT, MIXED, REACHED, SHARED, roles
from certigym.envs.interfaces.palette import rgb
from certigym.envs.interfaces.scene import panels
from certigym.envs.interfaces.task_roles import proposition_roles
from certigym.envs.tasks.automata import translate
from kinds import mostly_thorough

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
    ("(!p | !q) U r", "co-safe", {"p": SHARED, "q": SHARED, "r": REACHED}),
    ("G (!(p & q) & !w)", "finite-trace", {"p": SHARED, "q": SHARED, "w": AVOIDED}),
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


@mostly_thorough("id", ["meeting-v0", "invariance-b-100-v0", "patrol-recharge-v0", "fleet-v0"], first=3)
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
