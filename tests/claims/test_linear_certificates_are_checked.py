"""Certificates of linear agents claim what they store, survive files and rollouts, and are refused when forged."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.cell_probabilities import AgentRecord
from certigym.synthesis.certificates.proofs import changed, value_of
from certigym.synthesis.certificates.value_functions import Terms
from forged_cells import CLAIMS, MENU, Forge, one_choice, part_changed, raised_factor, relation_changed
from kinds import mostly_thorough
from problems import cart, cart_reach, scalar_agent, two_agents

FALSE_ALARM = 1e-6
"""Probability that rollouts refute a true certificate."""


@cache
def of_targets() -> cg.Certificate:
    """Two scalar agents that choose targets; terms are united, and remainders are kept."""
    return cg.synthesize(two_agents(horizon=4, noise_covariance=[[0.8]]), 40, relation="linear").certificate


@cache
def of_menu() -> cg.Certificate:
    """A cart with one input."""
    return cg.synthesize(cart_reach(cart()), [30, 15], relation="linear").certificate


CERTIFICATES = {"targets": of_targets, "menu": of_menu}


def product_at(certificate: cg.Certificate, state: np.ndarray) -> float:
    """The value at one joint state: a sum over terms of products of interpolated factors, corner by corner."""
    problem, terms = certificate.problem, value_of(certificate)
    assert isinstance(terms, Terms)
    letter = [problem.labeling.class_at(i, state[columns, None])[:, 0] for i, columns in enumerate(problem.columns)]
    q = int(problem.automaton.next_state(np.array(problem.automaton.initial), np.concatenate(letter)))
    total = 0.0
    for row in terms.index[q]:
        term = 1.0
        for i, (part, columns) in enumerate(zip(certificate.proof.agents, problem.columns, strict=True)):
            # One factor of 1 - share and share per axis, and the numbers of the cell's corners.
            read, table = 0.0, terms.factors[i][row[i]].reshape([2 * n for n in part.grid.shape])
            cell, share = [], []
            for edges, x in zip(part.grid.edges, state[columns], strict=True):
                k = min(int(np.searchsorted(edges, x, side="right")) - 1, len(edges) - 2)
                cell.append(k)
                share.append((x - edges[k]) / (edges[k + 1] - edges[k]))
            for side in product((0, 1), repeat=len(cell)):
                weight = np.prod([s if up else 1.0 - s for s, up in zip(share, side, strict=True)])
                read += weight * table[tuple(2 * k + up for k, up in zip(cell, side, strict=True))]
            term *= read
        total += term
    return total


@pytest.mark.parametrize("name", CERTIFICATES)
def test_claims_at_states_are_sums_over_corners(name: str) -> None:
    certificate, rng = CERTIFICATES[name](), np.random.default_rng(0)
    low = np.concatenate([agent.workspace.low for agent in certificate.problem.agents])
    high = np.concatenate([agent.workspace.high for agent in certificate.problem.agents])
    states = rng.uniform(low, high, size=(50, len(low)))
    claimed = certificate.at(states)
    expected = np.array([product_at(certificate, state) for state in states])
    np.testing.assert_allclose(claimed, np.clip(expected, 0.0, 1.0), rtol=1e-9, atol=1e-12)
    assert np.all(claimed <= expected) and claimed.max() > 0.5


@pytest.mark.parametrize("name", CERTIFICATES)
def test_means_and_minima_over_boxes(name: str) -> None:
    """In one joint cell the mean is the value at the centre of the box; over several it is their weighted mean."""
    certificate, rng = CERTIFICATES[name](), np.random.default_rng(1)
    edges = [axis for part in certificate.proof.agents for axis in part.grid.edges]
    for _ in range(10):
        first = [int(rng.integers(0, len(axis) - 2)) for axis in edges]
        low = np.array([axis[k] + 0.3 * (axis[k + 1] - axis[k]) for axis, k in zip(edges, first, strict=True)])
        high = np.array([axis[k + 1] + 0.6 * (axis[k + 2] - axis[k + 1]) for axis, k in zip(edges, first, strict=True)])
        middle = np.array([axis[k + 1] for axis, k in zip(edges, first, strict=True)])
        mean, volume = 0.0, np.prod(high - low)
        for side in product((0, 1), repeat=len(edges)):
            a, b = np.where(side, middle, low), np.where(side, high, middle)
            mean += float(np.prod(b - a) / volume * product_at(certificate, 0.5 * (a + b)))
        assert certificate.mean(low, high) == pytest.approx(mean, rel=1e-9, abs=1e-12)
        inside = certificate.at(rng.uniform(low, high, size=(200, len(low))))
        assert certificate.min(low, high) <= inside.min() + 1e-15
        assert certificate.mean(low, low) == pytest.approx(float(certificate.at(low)[0]), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("name", CERTIFICATES)
def test_files_and_rollouts_agree(name: str, tmp_path: Path) -> None:
    """40,000 episodes notice a claim that is too large by about .01 at a false-alarm rate of 1e-6."""
    certificate = CERTIFICATES[name]()
    cg.save(certificate, tmp_path / "certificate.npz")
    loaded = cg.load(tmp_path / "certificate.npz")
    assert isinstance(loaded, cg.Certificate)
    assert cg.check(loaded, certificate.problem) and loaded.lower_bound == certificate.lower_bound
    state = np.concatenate([agent.initial.low for agent in certificate.problem.agents])
    assert loaded.at(state) == certificate.at(state) > 0.8
    report = cg.validate(loaded, 40_000, seed=1, confidence=1 - FALSE_ALARM)
    assert report.verdict != "refuted" and report.details["inadmissible"] == 0
    assert not cg.audit(loaded, 4_000, seed=2, confidence=1 - FALSE_ALARM).refuted


def negative_corner(certificate: cg.Certificate) -> cg.Certificate:
    assert certificate.proof.terms is not None
    factors = certificate.proof.terms.factors[0].copy()
    factors[0, 0] = -0.1
    return changed(
        certificate, terms=Terms((factors, *certificate.proof.terms.factors[1:]), certificate.proof.terms.index)
    )


def shifted(part: AgentRecord, share: float) -> tuple[np.ndarray, ...]:
    return tuple(axis + share * (axis[1] - axis[0]) for axis in part.lattice)


def flipped(certificate: cg.Certificate) -> cg.Certificate:
    """Every remainder keeps the factor of the other vertex, and is subtracted from the wrong one."""
    steps = [
        replace(step, merges=tuple(replace(merges, rest=-merges.rests) for merges in step.merges))
        for step in certificate.proof.merge_log
    ]
    return changed(certificate, merge_log=tuple(steps))


BOTH: dict[str, Forge] = {
    "a stored factor of a finished state raised": lambda c: raised_factor(c, finished=True),
    "fewer parts": lambda c: relation_changed(c, parts=1),
}
TARGETS: dict[str, Forge] = {
    **CLAIMS,
    **BOTH,
    "a corner below 0": negative_corner,
    "targets out of reach": lambda c: one_choice(c, 0),
    "targets out of reach, gain 1": lambda c: one_choice(c, int(np.prod(c.proof.agents[0].lattice_shape))),
    "the lattice shifted by half a step": lambda c: part_changed(c, lattice=shifted(c.proof.agents[0], 0.5)),
    "remainders of the wrong vertices": flipped,
}
MENUS: dict[str, Forge] = {**MENU, **BOTH, "a stored factor raised": raised_factor}


def refused(forge: Forge, certificate: cg.Certificate, file: Path) -> bool:
    """Whether a forgery is refused, in words, by the record, the reader or the check."""
    try:
        cg.save(forge(certificate), file)
        return not cg.check(cg.load(file))
    except ValueError:
        return True


@pytest.mark.parametrize("name", TARGETS)
def test_forged_targets_are_refused(name: str, tmp_path: Path) -> None:
    assert cg.check(of_targets())
    assert refused(TARGETS[name], of_targets(), tmp_path / "forged.npz")


@pytest.mark.parametrize("name", MENUS)
def test_forged_menus_are_refused(name: str, tmp_path: Path) -> None:
    assert cg.check(of_menu())
    assert refused(MENUS[name], of_menu(), tmp_path / "forged.npz")


@mostly_thorough("sliver", [0.0, 3e-12, 1e-10, 1e-7], first=3)
def test_cells_that_are_nearly_even_are_accepted(sliver: float) -> None:
    """A region boundary next to a lattice of even cells: search and check agree on whether images lie on it."""
    agents = [scalar_agent("one"), scalar_agent("two")]
    problem = cg.Problem(
        name="nearly even",
        horizon=3,
        agents=agents,
        propositions={"goal": cg.Proposition("one", [1.0 + sliver], [3.0])},
        specification=cg.Specification("F goal", "co-safe"),
    )
    # The second agent is in no proposition, so it has no masks.
    certificate = cg.synthesize(problem, 32, relation="linear").certificate
    assert certificate.lower_bound > 0.5
    report = cg.check(certificate)
    assert report, str(report)


def test_stored_factors_leave_room_for_the_rounding_of_means() -> None:
    """A drift of billions that the input holds against: two sums of the same mean differ by 1e-6."""
    drift = 2.4e10
    agent = cart(
        A=[[0.9, -0.07], [0.0, 0.5]],
        B=[[0.0], [0.26440596508103253]],
        offset=[0.0, -0.26440596508103253 * drift],
        noise_covariance=[[0.0005, 0.0], [0.0, 0.01]],
        state_low=[-1.0, -1.0],
        state_high=[1.0, 1.0],
        input_low=[drift - 0.7],
        input_high=[drift + 0.6],
        initial_state=[0.2, -0.1],
    )
    problem = cg.Problem(
        name="held",
        horizon=4,
        agents=[agent],
        propositions={"p": cg.Proposition("cart", [-0.885, -0.175], [0.0332, 0.511])},
        specification=cg.Specification("G[0,1] p", "co-safe"),
    )
    for start in ([0.2, -0.1], [-0.3, 0.1]):
        held = problem.replace(initial_state=start)
        certificate = cg.synthesize(
            held, [13, 14], relation="linear", search=cg.SearchOptions(max_sweeps=2)
        ).certificate
        report = cg.check(certificate)
        assert report, str(report)
    assert certificate.lower_bound > 0.1


@mostly_thorough("cells", [33, 118, 261], first=2)
def test_cells_that_are_equal_up_to_the_rounding_of_edges_are_read_alike_by_the_check(cells: int) -> None:
    """Edges have eleven decimals here: whether cells count as equal must not depend on which code asks."""
    problem = cg.make_problem("reach-avoid-n-v0", n_agents=1, horizon=2)
    certificate = cg.synthesize(problem, cells, relation="linear", search=cg.SearchOptions(max_sweeps=1)).certificate
    assert cg.check(certificate), str(cg.check(certificate))
