"""The verdict on a file: proved, refused, or unreadable; by which modules, and why not.

In this order: the machine's arithmetic, the file, the problem in it, the automaton against the formula, and the proof
by the module of its kind. A claim is proved if the bound that is recomputed is as good as the one that is claimed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import cell_proofs, fields, trajectories
from .fields import Refused
from .file import MOST_BYTES, Contents, read_file
from .formula import wrong_automaton
from .problem import Problem, read_problem
from .selftest import wrong_arithmetic

KINDS = {
    "trajectory": ("trajectories", "letters", "constraints"),
    "cells": ("cells", "motions", "tables", "labels", "tree"),
}
"""Kinds of proofs, and the modules of the checker that prove them."""


@dataclass(frozen=True)
class Verdict:
    """What became of a claim; truthy if it is proved.

    Parameters
    ----------
    proved : bool
    claimed : float
        Upper bound on the probability that the task fails, as the file claims it.
    recomputed : float
        Upper bound on it that was proved here, 1 if none was.
    modules : tuple of str
        Modules of the checker for this kind of proof.
    reason : str
        Why the claim is refused, or in which sense it is proved.
    """

    proved: bool
    claimed: float
    recomputed: float
    modules: tuple[str, ...]
    reason: str

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
    """Prove the claim of a certificate file again, from the file alone.

    Raises
    ------
    Unreadable
        If the file holds no certificate of this format.
    OSError
        If it cannot be read.
    """
    return check_contents(read_file(path, most_bytes))


def check_contents(contents: Contents) -> Verdict:
    """Prove the claim of a file whose bytes were read (see ``check``)."""
    # First the machine, then what the file says, and only then what it claims.
    if wrong := wrong_arithmetic():
        raise ArithmeticError(f"nothing can be proved on this machine: {wrong}")
    problem = read_problem(contents.header)
    claim = fields.table(contents.header["claim"], "claim", ("failure",))
    claimed = fields.number(claim["failure"], "claim.failure")
    if not 0.0 <= claimed <= 1.0:
        raise fields.expected("claim.failure", "a probability", claimed)
    kind = contents.header["proof"].get("kind") if isinstance(contents.header["proof"], dict) else None
    if not isinstance(kind, str) or kind not in KINDS:
        raise fields.expected("proof.kind", " or ".join(map(repr, KINDS)), kind)
    modules = KINDS[kind] + _more_modules(contents.header["proof"])
    try:
        # What overflows becomes infinite or nan, and neither is ever better than a limit.
        with np.errstate(all="ignore"):
            failure, worst = _failure_of(contents, problem, kind)
    except Refused as refused:
        return Verdict(False, claimed, 1.0, modules, str(refused))
    except RecursionError:
        return Verdict(False, claimed, 1.0, modules, "a formula or an expression is nested too deeply to be proved")
    if not failure <= claimed:
        reason = f"a failure of at most {failure:.5g} follows, not {claimed:.5g}{worst}"
        return Verdict(False, claimed, failure, modules, reason)
    given = "" if problem.formula is not None else "; the task is the automaton in the file, which has no formula"
    return Verdict(True, claimed, failure, modules, given)


def _more_modules(proof: dict[str, Any]) -> tuple[str, ...]:
    """Return the modules that a proof of its kind uses besides."""
    agents = proof.get("agents")
    entries = [own for own in agents if isinstance(own, dict)] if isinstance(agents, list) else []
    more = {"network": "networks", "feedback": "feedbacks", "radius": "ellipsoids"}
    acts = tuple(name for key, name in more.items() if any(key in own for own in entries))
    return (("trains",) if "tolerance" in proof else ()) + acts


def _failure_of(contents: Contents, problem: Problem, kind: str) -> tuple[float, str]:
    """Return an upper bound on the probability that the task fails, and what fails most, in words."""
    along = kind == "trajectory"
    proof = trajectories.read_proof(contents, problem) if along else cell_proofs.read_proof(contents, problem)
    contents.everything_was_used()
    if problem.formula is not None and (wrong := wrong_automaton(problem.automaton, problem.formula)):
        raise Refused(f"the automaton is not that of the formula: {wrong}")
    if isinstance(proof, trajectories.TrajectoryProof):
        failure, constraints = trajectories.failure_of(problem, proof)
        return failure, f"; most probable: {constraints.likeliest()}"
    return cell_proofs.failure_of(problem, proof), ""


def bound_of(failure: float) -> float:
    """Return the lower bound that follows from an upper bound on the probability of failing, rounded down."""
    return 1.0 if failure <= 0.0 else max(0.0, math.nextafter(1.0 - failure, 0.0))


def shown(failure: float) -> str:
    """Return the lower bound that follows from a failure as text: rounded down, near 1 by what it lacks."""
    if 0.0 < failure < 1e-3:
        step = 10.0 ** (math.floor(math.log10(failure)) - 3)
        return f"1 - {math.ceil(failure / step) * step:.4g}"
    return f"{math.floor(bound_of(failure) * 1e6) / 1e6:.6f}"
