"""A simulator and a reading of formulas that share no code with the package.

Problems are plain dictionaries of numbers, formulas nested tuples. Letters, acceptance and the step of the agents are
written here once more, from ``docs/theory/setting.md`` alone, so that a mistake of the package is not repeated.

A formula is one of::

    ("true",) ("false",) ("is", name) ("not", name) ("and", f, g) ("or", f, g) ("X", f) ("N", f)
    ("F", a, b, f) ("G", a, b, f) ("U", f, g) ("R", f, g)          b is None for "without end"
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import cache
from itertools import combinations, product
from typing import Any

import numpy as np

from tuple_expressions import value_of

Formula = tuple[Any, ...]
Letter = frozenset[str]
Clause = frozenset[Formula]
Obligations = frozenset[Clause]
"""A disjunction of conjunctions of what remains to be seen; ``TRUE`` and ``FALSE`` are two of them."""

TRUE: Obligations = frozenset({frozenset()})
FALSE: Obligations = frozenset()


def text_of(formula: Formula) -> str:
    """The formula in the package's syntax."""
    kind, *parts = formula
    if kind in ("true", "false"):
        return str(kind)
    if kind in ("is", "not"):
        return ("!" if kind == "not" else "") + str(parts[0])
    if kind in ("and", "or", "U", "R"):
        sign = {"and": "&", "or": "|"}.get(kind, kind)
        return f"({text_of(parts[0])} {sign} {text_of(parts[1])})"
    if kind in ("X", "N"):
        return f"{kind} ({text_of(parts[0])})"
    first, last, inner = parts
    if last is None and first > 0:
        return f"X[{first}] {kind} ({text_of(inner)})" if kind == "F" else f"N[{first}] {kind} ({text_of(inner)})"
    return f"{kind}{'' if last is None else f'[{first},{last}]'} ({text_of(inner)})"


def names_in(formula: Formula) -> set[str]:
    """Propositions of a formula."""
    if formula[0] in ("is", "not"):
        return {formula[1]}
    return set().union(*(names_in(part) for part in formula[1:] if isinstance(part, tuple)))


def holds(formula: Formula, trace: Sequence[Letter], t: int = 0) -> bool:
    """Whether a finite trace satisfies the formula at position t, by recursion on both."""
    kind, *parts = formula
    last = len(trace) - 1
    if kind in ("true", "false"):
        return bool(kind == "true")
    if kind == "is":
        return parts[0] in trace[t]
    if kind == "not":
        return parts[0] not in trace[t]
    if kind == "and":
        return holds(parts[0], trace, t) and holds(parts[1], trace, t)
    if kind == "or":
        return holds(parts[0], trace, t) or holds(parts[1], trace, t)
    if kind == "X":
        return t < last and holds(parts[0], trace, t + 1)
    if kind == "N":
        return t >= last or holds(parts[0], trace, t + 1)
    if kind in ("F", "G"):
        first, end, inner = parts
        positions = range(t + first, min(last, last if end is None else t + end) + 1)
        return (any if kind == "F" else all)(holds(inner, trace, k) for k in positions)
    one, other = parts
    if kind == "U":
        return any(
            holds(other, trace, k) and all(holds(one, trace, j) for j in range(t, k)) for k in range(t, last + 1)
        )
    return all(holds(other, trace, k) or any(holds(one, trace, j) for j in range(t, k)) for k in range(t, last + 1))


# --- co-safe formulas: is a prefix good, whatever follows? ----------------------------------------------------
def _both(one: Obligations, other: Obligations) -> Obligations:
    return _least(a | b for a in one for b in other)


def _least(clauses: Iterable[Clause]) -> Obligations:
    """Clauses without those that ask for more than another one."""
    distinct = set(clauses)
    return frozenset(c for c in distinct if not any(other < c for other in distinct))


