"""Runs of inputs that are held: all the time, or until one time and others after that.

Where noise is large little feedback may be best, and that along runs which keep far from all limits by themselves. A
plan that is made for stiff feedback never comes there: it keeps inputs free to act, and they stand in the middle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from ..chance_constraints import NonlinearModel
from .candidate_runs import LEVELS, OFFERED, STEP, Places
from .counted_work import CountedWork

DRAWN = 600
"""Runs that are drawn."""

KEPT = 96
"""Runs that are handed over: the best ones, each of other inputs."""


def held_runs(
    problem: Problem,
    model: NonlinearModel,
    letters: NDArray[np.int8],
    work: CountedWork,
    rng: np.random.Generator,
) -> list[FloatArray]:
    """Return inputs (S, m) of the runs without noise that keep letters (S + 1, P) best, and stay in the workspace."""
    agent, steps, places = model.agent, len(letters) - 1, Places(problem, model.agent)
    most = LEVELS.get(agent.n_inputs, OFFERED) - 1
    levels, until = rng.integers(most + 1, size=(2, agent.n_inputs, DRAWN)), rng.integers(steps, size=DRAWN)
    levels[0] = np.where(until > 0, levels[0], levels[1])
    inputs = agent.input_low[:, None] + levels / most * (agent.input_high - agent.input_low)[:, None]
    x, total = np.repeat(0.5 * (agent.initial.low + agent.initial.high)[:, None], DRAWN, axis=1), np.zeros(DRAWN)
    work.count(STEP * DRAWN * steps)
    with np.errstate(all="ignore"):  # agents that are unstable may run away
        for t in range(1, steps + 1):
            x = model.step(x, np.where(t <= until, *inputs), t - 1)
            spare = [within * wanted for within, wanted in zip(places.depths(t, x), letters[t, places.own]) if wanted]
            total = total + places.cost(x, spare)
    best = dict[bytes, int]()
    for k in np.argsort(total, kind="stable")[: np.count_nonzero(np.isfinite(total))].tolist():
        best.setdefault(levels[:, :, k].tobytes(), k)
    is_first = np.arange(steps)[:, None] < until
    return [np.where(is_first[:, [k]], *inputs[:, :, k]) for k in [*best.values()][:KEPT]]
