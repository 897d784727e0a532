"""Textbook feedback where nothing is certified: LQR around nominal trajectories, clipped, the best of some in rollouts.

A claim of 0 says nothing of its controllers, and those of a search for bounds may be poor where noise is large. An
engineer linearises dynamics along a run without noise, weighs states by the widths of their workspaces and inputs by
those of their boxes, and clips what the feedback asks for. Runs that are found for a tenth, half and all of the noise
keep away from limits by different amounts. Rollouts choose; they prove nothing, and say where most episodes fail.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.simulation import Dynamics, batch_simulator, letters
from ....envs.systems.agents import AnyAgent
from ....envs.tasks.problem import Problem
from ...certificates.proofs import AgentPath, AlongPath, Synthesis, changed
from ...extended_check.claims import checked_once
from ...relations.grids import FloatArray
from ..portfolio import with_settings
from .agreement import agreed, along_path
from .on_cells import Plan

NOTHING = 1e-4
"""Bound up to which controllers are chosen by rollouts: it says no more than 0 does."""

SHARES = (0.1, 0.5, 1.0)
"""Shares of the noise for which runs are found."""

EPISODES, SEED, BETTER = 1000, 20240, 10
"""Rollouts of each controller, their seed, and by how many successes other feedback has to be better."""

FEEDBACK = {True: "with linear-quadratic feedback that is clipped", False: "with feedback for less noise"}
"""What is said of the controllers."""

MOST_WORK = 4.0
"""Core seconds that each run may take."""

STEP = 1e-5
"""Share of a range by which Jacobians look to each side."""


def with_textbook_feedback(found: Synthesis, plan: Plan) -> Synthesis:
    """Return a synthesis that certifies nothing with controllers at least as good as textbook feedback in rollouts.

    Others are returned as they are. ``stats["nothing"]`` says then, too, why most rollouts fail.
    """
    problem, effort = found.certificate.problem, plan.effort
    if found.certificate.lower_bound > NOTHING or effort.lost or effort.is_interrupted or effort.is_over:
        return found
    tried = [(rollouts_of(problem, found.controller), found, False)]
    for share in SHARES:
        effort.tell(f"textbook feedback, {share:g} of the noise", 0.0)
        for number, run in enumerate(textbook_runs(problem, share, plan)):
            other = replace(found, certificate=run, controller=run.controller)
            tried.append((rollouts_of(problem, run.controller), other, number > 0))
    tried.sort(key=lambda one: one[0][0] - BETTER * (one[1] is not found), reverse=True)
    # Of some runs the check proves not even that: a tube may be as wide as a turn of an angle.
    (successes, why), best, is_lqr = next((one for one in tried if checked_once(one[1].certificate)), tried[0])
    said = f"in {EPISODES} rollouts {successes} satisfy the task"
    said += f", most others fail as {why}" if why else ""
    said += "" if best is found else f"; the controllers follow a run without noise, {FEEDBACK[is_lqr]}"
    # What is most likely to be lost by the bounds of a path is no news beside what rollouts lose.
    first = str(found.stats.get("nothing", "")).partition(", with noise most")[0]
    nothing = f"{first}; {said}" if first else said
    proved = agreed(best)
    best = proved if proved.certificate.lower_bound > NOTHING else best
    best = with_settings(best, {**found.certificate.settings, "nothing": nothing})
    return replace(best, stats={**found.stats, "nothing": nothing})


def textbook_runs(problem: Problem, share: float, plan: Plan, most: float = MOST_WORK) -> list[AlongPath]:
    """Return runs that are found for a share of the noise, as claims of nothing: as they are, and with LQR.

    What the search believed of less noise is left out.
    """
    work = replace(plan.along_paths, limit=most, told=lambda bound: None, counted=lambda spent: None)
    try:
        run: AlongPath = along_path(problem.replace(disturbance_scale=share), work).certificate
    except ValueError:
        return []
    settings = {key: value for key, value in run.settings.items() if key != "believed"}
    own = changed(run, problem=problem, settings=settings, failure=1.0)
    if any(agent.others for agent in problem.agents):
        return [own]
    pairs = zip(problem.agents, own.proof.paths, own.controller.nominal, strict=True)
    return [own, changed(own, paths=tuple(_followed(*pair) for pair in pairs))]


def _followed(agent: AnyAgent, path: AgentPath, states: FloatArray) -> AgentPath:
    """Return a nominal trajectory (S + 1, d) with the gains (S, m, d) of finite-horizon LQR."""
    width, half = agent.state_high - agent.state_low, 0.5 * (agent.input_high - agent.input_low)
    half = np.maximum(half, 1e-9)
    P = Q = np.diag(1.0 / width**2)
    R, gains = np.diag(1.0 / half**2), []
    for t in reversed(range(path.n_steps)):
        A, B = _jacobians(agent.at(t), states[t], path.inputs[t], np.concatenate([width, half]))
        K = -np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
        P = Q + A.T @ P @ (A + B @ K)
        gains.append(K)
    strips = np.full((path.n_steps + 1, agent.n_states + agent.n_inputs), np.inf)
    return AgentPath(path.inputs, np.array(gains[::-1]), states, strips)


def _jacobians(agent: AnyAgent, x: FloatArray, u: FloatArray, ranges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Jacobians (d, d) and (d, m) of the mean, by central differences."""
    d, columns = len(x), []
    for off in STEP * np.diag(ranges):
        ends = [agent.mean(x + sign * off[:d], u + sign * off[d:]) for sign in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2.0 * off.sum()))
    both = np.stack(columns, axis=1)
    return both[:, :d], both[:, d:]


