"""Where a policy has no choice the check reads no value, however good the places are that a choice would lead to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from certigym.synthesis.extended_check.steps import step_backup_of
from composing import certificate_of

KINDS = [
    "exact matrices",
    "linear matrices",
    "linear expressions",
    "boxes matrices",
    "boxes Laplace",
    "boxes noise scale",
]


@pytest.mark.parametrize("kind", KINDS)
def test_every_reading_gives_them_zero(kind: str) -> None:
    certificate = certificate_of(kind)
    (agent,), (part,) = certificate.problem.agents, certificate.proof.agents
    policy = part.policy.copy()
    idle = np.arange(part.grid.n_cells) % 2 == 0
    policy[:, :, idle] = -1
    part = replace(part, policy=policy)
    q = int(np.flatnonzero(~certificate.problem.automaton.absorbing)[0])
    (values,) = step_backup_of(agent, part, {}, False).values(part, np.ones((1, part.n_places)), [(0, q)], {})
    by_cell = values.reshape(part.grid.n_cells, -1)
    assert np.all(by_cell[idle] == 0.0)
    # Elsewhere next to all of a factor that is 1 everywhere comes back: cells in the middle lead into the grid.
    assert np.median(by_cell[~idle]) > 0.9
