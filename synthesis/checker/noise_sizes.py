"""Noise whose size depends on states, inputs, disturbances or the time: what it adds to a step.

Let n = N w be the noise of an agent before it is scaled, and s the size of component k on the tube.

**Theorem.** Component k adds a form with at most the factor ``sup |s|`` to the error, and s times the mean of n. If s
depends on more than the time, the form is a martingale whose size depends on the past (``constraints``, STOPPED); else
its factor is known, up to what s is rounded by. QED
"""

from __future__ import annotations

import numpy as np

from .distributions import NORMAL, STOPPED
from .expressions import names_in
from .fields import Refused
from .intervals import add, down, interval, mul, up
from .jets import value_on
from .problem import Agent, Problem
from .rigorous import Array, U, Whole


def kinds_of(problem: Problem) -> Whole:
    """Return what is known of the tails of each source (W,)."""
    kinds = list[int]()
    for agent in problem.agents:
        for column, envelope in zip(agent.noise.T, agent.envelopes, strict=True):
            stopped = envelope.tail == NORMAL and _varies(agent) and np.any(column != 0.0)
            kinds.append(STOPPED if stopped else envelope.tail)
    return np.array([*kinds, *[NORMAL] * problem.agents[0].shared_noise.shape[1]], dtype=np.int64)


def _varies(agent: Agent) -> bool:
    """Return whether sizes are other than numbers at each time."""
    return bool(names_in(agent.scale) & {*agent.states, *agent.inputs, *agent.disturbances})


def sized(agent: Agent, factor: Array, leaves: dict[str, Array], t: int) -> tuple[Array, Array, Array]:
    """Return factors (d, W) of the noise of a step, what they may be off by, and ends (2, d) of what else it adds.

    ``factor`` (d, W) is that before it is scaled, ``leaves`` are ends (2, 1) of names on the tube. ``Refused`` if a
    size is not known, or if a source may cancel where sizes are not.
    """
    ends = np.concatenate([value_on(tree, leaves) for tree in agent.scale], axis=1)
    if not np.all(np.isfinite(ends)):
        raise Refused(f"the size of the noise of `{agent.name}` is not known on the tube at time {t}")
    own = slice(0, factor.shape[1] - agent.shared_noise.shape[1])  # shared sources are not scaled
    if _varies(agent) and np.any((factor[:, own] != 0.0).sum(axis=0) > 1):
        raise Refused(f"a source of the noise of `{agent.name}` that has a scale moves several states")
    scaled, off, size = factor.copy(), np.zeros(factor.shape), up(np.abs(ends).max(axis=0))[:, None]
    scaled[:, own] *= np.where(ends.sum(axis=0)[:, None] < 0.0, -size, size)
    if not _varies(agent):
        off[:, own] = np.abs(factor[:, own]) * (up(ends[1] - ends[0])[:, None] + 8.0 * U * size)
    return scaled, off, mul(ends, mean_of(agent))


def mean_of(agent: Agent) -> Array:
    """Return ends (2, d) of the mean of the noise of an agent, before it is scaled."""
    mean = np.zeros((2, len(agent.states)))
    for column, own in zip(agent.noise.T, agent.envelopes, strict=True):
        if own.mean or own.off:
            ends = np.stack([down(own.mean - np.full(len(column), own.off)), up(own.mean + own.off + 0.0 * column)])
            mean = add(mean, mul(interval(column), ends))
    return mean
