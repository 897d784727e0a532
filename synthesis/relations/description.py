"""Relations in certificates: the few numbers from which everything else about a relation is computed anew.

``{"kind": "exact"}``, ``{"kind": "paper", "epsilon", "feedback", "inputs", "delta"}``, ``{"kind": "tube", "feedback",
"inputs", "snap"}`` and ``{"kind": "ellipsoid", "shape", "epsilon", "feedback", "coupling", "inputs", "snap",
"delta"}``; matrices are nested lists in grid coordinates. They come from files and are trusted in nothing.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...envs.agents import LinearAgent
from ..cells import FloatArray, Grid
from .coupled import CoupledRelation
from .ellipsoid import Ellipsoid, ellipsoid_relation
from .exact import ExactRelation, exact_relation
from .scalar import paper_relation
from .tube import tube_relation

Relation = ExactRelation | CoupledRelation
"""What ties one agent to its cells."""

NUMBERS = {
    "exact": (),
    "paper": ("epsilon", "feedback", "inputs", "delta"),
    "tube": (),
    "ellipsoid": ("epsilon", "delta"),
}
"""Entries that are numbers, by kind."""

ARRAYS = {
    "exact": (),
    "paper": (),
    "tube": ("feedback", "inputs", "snap"),
    "ellipsoid": ("shape", "feedback", "coupling", "inputs", "snap"),
}
"""Entries that are arrays, by kind."""


def describe_relation(relation: Relation) -> dict[str, Any]:
    """Description of a relation; ``relation_from`` gives the same relation again."""
    if not isinstance(relation, CoupledRelation):
        return {"kind": "exact"}
    if relation.kind == "paper":
        return {"kind": "paper", "epsilon": float(relation.reach[0]), "feedback": float(relation.feedback[0, 0]),
                "inputs": len(relation.inputs), "delta": relation.delta}  # fmt: skip
    found = {"kind": relation.kind, **{name: getattr(relation, name).tolist() for name in ARRAYS[relation.kind]}}
    return {**found, **{name: getattr(relation, name) for name in NUMBERS[relation.kind]}}


def relation_from(description: dict[str, Any], agent: LinearAgent, grid: Grid, coordinates: FloatArray) -> Relation:
    """The relation of ``agent`` that is described, its margins and delta computed anew.

    Raises
    ------
    ValueError
        If there is no such relation.
    """
    kind = description["kind"]
    if kind == "exact":
        return exact_relation(agent, coordinates)
    if kind == "paper":
        if not np.array_equal(coordinates, np.eye(len(coordinates))):
            raise ValueError("the `paper` relation is for grids in state coordinates")
        return paper_relation(agent, grid.edges[0], **{name: description[name] for name in NUMBERS["paper"]})
    given = {name: np.array(description[name], dtype=float) for name in ARRAYS[kind]}
    if kind == "tube":
        return tube_relation(agent, grid, coordinates, given["feedback"], given["inputs"], given["snap"])
    found = Ellipsoid(given["shape"], description["epsilon"], given["feedback"], given["coupling"])
    return ellipsoid_relation(agent, grid, coordinates, found, given["inputs"], given["snap"], description["delta"])


def check_description(description: Any, agent: LinearAgent) -> None:
    """Refuse what is no description of a relation of ``agent``.

    Raises
    ------
    ValueError
        If the kind is unknown, or its numbers and arrays are not all there, finite and of the right shape.
    """
    if not isinstance(description, dict) or description.get("kind") not in NUMBERS:
        raise ValueError("it has a relation of an unknown kind")
    numbers = [description[name] for name in NUMBERS[description["kind"]]]
    if any(isinstance(x, bool) or not isinstance(x, int | float) or not math.isfinite(x) for x in numbers):
        raise ValueError("a relation has settings that are no numbers")
    d, m = agent.n_states, agent.n_inputs
    shapes = {"shape": (d, d), "feedback": (m, d), "coupling": (d, d), "inputs": (-1, m), "snap": (d,)}
    for name in ARRAYS[description["kind"]]:
        array = np.array(description[name], dtype=float)
        expected = tuple(len(array) if n < 0 else n for n in shapes[name]) if array.ndim else ()
        if array.shape != expected or not array.size or not np.all(np.isfinite(array)):
            raise ValueError(f"a relation has settings that are no matrices: `{name}` has shape {array.shape}")
