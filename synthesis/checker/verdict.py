"""The verdict on a file: proved, refused, or unreadable; by which modules, and why not.

In this order: the machine's arithmetic, the file, the problem in it, the automaton against the formula, and the proof
by the module of its kind. A claim is proved if the bound that is recomputed is as good as the one that is claimed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from pathlib import Path
from typing import Any

import numpy as np

from . import cell_proofs, trajectories
from .fields import Entry, Refused
from .file import MOST_BYTES, Contents, read_file
from .formula import wrong_automaton
from .problem import read_problem
from .rigorous import Array, wrong_arithmetic

KINDS: dict[str, tuple[tuple[str, ...], Callable[..., Any], Callable[..., tuple[float, str, Any]]]] = {
    "trajectory": (("trajectories", "letters", "constraints"), trajectories.read_proof, trajectories.failure_of),
    "starts": (("trajectories", "networks", "feedbacks"), trajectories.read_starts, trajectories.failure_of_starts),
    "cells": (("cells", "motions", "distributions", "tree"), cell_proofs.read_proof, cell_proofs.failure_of),
}
"""Kinds of proofs: the modules of the checker that prove them, how they are read, and what follows from them."""


@dataclass(frozen=True)
class Verdict:
    """What became of a claim; truthy if it is proved.

    ``claimed`` is the upper bound on the probability that the task fails, as the file claims it, ``recomputed`` the one
    that was proved here (1 if none was), by ``modules`` of the checker. The ``reason`` says why the claim is refused,
    or in which sense it is proved. Along a trajectory ``steps`` says at each time how many deviations the nearest end
    of a constraint is away, which, and deviations (D,) of errors, to compare with a search's; of cells of starts,
    what fails from each at most, its largest part, and its start. Nothing rests on them.
    """

    proved: bool
    claimed: float
    recomputed: float
    modules: tuple[str, ...]
    reason: str
    steps: Sequence[tuple[float, str, Array]] = ()

    def __bool__(self) -> bool:
        return self.proved

    @property
    def lower_bound(self) -> float:
        """Lower bound on the probability that the task is satisfied, as claimed; 0 if it is not proved."""
        return bound_of(self.claimed) if self.proved else 0.0

    def __str__(self) -> str:
        claim = f"P >= {shown(self.claimed)}"
        if not self.proved:
            return f"REFUSED: {claim} is claimed: {self.reason}"
        return f"PROVED: {claim} (recomputed {shown(self.recomputed)}; by {', '.join(self.modules)}){self.reason}"


def check(path: str | Path, most_bytes: int = MOST_BYTES) -> Verdict:
    """Prove the claim of a certificate file again, from the file alone; ``Unreadable`` if it holds none."""
    return check_contents(read_file(path, most_bytes))


def check_contents(contents: Contents) -> Verdict:
    """Prove the claim of a file whose bytes were read (see ``check``)."""
    # First the machine, then what the file says, and only then what it claims.
    if wrong := wrong_arithmetic():
        raise ArithmeticError(f"nothing can be proved on this machine: {wrong}")
    problem = read_problem(contents.header)
    failure_claimed = contents.entry("claim").table(("failure",))["failure"]
    claimed = failure_claimed.number()
    if not 0.0 <= claimed <= 1.0:
        raise failure_claimed.expected("a probability")
    kind = contents.entry("proof").entries_by_name().get("kind", Entry(None, "proof.kind")).one_of([*KINDS])
    modules, read, failure_of = KINDS[kind]
    try:
        # What overflows becomes infinite or nan, and neither is ever better than a limit.
        with np.errstate(all="ignore"):
            proof = read(contents, problem)
            contents.everything_was_used()  # what nobody asked for might mean something elsewhere
            modules += getattr(proof, "more", ())
            if problem.formula is not None and (wrong := wrong_automaton(problem.automaton, problem.formula)):
                raise Refused(f"the automaton is not that of the formula: {wrong}")
            failure, worst, steps = failure_of(problem, proof)
    except (Refused, RecursionError) as error:  # trees are followed by functions that call themselves
        deep = "a formula or an expression is nested too deeply to be proved"
        return Verdict(False, claimed, 1.0, modules, str(error) if isinstance(error, Refused) else deep)
    if not failure <= claimed:  # nan proves nothing
        reason = f"a failure of at most {failure:.5g} follows, not {claimed:.5g}{worst}"
        return Verdict(False, claimed, failure, modules, reason, steps)
    given = "" if problem.formula is not None else "; the task is the automaton in the file, which has no formula"
    return Verdict(True, claimed, failure, modules, given, steps)


def bound_of(failure: float) -> float:
    """Return the lower bound that follows from an upper bound on the probability of failing, rounded down."""
    return 1.0 if failure <= 0.0 else max(0.0, math.nextafter(1.0 - failure, 0.0))


def shown(failure: float) -> str:
    """Return the lower bound that follows from a failure as text: rounded down, near 1 by what it lacks."""
    if 0.0 < failure < 1e-3:
        return f"1 - {float(Context(4, rounding=ROUND_CEILING).create_decimal(failure)):.4g}"
    return str(Decimal(bound_of(failure)).quantize(Decimal("0.000001"), ROUND_FLOOR))
