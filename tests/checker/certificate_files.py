"""Certificate files made by hand, for tests of the checker: nothing of the package writes them."""

from __future__ import annotations

import copy
import json
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

STEPS = 4


def two_carts() -> tuple[dict[str, Any], list[np.ndarray]]:
    """Header and arrays: two carts on a line that reach their goals, keep off a rock, and never come near each other.

    One cart moves by ``x + u + .05 sin(x)``, the other one by ``x + u + push``, where the push is known up to .01.
    About one run in 23 misses a goal at the end.
    """

    def cart(name: str, start: float, drift: str) -> dict[str, Any]:
        return {
            "name": name,
            "states": ["x"],
            "inputs": ["u"],
            "dynamics": [drift],
            "outputs": ["x"],
            "state_low": [-10.0],
            "state_high": [10.0],
            "input_low": [-2.0],
            "input_high": [2.0],
            "start_low": [start],
            "start_high": [start],
            "noise": [[0.1]],
            "shared_noise": [[0.02]],
        }

    agents = [cart("left", -4.0, "x + u + 0.05*sin(x)"), cart("right", 4.0, "x + u + push")]
    agents[1]["disturbances"] = {"push": [-0.01, 0.01]}
    automaton = {  # of "!rock & !near U goals", propositions goal_0, goal_1, rock, near
        "initial": 0,
        "accepting": [False, True, False],
        "root": [0, -2, -3],
        "variable": [0, 1, 2, 3],
        "low": [2, 2, 3, -1],
        "high": [1, -2, -3, -3],
    }
    problem = {
        "horizon": STEPS,
        "agents": agents,
        "regions": [
            {"name": "goal_0", "agent": 0, "low": [-1.1], "high": [-0.6]},
            {"name": "goal_1", "agent": 1, "low": [0.5], "high": [1.1]},
            {"name": "rock", "agent": 0, "low": [5.0], "high": [None]},
        ],
        "pairs": [{"name": "near", "agents": [0, 1], "outputs": [[0], [0]], "radius": 0.5}],
        "task": {
            "formula": "!(rock | near) U (goal_0 & goal_1)",
            "semantics": "co-safe",
            "automaton": automaton,
        },
    }
    left, right = [-4.0], [4.0]
    inputs = np.array([[0.8], [0.8], [0.8], [0.8]])
    for u in inputs[:, 0]:
        left.append(left[-1] + u + 0.05 * np.sin(left[-1]))
        right.append(right[-1] - u)
    letters = np.zeros((STEPS + 1, 4), np.int8)
    letters[1:, 2:], letters[-1, :2] = -1, 1
    faces = np.full((STEPS + 1, 4), -1, np.int32)
    faces[1:, 2] = 0
    normals = np.full((STEPS + 1, 1), -1.0)
    gains, widths = np.full((STEPS, 1, 1), -0.5), np.full((STEPS + 1, 2), np.inf)
    widths[:, 0] = 0.5
    arrays: list[np.ndarray] = [
        letters,
        faces,
        normals,
        inputs,
        gains,
        np.array(left)[:, None],
        widths,
        -inputs,
        np.array(right)[:, None],
    ]
    entry = {
        "kind": "trajectory",
        "letters": 0,
        "faces": 1,
        "normals": 2,
        "agents": [
            {"inputs": 3, "gains": 4, "states": 5, "widths": 6},
            {"inputs": 7, "gains": 4, "states": 8, "widths": 6},
        ],
    }
    header: dict[str, Any] = {
        "format": "certigym-certificate",
        "version": 3,
        "name": "two carts",
        "problem": problem,
        "claim": {"failure": 0.1},
        "proof": entry,
    }
    return header, arrays


