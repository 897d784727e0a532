"""Means of linear agents, and what they are off by in floating point, as the maps of linear cells take them."""

from __future__ import annotations

from dataclasses import dataclass

from ....envs.systems.agents import LinearAgent
from ..grids import FloatArray
from .rounding import sizes_of

ROUNDED_TWICE = 2.0
"""Factor on the rounding of a mean: it is computed by the search, and by the agent itself."""


@dataclass(frozen=True, eq=False)
class LinearMeans:
    """Means ``A x + B u + offset``, off by ``rounding`` (d,) at most."""

    A: FloatArray
    B: FloatArray
    offset: FloatArray
    rounding: FloatArray

    @property
    def arrays(self) -> tuple[FloatArray, ...]:
        """All that maps depend on, for comparing relations."""
        return (self.A, self.B, self.offset)


def linear_means(agent: LinearAgent) -> LinearMeans:
    """Return the means of a linear agent, with upper bounds on their rounding."""
    sizes = sizes_of(agent)
    return LinearMeans(agent.A, agent.B, agent.offset, 2.0 * ROUNDED_TWICE * sizes.unit * sizes.means)
