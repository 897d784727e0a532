"""What a check takes for granted, noted down so that it can be proved.

A check computes with doubles. What sums, products, quotients and roots lose follows from the standard of floating
point, and is charged where it is lost. Everything else (special functions, factorisations, intervals around
expressions) is *stated* where it is made: ``state("masses", agent, part, tables)``. By itself that does nothing. Within
``noted`` the statements are kept, and whoever asked for them can prove them, one by one, in another arithmetic.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple

import numpy as np


class Statement(NamedTuple):
    """The name of what is stated, which is that of its proof, and its numbers."""

    name: str
    numbers: tuple[Any, ...]


_NOTES: ContextVar[list[Statement] | None] = ContextVar("notes", default=None)


def state(name: str, *numbers: Any) -> None:
    """Note down a statement if somebody listens."""
    notes = _NOTES.get()
    if notes is not None:
        notes.append(Statement(name, tuple(map(_kept, numbers))))


def _kept(number: Any) -> Any:
    """A number as it is now: arrays may be filled anew."""
    if isinstance(number, np.ndarray):
        return number.copy()
    return tuple(map(_kept, number)) if type(number) in (tuple, list) else number


@contextmanager
def noted() -> Iterator[list[Statement]]:
    """Keep what is stated within a block."""
    notes: list[Statement] = []
    token = _NOTES.set(notes)
    try:
        yield notes
    finally:
        _NOTES.reset(token)