def rollouts_of(problem: Problem, controller: Any) -> tuple[int, str]:
    """Return how many of some rollouts satisfy a task, an estimate, and as what most of the others fail, in words."""
    dynamics = Dynamics.of(problem)
    policy, rng = controller.batch(dynamics), np.random.default_rng(SEED)
    worlds = batch_simulator.initial(dynamics, rng, EPISODES)
    memory = policy.begin(worlds, np.random.default_rng(SEED + 1))
    names, dead = problem.automaton.propositions, np.asarray(problem.automaton.dead)
    before = letters(dynamics, worlds.states, 0)
    lost, causes = worlds.failed | dead[worlds.q], list[tuple[str, int]]()
    for t in range(1, problem.horizon + 1):
        if np.all(lost | worlds.accepted):
            break
        inputs, memory = policy.act(worlds, memory)
        worlds = batch_simulator.transition(dynamics, worlds, inputs, batch_simulator.noise(dynamics, rng, EPISODES))
        now, over = letters(dynamics, worlds.states, t), worlds.failed | dead[worlds.q]
        for m in np.flatnonzero(over & ~lost):
            causes.append((_cause(names, before[:, m], now[:, m]), t))
        before, lost = now, lost | over
    successes = int(np.count_nonzero(batch_simulator.satisfied(dynamics, worlds)))
    causes += [("it is not done at the end", problem.horizon)] * (EPISODES - successes - len(causes))
    if not causes:
        return successes, ""
    most = Counter(cause for cause, _ in causes).most_common(1)[0][0]
    times = [t for cause, t in causes if cause == most]
    return successes, most if times[0] == problem.horizon else f"{most}, half of these by step {int(np.median(times))}"


def _cause(names: tuple[str, ...], before: NDArray[np.bool_], now: NDArray[np.bool_]) -> str:
    """Return what changed at the step at which a task was lost, in words."""
    entered, left = np.flatnonzero(now & ~before), np.flatnonzero(before & ~now)
    if len(left):
        return f"`{names[left[0]]}` is left"
    return f"`{names[entered[0]]}` is entered" if len(entered) else "an agent leaves its workspace"
