"""What has to hold along a path: limits of states and outputs at each time, from letters and the sides of regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.agents import AnyAgent
from ....envs.tasks.problem import Problem
from ....envs.tasks.regions import Proposition
from ...certificates.proofs import SOMETIME
from ...relations.grids import FloatArray


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of one agent at times 0 to S, infinite where there are none; at time 0 there are none.

    Parameters
    ----------
    states : (2, S + 1, d) array
        Workspace, and regions whose outputs are states.
    outputs : (2, S + 1, p) array
        Regions of other outputs.
    jumps : (2, S + 1, p) array
        How far outputs may move in the step before, where a region is to be met at some time.
    """

    states: FloatArray
    outputs: FloatArray
    jumps: FloatArray

    @classmethod
    def side_by_side(cls, each: Sequence[Limits]) -> Limits:
        """Return the limits of several agents as those of one."""
        parts = [one.states for one in each], [one.outputs for one in each], [one.jumps for one in each]
        states, outputs, jumps = (np.concatenate(part, axis=2) for part in parts)
        return cls(states, outputs, jumps)

    @property
    def are_empty(self) -> bool:
        """Whether some of them contradict each other."""
        return any(bool(np.any(low >= high)) for low, high in (self.states, self.outputs))

    def for_nominal(self, states: FloatArray, outputs: FloatArray) -> Limits:
        """Return what this asks of nominal values, from which true ones are shifted: (S + 1, d) and (S + 1, p)."""
        return Limits(self.states - states, self.outputs - outputs, self.jumps)

    @property
    def limited(self) -> NDArray[np.int64]:
        """Outputs that have a limit at some time."""
        return np.flatnonzero(np.isfinite(self.outputs).any(axis=(0, 1)))


def corners_along(problem: Problem, name: str, times: int) -> tuple[FloatArray, FloatArray]:
    """Return the corners (times, p) of a region at times 0, 1, ..."""
    region = problem.propositions[name]
    assert isinstance(region, Proposition)
    low, high = region.over(np.arange(times, dtype=float))
    return low.T, high.T


