"""Certified table controllers as a C header: what they compute, operation by operation, with no library but C itself.

For every agent there is ``void PREFIX_AGENT_act(const double *x, int q, int time, double *u)`` for its state x (d), the
automaton state and the time, and its input u (m). Compiled without contraction of products and sums
(``-ffp-contract=off``, and no ``-ffast-math``) it gives the numbers of ``AgentController.act``, to the last bit.

    cell    the state, moved into the grid; bisection finds its interval on every axis
    choice  a table over times, automaton states and cells
    input   an entry of the menu, or ``B^+ (target - drift - A x) + u_mid``
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..certificates.controllers import AgentController, Controller
from ..relations.kinds import ExactRelation, Row, rows_of

KINDS = {1: "signed char", 2: "short", 4: "int"}
"""Types of tables by the bytes of an entry."""


def header_of(controller: Controller, prefix: str, agents: Sequence[str] = ()) -> str:
    """Return the header of the controllers of some agents, by default of all.

    Raises
    ------
    ValueError
        If a controller remembers, steers by networks, or is of another relation than ``exact`` or ``linear``.
    """
    problem, guard = controller.problem, f"{_name(prefix)}_H"
    chosen = [agent for agent in controller.agents if not agents or agent.name in agents]
    parts = [_of_agent(agent, _name(prefix)) for agent in chosen]
    states = ", ".join(f"{k} {name}" for k, name in enumerate(problem.automaton.state_names))
    head = [
        f"/* Controllers of {problem.name}, horizon {problem.horizon}, made by certigym.",
        f"   Automaton states: {states}. Compile with -ffp-contract=off. */",
        f"#ifndef {guard}",
        f"#define {guard}",
        "",
        f'#define {_name(prefix)}_FINGERPRINT "{problem.fingerprint}"',
        "",
    ]
    return "\n".join([*head, *parts, f"#endif /* {guard} */", ""])


def _of_agent(agent: AgentController, prefix: str) -> str:
    """Return tables and function of one agent."""
    name = f"{prefix}_{_name(agent.name)}"
    mean_targets, input_set = _aims_and_menu(agent)
    policy, edges = agent.policy, agent.grid.edges
    T, Q, S = policy.shape
    m = input_set.shape[1] if len(input_set) else len(_exact(mean_targets).input_centre)
    lines = [_table(f"{name}_edges_{k}", axis[1:-1] if len(axis) > 2 else axis[:1]) for k, axis in enumerate(edges)]
    lines.append(_table(f"{name}_policy", policy.reshape(-1)))
    if len(input_set):
        idle = input_set.mean(axis=0, keepdims=True)
        lines.append(_table(f"{name}_menu", np.concatenate([input_set, idle]).reshape(-1)))
    if mean_targets is not None:
        targets = [np.asarray(axis, dtype=float) for axis in agent.lattice]
        lines += [_table(f"{name}_aims_{k}", axis - drift)
                  for k, (axis, drift) in enumerate(zip(targets, mean_targets.drift, strict=True))]  # fmt: skip
    d = len(edges)
    lines += ["", f"static void {name}_act(const double *x, int q, int time, double *u) {{"]
    lines += [f"    double p[{d}];", "    long cell = 0, low, high, middle;", "    int choice;"]
    for k, axis in enumerate(edges):
        lines.append(f"    p[{k}] = x[{k}];")
        # Not a number goes to the low edge, as it does in Python.
        lines.append(f"    if (!(p[{k}] >= {_number(axis[0])})) p[{k}] = {_number(axis[0])};")
        lines.append(f"    if (p[{k}] > {_number(axis[-1])}) p[{k}] = {_number(axis[-1])};")
        lines.append(f"    low = 0; high = {len(axis) - 2};")
        lines.append("    while (low < high) {")
        lines.append("        middle = (low + high) / 2;")
        lines.append(f"        if (p[{k}] >= {name}_edges_{k}[middle]) low = middle + 1; else high = middle;")
        lines.append("    }")
        lines.append(f"    cell = cell * {len(axis) - 1} + low;")
    lines.append(f"    if (time > {T - 1}) time = {T - 1};")
    lines.append(f"    choice = {name}_policy[((long) time * {Q} + q) * {S} + cell];")
    if len(input_set):
        n = len(input_set)
        bound = f"choice < {n}" if mean_targets is not None else f"choice < {n + 1}"
        lines.append(f"    if ({bound}) {{")
        lines.append(f"        if (choice < 0) choice = {n};")
        lines += [f"        u[{j}] = {name}_menu[choice * {m} + {j}];" for j in range(m)]
        lines += ["        return;", "    }"]
        lines += [f"    choice -= {n};"] if mean_targets is not None else []
    elif np.any(policy < 0):
        lines.append("    if (choice < 0) {")
        lines += [f"        u[{j}] = {_number(c)};" for j, c in enumerate(_exact(mean_targets).input_centre)]
        lines += ["        return;", "    }"]
    if mean_targets is not None:
        lines += _steering(mean_targets, agent, name)
    lines += ["}", ""]
    return "\n".join(lines)


def _steering(mean_targets: ExactRelation, agent: AgentController, name: str) -> list[str]:
    """Return the lines that put the mean of the next state on a target."""
    lines, sizes = ["    {", f"        double g[{len(agent.lattice)}];"], [len(axis) for axis in agent.lattice]
    for k, row in enumerate(rows_of(mean_targets.A)):
        stride = int(np.prod(sizes[k + 1 :], dtype=np.int64))
        place = f"(choice / {stride}) % {sizes[k]}"
        lines.append(f"        g[{k}] = {name}_aims_{k}[{place}] - ({_sum(row, 'p')});")
    for j, (row, centre) in enumerate(
        zip(rows_of(mean_targets.right_inverse), mean_targets.input_centre.tolist(), strict=True)
    ):
        lines.append(f"        u[{j}] = {_sum(row, 'g')};")
        lines.append(f"        u[{j}] += {_number(centre)};")
    return [*lines, "    }"]


def _aims_and_menu(agent: AgentController) -> tuple[ExactRelation | None, NDArray[Any]]:
    """Return what puts means on targets, if there is such a thing, and the menu of inputs (A, m), maybe empty."""
    relation = agent.relation
    if relation.matrices is not None:
        return relation.matrices
    raise ValueError(
        f"`policy`: expected controllers of the relations exact or linear, whose dynamics are linear, got the relation "
        f"{relation.kind} of agent `{agent.name}`; networks are written as .onnx"
    )


def _exact(mean_targets: ExactRelation | None) -> ExactRelation:
    assert mean_targets is not None  # a relation without a menu has targets
    return mean_targets


def _sum(row: Row, vector: str) -> str:
    """Return a row times a vector, in the order in which Python adds."""
    return " + ".join(f"{_number(value)} * {vector}[{k}]" for k, value in row) or "0.0"


def _number(value: float) -> str:
    """Return a number with all of its digits."""
    return f"({float(value)!r})" if value < 0 else repr(float(value))


def _table(name: str, values: NDArray[Any]) -> str:
    """Return an array of numbers or of choices."""
    if values.dtype.kind == "f":
        kind, words = "double", [_number(v).strip("()") for v in values.tolist()]
    else:
        small = next(t for t in (np.int8, np.int16, np.int32) if np.array_equal(values, values.astype(t)))
        kind, words = KINDS[np.dtype(small).itemsize], [str(v) for v in values.tolist()]
    return f"static const {kind} {name}[{len(words)}] = {{{','.join(words)}}};"


def _name(text: str) -> str:
    """Return a name that C takes."""
    return re.sub(r"\W", "_", text)
