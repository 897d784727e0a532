"""Certificates of teams on finer and finer grids whose vertices have inputs."""

from __future__ import annotations

from typing import Any

import numpy as np

from ....envs.tasks.problem import Problem
from ...certificates.proofs import NotCanonicalError, Synthesis, VertexTeamProof, canonical_problem
from ...checker import CheckedProblem, Refused, Unreadable, read_problem
from ...extended_check.vertex_grids import NEAR, alone
from ...relations.grids import FloatArray, RelationRefused
from ...trajectories.planning import CountedWork
from .axis_edges import grid_of, moving_grid_of, spreads_of
from .best_grid import AIMS, CLAIMED, ENOUGH, GAINS, SEEN, BestGrid, left_over
from .counted_backups import Counted
from .input_choice import INPUTS
from .sampled_runs import RUNS, Runs
from .team_iteration import TeamGrids, TeamIteration
from .value_iteration import (
    FINER_STEPS,
    FIRST,
    MORE,
    MOST_VERTICES,
    POOR_GUESS,
    hull,
    jumps_of,
    lattice_around,
    moving_windows,
    near_of,
    refuse_small_noise,
    whole_of,
    within,
)

MOST_TEAM_STATES = 2
"""States of an agent up to which a team has such grids."""

UNCOUPLED = 0.05
"""Failure of agents that take others to be anywhere from which on they are tried as hopeful, too."""

ROUNDS = 2
"""How often each agent of a team answers, one after the other, on the coarse grid."""


def refuse_vertex_team(problem: Problem) -> CheckedProblem:
    """Return a team's problem as the check reads it; RelationRefused where grids of vertices do not apply."""
    if problem.n_agents == 1:
        raise RelationRefused("a team has several agents")
    for agent in problem.agents:
        if agent.n_states > MOST_TEAM_STATES or agent.n_inputs not in INPUTS:
            raise RelationRefused(
                f"grids of teams have {MOST_TEAM_STATES} states and {max(INPUTS)} inputs of an agent at most"
            )
    try:
        checked = read_problem({"problem": canonical_problem(problem)})
        for i, agent in enumerate(problem.agents):
            own = alone(checked, i)
            steps = Counted(own, whole_of(own), (True,) * agent.n_states, NEAR, agent.laws)
            if not any(steps.noisy):
                raise RelationRefused(f"agent `{agent.name}` has no noise")
            refuse_small_noise(spreads_of(own), own.agents[0].state_box)
    except (Refused, Unreadable, NotCanonicalError) as reason:
        raise RelationRefused(str(reason)) from reason
    return checked


def vertex_team_certificate(problem: Problem, work: CountedWork, guess: Any = None) -> Synthesis:
    """Return the certificate of the best grids that the work allows; RelationRefused where there is none.

    Runs under the controllers ``guess`` say where agents are, if many of them satisfy the task.
    """
    search = _TeamSearch(problem, refuse_vertex_team(problem), work)
    search.refine(guess)
    return search.best.synthesis(problem)


