"""The problem that a user names: by a `Problem`, the id of a suite problem, or the path of a problem file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..tasks.problem import Problem, checked_problem, load_problem
from .catalogue import make_problem


def as_problem(value: Any) -> Problem:
    """Return the problem that a value stands for.

    Parameters
    ----------
    value : Problem, str or Path
        Text that ends in `.toml` is the path of a problem file, any other text the id of a suite problem.

    Raises
    ------
    ValueError
        If it is none of these.
    """
    if isinstance(value, str) and not value.endswith(".toml"):
        return make_problem(value)
    if isinstance(value, str | Path):
        return load_problem(value)
    return checked_problem(value)
