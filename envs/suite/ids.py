"""The ids of the suite and the modules behind them: a table alone, so that registration loads no problem."""

NAMESPACE = "certigym"
"""Prefix of all ids in the registries of PettingZoo and Gymnasium."""

IDS = (
    "building-automation-v0",
    "car-park-planar-v0",
    "car-park-rough-v0",
    "car-park-v0",
    "car-slalom-v0",
    "corridor-v0",
    "courier-v0",
    "cyclic-delivery-v0",
    "decoupled-chain-14-v0",
    "decoupled-chain-v0",
    "door-formation-v0",
    "dubins-team-v0",
    "fleet-6-v0",
    "fleet-v0",
    "integrator-chain-v0",
    "invariance-20-v0",
    "invariance-4-v0",
    "invariance-b-100-v0",
    "invariance-b-20-v0",
    "invariance-b-50-v0",
    "invariance-v0",
    "meeting-v0",
    "needle-v0",
    "package-delivery-eased-v0",
    "package-delivery-kinematic-v0",
    "package-delivery-single-v0",
    "package-delivery-v0",
    "patrol-recharge-v0",
    "patrol-robot-v0",
    "platoon-distance-v0",
    "platoon-v0",
    "quadrotor-v0",
    "reach-avoid-20-rough-v0",
    "reach-avoid-20-v0",
    "reach-avoid-kinematic-v0",
    "reach-avoid-n-v0",
    "reach-avoid-planar-v0",
    "reach-avoid-v0",
    "rendezvous-3-v0",
    "rendezvous-v0",
    "room-network-v0",
    "swarm-8-v0",
    "swarm-v0",
    "van-der-pol-v0",
    "windy-delivery-v0",
)

MODULES = {id: id.replace("-", "_") for id in IDS}


def gymnasium_id(id: str) -> str:
    """Return the name of a suite problem's centralised environment in Gymnasium.

    Examples
    --------
    >>> gymnasium_id("invariance-b-20-v0")
    'certigym/InvarianceB20-v0'
    """
    *words, version = id.split("-")
    return f"{NAMESPACE}/{''.join(word.capitalize() for word in words)}-{version}"
