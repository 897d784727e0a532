"""The best nominal path of one agent that is found: a way around regions, a plan, feedbacks and strips, plans anew.

Feedbacks and strips come from a random search with the bound itself as the objective: weights of linear-quadratic
problems, and strips in deviations. Plans are made anew with the deviations and linearization errors of what was found.
Seeds are fixed and work is counted, never time: the same problem gives the same nominal path everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...certificates.proofs import AgentPath
from ...relations.grids import FloatArray
from ..chance_constraints import Feedback, NominalPath, NonlinearModel, Spreads, Worth, limits_along, sides_of, worth_of
from .candidate_runs import candidate_run
from .coarse_routes import guesses
from .counted_work import CountedWork
from .feedback_gains import feedback_gains
from .held_inputs import held_runs
from .nominal_planner import Aim, Planner, rolled

BATCH = 24
"""Candidates that are looked at at once."""

GENERATIONS = 5
"""Batches of candidates after a plan, each closer around the best ones."""

REPLANS, MORE_REPLANS = 4, 6
"""How often a nominal path is planned anew, as long as that helps, and how often besides where it fails rarely. To
which of many paths a search comes hangs on the last bits of derivatives; a few rounds more make up for bad luck."""

GOOD = 1e-4
"""Failure from which nothing but plans made anew improves a path: no other times are tried, and nothing is moved."""

RARE, RESERVES = 0.1, ((1.4, 2.0, 1.0), (1.0, 1.4))
"""What plans take a deviation for, in deviations, one after the other: of paths that fail less often than this, and of
others. A plan that reckons with true deviations has no reason to keep farther away than four of them: by then effort
costs more than what is left to gain."""

AT_LIMIT = 1e-3
"""Share of its range within which an input counts as standing at its limit, and has no feedback."""

QUARTER = 0.25
"""Share of the linearization error that plans keep away from limits, besides deviations."""

WIDEST = 0.15
"""Largest deviation that plans reckon with, as a share of a range."""

PURSUED, LOOK_AHEAD = 100, 3
"""Inputs that are tried at each step of running after a guess, and steps for which they are held."""

WELL = -4.0
"""Logarithm of the failure from which a guess is not followed from other inputs."""

SLACK = (-12.0, -4.0)
"""Logarithms of the weights of states in feedbacks along runs of held inputs: nearly none, and little."""

BEGUN, FAR, OFTEN = 2, 3.0, 0.5
"""Batches of candidates along the best run of held inputs before it is compared with another path; by how much it may
score worse before that; and the failure of the other from which more work is spent on both."""

ENOUGH, CERTAIN = 1e-9, 1e-15
"""Failures from which a nominal path is not improved, and from which nothing more is looked for at all."""

AT_ONCE = 7000
"""Candidates that are looked at together, times the square of the states."""


@dataclass(frozen=True, eq=False)
class FeedbackTrajectory:
    """A nominal path with the best feedback that was found for it.

    ``score`` falls with the failure, and is a number also where the failure is 1; ``theta`` are the logarithms of the
    weights and strips, and ``shares`` (m, d) what gains are of those of the weights.
    """

    score: float
    failure: float
    nominal: NominalPath
    feedback: Feedback
    theta: FloatArray
    faces: NDArray[np.int64]
    spreads: Spreads
    weakest: str
    shares: FloatArray | float = 1.0

    @property
    def path(self) -> AgentPath:
        """The nominal path as the certificate holds it."""
        return AgentPath(self.nominal.inputs, self.feedback.gains[0], self.nominal.states, self.spreads.strips)


Improved = Callable[[NDArray[np.int8], FeedbackTrajectory], FeedbackTrajectory]
"""What makes a nominal path for letters better."""


class NonlinearSearch:
    """Nominal paths of one agent of a problem; what they take is counted."""

    def __init__(self, problem: Problem, i: int, work: CountedWork) -> None:
        self.work = work
        self.problem, self.agent = problem, problem.agents[i]
        shared = problem.shared_noise[i]
        self.model = NonlinearModel(self.agent, shared if np.any(shared) else None)
        self.rng = np.random.default_rng([20261123, i])
        self.narrowing, self.turning = (np.random.default_rng([seed, i]) for seed in (20261126, 20261130))
        self.holding = tuple(np.random.default_rng([20261129, k, i]) for k in range(2))
        self.tried, self.tries_inputs = 0, False
        agent = self.agent
        self.width = agent.state_high - agent.state_low
        self.half = np.maximum(0.5 * (agent.input_high - agent.input_low), 1e-9)
        low, high = agent.output_range(agent.state_low[None], agent.state_high[None])
        self.spans = np.where(np.isfinite(high - low), high - low, 1.0)[0]

    def watch(self, states: tuple[int, ...], width: float) -> None:
        """Keep some states in a tube of a width in deviations, as others name them."""
        self.model = self.model.changed(watched=states, width=width)

    def planned_anew(self, letters: NDArray[np.int8], found: FeedbackTrajectory) -> FeedbackTrajectory | None:
        """Return a nominal path planned anew from another one: its model may be another one by now."""
        return self._planned_anew(letters, found, reserves_for(found.failure)[0])

    def quick(
        self, letters: NDArray[np.int8], warm: FloatArray | None = None, bar: float = np.inf
    ) -> FeedbackTrajectory | None:
        """Return a nominal path for letters (S + 1, P) after little work; None if none was found.

        Where inputs are tried it is the run that they give; ways that are drawn are for where they give none. Where
        the best path after the first guess scores above ``bar``, it is left at that.
        """
        start = 0.5 * (self.agent.initial.low + self.agent.initial.high)
        run = candidate_run(self.problem, self.model, letters, start, self.work) if self.tries_inputs else None
        if run is not None:
            seen, _ = self.model.outputs(rolled(self.model, start, run))
            return self._along(letters, seen, run, warm)
        best: FeedbackTrajectory | None = None
        for guess in guesses(self.problem, self.agent, letters, start):
            for first in (self.first_inputs(len(letters) - 1), self._pursued(guess)):
                found = self._along(letters, guess, first, warm)
                if found is not None and (best is None or found.score < best.score):
                    best = found
                if best is not None and best.score < WELL:
                    break
            if best is not None and (best.score < np.log(0.5) or best.score > bar):
                break
        return best if best is None else self._or_held(letters, best, self._begun)

    def _or_held(self, letters: NDArray[np.int8], found: FeedbackTrajectory, improved: Improved) -> FeedbackTrajectory:
        """Return a nominal path whose inputs are held at first, improved, if it is better than one that fails often."""
        if found.failure < RARE or self.work.is_over() or not self.agent.n_inputs:
            return found
        drawn = self.rng, self.narrowing
        self.rng, self.narrowing = self.holding
        held = self._held(letters)
        held = found if held is None or held.score > found.score + FAR else improved(letters, held)
        # What is drawn elsewhere is the same with this and without.
        self.rng, self.narrowing = drawn
        return held if held.score < found.score else found

    def _begun(self, letters: NDArray[np.int8], found: FeedbackTrajectory) -> FeedbackTrajectory:
        """Return a nominal path that is at most as bad as another one, after little work."""
        found = self.searched(found, BEGUN)
        again = None if found.failure <= CERTAIN else self._planned_anew(letters, found)
        return again if again is not None and again.score < found.score else found

    def _held(self, letters: NDArray[np.int8]) -> FeedbackTrajectory | None:
        """Return the best nominal path whose inputs are held, with one of some slack feedbacks; None without any."""
        agent, tasks, sides = self.agent, list[Candidates](), []
        thetas = np.zeros((len(SLACK), self.n_numbers))
        thetas[:, : agent.n_states] = np.array(SLACK)[:, None]
        start = 0.5 * (agent.initial.low + agent.initial.high)
        for u in held_runs(self.problem, self.model, letters, self.work, self.rng):
            states = rolled(self.model, start, u)
            faces = sides_of(self.problem, agent, letters, self.model.outputs(states)[0], self.spans)
            if not limits_along(self.problem, agent, letters, faces).are_empty:
                tasks.append((self, self.snapped(letters, states, u, faces), thetas))
                sides.append(faces)
        if not tasks:
            return None
        each = [replace(one, faces=own) for (one, _), own in zip(scored(tasks, sides[0]), sides, strict=True)]
        return min(each, key=lambda one: one.score)

    def along_again(self, letters: NDArray[np.int8], found: FeedbackTrajectory) -> FeedbackTrajectory | None:
        """Return a nominal path for other letters, which may take more steps, from the inputs of one that was found."""
        u = found.nominal.inputs
        u = np.concatenate([u, np.repeat(u[-1:], max(0, len(letters) - 1 - len(u)), axis=0)])
        start = 0.5 * (self.agent.initial.low + self.agent.initial.high)
        seen, _ = self.model.outputs(rolled(self.model, start, u))
        return self._along(letters, seen, u, found.theta)

    def full(self, letters: NDArray[np.int8], found: FeedbackTrajectory) -> FeedbackTrajectory:
        """Return a nominal path that is better than one that was found, if there is work left for one."""
        if self.work.is_over() or found.failure <= CERTAIN:
            return found
        found = self._full(letters, found)
        return self._or_held(letters, found, self._full) if found.failure > OFTEN else found

    def _full(self, letters: NDArray[np.int8], found: FeedbackTrajectory) -> FeedbackTrajectory:
        """Return a nominal path that is better than one that was found, in its own way."""
        found = self.searched(found, GENERATIONS)
        reserves = [*reserves_for(found.failure)]
        for count in range(REPLANS + MORE_REPLANS):
            is_for_others = count >= REPLANS and found.failure > GOOD
            if found.failure <= ENOUGH or is_for_others or self.work.is_over() or not reserves:
                break
            again = self._planned_anew(letters, found, reserves[0])
            again = None if again is None else self.searched(again, GENERATIONS)
            if again is None or again.score >= found.score - 1e-3:
                reserves.pop(0)
            found = again if again is not None and again.score < found.score else found
        return self._beyond_drifts(letters, found)

    def _beyond_drifts(self, letters: NDArray[np.int8], found: FeedbackTrajectory) -> FeedbackTrajectory:
        """Return a nominal path that keeps all of the linearization error away from limits, where paths that keep less
        fail often.

        What is charged in a narrow place, or lost in a sharp bend, adds up to more linearization error than deviations:
        a plan that does not reckon with all of it keeps no reserve where it matters.
        """
        for _ in range(REPLANS):
            if found.failure < RARE or self.work.is_over():
                break
            again = self._planned_anew(letters, found, drift_share=1.0)
            again = None if again is None else self.searched(again, GENERATIONS)
            if again is None or again.score >= found.score - 1e-3:
                break
            found = again
        return found

    def _along(
        self, letters: NDArray[np.int8], guess: FloatArray, u: FloatArray, warm: FloatArray | None
    ) -> FeedbackTrajectory | None:
        """Return a nominal path that follows a guess at first, from inputs (S, m)."""
        agent, steps = self.agent, len(letters) - 1
        faces = sides_of(self.problem, agent, letters, guess, self.spans)
        limits = limits_along(self.problem, agent, letters, faces)
        if limits.are_empty:
            return None
        sharp = (
            np.tile(0.02 * self.width, (steps + 1, 1)), np.tile(0.02 * self.spans, (steps + 1, 1)),
            np.tile(0.05 * self.half, (steps, 1)),
        )  # fmt: skip
        x, y, push = ((each, np.zeros_like(each)) for each in sharp)
        for weight, rounds in ((30.0, 30), (1.0, 30), (0.0, 60)):
            aim = Aim(limits, x, y, push, guess, np.full(agent.n_outputs, weight * 50.0 / steps) / self.spans**2)
            states, u, cost = Planner(self.model, aim, self.work).improved(u, rounds)
            if not np.isfinite(cost):
                return None
            # Sides are those on which the plan is, as soon as it follows.
            outputs, _ = self.model.outputs(states)
            faces = sides_of(self.problem, agent, letters, outputs, self.spans)
            limits = limits_along(self.problem, agent, letters, faces)
            if limits.are_empty:
                return None
        nominal = self.snapped(letters, states, u, faces)
        found = self.of_thetas(nominal, faces, self.thetas(warm))
        again = None if found.failure <= CERTAIN else self._planned_anew(letters, found)
        return again if again is not None and again.score < found.score else found

    @property
    def n_numbers(self) -> int:
        """How many logarithms of weights and strips a candidate has."""
        return len(self._sizes) + len(self._round)

    @property
    def _sizes(self) -> FloatArray:
        """By how much logarithms of weights and strips differ: of the latter little."""
        d, m = self.agent.n_states, self.agent.n_inputs
        # The last d are spare: what a search draws hangs on how many numbers it draws, and these draws are tried.
        return np.concatenate([np.full(d + m, 2.0), [1.0], np.full(2 * d + m, 0.3)])

    @property
    def _round(self) -> FloatArray:
        """The same of strips at times at which more round regions are asked for than at others; empty without any."""
        return np.full(int(np.any(self.model.bent_outputs)), 0.5)

    def first_inputs(self, steps: int) -> FloatArray:
        """Return inputs (S, m) that stand nearly still: a little off, so that nothing stays on a line of symmetry."""
        off = 0.05 * self.half * self.rng.standard_normal((steps, len(self.half)))
        return np.clip(self._still() + off, self.agent.input_low, self.agent.input_high)

    def followed(
        self, letters: NDArray[np.int8], guess: FloatArray, faces: NDArray[np.int64], weight: float, rounds: int
    ) -> FloatArray:
        """Return inputs (S, m) that follow a guess (S + 1, p) of outputs, with a weight, after some rounds."""
        steps, limits = len(letters) - 1, limits_along(self.problem, self.agent, letters, faces)
        sharp = (
            np.tile(0.02 * self.width, (steps + 1, 1)), np.tile(0.02 * self.spans, (steps + 1, 1)),
            np.tile(0.05 * self.half, (steps, 1)),
        )  # fmt: skip
        x, y, push = ((each, np.zeros_like(each)) for each in sharp)
        aim = Aim(limits, x, y, push, guess, np.full(self.agent.n_outputs, weight * 50.0 / steps) / self.spans**2)
        planner = Planner(self.model, aim, self.work)
        starts = [self.first_inputs(steps), self._pursued(guess)]
        costs = [float(planner.cost(planner.rolled(u)[:, :, None], u[:, :, None])[0]) for u in starts]
        return planner.improved(starts[int(np.argmin(costs))], rounds)[1]

    def _pursued(self, guess: FloatArray) -> FloatArray:
        """Return inputs (S, m) by which an agent runs after a guess: at each step the best of some constant ones."""
        agent, steps = self.agent, len(guess) - 1
        x, inputs = 0.5 * (agent.initial.low + agent.initial.high), list[FloatArray]()
        still = self._still()
        for t in range(steps):
            share = self.rng.uniform(-1.0, 1.0, (PURSUED, len(still)))
            tried = 0.5 * (agent.input_low + agent.input_high) + share * self.half
            last = inputs[-1] if inputs else still
            # Some are near the last ones, so that inputs need not jump.
            tried[: PURSUED // 2] = last + 0.2 * (tried[: PURSUED // 2] - last)
            tried[0], tried[1] = last, still
            u = tried.T
            states, cost = np.repeat(x[:, None], PURSUED, axis=1), np.zeros(PURSUED)
            for k in range(1, LOOK_AHEAD + 1):
                states = self.model.step(states, u, min(t + k, steps) - 1)
                miss = (self.model.output.values(states) - guess[min(t + k, steps)][:, None]) / self.spans[:, None]
                cost = cost + np.sum(miss**2, axis=0)
            beyond = np.maximum(agent.state_low[:, None] - states, states - agent.state_high[:, None])
            cost = cost + np.sum(np.maximum(beyond / self.width[:, None], 0.0), axis=0)
            best = int(np.argmin(np.where(np.isfinite(cost), cost, np.inf)))
            inputs.append(tried[best])
            x = self.model.step(x[:, None], tried[best][:, None], t)[:, 0]
        return np.array(inputs)

    def _still(self) -> FloatArray:
        """Return the input (m,) that keeps the start where it is best, by least squares."""
        agent = self.agent
        x = 0.5 * (agent.initial.low + agent.initial.high)
        u = 0.5 * (agent.input_low + agent.input_high)
        for _ in range(3):
            _, B = self.model.linear(x[None], u[None])
            miss = (x - self.model.step(x[:, None], u[:, None], 0)[:, 0]) / self.width
            scaled = B[0] / self.width[:, None] * self.half
            push = np.linalg.solve(scaled.T @ scaled + 1e-6 * np.eye(len(u)), scaled.T @ miss)
            u = np.clip(u + self.half * push, agent.input_low, agent.input_high)
        return u if np.all(np.isfinite(u)) else 0.5 * (agent.input_low + agent.input_high)

    def snapped(
        self, letters: NDArray[np.int8], states: FloatArray, inputs: FloatArray, faces: NDArray[np.int64]
    ) -> NominalPath:
        """Return a nominal path with inputs near a limit put there."""
        agent = self.agent
        near = AT_LIMIT * 2.0 * self.half
        snapped = np.where(inputs <= agent.input_low + near, agent.input_low, inputs)
        snapped = np.where(inputs >= agent.input_high - near, agent.input_high, snapped)
        limits = limits_along(self.problem, agent, letters, faces)
        if np.any(snapped != inputs):
            aim_free = Planner(self.model, _nowhere(limits, self.agent.n_outputs, len(inputs)), self.work)
            states = aim_free.rolled(snapped)
        return NominalPath(self.model, limits, states, snapped)

    def _planned_anew(
        self, letters: NDArray[np.int8], found: FeedbackTrajectory, reserve: float = 1.0, drift_share: float = QUARTER
    ) -> FeedbackTrajectory | None:
        """Return a nominal path planned with deviations and linearization errors of another one; None if that fails."""
        agent, spreads = self.agent, found.spreads
        pairs = []
        for (sd, linearization_error, _), width in zip(
            (spreads.states, spreads.outputs, spreads.inputs), (self.width, self.spans, 2.0 * self.half), strict=True
        ):
            sharp = np.clip(reserve * sd, 1e-5 * width, WIDEST * width)
            pairs.append((sharp, np.clip(drift_share * linearization_error, 0.0, WIDEST * width)))
        outputs, _ = found.nominal.outputs
        sharp = np.median(pairs[1][0], axis=0)
        u, states, faces = found.nominal.inputs, found.nominal.states, found.faces
        for _ in range(3):
            limits = limits_along(self.problem, agent, letters, faces)
            limits = limits.for_nominal(spreads.states[2], spreads.outputs[2])
            aim = Aim(limits, pairs[0], pairs[1], pairs[2], outputs, np.zeros(agent.n_outputs))
            states, u, cost = Planner(self.model, aim, self.work).improved(u, 40)
            if not np.isfinite(cost):
                return None
            outputs, _ = self.model.outputs(states)
            new = sides_of(self.problem, agent, letters, outputs, sharp)
            if np.array_equal(new, faces) or limits_along(self.problem, agent, letters, new).are_empty:
                break
            faces = new
        nominal = self.snapped(letters, states, u, faces)
        return self.of_thetas(nominal, faces, self.around([found.theta], 0.3, BATCH // 2))

    def searched(self, found: FeedbackTrajectory, generations: int) -> FeedbackTrajectory:
        """Return a nominal path with the best feedback of some generations, each closer to the best candidates."""
        kept = [(found.score, found.theta)]
        for generation in range(generations):
            thetas = self.around([theta for _, theta in kept], 0.8 * 0.6**generation, BATCH)
            better, scores = self._scored(found.nominal, found.faces, thetas)
            kept = sorted([*kept, *zip(scores.tolist(), thetas, strict=True)], key=lambda pair: pair[0])[:4]
            if better.score < found.score:
                found = better
            if found.failure <= ENOUGH:
                break
        return found

    def thetas(self, warm: FloatArray | None) -> FloatArray:
        """Return a first batch of logarithms of weights and strips."""
        if warm is not None:
            return np.concatenate([[warm], self.around([warm], 0.5, BATCH // 2)])
        # Half of them are narrower where round regions are asked for.
        narrower = -self._round * self.narrowing.uniform(0.0, 2.0, (2 * BATCH, len(self._round)))
        narrower[:BATCH] = 0.0
        return np.hstack([self._sizes * self.rng.uniform(-1.0, 1.0, (2 * BATCH, len(self._sizes))), narrower])

    def around(self, parents: list[FloatArray], sigma: float, count: int = BATCH) -> FloatArray:
        """Return candidates around mixtures of pairs of parents; the first parent is among them."""
        size = self._sizes
        chosen = np.array(parents)[self.rng.integers(len(parents), size=(count, 2))]
        share = self.rng.random((count, 1))
        # Most candidates move a part of their numbers.
        moved = self.rng.random((count, len(size))) < self.rng.choice([0.2, 0.5, 1.0], (count, 1))
        made = share * chosen[:, 0] + (1 - share) * chosen[:, 1]
        moves = moved * size * self.rng.standard_normal((count, len(size)))
        narrower = self._round * self.narrowing.standard_normal((count, len(self._round)))
        made = made + sigma * np.hstack([moves, narrower])
        made[0] = parents[0]
        return made

    def of_thetas(self, nominal: NominalPath, faces: NDArray[np.int64], thetas: FloatArray) -> FeedbackTrajectory:
        """Return the best of some candidates of feedback along a nominal path."""
        return self._scored(nominal, faces, thetas)[0]

    def _scored(
        self, nominal: NominalPath, faces: NDArray[np.int64], thetas: FloatArray
    ) -> tuple[FeedbackTrajectory, FloatArray]:
        """Return the best of some candidates, and the scores of all: infinite of those that nobody needs any more."""
        scores, parts = np.full(len(thetas), np.inf), list[FeedbackTrajectory]()
        together = max(1, AT_ONCE // self.agent.n_states**2)
        for first in range(0, len(thetas), together):
            found, own = scored([(self, nominal, thetas[first : first + together])], faces)[0]
            scores[first : first + together] = own
            parts.append(found)
            if found.failure <= CERTAIN:
                break
        return min(parts, key=lambda one: one.score), scores


def reserves_for(failure: float) -> tuple[float, ...]:
    """Return what plans that are made anew take a deviation for, in deviations, where paths so far fail so often."""
    return RESERVES[0] if failure < RARE else RESERVES[1]


Candidates = tuple[NonlinearSearch, NominalPath, FloatArray]
"""A search with a nominal path of its agent and logarithms of weights and strips (N, k)."""


def scored(tasks: Sequence[Candidates], faces: NDArray[np.int64]) -> list[tuple[FeedbackTrajectory, FloatArray]]:
    """Return, for each of some agents that are alike, the best of its candidates and the scores of all."""
    which = np.repeat(np.arange(len(tasks)), [len(thetas) for _, _, thetas in tasks])
    paths = [nominal for _, nominal, _ in tasks]
    tasks[0][0].work.walk(len(paths[0].inputs), tasks[0][0].agent.n_states, len(which))
    feedback = feedback_of(tasks[0][0], paths, which, np.concatenate([thetas for _, _, thetas in tasks]))
    worth, spreads = worth_of(paths, feedback, which)
    scores = worth.scores()
    scores = np.where(np.isfinite(scores), scores, np.inf)
    judged, failures, result = (worth, spreads, feedback), worth.failures(), []
    for k, (search, nominal, thetas) in enumerate(tasks):
        search.tried += len(thetas)
        here = np.flatnonzero(which == k)
        own = scores[here]
        best = int(np.argmin(own))
        c = int(here[best])
        values = float(own[best]), float(failures[c])
        result.append((found_of(judged, c, values, nominal, thetas[best], faces), own))
    return result


def found_of(
    judged: tuple[Worth, Spreads, Feedback],
    c: int,
    values: tuple[float, float],
    nominal: NominalPath,
    theta: FloatArray,
    faces: NDArray[np.int64],
) -> FeedbackTrajectory:
    """Return candidate c of those that were judged together, with its score and failure.

    A nominal state outside of the workspace fails: no certificate is made of it.
    """
    worth, spreads, feedback = judged
    values = values if is_inside(nominal) else (values[0], 1.0)
    alone = Feedback(feedback.gains[c : c + 1], feedback.strips[c : c + 1])
    return FeedbackTrajectory(*values, nominal, alone, theta, faces, spreads.of(c), worth.weakest(c))


def is_inside(nominal: NominalPath) -> bool:
    """Return whether nominal states lie in the closed workspace."""
    agent = nominal.model.agent
    return not np.any((nominal.states < agent.state_low) | (nominal.states > agent.state_high))


def feedback_of(
    search: NonlinearSearch, paths: Sequence[NominalPath], which: NDArray[np.int64], thetas: FloatArray
) -> Feedback:
    """Return the feedbacks of candidates (N, k), each along the path ``which`` (N,)."""
    d, m = search.agent.n_states, search.agent.n_inputs
    base = np.concatenate([1.0 / (0.05 * search.width) ** 2, 1.0 / search.half**2, [1.0]])
    weights = base * np.exp(np.clip(thetas[:, : d + m + 1], -16.0, 16.0))
    strips = 4.5 * np.exp(np.clip(thetas[:, d + m + 1 : 2 * (d + m) + 1], -1.5, 1.5))
    strips[:, list(search.model.watched)] = search.model.width
    low, high = search.agent.input_low, search.agent.input_high
    A, B = (np.stack([path.linear[k] for path in paths], axis=1)[:, which] for k in (0, 1))
    inputs = np.stack([path.inputs for path in paths], axis=1)[:, which]
    gains = feedback_gains(A, B, weights, (inputs <= low) | (inputs >= high))
    each = np.repeat(strips[:, None], gains.shape[1] + 1, axis=1)
    if np.any(search.model.bent_outputs):
        counts = np.stack([np.isfinite(path.limits.outputs).sum(axis=(0, 2)) for path in paths])
        asked = (counts > counts[:, 1:].min(axis=1, keepdims=True))[which]
        narrower = np.where(asked, np.exp(np.clip(thetas[:, -1:], -1.5, 1.5)), 1.0)
        each[:, :, :d] = each[:, :, :d] * narrower[..., None]
    return Feedback(np.where(np.isfinite(gains), np.clip(gains, -1e6, 1e6), 0.0), each)


def _nowhere(limits: object, p: int, steps: int) -> Aim:
    """Return an aim that is about nothing, for simulations."""
    nothing = (np.ones((steps, 1)), np.zeros((steps, 1)))
    return Aim(limits, nothing, nothing, nothing, np.zeros((steps + 1, p)), np.zeros(p))  # type: ignore[arg-type]
