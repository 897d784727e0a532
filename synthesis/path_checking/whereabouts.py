"""Where an agent along a path is, for what others ask of it: its linear deviation, and how far it is off from that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...envs.agents import AnyAgent
from ..cells import FloatArray
from ..certificates import AgentPath
from .gaussian_inequalities import Inequalities
from .moving import NothingKnownError
from .nonlinear_check import moments
from .roundings import TAIL, UNIT


@dataclass(frozen=True, eq=False)
class Whereabouts:
    """Some outputs at one time: nominal values, how far off, and the covariance of the linear deviation.

    Parameters
    ----------
    centre : (2, p) array
        Nominal values and what they are shifted by, from below and above.
    wider : (p,) array
        Upper bounds on what outputs are off nominal values and linear deviations, while the path is kept.
    covariance, off : (p, p) arrays
        Covariance of the linear deviations as computed, and bounds on what it is off.
    """

    centre: FloatArray
    wider: FloatArray
    covariance: FloatArray
    off: FloatArray


def whereabouts_along(agent: AnyAgent, path: AgentPath, outputs: Sequence[int]) -> list[Whereabouts]:
    """Return where some outputs are at times 0 to S.

    Raises
    ------
    ArithmeticError
        If nothing is known of them, or the linear deviation is not normal with a variance that is known.
    """
    if path.states is None:
        raise ArithmeticError(f"agent `{agent.name}` has no nominal states")
    if agent.laws is not None or not agent.has_plain_noise:
        raise ArithmeticError(f"the noise of agent `{agent.name}` is not normal and the same everywhere")
    result, places = [], list(outputs)
    try:
        for now in moments(agent, path, Inequalities()):
            found, size = now.outputs, np.abs(now.outputs.matrix[places])
            rows, values = found.matrix[places], found.values[:, places]
            # Rows round: what they are off by acts on deviations within the box.
            rounded = (len(now.at) + 4.0) * UNIT * (np.abs(values).max(axis=0) + size @ now.reach)
            shift, drift = now.chain.drift(rows)
            rounded = rounded + 4.0 * UNIT * (np.abs(values).max(axis=0) + np.abs(shift))
            wider = (drift + found.off[places] + rounded) * TAIL
            result.append(Whereabouts(values + shift, wider, *now.chain.covariance(rows)))
    except NothingKnownError as error:
        raise ArithmeticError(str(error)) from None
    return result
