"""Convex sets of starts: corners along rays from the middle, each as far out as its path keeps the probability."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
from scipy.special import ndtr

from ...envs.agents import LinearAgent, with_matrices
from ...envs.arrays import on_one_thread
from ..cells import FloatArray, RelationRefused
from ..certificates import AlongPath, Certificate, HullProof, any_certificate, path_under
from ..controllers import covariances_of
from ..path_bounds import OUTWARD, Slabs, input_slabs, limits_of, state_slabs
from .counted_work import CountedWork
from .nominal import Response, nominal_inputs
from .path_search import linear_certificate

HALVINGS = 12
"""Halvings of the distance along a ray: what remains is a few ten thousandths of it."""

MOST_SIGNS = 6
"""Axes whose corners are all tried."""

INSIDE = 1.0 - 1e-6
"""Share of the way to the edge of the workspace that is gone: mixtures of corners stay inside for all rounding."""

SPARE = 4e-9
"""Distance from edges that starts keep, as a share of one more than the largest outputs: more than the check asks."""

MOST_LETTERS = 256
"""First letters that are looked at: fewer than the check looks at."""


@on_one_thread
def certified_starts(
    certificate: Any, probability: float, axes: Sequence[int] | None = None, rays: int = 64
) -> Certificate[HullProof]:
    """Return a convex set of starts from all of which the task is satisfied with at least a given probability.

    Letters, faces and feedback are those of the certificate, whose start is in the middle of the rays; every corner has
    nominal inputs of its own. The set is no larger than what these allow: an inner approximation.

    Of the certificate nothing is trusted: what its letters, faces and feedback prove is computed anew for every corner,
    and ``check`` verifies the set.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path of a file
        Along a nominal path (``relation="path"``), of one agent.
    probability : float
        Probability in [0.5, 1) that is to be kept.
    axes : sequence of int, optional
        States that vary; the others stay as they are. All by default.
    rays : int
        Number of corners that are looked for.

    Raises
    ------
    ValueError
        If the certificate is not along a path, or of several agents, or itself below the probability, or if an argument
        is out of range.
    """
    certificate = any_certificate(certificate)
    if path_under(certificate) is not certificate:
        raise ValueError(
            "`certificate`: expected one along a path, got one on grids, which knows its bound at every start already; "
            'see `at`, or synthesize with relation="path"'
        )
    problem, agent = certificate.problem, certificate.problem.agents[0]
    if problem.n_agents != 1 or not isinstance(agent, LinearAgent):
        raise RelationRefused("sets of starts are for one agent; certify the agents one by one")
    if certificate.proof.paths[0].states is not None:
        # Its feedbacks change with the time: rays go along a path of which one feedback is for all times.
        is_straight = agent.is_linear_gaussian and agent.initial.is_point
        straight = linear_certificate(problem, CountedWork()) if is_straight else None
        if straight is None:
            raise RelationRefused(
                "sets of starts of a linear agent with a start that is a point can be found; certify others with a "
                "start box, `initial_low` and `initial_high`"
            )
        certificate = straight[0].certificate
    if not 0.5 <= probability < 1.0:
        raise ValueError(f"`probability`: expected one in [0.5, 1), got {probability!r}")
    axes = tuple(range(agent.n_states)) if axes is None else tuple(int(axis) for axis in axes)
    if not axes or len(set(axes)) < len(axes) or not all(0 <= axis < agent.n_states for axis in axes):
        raise ValueError(f"`axes`: expected different states from 0 to {agent.n_states - 1}, got {list(axes)}")
    if rays < 3:
        raise ValueError(f"`rays`: expected at least 3, got {rays}")
    finder = _Rays(certificate)
    middle = np.asarray(agent.initial.low, dtype=float)
    corners, inputs, failures = [], [], []
    for ray in _directions(len(axes), rays):
        # A box is nearly as wide as it is long in units of its sides.
        direction = np.zeros(agent.n_states)
        direction[list(axes)] = ray * (agent.state_high - agent.state_low)[list(axes)]
        found = finder.farthest(middle, direction, 1.0 - probability)
        if found is not None:
            corners.append(found[0])
            inputs.append(found[1])
            failures.append(found[2])
    if len(corners) <= len(axes):
        raise RelationRefused(f"no starts around the middle keep a probability of {probability}; ask for less")
    # Each of the two bounds is no worse between corners than at the worst of them; of the two the better counts.
    failure = min(1.0, float(np.array(failures).max(axis=0).min()))
    path = certificate.proof
    same = path.paths[0].gain, path.letters, path.faces
    proof = HullProof(axes, np.array(corners), np.array(inputs), *same, failure)
    return Certificate(problem, proof, {"relation": "path"})


def _directions(d: int, count: int) -> FloatArray:
    """Return directions (count, d), no longer than a half along any axis: to a lattice on the faces of a cube."""
    if d == 1:
        return np.array([[-0.5], [0.5]])
    if d == 2:
        angles = 2.0 * np.pi * (np.arange(count) + 0.5) / count
        points = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    else:
        from scipy.stats import qmc  # slow to load, and needed here alone

        # Its corners, and points that are spread evenly.
        signs = np.meshgrid(*[[-1.0, 1.0]] * min(d, MOST_SIGNS), indexing="ij")
        corners = np.ones((signs[0].size, d))
        corners[:, : len(signs)] = np.stack(signs, axis=-1).reshape(-1, len(signs))
        points = np.vstack([corners, 2.0 * qmc.Halton(d, seed=0).random(count) - 1.0])
    return np.asarray(0.5 * points / np.abs(points).max(axis=1, keepdims=True))


class _Rays:
    """Starts along rays with the nominal inputs that are found for them; what all starts share is computed once."""

    def __init__(self, certificate: AlongPath) -> None:
        problem, path = certificate.problem, certificate.proof.paths[0]
        agent = with_matrices(problem.agents[0])
        steps = certificate.proof.n_steps
        covariances = covariances_of(agent, path.gain, steps)
        self.agent = agent
        proof = certificate.proof
        self.states = state_slabs(limits_of(problem, 0, proof.letters, proof.faces), covariances)
        self.inputs = input_slabs(agent, path.gain, covariances, steps)
        self.response = Response.of(agent, steps)
        self.powers = [np.linalg.matrix_power(agent.A, t) for t in range(steps + 1)]
        self.problem = problem
        self.spare = SPARE * (
            1.0 + np.abs(agent.output_matrix) @ np.maximum(abs(agent.state_low), abs(agent.state_high))
        )
        self.sides = self._sides(agent.output_matrix @ agent.initial.low)

    def _sides(self, outputs: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return boxes (low, high) of outputs in which starts have to be: there the first letter leads to one state.

        They are convex, so that mixtures of starts are in them, too. Of several propositions that may have any value
        those are left open first whose edges are nearest.
        """
        automaton, fixed, values = self.problem.automaton, dict[int, tuple[float, FloatArray, FloatArray]](), []
        for p, name in enumerate(automaton.propositions):
            region = self.problem.propositions[name].at(0)
            beyond = np.concatenate([region.low - outputs, outputs - region.high]) - np.tile(self.spare, 2)
            inside = np.minimum(outputs - region.low, region.high - outputs) - self.spare
            low, high = np.full(len(outputs), -np.inf), np.full(len(outputs), np.inf)
            face, k = int(np.argmax(beyond)), int(np.argmax(beyond)) % len(outputs)
            if np.all(inside >= 0.0):
                fixed[p] = float(inside.min()), region.low, region.high
            elif beyond[face] > 0.0:
                (high if face < len(outputs) else low)[k] = (region.low if face < len(outputs) else region.high)[k]
                fixed[p] = float(beyond[face]), low, high
            values.append((True,) if np.all(inside >= 0.0) else (False,) if beyond[face] > 0.0 else (False, True))
        if not self._is_one_state(values):
            raise RelationRefused(
                "`initial_state`: expected a start off the edges of regions on which the first letter depends, got one "
                "on such an edge, around which there is no set of starts; move it"
            )
        for p in sorted(fixed, key=lambda p: fixed[p][0]):
            opened = [*values[:p], (False, True), *values[p + 1 :]]
            if self._is_one_state(opened):
                values = opened
                del fixed[p]
        return [(low, high) for _, low, high in fixed.values()]

    def _is_one_state(self, values: Sequence[tuple[bool, ...]]) -> bool:
        """Return whether all letters with these values lead to the same state."""
        if math.prod(map(len, values)) > MOST_LETTERS:
            return False
        automaton = self.problem.automaton
        letters = (np.array(letter, dtype=bool) for letter in product(*values))
        return len({int(automaton.next_state(automaton.initial, letter)) for letter in letters}) == 1

    def farthest(
        self, middle: FloatArray, direction: FloatArray, allowed: float
    ) -> tuple[FloatArray, FloatArray, tuple[float, float]] | None:
        """Return the farthest start that is found, its inputs and both bounds on failing; None if there is none."""
        room = np.where(direction > 0.0, self.agent.state_high - middle, middle - self.agent.state_low)
        with np.errstate(divide="ignore", invalid="ignore"):
            edge = float(np.nanmin(np.where(direction != 0.0, room / np.abs(direction), np.inf))) * INSIDE
        low, high, best = 0.0, edge, None
        for number in range(HALVINGS + 1):
            # The edge of the workspace first: often nothing is lost on the way to it.
            share = high if number == 0 else 0.5 * (low + high)
            found = self._from(middle + share * direction)
            if found is not None and min(found[2]) <= allowed:
                low, best = share, found
                if number == 0:
                    break
            else:
                high = share
        return best

    def _from(self, start: FloatArray) -> tuple[FloatArray, FloatArray, tuple[float, float]] | None:
        """Return a start with nominal inputs and both bounds on failing; None if its first letter leads elsewhere."""
        outputs = self.agent.output_matrix @ start
        if not all(np.all((low + self.spare <= outputs) & (outputs <= high - self.spare)) for low, high in self.sides):
            return None
        moved = np.array([power @ (start - self.agent.initial.low) for power in self.powers])
        response = replace(self.response, free=self.response.free + moved)
        u = nominal_inputs(self.agent, self.states, self.inputs, response)
        constant, matrix = response.of_slabs(self.states)
        at = constant + matrix @ u.ravel()
        return start, u, _bounds(self.states, at, self.inputs, u)


