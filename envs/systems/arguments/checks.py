"""Numbers from users: read-only float64 arrays and whole numbers, or an error that names the argument.

Every array that enters a problem passes through `float_array`, whether it comes from Python or from a file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from functools import wraps
from inspect import signature
from itertools import accumulate, pairwise
from numbers import Real
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[Any]
"""Arrays of numbers, for annotations: float64 unless the text says otherwise."""

LARGEST_MAGNITUDE = 1e100
"""Largest magnitude accepted: far beyond any model, and its square is still a finite float64."""

MOST_AGENTS = 10_000
"""Most agents of a problem: ten times what has been tried, and few enough that a mistyped number fails at once."""


class UnknownArgument(ValueError, TypeError):
    """A keyword argument that does not exist.

    It is a `ValueError`, as all mistakes of callers are, and also a `TypeError` in Python's own words ("unexpected
    keyword argument"): libraries catch that one to find out what an environment takes.
    """


OTHER_NAMES = {
    "algo": ("algorithm",),
    "budget": ("effort", "seconds"),
    "callback": ("progress",),
    "formula": ("specification",),
    "grid": ("cells",),
    "iterations": ("max_sweeps", "steps"),
    "labels": ("propositions",),
    "ltl": ("specification",),
    "max_iter": ("max_sweeps", "steps"),
    "max_time": ("seconds",),
    "method": ("relation", "algorithm"),
    "model": ("policy", "controller", "result"),
    "n": ("episodes", "cells"),
    "n_envs": ("worlds",),
    "n_episodes": ("episodes",),
    "n_jobs": ("executor",),
    "n_steps": ("steps", "horizon"),
    "n_workers": ("executor",),
    "num_episodes": ("episodes",),
    "predicates": ("propositions",),
    "random_state": ("seed",),
    "regions": ("propositions",),
    "resolution": ("cells",),
    "rng": ("seed",),
    "robots": ("agents",),
    "runs": ("episodes",),
    "samples": ("episodes",),
    "spec": ("specification",),
    "task": ("specification",),
    "time_limit": ("seconds",),
    "timeout": ("seconds", "effort"),
    "timesteps": ("steps",),
    "total_timesteps": ("steps",),
    "trials": ("episodes",),
    "upper_bound": ("above",),
    "verbose": ("progress",),
    "warm_start": ("start",),
    "workers": ("executor",),
}
"""Names that other libraries give to arguments, and ours for them: what a first guess means."""


def near(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that an unknown one means or resembles, if there is one."""
    known = list(known)
    meant = [one for one in OTHER_NAMES.get(name, ()) if one in known]
    return next(iter(meant or get_close_matches(name, known, n=1)), None)


