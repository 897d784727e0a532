"""The verbs: put an environment, or a policy, behind the shield of a certificate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...envs.interfaces import CentralEnv, ProblemEnv, ProblemVectorEnv, TasksEnv, TeamEnv
from ...envs.suite import as_problem, parallel_env
from ...envs.systems.arguments import names_arguments
from ...envs.tasks.problem import Problem
from ...synthesis.extended_check.shields import ProductShield, Shield, shield_of
from ...synthesis.interop import as_policy
from .shielded_batches import ShieldedTeamEnv, ShieldedVectorEnv
from .shielded_envs import ShieldedCentralEnv, ShieldedEnv, ShieldedTasksEnv
from .shielded_policy import ShieldedController

ENVIRONMENTS = (ProblemEnv, TasksEnv, CentralEnv, ProblemVectorEnv, TeamEnv)
"""Environments that go behind shields."""


@names_arguments()
def shield(guarded: Any, certificate: Any, *, probability: float | None = None, form: str = "joint") -> Any:
    """Put an environment or a policy behind a shield: every episode succeeds with at least ``probability``.

    The guarantee holds whoever proposes the actions, also while a learner is trained (docs/theory/shields.md, "The
    guarantee"): from the problem's start, and from others at which the certificate's value is large enough.

    Parameters
    ----------
    guarded : environment, Problem, id or path of a problem; or a policy
        An environment of this package, not wrapped by anything else: `parallel_env`, `central_env`, `vector_env` or
        `team_env`. It stays as it is; a new one of the same kind with the same options is returned. A problem gives its
        parallel environment. A policy is anything that ``as_policy`` takes, the path of an actor included, or a
        Synthesis, a certificate or a Training; it becomes one for ``rollout`` and ``compare``.
    certificate : Synthesis, certificate, path of one, Shield or ProductShield
        About the same problem.
    probability : float
        Success probability to keep, at most the certified bound (less rounding, some 1e-10). Not with a shield, which
        has its own.
    form : "joint" or "decentralised"
        Whether the actions of a team are judged together, or each agent's by itself.

    Returns
    -------
    environment or policy
        The infos of an environment say `budget`, `value` and `overridden`.

    Raises
    ------
    ValueError
        If the certificate cannot be a shield, does not fit, or the probability is out of range; if the environment has
        noisy sensors, or is one of another package.

    Examples
    --------
    >>> import certigym as cg
    >>> problem = cg.make_problem("reach-avoid-v0", horizon=5)
    >>> certificate = cg.synthesize(problem, 60, relation="exact").certificate
    >>> env = cg.shield(problem, certificate, probability=0.7)
    >>> observations, infos = env.reset(seed=0)
    >>> bool(0.0 < infos["agent_0"]["budget"] <= infos["agent_0"]["value"])
    True
    """
    if isinstance(guarded, Problem) or _names_problem(guarded):
        guarded = parallel_env(as_problem(guarded))
    if isinstance(guarded, ENVIRONMENTS):
        return _environment(guarded, certificate, probability, form)
    if hasattr(guarded, "reset") and hasattr(guarded, "step"):
        raise ValueError(
            f"`guarded`: expected a problem, a policy or an environment of certigym, got {type(guarded).__name__}; "
            "shield the environment first, then wrap it"
        )
    made = _made(None, certificate, probability, form)
    return ShieldedController(as_policy(guarded, made.problem), made)


def _names_problem(guarded: Any) -> bool:
    """Whether something names a problem: an id, or the path of a problem file; others are paths of actors."""
    if not isinstance(guarded, str) and not hasattr(guarded, "__fspath__"):
        return False
    path = Path(guarded)
    return path.suffix == ".toml" or not (path.suffix or path.exists())


def _environment(env: Any, certificate: Any, probability: float | None, form: str) -> Any:
    """Return an environment of the same kind behind a shield."""
    if np.any(env.options.get("sensor_noise", 0.0)):
        raise ValueError(
            "`guarded`: expected exact sensors, got `sensor_noise`; the certificate is about controllers that see the "
            "true states"
        )
    made = _made(env.problem, certificate, probability, form)
    if isinstance(made, ProductShield):
        assert isinstance(env, TasksEnv)  # independent tasks have no other environment
        return ShieldedTasksEnv(env.problem, made, env.render_mode, **env.options)
    if isinstance(env, ProblemVectorEnv):
        return ShieldedVectorEnv(env.problem, made, env.num_envs, env.render_mode, **env.options)
    if isinstance(env, TeamEnv):
        return ShieldedTeamEnv(env.problem, made, env.num_envs, **env.options)
    if isinstance(env, CentralEnv):
        return ShieldedCentralEnv(env.problem, made, env.render_mode, **env.options)
    return ShieldedEnv(env.problem, made, env.render_mode, **env.options)


def _made(problem: Problem | None, certificate: Any, probability: float | None, form: str) -> Shield | ProductShield:
    """Return the shield that is asked for; raise ValueError unless it is one of the problem."""
    made = certificate
    if not isinstance(made, Shield | ProductShield):
        if probability is None:
            raise ValueError("`probability`: expected the success probability to keep, got none")
        made = shield_of(certificate, probability, form)
    elif probability is not None and probability != made.probability:
        raise ValueError(f"`probability`: expected none with a shield that keeps {made.probability:.6g}")
    if problem is not None and made.problem.fingerprint != problem.fingerprint:
        raise ValueError(
            f"`certificate`: expected one of {problem.name!r}, got one about another problem "
            f"({made.problem.name!r}, or another start or horizon)"
        )
    return made
