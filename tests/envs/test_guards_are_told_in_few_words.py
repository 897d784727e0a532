"""Guards of automata as text: covers against all letters, families by name, and guards that are too long."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from certigym.envs.interfaces.guard_texts import guard_text
from certigym.envs.tasks.automata import DecisionDiagrams, cover


def _function(diagrams: DecisionDiagrams, table: np.ndarray, variables: int) -> int:
    """Return the node of a truth table of shape (2,) * variables."""
    letters = [
        diagrams.conjoin_all(diagrams.literal(k, bool(bit)) for k, bit in enumerate(bits))
        for bits in product((0, 1), repeat=variables)
        if table[bits]
    ]
    return diagrams.disjoin_all(letters)


def _covered(cubes: list[dict[int, bool]], bits: tuple[int, ...]) -> bool:
    return any(all(bool(bits[k]) == value for k, value in cube.items()) for cube in cubes)


@pytest.mark.parametrize("variables", [1, 3, 5])
def test_covers_lie_between_both_functions_and_no_part_can_be_left_out(variables: int) -> None:
    rng = np.random.default_rng(variables)
    for _ in range(40):
        lower = rng.random((2,) * variables) < rng.random()
        upper = lower | (rng.random((2,) * variables) < rng.random())
        diagrams = DecisionDiagrams()
        cubes = cover(diagrams, _function(diagrams, lower, variables), _function(diagrams, upper, variables), 1000)
        assert cubes is not None
        letters = list(product((0, 1), repeat=variables))
        for bits in letters:
            assert lower[bits] <= _covered(cubes, bits) <= upper[bits]
        for k in range(len(cubes)):
            rest = cubes[:k] + cubes[k + 1 :]
            assert any(lower[bits] and not _covered(rest, bits) for bits in letters), "a cube is superfluous"


def test_a_cover_that_would_be_too_long_is_not_made() -> None:
    diagrams = DecisionDiagrams()
    parity = 0
    for k in reversed(range(12)):  # no two letters of a parity share a cube
        parity = diagrams.node(k, parity, diagrams.negate(parity))
    assert cover(diagrams, parity, parity, most=1000) is None
    assert len(cover(diagrams, parity, parity, most=100_000) or []) == 2**11


def test_guards_name_families_once() -> None:
    names, families = ["a_0", "a_1", "b"], {"a": ("a_0", "a_1")}
    assert guard_text([{0: True, 1: True}], names, families) == "all(a)"
    assert guard_text([{0: False, 1: False, 2: True}], names, families) == "!any(a) & b"
    assert guard_text([{0: False}, {1: False}], names, families) == "!all(a)"
    assert guard_text([{0: True}, {1: True}, {2: False}], names, families) == "any(a) or !b"
    assert guard_text([{0: True}, {1: False}], names, families) == "a_0 or !a_1"
    assert guard_text([{}], names, families) == "any letter"
