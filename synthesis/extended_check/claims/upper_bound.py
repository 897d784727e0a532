"""The upper end of a certificate's claim, verified: its policies attain no more than ``lower_bound + gap``.

A bound from above needs more than one from below. Nothing may be lost anywhere: every agent puts its mean exactly where
its policy says, every cell has one class, grids tile the workspaces, and the guards out of an automaton state cover
*all* joint cells that lead to each of its successors. ``check`` has verified that guards are disjoint and lead where
they say, or to acceptance; so it remains to count. The joint cells of a guard are a product, those that lead to a
successor are counted agent by agent through the decision diagram, and both numbers are whole.

What the policies attain is then evaluated in the other direction than the value: as the mass that is accepted going
forward in time (``forward_occupancy``). For tensor trains, which leave cells out, it is evaluated backward again, and
all that they leave out counts as accepted (``train_check``).
"""

from __future__ import annotations

import math

import numpy as np

from ...certificates.cell_probabilities import kernel_key, lost_to_rounding
from ...certificates.proofs import OnGrid, start_of_claim
from .forward_occupancy import TooManyProducts, masses
from .guard_check import cell_classes, joint_cells_by_target
from .train_check import regrown_trains, train_start_value

MOST = 100_000
"""Products of the mass beyond which the upper end is left unverified."""

SPARED = 0.25
"""Share of the reserve for rounding that dropped mass may take."""


def inexact(certificate: OnGrid) -> list[str]:
    """Return reasons why a certificate cannot have an upper end, although its lower bound holds."""
    problem, agents = certificate.problem, certificate.proof.agents
    claim = "it says how far above its bound the probability may be, but "
    classes = []
    for i, (agent, part) in enumerate(zip(problem.agents, agents, strict=True)):
        rows, possible, _ = cell_classes(problem, i, part, None)
        if part.relation["kind"] != "exact" or np.any(possible.sum(axis=1) != 1):
            return [f"{claim}agent `{agent.name}` does not follow its policy exactly, or a cell has no certain class"]
        classes.append(rows[possible.argmax(axis=1)])
    arriving = [part.masks.sum(axis=1).tolist() for part in agents]
    starting = [part.start_masks.sum(axis=1).tolist() for part in agents]
    sets = []
    for q in range(problem.automaton.n_states):
        own = certificate.proof.guard_source == q
        if not problem.automaton.absorbing[q]:
            sets.append((q, arriving, certificate.proof.guard_mask[own], certificate.proof.guard_target[own]))
    if start_of_claim(certificate) == "mean" and not problem.automaton.absorbing[problem.automaton.initial]:
        sets.append((problem.automaton.initial, starting, certificate.proof.start_mask, certificate.proof.start_target))
    for q, sizes, mask, target in sets:
        for p, number in joint_cells_by_target(problem, q, classes).items():
            covered = sum(math.prod(s[m] for s, m in zip(sizes, row, strict=True)) for row in mask[target == p])
            if not problem.automaton.dead[p] and covered != number:
                return [f"{claim}its guards leave out joint cells that lead from automaton state {q} to {p}"]
    return []


def attained(certificate: OnGrid) -> float | None:
    """Compute an upper bound on what the policies of an exact certificate attain; None if it would take too long.

    Raises
    ------
    ValueError
        If it should have tensor trains, but has none that can be grown again.
    """
    problem, agents = certificate.problem, certificate.proof.agents
    lost, known = 0.0, dict[object, float]()
    for agent, part in zip(problem.agents, agents, strict=True):
        # Agents with equal noise, cells and means lose alike.
        key = kernel_key(agent, part)
        if key not in known:
            known[key] = lost_to_rounding(agent, part)
        lost += known[key]
    lost *= problem.horizon
    if certificate.proof.rounding is not None:
        value = regrown_trains(certificate, upper=True)
        return min(1.0, train_start_value(certificate, value, upper=True) + lost)
    share = SPARED * certificate.proof.relative_rounding * certificate.lower_bound / (problem.horizon + 1)
    try:
        *_, last = masses(certificate, share, MOST)
    except TooManyProducts:
        return None
    accepted = last.accepted + float(last.totals[problem.automaton.accepting[last.states]].sum())
    n = problem.horizon * sum(part.grid.n_cells + 1 for part in agents) + len(agents) + MOST
    return min(1.0, (accepted + last.dropped + last.deadlocked) * (1.0 + 2.0 * n * 2.0**-53) + lost)