class _TeamSearch:
    """Grids of a team, one finer than the other; the best proof is kept."""

    def __init__(self, problem: Problem, checked: CheckedProblem, work: CountedWork) -> None:
        self.problem, self.checked, self.work = problem, checked, work
        self.best = BestGrid[VertexTeamProof](work)
        self.alone = [alone(checked, i) for i in range(problem.n_agents)]
        self.spreads = [spreads_of(own) for own in self.alone]
        self.alive = [own.agents[0].state_box for own in self.alone]
        self.windows = self.alive
        self.finer: list[FloatArray] = [np.ones(len(own)) for own in self.spreads]
        self.vertices = [float(FIRST[len(own)]) for own in self.spreads]
        self.most = [MOST_VERTICES[len(own)] for own in self.spreads]

    def grids(self) -> TeamGrids:
        """Return the grids of a level."""
        steps = []
        for i, own in enumerate(self.alone):
            make: Any = moving_grid_of if self.windows[i].ndim > 2 else grid_of
            edges = make(own, self.spreads[i], round(self.vertices[i]), self.windows[i], self.finer[i])
            laws = self.problem.agents[i].laws
            steps.append(Counted(own, edges, jumps_of(own, edges), NEAR, laws).within(self.work))
        return TeamGrids(self.problem, self.checked, steps)

    def runs_of(self, grids: TeamGrids, iteration: TeamIteration) -> Runs:
        """Return runs of the team under the laws of a sweep."""
        return Runs.under(self.problem, grids.proof(iteration.choices).controller(self.problem))

    def coarse(self, runs: Runs | None) -> Runs:
        """Return runs under laws of coarse values: agents answer to runs of one another, one after the other."""
        self.alive, everyone = self.grids().alive(), range(self.problem.n_agents)
        self.windows = self.alive
        began = [self._begun(runs, is_hopeful=False)]
        if runs is None and began[0][2].failure > UNCOUPLED:
            began.append(self._begun(None, is_hopeful=True))
        grids, iteration, best = min(began, key=lambda own: own[2].failure)
        best = best if runs is None else runs.or_better(best)
        for _ in range(ROUNDS):
            before = best.failure
            for i in everyone:
                if best.failure * RUNS >= SEEN:
                    iteration.sweep(best, [i])
                    best = best.or_better(self.runs_of(grids, iteration))
                    self.work.hoped(1.0 - best.failure)
            if best.failure > (1.0 - GAINS) * before:
                break
        if (1.0 - best.failure) * RUNS < SEEN:
            raise RelationRefused("runs under coarse values hardly ever satisfy the task")
        return best

    def _begun(self, runs: Runs | None, is_hopeful: bool) -> tuple[TeamGrids, TeamIteration, Runs]:
        """Return coarse grids after a first sweep, and runs under its laws."""
        grids = self.grids()
        iteration = TeamIteration(grids, runs, AIMS[0], is_coarse=True, is_hopeful=is_hopeful)
        iteration.sweep(runs, range(self.problem.n_agents))
        return grids, iteration, self.runs_of(grids, iteration)

    def refine(self, guess: Any) -> None:
        """Look for the best proof on finer and finer grids."""
        best = self.best
        runs = None if guess is None else Runs.under(self.problem, guess)
        runs = None if runs is None or runs.failure >= POOR_GUESS else runs
        with best.kept():
            runs = self.coarse(runs)
            while True:
                self._look(runs)
                grids, iteration, failure = self._level(runs)
                is_best = best.tried(" and ".join(" x ".join(map(str, own.shape)) for own in grids.steps), failure)
                runs = runs.or_better(self.runs_of(grids, iteration))
                if is_best:
                    best.keep(grids.proof(iteration.choices, min(1.0, failure * CLAIMED)), failure)
                least, more = left_over(failure), self._more(grids)
                is_good = least is not None and runs.failure > least
                if failure < ENOUGH or best.is_slow or is_good or more is None:
                    break
                self._refine(grids, more)

    def _level(self, runs: Runs) -> tuple[TeamGrids, TeamIteration, float]:
        """Return grids with laws for all agents, and an upper bound on the failure."""
        grids = self.grids()
        for own, window in zip(grids.steps, self.windows, strict=True):
            own.near, own.window = near_of(own, max(runs.failure, self.best.aim)), lattice_around(own, window)
        iteration = TeamIteration(grids, runs, self.best.aim)
        iteration.sweep(runs, range(self.problem.n_agents))
        return grids, iteration, grids.proved(iteration.choices)

    def _look(self, runs: Runs) -> None:
        """Set the windows in which cells are narrow: where runs pass, which may be elsewhere than before."""
        self.windows = [*self.windows]
        for i, (own, columns) in enumerate(zip(self.alone, self.problem.columns, strict=True)):
            mine, spreads, before = runs.of_agent(columns), self.spreads[i], self.windows[i]
            if before.ndim > 2:
                self.windows[i] = hull(before, mine.windows(own, spreads))
                continue
            windows, _, is_smaller = moving_windows(own, spreads, mine)
            self.windows[i] = windows if is_smaller else within(self.alive[i], mine.window(own, spreads))

    def _more(self, grids: TeamGrids) -> float | None:
        """Return how many times as many vertices the next grids have; None where the work does not allow it."""
        for step in FINER_STEPS:
            more = min([float(step), *(most / count for most, count in zip(self.most, self.vertices, strict=True))])
            work = sum(own.grown(more, laws) for own, laws in zip(grids.steps, grids.laws, strict=True))
            if more > 1.0 and self.work.allows(MORE * work):
                return more
        return None

    def _refine(self, grids: TeamGrids, more: float) -> None:
        """Take more vertices, and more of them along axes along which more is charged."""
        for i, own in enumerate(grids.steps):
            self.vertices[i] *= more
            self.finer[i] = self.finer[i] * own.wanted
