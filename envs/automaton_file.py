"""Automata as JSON dictionaries (exact) and as Graphviz pictures."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import islice
from typing import Any

import numpy as np

from .automaton import Automaton
from .guards import letter_text

FORMAT = "certigym-automaton"
VERSION = 1
_INTEGER_FIELDS = ("accepting", "root", "variable", "low", "high")
_CUBES_SHOWN = 200  # per state, in pictures


def automaton_to_dict(automaton: Automaton) -> dict[str, Any]:
    """Return a dictionary of strings, integers and lists that holds `automaton` exactly."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "semantics": automaton.semantics,
        "propositions": list(automaton.propositions),
        "states": list(automaton.state_names),
        "initial": automaton.initial,
        "accepting": np.flatnonzero(automaton.accepting).tolist(),
        "root": automaton.root.tolist(),
        "variable": automaton.variable.tolist(),
        "low": automaton.low.tolist(),
        "high": automaton.high.tolist(),
    }


def automaton_from_dict(data: Mapping[str, Any]) -> Automaton:
    """Return the automaton held by `data`; raise ValueError if it holds none."""
    if not isinstance(data, Mapping) or data.get("format") != FORMAT:
        raise ValueError(f'`data`: expected a dictionary with "format": "{FORMAT}"')
    if data.get("version") != VERSION:
        raise ValueError(f"`version`: expected {VERSION}, got {data.get('version')!r}; written by another release")
    expected = {"format", "version", "semantics", "propositions", "states", "initial", *_INTEGER_FIELDS}
    if set(data) != expected:
        odd = sorted(map(str, set(data) ^ expected))
        raise ValueError(f"`data`: expected exactly the fields {', '.join(sorted(expected))}; differs in {odd[0]!r}")
    for field in ("propositions", "states"):
        if not isinstance(data[field], list) or not all(isinstance(name, str) for name in data[field]):
            raise ValueError(f"`{field}`: expected a list of strings")
    for field in _INTEGER_FIELDS:
        values = data[field]
        if not isinstance(values, list) or not all(type(v) is int and abs(v) < 2**31 for v in values):
            raise ValueError(f"`{field}`: expected a list of integers below 2^31")
    if type(data["initial"]) is not int:
        raise ValueError(f"`initial`: expected an integer, got {data['initial']!r}")
    n_states = len(data["states"])
    if not all(0 <= q < n_states for q in data["accepting"]):
        raise ValueError(f"`accepting`: expected state indices below {n_states}")
    accepting = np.zeros(n_states, dtype=bool)
    accepting[np.array(data["accepting"], dtype=np.int64)] = True
    return Automaton(
        propositions=tuple(data["propositions"]),
        semantics=data["semantics"],
        state_names=tuple(data["states"]),
        initial=data["initial"],
        accepting=accepting,
        root=np.array(data["root"], dtype=np.int32),
        variable=np.array(data["variable"], dtype=np.int32),
        low=np.array(data["low"], dtype=np.int32),
        high=np.array(data["high"], dtype=np.int32),
    )


def automaton_to_dot(automaton: Automaton) -> str:
    """Return a Graphviz picture: accepting states are doubly circled, edges carry their guards.

    Long guards are cut off with an ellipsis; the edges themselves are complete.
    """
    manager, roots = automaton.diagrams()
    lines = ["digraph automaton {", "  rankdir=LR;", '  start [shape=point, label=""];']
    for q, name in enumerate(automaton.state_names):
        shape = "doublecircle" if automaton.accepting[q] else "circle"
        lines.append(f"  {q} [shape={shape}, label={_quoted(name)}];")
    lines.append(f"  start -> {automaton.initial};")
    for q, root in enumerate(roots):
        cubes: dict[int, list[str]] = {target: [] for target in manager.leaves(root)}
        found = list(islice(manager.paths(root), _CUBES_SHOWN + 1))
        for assignment, target in found[:_CUBES_SHOWN]:
            cubes[target].append(letter_text(assignment, automaton.propositions) if assignment else "true")
        for target, texts in cubes.items():
            label = " | ".join(texts if len(found) <= _CUBES_SHOWN else [*texts, "..."])
            lines.append(f"  {q} -> {target} [label={_quoted(label)}];")
    return "\n".join([*lines, "}", ""])


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
