"""What each sub-command of the command line does; every function returns an exit status."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from ..envs.agents import LinearAgent
from ..envs.problem import Problem
from ..envs.suite import make_problem, problem_ids
from ..synthesis.certificates import Synthesis, load_certificate, save_certificate, shown_bound
from ..synthesis.checking import check as check_certificate
from ..synthesis.synthesize import synthesize as synthesize_problem
from .given import budget_of, cells_of, named_problem, problem_of, relation_of, search_of, state_of, write_json
from .learning_commands import certify as certify
from .learning_commands import compare as compare
from .learning_commands import train as train
from .plot_command import plot as plot
from .render_command import render_rollout
from .validation_commands import audit as audit
from .validation_commands import field as field
from .validation_commands import report as report
from .validation_commands import stress as stress
from .validation_commands import sweep as sweep
from .validation_commands import validate_result


def problems(options: Namespace) -> int:
    """List the suite."""
    rows = []
    for name in problem_ids():
        problem = make_problem(name)
        rows.append({"id": name, "agents": problem.n_agents, "horizon": problem.horizon,
                     "semantics": problem.automaton.semantics, "task": _task(problem)})  # fmt: skip
    width = max(len(str(row["id"])) for row in rows)
    if options.json != "-":
        for row in rows:
            size = f"{row['agents']:>3} agents  T={row['horizon']:<3}"
            print(f"{row['id']:<{width}}  {size} {row['semantics']:<12} {row['task']}")
    write_json(options, rows)
    return 0


def describe(options: Namespace) -> int:
    """Show a problem."""
    problem = problem_of(options)
    semantics = problem.specification.semantics
    lines = [
        f"{problem.name}: {problem.n_agents} agents, horizon {problem.horizon}, {semantics}",
        f"task: {_task(problem)}",
    ]
    for agent in problem.agents[:12]:
        lines += _agent_lines(agent)
    if problem.n_agents > 12:
        lines.append(f"... and {problem.n_agents - 12} more agents")
    names = list(problem.propositions.items())
    lines += [f"proposition {n}: agent {p.agent} in [{_vector(p.low)}, {_vector(p.high)})" for n, p in names[:24]]
    if len(names) > 24:
        lines.append(f"... and {len(names) - 24} more propositions")
    lines.append(_automaton_line(problem))
    lines.append(f"fingerprint: {problem.fingerprint}")
    if options.json != "-":
        print("\n".join(lines))
    write_json(options, {**problem.to_dict(), "fingerprint": problem.fingerprint})
    return 0


def run(options: Namespace) -> int:
    """Synthesize, validate, report: the main job."""
    result = _synthesize(options)
    if options.out:
        save_certificate(result.certificate, options.out)
    return validate_result(options, result, None)


def synthesize(options: Namespace) -> int:
    """Synthesize and save."""
    certificate = (result := _synthesize(options)).certificate
    save_certificate(certificate, options.out)
    summary = {
        "problem": certificate.problem.name, "horizon": certificate.problem.horizon, "method": certificate.method,
        "bound": certificate.bound, "start": certificate.start, "lower_bound": certificate.lower_bound,
        "gap": certificate.gap, "exact": certificate.exact, "rank": certificate.rank,
        "fingerprint": certificate.fingerprint, "seconds": result.stats["seconds"], "certificate": options.out,
    }  # fmt: skip
    if options.json != "-":
        claim = shown_bound(certificate.lower_bound, certificate.gap)
        print(f"{certificate.problem.name}, horizon {certificate.problem.horizon}: {claim}")
        print(f"saved to {options.out}")
    write_json(options, summary)
    return 0


def validate(options: Namespace) -> int:
    """Test a saved certificate."""
    return validate_result(options, load_certificate(options.certificate), state_of(options))


def check(options: Namespace) -> int:
    """Verify a saved certificate without simulation."""
    certificate = load_certificate(options.certificate)
    problem = None
    if options.problem is not None:
        problem = named_problem(options.problem, options.horizon)
    report = check_certificate(certificate, problem)
    if options.json != "-":
        unverified = report and report.above is None and certificate.gap is not None
        rest = "; the upper end of its claim was too large a computation" if unverified else ""
        print(f"{certificate.problem.name}, horizon {certificate.problem.horizon}: {report}{rest}")
    recomputed = None if np.isnan(report.recomputed) else report.recomputed
    said = {
        "valid": report.valid, "lower_bound": report.claimed, "recomputed": recomputed, "above": report.above,
        "failures": list(report.failures), "fingerprint": certificate.fingerprint,
    }  # fmt: skip
    write_json(options, said)
    return 0 if report else 1


def render(options: Namespace) -> int:
    """Show an episode under certified controllers."""
    if options.problem.endswith(".npz"):
        if options.horizon is not None or options.initial_state is not None or options.cells is not None:
            raise ValueError("`--horizon`, `--initial-state`, `--cells`: a certificate has its own; leave them out")
        certificate = load_certificate(options.problem)
    else:
        certificate = _synthesize(options).certificate
    shown = render_rollout(certificate, options.out, options.seed, options.fps)
    if options.json != "-":
        verdict = "satisfied" if shown["satisfied"] else "not satisfied"
        print(f"{shown['problem']}: {shown['steps']} steps, {verdict}, written to {options.out}")
    write_json(options, shown)
    return 0


def reproduce(options: Namespace) -> int:
    """Recompute a figure or table of the paper, or refute its certificate."""
    from ..validation.paper import refute_published
    from ..validation.paper import reproduce as figures

    if options.out and Path(options.out).exists() and not Path(options.out).is_dir():
        raise ValueError(f"`--out`: expected a folder, got the file {options.out!r}; name a folder, it is made")
    show = (lambda text: print(text)) if options.json != "-" else (lambda text: None)
    if options.what == "refutation":
        result: Any = refute_published()
        where = ", ".join(f"{x:g}" for x in result["worst_initial_state"])
        show(
            f"published certificate at T = {result['T']}: {result['verdict']} at {result['refuted']} of "
            f"{result['initial_states']} initial states; largest excess {result['worst_excess']:.4f} at ({where})"
        )
        show(f"certificates at the right noise: {result['right_noise_verdict']}")
        if options.out:
            Path(options.out).mkdir(parents=True, exist_ok=True)
            (Path(options.out) / "refutation.json").write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    else:
        folder = Path(options.out or "reproduced")
        result = getattr(figures, options.what)(folder, progress=show)
        show(f"written to {folder}")
        if not options.what.startswith("table") and not (folder / f"{options.what}.png").exists():
            print('certigym: no figure without matplotlib; install "certigym[viz]" for it', file=sys.stderr)
    write_json(options, result)
    return 0


def _synthesize(options: Namespace) -> Synthesis:
    problem = problem_of(options)
    cells = cells_of(options)
    with tqdm(desc="synthesize", unit=" sweeps", disable=None, leave=False) as bar:

        def report(text: str, value: float) -> None:
            bar.set_postfix_str(f"value {value:.6f}")
            bar.update()

        chosen = {**relation_of(options), **budget_of(options), **search_of(options)}
        found = synthesize_problem(problem, cells, **chosen, progress=report)
    record = found.stats.get("cells")
    if isinstance(record, dict) and options.json != "-":
        shapes = ", ".join(" x ".join(map(str, shape)) for shape in record["cells"])
        print(f"{shapes} cells, the best of {len(record['tried'])} runs: {record['stopped']}")
    return found


def _agent_lines(agent: LinearAgent) -> list[str]:
    """Dynamics, boxes and start of one agent."""
    low, high = agent.initial.low, agent.initial.high
    start = _vector(low) if np.array_equal(low, high) else f"{_vector(low)} .. {_vector(high)}"
    workspace = f"{_vector(agent.workspace.low)} .. {_vector(agent.workspace.high)}"
    inputs = f"{_vector(agent.input_box.low)} .. {_vector(agent.input_box.high)}"
    return [
        f"agent {agent.name}: x' = A x + B u + c + w, A = {agent.A.tolist()}, B = {agent.B.tolist()}, "
        f"c = {_vector(agent.offset)}, covariance of w {agent.noise_covariance.tolist()}",
        f"    workspace {workspace}, inputs {inputs}, start {start}",
    ]


def _automaton_line(problem: Problem) -> str:
    """The automaton of the task, or the tasks that it falls apart into."""
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
    return problem.specification.formula or "given as an automaton"


def _vector(values: Any) -> str:
    return "(" + ", ".join(f"{v:g}" for v in values) + ")"
