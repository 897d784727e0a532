"""Ways to certify a task, and the one scheduler that tries them: cheapest first, the best kept.

A way says how much work it is, from which bound on it is not worth that, and what it needs to know of the ways before
it. Ways are tried in the order of their work as long as the effort lasts; every certificate on the way is valid, and
the one with the largest bound is kept. What each gave, or why it was left out, is recorded.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ....envs.tasks.problem import why_unsatisfiable
from ...certificates.proofs import BROKEN_OFF, Synthesis, rounded_up
from ...relations.grids import NoRunFound, RelationRefused, to_who_asked_for_none
from .effort import GIVEN_UP, Effort, OutOfTime

SOLVED, GOOD = 0.9995, 0.9
"""Bounds from which nothing is worth its work, and from which ways that take long and rarely gain are left out."""

HOPELESS = 1e-3
"""Upper bound on what any controller does, below which the task is told to be too hard."""

NEARLY = 1.05
"""How much more a grid may fail than a path and still be kept, as a factor: it has values at other states."""

TINY = 1e-12
"""Bound of a grid below which it is not preferred to a path: it claims nothing."""

PATH = "path"
"""Name of the way along a path: where nothing is certified so far it is asked first whether a run exists at all."""

LEAST_ALLOWED, OFF = 1000.0, 2.0
"""Counted work that every way may take, in core seconds, and how much more than was estimated."""

Results = Mapping[str, Synthesis]
"""What the ways so far gave, by name."""


@dataclass(frozen=True, eq=False)
class Strategy:
    """One way to certify a task.

    Parameters
    ----------
    name : str
        What it is called in the record of what was tried.
    run : callable
        Its synthesis, given the results so far; raises RelationRefused if it does not apply.
    work : float
        Estimate of what it takes at least, in core seconds (see ``Effort``).
    enough : float
        Bound of others from which it is not tried.
    ends : float
        Its own bound from which nothing else is tried.
    why_not : callable, optional
        Why it is not tried after these results: in words, ``""`` where that need not be told, or None.
    after : str
        Name of a way whose result it needs, and after which it is tried.
    prefix : bool
        Whether the ways that it compares are recorded with its name.
    refusal : str
        Why it does not apply, where that is known before anything is computed.
    """

    name: str
    run: Callable[[Results], Synthesis]
    work: float = 0.0
    enough: float = SOLVED
    ends: float = SOLVED
    why_not: Callable[[Results], str | None] = lambda results: None
    after: str = ""
    prefix: bool = False
    refusal: str = ""


def refused(name: str, error: RelationRefused) -> Strategy:
    """Return a way of which it is known that it does not apply."""

    def run(results: Results) -> Synthesis:
        raise error

    return Strategy(name, run, refusal=to_who_asked_for_none(error))


def in_order(strategies: Sequence[Strategy]) -> list[Strategy]:
    """Return ways in the order in which they are tried: cheapest first; of equal ones the first of the table."""
    named = {strategy.name: strategy for strategy in strategies}

    def place(strategy: Strategy) -> tuple[float, int]:
        """Work of it and of all that it waits for, and how many these are."""
        work, waits = strategy.work, 0
        while strategy.after in named:
            strategy, waits = named[strategy.after], waits + 1
            work = max(work, strategy.work)
        return work, waits

    return sorted(strategies, key=place)


def best_of(strategies: Sequence[Strategy], effort: Effort) -> Synthesis:
    """Return the synthesis with the largest bound; ``stats["tried"]`` says what each way gave, or why not.

    Raises
    ------
    RelationRefused
        If no way applies; where one is refused for what others are refused for, too, it is said once.
    """
    began, results = time.perf_counter(), dict[str, Synthesis]()
    tried, refusals = dict[str, Any](), dict[str, str]()
    ended_by: str | None = None
    waiting, given_up = in_order(strategies), list[Strategy]()
    outer, names = effort.turn, [strategy.name for strategy in waiting if not strategy.refusal]
    # Where nothing else gave anything, what was given up may take what it takes.
    while waiting or (given_up and not results):
        strategy = waiting.pop(_next(waiting, results, bool(effort.lost))) if waiting else given_up.pop(0)
        ended_by = BROKEN_OFF if effort.is_interrupted else ended_by
        ended_by = "the task is out of reach" if effort.lost and results else ended_by
        reason = f"skipped: {ended_by}" if ended_by is not None else _left_out(strategy, results, effort)
        if reason is not None:
            tried |= {strategy.name: reason} if reason else {}
            continue
        before, counted, result = effort.spent, effort.counted, None
        effort.begins(outer if any(outer) or strategy.refusal else (names.index(strategy.name) + 1, len(names)))
        _tell(strategy, leading(results), effort)
        alone = not waiting and not results
        allowed = _allowed(strategy, effort, bool(results), alone)
        try:
            with effort.within(allowed), effort.until_broken_off():
                result = strategy.run(results)
        except RelationRefused as refusal:
            tried[strategy.name] = to_who_asked_for_none(refusal)
            refusals[strategy.name] = tried[strategy.name] if strategy.refusal else " ".join(str(refusal).split())
            effort.no_run = tried[strategy.name] if isinstance(refusal, NoRunFound) else effort.no_run
            continue
        except OutOfTime:
            if alone:
                raise  # what gave a certificate is whoever called this
            tried[strategy.name] = effort.given_up
            # Something is left for the others, whatever it took.
            effort.spent = max(effort.spent, before + min(effort.counted - counted, GIVEN_UP * max(0.0, effort.left)))
            given_up.append(strategy)
            continue
        finally:
            effort.charge(before, strategy.work, result is None or _bound(result) <= 0.0)
        results[strategy.name], effort.has_result = result, True
        effort.above = min(effort.above, _above(result))
        tried |= _outcomes(strategy, result)
        if effort.suffices(result.certificate.lower_bound):
            ended_by = f"`{strategy.name}` has the bound that was asked for"
        elif result.certificate.lower_bound >= strategy.ends:
            ended_by = f"at most {1.0 - result.certificate.lower_bound:.2g} is left to gain after `{strategy.name}`"
            if strategy.ends <= 0.0 and result.certificate.lower_bound < HARDLY_LEFT:
                ended_by = f"agents have more states than grids hold as a rule, which `{strategy.name}` is for"
    effort.turn = outer
    if not results:
        raise _refused(strategies, refusals, effort.lost)
    return _recorded(results, tried | effort.left_out, began, effort)


def _tell(strategy: Strategy, best: Synthesis | None, effort: Effort) -> None:
    """Say that a way begins."""
    work = f" (about {strategy.work:.2g} core seconds)" if strategy.work >= 1.0 else ""
    shown = "other relations" if strategy.name == "others" else strategy.name
    effort.tell(f"{shown}{work}", 0.0 if best is None else _bound(best))


HARDLY_LEFT = 0.99
"""Bound from which hardly anything is said to be left to gain."""


def _allowed(strategy: Strategy, effort: Effort, has_result: bool, alone: bool) -> float:
    """Return the work after which a way is given up; estimates may be off by a factor, and small ones by more.

    Nothing ends the only way that is left where none gave anything.
    """
    if alone:
        return math.inf
    return max(LEAST_ALLOWED, OFF * (max(strategy.work, effort.left) if has_result else strategy.work))


def _next(waiting: Sequence[Strategy], results: Results, is_lost: bool) -> int:
    """Return the position of the next way: the first, but for paths where all bounds so far are 0, or have to be."""
    if is_lost or (results and not any(_bound(result) > 0.0 for result in results.values())):
        return next((k for k, strategy in enumerate(waiting) if strategy.name == PATH), 0)
    return 0


def leading(results: Results) -> Synthesis | None:
    """Return the result with the largest bound; a grid, unless it fails ``NEARLY`` times as often as a path.

    Where all bounds are 0 it is the path, if there is one: its controllers follow a run that satisfies the task.
    """
    if not results:
        return None
    best = max(results.values(), key=_bound)
    if _bound(best) <= 0.0:
        return next((one for one in results.values() if not one.certificate.proof.has_cells), best)
    if best.certificate.proof.has_cells:
        return best
    least = 1.0 - NEARLY * (1.0 - _bound(best))
    grids = (one for one in results.values() if one.certificate.proof.has_cells and _bound(one) >= max(least, TINY))
    return max(grids, key=_bound, default=best)


def with_settings(result: Synthesis, more: Mapping[str, Any]) -> Synthesis:
    """Return a synthesis whose certificate says more about how it was made."""
    if not more:
        return result
    certificate = replace(result.certificate, settings={**result.certificate.settings, **more})
    return replace(result, certificate=certificate, controller=certificate.controller)


def _bound(result: Synthesis) -> float:
    """Return the certified bound."""
    return float(result.certificate.lower_bound)


def _above(result: Synthesis) -> float:
    """Return an upper bound on what any controller does, 1 where none is known."""
    known = result.stats.get("continuous_upper_bound")
    return known if isinstance(known, float) else 1.0


def _left_out(strategy: Strategy, results: Results, effort: Effort) -> str | None:
    """Return why a way is not tried after these results, in words; None if it is."""
    reason = strategy.why_not(results)
    best = leading(results)
    if reason is not None or best is None:
        return reason
    if _bound(best) >= strategy.enough:
        return f"skipped: {_bound(best):.4g} was certified already"
    return effort.refusal(strategy.work)


def _outcomes(strategy: Strategy, result: Synthesis) -> dict[str, Any]:
    """Return the bound of a way, or of each way that it compared, by name."""
    compared: Any = result.stats.get("tried")
    if compared:
        return (
            {f"{name}, {strategy.name}": outcome for name, outcome in compared.items()}
            if strategy.prefix
            else dict(compared)
        )
    return {strategy.name: _bound(result)}


def _refused(strategies: Sequence[Strategy], refusals: Mapping[str, str], lost: str) -> RelationRefused:
    """Return why no way applies: why the task is out of reach, or else each reason once, in the order of the table."""
    if lost:
        return RelationRefused(lost)
    named = {strategy.name: refusals[strategy.name] for strategy in strategies if strategy.name in refusals}
    reasons = list(dict.fromkeys(named.values()))
    if len(reasons) == 1:
        return RelationRefused(reasons[0])
    return RelationRefused("; ".join(f"{name}: {text}" for name, text in named.items()))


def _recorded(results: Results, tried: dict[str, Any], began: float, effort: Effort) -> Synthesis:
    """Return the best result, with what was tried, the least upper bound of all, and the seconds of all."""
    best = leading(results)
    assert best is not None
    above = [result.stats.get("continuous_upper_bound") for result in results.values()]
    known = [bound for bound in above if isinstance(bound, float)]
    stats: dict[str, Any] = {name: value for name, value in best.stats.items() if name != "tried"}
    if len(results) > 1:
        stats |= {"continuous_upper_bound": min(known, default=None)}
    stats["seconds"] = {"abstract": 0.0, "synthesize": time.perf_counter() - began}
    if _bound(best) <= 0.0:
        stats["nothing"] = effort.lost or _why_nothing(best, results, stats, effort.no_run)
        best = with_settings(best, {"nothing": stats["nothing"]})
    if len(tried) > 1:
        stats["tried"] = tried
        best = with_settings(best, {"relations_tried": tried})
    return replace(best, stats=stats)


def _why_nothing(best: Synthesis, results: Results, stats: Mapping[str, Any], no_run: str) -> str:
    """Return why nothing was certified, in words: the task, or the models, as far as that is known."""
    if never := why_unsatisfiable(best.certificate.problem):
        return never
    above = stats.get("continuous_upper_bound")
    if above is not None and above <= HOPELESS:
        too_hard = f"no controller satisfies the task more often than {rounded_up(above)}"
        return f"{too_hard}; {no_run}" if no_run else too_hard
    if no_run:
        return f"{no_run}; the task may ask for too much"
    if not best.certificate.proof.has_cells:
        weakest = best.certificate.settings.get("weakest", "")
        lost = f", with noise most is lost at {weakest}" if weakest else ""
        return f"the task can be done: a run without noise satisfies it{lost}; the controllers follow that run"
    models = [result.stats.get("abstract_upper_bound") for result in results.values()]
    known = [most for most in models if isinstance(most, float)]
    least = f": no policy of them does better than {rounded_up(max(known))}" if len(known) == len(models) else ""
    return f"the finite models are too coarse, or the noise is too large{least}; ask for more `effort`"
