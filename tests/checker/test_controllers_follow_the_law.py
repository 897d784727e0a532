"""Controllers of the package apply what the checker's law says, up to the rounding for which claims hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import certigym as cg
from canonical_controller import along_trajectory, on_cells
from certigym.synthesis.certificates.proofs.canonical import canonical_bytes
from certigym.synthesis.checker import CheckedAgent, cell_proofs, parse_file, read_problem, trajectories
from certigym.synthesis.checker.problem import TURN
from certigym.synthesis.checker.steps import Trajectory
from kinds import mostly_thorough

OWN = Path(__file__).parents[2] / "examples" / "own"
STATES = 200


def rounding(agent: CheckedAgent, own: Trajectory, t: int, x: np.ndarray) -> np.ndarray:
    """By how much inputs (m,) may differ from the law in real numbers: the check charges at least this."""
    off = x - own.states[t]
    for angle in agent.angles:
        k = agent.states.index(angle)
        off[k] -= TURN * np.rint(off[k] / TURN)
    size = np.abs(off) + 2.0**-53 * np.abs(own.states[t])
    return np.asarray(4.0 * (len(x) + 3.0) * 2.0**-53 * (np.abs(own.inputs[t]) + np.abs(own.gains[t]) @ size))


@mostly_thorough("name", ["integrator-chain-v0", "swing_up.toml", "satellite.toml"])
def test_along_trajectories(name: str) -> None:
    problem = cg.load(OWN / name) if name.endswith(".toml") else cg.make_problem(name)
    certificate = cg.synthesize(problem, relation="path", effort=2).certificate
    contents = parse_file(canonical_bytes(certificate))
    known = read_problem(contents.header)
    proof, rng = trajectories.read_proof(contents, known), np.random.default_rng(0)
    for i, (agent, own) in enumerate(zip(known.agents, proof.trajectories, strict=True)):
        low, high = agent.state_box
        for _ in range(STATES):
            t = int(rng.integers(len(own.inputs)))
            x = rng.uniform(low, high) if rng.random() < 0.5 else np.clip(rng.normal(own.states[t], 0.1), low, high)
            applied = certificate.controller.inputs(i, x[:, None], np.zeros(1, dtype=int), t)[:, 0]
            # the law is computed in floating point, too: both are within their rounding of it
            assert np.all(np.abs(applied - along_trajectory(agent, own, t, x)) <= 2.0 * rounding(agent, own, t, x))


@mostly_thorough(
    ("name", "relation", "cells"),
    [("reach-avoid-v0", "exact", 40), ("car-park-v0", "linear", 40), ("needle-v0", "exact", 16)],
)
def test_on_cells(name: str, relation: str, cells: int) -> None:
    problem = cg.make_problem(name)
    certificate = cg.synthesize(problem, cells, relation=relation).certificate
    contents = parse_file(canonical_bytes(certificate))
    known = read_problem(contents.header)
    proof, rng = cell_proofs.read_proof(contents, known), np.random.default_rng(0)
    compared = 0
    for agent, own, applied in zip(known.agents, proof.cells, certificate.controller.agents, strict=True):
        low, high = agent.state_box
        for _ in range(STATES):
            t, q = int(rng.integers(problem.horizon)), int(rng.integers(len(known.automaton.accepting)))
            x = rng.uniform(low, high)
            if rng.random() < 0.3:  # on faces of cells, the last ones among them
                x = np.array([rng.choice(axis) for axis in own.edges])
            wanted = on_cells(agent, own, t, q, x)
            if wanted is not None:
                found, _ = applied.act(x[:, None, None], np.array([q]), t, None)
                np.testing.assert_allclose(
                    found[:, 0, 0], wanted, rtol=0, atol=1e-12 * (1.0 + np.abs(agent.input_box).max())
                )
                compared += 1
    assert compared > STATES // 4
