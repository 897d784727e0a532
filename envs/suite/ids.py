"""The ids of the suite and what is behind them: tables alone, so that registration loads no problem."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

NAMESPACE = "certigym"
"""Prefix of all ids in the registries of PettingZoo and Gymnasium."""

CENTRAL_ENTRY = "certigym.envs.suite.constructors:central_env"
VECTOR_ENTRY = "certigym.envs.suite.constructors:vector_env"
"""What Gymnasium calls to make an environment, or a batch of them: texts, so that nothing is loaded before."""

ROOMS = {
    "single_agent": (
        "car-park-planar-v0",
        "car-park-v0",
        "car-slalom-v0",
        "courier-v0",
        "integrator-chain-v0",
        "needle-v0",
        "package-delivery-single-v0",
        "patrol-robot-v0",
        "quadrotor-v0",
        "van-der-pol-v0",
    ),
    "multi_agent": (
        "building-automation-v0",
        "corridor-v0",
        "cyclic-delivery-v0",
        "decoupled-chain-v0",
        "door-formation-v0",
        "dubins-team-v0",
        "fleet-v0",
        "invariance-v0",
        "meeting-v0",
        "package-delivery-v0",
        "package-delivery-eased-v0",
        "package-delivery-kinematic-v0",
        "patrol-recharge-v0",
        "platoon-v0",
        "platoon-distance-v0",
        "reach-avoid-v0",
        "reach-avoid-kinematic-v0",
        "reach-avoid-n-v0",
        "reach-avoid-planar-v0",
        "rendezvous-v0",
        "room-network-v0",
        "swarm-v0",
        "windy-delivery-v0",
    ),
}
"""Ids of the problems that have a file, by the room that it is in; the file has the name of its id."""


class Variant(NamedTuple):
    """A problem with an id of its own that is another one with some arguments.

    Parameters
    ----------
    name : str
        What it is called on its page.
    of : str
        Id of the other problem.
    arguments : dict
        Arguments that are given to it; they are no longer asked for.
    about : str
        The same in words.
    usual : dict
        Other values of arguments that may still be given.
    changes : dict
        What is changed of the problem afterwards (see ``Problem.replace``).
    """

    name: str
    of: str
    arguments: dict[str, Any]
    about: str
    usual: Mapping[str, Any] = MappingProxyType({})
    changes: Mapping[str, Any] = MappingProxyType({})


def _of(name: str, of: str, usual: dict[str, Any] | None = None, **arguments: Any) -> Variant:
    """Return a variant that has other arguments."""
    shown = {key: f'"{value}"' if isinstance(value, str) else value for key, value in arguments.items()}
    given = " and ".join(f"`{key}` = {value}" for key, value in shown.items())
    return Variant(name, of, arguments, f"`{of}` with {given}", usual or {})


def _noisier(name: str, of: str, scale: float) -> Variant:
    """Return a variant with more noise."""
    about = f"`{of}` with noise of {scale} times the standard deviation"
    return Variant(name, of, {}, about, changes={"disturbance_scale": scale})


VARIANTS = {
    "car-park-rough-v0": _noisier("Park a car on a rough line", "car-park-v0", 1.5),
    "decoupled-chain-14-v0": _of("Autonomous decoupled chain of 14 agents", "decoupled-chain-v0", n_agents=14),
    "fleet-6-v0": _of("Fleet of six", "fleet-v0", n_agents=6),
    "invariance-20-v0": _of("Invariance of 20 agents", "invariance-v0", n_agents=20),
    "invariance-4-v0": _of("Invariance of 4 agents", "invariance-v0", n_agents=4),
    "invariance-b-100-v0": _of(
        "Invariance of 100 agents in the second setting", "invariance-v0", n_agents=100, setting="B"
    ),
    "invariance-b-20-v0": _of(
        "Invariance of 20 agents in the second setting", "invariance-v0", n_agents=20, setting="B"
    ),
    "invariance-b-50-v0": _of(
        "Invariance of 50 agents in the tighter setting", "invariance-v0", n_agents=50, setting="B"
    ),
    "reach-avoid-20-rough-v0": _noisier("Reach-avoid of twenty on rough ground", "reach-avoid-20-v0", 1.3),
    "reach-avoid-20-v0": _of("Reach-avoid of 20 agents", "reach-avoid-n-v0", n_agents=20),
    "rendezvous-3-v0": _of("Rendezvous of four", "rendezvous-v0", n_followers=3),
    "swarm-8-v0": _of("Swarm of eight", "swarm-v0", {"horizon": 15}, n_agents=8),
}
"""Ids without a file."""

IDS = tuple(sorted([*ROOMS["single_agent"], *ROOMS["multi_agent"], *VARIANTS]))

MODULES = {id: id.replace("-", "_") for id in IDS}
"""Names under which problems can be imported, as in other environment packages."""


def gymnasium_id(id: str) -> str:
    """Return the name of a suite problem's centralised environment in Gymnasium.

    Examples
    --------
    >>> gymnasium_id("invariance-b-20-v0")
    'certigym/InvarianceB20-v0'
    """
    *words, version = id.split("-")
    return f"{NAMESPACE}/{''.join(word.capitalize() for word in words)}-{version}"
