"""Runs that keep all constraints so far are in the tube of the proof, their steps are in its boxes, and few fail.

Systems are random: nonlinear, of one or two agents that name one another, with shared noise, disturbances, the time,
boxes of starts, angles, sizes of noise that depend on the state, other distributions, no inputs. Runs come from a
simulator that shares no code with the checker. Steps are compared path by path, without any false alarm; the bound with
the share of runs that fail, with a false-alarm probability of 1e-6 for all comparisons together (Chernoff).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import pytest

from canonical_simulator import FUNCTIONS, Simulator
from certificate_files import file_of, one_crane
from certigym.synthesis.checker import check_contents, parse_file, read_problem, trajectories
from certigym.synthesis.checker.error_system import ErrorSystem
from certigym.synthesis.checker.fields import Refused
from certigym.synthesis.checker.letters import crossed, jumps

RUNS, COMPARISONS = 8000, 1000
ALARM = math.log(COMPARISONS / 1e-6)
TURN = 6.283185307179586

Header: TypeAlias = dict[str, Any]
Arrays: TypeAlias = list[np.ndarray]

LAWS: list[dict[str, Any]] = [
    {"law": "gaussian", "std": 0.7},
    {"law": "uniform", "low": -1.0, "high": 2.0},
    {"law": "triangular", "low": -1.0, "mode": 0.5, "high": 1.0},
    {"law": "truncated-gaussian", "spread": 1.0, "low": -1.5, "high": 1.5},
    {"law": "truncated-gaussian", "spread": 0.4, "low": -0.1, "high": 0.5},
    {"law": "laplace", "scale": 0.6},
    {"law": "logistic", "scale": 0.5},
    {
        "law": "mixture",
        "parts": [
            {"law": "gaussian", "std": 0.4, "weight": 1.0, "mean": -0.5},
            {"law": "uniform", "low": -0.3, "high": 0.3, "weight": 2.0, "mean": 0.4},
        ],
    },
]


def expression(rng: np.random.Generator, names: list[str], depth: int) -> str:
    if depth == 0 or rng.random() < 0.2:
        return str(rng.choice(names)) if rng.random() < 0.85 else repr(round(float(rng.normal()), 3))

    def inner() -> str:
        return expression(rng, names, depth - 1)

    kind = rng.random()
    if kind < 0.5:
        return f"({inner()}{rng.choice(('+', '-', '*'))}{inner()})"
    if kind < 0.6:
        return f"({inner()})/(2+({inner()})**2)"
    if kind < 0.7:
        return f"{rng.choice(('max', 'min'))}({inner()},{inner()})"
    if kind < 0.76:
        return f"sqrt(1+({inner()})**2)"
    if kind < 0.8:
        return f"exp(-1+.3*({inner()}))"
    return f"{rng.choice(('sin', 'cos', 'tanh', 'atan', 'abs'))}({inner()})"


@dataclass
class Team:
    """A random problem and nominal runs of it, before there are limits."""

    rng: np.random.Generator
    header: Header
    T: int
    scale: float
    gains: list[np.ndarray]
    inputs: list[np.ndarray]

    @property
    def agents(self) -> list[dict[str, Any]]:
        return list(self.header["problem"]["agents"])


def random_team(rng: np.random.Generator, trait: str) -> Team:
    """A team with a trait, and others by chance; workspaces and inputs are without limits yet."""
    n, T = 2 if trait in ("neighbours", "shared") else int(rng.integers(1, 3)), int(rng.integers(1, 5))
    ds = [int(rng.integers(1, 3)) for _ in range(n)]
    ms = [0 if trait == "no inputs" and i == 0 else int(rng.integers(1, 3)) for i in range(n)]
    scale = float(rng.choice((0.05, 0.15, 0.3)))
    shared = int(trait == "shared") + int(rng.random() < 0.2)
    agents = [_agent(rng, i, ds, ms, scale, trait, shared) for i in range(n)]
    gains = [-rng.random() * rng.normal(size=(T, m, d)) * 0.6 for d, m in zip(ds, ms)]
    inputs = [rng.normal(size=(T, m)) * 0.4 for m in ms]
    problem = {"horizon": T, "agents": agents, "regions": [], "pairs": [], "task": {}}
    return Team(rng, {"problem": problem}, T, scale, gains, inputs)


def _agent(
    rng: np.random.Generator, i: int, ds: list[int], ms: list[int], scale: float, trait: str, shared: int
) -> dict[str, Any]:
    d, m = ds[i], ms[i]
    states, inputs = [f"x{k}" for k in range(d)], [f"u{k}" for k in range(m)]
    disturbed = trait == "disturbances" or rng.random() < 0.2
    named = [*states, *inputs, *(["v"] if disturbed else []), *(["t"] if trait == "time" else [])]
    others = []
    if len(ds) == 2 and (trait == "neighbours" or rng.random() < 0.3):
        others = [f"a{1 - i}.x0", *([f"a{1 - i}.u0"] if ms[1 - i] else [])]
    A, B = 0.9 * np.eye(d) + 0.2 * rng.normal(size=(d, d)), 0.5 * rng.normal(size=(d, m))
    bend = float(rng.choice((0.0, 0.1, 0.3, 0.5)))
    dynamics = []
    for k in range(d):
        text = "+".join(f"({c:.3f})*{name}" for c, name in zip([*A[k], *B[k]], [*states, *inputs]))
        text += "".join(f"+({0.3 * rng.normal():.3f})*{name}" for name in others)
        text += f"+({0.3 * scale * rng.normal():.4f})*v" if disturbed else ""
        text += f"+{bend}*{expression(rng, [*named, *others], int(rng.integers(1, 3)))}" if bend else ""
        text += f"+{0.2 * rng.random():.2f}*t*{states[0]}" if trait == "time" else ""
        dynamics.append(text)
    noise = np.diag(rng.uniform(0.3, 1.0, d)) * scale
    if trait != "sizes" and rng.random() < 0.5:
        noise = rng.normal(size=(d, int(rng.integers(0, 3)))) * scale
    agent: dict[str, Any] = {
        "name": f"a{i}", "states": states, "inputs": inputs, "dynamics": dynamics, "outputs": [*states],
        "noise": noise.tolist(),
    }  # fmt: skip
    if disturbed:
        agent["disturbances"] = {"v": [-1.0, 0.5]}
    if shared:
        agent["shared_noise"] = (scale * rng.normal(size=(d, shared)) * 0.6).tolist()
    if trait == "laws" or (trait == "sizes" and rng.random() < 0.5):
        agent["distributions"] = [LAWS[int(rng.integers(len(LAWS)))] for _ in range(noise.shape[1])]
    if trait == "sizes":
        # one of them changes its sign
        agent["noise_scale"] = [
            str(rng.choice((f"1+0.5*sin({x})", f"0.6+{x}", f"0.5+0.2*{named[-1]}"))) for x in states
        ]
    if rng.random() < 0.4:
        agent["outputs"].append(expression(rng, states, 2))
    start = rng.normal(size=d)
    width = scale * 0.4 * rng.choice([0.0, 1.0], d) if trait == "starts" else np.zeros(d)
    if trait == "angles":
        # the first state is an angle, which dynamics repeat
        agent["angles"] = ["x0"]
        agent["dynamics"][0] = "x0" + (f"+0.7*{inputs[0]}" if m else "+0.5") + f"+{bend}*sin(x0)"
        for k in range(1, d):
            agent["dynamics"][k] = f"0.9*x{k}+0.4*cos({int(rng.integers(1, 3))}*x0)+0.2*{inputs[-1]}"
        agent["outputs"] = [*states, "sin(x0)"]
        start[0] = rng.uniform(-3.0, 3.0)
    agent["start_low"], agent["start_high"] = (start - width).tolist(), (start + width).tolist()
    return agent


class World:
    """Runs of a team under the controller of a proof; every step is recorded."""

    def __init__(self, team: Team, nominal: list[np.ndarray] | None) -> None:
        self.team, self.simulator, self.nominal = team, Simulator(team.header["problem"]), nominal

    def runs(self, n: int, mode: int, limits: list[np.ndarray] | None = None) -> Iterator[dict[str, Any]]:
        """Yield time, states, inputs before and after they are clipped, noise less its mean, and mean numbers."""
        rng, agents = self.team.rng, self.team.agents
        x = [self._starts(agent, n, mode) for agent in agents]
        for t in range(self.team.T + 1):
            if t == self.team.T:
                yield {"t": t, "x": x}
                return
            asked = [self._inputs(i, x[i], t) for i in range(len(agents))]
            u = asked if limits is None else [np.clip(own, *box[:, :, None]) for own, box in zip(asked, limits)]
            v = [self._disturbances(agent, x[0], mode) for agent in agents]
            drift, noise = self.simulator.means(x, u, v, t), self.simulator.noise(rng, x, u, t, v)
            after = [a + b for a, b in zip(drift, noise, strict=True)]
            yield {"t": t, "x": x, "asked": asked, "after": after, "noise": noise, "u": u, "v": v}
            x = self.simulator.wrapped([own.copy() for own in after])

    def _starts(self, agent: dict[str, Any], n: int, mode: int) -> np.ndarray:
        low, high = (np.array(agent[key])[:, None] for key in ("start_low", "start_high"))
        share = self.team.rng.random((len(low), n))
        return np.asarray(low + (np.rint(share) if mode % 2 else share) * (high - low))

    def _inputs(self, i: int, x: np.ndarray, t: int) -> np.ndarray:
        nominal, gain = self.team.inputs[i][t][:, None], self.team.gains[i][t]
        if self.nominal is None:
            return np.repeat(nominal, x.shape[1], axis=1)
        return np.asarray(nominal + gain @ self.errors(i, x, t))

    def errors(self, i: int, x: np.ndarray, t: int) -> np.ndarray:
        """Errors (d, n) of an agent, of angles less whole turns."""
        assert self.nominal is not None
        error = x - self.nominal[i][t][:, None]
        agent = self.team.agents[i]
        for angle in agent.get("angles", []):
            k = agent["states"].index(angle)
            error[k] = np.mod(error[k] + np.pi, 2.0 * np.pi) - np.pi
        return np.asarray(error)

    def _disturbances(self, agent: dict[str, Any], x: np.ndarray, mode: int) -> dict[str, Any]:
        ends = agent.get("disturbances", {})
        sign = (0.5, 1.0, 0.0, (np.sign(x[0] - x[0].mean()) + 1.0) / 2.0)[mode % 4]
        return {name: low + sign * (high - low) for name, (low, high) in ends.items()}


def with_limits(team: Team) -> tuple[Header, Arrays] | None:
    """A file: nominal runs, workspaces and boxes of inputs about as large as runs need, tubes and letters."""
    rng, T = team.rng, team.T
    world = World(team, None)
    quiet = Simulator({**team.header["problem"]})
    states = [np.array([0.5 * (np.array(a["start_low"]) + np.array(a["start_high"]))]) for a in team.agents]
    for t in range(T):
        x = [own[-1][:, None] for own in states]
        u = [own[t][:, None] for own in team.inputs]
        v = [{name: 0.5 * (low + high) for name, (low, high) in a.get("disturbances", {}).items()} for a in team.agents]
        means = quiet.means(x, u, v, t)
        states = [np.concatenate([own, mean.T]) for own, mean in zip(states, means, strict=True)]
    if rng.random() < 0.3:  # nominal runs need not be runs
        for own in states:
            own[1:] += 0.1 * team.scale * rng.normal(size=own[1:].shape)
    if not all(np.all(np.abs(own) < 30.0) for own in states):
        return None
    world = World(team, states)
    wide = list(_in_wide_workspaces(team, world, states))
    if not all(np.all(np.isfinite(error)) for step in wide for error in step["e"]):
        return None
    size = float(rng.uniform(2.0, 5.0))
    arrays: Arrays = []
    entries, boxes = [], []
    for i, agent in enumerate(team.agents):
        deviation = np.array([np.sqrt((step["e"][i] ** 2).mean(axis=1)) for step in wide]) + 1e-6
        asked = [np.abs(step["asked"][i] - team.inputs[i][step["t"]][:, None]) for step in wide[:-1]]
        _set_boxes(agent, states[i], size * deviation * rng.uniform(0.9, 2.0), rng)
        room = np.array([own.max(axis=1) for own in asked]).reshape(T, -1).max(axis=0) * rng.uniform(0.5, 1.5) + 1e-6
        middle = team.inputs[i]
        low, high = middle.min(axis=0, initial=0.0) - room, middle.max(axis=0, initial=0.0) + room
        agent["input_low"], agent["input_high"] = low.tolist(), high.tolist()
        boxes.append(np.stack([low, high]))
        widths = np.concatenate([deviation, np.full((T + 1, len(low)), np.inf)], axis=1) * rng.uniform(1.5, 5.0)
        if rng.random() < 0.2 and not agent.get("angles"):
            widths[:] = np.inf
        if agent.get("angles"):
            widths[:, 0] = np.minimum(widths[:, 0], 1.5)
        k = 3 + len(arrays)
        entries.append({"inputs": k, "gains": k + 1, "states": k + 2, "widths": k + 3})
        arrays += [team.inputs[i], team.gains[i], states[i], widths]
    letters, faces, task = _letters(team, world, wide)
    team.header["problem"]["task"] = task
    proof = {"kind": "trajectory", "letters": 0, "faces": 1, "normals": 2, "agents": entries}
    header = {
        "format": "certigym-certificate",
        "version": 3,
        "name": "random",
        "problem": team.header["problem"],
        "claim": {"failure": 1.0},
        "proof": proof,
    }
    return header, [letters, faces, np.zeros((T + 1, 0)), *arrays]


def _in_wide_workspaces(team: Team, world: World, states: list[np.ndarray]) -> Iterator[dict[str, Any]]:
    """Runs without limits, with their errors; angles are reduced into a turn around 0."""
    for agent in team.agents:
        d = len(agent["states"])
        agent["state_low"], agent["state_high"] = [-1e9] * d, [1e9] * d
        for angle in agent.get("angles", []):
            k = agent["states"].index(angle)
            agent["state_low"][k], agent["state_high"][k] = -0.5 * TURN, 0.5 * TURN
    for step in world.runs(500, 0):
        yield {**step, "e": [world.errors(i, step["x"][i], step["t"]) for i in range(len(states))]}


def _set_boxes(agent: dict[str, Any], states: np.ndarray, reach: np.ndarray, rng: np.random.Generator) -> None:
    low, high = (states - reach).min(axis=0), (states + reach).max(axis=0)
    low = np.minimum(low, np.array(agent["start_low"]) - 1e-3)
    high = np.maximum(high, np.array(agent["start_high"]) + 1e-3)
    for k, name in enumerate(agent["states"]):
        if name not in agent.get("angles", []):
            agent["state_low"][k], agent["state_high"][k] = float(low[k]), float(high[k])


def _letters(team: Team, world: World, wide: list[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray, dict[str, Any]]:
    """Letters of random regions that most runs have, and the automaton that asks for just these."""
    rng, T = team.rng, team.T
    regions, letters, faces = team.header["problem"]["regions"], [], []
    for p in range(int(rng.integers(0, 4))):
        t, i = int(rng.integers(1, T + 1)), int(rng.integers(len(team.agents)))
        agent = team.agents[i]
        k = int(rng.integers(len(agent["outputs"])))
        local = {**FUNCTIONS, **dict(zip(agent["states"], wide[t]["x"][i], strict=True))}
        with np.errstate(all="ignore"):
            values = np.broadcast_to(eval(agent["outputs"][k].replace("^", "**"), {}, local), 500)
        a, b = np.quantile(values, (0.02, 0.97)) + np.array([-0.3, 0.3]) * np.ptp(values) * float(rng.random() < 0.7)
        ends: list[Any] = [[None] * len(agent["outputs"]) for _ in range(2)]
        face = int(rng.integers(2))
        value = 1 if rng.random() < 0.5 else -1
        if value > 0:
            ends[0][k], ends[1][k] = (float(a), None) if face else (float(a), float(b) + 1e-9)
        else:  # keep away from what is beyond b, or before a
            ends[face][k], ends[1 - face][k] = (float(a), float(a) - 9.0) if face else (float(b), float(b) + 9.0)
        regions.append({"name": f"r{p}", "agent": i, "low": ends[0], "high": ends[1]})
        row, side = np.zeros(T + 1, dtype=np.int8), np.full(T + 1, -1, dtype=np.int32)
        row[t], side[t] = value, 2 * k + face
        letters.append(row)
        faces.append(side)
    shape = (T + 1, len(regions))
    rows, sides = (np.array(own, dtype=own[0].dtype if own else np.int32).T.reshape(shape) for own in (letters, faces))
    return rows.astype(np.int8), sides, {"semantics": "finite-trace", "automaton": _automaton_of(rows)}


def _automaton_of(letters: np.ndarray) -> dict[str, Any]:
    """State t reads the letter of time t, which has to be what the letters say; the last state but one accepts."""
    T, root, variable, low, high = len(letters) - 1, [], [], [], []
    nowhere = -1 - (T + 2)
    for t in range(T + 1):
        entry = -1 - (t + 1)
        for p in reversed(np.flatnonzero(letters[t]).tolist()):
            variable.append(p)
            low.append(nowhere if letters[t, p] > 0 else entry)
            high.append(entry if letters[t, p] > 0 else nowhere)
            entry = len(variable) - 1
        root.append(entry)
    accepting = [False] * (T + 1) + [True, False]
    return {
        "initial": 0,
        "accepting": accepting,
        "root": [*root, nowhere, nowhere],
        "variable": variable,
        "low": low,
        "high": high,
    }


@dataclass
class Spied:
    """Tubes (2, D), matrices F, boxes (2, D), half widths and factors of the noise, as the check had them."""

    tubes: list[np.ndarray]
    steps: list[tuple[np.ndarray, ...]]


def bound_of(header: Header, arrays: Arrays, monkeypatch: pytest.MonkeyPatch) -> tuple[float, Spied] | None:
    """The failure that the checker proves, and what it computed on the way; nothing if it refuses."""
    spied = Spied([], [])
    contents = parse_file(file_of(header, arrays))
    problem = read_problem(contents.header)
    proof = trajectories.read_proof(contents, problem)
    advance, step = trajectories.advance, ErrorSystem.step

    def seen(joint: Any, tube: Any) -> None:
        spied.tubes.append(tube.ends.copy())
        advance(joint, tube)

    def stepped(self: ErrorSystem, *own: np.ndarray) -> None:
        spied.steps.append(tuple(array.copy() for array in own))
        step(self, *own)

    with monkeypatch.context() as patch, np.errstate(all="ignore"):
        patch.setattr(trajectories, "advance", seen)
        patch.setattr(ErrorSystem, "step", stepped)
        try:
            return trajectories.failure_of(problem, proof)[0], spied
        except Refused:
            return None


def centred(team: Team, problem: Any, step: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Noise (D, n) of a step less its mean, and sizes (D, n) that multiply it."""
    parts, sizes = [], []
    everything = (team.agents, problem.agents, *(step[key] for key in ("x", "u", "v", "noise")))
    for agent, own, x, u, v, noise in zip(*everything, strict=True):
        local: dict[str, Any] = {**FUNCTIONS, "t": float(step["t"])}
        local |= dict(zip(agent["states"], x, strict=True)) | dict(zip(agent["inputs"], u, strict=True)) | v
        scale = np.ones_like(x)
        for k, text in enumerate(agent.get("noise_scale", [])):
            scale[k] = eval(text, {}, local)
        mean = own.noise @ np.array([envelope.mean for envelope in own.envelopes])
        parts.append(noise - scale * mean[:, None])
        sizes.append(scale)
    return np.concatenate(parts), np.concatenate(sizes)


