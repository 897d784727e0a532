"""Small random problems of single kinds, most of which have a claim that says something.

Those of ``random_problems`` are as wild as they can be, and half of their claims are 0. Here noise, regions and times
fit together, so that bounds lie between 0 and 1; what is wild are the details: starts on faces and outside, inputs
without effect, edges that coincide or differ by rounding, scales that are constants, units.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from independent import Formula, names_in, text_of
from random_expressions import _make_uneven, _write, _write_aimed
from random_problems import Spec, _formula, make_independent
from tuple_expressions import Expression
from tuple_expressions import text_of as expression_text


def small_spec(kind: str, seed: int) -> Spec:
    """A problem of a kind as plain numbers, and under ``options`` what to synthesize it with."""
    rng = np.random.default_rng([20261130, *kind.encode(), seed])
    return MAKERS[kind](rng)


def _problem(rng: np.random.Generator, agents: list[Spec], options: Spec, horizons: tuple[int, ...]) -> Spec:
    """Regions, a task and starts for agents, drawn in this order."""
    if options.get("relation") != "path":
        make_independent(agents)
    propositions: dict[str, Spec] = {}
    goals, safes = list[str](), list[str]()
    for agent in agents:
        for what, names in (("goal", goals), ("safe", safes)):
            if rng.random() < 0.75 or not names:
                names.append(f"{what}_{agent['name']}")
                propositions[names[-1]] = _region(rng, agent, what)
        if rng.random() < 0.4:
            propositions[f"near_{agent['name']}"] = _next_to(rng, agent, propositions)
    semantics = str(rng.choice(["co-safe", "finite-trace"]))
    formula = _task(rng, goals, safes, list(propositions), semantics)
    used = names_in(formula)
    kept = {name: region for name, region in propositions.items() if name in used or rng.random() < 0.3}
    for agent in agents:
        _start(rng, agent, kept)
    return {
        "agents": agents,
        "propositions": kept,
        "formula": formula,
        "text": text_of(formula),
        "semantics": semantics,
        "horizon": int(rng.choice(horizons)),
        "options": options,
    }


def _task(rng: np.random.Generator, goals: list[str], safes: list[str], names: list[str], semantics: str) -> Formula:
    """Reach, stay, avoid, and now and then anything."""

    def every(these: list[str]) -> Formula:
        formula: Formula = ("is", these[0])
        for name in these[1:]:
            formula = ("and", formula, ("is", name))
        return formula

    goal, safe = every(goals), every(safes)
    forms: list[Formula] = [("F", 0, None, goal), ("U", safe, goal), ("X", ("F", 0, None, goal))]
    forms.append(("F", 0, None, ("and", goal, ("X", ("F", 0, None, safe)))))
    if semantics == "finite-trace":
        forms += [("G", 0, None, safe), ("G", 0, None, safe), ("and", ("G", 0, None, safe), ("F", 0, None, goal))]
        forms.append(("F", 0, None, ("G", 0, None, safe)))
    forms.append(_formula(rng, names, semantics, 2))
    return forms[int(rng.integers(len(forms)))]


def _region(rng: np.random.Generator, agent: Spec, what: str) -> Spec:
    """A box: of goals a part of the workspace, of safe places most of it; some edges lie on its faces or beyond."""
    low, high = np.array(agent["state_low"]), np.array(agent["state_high"])
    width = rng.uniform(0.35, 0.6, len(low)) if what == "goal" else rng.uniform(0.7, 0.95, len(low))
    first = rng.random(len(low)) * (1.0 - width)
    ends = np.stack([low + (high - low) * first, low + (high - low) * (first + width)])
    for side, face in enumerate((low, high)):
        moved = rng.random(len(low))
        ends[side] = np.where(moved < 0.2, face, ends[side])
        ends[side] = np.where((moved > 0.95), face + (2 * side - 1) * 0.1 * (high - low), ends[side])
        beyond = np.nextafter(face, np.inf if side else -np.inf)  # outside the workspace by one unit of rounding
        ends[side] = np.where((moved > 0.93) & (moved <= 0.95), beyond, ends[side])
    return {"agent": agent["name"], "low": ends[0].tolist(), "high": ends[1].tolist()}


def _next_to(rng: np.random.Generator, agent: Spec, propositions: dict[str, Spec]) -> Spec:
    """A region that shares an edge with another one, or misses it by a few units of rounding."""
    own = [region for region in propositions.values() if region["agent"] == agent["name"]]
    region = _region(rng, agent, "goal")
    if own:
        other, axis = own[int(rng.integers(len(own)))], int(rng.integers(len(region["low"])))
        edge = float(other[str(rng.choice(["low", "high"]))][axis])
        steps = int(rng.choice([0, 0, 0, 0, 0, 0, 1, 3]))
        for _ in range(steps):
            edge = float(np.nextafter(edge, np.inf))
        low, high = agent["state_low"][axis], agent["state_high"][axis]
        if 0.5 * (low + high) > edge:
            region["low"][axis], region["high"][axis] = edge, max(region["high"][axis], edge + 0.3 * (high - low))
        else:
            region["low"][axis], region["high"][axis] = min(region["low"][axis], edge - 0.3 * (high - low)), edge
    return region


def _start(rng: np.random.Generator, agent: Spec, propositions: dict[str, Spec], boxes: bool = True) -> None:
    """A point near the middle, on the edge of a region or the workspace, just outside of it, or a box."""
    low, high = np.array(agent["state_low"]), np.array(agent["state_high"])
    point, kind = low + (high - low) * rng.uniform(0.25, 0.75, len(low)), rng.random()
    own = [region for region in propositions.values() if region["agent"] == agent["name"]]
    axis = int(rng.integers(len(low)))
    if kind < 0.1 and boxes and not agent["correlated"]:
        half = 0.1 * (high - low) * (rng.random(len(low)) < 0.7)
        agent["initial_low"], agent["initial_high"] = (point - half).tolist(), (point + half).tolist()
    elif kind < 0.13 and boxes and not agent["correlated"]:  # partly outside
        corner = point.copy()
        corner[axis] = high[axis] + 0.05 * (high - low)[axis]
        agent["initial_low"], agent["initial_high"] = point.tolist(), np.maximum(corner, point).tolist()
    elif kind < 0.3 and own:
        edge = np.array(own[int(rng.integers(len(own)))][str(rng.choice(["low", "high"]))])
        point[axis] = np.clip(edge[axis], low[axis], high[axis])
    elif kind < 0.34:
        point[axis] = (low, high)[int(rng.integers(2))][axis]
    elif kind < 0.36:  # outside by a unit of rounding
        point[axis] = np.nextafter(high[axis], np.inf)
    if "initial_low" not in agent:
        agent["initial_state"] = point.tolist()
    agent.pop("correlated")


def _linear(rng: np.random.Generator, name: str, d: int, noise: tuple[float, float], wide: bool = True) -> Spec:
    """A linear agent on [-1, 1]^d in units of its own, whose inputs reach every mean if they are wide."""
    A = np.diag(rng.choice([0.5, 0.8, 0.9, 1.0, 1.0, 1.1], d))
    A += 0.15 * rng.standard_normal((d, d)) * (rng.random((d, d)) < 0.4) * (1 - np.eye(d))
    B = np.diag(rng.uniform(0.4, 1.0, d) * rng.choice([-1.0, 1.0], d))
    if d > 1 and rng.random() < 0.2:
        B[0, 1] = 0.2
    if not wide:  # the last state is pushed, the others follow
        A = np.triu(A) + np.diag(rng.uniform(0.2, 0.5, d - 1), 1)
        B = B[:, -1:]
    if rng.random() < 0.12:  # an input without effect
        B = np.hstack([B, np.zeros((d, 1))])[:, rng.permutation(B.shape[1] + 1)]
    m = B.shape[1]
    unit = np.ones(d)
    if rng.random() < 0.3:
        unit = 10.0 ** rng.uniform(-3, 3, d)
    elif rng.random() < 0.4:
        unit = np.full(d, float(rng.choice([10.0, 4.0, 0.01])))
    deviation, width = rng.uniform(*noise, d) * unit, rng.uniform(0.5, 1.5, m)
    middle = rng.uniform(-0.3, 0.3, m) * (rng.random() < 0.3)
    shape, correlated = np.eye(d), d > 1 and rng.random() < 0.12
    if correlated:
        mixed = rng.standard_normal((d, d)) + np.eye(d)
        shape = mixed @ mixed.T
        shape /= np.sqrt(np.outer(np.diag(shape), np.diag(shape)))
    covariance = shape * np.outer(deviation, deviation)
    return {
        "name": name,
        "A": (unit[:, None] * A / unit).tolist(),
        "B": (unit[:, None] * B).tolist(),
        "state_low": (-unit).tolist(),
        "state_high": unit.tolist(),
        "input_low": (middle - width).tolist(),
        "input_high": (middle + width).tolist(),
        "offset": (0.05 * unit * rng.standard_normal(d) * (rng.random() < 0.3)).tolist(),
        "noise_covariance": (0.5 * (covariance + covariance.T)).tolist(),
        "correlated": bool(correlated),
    }


def _in_words(rng: np.random.Generator, agent: Spec, write: Callable[..., None]) -> None:
    """Write a linear agent as expressions, with terms that bend it; its start is added later."""
    agent["correlated"] = False
    agent["noise_covariance"] = np.diag(np.diag(agent["noise_covariance"])).tolist()
    write(rng, agent)


def _write_plainly(rng: np.random.Generator, agent: Spec) -> None:
    """The linear dynamics themselves, in words."""
    d, m = len(agent["A"]), len(agent["B"][0])
    dynamics: list[Expression] = []
    for k in range(d):
        total: Expression = float(agent["offset"][k])
        for j in range(d):
            total = ("+", total, ("*", float(agent["A"][k][j]), f"x{j}"))
        for j in range(m):
            total = ("+", total, ("*", float(agent["B"][k][j]), f"u{j}"))
        dynamics.append(total)
    agent["tuples"], agent["winds"] = dynamics, {}
    keys = ("name", "state_low", "state_high", "input_low", "input_high", "noise_covariance")
    agent["written"] = {key: agent[key] for key in keys} | {
        "states": [f"x{k}" for k in range(d)],
        "inputs": [f"u{j}" for j in range(m)],
        "dynamics": [expression_text(expression) for expression in dynamics],
    }


def _told_starts(spec: Spec) -> Spec:
    """Starts of agents that were written before they had one."""
    for agent in spec["agents"]:
        if "written" in agent:
            agent["written"] |= {key: agent[key] for key in agent if key.startswith("initial_")}
            agent["written"]["dynamics"] = [expression_text(tree) for tree in agent["tuples"]]
    return spec


def _states(rng: np.random.Generator) -> Spec:
    """Two and three states, every relation."""
    d = int(rng.choice([2, 3], p=[0.8, 0.2]))
    relation = str(rng.choice(["exact", "exact", "linear", "boxes", "linear", "boxes"]))
    agent = _linear(rng, "agent_0", d, (0.08, 0.3), wide=relation == "exact" or rng.random() < 0.7)
    agents = [agent]
    if d == 2 and rng.random() < 0.2:
        agents.append(_linear(rng, "agent_1", 1, (0.08, 0.3)))
    cells = {each["name"]: [int(rng.integers(*{1: (20, 40), 2: (10, 19), 3: (5, 8)}[len(each["A"])]))
             for _ in each["A"]] for each in agents}  # fmt: skip
    options: Spec = {"cells": cells, "relation": relation, "max_sweeps": 1}
    return _problem(rng, agents, options, (1, 2, 3, 4))


def _lawful(rng: np.random.Generator) -> Spec:
    """The relation `boxes`, with noise of four laws and scales, some of which are constants."""
    d = int(rng.choice([1, 2], p=[0.92, 0.08]))
    agents = [_linear(rng, f"agent_{i}", d, (0.1, 0.3)) for i in range(1 + int(d == 1 and rng.random() < 0.15))]
    for agent in agents:
        _in_words(rng, agent, _write)
        _make_uneven(rng, agent)
        for k in range(d):
            if rng.random() < 0.35:
                text, value = [("1", 1.0), ("2/2", 1.0), ("0.5", 0.5), ("1.0", 1.0), ("exp(0)", 1.0)][
                    int(rng.integers(5))
                ]
                agent["scales"][k], agent["written"]["noise_scale"][k] = value, text
        if rng.random() < 0.3:  # laws without any scale
            del agent["written"]["noise_scale"]
            agent["scales"] = [1.0] * d
    sizes = (14, 32) if d == 1 and len(agents) == 1 else (8, 14) if d == 1 else (5, 8)
    cells = {agent["name"]: [int(rng.integers(*sizes)) for _ in range(d)] for agent in agents}
    return _told_starts(_problem(rng, agents, {"cells": cells, "relation": "boxes", "max_sweeps": 1}, (1, 2, 3, 4)))


def _coupled(rng: np.random.Generator) -> Spec:
    """Agents whose dynamics name states of others, of which they are told or not."""
    agents = [_linear(rng, f"agent_{i}", 1, (0.1, 0.25)) for i in range(int(rng.choice([2, 3], p=[0.8, 0.2])))]
    aimed = rng.random() < 0.5
    for agent in agents:
        _in_words(rng, agent, _write_aimed if aimed else _write)
    for i, agent in enumerate(agents):
        others = [other for j, other in enumerate(agents) if j != i and (rng.random() < 0.6 or i == 0)]
        for other in others:
            named: Expression = ("/", f"{other['name']}.x0", float(other["state_high"][0]))
            share = float(rng.uniform(-0.15, 0.15) * agent["state_high"][0])
            term = [named, ("sin", named), ("abs", ("-", named, 0.2))][int(rng.integers(3))]
            agent["tuples"][0] = ("+", agent["tuples"][0], ("*", share, term))
        told = [other["name"] for other in others if rng.random() < 0.6]
        agent["beside"] = [f"{other['name']}.x0" for other in others]
        if told:
            agent["written"]["communicated"] = told
    cells = {agent["name"]: [int(rng.integers(14, 26))] for agent in agents}
    options: Spec = {"cells": cells, "max_sweeps": 1, "relation": "exact" if aimed else "boxes"}
    if aimed:
        options.pop("max_sweeps")
    return _told_starts(_problem(rng, agents, options, (1, 2, 3, 4)))


def _path(rng: np.random.Generator) -> Spec:
    """Certificates along a path: one to four states, no cells."""
    several = rng.random() < 0.25
    agents = []
    for i in range(2 if several else 1):
        d = int(rng.choice([1, 2]) if several else rng.choice([1, 2, 3, 4]))
        agents.append(_linear(rng, f"agent_{i}", d, (0.05, 0.2), wide=d == 1 or rng.random() < 0.6))
        if d > 1 and rng.random() < 0.15:  # a state without noise
            covariance = np.array(agents[-1]["noise_covariance"])
            covariance[0] = covariance[:, 0] = 0.0
            agents[-1]["noise_covariance"] = covariance.tolist()
        agents[-1]["correlated"] = True  # no start boxes
    return _problem(rng, agents, {"relation": "path"}, (1, 2, 3, 4, 6))


def _nonlinear(rng: np.random.Generator) -> Spec:
    """Certificates along a path of agents written as expressions: one to six states, winds, scales, start boxes."""
    d = int(rng.choice([1, 2, 3, 4, 5, 6], p=[0.15, 0.3, 0.2, 0.15, 0.1, 0.1]))
    agents = [_linear(rng, f"agent_{i}", d, (0.04, 0.15), wide=d == 1 or rng.random() < 0.5)
              for i in range(1 + int(d == 1 and rng.random() < 0.3))]  # fmt: skip
    for agent in agents:
        _in_words(rng, agent, _write)
        if rng.random() < 0.3:
            _make_uneven(rng, agent)
            deviations = rng.uniform(0.04, 0.12, d) * np.array(agent["state_high"])
            agent["laws"] = [{"law": "gaussian", "std": float(std)} for std in deviations]
            agent["written"]["noise"] = agent["laws"]
        elif rng.random() < 0.4:
            del agent["noise_covariance"], agent["written"]["noise_covariance"]
            agent["scales"], agent["laws"] = [1.0] * d, [_other_law(rng, float(size)) for size in agent["state_high"]]
            agent["written"]["noise"] = agent["laws"]
    return _told_starts(_problem(rng, agents, {"relation": "path"}, (1, 2, 3, 5)))


def _other_law(rng: np.random.Generator, size: float) -> Spec:
    """A law that is not normal, with a mean that need not be 0, or with heavier tails."""
    half, off = size * float(rng.uniform(0.05, 0.25)), size * float(rng.choice([0.0, 0.05, -0.1]))
    if rng.random() < 0.35:
        scale = 0.3 * half
        heavy = ({"law": "laplace"}, {"law": "logistic"}, {"law": "student-t", "df": float(rng.choice([3.0, 6.0]))})
        return {**heavy[int(rng.integers(3))], "scale": scale}
    if rng.random() < 0.6:
        return {"law": "uniform", "low": off - half, "high": off + half}
    return {"law": "triangular", "low": off - half, "mode": off + half * float(rng.uniform(-1.0, 1.0)),
            "high": off + half}  # fmt: skip


def _fleet(rng: np.random.Generator) -> Spec:
    """Two or three agents, linear or written as expressions, that keep apart, meet, or stay near each other."""
    unit = float(rng.choice([1.0, 1.0, 10.0, 0.01]))
    agents, goals = [], list[str]()
    propositions: dict[str, Spec] = {}
    for i in range(int(rng.choice([2, 3], p=[0.75, 0.25]))):
        d = int(rng.choice([1, 2, 3], p=[0.4, 0.4, 0.2]))
        agent = _in_units(_linear(rng, f"agent_{i}", d, (0.03, 0.1), wide=d == 1 or rng.random() < 0.7), unit)
        if rng.random() < 0.7:
            _in_words(rng, agent, _write)
        agent["correlated"] = True  # no start boxes: pairs are read at points
        agents.append(agent)
    apart = rng.random() < 0.6
    pairs = []
    for i, first in enumerate(agents):
        for second in agents[i + 1 :]:
            axes = [int(rng.integers(len(agent["state_low"]))) for agent in (first, second)]
            both = len(first["state_low"]) > 1 and len(second["state_low"]) > 1 and rng.random() < 0.5
            outputs = [[0, 1], [0, 1]] if both else [[axes[0]], [axes[1]]]
            half = rng.uniform(0.1, 0.35, 1 + both) if apart else rng.uniform(0.5, 1.0, 1 + both)
            middle = rng.uniform(-0.1, 0.1, 1 + both)
            low, high = (unit * (middle - half)).tolist(), (unit * (middle + half)).tolist()
            name = f"near_{first['name'][-1]}{second['name'][-1]}"
            pairs.append(name)
            propositions[name] = {"agents": [first["name"], second["name"]], "low": low, "high": high,
                                  "outputs": outputs}  # fmt: skip
    singles: dict[str, Spec] = {}
    for agent in agents:
        if rng.random() < 0.6 or not goals:
            goals.append(f"goal_{agent['name']}")
            singles[goals[-1]] = _region(rng, agent, "goal")
        _start(rng, agent, singles)
    for name in pairs:
        if rng.random() < 0.15:
            _on_face(rng, agents, propositions[name])
    semantics = str(rng.choice(["co-safe", "finite-trace"]))
    formula = _pair_task(rng, pairs, goals, apart, semantics)
    spec = {"agents": agents, "propositions": singles | propositions, "formula": formula, "text": text_of(formula),
            "semantics": semantics, "horizon": int(rng.choice([1, 2, 3, 5, 6])),
            "options": {"relation": "path"}}  # fmt: skip
    return _told_starts(spec)


def _in_units(agent: Spec, unit: float) -> Spec:
    """The same agent with all of its states in one unit."""
    own = np.array(agent["state_high"]) / unit
    agent["A"] = (np.array(agent["A"]) * own / own[:, None]).tolist()
    for name in ("state_low", "state_high", "offset"):
        agent[name] = (np.array(agent[name]) / own).tolist()
    agent["B"] = (np.array(agent["B"]) / own[:, None]).tolist()
    covariance = np.array(agent["noise_covariance"]) / np.outer(own, own)
    agent["noise_covariance"] = (0.5 * (covariance + covariance.T)).tolist()
    return agent


def _on_face(rng: np.random.Generator, agents: list[Spec], pair: Spec) -> None:
    """Move the start of the second agent of a pair so that their difference lies on a face of its box."""
    first, second = (next(a for a in agents if a["name"] == name) for name in pair["agents"])
    k, side = int(rng.integers(len(pair["low"]))), str(rng.choice(["low", "high"]))
    if "initial_state" in first and "initial_state" in second:
        i, j = (outputs[k] for outputs in pair["outputs"])
        place = first["initial_state"][i] - pair[side][k]
        second["initial_state"][j] = float(np.clip(place, second["state_low"][j], second["state_high"][j]))


def _pair_task(rng: np.random.Generator, pairs: list[str], goals: list[str], apart: bool, semantics: str) -> Formula:
    """Keep apart on the way to goals or for good; or meet, or stay near each other."""

    def every(these: list[str], kind: str = "is") -> Formula:
        formula: Formula = (kind, these[0])
        for name in these[1:]:
            formula = ("and", formula, (kind, name))
        return formula

    goal, wanted = every(goals), every(pairs, "not" if apart else "is")
    forms: list[Formula] = [("U", wanted, goal), ("X", ("U", wanted, goal)), ("F", 0, None, ("and", wanted, goal))]
    if semantics == "finite-trace":
        forms += [("G", 0, None, wanted), ("and", ("G", 0, None, wanted), ("F", 0, None, goal))]
        forms.append(("G", 1, None, wanted))
    return forms[int(rng.integers(len(forms)))]


def _networks(rng: np.random.Generator) -> Spec:
    """Linear agents moved by one random network that leads them about to their middle."""
    d = int(rng.choice([1, 2], p=[0.8, 0.2]))
    agents = [_linear(rng, f"agent_{i}", d, (0.1, 0.25)) for i in range(1 + int(d == 1 and rng.random() < 0.3))]
    cells = {agent["name"]: [int(rng.integers(*((50, 120) if d == 1 else (10, 16)))) for _ in range(d)]
             for agent in agents}  # fmt: skip
    return _with_network(rng, _problem(rng, agents, {"cells": cells}, (1, 2, 3)))


def _network_runs(rng: np.random.Generator) -> Spec:
    """The problems of ``paths`` and ``nonlinear``, moved by one random network."""
    return _with_network(rng, (_path, _nonlinear)[int(rng.integers(2))](rng))


def _with_network(rng: np.random.Generator, spec: Spec) -> Spec:
    hidden = [int(n) for n in rng.integers(3, 9, rng.integers(3))]
    network = {"seed": int(rng.integers(2**31)), "hidden": hidden, "activation": str(rng.choice(["tanh", "relu"]))}
    return spec | {"network": network | {"squashed": bool(rng.random() < 0.4)}}


def _above(rng: np.random.Generator) -> Spec:
    """Problems whose certificates get an upper end: every relation with cells."""
    kind = int(rng.choice([0, 1, 2, 3], p=[0.05, 0.05, 0.8, 0.1]))
    if kind == 0:
        spec = _coupled(rng)
    elif kind == 1:
        spec = _lawful(rng)
    elif kind == 2:
        agent = _linear(rng, "agent_0", 1, (0.08, 0.2))
        weak = float(rng.uniform(0.05, 0.25))  # too weak to be nearly sure of anything
        for side in ("input_low", "input_high"):
            agent[side] = (weak * np.array(agent[side])).tolist()
        options = {"cells": {"agent_0": [int(rng.integers(40, 80))]}, "max_sweeps": 1,
                   "relation": str(rng.choice(["linear", "boxes", "exact"]))}  # fmt: skip
        spec = _problem(rng, [agent], options, (1, 2, 3, 4))
    else:
        spec = _states(rng)
    return spec


MAKERS: dict[str, Callable[[np.random.Generator], Spec]] = {
    "laws": _lawful,
    "neighbours": _coupled,
    "states": _states,
    "paths": _path,
    "nonlinear": _nonlinear,
    "fleets": _fleet,
    "networks": _networks,
    "network_runs": _network_runs,
    "upper": _above,
}
"""How problems of each kind are drawn."""
