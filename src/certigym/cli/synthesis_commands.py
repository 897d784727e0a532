"""The commands that describe, certify and check: ``describe``, ``run``, ``synthesize``, ``check``."""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ..envs.suite import make_problem, problem_ids, tier_of_id
from ..envs.systems.agents import AnyAgent
from ..envs.systems.arguments import counted, matrix_text, vector_text
from ..envs.tasks.problem import Problem, cut_by_the_end, doubts, out_of_reach, why_unsatisfiable
from ..envs.tasks.regions import Pair, Proposition
from ..synthesis.certificates.proofs import is_exact, lasting_bound, save_certificate, start_of_claim
from ..synthesis.certificates.proofs.canonical import checker_text
from ..synthesis.extended_check.claims import safety_rate
from ..synthesis.policy_search.portfolio import bar_of
from ..synthesis.verbs.in_files import check as check_claim
from ..synthesis.verbs.in_files import load
from ..synthesis.verbs.synthesize import strategies_ahead
from ..validation.statistical_tests import told_of
from .given import is_endless, limit_of, named_problem, problem_of, say, several_horizons, show, write_json
from .validation_commands import print_horizons, validate_result
from .work import synthesized, ticking, within

VACUOUS_CHECK = "; vacuous: it promises P >= 0, which says nothing"
"""What is said of a certificate that holds because it claims nothing."""

MOST_SECONDS = 20.0
"""Seconds for which ``describe`` looks for what a search would try: automata of thousands of states take minutes."""

MOST_AGENTS_SHOWN, MOST_REGIONS_SHOWN = 12, 24
"""Agents and propositions that ``describe`` prints: about two screens."""


def describe(options: Namespace) -> int:
    """List the suite, or print one problem."""
    if options.problem is None:
        return _list_suite(options)
    with bar_of() as bar, ticking(bar):
        bar.set_description_str("the automaton of the task")
        problem = problem_of(options)
    semantics = problem.specification.semantics
    lines = [
        f"{problem.name}: {counted(problem.n_agents, 'agent')}, horizon {problem.horizon}, {semantics}",
        f"task: {_task(problem)}",
    ]
    for agent in problem.written_agents[:MOST_AGENTS_SHOWN]:
        lines += _agent_lines(agent)
    lines += _shared_lines(problem)
    if problem.n_agents > MOST_AGENTS_SHOWN:
        lines.append(f"... and {counted(problem.n_agents - MOST_AGENTS_SHOWN, 'more agent')}")
    regions = list(problem.written.items())
    lines += [
        f"proposition {name}: {_subject(region)} in {_box(region)}" for name, region in regions[:MOST_REGIONS_SHOWN]
    ]
    if len(regions) > MOST_REGIONS_SHOWN:
        lines.append(f"... and {counted(len(regions) - MOST_REGIONS_SHOWN, 'more proposition')}")
    lines.append(_automaton_line(problem))
    lines.append(f"fingerprint: {problem.fingerprint}")
    say(options, "\n".join(lines))
    # What is worth a search is looked for at last, and for so long.
    strategies, are_all = within(MOST_SECONDS, _looked_for(problem))
    if not are_all:
        strategies.append(f"not known after {MOST_SECONDS:g} s: what else a search tries; `run` tries it")
    say(options, "\n".join(strategies[:MOST_WAYS_SHOWN]))
    write_json(options, {**problem.to_dict(), "fingerprint": problem.fingerprint, "ways": strategies})
    return 0


def _looked_for(problem: Problem) -> Iterator[str]:
    """Yield a line for each thing that is known of a problem before a search: notes, and then the ways."""
    lost = why_unsatisfiable(problem) or ("" if (found := out_of_reach(problem)) is None else found.why)
    yield from (f"note: {note}" for note in (lost, *doubts(problem)) if note)
    yield from _ways(problem)


WAY_WORDS = {
    "others": "other relations, compared on coarse cells",
    "finer cells": "finer cells of the best of these",
    "exact": "`exact`",
    "linear": "`linear`, level by level",
    "path": "along a path",
}
"""What ways are called in ``describe``, where the name alone says too little."""

MOST_WAYS_SHOWN, MOST_TASKS_SHOWN = 16, 2
"""Lines about ways, and independent tasks whose ways are told: they are alike as a rule."""


