"""The last touch to a nominal path: inputs, weights and strips moved a little at once, with the bound as the objective.

Plans keep deviations of an earlier path away from limits, which is not what the certificate adds up: linearization
errors change with the path, and strips that are late bend little that follows. Here candidates are judged by the
certificate itself. Inputs are moved under feedback, so that an agent that is unstable stays near its path.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...relations.grids import FloatArray
from ..chance_constraints import Feedback, worth_of
from .counted_work import work_of_walk
from .nonlinear_search import FeedbackTrajectory, NonlinearSearch, feedback_of, found_of

BATCH = 24
"""Candidates in each generation."""

WINDOW, LEAST_GAIN = 20, 0.01
"""Generations within which the failure has to fall by this share of itself; else the rest is not worth its work."""

KNOTS = 6
"""Times between which moves of strips change evenly; inputs have two for each."""

FIRST_SPREAD, LEAST_SPREAD, WIDER, NARROWER = 0.3, 0.01, 1.3, 0.8
"""Size of the moves at first and at last, and what it is multiplied with after a batch that helps, or does not."""

MOST_SPREAD = 1.0
"""Largest size."""

SLABS = (0.1, 100.0)
"""Strips are between these, in deviations."""

FARTHER, BESIDE = (0.5, 1.0, 2.0), (0.5, 1.0)
"""How far the moves that helped most are tried again; and all others that helped, in proportion to their gains."""

MOVED = 0.1
"""Moves of inputs, as a share of half their range, against those of logarithms."""

ENOUGH, HOPELESS = 1e-5, 0.9999
"""Failures below and above which nothing is touched any more."""

LARGE = 1e-3
"""Failure from which on limits count for what they add to the failure of the same one a step earlier, as in the check.

