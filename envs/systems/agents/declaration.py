"""What an agent declares in Python, brought to the keys of problem files.

A box is a pair ``(low, high)`` in Python and two keys in a file; so is a start that is a box. Noise is a standard
deviation, a covariance, laws, or a mapping of these. The keys are arguments in Python, too.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

from ..arguments import float_array, for_all_axes, shown, unknown_argument
from ..distributions import Law

SPACES = {"state_space": ("state_low", "state_high"), "input_space": ("input_low", "input_high")}
"""Pairs of corners, and their keys in files."""

STARTS = ("initial_state", "initial_low", "initial_high")
"""Keys of the start in files."""

NOISES = {"covariance": "noise_covariance", "std": "noise_std", "laws": "noise", "axes": "noise_axes"}
"""Parts of noise that is a mapping, and their keys in files."""

SCALE = {"scale": "noise_scale"}
"""The same of noise whose size is an expression."""

KEYS = (*(key for pair in SPACES.values() for key in pair), *STARTS, "noise_covariance", "noise_std", "noise_axes")
"""Keys that all agents have in files and that no argument of their signatures has the name of."""


def declared(owner: str, d: int, named: Mapping[str, Any], keys: Mapping[str, Any], more: Collection[str]) -> Any:
    """Return the arguments of an agent by the keys of problem files; None for those that are not given.

    Parameters
    ----------
    owner : str
        Class of the agent, for messages.
    d : int
        Number of states.
    named : mapping
        Arguments in its signature.
    keys : mapping
        Keys of problem files that were given instead.
    more : collection of str
        Keys that only agents of this class have.

    Raises
    ------
    ValueError
        If a key does not exist, or something is given twice.
    """
    known = (*KEYS, *more)
    for key in keys:
        if key not in known:
            raise unknown_argument(key, f"`{owner}`", [*named, *known])
    given = {**dict.fromkeys(known), "added_outputs": 0, **named, **keys}
    for argument, pair in SPACES.items():
        if (space := given.pop(argument)) is not None:
            given |= _once(argument, given, dict(zip(pair, _corners(argument, space), strict=True)))
    if (start := given.pop("start")) is not None:
        given |= _once("start", given, _start(start, d))
    noise = given.pop("noise")
    given["noise"] = None
    if noise is not None:
        given |= _once("noise", given, _noise(noise, d, {**NOISES, **(SCALE if "noise_scale" in known else {})}))
    return with_covariance(given, d)


def _once(argument: str, given: Mapping[str, Any], found: dict[str, Any]) -> dict[str, Any]:
    """Return keys that stand for an argument; raise ValueError if one of them is given, too."""
    for key, value in found.items():
        if value is not None and given.get(key) is not None:
            raise ValueError(f"`{argument}`: expected none beside `{key}`, got both; leave one of them out")
    return found


def _corners(argument: str, space: Any) -> tuple[Any, Any]:
    """Return the corners of a box: a pair, or an object with `low` and `high`, such as a space of Gymnasium."""
    if hasattr(space, "low") and hasattr(space, "high"):
        return space.low, space.high
    if isinstance(space, Sequence | np.ndarray) and not isinstance(space, str) and len(space) == 2:
        return space[0], space[1]
    raise ValueError(f"`{argument}`: expected a pair (low, high), such as ([-1, -1], [1, 1]), got {shown(space)}")


def _start(start: Any, d: int) -> dict[str, Any]:
    """Return the keys of a start: a point, or a pair of corners.

    Two numbers are corners for an agent of one state, and a point for others.
    """
    is_pair = isinstance(start, Sequence | np.ndarray) and not isinstance(start, str) and len(start) == 2
    if hasattr(start, "low") or (is_pair and (d == 1 or all(_depth(corner) == 1 for corner in start))):
        return dict(zip(("initial_low", "initial_high"), _corners("start", start), strict=True))
    return {"initial_state": start}


def _noise(noise: Any, d: int, parts: Mapping[str, str]) -> dict[str, Any]:
    """Return the keys of noise that is given in any form."""
    if isinstance(noise, Law):
        return {"noise": [noise] * d}
    if isinstance(noise, Mapping) and "law" in noise:
        return {"noise": noise}
    if isinstance(noise, Mapping):
        for part in noise:
            if part not in parts:
                raise unknown_argument(str(part), "`noise`", parts)
        return {parts[part]: value for part, value in noise.items()}
    if isinstance(noise, Real | str) or _depth(noise) == 1:
        return {"noise_std": noise}
    return {"noise_covariance" if _depth(noise) == 2 else "noise": noise}


def _depth(value: Any) -> int:
    """Return 1 for numbers in a row, 2 for rows of them, 0 for anything else."""
    if isinstance(value, np.ndarray):
        return value.ndim
    if not isinstance(value, Sequence) or isinstance(value, str) or not len(value):
        return 0
    if all(isinstance(entry, Real | str) for entry in value):
        return 1
    return 2 if all(_depth(entry) == 1 for entry in value) else 0


def with_covariance(given: Mapping[str, Any], d: int) -> dict[str, Any]:
    """Return arguments with a covariance, or laws, in the place of standard deviations."""
    rest = {key: value for key, value in given.items() if key != "noise_std"}
    if (value := given.get("noise_std")) is None:
        return rest
    for other in ("noise_covariance", "noise"):
        if given.get(other) is not None:
            raise ValueError(f"`noise_std`: expected no `{other}` beside it; leave one of them out")
    numbers, scales = split_deviations([value] * d if isinstance(value, str) else for_all_axes(value, d))
    if scales is not None:
        if "noise_scale" not in given or given["noise_scale"] is not None:
            raise ValueError(
                f"`noise_std`: expected numbers, got {shown(value)}; noise that names states or the time "
                "is for agents written as expressions, with `states` and `dynamics`, and without `noise_scale`"
            )
        given = {**given, "noise_scale": scales}
        rest |= {"noise_scale": scales}
    deviations = float_array(numbers, "noise_std", (None,), "[0.1, 0.1]")
    if len(deviations) != d or np.any(deviations < 0.0):
        raise ValueError(f"`noise_std`: expected numbers >= 0, one for each state, got {shown(value)}")
    if given.get("noise_scale") is not None:  # which multiplies laws
        return {**rest, "noise": [{"law": "gaussian", "std": deviation} for deviation in deviations.tolist()]}
    return {**rest, "noise_covariance": np.diag(deviations**2)}


def split_deviations(deviations: Any) -> tuple[Any, list[Any] | None]:
    """Return standard deviations as numbers, 1 where they are expressions, and these as scales; None if none is."""
    if not isinstance(deviations, list | tuple) or not any(isinstance(own, str) for own in deviations):
        return deviations, None
    numbers = [1.0 if isinstance(own, str) else own for own in deviations]
    return numbers, [own if isinstance(own, str) else "1" for own in deviations]
