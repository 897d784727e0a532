"""The HTML of a report; everything that comes from a certificate is escaped."""

from __future__ import annotations

import json
import platform
from html import escape
from itertools import islice
from typing import TYPE_CHECKING, Any

from ..envs.automaton import Automaton
from ..envs.guards import letter_text
from ..envs.scene import panels
from ..synthesis.digits import rounded_down
from .page_style import STYLE
from .pictures import automaton_picture, bound_curve, coordinate_name, margin_pictures, rollouts_picture
from .validate import shown_bound, tried_lines

if TYPE_CHECKING:
    from .report import ReportContent


def page_of(content: ReportContent) -> str:
    """The whole page."""
    problem = content.certificate.problem
    sections = [
        _claim(content), _curve(content), *_map(content), *_rollouts(content), _automaton(problem.automaton),
        _audit(content), _settings(content), _again(content),
    ]  # fmt: skip
    data = json.dumps(content.to_dict(), allow_nan=False).replace("<", "\\u003c")
    task = problem.specification.formula or "given as an automaton"
    size = f"{_counted(problem.n_agents, 'agent')}, horizon {problem.horizon}"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(problem.name)}: certificate</title><style>{STYLE}</style></head><body><main>"
        f"<h1>{escape(problem.name)}</h1><p class=soft>{size}, "
        f"{escape(problem.automaton.semantics)}; task <code>{escape(_cut(task, 400))}</code></p>"
        f'<div class="grid">{"".join(sections)}</div></main>'
        f'<script type="application/json" id="data">{data}</script></body></html>\n'
    )


def _section(title: str, body: str, wide: bool = False) -> str:
    return f"<section{' class=wide' if wide else ''}><h2>{escape(title)}</h2>{body}</section>"


def _list(pairs: dict[str, Any]) -> str:
    return "<dl>" + "".join(f"<dt>{escape(k)}</dt><dd>{escape(str(v))}</dd>" for k, v in pairs.items()) + "</dl>"


def _cut(words: str, most: int) -> str:
    return words if len(words) <= most else words[:most] + " ..."


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"


def _verdict(word: str) -> str:
    return f'<span class="verdict {escape(word)}">{escape(word)}</span>'


def _claim(content: ReportContent) -> str:
    v, certificate = content.validation, content.certificate
    start = {"point": "from the initial state", "mean": "on average over the initial box"}.get(certificate.start, "")
    checked = "holds" if content.checked else "; ".join(content.checked.failures)
    body = f"<p class=big>{escape(shown_bound(v.lower_bound, v.gap))}</p><p>{escape(start)} {_verdict(v.verdict)}</p>"
    facts = {
        "simulated": f"{v.estimate:.6f}, {100 * v.confidence:g} % limits [{v.ci_low:.6f}, {v.ci_high:.6f}]",
        "episodes": f"{v.successes} successes of {v.episodes}",
        "method": f"{v.method} ({certificate.bound} bound, rank {v.rank})",
        **({"tried": "; ".join(tried)} if (tried := tried_lines(v.details)) else {}),
        "separate check": checked,
        "audit": content.audit.verdict,
        "map of starts": content.field.verdict,
    }
    return _section("Claim and verdict", body + _list(facts))


def _curve(content: ReportContent) -> str:
    v = content.validation
    estimate = (v.estimate, v.ci_low, v.ci_high) if content.certificate.start == "point" else None
    where = "the start" if estimate else "the middle of the initial box"
    end = "; at the right end, the rollouts" if estimate else ""
    note = f"Certified from {where} when the last k steps of the policies are played{end}."
    return _section("Bound against horizon", bound_curve(content.bounds, estimate) + f"<p class=soft>{note}</p>")


