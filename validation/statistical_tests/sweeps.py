"""A problem synthesized, checked and validated at many horizons."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from ...envs.tasks.problem import Problem
from ...synthesis.certificates.proofs import Certificate, Synthesis
from ...synthesis.composition import each_horizon
from ...synthesis.verbs.synthesize import synthesize
from .success_rate import ValidationReport, validate
from .trials import TrialPlan


def each_report(
    problem: Problem, horizons: Iterable[int], plan: TrialPlan, settings: Mapping[str, Any] | None = None
) -> Iterator[ValidationReport]:
    """Synthesize, check and validate the problem at every horizon; yield the reports one by one, as horizons increase.

    Each search begins with the policies of the horizon before (``synthesize`` with several horizons).

    Parameters
    ----------
    problem : Problem
    horizons : iterable of int
        Control steps.
    plan : TrialPlan
        Plan of each validation.
    settings : mapping, optional
        Arguments of ``synthesize``, such as ``cells``.
    """
    settings = dict(settings or {})
    anew = settings.get("relation") == "best"

    def once(task: Problem, begun: Certificate | None) -> Synthesis:
        return synthesize(task, start=None if anew else begun, **settings)

    for result in each_horizon(problem, horizons, once):
        yield validate(result, plan)
