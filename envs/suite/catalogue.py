"""The suite: problems by their ids. The version `-vN` of an id changes when results on the problem change."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from inspect import signature
from typing import Any

from ..systems.arguments import shown, unknown_argument
from ..tasks.problem import Problem
from .ids import MODULES, NAMESPACE, ROOMS, VARIANTS, gymnasium_id
from .tiers import NAMES, TIERS

# Arguments that every problem takes: they are handed to `Problem.replace`.
_CHANGES = ("initial_state", "initial_low", "initial_high", "disturbance_scale")

_BY_GYMNASIUM = {gymnasium_id(id).removeprefix(f"{NAMESPACE}/"): id for id in MODULES}


def problem_ids(tier: str | None = None) -> tuple[str, ...]:
    """Return the ids of the suite, or those of one tier, in alphabetical order.

    Parameters
    ----------
    tier : "solved", "open", "hard" or "unrated", optional
        What is left to learn, by what learners without help have reached (see `tiers`).

    Examples
    --------
    >>> "reach-avoid-v0" in problem_ids()
    True
    >>> "reach-avoid-v0" in problem_ids("solved")
    True
    """
    if tier is not None and tier not in NAMES:
        raise ValueError(f"`tier`: expected {', '.join(map(repr, NAMES))}, got {shown(tier)}")
    return tuple(id for id in sorted(MODULES) if tier in (None, tier_of_id(id)))


def tier_of_id(id: str) -> str:
    """Return the tier of an id; one that nobody has judged yet is unrated."""
    return TIERS.get(id, "unrated")


def make_problem(id: str, **arguments: Any) -> Problem:
    """Return a suite problem.

    Parameters
    ----------
    id : str
        One of `problem_ids()`, with or without the prefix "certigym/"; the names of Gymnasium ("Meeting-v0") will do.
    **arguments
        Arguments of the problem, such as `horizon` or, if its page says so, `n_agents`. Every problem also takes
        `initial_state`, or `initial_low` and `initial_high`, and `disturbance_scale`, in the forms of
        `Problem.replace`.

    Raises
    ------
    ValueError
        If the id or an argument is unknown, or a value is wrong.

    Examples
    --------
    >>> make_problem("invariance-v0", n_agents=3, horizon=5).n_agents
    3
    """
    return problem_of_id(id, arguments)


def problem_of_id(id: str, arguments: dict[str, Any], also: Iterable[str] = ()) -> Problem:
    """Return a suite problem; `also` are arguments taken elsewhere, which the error about an unknown one lists, too."""
    key = id.removeprefix(f"{NAMESPACE}/") if isinstance(id, str) else id
    key = _BY_GYMNASIUM.get(key, key) if isinstance(key, str) else key
    if not isinstance(key, str) or key not in MODULES:
        close = get_close_matches(str(key), MODULES, n=1)
        remedy = f"did you mean {close[0]!r}?" if close else f"the ids are {', '.join(problem_ids())}"
        raise ValueError(f"`id`: expected the id of a suite problem, got {shown(id)}; {remedy}")
    # Load the one module that is needed; its parameters are the problem's arguments.
    make, _ = made_by(key)
    changes = {name: value for name, value in arguments.items() if name in _CHANGES}
    arguments = {name: value for name, value in arguments.items() if name not in _CHANGES}
    parameters = list(signature(make).parameters)
    for name in arguments:
        if name not in parameters:
            raise unknown_argument(name, key, [*parameters, *_CHANGES, *also])
    problem = make(**arguments)
    return problem.replace(**changes) if changes else problem


@cache
def made_by(id: str) -> tuple[Callable[..., Problem], str]:
    """Return the function that makes the problem of an id, with its arguments as parameters, and what is said of it."""
    if id not in VARIANTS:
        room = next(room for room, ids in ROOMS.items() if id in ids)
        module = import_module(f"..{room}.{MODULES[id]}", __name__)
        return module.problem, module.__doc__ or ""
    variant = VARIANTS[id]
    of, _ = made_by(variant.of)

    asked = [own for name, own in signature(of).parameters.items() if name not in variant.arguments]
    usual = [own.replace(default=variant.usual.get(own.name, own.default)) for own in asked]
    form = signature(of).replace(parameters=usual)

    def problem(*given: Any, **named: Any) -> Problem:
        own = form.bind(*given, **named).arguments
        return of(**{**variant.arguments, **variant.usual, **own}).replace(name=id, **variant.changes)

    problem.__doc__ = f"Return the problem {id}: {variant.about}."
    problem.__signature__ = form  # type: ignore[attr-defined]
    return problem, f"{variant.name}: {variant.about}.\n\n**Versions**: v0: the first version.\n"
