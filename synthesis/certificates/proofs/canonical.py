"""Problems and certificates in the form that the checker reads: everything written out, nothing left to expand.

Families, shapes, units, moving corners and covariances are sugar. Here they become agents with expressions, limits on
outputs for each time, factors of noise, and one formula over plain names (docs/reference/certificate_format.md). The
checker trusts nothing of it: a test compares the simulator with one that is written from the canonical problem alone.
"""

from __future__ import annotations

import io
import json
import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from ....envs.systems.agents import Agent, AnyAgent, LinearAgent
from ....envs.systems.arguments import write_bytes
from ....envs.systems.distributions import Law
from ....envs.tasks.automata import Formula, parse_formula
from ....envs.tasks.problem import Problem
from ...checker import (
    FORMAT,
    VERSION,
    CheckedAgent,
    Contents,
    Refused,
    Unreadable,
    Verdict,
    affine_dynamics,
    bound_of,
    check_angles,
    check_contents,
    read_problem,
    shown,
)
from ...relations.grids import FloatArray
from ...relations.kinds import JointNetworkPolicy, SymbolicPolicy, seen_jointly
from ..beliefs import alarm
from ..cell_probabilities import AgentRecord
from ..value_functions import tree_rows
from .certificate import Certificate
from .grid_proof import GridProof
from .path_proof import AgentPath, PathProof
from .proof import FailureProof
from .starts_proof import Cut, StartsProof


class NotCanonicalError(ValueError):
    """A problem or a proof that the canonical form has no words for yet; the message says which part."""


def canonical_problem(problem: Problem) -> dict[str, Any]:
    """Return a problem in canonical form, as plain values (exact, but for square roots of covariances).

    Raises
    ------
    NotCanonicalError
        If it has independent tasks, noise of a distribution of scipy, or is the opposite of a task.
    """
    if problem.groups:
        raise NotCanonicalError("independent tasks that are not joined have no canonical form yet")
    names = _plain_names(problem.labeling.names)
    return {
        "horizon": problem.horizon,
        "agents": [_agent(problem, i) for i in range(problem.n_agents)],
        "regions": _regions(problem, names),
        "pairs": _pairs(problem, names),
        "task": _task(problem, names),
    }


class ClaimsMoreError(ValueError):
    """A certificate claims more than the checker proves of it, by more than rounding; its numbers are lower bounds."""

    def __init__(self, claimed: float, proved: float) -> None:
        self.claimed, self.proved = claimed, proved
        text = f"it claims P >= {claimed:.15g}, and the checker proves P >= {proved:.15g} of it"
        super().__init__(f'`certificate`: {text}; claim what is proved (`claim="proved"`), or make it anew')


def canonical_bytes(certificate: Certificate, claim: str = "same") -> bytes:
    """Return the file of a certificate in canonical form, with the bound that the checker proves of it.

    What the search believed of it stands in the notes, on which nothing rests.

    Parameters
    ----------
    certificate : Certificate
    claim : "same" or "proved"
        Whether a certificate that claims more than the checker proves is refused, or claims what is proved.

    Raises
    ------
    NotCanonicalError
        If its problem or its proof has no canonical form yet.
    ClaimsMoreError
        If it claims more than the checker proves, and nobody said that it may claim less.
    ValueError
        If the checker refuses it.
    """
    if claim not in ("same", "proved"):
        raise ValueError(f"`claim`: expected same or proved, got {claim!r}")
    header, arrays, verdict = _judged(certificate)
    if not verdict.proved:
        raise ValueError(f"`certificate`: the checker refuses it: {verdict.reason}")
    claimed = (
        certificate.proof.failure if isinstance(certificate.proof, FailureProof) else 1.0 - certificate.lower_bound
    )
    # what is no number claims more, too
    if claim == "same" and not verdict.recomputed <= claimed * (1.0 + SLACK) + LEAST:
        raise ClaimsMoreError(certificate.lower_bound, bound_of(verdict.recomputed))
    believed = certificate.settings.get("believed")
    notes = {} if believed is None else {"notes": {"believed": believed}}
    return archive({**header, "claim": {"failure": min(1.0, verdict.recomputed * CLAIMED)}, **notes}, arrays)


