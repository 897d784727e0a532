"""Convex sets of starts keep what they claim between their corners, and their check finds what is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates import StartHull
from certigym.synthesis.checking import wrong_hull
from certigym.synthesis.nominal_paths import certified_starts

FOLDER = Path(__file__).parents[1] / "benchmarks" / "arch"


def hull_of(row: str, level: float, rays: int = 16) -> StartHull:
    """Return the set of starts of a row over its first two states."""
    certificate: Any = cg.synthesize(FOLDER / f"{row}.toml", relation="path").certificate
    return certified_starts(certificate, level, (0, 1), rays)


@pytest.fixture(scope="module")
def chain() -> StartHull:
    return hull_of("chain_2", 0.8, 64)


def test_sets_are_at_least_as_large_as_those_published(chain: StartHull) -> None:
    assert chain.share > 0.629 and chain.failure <= 0.2
    assert wrong_hull(chain) == []


def test_starts_between_the_corners_have_certificates_of_their_own(chain: StartHull) -> None:
    generator = np.random.default_rng(0)
    for _ in range(5):
        weights = generator.dirichlet(np.full(len(chain.corners), 0.05))
        certificate = chain.at(weights @ chain.corners)
        assert cg.check(certificate).valid
    with pytest.raises(ValueError, match="hull of the corners"):
        chain.at(np.array([9.9, 9.9]))


def test_rollouts_do_not_refute_corners(chain: StartHull) -> None:
    """Four corners by 20,000 rollouts each; false alarm 1e-6 altogether."""
    for i in range(0, 64, 16):
        certificate = chain.corner(i)
        verdict = cg.validate(certificate, 20_000, seed=i, confidence=1.0 - 1e-6 / 4)
        assert verdict.verdict != "refuted"


def test_the_check_finds_what_is_wrong(chain: StartHull) -> None:
    far = chain.corners.copy()
    far[0] = 1.05 * far[0]
    assert wrong_hull(replace(chain, corners=far))
    assert wrong_hull(replace(chain, failure=0.5 * chain.failure))
    letters = chain.letters.copy()
    letters[-1] = 0
    assert wrong_hull(replace(chain, letters=letters))
    assert wrong_hull(replace(chain, inputs=-chain.inputs))


def test_first_letters_must_not_depend_on_the_start() -> None:
    hull = hull_of("bas_4_deviation", 0.8)
    assert wrong_hull(hull) == [] and hull.share > 0.9
    # A corner on the edge of the safe set, up to rounding, may be on either side of it.
    edge = hull.corners.copy()
    edge[np.argmax(edge[:, 0]), 0] = 20.5
    assert "first letter" in wrong_hull(replace(hull, corners=edge))[0]


def test_levels_below_a_half_are_refused(chain: StartHull) -> None:
    certificate = chain.corner(0)
    with pytest.raises(ValueError, match="`level`"):
        certified_starts(certificate, 0.3)
