"""Names of 0.3 and before that are called otherwise now: they work for one release, and say what to write."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from importlib import import_module
from typing import Any

MOVED: dict[str, tuple[str, str]] = {
    "AuditReport": ("validation.audits", "AuditReport"),
    "Comparison": ("validation.policies", "Comparison"),
    "Controller": ("synthesis.controllers", "Controller"),
    "FieldReport": ("validation.verdicts", "FieldReport"),
    "InputTable": ("synthesis.controllers", "InputTable"),
    "Permission": ("synthesis.permissions", "Permission"),
    "Probe": ("validation.policies", "Probe"),
    "Rollouts": ("validation.simulation", "Rollouts"),
    "StressReport": ("validation.verdicts", "StressReport"),
    "TrialPlan": ("validation.simulation", "TrialPlan"),
    "ValidationReport": ("validation.verdicts", "ValidationReport"),
    "certified_starts": ("synthesis.nominal_paths", "certified_starts"),
}
"""Names that are no longer at the top, and the rooms at whose doors they are."""

RENAMED: dict[str, tuple[str, str, str]] = {
    "automaton_from_hoa": ("translate(text, propositions)", "envs.logic", "automaton_from_hoa"),
    "automaton_from_transitions": ("translate({...}, propositions)", "envs.logic", "automaton_from_transitions"),
    "bound_above": ("synthesize(..., above=True)", "synthesis.upper_ends", "bound_above"),
    "check_permission": ("check", "synthesis.permissions", "check_permission"),
    "load_certificate": ("load", "synthesis.certificates", "load_certificate"),
    "load_permission": ("load", "synthesis.permissions", "load_permission"),
    "load_problem": ("load", "envs.problem", "load_problem"),
    "repair_network": ("improve(..., as_is=True)", "synthesis.raw_networks", "repair_network"),
    "save_certificate": ("save", "synthesis.certificates", "save_certificate"),
    "save_permission": ("save", "synthesis.permissions", "save_permission"),
    "save_policy": ("save", "synthesis.bridges", "save_policy"),
    "shielded": ("shield", "validation.shields", "shield"),
}
"""Old names, what to write in their place, and the rooms that have what they meant."""


def _synthesize_horizons(problem: Any, horizons: Any, cells: Any = None, **settings: Any) -> Any:
    from .synthesis.synthesize import synthesize

    return synthesize(problem, cells, horizon=horizons, **settings)


def _without_deadline(problem: Any, cells: Any = None, *, tolerance: float = 1e-6, **settings: Any) -> Any:
    from .synthesis.synthesize import synthesize

    return synthesize(problem, cells, horizon=None, accuracy=tolerance, **settings)


def _validate_horizons(problem: Any, horizons: Any, plan: Any = 20_000, **settings: Any) -> Any:
    from .validation.verdicts import validate

    return [validate(found, plan) for found in _synthesize_horizons(problem, horizons, **settings)]


REWRITTEN: dict[str, tuple[str, Callable[..., Any]]] = {
    "synthesize_horizons": ("synthesize(..., horizon=[...])", _synthesize_horizons),
    "without_deadline": ("synthesize(..., horizon=None)", _without_deadline),
    "validate_horizons": ("validate of each of synthesize(..., horizon=[...])", _validate_horizons),
}
"""Old names whose arguments are others now."""


def old_name(name: str) -> Any:
    """Return what a name meant before, with a warning that says what to write; raise AttributeError for others."""
    if name in REWRITTEN:
        instead, found = REWRITTEN[name]
    elif name in RENAMED or name in MOVED:
        room, now = MOVED.get(name) or RENAMED[name][1:]
        instead = RENAMED[name][0] if name in RENAMED else f"certigym.{room}.{now}"
        found = getattr(import_module(f"certigym.{room}"), now)
    else:
        raise AttributeError(f"module 'certigym' has no attribute {name!r}")
    warnings.warn(f"certigym.{name} goes with the next release: write `{instead}`", DeprecationWarning, stacklevel=3)
    return found
