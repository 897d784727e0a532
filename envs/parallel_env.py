"""PettingZoo environments by the name, the file or the record of a problem: `parallel_env` and `aec_env`.

A problem with one task becomes a `ProblemEnv`, one that falls apart into independent tasks a `TasksEnv`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pettingzoo import AECEnv
from pettingzoo.utils.conversions import parallel_to_aec

from .problem import Problem
from .problem_env import ProblemEnv
from .suite import resolve
from .tasks_env import TasksEnv


def parallel_env(
    problem: Problem | str | Path, render_mode: str | None = None, **arguments: Any
) -> ProblemEnv | TasksEnv:
    """Return the PettingZoo parallel environment of a problem, of all tasks together if it falls apart (`TasksEnv`).

    Parameters
    ----------
    problem : Problem, str or Path
        A problem, the id of a suite problem, or the path of a problem file (`.toml`).
    render_mode : None, "ansi", "rgb_array" or "human"
    **arguments
        Options of `ProblemEnv`; with an id also the arguments of `make_problem`.

    Examples
    --------
    >>> env = parallel_env("reach-avoid-v0", horizon=7)
    >>> observations, infos = env.reset(seed=0)
    >>> env.agents
    ['agent_0', 'agent_1']
    """
    options = {name: arguments.pop(name) for name in OPTIONS if name in arguments}
    resolved = resolve(problem, arguments)
    if resolved.groups:
        return TasksEnv(resolved, render_mode, **options)
    return ProblemEnv(resolved, render_mode, **options)


OPTIONS = ("observation", "reward", "discount", "dtype", "actions", "caption")
"""Arguments of `parallel_env` that say how a problem is shown, not which."""


def aec_env(problem: Problem | str | Path, render_mode: str | None = None, **arguments: Any) -> AECEnv:  # type: ignore[type-arg, unused-ignore]
    """Return the PettingZoo agent-environment-cycle form of `parallel_env` (same arguments)."""
    return parallel_to_aec(parallel_env(problem, render_mode, **arguments))