def _ways(problem: Problem) -> Iterator[str]:
    """Yield a line for each way that ``run`` tries without options, in order, and for each that does not apply."""
    if problem.starts_outside:
        yield "ways: none, a start is outside its workspace"
        return
    for task, strategies in islice(strategies_ahead(problem), MOST_TASKS_SHOWN):
        of = "" if task is problem else f" of task {task.name}"
        open_strategies = [strategy for strategy in strategies if not strategy.refusal]
        for number, strategy in enumerate(open_strategies, start=1):
            work = f", about {strategy.work:.2g} core seconds at first" if strategy.work >= 0.1 else ""
            yield f"way {number}{of}: {WAY_WORDS.get(strategy.name, strategy.name)}{work}"
        yield from (
            f"not{of} {WAY_WORDS.get(strategy.name, strategy.name)}: {strategy.refusal}"
            for strategy in strategies
            if strategy.refusal
        )


def run(options: Namespace) -> int:
    """Synthesize, check, validate, and print the report; with several horizons, a row for each."""
    if (horizons := several_horizons(options)) is not None:
        if options.out:
            raise ValueError("`--out`: expected none with several horizons: each has a certificate; leave it out")
        return print_horizons(options, horizons)
    result = synthesized(options)
    if options.out:
        save_certificate(result.certificate, options.out)
    more = {"certificate": options.out} if options.out else {}
    if result.checked:
        result, more["checker"] = _with_checker(result)
    told = _lasting(result) if is_endless(options) else {}
    told |= {"note": cut} if (cut := cut_by_the_end(result.certificate.problem)) else {}
    status = validate_result(options, result, None, result.checked, more | told)
    return 130 if result.checked is None else status


def _with_checker(result: Any) -> tuple[Any, str]:
    """Return what the small checker proves, in words, and the synthesis with its seconds among those of checks."""
    began = time.perf_counter()
    text = checker_text(result.certificate)
    seconds = dict(result.stats["seconds"])
    seconds["check"] = (seconds.get("check") or 0.0) + time.perf_counter() - began
    return replace(result, stats={**result.stats, "seconds": seconds}), text


def _lasting(result: Any) -> dict[str, Any]:
    """Return what is certified without a deadline: in words, and as a number where one holds for every horizon."""
    certificate = result.certificate
    if (lasting := lasting_bound(certificate)) is not None:
        said = f"the bound holds for every longer horizon, too, and without any: P >= {lasting:.6g}"
    else:
        said = f"P(safe for k steps) >= {safety_rate(certificate)}, for every k"
    return {"no_deadline": said, "unbounded": lasting}


def synthesize(options: Namespace) -> int:
    """Synthesize, save the certificate, and print the claim."""
    if several_horizons(options) is not None:
        raise ValueError("`--horizon`: expected one number, or `none`, for one certificate; got several")
    if options.out is None:
        options.out = f"{Path(options.problem).stem}.npz"
        if Path(options.out).exists():
            raise ValueError(
                f"`--out`: expected a name, as {options.out} is already there; give one, or move that file"
            )
    result = synthesized(options)
    certificate = result.certificate
    save_certificate(certificate, options.out)
    summary = {
        "problem": certificate.problem.name,
        "horizon": certificate.problem.horizon,
        "method": certificate.proof.method,
        "bound": certificate.proof.bound,
        "start": start_of_claim(certificate),
        "lower_bound": certificate.lower_bound,
        "gap": certificate.gap,
        "exact": is_exact(certificate),
        "rank": certificate.proof.rank,
        "fingerprint": certificate.fingerprint,
        "seconds": result.stats["seconds"],
        "check": None if result.checked is None else told_of(result.checked),
        "certificate": options.out,
    }
    claim = result.claim
    if why := result.stats.get("nothing"):
        claim = f"nothing was certified ({claim}): {why}"
    text = f"{certificate.problem.name}, horizon {certificate.problem.horizon}: {claim}\nsaved to {options.out}"
    show(options, text, summary)
    return 130 if result.checked is None else int(not result.checked)


