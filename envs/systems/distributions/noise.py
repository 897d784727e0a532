"""Noise as it is declared: a law per axis, or a covariance."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from numbers import Real
from typing import Any

import numpy as np

from ..arguments import float_array, near, read_only, shown
from .composed_laws import Mixture, TruncatedGaussian, scipy_law
from .laws import Gaussian, Laplace, Law, Logistic, StudentT, Triangular, Uniform

MOST_PARTS = 20
"""Most parts of a mixture."""

KINDS: dict[str, type[Law]] = {
    law.name: law for law in (Gaussian, Uniform, Triangular, Laplace, Logistic, StudentT, TruncatedGaussian)
}
"""Laws by the names that problem files use, apart from mixtures."""


def is_own_law(law: Law) -> bool:
    """Return whether a law is one of this package, of which every number can be computed from its parameters."""
    return type(law) is Mixture or type(law) in KINDS.values()


def laws_by_author(laws: Iterable[Law]) -> list[Law]:
    """Return those laws, parts of mixtures among them, whose numbers are what their authors state."""
    found = list[Law]()
    for law in laws:
        found += laws_by_author(law.laws) if isinstance(law, Mixture) else [] if is_own_law(law) else [law]
    return found


NAMES = ", ".join([*KINDS, Mixture.name, "scipy"])


def laws_of(noise: Any, d: int) -> tuple[Law, ...]:
    """Return the laws of noise that is declared axis by axis.

    Parameters
    ----------
    noise : sequence of d mappings or laws
        Such as `{ law = "gaussian", std = 0.05 }`, one for each axis, or a single one for
        all, in which a number may be a list of d; numbers are in units of the state. A number stands for the normal
        law with this deviation.

    Raises
    ------
    ValueError
        If a law is unknown, or a number is missing or makes no sense.
    """
    if isinstance(noise, Mapping):
        # Parts of mixtures and arguments of scipy's laws are lists of their own.
        has_numbers = isinstance(noise.get("law"), str) and noise["law"] in KINDS
        noise = [
            {key: _of_axis(value, k, d) if has_numbers else value for key, value in noise.items()} for k in range(d)
        ]
    if not isinstance(noise, Sequence) or isinstance(noise, str) or len(noise) != d:
        raise ValueError(
            f"`noise`: expected a list of {d} laws, one for each state, such as "
            f'{{ law = "gaussian", std = 0.1 }}, got {shown(noise)}'
        )
    laws = tuple(entry if isinstance(entry, Law) else _law(entry) for entry in noise)
    for law in laws_by_author(laws):
        if law.name in (*KINDS, Mixture.name):
            raise ValueError(
                f"`noise`: expected a name of its own for the law {type(law).__name__}, got {law.name!r}, which is one "
                "of this package, with its formulas; give it another"
            )
    return laws


def _of_axis(value: Any, k: int, d: int) -> Any:
    """Return the number of axis k where a law of all axes has one for each."""
    is_one_each = isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) and len(value) == d
    return value[k] if is_one_each and all(isinstance(number, Real) for number in value) else value


def _law(entry: Any) -> Law:
    """Return one law, or raise ValueError."""
    if isinstance(entry, Real) and not isinstance(entry, bool):
        entry = {"law": Gaussian.name, "std": entry}
    if not isinstance(entry, Mapping) or "law" not in entry:
        got = shown(dict(entry) if isinstance(entry, Mapping) else entry)
        raise ValueError(f'`noise`: expected laws such as {{ law = "gaussian", std = 0.05 }}, got {got}; use {NAMES}')
    if entry["law"] == "scipy" or callable(getattr(entry["law"], "cdf", None)):
        return scipy_law(entry)
    if entry["law"] == Mixture.name:
        return _mixture(entry)
    kind = KINDS.get(entry["law"]) if isinstance(entry["law"], str) else None
    if kind is None:
        meant = near(str(entry["law"]), KINDS)
        remedy = f"; did you mean {meant!r}?" if meant else ""
        raise ValueError(f"`noise`: expected one of the laws {NAMES}, got {shown(entry['law'])}{remedy}")
    wanted = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    if {*entry} != {"law", *wanted}:
        raise ValueError(f"`noise`: expected {', '.join(wanted)} for a {kind.name} law, got {shown(dict(entry))}")
    numbers = {name: float(float_array([entry[name]], f"noise.{name}", (1,), "[0.05]")[0]) for name in wanted}
    _check_numbers(kind.name, numbers)
    return kind(**numbers)


def _check_numbers(name: str, numbers: dict[str, float]) -> None:
    """Raise ValueError if numbers cannot be those of a law."""
    for key in ("std", "scale", "spread"):
        least = 0.0 if key == "std" else math.ulp(0.0)
        if key in numbers and not numbers[key] >= least:
            wanted = f"a {key} of at least 0" if key == "std" else f"a positive {key}"
            raise ValueError(f"`noise`: expected {wanted} of a {name} law, got {numbers[key]:g}")
        if key in numbers and 0.0 < numbers[key] < LEAST_DEVIATION:
            raise ValueError(f"`noise`: expected a {key} of at least {LEAST_DEVIATION:g}, got {numbers[key]:g}")
    if "low" in numbers and not numbers["low"] < numbers["high"]:
        raise ValueError(f"`noise`: expected low < high, got {numbers['low']:g} and {numbers['high']:g}")
    if "mode" in numbers and not numbers["low"] <= numbers["mode"] <= numbers["high"]:
        raise ValueError(f"`noise`: expected a mode between low and high, got {numbers['mode']:g}")
    if "df" in numbers and not 2.0 < numbers["df"] <= 1e6:
        raise ValueError(f"`noise`: expected more than 2 degrees of freedom, a finite variance, got {numbers['df']:g}")
    if name == TruncatedGaussian.name and not TruncatedGaussian(**numbers).share >= LEAST_SHARE:
        raise ValueError(
            f"`noise`: expected an interval with a probability of at least {LEAST_SHARE:g} before truncation, got "
            f"[{numbers['low']:g}, {numbers['high']:g}] with spread {numbers['spread']:g}"
        )


LEAST_DEVIATION = 1e-100
"""Least positive deviation of a law: the squares of smaller ones are 0 in floating point."""

LEAST_SHARE = 0.01
"""Least probability of the interval of a truncated law: smaller ones cost digits."""


def _mixture(entry: Mapping[str, Any]) -> Mixture:
    """Return a mixture, or raise ValueError."""
    parts = entry.get("parts")
    if {*entry} != {"law", "parts"} or not isinstance(parts, Sequence) or not 0 < len(parts) <= MOST_PARTS:
        raise ValueError(
            f"`noise`: expected 1 to {MOST_PARTS} parts of a mixture, each a law with `weight` and `mean`, got "
            f"{shown(dict(entry))}"
        )
    weights, means, laws = [], [], []
    for part in parts:
        if not isinstance(part, Mapping) or "weight" not in part:
            raise ValueError(f"`noise`: expected parts of a mixture with `weight`, `mean` and a law, got {shown(part)}")
        numbers = [part["weight"], part.get("mean", 0.0)]
        weight, mean = float_array(numbers, "noise.parts", (2,), "[0.5, 0.0]").tolist()
        weights.append(weight)
        means.append(mean)
        laws.append(_law({key: value for key, value in part.items() if key not in ("weight", "mean")}))
    if min(weights) <= 0.0 or abs(sum(weights) - 1.0) > 1e-9:
        raise ValueError(f"`noise`: expected positive weights of a mixture that sum to 1, got {shown(weights)}")
    total = sum(weights)
    if any(isinstance(law, Mixture) for law in laws) or any(law.std == 0.0 for law in laws):
        raise ValueError("`noise`: expected parts of a mixture that are continuous and no mixtures themselves")
    return Mixture(tuple(weight / total for weight in weights), tuple(means), tuple(laws))


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise ``w = axes @ e`` of an agent, with independent components of e.

    Parameters
    ----------
    covariance : (d, d) array
        Covariance of w: exactly what was given, or that of the laws (rounded).
    laws : tuple of Law, or None
        Laws of the components of e; None where w is Gaussian, and all is in the covariance.
    axes : (d, d) array
        Directions of the components, as columns; the identity where laws are those of the states.
    """

    covariance: np.ndarray
    laws: tuple[Law, ...] | None
    axes: np.ndarray


