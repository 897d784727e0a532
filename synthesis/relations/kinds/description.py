"""Relations in certificates: the few numbers from which everything else about a relation is computed anew.

``{"kind": "exact"}``, ``{"kind": "boxes", "input_set"}`` (with ``"parts"`` where dynamics are expressions),
``{"kind": "linear", "input_set", "parts", "cuts", "reach", "blocks"}``
(with ``"mean_targets"`` where targets are offered beside the menu, and ``"network"`` where networks move agents),
and ``{"kind": "paper", "epsilon", "feedback", "inputs", "delta"}``; matrices
are nested lists. They come from files, and nothing in them is trusted.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....envs.systems.agents import AnyAgent
from ..grids import Grid, linear_agent
from .affine_means import MapRelation, map_relation
from .boxes import BoxRelation, box_relation
from .coupled import COUPLED_NUMBERS, CoupledRelation
from .exact import ExactRelation, aimed_relation
from .inverse_means import SymbolicTargets
from .network_maps import network_linear_relation
from .networks import ON_CELLS, check_network, network_policy
from .scalar import paper_relation

Relation = BoxRelation | ExactRelation | MapRelation | CoupledRelation | SymbolicTargets
"""What ties one agent to its cells."""

GONE = ("tube", "ellipsoid")
"""Kinds of relations of 0.3."""

NUMBER_ENTRIES = {"boxes": (), "exact": (), "linear": ("parts",), "paper": COUPLED_NUMBERS}
"""Entries that are numbers, by kind."""

LARGEST = 1e60
"""Largest number of a description: products of a few such numbers are still numbers."""

ARRAY_ENTRIES = {"boxes": ("menu",), "exact": (), "linear": ("menu",), "paper": ()}
"""Entries that are arrays, by kind."""


MOST_BOXES_OF_A_CELL = 256
"""Most parts of a cell whose means are enclosed one by one."""

MOST_REACH = 10_000
"""Most lattice steps within which largest differences are taken."""

MOST_PARTS = 16
"""Most parts of each side of an image: what a file may ask a check to compute."""


def describe_relation(relation: Relation) -> dict[str, Any]:
    """Return the description of a relation; ``relation_from`` makes the same relation from it (exact)."""
    return relation.describe()


def relation_from(description: dict[str, Any], agent: AnyAgent, grid: Grid) -> Relation:
    """Return the relation of ``agent`` that is described, its margins and delta computed anew (upper bounds).

    Raises
    ------
    ValueError
        If there is no such relation.
    """
    kind = description["kind"]
    if kind == "boxes":
        input_set = np.array(description["menu"], dtype=float)
        return box_relation(agent, input_set, int(description.get("parts", 1)))
    if kind == "linear" and "network" not in description:
        input_set = np.array(description["menu"], dtype=float)
        numbers = (int(description["parts"]), int(description["cuts"]), description["reach"])
        return map_relation(agent, input_set, numbers, "aims" in description)
    if kind == "exact":
        return aimed_relation(agent)
    if kind == "linear":
        policy = network_policy(description["network"], agent)
        return network_linear_relation(agent, policy, int(description["parts"]), description["reach"])
    agent = linear_agent(agent, kind)
    return paper_relation(agent, grid.edges[0], **{name: description[name] for name in NUMBER_ENTRIES["paper"]})


def check_description(description: Any, agent: AnyAgent) -> None:
    """Raise ValueError unless a value describes a relation of ``agent``.

    Raises
    ------
    ValueError
        If the kind is unknown, or if its numbers and arrays are not all there, finite and of the right shape.
    """
    if isinstance(description, dict) and description.get("kind") in GONE:
        raise ValueError(f"relations {description['kind']!r} are gone since 0.4; synthesize anew, relation='linear'")
    if not isinstance(description, dict) or description.get("kind") not in NUMBER_ENTRIES:
        raise ValueError("it has a relation of an unknown kind")
    if np.any(np.array(description.get("gains", 0.0), dtype=float)):
        raise ValueError("boxes have no feedback inside cells since 0.4; synthesize anew, relation='linear'")
    if np.any(np.array(description.get("steer", False), dtype=bool)):
        raise ValueError("boxes have no targets since 0.4; synthesize anew, relation='linear'")
    numbers = [description[name] for name in NUMBER_ENTRIES[description["kind"]]]
    if any(isinstance(x, bool) or not isinstance(x, int | float) or not abs(x) <= LARGEST for x in numbers):
        raise ValueError("a relation has settings that are not numbers")
    is_written = not agent.is_affine
    is_linear = description["kind"] == "linear"
    if "network" in description and not is_linear:
        raise ValueError("networks have linear cells only since 0.4; certify the network anew")
    known = {"boxes": ("parts",), "linear": ("parts", "cuts", "reach"), "exact": () if is_written else None}
    named = known.get(description["kind"])
    if (is_written or is_linear) != (named is not None and all(name in description for name in named)):
        raise ValueError("it has a relation that is not for the dynamics of its agent")
    if is_written and description["kind"] == "exact" and len(description) > 1:
        raise ValueError("it has settings for a relation of exact targets, which has none")
    in_parts = is_linear or (is_written and description["kind"] == "boxes")
    if in_parts and description["parts"] not in range(1, MOST_PARTS + 1):
        raise ValueError(f"a relation reads images in {description['parts']} parts, expected 1 to {MOST_PARTS}")
    if "network" in description:
        check_network(description["network"], agent, len(description["menu"]), ON_CELLS)
    if is_linear:
        _check_maps(description, agent)
        _check_modes(description)
    elif in_parts and description["parts"] ** agent.n_states > MOST_BOXES_OF_A_CELL:
        raise ValueError(f"a relation cuts cells into more than {MOST_BOXES_OF_A_CELL} parts")
    m = agent.n_inputs
    # -1 stands for any length: the number of choices.
    shapes = {"menu": (-1, m)}
    for name in ARRAY_ENTRIES[description["kind"]]:
        array = np.array(description[name], dtype=float)
        expected = tuple(len(array) if n < 0 else n for n in shapes[name]) if array.ndim else ()
        if not array.ndim or array.shape != expected or not array.size or not np.all(np.abs(array) <= LARGEST):
            raise ValueError(f"a relation has settings that are not matrices: `{name}` has shape {array.shape}")


def _check_modes(description: dict[str, Any]) -> None:
    """Raise ValueError if a relation of affine maps has a network, and other choices than its modes."""
    network = description.get("network")
    if network is not None and len(description["menu"]) != network["horizon"] * network["states"]:
        raise ValueError("a relation of maps has other choices than the modes of its network")


def _check_maps(description: dict[str, Any], agent: AnyAgent) -> None:
    """Raise ValueError unless a relation of affine maps says into what cells are cut, and how far differences reach."""
    cuts, reach = description["cuts"], description["reach"]
    if description.get("aims", True) is not True or ("aims" in description and "network" in description):
        raise ValueError("a relation offers targets to a network, or does not say that it offers them")
    if "network" in description and cuts != 1:
        raise ValueError("cells of networks are cut into no parts since 0.4; certify the network anew")
    if type(cuts) is not int or not 1 <= cuts**agent.n_states <= MOST_BOXES_OF_A_CELL:
        raise ValueError(f"a relation cuts cells into more than {MOST_BOXES_OF_A_CELL} parts")
    if not isinstance(reach, list) or len(reach) != agent.n_states:
        raise ValueError("a relation does not say of every axis how far differences reach")
    if any(type(n) is not int or not 0 <= n <= MOST_REACH for n in reach):
        raise ValueError(f"a relation has differences that reach farther than {MOST_REACH} lattice steps")
    blocks = description.get("blocks", reach)
    if not isinstance(blocks, list) or len(blocks) != agent.n_states:
        raise ValueError("a relation does not say of every axis how many lattice points are looked at together")
    if "blocks" in description and any(type(n) is not int or not 1 <= n <= MOST_REACH + 1 for n in blocks):
        raise ValueError(f"a relation looks at more than {MOST_REACH + 1} lattice points together, or at none")
