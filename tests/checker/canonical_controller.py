"""The controllers that certificates are about, one agent and one time at a time.

* Along a trajectory: ``u_t = clip(ubar_t + K_t (x - xbar_t))``, the error of an angle less whole turns.
* On cells: the input that the policy has for the cell of x, the time and the automaton state; or, for a target z, the
  input ``P (z - A x - b)``.

Claims hold for *every* controller whose inputs differ from these, in real numbers and clipped to the input box, by at
most what the check charges: in whatever order it adds, on whatever device that computes in double precision.
"""

from __future__ import annotations

import numpy as np

from certigym.synthesis.checker.cell_proofs import AgentCells
from certigym.synthesis.checker.fields import Refused
from certigym.synthesis.checker.motions import affine_dynamics
from certigym.synthesis.checker.problem import TURN, Agent
from certigym.synthesis.checker.rigorous import Array
from certigym.synthesis.checker.steps import Trajectory


def along_trajectory(agent: Agent, own: Trajectory, t: int, x: Array) -> Array:
    """Return inputs (m,) of an agent at a time t < S, from its state (d,)."""
    return np.clip(own.inputs[t] + own.gains[t] @ _error(agent, own, t, x), *agent.input_box)


def _error(agent: Agent, own: Trajectory, t: int, x: Array) -> Array:
    error = x - own.states[t]
    for angle in agent.angles:
        k = agent.states.index(angle)
        error[k] -= TURN * np.rint(error[k] / TURN)  # less whole turns
    return error


def on_cells(agent: Agent, own: AgentCells, t: int, q: int, x: Array) -> Array | None:
    """Return inputs (m,) of an agent at a time, in an automaton state, from its state (d,); None: anything will do."""
    # half-open cells; the last one along an axis holds its upper face
    cells = [int(np.searchsorted(axis, value, side="right")) - 1 for axis, value in zip(own.edges, x, strict=True)]
    place = np.ravel_multi_index(cells, own.shape, mode="clip")
    choice = int(own.policy[min(t, len(own.policy) - 1), q, place])  # the same at all times if there is one row
    if choice < len(own.inputs):
        return None if choice < 0 else own.inputs[choice]
    point = np.unravel_index(choice - len(own.inputs), [len(axis) for axis in own.lattice])
    z = np.array([axis[k] for axis, k in zip(own.lattice, point, strict=True)])
    A, _, b = affine_dynamics(agent)
    if own.inverse is None:
        raise Refused(f"`{agent.name}` chooses a target, and no matrix says by which inputs")
    return np.clip(own.inverse @ (z - A @ x - b), *agent.input_box)
