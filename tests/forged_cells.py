"""Certificates on cells with one entry changed, as forgers change them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.certificates.value_functions import Terms

Forge = Callable[[cg.Certificate], cg.Certificate]


def part_changed(certificate: cg.Certificate, **changes: Any) -> cg.Certificate:
    """The certificate with another first agent."""
    return changed(certificate, agents=(replace(certificate.proof.agents[0], **changes), *certificate.proof.agents[1:]))


def relation_changed(certificate: cg.Certificate, **changes: Any) -> cg.Certificate:
    return part_changed(certificate, relation=certificate.proof.agents[0].relation | changes)


def raised_factor(certificate: cg.Certificate, finished: bool = False) -> cg.Certificate:
    """The largest number of a stored factor, a thousandth larger: one of a state that accepts, or of the first one."""
    automaton, terms = certificate.problem.automaton, certificate.proof.tree
    q = int(np.flatnonzero(automaton.finished)[0]) if finished else automaton.initial
    factors, row = terms.factors[0].copy(), int(terms.index[q][0, 0])
    factors[row, np.argmax(factors[row])] += 1e-3
    return changed(certificate, terms=Terms((factors, *terms.factors[1:]), terms.index))


def one_choice(certificate: cg.Certificate, choice: int) -> cg.Certificate:
    """All cells choose one input or target, from whatever distance."""
    return part_changed(certificate, policy=np.full_like(certificate.proof.agents[0].policy, choice))


def inputs_of(certificate: cg.Certificate) -> np.ndarray:
    return np.array(certificate.proof.agents[0].relation["menu"])


CLAIMS: dict[str, Forge] = {
    "a stored factor raised": raised_factor,
    "a gap": lambda c: changed(c, gap=0.01),
    "called exact": lambda c: changed(c, gap=0.0),
    "the bound raised": lambda c: changed(
        c, lower_bound=c.lower_bound + 1e-6, bounds={"nominal": c.lower_bound + 1e-6}
    ),
    "another bound": lambda c: changed(c, bound="robust tree", bounds={"robust tree": c.lower_bound}),
    "called an exact relation": lambda c: part_changed(c, relation={"kind": "exact"}),
}
"""What is wrong on cells of every kind."""

MENU: dict[str, Forge] = {
    "inputs outside their box": lambda c: relation_changed(c, menu=(1.5 * inputs_of(c)).tolist()),
    "inputs exchanged": lambda c: relation_changed(c, menu=inputs_of(c)[::-1].tolist()),
    "no inputs": lambda c: relation_changed(c, menu=[]),
    "an input that is not there": lambda c: one_choice(c, len(inputs_of(c))),
}
"""What is wrong where cells choose from a menu of inputs."""
