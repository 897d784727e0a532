"""``Certificate.at`` and ``mean`` say what a plain evaluation of the policies says, that shares no code with them.

The oracle knows the policies, cell edges, lattices and menus of a certificate. Masses come from the error function of
the standard library, letters and the task from ``independent``; joint cells and times are looped over. Under the
a-posteriori bound a run loses delta at every step until it accepts: with V the value and N the expected number of steps
that find it not accepted, the claim is ``V - Delta N``. The package reads N off the depths of its terms.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce
from itertools import product
from typing import Any

import numpy as np
import pytest

import certigym as cg
from adversary import problem_of
from certigym.synthesis.certificates.proofs import changed, delta_of
from certigym.synthesis.extended_check.claims import regrow
from independent import FALSE, GoodPrefixes, membership
from kinds import mostly_thorough

FORMULA = ("and", ("U", ("not", "wall"), ("is", "goal")), ("F", 0, None, ("is", "door")))
HORIZON = 4


def spec() -> dict[str, Any]:
    """Two scalar agents with different noise, on [-1, 1]."""
    agents = [
        {
            "name": name, "A": [[a]], "B": [[1.0]], "noise_covariance": [[variance]], "state_low": [-1.0],
            "state_high": [1.0], "input_low": [-0.6], "input_high": [0.6], "initial_state": [start],
        }
        for name, a, variance, start in [("one", 0.9, 0.03, -0.3), ("two", 1.0, 0.05, 0.1)]
    ]  # fmt: skip
    regions = {
        "goal": {"agent": "one", "low": [0.5], "high": [1.0]},
        "wall": {"agent": "one", "low": [-1.0], "high": [-0.75]},
        "door": {"agent": "two", "low": [-0.75], "high": [-0.25]},
    }
    text = "(!wall U goal) & F door"
    return {
        "agents": agents, "propositions": regions, "formula": FORMULA, "text": text, "semantics": "co-safe",
        "horizon": HORIZON,
    }  # fmt: skip


def alone() -> dict[str, Any]:
    """The first agent alone: all its terms are united, whatever their depths."""
    both = spec()
    goal = {"goal": both["propositions"]["goal"]}
    changes = {"agents": both["agents"][:1], "propositions": goal, "formula": ("F", 0, None, ("is", "goal"))}
    return both | changes | {"text": "F goal"}


class Oracle:
    """Success, and expected steps without acceptance, from every joint cell after its letter was read."""

    def __init__(self, problem: dict[str, Any], certificate: Any) -> None:
        self.spec, self.certificate = problem, certificate
        self.good = GoodPrefixes(problem["formula"])
        self.edges = [part.grid.edges[0].tolist() for part in certificate.proof.agents]
        self.agents = range(len(certificate.proof.agents))
        self.letters = [self._letters(i) for i in self.agents]
        self.tables = [self._table(i) for i in self.agents]
        self.known: dict[Any, tuple[np.ndarray, np.ndarray]] = {}

    def _letters(self, i: int) -> list[frozenset[str]]:
        agent, middle = self.spec["agents"][i], 0.5 * np.add(self.edges[i][1:], self.edges[i][:-1])
        rows = {name: membership(agent, r, middle[None]) for name, r in self.spec["propositions"].items()
                if r["agent"] == agent["name"]}  # fmt: skip
        return [frozenset(name for name in rows if rows[name][s]) for s in range(len(middle))]

    def _table(self, i: int) -> np.ndarray:
        deviation = math.sqrt(self.spec["agents"][i]["noise_covariance"][0][0])

        def below(x: float) -> float:
            return 0.5 * math.erfc(-x / (deviation * math.sqrt(2.0)))

        means = self.certificate.proof.agents[i].lattice[0].tolist()
        return np.array(
            [[below(b - z) - below(a - z) for a, b in zip(self.edges[i], self.edges[i][1:])] for z in means]
        )

    def _rows(self, i: int, t: int, q: int) -> np.ndarray:
        """Masses (S, S) of the next cell under the policy."""
        part = self.certificate.proof.agents[i]
        rows = np.zeros((len(self.letters[i]), len(self.letters[i])))
        for s, choice in enumerate(part.policy[t, q].tolist()):
            if choice >= 0:
                rows[s] = self.tables[i][choice if part.input_set is None else part.input_set[s, choice]]
        return rows

    def read(self, left: Any, q: int, s: tuple[int, ...]) -> tuple[Any, int]:
        """What is left of the task after the letter of a joint cell, and the package's number of it."""
        letter = frozenset().union(*(letters[k] for letters, k in zip(self.letters, s, strict=True)))
        automaton = self.certificate.problem.automaton
        bits = np.array([[name in letter] for name in automaton.propositions])
        return self.good.after(left, letter), int(automaton.next_state(np.array([q]), bits)[0])

    def value(self, left: Any, q: int, t: int) -> tuple[np.ndarray, np.ndarray]:
        """Success and steps without acceptance (S_1, S_2), where a task is left after the letter of time t."""
        key = (left, q, t)
        if key not in self.known:
            shape = tuple(len(letters) for letters in self.letters)
            accepted, nothing = self.good.is_good(left), np.zeros(shape)
            if accepted or t == HORIZON or left == FALSE:
                self.known[key] = np.full(shape, float(accepted)), nothing + (0.0 if accepted else HORIZON - t)
            else:
                success, steps = np.zeros(shape), np.full(shape, float(HORIZON - t))
                masses = [self._rows(i, t, q) for i in self.agents]
                for arrival in product(*map(range, shape)):
                    following = self.value(*self.read(left, q, arrival), t + 1)
                    weight = reduce(np.multiply.outer, [rows[:, k] for rows, k in zip(masses, arrival, strict=True)])
                    success += weight * following[0][arrival]
                    # whoever leaves the workspace, or has no choice, is not accepted up to the end
                    steps -= weight * (HORIZON - t - 1 - following[1][arrival])
                self.known[key] = success, steps
        return self.known[key]

    def claim(self, s: tuple[int, ...], delta: float) -> float:
        success, steps = self.value(*self.read(self.good.start, self.certificate.problem.automaton.initial, s), 0)
        return float(success[s] - delta * steps[s])