def _map(content: ReportContent) -> list[str]:
    field, problem = content.field, content.certificate.problem
    names = " and ".join(coordinate_name(problem, k) for k in content.axes)
    w = field.weakest
    note = (
        f"{len(field.states)} starts that differ in {names}, {int(field.episodes.min())} episodes each, tested "
        f"together: refuted at {int(field.refuted.sum())}, confirmed at {int(field.confirmed.sum())}. Weakest at "
        f"({', '.join(f'{x:.4g}' for x in field.states[w])}): bound {rounded_down(field.lower_bounds[w], 4)}, "
        f"rollouts {field.estimates[w]:.4f}."
    )
    drawings = margin_pictures(problem, field, content.axes)
    notes = [
        f"Line: bound; dots: rollouts with their limits. {note}"
        if len(content.axes) == 1
        else f"The stronger the colour, the larger the bound; dots: confirmed; red: refuted. {note}",
        "Blue: the rollouts lie above the bound; orange: below it, mostly by chance where nothing is refuted.",
    ]
    return [
        _section(title, f"{drawing}<p class=soft>{escape(words)}</p>")
        for (title, drawing), words in zip(drawings.items(), notes)
    ]


def _rollouts(content: ReportContent) -> list[str]:
    shown = panels(content.certificate.problem)
    sections = []
    for panel in shown[:6]:
        names = ", ".join(curve.name for curve in panel.curves)
        drawing = rollouts_picture(panel, content.states, content.success)
        note = f"{len(content.success)} rollouts; broken lines did not satisfy the task."
        sections.append(_section(f"Rollouts: {_cut(names, 60)}", f"{drawing}<p class=soft>{escape(note)}</p>"))
    if len(shown) > 6:
        sections.append(_section("Rollouts", f"<p class=soft>and {len(shown) - 6} more panels, not drawn</p>"))
    return sections


def _automaton(automaton: Automaton) -> str:
    manager, roots = automaton.diagrams()
    rows = []
    for q, root in enumerate(roots[:24]):
        cubes: dict[int, list[str]] = {target: [] for target in manager.leaves(root)}
        for assignment, target in islice(manager.paths(root), 60):
            cubes[target].append(letter_text(assignment, automaton.propositions) if assignment else "true")
        for target, texts in cubes.items():
            guard = _cut(" | ".join(texts), 160) or "..."
            ends = f"<td>{escape(automaton.state_names[q])}</td><td>{escape(automaton.state_names[target])}</td>"
            rows.append(f"<tr>{ends}<td><code>{escape(guard)}</code></td></tr>")
    more = f"<p class=soft>{len(rows) - 60} more transitions</p>" if len(rows) > 60 else ""
    table = f"<div class=scroll><table><tr><th>from<th>to<th>on</tr>{''.join(rows[:60])}</table></div>{more}"
    note = "<p class=soft>Double circle: accepting; red: no way to acceptance.</p>"
    return _section("Automaton", automaton_picture(automaton) + note + table)


def _audit(content: ReportContent) -> str:
    audit = content.audit
    facts = {
        "tests": f"{audit.tests} pairs of time and state, {audit.episodes} episodes",
        "all steps together": f"p = {audit.overall_p:.2g}",
        "contradictions": audit.contradictions,
    }
    findings = "".join(f"<p class=soft>{escape(str(f))}</p>" for f in audit.findings[:12])
    body = _verdict(audit.verdict) + _list(facts) + (findings or "<p class=soft>Nothing found.</p>")
    return _section("Audit of every step", body)


def _settings(content: ReportContent) -> str:
    certificate, details = content.certificate, content.validation.details
    text = json.dumps(certificate.settings, indent=1, sort_keys=True, default=str)
    facts = {
        "fingerprint": certificate.fingerprint, "seed": details["seed"], "worlds per chunk": details["chunk"],
        "confidence": content.validation.confidence, "certigym": details["certigym"], "numpy": details["numpy"],
        "python": platform.python_version(),
    }  # fmt: skip
    settings = f"<details><summary>Settings of the synthesis</summary><pre>{escape(_cut(text, 20_000))}</pre></details>"
    return _section("Versions, seeds, settings", _list(facts) + settings)


def _again(content: ReportContent) -> str:
    d, v = content.validation.details, content.validation
    command = f"certigym validate CERT --episodes {v.episodes} --seed {d['seed']} --confidence {v.confidence}"
    words = "The same numbers come out on one worker or many. A bound speaks of the model only."
    return _section("Run it again", f"<pre>{escape(command)}</pre><p class=soft>{words}</p>")
