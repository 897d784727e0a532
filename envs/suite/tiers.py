"""Tiers of the suite: what is left to learn on each problem.

*solved*: a learner without help comes as far as is known to be possible; *open*: it gets somewhere, but not there;
*hard*: less than half of the way; *unrated*: no learner was judged. The rule is in `validation.policies.tier_rule`, the
numbers are those of docs/leaderboard.json. Written by `python docs/rate_problems.py`; not by hand.
"""

from __future__ import annotations

NAMES = ("solved", "open", "hard", "unrated")

TIERS: dict[str, str] = {
    "building-automation-v0": "solved",
    "car-park-planar-v0": "solved",
    "car-park-rough-v0": "open",
    "car-park-v0": "open",
    "car-slalom-v0": "solved",
    "corridor-v0": "hard",
    "courier-v0": "solved",
    "cyclic-delivery-v0": "solved",
    "decoupled-chain-14-v0": "solved",
    "decoupled-chain-v0": "solved",
    "door-formation-v0": "solved",
    "dubins-team-v0": "solved",
    "fleet-6-v0": "solved",
    "fleet-v0": "hard",
    "integrator-chain-v0": "solved",
    "invariance-20-v0": "solved",
    "invariance-4-v0": "solved",
    "invariance-b-100-v0": "solved",
    "invariance-b-20-v0": "solved",
    "invariance-b-50-v0": "solved",
    "invariance-v0": "solved",
    "meeting-v0": "solved",
    "needle-v0": "hard",
    "package-delivery-eased-v0": "hard",
    "package-delivery-kinematic-v0": "hard",
    "package-delivery-single-v0": "solved",
    "package-delivery-v0": "hard",
    "patrol-recharge-v0": "open",
    "patrol-robot-v0": "solved",
    "platoon-distance-v0": "solved",
    "platoon-v0": "solved",
    "quadrotor-v0": "solved",
    "reach-avoid-20-rough-v0": "solved",
    "reach-avoid-20-v0": "solved",
    "reach-avoid-kinematic-v0": "solved",
    "reach-avoid-n-v0": "solved",
    "reach-avoid-planar-v0": "open",
    "reach-avoid-v0": "solved",
    "rendezvous-3-v0": "open",
    "rendezvous-v0": "solved",
    "room-network-v0": "solved",
    "swarm-8-v0": "hard",
    "swarm-v0": "solved",
    "van-der-pol-v0": "open",
    "windy-delivery-v0": "solved",
}