@cache
def _after(formula: Formula, letter: Letter) -> Obligations:
    """What remains of a formula once a letter was read."""
    kind, *parts = formula
    if kind in ("true", "false"):
        return TRUE if kind == "true" else FALSE
    if kind in ("is", "not"):
        return TRUE if (parts[0] in letter) == (kind == "is") else FALSE
    if kind == "and":
        return _both(_after(parts[0], letter), _after(parts[1], letter))
    if kind == "or":
        return _least(_after(parts[0], letter) | _after(parts[1], letter))
    if kind in ("X", "N"):
        return frozenset({frozenset({parts[0]})})
    if kind in ("F", "G"):
        first, end, inner = parts
        later = (kind, max(0, first - 1), None if end is None else end - 1, inner)
        if first > 0:
            return frozenset({frozenset({later})})
        now = _after(inner, letter)
        if end == 0:
            return now
        then: Obligations = frozenset({frozenset({later})})
        return _least(now | then) if kind == "F" else _both(now, then)
    one, other = parts
    then = frozenset({frozenset({formula})})
    if kind == "U":
        return _least(_after(other, letter) | _both(_after(one, letter), then))
    return _both(_after(other, letter), _least(_after(one, letter) | then))


class GoodPrefixes:
    """Whether prefixes satisfy a co-safe formula for good."""

    def __init__(self, formula: Formula) -> None:
        names = sorted(names_in(formula))
        self.letters = [frozenset(some) for n in range(len(names) + 1) for some in combinations(names, n)]
        self.names = frozenset(names)
        self.start: Obligations = frozenset({frozenset({formula})})
        self._next: dict[tuple[Obligations, Letter], Obligations] = {}
        self._good: dict[Obligations, bool] = {TRUE: True, FALSE: False}

    def after(self, state: Obligations, letter: Letter) -> Obligations:
        """Obligations after one more letter."""
        key = (state, letter & self.names)
        if key not in self._next:
            remaining = FALSE
            for clause in state:
                here = TRUE
                for obligation in clause:
                    here = _both(here, _after(obligation, key[1]))
                remaining = _least(remaining | here)
            self._next[key] = remaining
        return self._next[key]

    def is_good(self, state: Obligations) -> bool:
        """Whether every continuation satisfies: all of them reach ``TRUE`` (least fixed point)."""
        if state in self._good:
            return self._good[state]
        seen, frontier = {state}, [state]
        while frontier:
            for following in {self.after(frontier[-1], letter) for letter in self.letters} if frontier else ():
                if following not in seen and following not in self._good:
                    seen.add(following)
                    frontier.insert(0, following)
            frontier.pop()
        good: set[Obligations] = set()
        changed = True
        while changed:
            changed = False
            for one in seen - good:
                if all(self._good.get(f, f in good) for f in (self.after(one, letter) for letter in self.letters)):
                    good.add(one)
                    changed = True
        self._good |= {one: one in good for one in seen}
        return self._good[state]

    def satisfied(self, trace: Iterable[Letter]) -> int | None:
        """Position at which a trace is first good; None if it never is."""
        state = self.start
        for t, letter in enumerate(trace):
            state = self.after(state, letter)
            if self.is_good(state):
                return t
        return None


# --- agents --------------------------------------------------------------------------------------------------
def membership(agent: dict[str, Any], region: dict[str, Any], x: np.ndarray) -> np.ndarray:
    """Whether outputs of states (d, M) lie in a region: half-open, closed where it reaches the top of the workspace."""
    C = agent.get("output_matrix")
    y = x if C is None else np.array(C) @ x
    inside = np.ones(x.shape[1], dtype=bool)
    for k in range(len(y)):
        low, high = region["low"][k], region["high"][k]
        closed = C is None and high >= agent["state_high"][k]
        inside &= (y[k] >= low) & ((y[k] <= high) if closed else (y[k] < high))
    return inside


Act = Callable[[list[np.ndarray], list[dict[str, np.ndarray]], int], list[np.ndarray]]
"""Inputs (m, M) of each agent, from states (d, M), which propositions hold, and the time."""


