"""Noise that several agents share: one wind for all.

A *source* is one standard normal number per step, independent of everything else, that is added to states of several
agents, each with a factor of its own:

    x_i' = f_i(x_i, u_i, t) + w_i + sum over sources k of v_ik e_k,      e_k ~ N(0, 1).

Here v_ik is a vector (d_i,) in units of the states: the standard deviation that the source causes in each of them, with
a sign. What an agent feels by itself is again normal, with covariance ``Q_i + sum_k v_ik v_ik'``; agents of one source
are not independent, so that no product over agents is a bound.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...systems.agents import AnyAgent, checked_name
from ...systems.arguments import float_array, read_only, shown

MOST_SOURCES = 64
"""Most sources of one problem."""

LEAST_FACTOR = 1e-100
"""Least size of a factor that is not 0: squares of smaller ones are 0 in floating point."""

Sources = Mapping[str, Mapping[str, Any]]
"""By name of the source and of an agent, or a pattern with one `*`: its factors, by names of states or one for each."""

JOINT_NOISE_REFUSAL = (
    "`joint_noise`: expected agents whose noise is independent, got some that share a source; certificates on grids "
    "multiply over agents: ask for the relation `path`"
)
"""What is said where products over agents are formed."""


def checked_sources(value: Any, agents: Sequence[AnyAgent]) -> tuple[dict[str, dict[str, Any]], tuple[np.ndarray, ...]]:
    """Return the sources as they were declared (plain values), and the factors (d, K) of each agent.

    Parameters
    ----------
    value : mapping, or None
        ``{"wind": {"drone_*": {"x": 0.03}, "kite": [0.0, 0.05]}}``.
    agents : sequence of AnyAgent

    Raises
    ------
    ValueError
        If an agent or state is not known, a number is none, or an agent has noise that is not normal, or is scaled.
    """
    if value is None:
        value = {}
    if not isinstance(value, Mapping) or len(value) > MOST_SOURCES:
        raise ValueError(
            "`joint_noise`: expected a table of at most "
            f'{MOST_SOURCES} sources such as wind = {{ "drone_*" = {{ x = 0.03 }} }}, got {shown(value)}'
        )
    declared: dict[str, dict[str, Any]] = {}
    factors = [np.zeros((agent.n_states, len(value))) for agent in agents]
    for k, (name, members) in enumerate(value.items()):
        where = f"joint_noise.{checked_name(name, 'joint_noise')}"
        if not isinstance(members, Mapping) or not members:
            raise ValueError(f"`{where}`: expected factors by agents, got {shown(members)}")
        declared[name] = {}
        for pattern, given in members.items():
            here = _members(pattern, agents, where)
            for i in here:
                if np.any(factors[i][:, k]):
                    raise ValueError(f"`{where}`: expected one entry for agent {agents[i].name!r}, got two")
                factors[i][:, k] = _factors(given, agents[i], f"{where}.{pattern}")
            declared[name][pattern] = _plain(given)
    for agent, own in zip(agents, factors, strict=True):
        if np.any(own) and agent.laws is not None:
            raise ValueError(
                f"`joint_noise`: expected agents with normal noise that nothing multiplies, got {agent.name!r} with "
                f"{', '.join(dict.fromkeys(law.name for law in agent.laws))} noise; give it `noise_covariance`"
            )
    return declared, tuple(read_only(own) for own in factors)


def refuse_joint_noise(problem: Any) -> None:
    """Raise ValueError if agents of a problem share noise; for whoever takes them for independent."""
    if problem.joint_noise:
        raise ValueError(JOINT_NOISE_REFUSAL)


def with_sources(agent: AnyAgent, own: np.ndarray, factors: np.ndarray) -> AnyAgent:
    """Return an agent with all the noise that it feels: its own covariance (d, d), and that of its factors (d, K).

    The covariance is above the exact one, by some units in the last place of its variances.
    """
    if not np.any(factors):
        return agent
    total = own + factors @ factors.T
    total = 0.5 * (total + total.T)
    # An entry is a sum of K + 1 products; what it rounds by is below a share of the deviations of its row and column.
    d, count = factors.shape
    spare = 8.0 * d * (count + 4.0) * np.finfo(float).eps
    return agent.replace(noise_covariance=total + np.diag(spare * np.diag(total)))


def scaled_sources(declared: Sources, factor: float) -> dict[str, dict[str, Any]]:
    """Return sources with all factors multiplied."""

    def scaled(given: Any) -> Any:
        if isinstance(given, Mapping):
            return {key: factor * number for key, number in given.items()}
        return [factor * number for number in given]

    return {name: {key: scaled(given) for key, given in members.items()} for name, members in declared.items()}


def _members(pattern: Any, agents: Sequence[AnyAgent], where: str) -> list[int]:
    """Return the numbers of the agents that a name, or a pattern with one `*`, stands for."""
    text = pattern if isinstance(pattern, str) and pattern.count("*") <= 1 else ""
    expression = re.compile("[A-Za-z0-9_]*".join(map(re.escape, text.split("*"))))
    found = [i for i, agent in enumerate(agents) if text and expression.fullmatch(agent.name)]
    if not found:
        names = ", ".join(agent.name for agent in agents[:8])
        raise ValueError(f"`{where}`: expected agents among {names}, or a pattern with one `*`, got {shown(pattern)}")
    return found


def _factors(given: Any, agent: AnyAgent, where: str) -> np.ndarray:
    """Return the factors (d,) of one agent."""
    d = agent.n_states
    if isinstance(given, Mapping):
        if not agent.state_names:
            raise ValueError(f"`{where}`: expected a list of {d} factors, as states of {agent.name!r} have no names")
        for key in given:
            if key not in agent.state_names:
                raise ValueError(f"`{where}`: expected states among {', '.join(agent.state_names)}, got {shown(key)}")
        given = [given.get(name, 0.0) for name in agent.state_names]
    result = float_array(given, where, (d,), f"{[0.05] * min(d, 4)}")
    sizes = np.abs(result[result != 0.0])
    if np.any((sizes < LEAST_FACTOR) | (sizes > 1.0 / LEAST_FACTOR)):
        raise ValueError(f"`{where}`: expected 0 or sizes from {LEAST_FACTOR:g} to {1 / LEAST_FACTOR:g}, got {given}")
    return result


def _plain(given: Any) -> Any:
    """Return factors as plain values."""
    if isinstance(given, Mapping):
        return {key: float(number) for key, number in given.items()}
    return [float(number) for number in np.asarray(given, dtype=float)]