def alarm_of(certificate: Certificate, verdict: Verdict) -> str:
    """Return how what the search believed of a certificate differs from what the checker recomputed, in words."""
    return alarm(certificate.settings.get("believed"), verdict)


def verdict_of(certificate: Certificate) -> Verdict:
    """Return what the checker proves of a certificate, whatever it claims.

    ``recomputed`` is an upper bound on the probability that the task fails; 1 if nothing is proved.

    Raises
    ------
    NotCanonicalError
        If its problem or its proof has no canonical form yet.
    """
    return _judged(certificate)[2]


def wrong_angles(problem: Problem) -> str:
    """Return why states that are said to be angles are none; nothing if they are.

    Runs on cells need it as those along trajectories do, whatever the task: the one that is looked at is always true.
    """
    if not any(agent.angles for agent in problem.agents):
        return ""
    names = _plain_names(problem.labeling.names)
    always = {"initial": 0, "accepting": [True], "root": [-1], "variable": [], "low": [], "high": []}
    header = {
        "horizon": problem.horizon,
        "agents": [_agent(problem, i) for i in range(problem.n_agents)],
        "regions": _regions(problem, names),
        "pairs": _pairs(problem, names),
        "task": {"semantics": "co-safe", "automaton": always},
    }
    try:
        check_angles(read_problem({"problem": header}))
    except (Refused, Unreadable) as reason:
        return str(reason)
    return ""


def checker_text(certificate: Certificate) -> str:
    """Return what the checker proves of a certificate, in words; else that only the extended check reads it."""
    try:
        verdict = verdict_of(certificate)
    except NotCanonicalError as reason:
        return f"extended check: the small checker does not read it yet ({reason})"
    if not verdict.proved:
        return f"extended check: the small checker proves nothing ({verdict.reason})"
    told = alarm_of(certificate, verdict)
    more = f"; {told}" if told else ""
    return f"the small checker proves P >= {shown(verdict.recomputed)} by {', '.join(verdict.modules)}{more}"


def _judged(certificate: Certificate) -> tuple[dict[str, Any], list[np.ndarray], Verdict]:
    """Return header and arrays of a file that claims nothing, and the verdict on them."""
    try:
        header, arrays = _contents(certificate)
        file = sha256(archive(header, arrays)).digest()
        if file not in _verdicts:
            _verdicts[file] = check_contents(Contents(header, tuple(arrays), set()))
        return header, arrays, _verdicts[file]
    except Unreadable as reason:  # more than the format has words for: laws of users, say
        raise NotCanonicalError(str(reason)) from reason


_verdicts: dict[bytes, Verdict] = {}
"""Verdicts by what the checker read: a search asks it before it claims, and who prints the claim asks again."""


def contents_of(certificate: Certificate) -> Contents:
    """Return what the checker reads of a certificate that claims nothing."""
    header, arrays = _contents(certificate)
    return Contents(header, tuple(arrays), set())


def _contents(certificate: Certificate) -> tuple[dict[str, Any], list[np.ndarray]]:
    """Return header and arrays of a file that claims nothing."""
    proof, problem = certificate.proof, certificate.problem
    write = _WRITERS.get(type(proof))
    if write is None:
        raise NotCanonicalError(f"proofs of the kind {proof.kind!r} have no canonical form yet")
    arrays: list[np.ndarray] = []
    header = {
        "format": FORMAT,
        "version": VERSION,
        "name": problem.name,
        "problem": canonical_problem(problem),
        "claim": {"failure": 1.0},
        "proof": write(problem, proof, arrays),
    }
    return header, arrays


