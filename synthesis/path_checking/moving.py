"""How an agent moves, as the check of nonlinear paths reads it: expressions, and a covariance above its noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...envs.agents import AnyAgent
from ...envs.expressions import Number, Operation, Tree
from ..cells import FloatArray
from .law_moments import NORMAL, moments_of
from .roundings import UNIT


class NothingKnownError(Exception):
    """Nothing is known of an agent beyond a step."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of an agent: a covariance (d, d) that is above it, means (d,) of its sums, and how it is multiplied.

    ``deviations`` (d,) are those of its components, before they are multiplied; ``off`` (d,) is what means are off by.
    ``tail`` is what is known of its tails, and ``lost`` the probability of the noise of a step that is given up.
    """

    covariance: FloatArray
    deviations: FloatArray
    means: FloatArray
    off: FloatArray
    tail: int
    lost: float

    @classmethod
    def of(cls, agent: AnyAgent) -> Noise:
        """Read the noise of an agent, of whose laws exponential moments are known."""
        d = agent.n_states
        if agent.laws is None:
            return cls(agent.noise_covariance, np.zeros(d), np.zeros(d), np.zeros(d), NORMAL, 0.0)
        laws = [moments_of(law) for law in agent.laws]
        known = [law for law in laws if law is not None]
        if len(known) < len(laws):
            raise NothingKnownError(f"agent `{agent.name}`: no moments of its noise are known")
        axes, deviations = agent.noise_axes, np.array([law.deviation for law in known])
        means, off = np.array([law.mean for law in known]), np.array([law.off for law in known])
        moved, size = axes @ means, np.abs(axes) @ np.abs(means)
        # Each entry is a sum of d products of three factors.
        covariance = (axes * deviations**2) @ axes.T
        length = np.sqrt(np.diag(np.abs(axes) * deviations**2 @ np.abs(axes).T))
        covariance = covariance + np.diag(d * (d + 4.0) * UNIT * length * length.max(initial=0.0))
        tail, lost = max(law.tail for law in known), sum(law.lost for law in known)
        return cls(covariance, deviations, moved, np.abs(axes) @ off + (d + 2.0) * UNIT * size, tail, lost)

    def moved(self, trees: tuple[Tree, ...], scales: tuple[Tree, ...]) -> tuple[Tree, ...]:
        """Return dynamics with the means of the noise in them."""
        if not np.any(self.means):
            return trees
        result = []
        for k, (tree, mean) in enumerate(zip(trees, self.means.tolist(), strict=True)):
            added = Operation("*", (Number(mean), scales[k])) if scales else Number(mean)
            result.append(Operation("+", (tree, added)) if mean else tree)
        return tuple(result)


@dataclass(frozen=True, eq=False)
class Moving:
    """How an agent moves, as expressions.

    ``names`` are those of states, inputs and of what is unknown, in ``ranges`` (2, k). Means of noise are in ``trees``;
    ``deviations`` (d,) of its components are those of laws above them.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    unknown: tuple[str, ...]
    ranges: FloatArray
    trees: tuple[Tree, ...]
    outputs: tuple[Tree, ...]
    scales: tuple[Tree, ...]
    noise: Noise

    @classmethod
    def of(cls, agent: AnyAgent) -> Moving:
        """Read an agent; matrices become sums of products."""
        noise = Noise.of(agent)
        ranges = np.array(list(agent.unknowns.values()), dtype=float).reshape(-1, 2).T
        scales = agent.timed_scale_trees
        trees = noise.moved(agent.timed_trees, scales)
        names = agent.states, agent.inputs, tuple(agent.unknowns)
        return cls(*names, ranges, trees, agent.output_trees, scales, noise)
