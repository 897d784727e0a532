"""Grids, for the check: they cover the workspaces, noise is independent along their axes, and lattices are even."""

from __future__ import annotations

import numpy as np

from ....envs.systems.agents import Box
from ...certificates.proofs import OnGrid
from ...relations.grids import FloatArray
from ..steps import wrong_for_uneven_noise


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
    """Grids tile the workspaces, and along their axes the noise is independent and positive."""
    failures = []
    for agent, part in zip(certificate.problem.agents, certificate.proof.agents, strict=True):
        low = np.array([edges[0] for edges in part.grid.edges])
        high = np.array([edges[-1] for edges in part.grid.edges])
        if not _tiles(agent.workspace, low, high, certificate.problem.labeling.reads_exits):
            failures.append(f"the grid of agent `{agent.name}` does not tile its workspace")
        variances = np.diag(agent.noise_covariance)
        is_turned = agent.laws is not None and np.any(agent.noise_axes != np.eye(agent.n_states))
        is_correlated = np.any(agent.noise_covariance != np.diag(variances))
        if agent.angles and part.relation["kind"] != "boxes":
            failures.append(f"the relation of agent `{agent.name}` takes its angles for numbers")
        if not agent.has_plain_noise:
            failures += wrong_for_uneven_noise(agent, part)
            variances = np.where(agent.still_axes, 1.0, variances)
        if np.any(variances <= 0) or is_turned or is_correlated:
            failures.append(f"the noise of agent `{agent.name}` is not independent along its grid axes")
        if any(np.any(np.diff(axis) <= 0) for axis in part.lattice):
            failures.append(f"the lattice of agent `{agent.name}` is not increasing")
    return failures


def _tiles(workspace: Box, low: FloatArray, high: FloatArray, reads_exits: bool) -> bool:
    """Whether the grid ``[low, high]`` is the workspace, or holds it where cells beyond it are read as such."""
    if reads_exits:
        return bool(np.all(low <= workspace.low) and np.all(workspace.high <= high))
    return bool(np.array_equal(low, workspace.low) and np.array_equal(high, workspace.high))
