"""Regions are drawn by what the task asks of them, as the automaton tells, in colours and hatches that stay apart."""

from __future__ import annotations

import pytest

import certigym as cg
from certigym.envs.interfaces import AVOIDED, FREE, KEPT, MIXED, REACHED, SHARED, roles
from certigym.envs.interfaces.scene import panels
from certigym.envs.interfaces.task_roles import proposition_roles
from certigym.envs.tasks.automata import translate
from kinds import mostly_thorough

CASES = [
    ("!wall U goal", "co-safe", {"wall": AVOIDED, "goal": REACHED}),
    ("G safe & F goal", "finite-trace", {"safe": KEPT, "goal": REACHED}),
    ("G !wall", "finite-trace", {"wall": AVOIDED}),
    ("F G a", "finite-trace", {"a": REACHED}),
    # Nested: what comes later has the role that it has there.
    ("!a U (b & (!c U d))", "co-safe", {"a": AVOIDED, "b": REACHED, "c": AVOIDED, "d": REACHED}),
    ("(!p | !q) U r", "co-safe", {"p": SHARED, "q": SHARED, "r": REACHED}),
    ("G (!(p & q) & !w)", "finite-trace", {"p": SHARED, "q": SHARED, "w": AVOIDED}),
    # Both signs: a proposition that is asked for and against at different times, or that chooses between ways.
    ("!b U a & F b", "co-safe", {"a": REACHED, "b": MIXED}),
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
