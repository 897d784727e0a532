"""What tables of agents may say besides the arguments of agents: numbers as expressions, starts of copies, deviations.

All of it is shorthand: the agents that come out have plain arguments, and files that are written hold these.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...systems.agents import TIME, split_deviations
from ...systems.arguments import shown
from ...systems.expressions import ExpressionError, Tree, computed, names_in, read_expression

CONSTANTS = ("state_low", "state_high", "initial_low", "initial_high", "initial_state", "noise_std")
"""Keys of arrays whose entries may be expressions of numbers, such as `"-pi"`; deviations may name states, too."""

STARTS = ("initial_state", "initial_low", "initial_high")
"""Keys that may be a list for each copy."""

INPUTS = ("input_low", "input_high")
"""Keys of arrays whose entries may name the time, too."""


def in_canonical_form(table: Any, horizon: Any, others: Sequence[Any]) -> Any:
    """Return the table of an agent with the arguments that it stands for; what is no table comes back as it is.

    Parameters
    ----------
    table : Any
        As a file has it.
    horizon : Any
        Control steps of the task, at which input boxes in the time `t` are computed.
    others : sequence
        All tables of agents: where they name an input whose box moves it is refused.

    Raises
    ------
    ValueError
        If an entry is wrong. The message names the key.
    """
    if not isinstance(table, Mapping):
        return table
    table = _with_scales(dict(table))
    table = {key: _numbers(value, key) if key in CONSTANTS else value for key, value in table.items()}
    return _with_moving_inputs(table, horizon, others)


def starts_of_copies(table: Mapping[str, Any], copies: int) -> list[Mapping[str, Any]] | None:
    """Return the table of each copy where starts are a list for each of them; None where all start alike."""
    apart = {key: table[key] for key in STARTS if _is_list_of_lists(table.get(key))}
    for key, starts in apart.items():
        if len(starts) != copies:
            raise ValueError(f"`{key}`: expected one start, or one for each of {copies} copies, got {len(starts)}")
    if not apart:
        return None
    return [
        {**table, "name": f"{table['name']}_{k}", **{key: starts[k] for key, starts in apart.items()}}
        for k in range(copies)
    ]


def _is_list_of_lists(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(own, list) for own in value)


def _tree(text: str, key: str, names: tuple[str, ...]) -> Tree:
    try:
        return read_expression(text, names)
    except ExpressionError as error:
        raise ValueError(f"`{key}`: {error}") from None


def _numbers(value: Any, key: str) -> Any:
    """Return a list with its expressions of numbers as numbers, lists in it too."""
    if isinstance(value, list):
        return [_numbers(entry, key) for entry in value]
    if not isinstance(value, str):
        return value
    return float(np.asarray(computed((_tree(value, key, ()),), {})[0]).reshape(-1)[0])


def _with_scales(table: dict[str, Any]) -> dict[str, Any]:
    """Return a table whose standard deviations are numbers: one that names a state, an input or the time is a scale."""
    given, known = table.get("noise_std"), not {"noise_scale", "noise"} & {*table}
    if not isinstance(given, list) or not known:
        return table
    named = [isinstance(entry, str) and _names_something(entry) for entry in given]
    if not any(named):
        return table
    if not isinstance(table.get("dynamics"), list):
        raise ValueError(
            f"`noise_std`: expected numbers, got {shown(given)}; noise that names states or the time is for agents "
            "written as expressions, with `states` and `dynamics`"
        )
    plain = [entry if moves else _numbers(entry, "noise_std") for entry, moves in zip(given, named, strict=True)]
    deviations, scales = split_deviations(plain)
    return {**table, "noise_std": deviations, "noise_scale": scales}


def _names_something(text: str) -> bool:
    """Whether a text is no expression of numbers alone."""
    try:
        read_expression(text, ())
    except ExpressionError as error:
        return "unknown name" in str(error)
    return False


def _with_moving_inputs(table: dict[str, Any], horizon: Any, others: Sequence[Any]) -> dict[str, Any]:
    """Return a table whose input box stands still: inputs beyond a box that moves count as its nearest end.

    An input is written as `clip(input, low, high)` wherever dynamics and scales name it, and its box is the smallest
    one that holds the boxes of all steps.
    """
    written = [key for key in INPUTS if isinstance(table.get(key), list)]
    trees = {
        (key, j): _tree(text, key, (TIME,))
        for key in written
        for j, text in enumerate(table[key])
        if isinstance(text, str)
    }
    if not trees:
        return table
    if type(horizon) is not int or horizon < 1:
        return table  # what is wrong with the horizon is said where it is read
    result, times = {**table, **{key: list(table[key]) for key in written}}, np.arange(horizon, dtype=float)
    moving = sorted({j for (_, j), tree in trees.items() if names_in(tree)})
    ends = {}
    for (key, j), tree in trees.items():
        ends[key, j] = np.broadcast_to(np.asarray(computed((tree,), {TIME: times})[0], dtype=float), times.shape)
        if not np.all(np.isfinite(ends[key, j])):
            raise ValueError(f"`{key}`: expected numbers at all steps, got {shown(table[key][j])}")
        result[key][j] = float(ends[key, j].min() if key == INPUTS[0] else ends[key, j].max())
    if moving:
        _clip(result, table, moving, others)
        for j in moving:
            low, high = (ends.get((key, j), table[key][j]) for key in INPUTS)
            empty = np.flatnonzero(np.greater(low, high))
            if len(empty):
                raise ValueError(
                    f"`input_low`: expected at most `input_high` at all steps, got more at step {empty[0]}"
                )
    return result


def _clip(result: dict[str, Any], table: Mapping[str, Any], moving: Sequence[int], others: Sequence[Any]) -> None:
    """Write clipped inputs into dynamics and scales."""
    names = table.get("inputs")
    if not isinstance(names, list) or not isinstance(table.get("dynamics"), list):
        raise ValueError("`input_low`, `input_high`: expected numbers, as there are no `dynamics` with named `inputs`")
    for j in moving:
        if j >= len(names) or any(j >= len(table.get(key) or ()) for key in INPUTS):
            raise ValueError(f"`input_low`, `input_high`: expected one entry for each of {len(names)} inputs")
        owner = re.escape(str(table.get("name"))) + (r"_\d+" if "copies" in table else "")
        owned = re.compile(rf"(?<![\w.]){owner}\.{re.escape(str(names[j]))}\b")
        for other in others:
            texts = [*_texts(other, "dynamics"), *_texts(other, "noise_scale")]
            if any(owned.search(text) for text in texts):
                raise ValueError(
                    f"`input_high`: the box of `{names[j]}` names the time, and another agent names that input; "
                    f"bound it by numbers, and write `clip({names[j]}, low, high)` where it acts"
                )
        low, high = (table[key][j] for key in INPUTS)
        alone = re.compile(rf"(?<![\w.]){re.escape(str(names[j]))}(?![\w.])")
        for key in ("dynamics", "noise_scale"):
            if isinstance(result.get(key), list):
                clipped = f"clip({names[j]}, {low}, {high})"
                result[key] = [alone.sub(clipped, text) if isinstance(text, str) else text for text in result[key]]


def _texts(table: Any, key: str) -> list[str]:
    found = table.get(key) if isinstance(table, Mapping) else None
    return [text for text in found if isinstance(text, str)] if isinstance(found, list) else []