def unknown_argument(name: str, owner: str, known: Iterable[str], meant: str | None = None) -> UnknownArgument:
    """Return the error about the argument `name` of `owner`, with what was meant, by default the nearest, or all."""
    known = list(known)
    meant = meant or near(name, known)
    remedy = f"did you mean `{meant}`?" if meant else f"the arguments are {', '.join(known)}"
    return UnknownArgument(
        f"`{name}`: expected an argument of {owner}, got an unexpected keyword argument {name!r}; {remedy}"
    )


Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def names_arguments(*more: str) -> Callable[[Callable[Parameters, Result]], Callable[Parameters, Result]]:
    """Return a decorator of functions that refuse a keyword which does not exist, and name the one that was meant.

    ``more`` are keywords that a function takes besides those in its signature.
    """

    def decorated(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
        own = [one.name for one in signature(function).parameters.values() if one.kind is not one.VAR_KEYWORD]
        known = [*(name for name in own if name != "self"), *more]
        owner = function.__qualname__.removesuffix(".__init__")

        @wraps(function)
        def called(*arguments: Parameters.args, **named: Parameters.kwargs) -> Result:
            for name in named:
                if name not in known:
                    raise unknown_argument(name, f"`{owner}`", known)
            return function(*arguments, **named)

        return called

    return decorated


def float_array(value: Any, name: str, shape: tuple[int | None, ...], example: str) -> FloatArray:
    """Return `value` as a read-only float64 array of the given shape (exact copy).

    Parameters
    ----------
    value : array_like
        Numbers, or nested lists of numbers; one number for one in lists. Strings and Booleans are refused.
    name : str
        Argument named in the error.
    shape : tuple of int or None
        Expected lengths, None for any length of at least 1.
    example : str
        A value of the right form, shown in the error.

    Raises
    ------
    ValueError
        If `value` has another shape, or holds anything but finite numbers of magnitude at most 1e100.
    """
    wanted = f"numbers of shape ({', '.join('any' if n is None else str(n) for n in shape)}) such as {example}"
    # Read as objects first: numpy would turn strings and Booleans into numbers without a word.
    try:
        cells = np.array(value, dtype=object)
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(f"`{name}`: expected {wanted}, got {shown(value)}") from error
    if any(isinstance(cell, (list, tuple, np.ndarray)) for cell in cells.flat):
        raise ValueError(f"`{name}`: expected {wanted}, got rows of unequal length or depth in {shown(value)}")
    for cell in cells.flat:
        if not isinstance(cell, Real) or isinstance(cell, bool):
            raise ValueError(f"`{name}`: expected {wanted}, got {shown(cell)}; give plain numbers")
    if not cells.ndim and all(n in (None, 1) for n in shape):  # one number for a vector or a matrix of one
        cells = cells.reshape((1,) * len(shape))
    if cells.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, cells.shape)) or cells.size == 0:
        raise ValueError(f"`{name}`: expected {wanted}, got shape {_shape(cells.shape)}: {shown(value)}")
    # The comparison is written such that NaN fails it, too.
    for cell in cells.flat:
        if not abs(cell) <= LARGEST_MAGNITUDE:
            raise ValueError(
                f"`{name}`: expected finite numbers of magnitude at most {LARGEST_MAGNITUDE:g}, got {shown(cell)}"
            )
    return read_only(cells.astype(np.float64) + 0.0)  # + 0.0 turns -0.0 into 0.0: equal problems, equal fingerprints


def for_all_axes(value: Any, length: int | None) -> Any:
    """Return a list of `length` numbers where one number is given for all axes, else `value` itself, unchecked."""
    is_one = isinstance(value, Real) and not isinstance(value, bool)
    return [value] * length if is_one and length is not None else value


def checked_count(value: Any, argument: str, least: int = 1, most: int | None = None, unit: str = "") -> int:
    """Return a whole number as an int (exact), or raise ValueError; Booleans and floats are refused.

    Parameters
    ----------
    value : object
        An int or a numpy integer.
    argument : str
        Argument named in the error.
    least, most : int
        Smallest and largest number accepted; no largest one if `most` is None.
    unit : str
        What is counted, such as "control steps"; shown in the error.
    """
    # A Boolean is an int in Python, but never meant as a count.
    is_whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not is_whole or value < least or (most is not None and value > most):
        span = f"of at least {least}" if most is None else f"from {least} to {most}"
        counted = f" ({unit})" if unit else ""
        raise ValueError(f"`{argument}`: expected a whole number {span}{counted}, got {shown(value)}")
    return int(value)


def checked_states(of: Any) -> tuple[str | int, ...]:
    """Return the states that `of` names, by name or number; raise ValueError if they are malformed."""
    entries = [of] if isinstance(of, str | int) else list(of) if isinstance(of, Sequence) else []
    good = all(isinstance(entry, str | int) and not isinstance(entry, bool) for entry in entries)
    if not entries or not good or len({*entries}) < len(entries):
        raise ValueError(f"`of`: expected different names or numbers of states, got {shown(of)}")
    return tuple(entries)


def slices_of(lengths: Iterable[int]) -> tuple[slice, ...]:
    """Return the slices of pieces with these lengths that stand one after the other.

    Examples
    --------
    >>> slices_of([2, 1])
    (slice(0, 2, None), slice(2, 3, None))
    """
    ends = list(accumulate(lengths, initial=0))
    return tuple(slice(start, end) for start, end in pairwise(ends))


def read_only(array: np.ndarray) -> np.ndarray:
    """Return `array` itself, marked read-only."""
    array.flags.writeable = False
    return array


def shown(value: Any, limit: int = 60) -> str:
    """Return a one-line, shortened `repr` of a value for error messages."""
    try:
        text = " ".join(repr(value).split())
    except (ValueError, RecursionError):  # integers of more digits than Python prints, lists nested too deeply
        text = f"a value of type {type(value).__name__}"
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


def _shape(shape: tuple[int, ...]) -> str:
    return f"({', '.join(str(n) for n in shape)})"
