"""How the real system may differ from the model that was certified.

A ``Mismatch`` changes noise, actuators or observations of the simulated system, never the certificate. Rollouts under a
mismatch say how far a bound survives. All noise families have mean 0 and the **same covariance** as the model's noise.
Their numbers are made from the model's normal numbers by quantiles, so that different mismatches meet comparable noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

from ...envs.simulation import Dynamics, Worlds
from ...envs.systems.arguments import checked_count

FAMILIES = ("gaussian", "laplace", "uniform", "student-t")
"""Noise families: the model's, one with heavier tails, one without tails, and one with much heavier tails."""

FREEDOM = 5.0
"""Degrees of freedom of Student's t: heavy tails, but four moments exist."""


@dataclass(frozen=True)
class Mismatch:
    """A perturbation of the closed loop; the default changes nothing.

    Parameters
    ----------
    noise_scale : float
        Factor on the standard deviations (dimensionless, at least 0).
    noise_family : str
        One of ``FAMILIES``; independent components in whitened coordinates, unit variance before scaling.
    actuator_bias : float
        Added to every input, as a share of the half width of its box; the sum saturates at the box.
    delay : int
        Control steps by which each agent's view of its own state lags; before time ``delay`` it sees the start. The
        automaton state and the clock are current.
    dropout : float
        Probability, per agent and step, that an agent does not see its state and uses the last one it saw again. The
        start is always seen.

    Raises
    ------
    ValueError
        If a value is out of range.

    Examples
    --------
    >>> str(Mismatch(noise_scale=1.5, delay=1))
    'noise_scale=1.5, delay=1'
    """

    noise_scale: float = 1.0
    noise_family: str = "gaussian"
    actuator_bias: float = 0.0
    delay: int = 0
    dropout: float = 0.0

    def __post_init__(self) -> None:
        for name, low, high in (("noise_scale", 0.0, 1e3), ("actuator_bias", -2.0, 2.0), ("dropout", 0.0, 1.0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float | np.floating) or not low <= value <= high:
                raise ValueError(f"`{name}`: expected a number from {low:g} to {high:g}, got {value!r}")
        if self.noise_family not in FAMILIES:
            raise ValueError(f"`noise_family`: expected one of {', '.join(FAMILIES)}, got {self.noise_family!r}")
        checked_count(self.delay, "delay", least=0, unit="control steps")

    def __str__(self) -> str:
        plain = Mismatch.__dataclass_fields__
        changed = {name: getattr(self, name) for name in plain if getattr(self, name) != plain[name].default}
        return ", ".join(f"{name}={value}" for name, value in changed.items()) or "none"


def disturbed(
    dynamics: Dynamics, mismatch: Mismatch, inputs: Sequence[NDArray[Any]], normals: Sequence[NDArray[Any]]
) -> tuple[tuple[NDArray[Any], ...], tuple[NDArray[Any], ...]]:
    """Return the inputs and the noise of one step as the perturbed system meets them, inputs not yet saturated.

    Parameters
    ----------
    inputs : sequence of (m, n, M) arrays
        Inputs per block that the policy asks for.
    normals : sequence of (d, n, M) arrays
        Standard normal numbers per block, before they are multiplied by the noise factor.
    """
    noise = tuple(mismatch.noise_scale * as_family(z, mismatch.noise_family) for z in normals)
    if mismatch.actuator_bias == 0.0:
        return tuple(inputs), noise
    # The command saturates before the bias is added; the sum saturates once more afterwards.
    biased = []
    for block, u in zip(dynamics.blocks, inputs, strict=True):
        bias = mismatch.actuator_bias * 0.5 * (block.input_high - block.input_low)
        biased.append(np.clip(u, block.input_low, block.input_high) + bias)
    return tuple(biased), noise


def as_family(z: NDArray[Any], family: str) -> NDArray[Any]:
    """Return standard normal numbers turned, by quantiles, into another symmetric family of unit variance.

    Examples
    --------
    >>> as_family(np.array([-1.0, 0.0, 1.0]), "uniform").round(4)
    array([-1.1825,  0.    ,  1.1825])
    """
    if family == "gaussian":
        return z
    # Work on the smaller tail, where the distribution function is accurate, and put the sign back at the end.
    tail = ndtr(-np.abs(z))
    if family == "laplace":
        size = -np.log(2.0 * tail) / np.sqrt(2.0)
    elif family == "uniform":
        size = np.sqrt(12.0) * (0.5 - tail)
    else:
        size = -stdtrit(FREEDOM, tail) * np.sqrt((FREEDOM - 2.0) / FREEDOM)
    return np.copysign(size, z)


@dataclass(frozen=True, eq=False)
class _Sight:
    """Memory of a degraded policy: the policy's own memory, the states of the last steps, what each agent saw last."""

    inner: Any
    past: tuple[tuple[NDArray[Any], ...], ...]
    seen: tuple[NDArray[Any], ...]


@dataclass(frozen=True, eq=False)
class DegradedPolicy:
    """A batch policy behind late or interrupted observations of the agents' own states."""

    policy: Any
    delay: int
    dropout: float
    rng: np.random.Generator

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> _Sight:
        """Return the memory at time 0."""
        return _Sight(self.policy.begin(worlds, rng), (worlds.states,) * self.delay, worlds.states)

    def act(self, worlds: Worlds, memory: _Sight) -> tuple[tuple[NDArray[Any], ...], _Sight]:
        """Return the inputs (m, n, M) per block for the states that agents see, and the memory for the next step."""
        # The oldest remembered states arrive now; before time `delay` these are copies of the start.
        past = (*memory.past, worlds.states)
        arriving = past[0]
        # An agent whose observation is lost sees again what it saw before.
        if self.dropout > 0.0:
            lost = [self.rng.random(x.shape[1:]) < self.dropout for x in arriving]
            arriving = tuple(
                np.where(gone, old, new) for gone, old, new in zip(lost, memory.seen, arriving, strict=True)
            )
        inputs, inner = self.policy.act(replace(worlds, states=arriving), memory.inner)
        return inputs, _Sight(inner, past[1:], arriving)


def degraded(policy: Any, mismatch: Mismatch, rng: np.random.Generator) -> Any:
    """Return the policy behind late or lost observations; the policy itself if observations are perfect."""
    if mismatch.delay == 0 and mismatch.dropout == 0.0:
        return policy
    return DegradedPolicy(policy, int(mismatch.delay), float(mismatch.dropout), rng)
