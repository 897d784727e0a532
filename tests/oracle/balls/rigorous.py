"""The check with a proof of everything that it takes for granted: ball arithmetic in the place of trust in libraries.

``check`` runs as it is, whatever the certificate: agents and noise of any kind, every relation, trees and trains,
pairs, paths. On the way it states what it takes from special functions, factorisations and intervals
(``certificates.stated``): cell masses, charges, tails, boxes around means, invariant sets. Each statement is then
proved in balls (``ball_proofs``): every number of every table that a policy reads is on the right side of the truth.
What sums and products of these numbers may gain by rounding is bounded by counting them, and taken off
(docs/theory/numerics.md, "In balls").
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from math import nextafter
from typing import Any

import numpy as np

from certigym.envs.suite import as_problem
from certigym.synthesis.certificates.cell_probabilities import Statement, noted
from certigym.synthesis.certificates.proofs import certificate_from, members_of, told_assumed
from certigym.synthesis.extended_check.claims import check

BITS = 106
"""Precision of the balls: twice that of doubles."""


@dataclass(frozen=True)
class RigorousReport:
    """Outcome of ``check_rigorous``: truthy if the certificate stands.

    Parameters
    ----------
    valid : bool
    claimed : float
        The certificate's lower bound.
    low : float
        What is proved: the true probability is at least this. NaN if something was not proved.
    numbers : int
        How many numbers were proved in balls.
    failures : tuple of str
        What is wrong, in words.
    assumed : tuple of str
        Laws of noise whose numbers are those that their authors state, as in ``CheckReport``.
    """

    valid: bool
    claimed: float
    low: float
    numbers: int
    failures: tuple[str, ...]
    assumed: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return self.valid

    def __str__(self) -> str:
        if self.valid:
            bounds = f"claimed {self.claimed:.15g}, at least {self.low:.15g}"
            return f"proved in balls: {bounds} ({self.numbers:,} numbers){told_assumed(self.assumed)}"
        return "NOT proved: " + "; ".join(self.failures)


def check_rigorous(certificate: Any, problem: Any = None) -> RigorousReport:
    """Verify the lower bound of a certificate at its start, with a proof of every number that the check relies on.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
    problem : Problem, id or path, optional
        As for ``check``.

    Raises
    ------
    ValueError
        If states are angles, or the noise has a law that is known by the numbers of its author alone.
    """
    from flint import ctx

    given = certificate_from(certificate)
    problem = given.problem if problem is None else as_problem(problem)
    if any(agent.angles for agent in problem.agents):
        raise ValueError(
            "expected states that are numbers, got angles, whose copies of cells and regions are bounded by hand"
        )
    with noted() as statements:
        plain = check(given, problem)
    claimed = given.lower_bound
    if not plain:
        return RigorousReport(False, claimed, float("nan"), 0, plain.failures)
    with ctx.workprec(BITS):
        numbers, failures, memory = _proved(statements)
    if failures:
        return RigorousReport(False, claimed, float("nan"), numbers, tuple(dict.fromkeys(failures)))
    # Independent tasks have as many factors as there are parts, each at most 1; powers and products round.
    parts = len(members_of(given))
    rounded = 4.0 * parts * 2.0**-53 if parts > 1 else 0.0
    lost = parts * memory.sums + memory.differences
    low = max(0.0, nextafter((plain.recomputed - lost) * (1.0 - rounded), 0.0))
    bounds = [claimed, *getattr(given.proof, "bounds", {}).values()]
    wrong = tuple(f"its bound {bound:.15g} was not proved" for bound in bounds if not bound <= low)
    return RigorousReport(not wrong, claimed, low, numbers, wrong, plain.assumed)


def _proved(statements: list[Statement]) -> tuple[int, list[str], Any]:
    """Prove statements: how many numbers they hold, what is wrong, and what is remembered of all of them."""
    from .ball_memory import Memory
    from .ball_proofs import PROOFS

    memory, seen, failures, numbers = Memory(), set[Hashable](), list[str](), 0
    for statement in statements:
        key = (statement.name, *map(_key, statement.numbers))
        if key in seen:
            continue
        seen.add(key)
        try:
            count, wrong = PROOFS[statement.name](memory, *statement.numbers)
        except NotImplementedError as error:
            raise ValueError(
                f"expected noise whose law has a formula, got {error}: `check` counts with the error its author states"
            ) from None
        numbers, failures = numbers + count, failures + wrong
    return numbers, failures, memory


def _key(number: Any) -> Hashable:
    """What tells numbers apart: the bytes of arrays, the parts of pairs, and which record it is of records."""
    if hasattr(number, "told_apart_by"):
        return _key(number.told_apart_by)
    if isinstance(number, np.ndarray):
        return number.shape, number.tobytes()
    if isinstance(number, tuple | list):
        return tuple(map(_key, number))
    return number if isinstance(number, str | bytes | float | int) else id(number)
