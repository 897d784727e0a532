"""Noise as it is declared: one law per state, or a covariance. All laws so far are Gaussian."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .checks import float_array, shown

LAWS = ("gaussian",)
"""Laws that can be named."""


def covariance_of(noise: Any, d: int) -> np.ndarray:
    """Return the covariance (d, d) of noise that is declared axis by axis.

    Parameters
    ----------
    noise : sequence of d mappings
        `{ law = "gaussian", std = 0.05 }`, one for each state; `std` is a standard deviation, in units of the state.

    Raises
    ------
    ValueError
        If a law is unknown, or a number is missing or negative.
    """
    if not isinstance(noise, Sequence) or isinstance(noise, str) or len(noise) != d:
        raise ValueError(f"`noise`: expected a list of {d} laws, one for each state, got {shown(noise)}")
    variances = []
    for entry in noise:
        if not isinstance(entry, Mapping) or {*entry} != {"law", "std"} or entry["law"] not in LAWS:
            raise ValueError(
                '`noise`: expected laws such as { law = "gaussian", std = 0.05 }, '
                f"got {shown(dict(entry) if isinstance(entry, Mapping) else entry)}; the laws are {', '.join(LAWS)}"
            )
        deviation = float(float_array([entry["std"]], "noise", (1,), "[0.05]")[0])
        if deviation < 0.0:
            raise ValueError(f"`noise`: expected a standard deviation of at least 0, got {deviation:g}")
        variances.append(deviation * deviation)
    return np.diag(variances)
