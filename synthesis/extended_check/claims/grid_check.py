"""Grids, for the check: they cover the workspaces, noise is independent along their axes, and lattices are even."""

from __future__ import annotations

import numpy as np

from ....envs.systems.agents import AnyAgent, Box
from ...certificates.cell_probabilities import AgentRecord, grid_noise, state
from ...certificates.proofs import OnGrid
from ...relations.grids import FloatArray
from ..steps import UNIT, wrong_for_uneven_noise

CORRELATION = 1e-11
"""Largest correlation between the noises of two grid axes that counts as rounding."""

INVERSE = 1e-9
"""By how much, in deviations of the noise, states may change on the way to grid coordinates and back."""


def uneven_lattices(certificate: OnGrid) -> list[str]:
    """Lattices on which values are interpolated are evenly spaced, so that positions in steps are right."""
    failures = []
    for agent, part in zip(certificate.problem.agents, certificate.proof.agents, strict=True):
        if not part.is_additive:
            for axis in part.lattice:
                even = axis[0] + (axis[-1] - axis[0]) * np.linspace(0.0, 1.0, len(axis))
                step = (axis[-1] - axis[0]) / max(1, len(axis) - 1)
                if len(axis) < 2 or not step > 0 or np.any(np.abs(axis - even) > 1e-9 * step):
                    failures.append(f"the lattice of agent `{agent.name}` is not evenly spaced")
    return failures


def wrong_grids(certificate: OnGrid) -> list[str]:
    """Grids cover the workspaces and, in their coordinates, the noise is independent and positive."""
    failures = []
    for agent, part in zip(certificate.problem.agents, certificate.proof.agents, strict=True):
        low = np.array([edges[0] for edges in part.grid.edges])
        high = np.array([edges[-1] for edges in part.grid.edges])
        if not _is_inverted(part.coordinates, agent.noise_covariance):
            failures.append(f"the grid coordinates of agent `{agent.name}` cannot be inverted")
            continue
        identity = np.array_equal(part.coordinates, np.eye(agent.n_states))
        if identity and not _tiles(agent.workspace, low, high, certificate.problem.labeling.reads_exits):
            failures.append(f"the grid of agent `{agent.name}` does not tile its workspace")
        if not identity and part.is_linear and not np.array_equal(agent.initial.low, agent.initial.high):
            failures.append(f"linear cells of agent `{agent.name}` are no boxes in state space, as its start box needs")
        if not identity and not _covers(agent.workspace, part.coordinates, low, high):
            failures.append(f"the grid of agent `{agent.name}` does not cover its workspace")
        if not identity and _start_on_a_face(agent, part):
            failures.append(
                f"the start of agent `{agent.name}` lies on a face of cells to rounding: its cell is not certain"
            )
        if agent.laws is not None and not np.array_equal(part.coordinates, agent.noise_axes):
            failures.append(f"the grid axes of agent `{agent.name}` are not those of its noise")
            continue
        noise = grid_noise(agent.noise_covariance, part.coordinates)
        variances = np.diag(noise)
        off = np.abs(noise - np.diag(variances))
        if agent.angles and part.relation["kind"] != "boxes":
            failures.append(f"the relation of agent `{agent.name}` takes its angles for numbers")
        if not agent.has_plain_noise:
            failures += wrong_for_uneven_noise(agent, part)
            variances = np.where(agent.still_axes, 1.0, variances)
        if np.any(variances <= 0) or np.any(off > CORRELATION * np.sqrt(np.outer(variances, variances))):
            failures.append(f"the noise of agent `{agent.name}` is not independent along its grid axes")
        if any(np.any(np.diff(axis) <= 0) for axis in part.lattice):
            failures.append(f"the lattice of agent `{agent.name}` is not increasing")
    return failures


def _tiles(workspace: Box, low: FloatArray, high: FloatArray, reads_exits: bool) -> bool:
    """Whether the grid ``[low, high]`` is the workspace, or holds it where cells beyond it are read as such."""
    if reads_exits:
        return bool(np.all(low <= workspace.low) and np.all(workspace.high <= high))
    return bool(np.array_equal(low, workspace.low) and np.array_equal(high, workspace.high))


def _start_on_a_face(agent: AnyAgent, part: AgentRecord) -> bool:
    """Whether rounding may decide in which cell a start is, in coordinates other than the states.

    Along axes that a start box spans hardly any start is so near to an edge, and what is comes off its shares.

    The controller multiplies by an inverse, the check solves equations: both are within ``off`` of the truth.
    """
    start, coordinates, d = agent.initial.low, part.coordinates, agent.n_states
    inverse, unit = np.linalg.inv(coordinates), (8.0 * d + 16.0) * UNIT
    lost = np.abs(coordinates @ inverse - np.eye(d)) + unit * np.abs(coordinates) @ np.abs(inverse)
    off = (2.0 * np.abs(inverse) @ lost + unit * np.abs(inverse)) @ np.abs(start)
    points = np.linalg.solve(coordinates, start)
    # A coordinate that is a state is read as it is, by both.
    own = np.all(coordinates == np.eye(d), axis=1) & np.all(inverse == np.eye(d), axis=1) & (points == start)
    drawn = np.any(inverse[:, start < agent.initial.high] != 0.0, axis=1)
    off = np.where(own | drawn, 0.0, off)
    state("start", part, start, points, own | drawn)
    triples = zip(part.grid.edges, points, off, strict=True)
    # A start of zeros is read without rounding.
    return any(width > 0.0 and bool(np.any(np.abs(edges - x) <= width)) for edges, x, width in triples)


def _is_inverted(coordinates: FloatArray, covariance: FloatArray) -> bool:
    """Return whether the computed inverse of the grid coordinates is an inverse; everything else relies on it.

    States are counted in deviations of their noise, so that their units do not matter.
    """
    try:
        inverse = np.linalg.inv(coordinates)
    except np.linalg.LinAlgError:
        return False
    variances = np.diag(covariance)
    units = np.sqrt(np.where(variances > 0, variances, 1.0))
    off = np.abs(coordinates @ inverse - np.eye(len(coordinates)))
    return bool(np.all(off * units <= INVERSE * units[:, None]))


def _covers(workspace: Box, coordinates: FloatArray, low: FloatArray, high: FloatArray) -> bool:
    """Whether the grid ``[low, high]`` holds the workspace in its coordinates (up to rounding)."""
    inverse = np.linalg.inv(coordinates)
    middle = inverse @ (0.5 * (workspace.low + workspace.high))
    reach = np.abs(inverse) @ (0.5 * (workspace.high - workspace.low))
    slack = 1e-12 * (np.abs(middle) + reach)
    return bool(np.all(low <= middle - reach + slack) and np.all(high >= middle + reach - slack))
