"""The verbs: put an environment, or a policy, behind the shield of a certificate."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...envs.interfaces import CentralEnv, ProblemEnv, ProblemVectorEnv, TasksEnv, TeamEnv
from ...envs.problem import Problem
from ...envs.suite import as_problem, parallel_env
from ...synthesis.bridges import as_policy
from ...synthesis.shielding import ProductShield, Shield, shield_of
from .shielded_batches import ShieldedTeamEnv, ShieldedVectorEnv
from .shielded_envs import ShieldedCentralEnv, ShieldedEnv, ShieldedTasksEnv
from .shielded_policy import ShieldedController


def shield(env_or_problem: Any, certificate: Any, *, probability: float | None = None, form: str = "joint") -> Any:
    """Return an environment in which every episode succeeds with a probability of at least ``probability``.

    The guarantee holds whoever proposes the actions, also while a learner is trained (docs/theory/shields.md, "The
    guarantee"): from the problem's start, and from others at which the certificate's value is large enough.

    Parameters
    ----------
    env_or_problem : environment, Problem, id or path
        An environment of this package, not wrapped by anything else: `parallel_env`, `central_env`, `vector_env` or
        `team_env`. It stays as it is; a new one of the same kind with the same options is returned. A problem gives its
        parallel environment.
    certificate : Synthesis, certificate, path of one, Shield or ProductShield
        About the same problem.
    probability : float
        Success probability to keep, at most the certified bound (less rounding, some 1e-10). Not with a shield, which
        has its own.
    form : "joint" or "decentralised"
        Whether the actions of a team are judged together, or each agent's by itself.

    Returns
    -------
    environment
        Its infos say `budget`, `value` and `overridden`.

    Raises
    ------
    ValueError
        If the certificate cannot be a shield, does not fit, or the probability is out of range; if the environment has
        noisy sensors.

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
    env = env_or_problem
    known = (ProblemEnv, TasksEnv, CentralEnv, ProblemVectorEnv, TeamEnv)
    if not isinstance(env, (*known, Problem, str)) and not hasattr(env, "__fspath__"):
        raise ValueError(
            f"`env_or_problem`: expected a problem or an environment of certigym, got {type(env).__name__}; shield the "
            "environment first, then wrap it"
        )
    if not isinstance(env, known):
        env = parallel_env(as_problem(env))
    if np.any(env.options.get("sensor_noise", 0.0)):
        raise ValueError(
            "`env_or_problem`: expected exact sensors, got `sensor_noise`; the certificate is about controllers that "
            "see the true states"
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


def shielded(policy: Any, certificate: Any, *, probability: float | None = None, form: str = "joint") -> Any:
    """Return a policy behind a shield, for ``rollout`` and ``compare``.

    Parameters
    ----------
    policy : object with ``batch(dynamics)``, Synthesis, certificate, Training, or what ``as_policy`` takes
    certificate, probability, form
        As for ``shield``.

    Raises
    ------
    ValueError
        As for ``shield``.
    """
    made = _made(None, certificate, probability, form)
    return ShieldedController(as_policy(policy, made.problem), made)


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