CLAIMED = 1.0 + 1e-9
"""Factor on the failure that is claimed: other machines add in another order, and prove the same up to rounding."""

SLACK, LEAST = 1e-6, 1e-12
"""By how much what is proved may fail more often than what is claimed, relatively and besides: by rounding."""


def require_about(contents: Contents, problem: Problem | None) -> None:
    """Raise ValueError if a file is about another problem than the one that is given."""
    if problem is not None:
        inside, asked = contents.header["problem"], json.loads(json.dumps(canonical_problem(problem)))
        if differing := [key for key in asked if asked[key] != inside.get(key)]:
            raise ValueError(f"`problem`: the certificate is about another one, with other {', '.join(differing)}")


def save_canonical(certificate: Certificate, path: str | Path, claim: str = "same") -> None:
    """Write the file of a certificate in canonical form (see ``canonical_bytes``)."""
    write_bytes(path, canonical_bytes(certificate, claim))


def archive(header: Mapping[str, Any], arrays: Sequence[np.ndarray]) -> bytes:
    """Return the bytes of a file: the same for the same content, on every machine."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as target:
        target.writestr(zipfile.ZipInfo("header.json"), json.dumps(header, allow_nan=False))
        for number, array in enumerate(arrays):
            member = io.BytesIO()
            np.lib.format.write_array(member, array, version=(1, 0), allow_pickle=False)
            target.writestr(zipfile.ZipInfo(f"{number}.npy"), member.getvalue())
    return file.getvalue()


# Agents.


def _agent(problem: Problem, i: int) -> dict[str, Any]:
    agent, written = problem.agents[i], problem.written_agents[i]
    if any(map(_is_of_scipy, agent.laws or ())):
        raise NotCanonicalError(f"agent `{agent.name}` has noise of a distribution of scipy")
    shared = problem.shared_noise[i]
    data: dict[str, Any] = {
        "name": agent.name,
        "outputs": _outputs(agent),
        "state_low": agent.state_low.tolist(),
        "state_high": agent.state_high.tolist(),
        "input_low": agent.input_low.tolist(),
        "input_high": agent.input_high.tolist(),
        "start_low": agent.initial.low.tolist(),
        "start_high": agent.initial.high.tolist(),
        "noise": agent.noise_axes.tolist(),
    }
    if agent.laws is None:
        data["noise"] = _columns(written.noise_factor if shared.size else agent.noise_factor)
    else:
        data["distributions"] = [law.to_dict() for law in agent.laws]
    if agent.noise_scale is not None:
        data["noise_scale"] = list(agent.noise_scale)
    if isinstance(agent, LinearAgent):
        data |= {"states": _numbered("x", agent.n_states), "inputs": _numbered("u", agent.n_inputs)}
        data |= {"A": agent.A.tolist(), "B": agent.B.tolist(), "c": agent.offset.tolist()}
    else:
        assert isinstance(agent, Agent)
        data |= {"states": list(agent.states), "inputs": list(agent.inputs), "dynamics": list(agent.dynamics)}
        data |= {"parameters": dict(agent.parameters)} if agent.parameters else {}
        ranges = {name: [low, high] for name, (low, high) in agent.disturbances.items()}
        data |= {"disturbances": ranges} if ranges else {}
    data |= {"angles": list(agent.angles)} if agent.angles else {}
    return data | ({"shared_noise": shared.tolist()} if shared.shape[1] else {})


def _is_of_scipy(law: Law) -> bool:
    """Return whether a law, or a part of it, is one of ``scipy.stats``."""
    return law.name == "scipy" or any(map(_is_of_scipy, getattr(law, "laws", ())))


def _numbered(letter: str, count: int) -> list[str]:
    return [f"{letter}{k}" for k in range(count)]


def _columns(factor: FloatArray) -> list[list[float]]:
    """Return a factor of noise without the sources that reach nothing."""
    kept: list[list[float]] = factor[:, np.any(factor != 0.0, axis=0)].tolist()
    return kept


def _outputs(agent: AnyAgent) -> list[str]:
    """Return outputs as texts in the states."""
    if not isinstance(agent, LinearAgent):
        assert isinstance(agent, Agent)
        return list(agent.output_expressions)
    rows = agent.output_matrix
    return [" + ".join(_term(float(c), f"x{k}") for k, c in enumerate(row) if c) or "0" for row in rows]


def _term(factor: float, name: str) -> str:
    return name if factor == 1.0 else f"{factor!r}*{name}"


# Propositions.


def _plain_names(names: Sequence[str]) -> dict[str, str]:
    """Return a name of letters, digits and underscores for each proposition."""
    plain: dict[str, str] = {}
    for name in names:
        candidate = re.sub(r"[^A-Za-z0-9_]", "_", name)
        while candidate in plain.values():
            candidate += "_"
        plain[name] = candidate
    return plain


def _regions(problem: Problem, names: Mapping[str, str]) -> list[dict[str, Any]]:
    labeling, regions = problem.labeling, []
    times = range(problem.horizon + 1) if labeling.moving else [0]
    for i, positions in enumerate(labeling.agent_propositions):
        for column, position in enumerate(positions.tolist()):
            corners = [_corners(here.low[i][:, column], here.high[i][:, column]) for here in map(labeling.at, times)]
            low, high = ([list(corner) for corner in each] for each in zip(*corners, strict=True))
            name = names[labeling.names[position]]
            regions.append({"name": name, "agent": i, "low": _over_time(low), "high": _over_time(high)})
    return regions


def _corners(low: FloatArray, high: FloatArray) -> tuple[list[float | None], list[float | None]]:
    """Return corners of a region at a time; null where there is no limit."""
    if np.any(low == np.inf):  # it begins on the upper face of the workspace, and holds nowhere
        return [0.0] * len(low), [0.0] * len(low)
    return [None if x == -np.inf else x for x in low.tolist()], [None if x == np.inf else x for x in high.tolist()]


def _over_time(rows: list[Any]) -> Any:
    """Return one entry for all times where it never changes."""
    return rows[0] if all(row == rows[0] for row in rows) else rows


def _pairs(problem: Problem, names: Mapping[str, str]) -> list[dict[str, Any]]:
    labeling, pairs = problem.labeling, []
    for pair, name in zip(labeling.pairs, labeling.names[labeling.first_pair :], strict=True):
        data: dict[str, Any] = {
            "name": names[name],
            "agents": [pair.first, pair.second],
            "outputs": [list(axes) for axes in pair.outputs],
        }
        here = [pair.at(t) for t in (range(problem.horizon + 1) if pair.moves else [0])]
        if any(region.is_round for region in here):
            data["radius"] = _over_time([0.0 if region.is_empty else float(region.radius) for region in here])
        else:
            corners = [_corners(region.low, region.high) for region in here]
            data["low"], data["high"] = (_over_time(list(each)) for each in zip(*corners, strict=True))
        pairs.append(data)
    return pairs


# The task.


def _task(problem: Problem, names: Mapping[str, str]) -> dict[str, Any]:
    automaton, specification = problem.automaton, problem.specification
    if automaton.semantics not in ("co-safe", "finite-trace"):
        raise NotCanonicalError("opposite tasks have no canonical form yet")
    data = {
        "semantics": automaton.semantics,
        "automaton": {
            "initial": int(automaton.initial),
            "accepting": automaton.accepting.tolist(),
            **{key: getattr(automaton, key).tolist() for key in ("root", "variable", "low", "high")},
        },
    }
    if specification.formula is None:
        return data
    formula = _substituted(parse_formula(specification.formula), problem, names)
    return {**data, "formula": str(formula)}


def _substituted(formula: Formula, problem: Problem, names: Mapping[str, str]) -> Formula:
    """Return a formula over plain names: families and shapes written out."""
    if formula.operator in ("all", "any"):
        members = tuple(Formula("atom", name=name) for name in problem.families[formula.name])
        joined = members[0] if len(members) == 1 else Formula("&" if formula.operator == "all" else "|", members)
        return _substituted(joined, problem, names)
    if formula.operator == "atom":
        if formula.name in problem.meanings:
            return _substituted(problem.meanings[formula.name], problem, names)
        return Formula("atom", name=names[formula.name])
    operands = tuple(_substituted(operand, problem, names) for operand in formula.operands)
    return Formula(formula.operator, operands, formula.name, formula.bounds)


# Proofs.


class _Pool:
    """Puts arrays into a file, equal ones once, and returns their numbers."""

    def __init__(self, arrays: list[np.ndarray]) -> None:
        self.arrays, self.numbers = arrays, dict[tuple[str, tuple[int, ...], bytes], int]()

    def __call__(self, array: Any, dtype: Any = np.float64) -> int:
        stored = np.ascontiguousarray(array, dtype=dtype)
        key = stored.dtype.str, stored.shape, stored.tobytes()
        if key not in self.numbers:
            self.numbers[key] = len(self.arrays)
            self.arrays.append(stored)
        return self.numbers[key]


def _from_starts(problem: Problem, proof: StartsProof, arrays: list[np.ndarray]) -> dict[str, Any]:
    """Return the entry of a proof from a box of starts that is cut, and add its arrays to those of the file."""
    put = _Pool(arrays)

    def entry(part: Cut | PathProof | None) -> Any:
        if not isinstance(part, Cut):
            return None if part is None else _along_trajectories(problem, part, arrays, put)
        sides = {"below": entry(part.below), "above": entry(part.above)}
        return {"kind": "starts", "agent": part.agent, "state": part.state, "cut": float(part.at), **sides}

    whole: dict[str, Any] = entry(proof.cut)
    return whole


def _along_trajectories(
    problem: Problem, proof: PathProof, arrays: list[np.ndarray], put: _Pool | None = None
) -> dict[str, Any]:
    """Return the entry of a proof along trajectories, and add its arrays to those of the file."""
    put = put or _Pool(arrays)
    return {
        "kind": "trajectory",
        "letters": put(proof.letters, np.int8),
        "faces": put(proof.faces, np.int32),
        "normals": put(np.zeros((proof.n_steps + 1, 0)) if proof.normals is None else proof.normals),
        "agents": [
            {key: put(array) for key, array in _trajectory(path).items()} | _network_of(problem, proof, i, put)
            for i, path in enumerate(proof.paths)
        ],
    }


def _written(policy: SymbolicPolicy, text: str) -> str:
    """Return an expression with the parameters of its agent as numbers."""
    for name, value in policy.parameters.items():
        text = re.sub(rf"(?<![\w.]){re.escape(name)}(?![\w.])", f"({value!r})", text)
    return text


def _network_of(problem: Problem, proof: PathProof, i: int, put: _Pool) -> dict[str, Any]:
    """Return the entries of the network of agent i; none where nominal inputs act."""
    if proof.networks is None:
        return {}
    policy = proof.networks[i]
    if isinstance(policy, SymbolicPolicy):
        return {"radius": float(proof.radii[i]), "feedback": [_written(policy, text) for text in policy.expressions]}
    if not isinstance(policy, JointNetworkPolicy):
        policy = seen_jointly(policy, problem.columns[i].start, problem.n_states)
    if (policy.horizon, policy.states) != (problem.horizon, problem.automaton.n_states):
        raise NotCanonicalError("a network was made for another horizon, or another number of automaton states")
    network = policy.network
    return {
        "radius": float(proof.radii[i]),
        "network": {
            "weights": [put(weight) for weight in network.weights],
            "biases": [put(bias) for bias in network.biases],
            "activation": network.activation,
            "output": "box" if network.outputs == "box" else "tanh" if network.squashed else "clip",
            "view": put(policy.matrix),
            "offset": put(policy.offset),
            "told": policy.told,
        },
    }


def _trajectory(path: AgentPath) -> dict[str, FloatArray]:
    """Return nominal inputs, gains, states and widths of the tube of one agent."""
    return {"inputs": path.inputs, "gains": path.gains, "states": path.states, "widths": path.strips}


def _on_cells(problem: Problem, proof: GridProof, arrays: list[np.ndarray]) -> dict[str, Any]:
    """Return the entry of a proof on cells, and add its arrays to those of the file."""
    if proof.bound != "nominal":
        raise NotCanonicalError("relations that may be lost have no canonical form yet")
    put = _Pool(arrays)
    known = read_problem({"problem": canonical_problem(problem)}).agents
    value: dict[str, Any] = {}
    if proof.rounding is None:
        tables = zip(("vertices", "unions", "kept"), tree_rows(proof.merge_log), strict=True)
        value["tree"] = {name: put(rows, np.int32) for name, rows in tables}
    elif sum(part.policy.shape[-1] for part in proof.agents) > CELLS_OF_TRAINS:
        raise NotCanonicalError("tensor trains on so many cells would take the small checker many minutes")
    else:
        value["tolerance"] = TRAINS * float(proof.rounding.tolerance)
    return {
        "kind": "cells",
        "guards": {
            "source": put(proof.guard_source, np.int32),
            "target": put(proof.guard_target, np.int32),
            "sets": put(proof.guard_mask, np.int32),
        },
        "start": {"target": put(proof.start_target, np.int32), "sets": put(proof.start_mask, np.int32)},
        **value,
        "agents": [_cells_of(*each, put) for each in zip(problem.agents, known, proof.agents, strict=True)],
    }


def _cells_of(agent: AnyAgent, known: CheckedAgent, part: AgentRecord, put: _Pool) -> dict[str, Any]:
    """Return the entry of the cells of one agent."""
    relation, kind = part.relation, part.relation["kind"]
    if kind not in ("exact", "linear", "boxes") or "network" in relation:
        raise NotCanonicalError(f"the relation {kind!r} of agent `{agent.name}` has no canonical form yet")
    if kind == "boxes" and "parts" in relation:
        raise NotCanonicalError(f"boxes of agent `{agent.name}` are those of expressions")
    input_set = np.array(relation.get("menu", []), dtype=float).reshape(-1, agent.n_inputs)
    targets = np.any(part.policy >= len(input_set))
    inverse = None
    if targets:
        try:
            inverse = put(np.linalg.pinv(affine_dynamics(known)[1]))
        except Refused as reason:
            raise NotCanonicalError(str(reason)) from reason
    return {
        "edges": [put(axis) for axis in part.grid.edges],
        "lattice": [put(axis) for axis in part.lattice],
        "values": "corners" if kind == "linear" else "cells",
        "parts": int(relation.get("parts", 1)) if kind == "linear" else PARTS_OF_BOXES,
        "inputs": put(input_set),
        "inverse": inverse,
        "sets": put(part.masks, np.bool_),
        "start_sets": put(part.start_masks, np.bool_),
        "policy": put(part.policy, np.int32),
    }


TRAINS, CELLS_OF_TRAINS = 0.04, 10_000
"""Share of the tolerance of tensor trains that the checker's cuts may cost, and cells of all agents for which they take
seconds: with 16,000 cells and a hundred columns a step takes ten."""

PARTS_OF_BOXES = 8
"""Parts of a side at whose ends values that are constant on cells are read: with two, car-park-v0 loses 5e-4."""

_WRITERS: dict[type, Callable[[Problem, Any, list[np.ndarray]], dict[str, Any]]] = {
    PathProof: _along_trajectories,
    StartsProof: _from_starts,
    GridProof: _on_cells,
}
