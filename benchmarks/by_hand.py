"""What an engineer does first, for ``own_models.py``: a plan without noise, and linear-quadratic feedback around it.

The search tries the same where it certifies nothing (``cell_certificates/textbook_feedback.py`` of ``policy_search``).
The plan that does best in a few rollouts is taken. Nothing is certified; further rollouts say how often the task is
satisfied.
"""

from __future__ import annotations

import certigym as cg
from certigym.synthesis.abstraction.models import Settings
from certigym.synthesis.policy_search.ascent import Search
from certigym.synthesis.policy_search.cell_certificates import Plan, rollouts_of, textbook_runs
from certigym.synthesis.policy_search.portfolio import Effort
from certigym.validation.statistical_tests import TrialPlan, clopper_pearson

SHARES, EPISODES, CONFIDENCE = (0.1, 0.5, 1.0), 20_000, 0.999


def by_hand(problem: cg.Problem, seed: int) -> tuple[float, float] | None:
    """Return exact limits of the rate of success, or None where there is no plan to follow."""
    low, high = 1.0, 1.0
    for task in problem.tasks if problem.groups else (problem,):
        plan = Plan(Settings(), Search(), Effort())
        runs = [runs[-1] for share in SHARES if (runs := textbook_runs(task, share, plan, plan.effort.limit))]
        if not runs:
            return None
        best = max(runs, key=lambda run: rollouts_of(task, run.controller)[0])
        found = cg.rollout(task, best.controller, TrialPlan(EPISODES, seed))
        limits = clopper_pearson(found.successes, found.episodes, CONFIDENCE)
        low, high = low * limits[0], high * limits[1]
    return low, high
