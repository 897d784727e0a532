"""Lists of names and expressions, and numbers and intervals by name: what agents with expressions declare, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..arguments import counted, float_array, read_only, shown
from ..expressions import checked_variable

TIME = "t"
"""Name of the time in expressions, unless a state, input, parameter or disturbance has this name."""

MOST_STATES = 30
"""Most states, inputs, outputs, parameters or disturbances: more would be a slip."""


MOST_OUTPUTS = 150
"""Most outputs: shapes that move have some for each time."""


def checked_texts(value: Any, argument: str, length: int | None, most: int = MOST_STATES) -> tuple[str, ...]:
    """Return a list of strings, as many as there should be, or raise ValueError."""
    is_list = isinstance(value, Sequence) and not isinstance(value, str) and all(isinstance(t, str) for t in value)
    if not is_list or not 0 < len(value) <= most or (length is not None and len(value) != length):
        wanted = f"{counted(length, 'string')}, one for each state" if length else f"1 to {most} strings"
        remedy = f'; write {argument} = ["{value}"]' if isinstance(value, str) else ""
        raise ValueError(f"`{argument}`: expected a list of {wanted}, got {shown(value)}{remedy}")
    return tuple(value)


def checked_names(value: Any, argument: str) -> tuple[str, ...]:
    """Return names that can stand in expressions, or raise ValueError."""
    return tuple(checked_variable(name, argument) for name in checked_texts(value, argument, None))


def checked_numbers(value: Any) -> dict[str, float]:
    """Return parameters by name, or raise ValueError."""
    named = _named(value, "parameters", "{'damping': 0.2}")
    return {
        name: float(float_array([number], f"parameters.{name}", (1,), "[0.2]")[0]) for name, number in named.items()
    }


def checked_ranges(value: Any) -> dict[str, tuple[float, float]]:
    """Return the ends of disturbances by name, or raise ValueError."""
    ranges = {}
    for name, ends in _named(value, "disturbances", "{'wind': [-0.1, 0.1]}").items():
        low, high = read_only(float_array(ends, f"disturbances.{name}", (2,), "[-0.1, 0.1]")).tolist()
        if low > high:
            raise ValueError(f"`disturbances.{name}`: expected low and high, got {low:g} > {high:g}; exchange the two")
        ranges[name] = (low, high)
    return ranges


def _named(value: Any, argument: str, example: str) -> dict[str, Any]:
    """Return a mapping from names of expressions, or raise ValueError."""
    if value is None:
        return {}
    if not isinstance(value, Mapping) or len(value) > MOST_STATES:
        raise ValueError(f"`{argument}`: expected a mapping such as {example}, got {shown(value)}")
    return {checked_variable(name, argument): item for name, item in value.items()}