def successes(spec: dict[str, Any], act: Act, episodes: int, seed: int) -> tuple[int, float]:
    """Episodes of the continuous system that satisfy the task; and how far inputs ever were outside their boxes.

    Parameters
    ----------
    spec : dict
        ``agents`` (list of arguments of ``LinearAgent``), ``propositions``, ``formula`` (tuple), ``semantics``,
        ``horizon``.
    act : callable
        The controllers.
    episodes : int
    seed : int
    """
    rng, agents = np.random.default_rng(seed), spec["agents"]
    winds = np.random.default_rng([seed, 2])
    factors, states = [], []
    for agent in agents:
        if "laws" in agent:
            factors.append(np.eye(len(agent["laws"])))
        else:
            values, vectors = np.linalg.eigh(np.array(agent["noise_covariance"], dtype=float))
            factors.append(vectors * np.sqrt(np.maximum(values, 0.0)))
        low = np.array(agent.get("initial_state") or agent["initial_low"], dtype=float)[:, None]
        high = np.array(agent.get("initial_state") or agent["initial_high"], dtype=float)[:, None]
        states.append(low + (high - low) * rng.random((len(low), episodes)))
    names = list(spec["propositions"])
    place = {agent["name"]: i for i, agent in enumerate(agents)}
    left = np.full(episodes, spec["horizon"] + 1)  # the time at which some agent is first outside
    words, beyond = np.zeros((episodes, spec["horizon"] + 1), dtype=np.int64), 0.0
    for t in range(spec["horizon"] + 1):
        for agent, x in zip(agents, states):
            low, high = (np.array(agent[side], dtype=float)[:, None] for side in ("state_low", "state_high"))
            outside = ~np.all((x >= low) & (x <= high), axis=0)
            left = np.where(outside & (left > t), t, left)
        held: list[dict[str, np.ndarray]] = [{} for _ in agents]
        for bit, name in enumerate(names):
            region = spec["propositions"][name]
            if "agents" in region:
                holds_now = _near(region, *(states[place[owner]] for owner in region["agents"]))
            else:
                i = place[region["agent"]]
                holds_now = held[i][name] = membership(agents[i], region, states[i])
            words[:, t] |= holds_now.astype(np.int64) << bit
        if t == spec["horizon"]:
            break
        inputs, told = act(states, held, t), dict[str, np.ndarray]()
        for agent, x, u in zip(agents, states, inputs):  # what expressions of others may name, before anybody moves
            low, high = (np.array(agent[side], dtype=float)[:, None] for side in ("input_low", "input_high"))
            told |= {f"{agent['name']}.x{k}": row for k, row in enumerate(x)}
            told |= {f"{agent['name']}.u{j}": row for j, row in enumerate(np.clip(u, low, high))}
        for i, (agent, x, u) in enumerate(zip(agents, states, inputs)):
            low, high = (np.array(agent[side], dtype=float)[:, None] for side in ("input_low", "input_high"))
            running = left > t
            if running.any():
                width = np.maximum(high - low, 1e-300)
                beyond = max(beyond, float(np.max((np.maximum(low - u, u - high) / width)[:, running])))
            if "tuples" in agent:
                applied = np.clip(u, low, high)
                noise = (
                    _uneven(agent, x, applied, rng) if "laws" in agent else factors[i] @ rng.standard_normal(x.shape)
                )
                states[i] = _bent(agent, x, applied, winds, told, spec.get("blowing", "")) + noise
                continue
            noise = factors[i] @ rng.standard_normal(x.shape)
            offset = np.array(agent.get("offset") or np.zeros(len(x)), dtype=float)[:, None]
            states[i] = np.array(agent["A"]) @ x + np.array(agent["B"]) @ u + offset + noise
    number = _count(spec, names, words, left)
    # A claim about an upper end is one about failures.
    return (episodes - number if spec.get("fails") else number), beyond


