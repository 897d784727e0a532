"""The HTML of a report: one section per question. All text that comes from a certificate is escaped."""

from __future__ import annotations

import json
import platform
from html import escape
from typing import TYPE_CHECKING, Any

from ...envs.agents import counted
from ...envs.pictures import coordinate_name, edges, panels
from ...envs.problem import Problem
from ...synthesis.certificates import (
    Certificate,
    PairsCertificate,
    ProductCertificate,
    TeamCertificate,
    rounded_down,
    shown_bound,
    significant_up,
)
from ..verdicts import tried_lines
from .inline_pictures import FEW_STATES, automaton_picture, bound_curve, margin_pictures, rollouts_picture

if TYPE_CHECKING:
    from .content import ReportContent

MOST_AUTOMATA = 4
"""Automata of independent tasks that are drawn."""

STATES_LISTED, STATES_DRAWN = 200, 30
"""Largest automaton whose transitions are listed, and largest one that is drawn: more could not be told apart."""

MOST_TRANSITIONS = 60
"""Transitions in the table of an automaton."""

MOST_PANELS_DRAWN = 6
"""Panels of rollouts that are drawn."""

FINDINGS_SHOWN = 12
"""Findings of an audit that the page shows."""


def page_of(content: ReportContent) -> str:
    """Return the whole page."""
    problem = content.certificate.problem
    evidence = [_claim(content), *_curve(content), *_map(content), *_rollouts(content)]
    records = [*_automata(content.certificate), *_audit(content), _settings(content), _again(content)]
    sections = [*evidence, *records]
    # Data inside a script element must not contain "</script>".
    data = json.dumps(content.to_dict(), allow_nan=False).replace("<", "\\u003c")
    task = problem.specification.formula or "given as an automaton"
    size = f"{counted(problem.n_agents, 'agent')}, horizon {problem.horizon}"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(problem.name)}: certificate</title><style>{STYLE}</style></head><body><main>"
        f"<h1>{escape(problem.name)}</h1><p class=soft>{size}, "
        f"{escape(problem.specification.semantics)}; task <code>{escape(_cut(task, 400))}</code></p>"
        f'<div class="grid">{"".join(sections)}</div></main>'
        f'<script type="application/json" id="data">{data}</script></body></html>\n'
    )


def _section(title: str, body: str, wide: bool = False) -> str:
    return f"<section{' class=wide' if wide else ''}><h2>{escape(title)}</h2>{body}</section>"


def _list(pairs: dict[str, Any]) -> str:
    return "<dl>" + "".join(f"<dt>{escape(k)}</dt><dd>{escape(str(v))}</dd>" for k, v in pairs.items()) + "</dl>"


def _cut(words: str, most: int) -> str:
    """Return a text, cut off with dots if it is longer than ``most`` characters."""
    return words if len(words) <= most else words[:most] + " ..."


def _verdict(word: str) -> str:
    return f'<span class="verdict {escape(word)}">{escape(word)}</span>'


def _claim(content: ReportContent) -> str:
    """Return the section of what is claimed, and what every kind of test says about it."""
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
    }
    if content.audit is not None and content.field is not None:
        facts |= {"audit": content.audit.verdict, "map of starts": content.field.verdict}
    if isinstance(certificate, PairsCertificate):
        facts["pairs"] = f"not as they should be with probability {significant_up(certificate.near, 3)} at most"
    if isinstance(certificate, TeamCertificate):
        facts["information"] = "every agent sees the states of all"
    return _section("Claim and verdict", body + _list(facts))


def _curve(content: ReportContent) -> list[str]:
    """Return the section of the bound against the number of steps played; none where that is not known."""
    v = content.validation
    if content.bounds is None:
        return []
    # The curve is about one start; rollouts from a box of starts estimate a mean, which is not on it.
    estimate = (v.estimate, v.ci_low, v.ci_high) if content.certificate.start == "point" else None
    where = "the start" if estimate else "the middle of the initial box"
    end = "; at the right end, the rollouts with their limits" if estimate else ""
    note = f"Certified from {where} if only the last k steps of the policies are played{end}."
    return [_section("Bound against horizon", bound_curve(content.bounds, estimate) + f"<p class=soft>{note}</p>")]