def two_tanks() -> tuple[dict[str, Any], list[np.ndarray]]:
    """Header and arrays of a proof on cells: two tanks that fill within two steps, one of them never beyond a mark.

    The first tank chooses targets, ``x' = x/2 + u``, with values that are constant on cells; the second one chooses
    inputs and a target, ``y' = 0.8 y + u``, with values that are linear in cells. The tree holds all vertices.
    """

    def tank(name: str, state: str, factor: float, low: float) -> dict[str, Any]:
        return {
            "name": name,
            "states": [state],
            "inputs": ["u"],
            "A": [[factor]],
            "B": [[1.0]],
            "c": [0.0],
            "outputs": [state],
            "state_low": [low],
            "state_high": [4.0],
            "input_low": [-3.0],
            "input_high": [3.0],
            "start_low": [0.25],
            "start_high": [0.75],
            "noise": [[0.4]],
        }

    regions = [
        {"name": "full_0", "agent": 0, "low": [1.0], "high": [None]},
        {"name": "full_1", "agent": 1, "low": [1.0], "high": [3.0]},
        {"name": "over", "agent": 1, "low": [3.0], "high": [None]},
    ]
    automaton = {  # of "!over U (full_0 & full_1)"
        "initial": 0,
        "accepting": [False, True, False],
        "root": [0, -2, -3],
        "variable": [0, 1, 2],
        "low": [2, 2, -1],
        "high": [1, -2, -3],
    }
    problem = {
        "horizon": 2,
        "agents": [tank("first", "x", 0.5, -4.0), tank("second", "y", 0.8, -4.0)],
        "regions": regions,
        "pairs": [],
        "task": {"formula": "!over U (full_0 & full_1)", "semantics": "co-safe", "automaton": automaton},
    }
    edges, lattice = np.linspace(-4.0, 4.0, 17), np.linspace(-8.0, 8.0, 257)
    middles = 0.5 * edges[:-1] + 0.5 * edges[1:]
    # sets of cells by what is known in them: x below 1, x from 1 on; y below 1, from 1 to 3, from 3 on
    sets_0 = np.stack([middles < 1.0, middles > 1.0])
    sets_1 = np.stack([middles < 1.0, (middles > 1.0) & (middles < 3.0), middles > 3.0])
    lead = [(0, (0, 0)), (0, (0, 1)), (0, (1, 0)), (1, (1, 1))]
    target, sets = np.array([q for q, _ in lead], np.int32), np.array([pair for _, pair in lead], np.int32)
    source = np.zeros(len(lead), np.int32)
    # at the last step the guard that accepts has one vertex below it; one step earlier the others have one each, too
    vertices = np.array([[0, 0, g, 0] for g in range(4)] + [[1, 0, 3, 0]], np.int32)
    kept = np.array([[0, 0, k] for k in range(4)] + [[1, 0, 0]], np.int32)
    inputs, aim = np.array([[-1.0], [0.0], [1.0], [2.0]]), np.searchsorted(lattice, 2.0)
    policy_0, policy_1 = np.full((1, 3, 16), -1, np.int32), np.full((1, 3, 16), -1, np.int32)
    reached = np.abs(2.0 - 0.5 * middles) < 2.8
    policy_0[0, 0, reached] = aim
    policy_1[0, 0] = np.abs(0.8 * middles[:, None] + inputs[:, 0] - 2.0).argmin(axis=1)
    policy_1[0, 0, 9] = len(inputs) + aim
    arrays: list[np.ndarray] = [
        source, target, sets, vertices, np.zeros((0, 6), np.int32), kept, edges, lattice, np.zeros((0, 1)),
        np.ones((1, 1)), sets_0, policy_0, inputs, sets_1, policy_1,
    ]  # fmt: skip
    shared = {"edges": [6], "lattice": [7], "inverse": 9}
    agents = [
        {**shared, "values": "cells", "parts": 2, "inputs": 8, "sets": 10, "start_sets": 10, "policy": 11},
        {**shared, "values": "corners", "parts": 2, "inputs": 12, "sets": 13, "start_sets": 13, "policy": 14},
    ]
    proof = {
        "kind": "cells",
        "guards": {"source": 0, "target": 1, "sets": 2},
        "start": {"target": 1, "sets": 2},
        "tree": {"vertices": 3, "unions": 4, "kept": 5},
        "agents": agents,
    }
    header: dict[str, Any] = {
        "format": "certigym-certificate",
        "version": 3,
        "name": "two tanks",
        "problem": problem,
        "claim": {"failure": 0.1},
        "proof": proof,
    }
    return header, arrays