def _bounds(states: Slabs, at: FloatArray, inputs: Slabs, u: FloatArray) -> tuple[float, float]:
    """Return upper bounds on failing, by Boole and by the correlation inequality, with room for rounding.

    A bound that is not convex where it stands (a limit on the wrong side of the nominal value) counts as 1.
    """
    flat = u.ravel()
    size = np.abs(states.rows) @ np.full(states.rows.shape[1], float(np.abs(at).max(initial=1.0)))
    tails = [states.failure(at, size), inputs.failure(flat, np.abs(flat) * (inputs.deviations > 0.0))]
    below, above = (np.concatenate([pair[k] for pair in tails]) for k in (0, 1))
    # Inputs that no feedback moves are admissible if they are in their box.
    fixed = np.concatenate([np.zeros(len(at), dtype=bool), inputs.deviations <= 0.0])
    below[fixed] = above[fixed] = 0.0
    worse = np.maximum(below, above)
    still = inputs.deviations <= 0.0
    if np.any(worse >= ndtr(0.0)) or np.any((flat < inputs.low)[still] | (flat > inputs.high)[still]):
        return 1.0, 1.0
    return float(np.sum(below + above)) * OUTWARD, float(-np.expm1(np.sum(np.log1p(-2.0 * worse)))) * OUTWARD
