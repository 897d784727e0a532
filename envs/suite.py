"""The suite: problems with ids. An id changes its `-vN` when results on it change."""

from __future__ import annotations

from collections.abc import Callable
from difflib import get_close_matches
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any

from .arrays import shown
from .problem import Problem
from .problem_file import load_problem
from .suite_ids import MODULES, NAMESPACE

_CHANGES = ("initial_state", "initial_low", "initial_high", "disturbance_scale")


def problem_ids() -> tuple[str, ...]:
    """Return the ids of the suite, in alphabetical order.

    Examples
    --------
    >>> "reach-avoid-v0" in problem_ids()
    True
    """
    return tuple(sorted(MODULES))


def make_problem(id: str, **arguments: Any) -> Problem:
    """Return a suite problem.

    Parameters
    ----------
    id : str
        One of `problem_ids()`, with or without the prefix "certigym/".
    **arguments
        Arguments of the problem, such as `horizon` or (where its page says so) `n_agents`; for every problem also
        `initial_state`, or `initial_low` and `initial_high`, and `disturbance_scale`, in the forms that
        `Problem.replace` takes.

    Raises
    ------
    ValueError
        If the id or an argument is unknown, or a value is wrong.

    Examples
    --------
    >>> make_problem("invariance-v0", n_agents=3, horizon=5).n_agents
    3
    """
    key = id.removeprefix(f"{NAMESPACE}/") if isinstance(id, str) else id
    if not isinstance(key, str) or key not in MODULES:
        close = get_close_matches(str(key), MODULES, n=1)
        remedy = f"did you mean {close[0]!r}?" if close else f"known are {', '.join(problem_ids())}"
        raise ValueError(f"`id`: expected the id of a suite problem, got {shown(id)}; {remedy}")
    make: Callable[..., Problem] = import_module(f".{MODULES[key]}", __package__).problem
    changes = {name: arguments.pop(name) for name in _CHANGES if name in arguments}
    known = list(signature(make).parameters)
    for name in arguments:
        if name not in known:
            close = get_close_matches(name, [*known, *_CHANGES], n=1)
            remedy = f"did you mean `{close[0]}`?" if close else f"known are {', '.join([*known, *_CHANGES])}"
            raise ValueError(f"`{name}`: no argument of {key}; {remedy}")
    problem = make(**arguments)
    return problem.replace(**changes) if changes else problem


def resolve(problem: Any, arguments: dict[str, Any]) -> Problem:
    """Return the problem that a Problem, a suite id (with arguments) or the path of a problem file stands for.

    Raises
    ------
    ValueError
        If it is none of them, or arguments come with something else than an id.
    """
    if isinstance(problem, str) and not problem.endswith(".toml"):
        return make_problem(problem, **arguments)
    if isinstance(problem, str | Path):
        problem = load_problem(problem)
    if not isinstance(problem, Problem):
        raise ValueError(f"`problem`: expected a Problem or the id of one, got {type(problem).__name__}")
    for name in arguments:
        raise ValueError(
            f"`{name}`: expected only with a problem id; use `problem.replace`, or correct the name of the option"
        )
    return problem


def environments(id: str) -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]:
    """Return the functions `parallel_env`, `env` and `raw_env` that the module of a suite problem offers.

    Each takes `render_mode` and the arguments of the problem; `env` and `raw_env` give the agent-environment-cycle
    form, with and without PettingZoo's check of the call order.
    """
    from .parallel_env import aec_env
    from .parallel_env import parallel_env as make

    def parallel_env(render_mode: str | None = None, **arguments: Any) -> Any:
        """Return the parallel environment."""
        return make(id, render_mode, **arguments)

    def env(render_mode: str | None = None, **arguments: Any) -> Any:
        """Return the agent-environment-cycle form; calls out of order are refused."""
        return aec_env(id, render_mode, **arguments)

    def raw_env(render_mode: str | None = None, **arguments: Any) -> Any:
        """Return the agent-environment-cycle form without checks."""
        return env(render_mode, **arguments).env

    return parallel_env, env, raw_env


def checked_count(value: Any, argument: str, least: int = 1, most: int = 10_000) -> int:
    """Return a number of agents, or raise ValueError."""
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"`{argument}`: expected an integer from {least} to {most}, got {shown(value)}")
    return value