def without_far_ends(agent: AnyAgent, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return corners (..., p) that are infinite where they lie beyond what outputs that were added for shapes ask.

    What is never met limits nothing: a search that took such ends for a width would measure by it.
    """
    if not agent.added_outputs:
        return low, high
    bottom, top = (end[0] for end in agent.output_range(agent.state_low[None], agent.state_high[None]))
    size = 1.0 + np.abs(bottom) + np.abs(top)
    return np.where(low < bottom - size, -np.inf, low), np.where(high > top + size, np.inf, high)


def limits_along(problem: Problem, agent: AnyAgent, letters: NDArray[np.int8], faces: NDArray[np.int64]) -> Limits:
    """Return the limits of an agent for letters (S + 1, P) and sides of regions that are kept away from."""
    steps, p = len(letters), agent.n_outputs
    outputs = np.stack([np.full((steps, p), -np.inf), np.full((steps, p), np.inf)])
    jumps = outputs.copy()
    for q, name in enumerate(problem.automaton.propositions):
        if q >= problem.labeling.first_pair or problem.propositions[name].agent != agent.name:
            continue
        low, high = without_far_ends(agent, *corners_along(problem, name, steps))
        for first, last in windows_of(letters[:, q]):
            _cross(outputs, jumps, (low, high), (first, last), int(faces[first, q]))
        here = letters[:, q] == 1
        outputs[0, here] = np.maximum(outputs[0, here], low[here])
        outputs[1, here] = np.minimum(outputs[1, here], high[here])
        for t in np.flatnonzero(letters[:, q] < 0):
            k, is_above = divmod(int(faces[t, q]), 2)
            if is_above:
                outputs[0, t, k] = max(outputs[0, t, k], high[t, k])
            else:
                outputs[1, t, k] = min(outputs[1, t, k], low[t, k])
    states = np.stack([np.tile(agent.state_low, (steps, 1)), np.tile(agent.state_high, (steps, 1))])
    for k in range(p):
        axis = agent.output_axis(k)
        # Rows of one form are one.
        if axis is not None and axis[1] == 1.0:
            states[0, :, axis[0]] = np.maximum(states[0, :, axis[0]], outputs[0, :, k])
            states[1, :, axis[0]] = np.minimum(states[1, :, axis[0]], outputs[1, :, k])
            outputs[0, :, k], outputs[1, :, k] = -np.inf, np.inf
    for ends in (states, outputs):
        ends[0, 0], ends[1, 0] = -np.inf, np.inf
    return Limits(states, outputs, jumps)


def windows_of(letters: NDArray[np.int8]) -> list[tuple[int, int]]:
    """Return first and last times of the windows in which a proposition with letters (S + 1,) is to hold."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], letters == SOMETIME, [False]])))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


def _cross(
    outputs: FloatArray, jumps: FloatArray, region: tuple[FloatArray, FloatArray], window: tuple[int, int], face: int
) -> None:
    """Note limits of outputs and of their jumps (2, S + 1, p) of crossing a region that a path comes to by a face.

    Beyond the face that it comes by at last, not yet beyond the opposite one at first, and over no region in one step.
    """
    (low, high), (first, last), (k, from_above) = region, window, divmod(face, 2)
    times = slice(first, last + 1)
    others = np.arange(outputs.shape[2]) != k
    outputs[0, times, others] = np.maximum(outputs[0, times, others], low[times, others].T)
    outputs[1, times, others] = np.minimum(outputs[1, times, others], high[times, others].T)
    near, far = (first, last) if from_above else (last, first)
    outputs[0, near, k] = max(outputs[0, near, k], low[near, k])
    outputs[1, far, k] = min(outputs[1, far, k], high[far, k])
    before, after = slice(first, last), slice(first + 1, last + 1)
    if from_above:
        jumps[0, after, k] = np.maximum(jumps[0, after, k], low[after, k] - high[before, k])
    else:
        jumps[1, after, k] = np.minimum(jumps[1, after, k], high[after, k] - low[before, k])


def sides_of(
    problem: Problem, agent: AnyAgent, letters: NDArray[np.int8], outputs: FloatArray, sharp: FloatArray
) -> NDArray[np.int64]:
    """Return the sides (S + 1, P) on which outputs (S + 1, p) are farthest beyond regions, in units ``sharp`` (p,).

    Only those of this agent's propositions that are not to hold, or to hold at some time of a window: of these the
    sides on which they are before. -1 elsewhere.
    """
    faces = np.full(letters.shape, -1)
    for q, name in enumerate(problem.automaton.propositions):
        if q >= problem.labeling.first_pair or problem.propositions[name].agent != agent.name:
            continue
        best = farthest_sides(agent, *corners_along(problem, name, len(letters)), outputs, sharp)
        faces[letters[:, q] < 0, q] = best[letters[:, q] < 0]
        for first, last in windows_of(letters[:, q]):
            faces[first : last + 1, q] = best[first - 1]
    return faces


def farthest_sides(
    agent: AnyAgent, low: FloatArray, high: FloatArray, outputs: FloatArray, sharp: FloatArray
) -> NDArray[np.int64]:
    """Return the sides (S + 1,) of a region on which outputs (S + 1, p) are farthest beyond it, in units ``sharp``.

    Sides where the workspace leaves no room count only where no other one has any: a plan that is outside of it, as an
    empty battery is, would be kept there.
    """
    beyond = np.stack([low - outputs, outputs - high], axis=2) / np.broadcast_to(sharp, low.shape)[:, :, None]
    bottom, top = agent.output_ends
    room = np.stack([low > bottom, high < top], axis=2).reshape(len(low), -1)
    beyond = beyond.reshape(len(low), -1)
    return np.asarray(np.argmax(np.where(room | ~room.any(axis=1, keepdims=True), beyond, -np.inf), axis=1))