def check(options: Namespace) -> int:
    """Verify a saved certificate without simulation."""
    claim = load(options.certificate, limit_of(options))
    certificate = claim
    problem = None if options.problem is None else named_problem(options.problem, options.horizon)
    report = check_claim(claim, problem)
    # A valid certificate may claim an upper end that is too large a computation to verify; say so.
    unverified = report and report.above is None and claim is certificate and certificate.gap is not None
    rest = "; the upper end of the claim would take too large a computation" if unverified else ""
    rest += VACUOUS_CHECK if report and report.claimed <= 0.0 else ""
    text = f"{certificate.problem.name}, horizon {certificate.problem.horizon}: {report}{rest}"
    small = checker_text(certificate)
    text += f"\n{small}" if report else ""
    outcome = {
        "checker": small,
        "valid": report.valid,
        "vacuous": bool(report) and report.claimed <= 0.0,
        "lower_bound": report.claimed,
        "recomputed": None if np.isnan(report.recomputed) else report.recomputed,
        "above": report.above,
        "failures": list(report.failures),
        "assumed": list(report.assumed),
        "fingerprint": certificate.fingerprint,
    }
    show(options, text, outcome)
    return 0 if report else 1


def _list_suite(options: Namespace) -> int:
    """Print one line per problem of the suite."""
    rows: list[dict[str, Any]] = []
    for name in problem_ids(options.tier):
        problem = make_problem(name)
        sizes = {"tier": tier_of_id(name), "agents": problem.n_agents, "horizon": problem.horizon}
        rows.append({"id": name, **sizes, "semantics": problem.specification.semantics, "task": _task(problem)})
    width = max((len(str(row["id"])) for row in rows), default=0)
    for row in rows:
        agents = f"{row['agents']:>3} {'agent ' if row['agents'] == 1 else 'agents'}"
        size = f"{row['tier']:<7} {agents}  T={row['horizon']:<3}"
        say(options, f"{row['id']:<{width}}  {size} {row['semantics']:<12}  {row['task']}")
    write_json(options, rows)
    return 0


def _agent_lines(agent: AnyAgent) -> list[str]:
    """Return dynamics, boxes and start of one agent in words."""
    low, high = agent.initial.low, agent.initial.high
    start = vector_text(low) if np.array_equal(low, high) else f"{vector_text(low)} .. {vector_text(high)}"
    workspace = f"{vector_text(agent.workspace.low)} .. {vector_text(agent.workspace.high)}"
    inputs = f"{vector_text(agent.input_box.low)} .. {vector_text(agent.input_box.high)}"
    return [
        f"agent {agent.name}: {agent.motion_text}, {_noise(agent)}",
        f"    workspace {workspace}, inputs {inputs}, start {start}",
    ]


def _shared_lines(problem: Problem) -> list[str]:
    """Return the sources of noise that agents share, with the deviations that they cause."""
    return [
        f"joint noise {name}: " + ", ".join(f"{agent} {deviations}" for agent, deviations in own.items())
        for name, own in problem.joint_noise.items()
    ]


def _noise(agent: AnyAgent) -> str:
    """Return the noise of an agent: a covariance, or the law of each component."""
    if agent.laws is None:
        return f"covariance of w {matrix_text(agent.noise_covariance)}"
    laws = [law.to_dict() for law in agent.laws]
    words = [f"{law.pop('law')} ({', '.join(f'{key} {value}' for key, value in law.items())})" for law in laws]
    axes = "" if np.array_equal(agent.noise_axes, np.eye(agent.n_states)) else f" along {agent.noise_axes.T.tolist()}"
    return f"w {' x '.join(words)}{axes}"


def _automaton_line(problem: Problem) -> str:
    """Return the size of the automaton of the task, or the number of tasks into which it decomposes."""
    if problem.groups:
        sizes = sorted({group.automaton.n_states for group in problem.groups})
        return f"{len(problem.groups)} independent tasks, automata of {', '.join(map(str, sizes))} states"
    automaton = problem.automaton
    accepting = ", ".join(automaton.state_names[q] for q in np.flatnonzero(automaton.accepting)) or "none"
    return (
        f"automaton: {automaton.n_states} states, initial {automaton.state_names[automaton.initial]}, "
        f"accepting {accepting}"
    )


def _task(problem: Problem) -> str:
    """Return the formula, if there is one."""
    return problem.specification.formula or "given as an automaton"


def _subject(region: Proposition | Pair) -> str:
    """Return what a proposition is about."""
    if isinstance(region, Pair):
        return " less ".join(region.agents)
    return f"agent {region.agent}"


def _box(region: Proposition | Pair) -> str:
    """Return the corners of a region; where it moves, as they are written."""
    is_box = region.distance is None if isinstance(region, Pair) else not region.shape
    is_box = is_box and not region.moves
    return f"[{vector_text(region.low)}, {vector_text(region.high)})" if is_box else region.text