def _near(pair: dict[str, Any], first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Whether the difference of states (d, M) of two agents lies in a half-open box."""
    inside = np.ones(first.shape[1], dtype=bool)
    for low, high, k, m in zip(pair["low"], pair["high"], *pair["outputs"]):
        difference = first[k] - second[m]
        inside &= (difference >= low) & (difference < high)
    return inside


def _bent(
    agent: dict[str, Any], x: np.ndarray, u: np.ndarray, rng: np.random.Generator, told: dict[str, np.ndarray], way: str
) -> np.ndarray:
    """Means (d, M) of agents whose dynamics are nested tuples; disturbances jump between their ends.

    They jump at random, or, ``"outward"`` or ``"inward"``, to the ends that lead farthest from the middle of the
    workspace, or nearest to it, in its widths.
    """
    if way and agent["winds"]:
        middle = 0.5 * (np.array(agent["state_high"]) + np.array(agent["state_low"]))[:, None]
        width = (np.array(agent["state_high"]) - np.array(agent["state_low"]))[:, None]
        best, least = np.zeros(x.shape), np.full(x.shape[1], np.inf)
        for ends in product(*agent["winds"].values()):
            blown = {**agent, "winds": {name: (end, end) for name, end in zip(agent["winds"], ends)}}
            mean = _bent(blown, x, u, rng, told, "")
            far = np.sum(((mean - middle) / width) ** 2, axis=0) * (-1.0 if way == "outward" else 1.0)
            best, least = np.where(far < least, mean, best), np.minimum(far, least)
        return best
    values = {f"x{k}": row for k, row in enumerate(x)} | {f"u{j}": row for j, row in enumerate(u)} | told
    for name, ends in agent["winds"].items():
        values[name] = np.where(rng.random(x.shape[1]) < 0.7, ends[0], ends[1])
    with np.errstate(all="ignore"):
        rows = [value_of(expression, values) for expression in agent["tuples"]]
    return np.stack([np.broadcast_to(row, x.shape[1:]) for row in rows])


def _uneven(agent: dict[str, Any], x: np.ndarray, u: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Noise (d, M) of laws of its own, times scales of state and input."""
    values = {f"x{k}": row for k, row in enumerate(x)} | {f"u{j}": row for j, row in enumerate(u)}
    rows = []
    for law, scale in zip(agent["laws"], agent["scales"]):
        drawn = {
            "gaussian": lambda n, law=law: law["std"] * rng.standard_normal(n),
            "laplace": lambda n, law=law: rng.laplace(0.0, law["scale"], n),
            "logistic": lambda n, law=law: rng.logistic(0.0, law["scale"], n),
            "student-t": lambda n, law=law: law["scale"] * rng.standard_t(law["df"], n),
            "uniform": lambda n, law=law: rng.uniform(law["low"], law["high"], n),
            "triangular": lambda n, law=law: rng.triangular(law["low"], law["mode"], law["high"], n),
        }[law["law"]](x.shape[1])
        with np.errstate(all="ignore"):
            rows.append(np.broadcast_to(value_of(scale, values), drawn.shape) * drawn)
    return np.stack(rows)


def _count(spec: dict[str, Any], names: list[str], words: np.ndarray, left: np.ndarray) -> int:
    """How many of the words (M, T + 1) satisfy the task before, or without, leaving."""
    good, total = GoodPrefixes(spec["formula"]), 0
    distinct, numbers = np.unique(np.column_stack([words, left]), axis=0, return_counts=True)
    for row, number in zip(distinct, numbers):
        trace = [frozenset(name for bit, name in enumerate(names) if word >> bit & 1) for word in row[:-1].tolist()]
        gone = int(row[-1])
        if spec["semantics"] == "co-safe":
            at = good.satisfied(trace[:gone])
            total += int(number) if at is not None else 0
        elif gone > spec["horizon"]:
            total += int(number) * holds(spec["formula"], trace)
    return total
