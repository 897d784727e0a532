"""Noise whose size depends on states, inputs, disturbances or the time: what it adds to a step.

Let n = N w be the normal noise of an agent before it is scaled, and s the size of component k on the tube.

**Theorem.** At each step component k adds to the error one of

- ``s0 n_k``, a form with a known factor, and something within ``sup |s - s0| * width``, for any s0, while n_k keeps in
  the strip ``|n_k| <= width``, which is one more constraint on a normal number;
- a form with at most the factor ``sup |s|``, of a size that depends on the past (``constraints``, STOPPED).

*Proof.* ``s n_k = s0 n_k + (s - s0) n_k``. The strip of step t is a constraint like those of the tube at t + 1: at the
first failure one of the forms fails, as in ``trajectories``. The second way is a martingale. QED

Sources all of whose components keep in strips at all times are normal.
"""

from __future__ import annotations

import numpy as np

from .constraints import Constraints, Forms
from .distributions import NORMAL, STOPPED
from .expressions import names_in
from .fields import Refused
from .intervals import add, down, interval, mul, up
from .jets import value_on
from .problem import Agent, Problem
from .rigorous import Array, Ends, U, Whole

Leaves = tuple[dict[str, Array], dict[str, Array]]  # ends (2, 1) of names on the nominal trajectory, and on the tube


def kinds_of(problem: Problem, widths: list[Array]) -> Whole:
    """Return what is known of the tails of each source (W,), for widths (S, d) of strips of each agent."""
    kinds = list[int]()
    for agent, width in zip(problem.agents, widths, strict=True):
        # a scale that names the time only is a number at each step
        depends = names_in(agent.scale) & {*agent.states, *agent.inputs, *agent.disturbances}
        wide = np.isinf(width).any(axis=0) & bool(depends)
        for column, envelope in zip(agent.noise.T, agent.envelopes, strict=True):
            stopped = envelope.tail == NORMAL and np.any(wide & (column != 0.0))
            kinds.append(STOPPED if stopped else envelope.tail)
    return np.array([*kinds, *[NORMAL] * problem.agents[0].shared_noise.shape[1]], dtype=np.int64)


def sized(agent: Agent, factor: Array, width: Array, leaves: Leaves, constraints: Constraints, t: int) -> Ends:
    """Return factors (d, W) of the noise of a step, and ends (2, d) of what else it adds; ask for its strips.

    ``factor`` (d, W) is that of the noise before it is scaled, in deviations of its sources, ``width`` (d,) of strips,
    infinite for none. ``Refused`` if a size is not known, or if a source may cancel where sizes are not.
    """
    nominal, ends = (np.concatenate([value_on(tree, own) for tree in agent.scale], axis=1) for own in leaves)
    if not np.all(np.isfinite(ends)):
        raise Refused(f"the size of the noise of `{agent.name}` is not known on the tube at time {t}")
    own = factor[:, : factor.shape[1] - agent.shared_noise.shape[1]]
    moves = np.any(own != 0.0, axis=1)
    # other than normal noise has no strips: its sources are no normal numbers
    strip = np.isfinite(width) & moves & all(envelope.tail == NORMAL for envelope in agent.envelopes)
    if np.any((own[~strip] != 0.0).sum(axis=0) > 1) or np.any(own[strip].any(axis=0) & own[~strip].any(axis=0)):
        # what one source adds to two states may cancel in a row only if both sizes are known
        raise Refused(f"a source of the noise of `{agent.name}` that has a scale moves several states")
    middle = np.where(strip, 0.5 * (nominal[0] + nominal[1]), np.abs(ends).max(axis=0) * (1.0 + 4.0 * U))
    away = np.where(strip, np.maximum(up(ends[1] - middle), up(middle - ends[0])), 0.0)
    more = up(away * np.where(strip, width, 0.0)) + np.where(strip, 1e-290, 0.0)
    variance = np.sum(own * own, axis=1) * (1.0 + 4.0 * U * (own.shape[1] + 4.0))
    scaled, sources = factor.copy(), np.zeros(factor.shape, dtype=bool)
    scaled[:, : own.shape[1]] *= middle[:, None]  # shared sources are not scaled
    sources[:, : own.shape[1]] = own != 0.0
    # Strips are constraints on the noise of this step, and rest on nothing else.
    if labels := [f"noise of `{agent.states[k]}` of `{agent.name}` at time {t}" for k in np.flatnonzero(strip)]:
        constraints.add(np.inf, np.inf, width[strip], Forms(variance, variance, sources).at(strip), labels)
    return scaled, add(np.stack([-more, more]), mul(ends, mean_of(agent)))


def mean_of(agent: Agent) -> Array:
    """Return ends (2, d) of the mean of the noise of an agent, before it is scaled."""
    mean = np.zeros((2, len(agent.states)))
    for column, own in zip(agent.noise.T, agent.envelopes, strict=True):
        if own.mean or own.off:
            ends = np.stack([down(own.mean - np.full(len(column), own.off)), up(own.mean + own.off + 0.0 * column)])
            mean = add(mean, mul(interval(column), ends))
    return mean