Smaller ones are those of few limits, and the plain sum leads searches better."""


@dataclass(frozen=True, eq=False)
class Moves:
    """Moves of N candidates: inputs (N, S, m), logarithms of weights (N, k), and of strips (N, S + 1, j), and shares by
    which gains (N, m, d) change."""

    inputs: FloatArray
    weights: FloatArray
    strips: FloatArray
    gains: FloatArray

    @property
    def parts(self) -> tuple[FloatArray, ...]:
        """All of them."""
        return self.inputs, self.weights, self.strips, self.gains

    def mixed(self, shares: FloatArray) -> Moves:
        """Return candidates that are sums of these, in the shares (M, N) of each."""
        return Moves(*(np.tensordot(shares, part, 1) for part in self.parts))

    def beside(self, others: Moves) -> Moves:
        """Return these candidates before others."""
        return Moves(*(np.concatenate(pair) for pair in zip(self.parts, others.parts, strict=True)))


def polished(search: NonlinearSearch, found: FeedbackTrajectory, generations: int) -> FeedbackTrajectory:
    """Return a path that fails at most as often, after small moves of all that is free."""
    worth, _ = found.nominal.worth(found.feedback)
    first, begun = bool(worth.failures()[0] > LARGE), found
    if first:
        found = replace(found, score=float(worth.scores(first)[0]), failure=float(worth.failures(first)[0]))
    started, spread, last, work, before = found, FIRST_SPREAD, None, search.work, found.failure
    each = work_of_walk(len(found.nominal.inputs), search.agent.n_states, BATCH)
    for generation in range(generations):
        if not ENOUGH < found.failure < HOPELESS or spread < LEAST_SPREAD or not work.allows(each):
            break
        if generation and generation % WINDOW == 0:
            if found.failure > (1.0 - LEAST_GAIN) * before:
                break
            before = found.failure
        moves = _drawn(search, found, spread)
        # What helped may help again, and farther.
        moves = moves if last is None else last.beside(moves)
        best, scores = _best_moved(search, found, moves, first)
        is_better = best.score < found.score
        last = moves.mixed(_again(found.score - scores)) if is_better else None
        found = best if is_better else found
        spread = min(MOST_SPREAD, spread * (WIDER if is_better else NARROWER))
    return begun if found is started else found


def _again(gains: FloatArray) -> FloatArray:
    """Return shares (M, N) of candidates of which those of the next generation are sums, by what each gained (N,)."""
    best, helped = np.eye(len(gains))[gains.argmax()], np.maximum(gains, 0.0)
    rest = (helped - helped.max() * best) / helped.max()
    return np.concatenate([np.outer(FARTHER, best), np.outer(BESIDE, rest)])


def _drawn(search: NonlinearSearch, found: FeedbackTrajectory, spread: float) -> Moves:
    """Return random moves; most candidates move a part of what may move."""
    rng, (steps, m) = search.rng, found.nominal.inputs.shape
    d = search.agent.n_states
    inputs = _smooth(search, (BATCH, m), 2 * KNOTS, steps).swapaxes(1, 2) * MOVED * search.half
    strips = _smooth(search, (BATCH, found.feedback.strips.shape[2]), KNOTS, steps + 1).swapaxes(1, 2)
    weights = np.zeros((BATCH, len(found.theta)))
    weights[:, : d + m + 1] = rng.standard_normal((BATCH, d + m + 1)) * (rng.random((BATCH, d + m + 1)) < 0.3)
    parts = rng.random((3, BATCH)) < 0.6
    moved = [spread * part * np.expand_dims(here, tuple(range(1, part.ndim)))
             for part, here in zip((inputs, weights, strips), parts, strict=True)]  # fmt: skip
    # Gains of weighted squares are not all there are: with an eye on one limit others may be left.
    gains = search.turning.standard_normal((BATCH, m, d)) * (search.turning.random((BATCH, 1, 1)) < 0.3)
    return Moves(moved[0], moved[1], moved[2], spread * gains)


def _smooth(search: NonlinearSearch, shape: tuple[int, int], knots: int, times: int) -> FloatArray:
    """Return functions of time (.., times), straight between random values at some times; half of them are 0."""
    values = search.rng.standard_normal((*shape, knots)) * (search.rng.random((*shape, 1)) < 0.5)
    at = np.linspace(0.0, knots - 1.0, times)
    first = np.minimum(at.astype(int), knots - 2)
    share = at - first
    return (1.0 - share) * values[..., first] + share * values[..., first + 1]


def _best_moved(
    search: NonlinearSearch, found: FeedbackTrajectory, moves: Moves, first: bool
) -> tuple[FeedbackTrajectory, FloatArray]:
    """Return the best of some candidates, and the scores (N,) of all."""
    states, inputs = _rolled(search, found, moves.inputs)
    fine, scores = np.flatnonzero(np.isfinite(states).all(axis=(1, 2))), np.full(len(states), np.inf)
    if not len(fine):
        return found, scores  # unstable agents may leave the numbers there are
    paths = found.nominal.many(states[fine], inputs[fine])
    which = np.arange(len(paths))
    shares = found.shares * (1.0 + moves.gains[fine])
    gains = feedback_of(search, paths, which, found.theta + moves.weights[fine]).gains * shares[:, None]
    strips = np.clip(found.feedback.strips * np.exp(np.clip(moves.strips[fine], -3.0, 3.0)), *SLABS)
    feedback = Feedback(gains, np.where(np.isinf(found.feedback.strips), np.inf, strips))
    search.work.walk(len(paths[0].inputs), search.agent.n_states, len(paths))
    worth, spreads = worth_of(paths, feedback, which)
    search.tried += len(paths)
    scores[fine] = worth.scores(first)
    scores = np.where(np.isfinite(scores), scores, np.inf)
    c = int(np.argmin(scores[fine]))
    judged, values = (worth, spreads, feedback), (float(scores[fine[c]]), float(worth.failures(first)[c]))
    best = found_of(judged, c, values, paths[c], found.theta + moves.weights[fine[c]], found.faces)
    return replace(best, shares=shares[c]), scores


def _rolled(search: NonlinearSearch, found: FeedbackTrajectory, moved: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return states (N, S + 1, d) and inputs (N, S, m) of moved inputs (N, S, m), under the feedback of the path."""
    agent, nominal, gains = search.agent, found.nominal, found.feedback.gains[0]
    states, inputs = [np.repeat(nominal.states[0][None], len(moved), axis=0)], list[FloatArray]()
    low, high, near = agent.input_low, agent.input_high, 2e-3 * search.half
    for t, u in enumerate(nominal.inputs):
        off = np.nan_to_num(states[-1] - nominal.states[t])
        wanted = u + moved[:, t] + off @ gains[t].T
        # Inputs that stand at a limit need no reserve there.
        wanted = np.where(wanted <= low + near, low, np.where(wanted >= high - near, high, wanted))
        inputs.append(wanted)
        states.append(search.model.step(states[-1].T, wanted.T, t).T)
    return np.array(states).swapaxes(0, 1), np.array(inputs).swapaxes(0, 1)