def declared_noise(noise: Any, covariance: Any, axes: Any, d: int) -> Noise:
    """Return the noise that an agent declares, by laws or by a covariance.

    Raises
    ------
    ValueError
        If both or none are given, or a law, the covariance or the axes are wrong.
    """
    if noise is None and covariance is None:
        raise ValueError(
            "`noise`: expected `noise`, `noise_covariance` or `noise_std`, got none; give one, such as "
            f"`noise_std = {[0.1] * d}`, with 0.0 for a state without noise"
        )
    if noise is not None and covariance is not None:
        raise ValueError("`noise`: expected either `noise` or `noise_covariance`, got both; leave one of them out")
    identity = read_only(np.eye(d))
    if noise is None:
        if axes is not None:
            raise ValueError("`noise_axes`: expected none with a covariance, which has its own; leave them out")
        return Noise(checked_covariance(covariance, d), None, identity)
    laws = laws_of(noise, d)
    directions = identity if axes is None else float_array(axes, "noise_axes", (d, d), f"{np.eye(d).tolist()}")
    if not np.linalg.cond(directions) < MOST_CONDITION:
        raise ValueError(
            f"`noise_axes`: expected columns that are linearly independent, got {shown(directions.tolist())}"
        )
    variances = np.array([law.std**2 for law in laws])
    product = directions * variances @ directions.T
    total = checked_covariance(0.5 * (product + product.T), d)
    is_gaussian = all(isinstance(law, Gaussian) for law in laws)
    if not is_gaussian and not np.all(variances > 0.0) and np.any(directions != identity):
        raise ValueError("`noise`: expected positive deviations along `noise_axes` that are no states, got 0")
    return Noise(total, None if is_gaussian else laws, directions)


MOST_CONDITION = 1e8
"""Largest condition number of the axes of noise: beyond it digits are lost."""


def checked_covariance(value: Any, d: int) -> np.ndarray:
    """Return a covariance if it is symmetric and positive semidefinite; raise ValueError otherwise."""
    covariance = float_array(value, "noise_covariance", (d, d), f"{np.eye(d).tolist()}")
    if (covariance != covariance.T).any():
        raise ValueError(
            f"`noise_covariance`: expected a symmetric matrix, got {shown(covariance.tolist())}; use (S + S.T) / 2"
        )
    spectrum = np.linalg.eigvalsh(covariance)
    # Rounding may push the zero eigenvalues of a singular covariance a little below zero.
    if spectrum[0] < -4.0 * d * np.finfo(float).eps * max(spectrum[-1], 0.0):
        raise ValueError(
            f"`noise_covariance`: expected a positive semidefinite matrix, got the eigenvalue {spectrum[0]:g}"
        )
    return covariance