def one_crane() -> tuple[dict[str, Any], list[np.ndarray]]:
    """Header and arrays: a crane that turns past pi while its load rises through a window of heights.

    Its angle wraps, the noise of the height is Laplace's and grows with the height, that of the angle is uniform. The
    height is to be within the window at some time of the last two, and the crane is not to look ahead then.
    """
    steps = 3
    agent = {
        "name": "crane",
        "states": ["a", "y"],
        "inputs": ["turn", "lift"],
        "dynamics": ["a + turn", "y + lift + 0.02*cos(a)"],
        "outputs": ["a", "y"],
        "angles": ["a"],
        "state_low": [-np.pi, -10.0],
        "state_high": [np.pi, 10.0],
        "input_low": [-2.0, -3.0],
        "input_high": [2.0, 3.0],
        "start_low": [2.5, 0.0],
        "start_high": [2.5, 0.0],
        "noise": [[1.0, 0.0], [0.0, 1.0]],
        "distributions": [{"law": "uniform", "low": -0.1, "high": 0.1}, {"law": "laplace", "scale": 0.085}],
        "noise_scale": ["1", "1 + 0.05*y"],
    }
    automaton = {"initial": 0, "accepting": [False, True], "root": [0, -2], "variable": [0], "low": [-1], "high": [-2]}
    problem = {
        "horizon": steps,
        "agents": [agent],
        "regions": [
            {"name": "hung", "agent": 0, "low": [None, 2.0], "high": [None, 3.5]},
            {"name": "ahead", "agent": 0, "low": [-1.0, None], "high": [1.0, None]},
        ],
        "pairs": [],
        "task": {"formula": "F hung", "semantics": "co-safe", "automaton": automaton},
    }
    states, inputs = [np.array([2.5, 0.0])], np.array([[0.6, 0.9]] * steps)
    for turn, lift in inputs:
        a, y = states[-1]
        states.append(np.array([a + turn, y + lift + 0.02 * np.cos(a)]))
    letters = np.zeros((steps + 1, 2), np.int8)
    letters[2:, 0], letters[1:, 1] = 2, -1
    faces = np.full((steps + 1, 2), -1, np.int32)
    faces[2:, 0], faces[1:, 1] = 2, 0
    gains, widths = np.tile([[-0.8, 0.0], [0.0, -0.5]], (steps, 1, 1)), np.full((steps + 1, 4), np.inf)
    widths[:, :2] = 0.9
    arrays: list[np.ndarray] = [letters, faces, np.zeros((steps + 1, 0)), inputs, gains, np.array(states), widths]
    entry = {"inputs": 3, "gains": 4, "states": 5, "widths": 6}
    header: dict[str, Any] = {
        "format": "certigym-certificate",
        "version": 3,
        "name": "one crane",
        "problem": problem,
        "claim": {"failure": 0.1},
        "proof": {"kind": "trajectory", "letters": 0, "faces": 1, "normals": 2, "agents": [entry]},
    }
    return header, arrays


def npy(array: np.ndarray) -> bytes:
    """The member of an array."""
    shape = f"({', '.join(map(str, array.shape))}{',' if array.ndim == 1 else ''})"
    text = f"{{'descr': '{array.dtype.str}', 'fortran_order': False, 'shape': {shape}, }}"
    text += " " * (-(len(text) + 11) % 64) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode() + np.ascontiguousarray(array).tobytes()


def members_of(header: Any, arrays: Sequence[np.ndarray]) -> list[tuple[str, bytes]]:
    """Names and contents of the members of a file; the header may be a text."""
    text = header if isinstance(header, str) else json.dumps(header)
    return [("header.json", text.encode()), *((f"{k}.npy", npy(array)) for k, array in enumerate(arrays))]


def archive(members: Sequence[tuple[str, bytes]]) -> bytes:
    """A ZIP archive of stored members, as the format wants it."""
    body, directory = b"", b""
    for name, data in members:
        numbers = struct.pack("<HHHHIII", 0, 0, 0, 33, zlib.crc32(data), len(data), len(data))
        place, raw = len(body), name.encode()
        body += b"PK\x03\x04" + struct.pack("<H", 20) + numbers + struct.pack("<HH", len(raw), 0) + raw + data
        directory += b"PK\x01\x02" + struct.pack("<HH", 20, 20) + numbers
        directory += struct.pack("<HHHHHII", len(raw), 0, 0, 0, 0, 0, place) + raw
    count = len(members)
    return body + directory + struct.pack("<4sHHHHIIH", b"PK\x05\x06", 0, 0, count, count, len(directory), len(body), 0)


def file_of(header: Any, arrays: Sequence[np.ndarray]) -> bytes:
    """The bytes of a file."""
    return archive(members_of(header, arrays))


Path = tuple[str | int, ...]


def places(value: Any, path: Path = ()) -> Iterator[Path]:
    """All places in a header, the deepest first."""
    entries: list[tuple[str | int, Any]] = []
    if isinstance(value, dict):
        entries = list(value.items())
    elif isinstance(value, list):
        entries = list(enumerate(value))
    for key, inner in entries:
        yield from places(inner, (*path, key))
        yield (*path, key)


def at(value: Any, path: Path) -> Any:
    """What stands at a place."""
    for key in path:
        value = value[key]
    return value


def changed(header: dict[str, Any], path: Path, new: Any) -> dict[str, Any]:
    """A header with something else at a place."""
    result = copy.deepcopy(header)
    at(result, path[:-1])[path[-1]] = new
    return result


def without(header: dict[str, Any], path: Path) -> dict[str, Any]:
    """A header in which an entry is left out."""
    result = copy.deepcopy(header)
    del at(result, path[:-1])[path[-1]]
    return result