def _map(content: ReportContent) -> list[str]:
    """Return the sections of the tests at many starts: two maps, or one line."""
    field, problem = content.field, content.certificate.problem
    if field is None:
        return []
    names = " and ".join(coordinate_name(problem, k) for k in content.axes)
    # The long explanation stands below the first drawing, a short one below the second.
    w = field.weakest
    note = (
        f"{len(field.states)} starts that differ in {names}, {counted(int(field.episodes.min()), 'episode')} each, all "
        f"tested together: refuted at {int(field.refuted.sum())}, confirmed at {int(field.confirmed.sum())}. Weakest "
        f"at ({', '.join(f'{x:.4g}' for x in field.states[w])}): bound {rounded_down(field.lower_bounds[w], 4)}, "
        f"rollouts {field.estimates[w]:.4f}."
    )
    drawings = margin_pictures(problem, field, content.axes)
    notes = [
        f"Line: bound; dots: rollouts with their limits. {note}"
        if len(content.axes) == 1
        else f"The stronger the colour, the larger the bound. Dots: confirmed; red: refuted. {note}",
        "Blue: the rollouts lie above the bound. Orange: they lie below it, by chance unless a cell is red.",
    ]
    return [
        _section(title, f"{drawing}<p class=soft>{escape(words)}</p>")
        for (title, drawing), words in zip(drawings.items(), notes)
    ]


def _rollouts(content: ReportContent) -> list[str]:
    """Return the sections of drawn rollouts, one per panel."""
    shown = panels(content.certificate.problem)
    sections = []
    for panel in shown[:MOST_PANELS_DRAWN]:
        names = ", ".join(curve.name for curve in panel.curves)
        drawing = rollouts_picture(panel, content.states, content.success)
        note = f"{len(content.success)} rollouts; those with broken lines did not satisfy the task."
        sections.append(_section(f"Rollouts: {_cut(names, 60)}", f"{drawing}<p class=soft>{escape(note)}</p>"))
    if len(shown) > MOST_PANELS_DRAWN:
        rest = counted(len(shown) - MOST_PANELS_DRAWN, "more panel")
        sections.append(_section("Rollouts", f"<p class=soft>and {rest}, not drawn</p>"))
    return sections


def _automata(certificate: Certificate | ProductCertificate | PairsCertificate | TeamCertificate) -> list[str]:
    """Return the section of the task automaton, or of those of independent tasks that differ in more than names."""
    if not isinstance(certificate, ProductCertificate):
        return [_automaton(certificate.problem)]
    distinct = [certificate.parts[group[0]].problem for group in certificate.alike]
    return [_automaton(task) for task in distinct[:MOST_AUTOMATA]]


def _automaton(problem: Problem) -> str:
    """Return the section of one automaton: a picture, and a table of the letters that take each transition."""
    automaton = problem.automaton
    if automaton.n_states > STATES_LISTED:
        return _section("Automaton", f"<p class=soft>{automaton.n_states} states, not listed</p>")
    names, transitions = automaton.state_names, edges(problem)
    rows = [
        f"<tr><td>{escape(names[edge.source])}</td><td>{escape(names[edge.target])}</td>"
        f"<td><code>{escape(_cut(edge.guard, 1000))}</code></td></tr>"
        for edge in transitions[:MOST_TRANSITIONS]
    ]
    rest = len(transitions) - MOST_TRANSITIONS
    more = f"<p class=soft>{counted(rest, 'more transition')}</p>" if rest > 0 else ""
    table = f"<div class=scroll><table><tr><th>from<th>to<th>when</tr>{''.join(rows)}</table></div>{more}"
    if automaton.n_states > STATES_DRAWN:
        return _section("Automaton", table)
    left_out = "" if automaton.n_states <= FEW_STATES else " Arrows to red states are left out."
    note = f"<p class=soft>Double circle: accepting; red: acceptance can no longer be reached.{left_out}</p>"
    return _section("Automaton", automaton_picture(automaton, transitions) + note + table)


def _audit(content: ReportContent) -> list[str]:
    """Return the section of the tests step by step, if there were any."""
    audit = content.audit
    if audit is None:
        return []
    facts = {
        "tests": f"{audit.tests} of pairs of time and task state, on {counted(audit.episodes, 'episode')}",
        "all steps together": f"p = {audit.overall_p:.2g}",
        "contradictions": audit.contradictions,
    }
    findings = "".join(f"<p class=soft>{escape(str(f))}</p>" for f in audit.findings[:FINDINGS_SHOWN])
    body = _verdict(audit.verdict) + _list(facts) + (findings or "<p class=soft>No step is suspicious.</p>")
    return [_section("Audit of every step", body)]


def _settings(content: ReportContent) -> str:
    """Return the section of everything that a repetition needs."""
    certificate, details = content.certificate, content.validation.details
    text = json.dumps(certificate.settings, indent=1, sort_keys=True, default=str)
    facts = {
        "fingerprint": certificate.fingerprint,
        "seed": details["seed"],
        "worlds per chunk": details["chunk"],
        "confidence": content.validation.confidence,
        "certigym": details["certigym"],
        "numpy": details["numpy"],
        "python": platform.python_version(),
    }
    settings = f"<details><summary>Settings of the synthesis</summary><pre>{escape(_cut(text, 20_000))}</pre></details>"
    return _section("Versions, seeds, settings", _list(facts) + settings)


