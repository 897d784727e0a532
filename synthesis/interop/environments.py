"""Which environment a model was trained in: as somebody says, or by the sizes and ranges of what it observes."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from ...envs.interfaces import AUTOMATON, SCALES, SCOPES
from ...envs.tasks.problem import Problem
from .detected import Detected
from .observation_maps import ObservationMap

SCOPES_OF = {"local": "own", "full": "full", "relative": "relative", "neighbours": "neighbours"}
TEAM_SCOPES = {"own": "own", "joint": "joint", "neighbours": "neighbours"}

WORLDS = {
    "shared_vec_env": ObservationMap("shared_vec_env", "own", "unit", actions="unit", padded=True, told=True,
                            spaces_are_unit=True),
    "central_vec_env": ObservationMap("central_vec_env", "joint", "unit", actions="unit", central=True,
                            spaces_are_unit=True),
}  # fmt: skip
"""What the worlds for Stable-Baselines3 show; they have no options that matter here."""

DEFAULTS = {
    "parallel_env": {"observation": "local", "scale": "raw", "automaton": "one-hot", "actions": "input"},
    "aec_env": {"observation": "local", "scale": "raw", "automaton": "one-hot", "actions": "input"},
    "team_env": {"observation": "own", "scale": "unit", "automaton": "one-hot", "actions": "unit"},
    "central_env": {"scale": "raw", "automaton": "one-hot", "actions": "unit"},
    "vector_env": {"scale": "raw", "automaton": "one-hot", "actions": "unit"},
    "rows": {"scale": "unit", "actions": "unit"},
}
"""Options of the makers of environments that decide what is seen, and their defaults; ``rows`` are those of networks
that this package has written (`relations.networks`)."""

IGNORED = ("neighbours", "sensor_noise", "reward", "discount", "dtype", "infos", "caption", "disturbance", "spread",
           "autoreset_mode")  # fmt: skip
"""Options that change nothing in what is seen, or in how it is told."""

MAKERS = {
    "ProblemEnv": "parallel_env",
    "ShieldedEnv": "parallel_env",
    "TeamEnv": "team_env",
    "ShieldedTeamEnv": "team_env",
    "CentralEnv": "central_env",
    "ShieldedCentralEnv": "central_env",
    "ProblemVectorEnv": "vector_env",
    "ShieldedVectorEnv": "vector_env",
}
"""Makers by the names of the classes of what they make."""


def sight_of(env: Any) -> ObservationMap:
    """Return what an environment shows to a model.

    Parameters
    ----------
    env : environment, Sight or str
        An environment of this package, wrapped or not; or how it is made, such as ``"team_env"`` or
        ``"parallel_env(scale='unit', actions='unit')"``, the names without quotes if you like.

    Raises
    ------
    ValueError
        If it is none of these.

    Examples
    --------
    >>> sight_of("central_env(scale=unit)").scope
    'joint'
    """
    if isinstance(env, ObservationMap):
        return env
    if isinstance(env, str):
        return _named(env)
    view = getattr(env, "view", None)  # of worlds for Stable-Baselines3, and of their wrappers
    if view is not None and hasattr(view, "rows"):
        return WORLDS["central_vec_env" if view.rows == 1 and not hasattr(view, "width") else "shared_vec_env"]
    inner = getattr(env, "unwrapped", env)
    for kind in type(inner).__mro__:
        if kind.__name__ in MAKERS and hasattr(inner, "options"):
            return _made(MAKERS[kind.__name__], {k: v for k, v in inner.options.items() if v is not None})
    raise ValueError(
        f"`env`: expected an environment of certigym, or how it is made, such as "
        f"\"parallel_env(actions='unit')\", got {type(env).__name__}"
    )


def _named(text: str) -> ObservationMap:
    """Return the sight of a text such as ``team_env(scale='raw')``."""
    name, _, rest = text.strip().partition("(")
    name, options = name.strip(), {}
    for pair in re.split("[,;]", rest.rstrip(") ")):  # commas separate policies on the command line
        if pair.strip():
            key, _, value = (part.strip() for part in pair.partition("="))
            options[key] = value.strip("'\"")
    if name not in DEFAULTS and name not in WORLDS:
        raise ValueError(f"`env`: expected {', '.join([*DEFAULTS, *WORLDS])} with options, got {text!r}")
    return _made(name, options)


def _made(maker: str, given: dict[str, Any]) -> ObservationMap:
    """Return what an environment shows that is made in this way."""
    if maker in WORLDS:
        return WORLDS[maker]
    defaults, options = DEFAULTS[maker], dict(DEFAULTS[maker])
    options |= {name: str(given[name]) for name in defaults if name in given}
    scopes = TEAM_SCOPES if maker == "team_env" else SCOPES_OF if "observation" in defaults else {}
    known = {"observation": tuple(scopes), "scale": SCALES, "automaton": AUTOMATON, "actions": ("unit", "input")}
    for name, value in options.items():
        if value not in known[name]:
            raise ValueError(f"`env`: expected {name} {' or '.join(map(repr, known[name]))}, got {value!r}")
    strange = sorted(set(given) - set(defaults) - set(IGNORED))
    if strange:
        raise ValueError(f"`env`: expected the options {', '.join(defaults)} of {maker}, got {strange[0]!r}")
    differing = [f"{name}={value!r}" for name, value in options.items() if value != defaults[name]]
    if maker == "rows":
        name = f"rows(scale={options['scale']!r}, actions={options['actions']!r})"
        return ObservationMap(name, "own", options["scale"], actions=options["actions"], padded=True, told=True)
    count = given.get("neighbours")
    observation_map = ObservationMap(
        f"{maker}({', '.join(differing)})" if differing else maker,
        scopes.get(options.get("observation", ""), "joint"),
        options["scale"],
        options["automaton"],
        options["actions"],
        central=not scopes,
    )
    return observation_map if count is None else replace(observation_map, neighbours=int(ast.literal_eval(str(count))))


def known_sights() -> Iterator[ObservationMap]:
    """Yield what models may have been trained with, the most usual first: each thing that can be seen once."""
    yield from WORLDS.values()
    for automaton, actions, scale in product(AUTOMATON, ("unit", "input"), SCALES):
        shared = {"automaton": automaton, "actions": actions, "scale": scale}
        yield from (_made("parallel_env", {"observation": scope, **shared}) for scope in SCOPES)
        yield _made("central_env", shared)
        yield _made("team_env", {"observation": "joint", **shared})


def matched(problem: Problem, found: Detected, env: Any, agents: Sequence[int]) -> ObservationMap:
    """Return what a model was trained to see that moves these agents.

    Raises
    ------
    ValueError
        If no environment shows so many numbers in these ranges, or if several do that differ in what they show.
    """
    if env is not None:
        observation_map = sight_of(env)
        if not _fits(problem, found, observation_map, agents, spaces=False):
            raise ValueError(_no_fit(problem, found, [observation_map], agents))
        return observation_map
    fitting = [
        observation_map
        for observation_map in known_sights()
        if _fits(problem, found, observation_map, agents, spaces=True)
    ]
    if not fitting:
        raise ValueError(_no_fit(problem, found, list(known_sights()), agents))
    told = list(
        {_meaning(problem, observation_map): observation_map for observation_map in reversed(fitting)}.values()
    )[::-1]
    if len(told) > 1:
        shown = ", ".join(observation_map.maker for observation_map in told[:6]) + (", ..." if len(told) > 6 else "")
        raise ValueError(
            f"`env`: expected the environment in which the model was trained, got none: {found.name} with "
            f"{_sizes(found)} may be of {shown}; give it, as in `as_policy(model, problem, env=env)` or "
            f'`env="{told[0].maker}"`'
        )
    return told[0]


def _meaning(problem: Problem, observation_map: ObservationMap) -> tuple[Any, ...]:
    """Return what tells sights apart on a problem: rows and answers, however the environment is called."""
    first = observation_map.space(problem, 0)
    unit = all(np.array_equal(a.input_low, -np.ones(a.n_inputs)) and np.array_equal(a.input_high, np.ones(a.n_inputs))
               for a in problem.agents)  # fmt: skip
    scope = "own" if problem.n_agents == 1 else observation_map.scope
    automaton = observation_map.automaton if len(first[0]) else ""
    return (
        scope,
        observation_map.scale,
        automaton,
        observation_map.told,
        observation_map.central and problem.n_agents > 1,
        unit or observation_map.actions,
    )


def _fits(
    problem: Problem, found: Detected, observation_map: ObservationMap, agents: Sequence[int], spaces: bool
) -> bool:
    """Whether a model observes and answers with as many numbers as an environment has, in its ranges if asked."""
    asked = agents[:1] if observation_map.central else agents
    # Agents with fewer numbers may have been filled up to the largest one.
    if found.observed not in (None, max(observation_map.size(problem, i) for i in asked)):
        return False
    if found.answered not in (None, max(observation_map.n_actions(problem, i) for i in asked)):
        return False
    return _actions_fit(problem, found, observation_map, asked) and (
        not spaces or _spaces_fit(problem, found, observation_map, asked)
    )


def _spaces_fit(problem: Problem, found: Detected, observation_map: ObservationMap, agents: Sequence[int]) -> bool:
    """Whether the space of observations, where the library keeps it, is that of an environment."""
    if found.space is None:
        return True
    for i in agents:
        low, high = observation_map.space(problem, i)
        n = len(low)
        if not (np.array_equal(found.space[0][:n], low.astype(found.space[0].dtype)) and
                np.array_equal(found.space[1][:n], high.astype(found.space[1].dtype))):  # fmt: skip
            return False
    return True


def _actions_fit(problem: Problem, found: Detected, observation_map: ObservationMap, agents: Sequence[int]) -> bool:
    """Whether the space of actions, where the library keeps it, is that of an environment."""
    if found.action_space is None:
        return True
    low, high = (np.asarray(end, dtype=float) for end in found.action_space)
    if observation_map.actions == "unit":
        return bool(np.all(low == -1.0) and np.all(high == 1.0))
    moved = [problem.agents[i] for i in agents]
    own = [(a.input_low, a.input_high) for a in moved]
    if observation_map.central:
        team = problem.agents
        own = [(np.concatenate([a.input_low for a in team]), np.concatenate([a.input_high for a in team]))]
    return all(np.allclose(low[: len(a)], a) and np.allclose(high[: len(b)], b) for a, b in own)


def _sizes(found: Detected) -> str:
    """Return how many numbers a model observes and answers with, in words."""
    seen = "any number of" if found.observed is None else str(found.observed)
    answered = "any number of" if found.answered is None else str(found.answered)
    return f"{seen} observed numbers and {answered} actions"


def _no_fit(problem: Problem, found: Detected, observation_maps: list[ObservationMap], agents: Sequence[int]) -> str:
    """Return the message about a model that fits no environment of the problem: the sizes that are known."""
    sizes: dict[tuple[int, int], str] = {}
    for observation_map in observation_maps:
        asked = agents[:1] if observation_map.central else agents
        key = (
            max(observation_map.size(problem, i) for i in asked),
            max(observation_map.n_actions(problem, i) for i in asked),
        )
        sizes.setdefault(key, observation_map.maker)
    listed = ", ".join(f"{seen} and {done} ({maker})" for (seen, done), maker in sorted(sizes.items()))
    hint = ""
    if any(_fits(problem, found, observation_map, agents, spaces=False) for observation_map in observation_maps):
        hint = "; the sizes are known, but the ranges of its observations are not: give `env=` if they were changed"
    return (
        f"`model`: expected the observed numbers and actions of an environment of {problem.name!r}, got {found.name} "
        f"with {_sizes(found)}{hint}; known are {listed}"
    )
