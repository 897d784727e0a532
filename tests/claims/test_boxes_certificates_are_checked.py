"""Certificates of mean boxes survive files, rollouts and audits; forged ones, and those of wrong searches, do not."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import certigym as cg
from certigym.synthesis.abstraction.kernels.box_kernel import BoxKernel
from certigym.synthesis.abstraction.kernels.kernel import Kernel
from certigym.synthesis.abstraction.models import box_choices
from certigym.synthesis.relations.kinds import BoxRelation, MeanBoxes
from forged_cells import CLAIMS, MENU, Forge, inputs_of, one_choice, part_changed, relation_changed
from kinds import mostly_thorough
from problems import cart, cart_reach, two_agents


@cache
def of_cart() -> cg.Certificate:
    """A cart with one input."""
    return cg.synthesize(cart_reach(cart()), [30, 15], relation="boxes").certificate


@cache
def of_team() -> cg.Certificate:
    """Two scalar agents; terms are united from below, and remainders are kept."""
    return cg.synthesize(two_agents(horizon=4, noise_covariance=[[0.8]]), 40, relation="boxes").certificate


CERTIFICATES = {"cart": of_cart, "team": of_team}


def shifted(certificate: cg.Certificate, steps: float) -> cg.Certificate:
    lattice = tuple(axis + steps * (axis[1] - axis[0]) for axis in certificate.proof.agents[0].lattice)
    return part_changed(certificate, lattice=lattice)


def coarser(certificate: cg.Certificate) -> cg.Certificate:
    return part_changed(certificate, lattice=tuple(axis[::5] for axis in certificate.proof.agents[0].lattice))


def uneven(certificate: cg.Certificate) -> cg.Certificate:
    """A lattice with a point in another place: second differences of it would mean nothing."""
    axes = [axis.copy() for axis in certificate.proof.agents[0].lattice]
    axes[0][len(axes[0]) // 2] += 0.3 * (axes[0][1] - axes[0][0])
    return part_changed(certificate, lattice=tuple(axes))


FORGERIES: dict[str, Forge] = {
    **CLAIMS,
    **MENU,
    "feedback inside cells": lambda c: relation_changed(c, gains=[[[1.0]]] * len(inputs_of(c))),
    "one input everywhere": lambda c: one_choice(c, 0),
    "a coarser lattice": coarser,
    "a lattice that does not reach": lambda c: shifted(c, 200.0),
    "an uneven lattice": uneven,
    "called linear": lambda c: part_changed(c, relation={"kind": "linear", "menu": inputs_of(c).tolist(), "parts": 2}),
}


@mostly_thorough("name", CERTIFICATES)
@pytest.mark.parametrize("forgery", FORGERIES)
def test_forgeries_are_refused_in_words(forgery: str, name: str, tmp_path: Path) -> None:
    certificate = CERTIFICATES[name]()
    try:
        cg.save(FORGERIES[forgery](certificate), tmp_path / "forged.npz")
        report = cg.check(cg.load(tmp_path / "forged.npz"))
    except ValueError as refusal:
        assert str(refusal)
    else:
        assert not report and report.failures


def middle_values(numbers: NDArray, shape: tuple[int, ...], low: NDArray, high: NDArray) -> NDArray:
    """What is nearest to the middle of the boxes, in place of the least value."""
    index = np.rint(0.5 * (low + high)).astype(np.int64)
    return np.asarray(numbers[:, np.ravel_multi_index(tuple(index.T), shape)])


def shrunk(relation: BoxRelation, low: NDArray, high: NDArray) -> MeanBoxes:
    """Boxes a fiftieth narrower than they are."""
    boxes = ENCLOSED(relation, low, high)
    less = 0.01 * (boxes.high - boxes.low)
    return MeanBoxes(boxes.low + less, boxes.high - less, boxes.admissible)


def rounded_inward(*of: Any) -> tuple[NDArray, NDArray]:
    """Boxes to the lattice points inside of them, where there are any."""
    low, high = PLACED(*of)
    a, b = np.ceil(low), np.floor(high)
    return np.where(a <= b, a, low), np.where(a <= b, b, high)


def moved_aside(relation: BoxRelation, low: NDArray, high: NDArray) -> MeanBoxes:
    """Centres of cells elsewhere: the boxes are those of neighbours."""
    boxes = ENCLOSED(relation, low, high)
    moved = 0.05 * (high - low)[:, None]
    return MeanBoxes(boxes.low + moved, boxes.high + moved, boxes.admissible)


ENCLOSED, PLACED = BoxRelation.mean_boxes, box_choices.positions

SABOTAGE: dict[str, tuple[Any, str, Any]] = {
    "a value in the middle instead of the least": (box_choices, "least_over_boxes", middle_values),
    "the charge left out": (BoxKernel, "backup", Kernel.backup),
    "boxes shrunk": (BoxRelation, "mean_boxes", shrunk),
    "positions rounded inward": (box_choices, "positions", rounded_inward),
    "boxes moved": (BoxRelation, "mean_boxes", moved_aside),
}


@pytest.mark.parametrize("sabotage", SABOTAGE)
@mostly_thorough("name", CERTIFICATES)
def test_the_check_refuses_what_a_wrong_search_claims(
    sabotage: str, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search is broken, the check is not: it shares none of the code that was changed."""
    honest = CERTIFICATES[name]()
    monkeypatch.setattr(*SABOTAGE[sabotage])
    cells = [30, 15] if name == "cart" else 40
    certificate = cg.synthesize(
        honest.problem, cells, relation="boxes", search=cg.SearchOptions(targets_per_cell=4)
    ).certificate
    report = cg.check(certificate)
    assert not report and "exceeds" in " ".join(report.failures)


def test_boxes_stand_beside_relations_that_are_never_lost() -> None:
    problem = two_agents(horizon=3, noise_covariance=[[0.8]])
    for other in ("exact", "linear"):
        certificate = cg.synthesize(problem, 40, relation={"one": "boxes", "two": other}).certificate
        assert cg.check(certificate) and certificate.lower_bound > 0.5 and certificate.gap is None
    with pytest.raises(ValueError, match="never lost beside `boxes`"):
        cg.synthesize(problem, 40, relation={"one": "boxes", "two": "paper"})