def _again(content: ReportContent) -> str:
    """Return the section of the command that repeats the validation."""
    d, v = content.validation.details, content.validation
    command = f"certigym validate CERT --episodes {v.episodes} --seed {d['seed']} --confidence {v.confidence}"
    words = "The numbers are the same on one worker or many. A bound is about the model only."
    return _section("Run it again", f"<pre>{escape(command)}</pre><p class=soft>{words}</p>")


STYLE = """
:root{--ink:#1b2430;--soft:#5b6775;--paper:#fbfbf9;--card:#fff;--line:#dfe3e8;--bound:#1f5fae;--run:#c2571a;
--bad:#b3261e;--good:#1e7d4f;--region:#e9b949}
@media (prefers-color-scheme:dark){:root{--ink:#e6e9ee;--soft:#9aa6b4;--paper:#14181e;--card:#1c222a;--line:#313a45;
--bound:#7db2ef;--run:#f0a06b;--bad:#ff8a80;--good:#74d3a2;--region:#8d6d1d}
}*{box-sizing:border-box}
body{margin:0;background:var(--paper);color:var(--ink);font:16px/1.5 system-ui,-apple-system,"Segoe UI",Roboto,
sans-serif}
main{max-width:1120px;margin:0 auto;padding:20px 16px 48px}h1{font-size:1.5rem;margin:0}
h2{font-size:1.05rem;margin:0 0 6px}p{margin:4px 0}.soft{color:var(--soft);font-size:.86rem}
.grid{display:grid;gap:14px;margin-top:16px;grid-template-columns:repeat(auto-fit,minmax(min(330px,100%),1fr))}
section{background:var(--card);border:1px solid var(--line);border-radius:8px;padding:14px;min-width:0}
.wide{grid-column:1/-1}
.verdict{display:inline-block;padding:2px 12px;border-radius:14px;font-weight:600;color:#fff;background:#3f566f}
.confirmed{background:#1a6e45}.refuted{background:#a3211a}.big{font-size:1.35rem;font-weight:600}
dl{display:grid;grid-template-columns:max-content 1fr;gap:2px 14px;margin:6px 0}dt{color:var(--soft)}
dd{margin:0;overflow-wrap:anywhere}table{border-collapse:collapse;width:100%;font-size:.86rem}
th,td{text-align:left;padding:3px 10px 3px 0;border-top:1px solid var(--line);vertical-align:top;
overflow-wrap:anywhere}
code,pre{font:.82rem/1.45 ui-monospace,Menlo,Consolas,monospace}
pre{overflow-x:auto;white-space:pre-wrap;overflow-wrap:anywhere;margin:4px 0}.scroll{overflow-x:auto}
svg{width:100%;height:auto;display:block}svg text{font:11px system-ui,sans-serif;fill:var(--ink)}
svg .tick{font-size:10px;fill:var(--soft)}svg .name{fill:var(--soft)}.middle{text-anchor:middle}
.end{text-anchor:end}.grid line,line.grid{stroke:var(--line);stroke-width:1}polyline,.arrow{fill:none}
.bound{stroke:var(--bound);stroke-width:2}.bound-dot{fill:var(--bound)}.estimate{stroke:var(--run);stroke-width:1.5}
.estimate-dot{fill:var(--run)}.bad-dot{fill:var(--bad)}.cell{fill:var(--bound)}.over{fill:var(--bound)}.under{fill:var(--run)}
.bad-cell{fill:var(--bad)}
.sure-dot{fill:var(--good);stroke:var(--card);stroke-width:.4}
.region{fill:var(--region);fill-opacity:.22;stroke:var(--region);stroke-width:1}
svg .region-name{font-size:9px;fill:var(--soft)}.path{stroke-width:1;stroke-opacity:.55}
.path.lost{stroke-dasharray:3 2}circle.path{fill-opacity:.8;stroke:none}.agent0{stroke:var(--bound)}
.agent1{stroke:var(--run)}.agent2{stroke:var(--good)}.agent3{stroke:#8a4fb0}.agent4{stroke:#b0902a}.agent5{stroke:#c24c7a}
circle.agent0{fill:var(--bound)}circle.agent1{fill:var(--run)}circle.agent2{fill:var(--good)}circle.agent3{fill:#8a4fb0}
circle.agent4{fill:#b0902a}circle.agent5{fill:#c24c7a}
.state,.accepting,.dead{fill:var(--card);stroke:var(--ink);stroke-width:1.3}
.accepting{stroke:var(--good);stroke-width:1.8}.dead{stroke:var(--bad)}svg .state-name{font-size:10px}
.arrow{stroke:var(--soft);stroke-width:1.1}.tip{fill:var(--soft)}
.key{display:inline-block;width:.75em;height:.75em;border-radius:2px;margin-right:4px}
"""