def check_paths(team: Team, header: Header, arrays: Arrays, spied: Spied, mode: int) -> tuple[int, float]:
    """Count the steps of runs that kept everything so far: every one in the tube and in the boxes.

    Also returned: the share of runs that did not keep everything until the end.
    """
    problem = read_problem(header)
    nominal, D = [arrays[3 + 4 * i + 2] for i in range(len(team.agents))], spied.tubes[0].shape[1]
    world = World(team, nominal)
    limits = [np.array([agent["input_low"], agent["input_high"]]).reshape(2, -1) for agent in team.agents]
    widths = np.concatenate([arrays[3 + 4 * i + 3][:, : len(a["states"])] for i, a in enumerate(team.agents)], axis=1)
    kept, g, count = np.ones(RUNS, dtype=bool), np.zeros((D, RUNS)), 0
    turning = np.concatenate([[name in agent.get("angles", []) for name in agent["states"]] for agent in team.agents])
    before, noise = None, np.zeros((D, RUNS))
    for step in world.runs(RUNS, mode, limits):
        t = step["t"]
        e = np.concatenate([world.errors(i, step["x"][i], t) for i in range(len(nominal))])
        if before is not None:  # the step from t - 1, of runs that kept everything until then
            F, pushed, _, _, _ = spied.steps[t - 1]
            rest = e - F @ before - noise
            rest[turning] = np.mod(rest[turning] + np.pi, 2 * np.pi) - np.pi
            spare = 1e-9 * (1.0 + np.abs(e).max() + np.abs(before).max())
            inside = np.all((rest >= pushed[0][:, None] - spare) & (rest <= pushed[1][:, None] + spare), axis=0)
            assert inside[kept].all(), ("box", t)
        if t:
            kept &= np.all(np.abs(g) <= widths[t][:, None], axis=0) & world.simulator.in_workspace(step["x"])
            for value, holds in zip(arrays[0][t], world.simulator.letters(step["x"], t), strict=True):
                kept &= holds if value > 0 else ~holds if value < 0 else True
        if t == team.T:
            break
        tube = spied.tubes[t]
        within = np.all((e >= tube[0][:, None] - 1e-9) & (e <= tube[1][:, None] + 1e-9), axis=0)
        assert within[kept].all(), ("tube", t)
        for asked, box in zip(step["asked"], limits, strict=True):
            kept &= np.all((asked >= box[0][:, None]) & (asked <= box[1][:, None]), axis=0)
        count += int(kept.sum())
        noise, sizes = centred(team, problem, step)
        F, _, reach, factor, _ = spied.steps[t]
        assert np.all(np.abs(tube) <= reach + 1e-9)
        # sizes of noise on the tube are at most those of the proof
        own = problem.noise
        most = np.abs(own)[:, :, None] * np.abs(sizes[:, None, :] if any(a.scale for a in problem.agents) else 1.0)
        if any(a.scale for a in problem.agents):
            shared = own.shape[1] - problem.agents[0].shared_noise.shape[1]
            assert np.all(most[:, :shared][:, :, kept] <= np.abs(factor[:, :shared])[:, :, None] + 1e-9)
        else:
            assert np.array_equal(np.abs(factor), np.abs(own))
        g = F @ g + noise
        before = e
    return count, float(1.0 - kept.mean())