PAPER = {"relation": "paper", "search": cg.SearchOptions(epsilon=0.125, feedback=-0.85)}
TRAIN = {"relation": "exact", "search": cg.SearchOptions(value="train")}
CASES: list[tuple[Callable[[], dict[str, Any]], dict[str, Any]]] = [
    (spec, {"relation": "exact"}), (spec, PAPER), (spec, TRAIN), (alone, PAPER)
]  # fmt: skip


@mostly_thorough("case", CASES, first=2)
def test_claims_agree_everywhere(case: tuple[Callable[[], dict[str, Any]], dict[str, Any]]) -> None:
    problem, options = case[0](), case[1]
    certificate: Any = cg.synthesize(problem_of(problem), 8, **options).certificate
    oracle = Oracle(problem, certificate)
    united = case[0] is alone
    if united:  # read its tree by depths, although the robust tree proves more
        certificate = changed(certificate, bound="a-posteriori")
        certificate = changed(certificate, terms=regrow(certificate))
    if options is PAPER:
        assert certificate.proof.bound == "a-posteriori" and delta_of(certificate) > 0.01
    edges = oracle.edges
    low, high = [axis[0] for axis in edges], [axis[-1] for axis in edges]
    cells = list(product(range(8), repeat=len(edges)))
    states = np.array([[0.5 * (axis[k] + axis[k + 1]) for axis, k in zip(edges, s, strict=True)] for s in cells])
    wanted = np.maximum([oracle.claim(s, delta_of(certificate)) for s in cells], 0.0)
    claimed, mean = certificate.at(states), certificate.mean(low, high)
    assert np.all(claimed <= wanted + 1e-12) and mean <= float(np.mean(wanted)) + 1e-12
    if united:  # terms of different depths became one, which pays for the largest
        assert np.max(claimed) > 0.5
        return
    # Trains of two agents are grown from starts everywhere, and say what they may be off by.
    within = 2e-6 if certificate.proof.terms is not None else 2 * certificate.proof.rounding.tolerance
    assert within < 1e-4
    np.testing.assert_allclose(claimed, wanted, atol=within)
    if delta_of(certificate) == 0.0:  # the mean is cut off at 0 once, not cell by cell
        assert mean == pytest.approx(float(np.mean(wanted)), abs=within)
    assert cg.check(certificate)
