"""A synthesis on given cells: under one relation per agent, or the best of those that apply."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ....envs.tasks.problem import Problem
from ...abstraction.models import Abstraction, JointModel, Policies, Settings, abstraction_of, join
from ...certificates.proofs import OnGrid, Synthesis, checked_certificate
from ...relations.grids import CellCounts
from ...trajectories.planning import CountedWork
from ..ascent import FINAL, Relaxation, Search, Sweep, find_policies, stationary_best
from ..portfolio import Effort, Tries, groups_of, policies_from, with_settings
from .certification import against_losses, certified

Clock = tuple[float, float]
"""When the work began, and when the finite models were finished, in seconds of ``perf_counter``."""


@dataclass(frozen=True)
class Plan:
    """How a task is to be synthesized, apart from its cells and relations.

    Parameters
    ----------
    settings : Settings
        Settings of the relations.
    search : Search
        How policies are searched for.
    effort : Effort
        What the task may still take.
    paths : bool
        Whether paths, which have no cells, may be tried as well.
    """

    settings: Settings
    search: Search
    effort: Effort
    paths: bool = True

    @property
    def along_paths(self) -> CountedWork:
        """What a search along paths may take: all that is left of the effort."""
        progress = self.effort.progress
        told = (lambda bound: None) if progress is None else (lambda bound: progress("path", bound))
        return CountedWork(
            self.effort.left,
            lambda: self.effort.is_over,
            told=told,
            hoped=self.effort.tell_hoped,
            suffices=self.effort.suffices,
            counted=self.effort.tell_again,
            is_hopeless=bool(self.effort.lost),
        )

    def anew(self) -> Plan:
        """Return the plan of another task: with as much effort, whose clock its search heeds."""
        effort = self.effort.anew()
        search = replace(self.search, progress=effort.heeding(self.search.progress), spend=effort.count)
        return replace(self, effort=effort, search=search)


def plain(
    problem: Problem, cells: CellCounts, kinds: Sequence[str], plan: Plan, start: OnGrid | None = None
) -> Synthesis:
    """Synthesize on given cells under one given relation per agent."""
    began = time.perf_counter()
    abstraction = abstraction_of(problem, cells, kinds, plan.settings)
    abstracted = time.perf_counter()
    policies = {} if start is None else policies_from(start, problem, abstraction)
    result = searched(problem, abstraction, join(problem, abstraction), plan.search, policies)
    return replace(result, stats={**result.stats, "seconds": seconds_of_work((began, abstracted))})


def continued(problem: Problem, cells: CellCounts, kinds: Sequence[str], plan: Plan, start: OnGrid) -> Synthesis:
    """Synthesize from the policies of a certificate; cells and relations default to those of the certificate."""
    start = checked_certificate(start, "start")
    of_start = [part.relation["kind"] for part in start.proof.agents]
    if cells is None and len(of_start) == problem.n_agents:
        cells = dict(zip(problem.agent_names, (part.grid.shape for part in start.proof.agents), strict=True))
    if len(of_start) == len(kinds) and "auto" in kinds:
        kinds = [of_one if kind == "auto" else kind for kind, of_one in zip(kinds, of_start, strict=True)]
        plan = replace(plan, settings=plan.settings.of_kinds(kinds))
    return plain(problem, cells, kinds, plan, start)


def compared(
    problem: Problem, cells: CellCounts, kinds: Sequence[str], plan: Plan, quick_result: Synthesis | None = None
) -> Synthesis:
    """Return the synthesis with the largest bound among all relations that apply.

    The certificate records which relations were tried. ``quick_result`` is a synthesis on the same cells, if there is
    one already.
    """
    began = time.perf_counter()
    tries = Tries(problem, groups_of(problem, cells, kinds, plan.settings), plan.settings)
    abstracted = time.perf_counter()

    def run(abstraction: Abstraction, joint: JointModel, relaxations: tuple[Relaxation, ...]) -> Synthesis:
        return searched(problem, abstraction, joint, plan.search, {}, relaxations)

    best, tried = tries.best(run, quick_result, every="best" in kinds)
    stats = {**best.stats, "seconds": seconds_of_work((began, abstracted))}
    if len(tried) == 1:
        return replace(best, stats={**stats, "tried": tried})
    return with_settings(replace(best, stats={**stats, "tried": tried}), {"relations_tried": tried})


def searched(
    problem: Problem,
    abstraction: Abstraction,
    joint: JointModel,
    search: Search,
    starts: dict[str, Policies],
    relaxations: tuple[Relaxation, ...] | None = None,
) -> Synthesis:
    """Search on finite models, from the policies ``starts`` if there are any, and certify the result."""
    result = find_policies(problem, joint, search, starts, relaxations)
    best = stationary_best(problem, joint, result, search.limits) if search.stationary else result.best
    name = f"{'stationary policies from ' if search.stationary else ''}occupancy-weighted coordinate ascent"
    used = {**abstraction.settings, **search.used(), "final_limits": vars(FINAL)}
    loses = any(model.delta > 0.0 for model in joint.models)
    if not loses or search.stationary or search.max_sweeps == 0 or not isinstance(best, Sweep):
        return certified(problem, abstraction, joint, result, best, used, name)
    best, largest = against_losses(problem, abstraction, joint, best)
    # What one agent alone could gain was computed for the nominal value of other policies.
    synthesis = certified(problem, abstraction, joint, replace(result, unilateral_gain=None), best, used, name)
    return replace(synthesis, stats={**synthesis.stats, "largest_bounds": largest})


def seconds_of_work(clock: Clock) -> dict[str, float]:
    """Return the seconds that the finite models took, and those from then until now."""
    began, abstracted = clock
    return {"abstract": abstracted - began, "synthesize": time.perf_counter() - abstracted}