def excess(share: float, claim: float) -> float:
    """Logarithm of how improbable it is that this share of runs fails or more, if the claim is true (Chernoff)."""
    if share <= claim:
        return 0.0
    if claim <= 0.0 or share >= 1.0:
        return math.inf if claim <= 0.0 else -RUNS * math.log(claim)
    return RUNS * (share * math.log(share / claim) + (1 - share) * math.log((1 - share) / (1 - claim)))


TRAITS = ("plain", "neighbours", "shared", "disturbances", "time", "starts", "sizes", "laws", "angles", "no inputs")


def compare(trait: str, seed: int, wanted: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs of random teams with a trait, until so many bounds say something."""
    rng, useful, steps, tightest = np.random.default_rng(seed), 0, 0, 0.0
    for _ in range(12 * wanted):
        if useful == wanted:
            break
        team = random_team(rng, trait)
        made = with_limits(team)
        found = made and bound_of(*made, monkeypatch)
        if not made or not found or not 1e-6 < found[0] < 0.6:
            continue
        header, arrays = made
        useful += 1
        several = any(agent.get("disturbances") for agent in team.agents) or trait == "starts"
        for mode in range(4 if several else 1):
            with np.errstate(all="ignore"):
                count, broken = check_paths(team, header, arrays, found[1], mode)
                share = failing(team, header, arrays, mode)
            # the bound is on all that is asked, of which only a part is the task
            assert max(excess(share, found[0]), excess(broken, found[0])) < ALARM, (
                trait,
                mode,
                found[0],
                share,
                broken,
            )
            steps, tightest = steps + count, max(tightest, broken / found[0])
    assert useful == wanted and steps > RUNS
    assert tightest > 0.1


def failing(team: Team, header: Header, arrays: Arrays, mode: int) -> float:
    """The share of runs that fail: they leave a workspace, or their word is not accepted."""
    simulator, n = Simulator(header["problem"]), RUNS
    nominal = [arrays[3 + 4 * i + 2] for i in range(len(team.agents))]
    limits = [np.array([agent["input_low"], agent["input_high"]]).reshape(2, -1) for agent in team.agents]
    letters, alive = arrays[0], np.ones(n, dtype=bool)
    for step in World(team, nominal).runs(n, mode, limits):
        t = step["t"]
        if t:
            alive &= simulator.in_workspace(step["x"])
            for p, holds in enumerate(simulator.letters(step["x"], t)):
                alive &= holds if letters[t, p] > 0 else ~holds if letters[t, p] < 0 else True
    return float(1.0 - alive.mean())


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("trait", TRAITS)
def test_random_teams_do_what_the_proof_says(trait: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compare(trait, TRAITS.index(trait), 5, monkeypatch)


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("trait", TRAITS)
def test_many_random_teams_do_what_the_proof_says(trait: str, monkeypatch: pytest.MonkeyPatch) -> None:
    compare(trait, 100 + TRAITS.index(trait), 20, monkeypatch)


def test_runs_keep_what_is_asked_in_windows_as_often_as_is_said() -> None:
    """Of runs that cross a window the share that does not keep its limits, or jumps, is at most the bound."""
    rng, tightest, useful = np.random.default_rng(50), 0.0, 0
    for _ in range(16):
        header, arrays = one_crane()
        agent = header["problem"]["agents"][0]
        s, bend = float(rng.uniform(0.1, 0.3)), float(rng.choice((0.0, 0.2)))
        agent["distributions"][1] = {"law": "gaussian", "std": s}
        agent["outputs"] = ["a", f"y + {bend}*sin(y)"]
        agent["dynamics"][1] = f"y + lift + {bend}*cos(y)"
        if rng.random() < 0.5:
            del agent["noise_scale"]
        header["problem"]["regions"][0].update(low=[None, float(rng.uniform(1.2, 2.0))], high=[None, 3.6])
        y = [0.0]
        for lift in arrays[3][:, 1]:
            y.append(y[-1] + lift + bend * math.cos(y[-1]))
        arrays[5][:, 1] = y
        arrays[6][:, 1] = 2.0
        bound = check_contents(parse_file(file_of(header, arrays))).recomputed
        if bound < 0.8:
            useful += 1
            broken = broken_in_windows(header, arrays, rng)
            assert excess(broken, bound) < ALARM, (bound, broken)
            tightest = max(tightest, broken / bound)
    assert useful > 4 and tightest > 0.2


def broken_in_windows(header: Header, arrays: Arrays, rng: np.random.Generator) -> float:
    """The share of runs of the crane that leave what is asked of its height."""
    problem, simulator = read_problem(header), Simulator(header["problem"])
    letters, faces = (own.astype(np.int64) for own in arrays[:2])
    x, kept, before = [np.tile(arrays[5][0][:, None], (1, RUNS))], np.ones(RUNS, dtype=bool), None
    for t in range(len(letters)):
        output = header["problem"]["agents"][0]["outputs"][1]
        y = eval(output, {}, {**FUNCTIONS, "y": x[0][1]}) + np.zeros(RUNS)
        for demand in crossed(problem, letters, faces, t) if t else ():
            if demand.parts[0][1] == 1:
                kept &= (demand.low <= y) & (y < demand.high)
        for jump in jumps(problem, letters, faces, t) if t else ():
            kept &= (jump.low < y - before) & (y - before < jump.high)
        if t == len(letters) - 1:
            break
        before = y
        error = x[0] - arrays[5][t][:, None]
        error[0] = np.mod(error[0] + np.pi, 2.0 * np.pi) - np.pi
        u = [arrays[3][t][:, None] + arrays[4][t] @ error]
        drift, noise = simulator.means(x, u, [{}], t), simulator.noise(rng, x, u, t, [{}])
        x = simulator.wrapped([drift[0] + noise[0]])
    return float(1.0 - kept.mean())
