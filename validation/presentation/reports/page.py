"""The HTML of a report: a section per question, verdict first. All text that comes from a certificate is escaped."""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Iterable
from html import escape
from typing import TYPE_CHECKING, Any

from ....envs.interfaces import AGENTS, LOOKS, Panel, coordinate_name, edges, panels
from ....envs.systems.arguments import counted
from ....envs.tasks.problem import Problem
from ....synthesis.certificates.proofs import (
    KEPT,
    Certificate,
    Tube,
    alike_members,
    in_runs,
    members_of,
    rounded_down,
    shown_bound,
    start_of_claim,
    tube_along,
)
from ...statistical_tests import MEANINGS, NOT_CERTIFIED, REFUTED, VACUOUS, tried_lines
from .content import INVALID
from .explorer import MOST_PANELS, explorer_data
from .explorer_script import EXPLORER, EXPLORER_STYLE
from .inline_pictures import (
    FEW_STATES,
    automaton_picture,
    bound_curve,
    empty_panel,
    margin_pictures,
    meter,
    rollouts_picture,
)
from .page_style import PATTERNS, PLAYER, STYLE
from .player import episodes_of

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

TUBE = f"; shaded: the tube along the nominal path, kept with probability {KEPT:g} unless an input is cut off"
LINEAR_TUBE = (
    f"; shaded: the tube that linear deviations from the nominal path keep with probability {KEPT:g}; what the "
    "dynamics bend beyond that is part of the proof, and is not drawn"
)
OTHER_TUBE = "; shaded: {:.1f} standard deviations around the nominal path, of linear deviations alone"
"""What is said of a tube that is drawn, of one of an agent that is not linear, and of noise that is not normal."""

ONE_START = (
    "<b>The certificate is about one start, which the cross marks.</b> Elsewhere stands what the separate check proves "
    "of the same controllers from there; where it was not asked, no bound is known, and the point is empty."
)
"""What is said of the explorer of a certificate that speaks of its own start."""

HEADLINES = {INVALID: "Not certified", REFUTED: "Refuted by rollouts", VACUOUS: "Nothing is claimed"}
"""What stands over the page in place of the name where the claim failed, or says nothing."""

LONGEST_TASK = 600
"""Characters of a formula that the head of the page shows; the data at its end have all of it."""


def page_of(content: ReportContent) -> str:
    """Return the whole page."""
    problem = content.certificate.problem
    sections = [_explorer(content), _rollouts(content), _starts(content), _steps(content), _trust(content)]
    task = problem.specification.formula or "given as an automaton"
    kind = "certificate" if content.checked else "NOT certified"
    size = f"{counted(problem.n_agents, 'agent')}, {counted(problem.horizon, 'control step')}"
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{escape(problem.name)}: {kind}</title><style>{STYLE}{EXPLORER_STYLE}</style></head>"
        f"<body>{PATTERNS}<main>"
        f"{_headline(content)}<p class=soft>{size}, {escape(problem.specification.semantics)} task</p>"
        f"<p class=task><code>{escape(_cut(task, LONGEST_TASK))}</code></p>"
        f"{_answer(content)}{''.join(sections)}</main>"
        f"{_data('data', content.to_dict())}{_data('episodes', _episodes(content))}<script>{PLAYER}</script>"
        f"{_explorer_script(content)}</body></html>\n"
    )


def _data(name: str, values: Any) -> str:
    """Return values as JSON inside the page; text inside a script element must not contain "</script>"."""
    text = json.dumps(values, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f'<script type="application/json" id="{name}">{text}</script>'


def _section(title: str, body: str) -> str:
    return f"<section><h2>{escape(title)}</h2>{body}</section>"


def _figure(title: str, drawing: str, caption: str) -> str:
    """Return a drawing with its title above and an explanation, which may hold markup, below."""
    head = f"<h3>{escape(title)}</h3>" if title else ""
    return f"<figure>{head}{drawing}<figcaption>{caption}</figcaption></figure>"


def _list(pairs: dict[str, Any]) -> str:
    return "<dl>" + "".join(f"<dt>{escape(k)}</dt><dd>{escape(str(v))}</dd>" for k, v in pairs.items()) + "</dl>"


def _cut(words: str, most: int) -> str:
    """Return a text, cut off with dots if it is longer than ``most`` characters."""
    return words if len(words) <= most else words[:most] + " ..."


def _verdict(word: str) -> str:
    return f'<span class="verdict {escape(word)}">{escape(word)}</span>'


def _headline(content: ReportContent) -> str:
    """Return the head of the page: the name, or first of all that the claim failed, or that it claims nothing."""
    name = escape(content.certificate.problem.name)
    word = HEADLINES.get(content.verdict)
    return f"<h1>{name}</h1>" if word is None else f'<h1 class="alarm">{word}</h1><p class=big>{name}</p>'


def _explorer(content: ReportContent) -> str:
    """Return the value explorer, which its script fills; nothing where there is nothing to explore."""
    if content.explored is None:
        return ""
    problem = content.certificate.problem
    shown = panels(problem)[:MOST_PANELS]
    of_one = content.explored.own is not None
    drawings = ""
    for k, panel in enumerate(shown):
        tubes = _tubes(content, panel) if of_one else {}
        drawing = empty_panel(panel, problem.horizon, k, tubes)
        drawings += _figure("", drawing, _names(panel) + _about(tubes.values()))
    height = 320 if len(content.explored.axes) == 2 else 120
    others = ONE_START if of_one else "The others start where the problem says."
    body = (
        '<div class="explorer" hidden><p class=soft>Drag the ring, or move it with the arrow keys. The stronger the '
        "colour, the better the odds that are certified at that point; the paths are ten episodes from there. "
        f"{others}</p>"
        '<div class=controls><span class=later><label>automaton <select><option value="start">at the start</option>'
        '</select></label> <label><span class=when></span> <input type="range" min="0" value="0"></label></span></div>'
        "<p class=read aria-live=polite></p><div class=row><figure>"
        f'<svg class="map" viewBox="0 0 360 {height}" role="group" aria-label="map of starts"></svg></figure>{drawings}'
        "</div></div>"
    )
    return _section("Explore", body)


def _explorer_script(content: ReportContent) -> str:
    """Return the data and the script of the explorer, if there is one."""
    if content.explored is None:
        return ""
    data = explorer_data(content.explored, content.certificate.problem)
    return f"{_data('explorer', data)}<script>{EXPLORER}</script>"


def _answer(content: ReportContent) -> str:
    """Return the box at the head: what is certified, beside what rollouts gave, and what each test says."""
    v, certificate = content.validation, content.certificate
    point = start_of_claim(certificate) == "point"
    start = "from the initial state" if point else "on average over the initial box"
    upper = None if v.gap is None else min(1.0, v.lower_bound + v.gap)
    above = "the probability is at least this" if upper is None else "the probability lies between these"
    # What stands in brackets is not broken at the minus of an exponent.
    shown = re.sub(r"\(.*\)", r"<span class=whole>\g<0></span>", escape(shown_bound(v.lower_bound, v.gap)))
    words = in_runs(v.lower_bound)
    said = f"<p class=words>{words[:1].upper()}{escape(words[1:])}.</p>" if words else ""
    proved = f"{said}<p>Under these controllers, {escape(start)}, {above}: proved for the model, not estimated.</p>"
    if v.verdict == VACUOUS:
        why = escape(v.details.get("nothing", ""))
        proved = f"<p>{_verdict(VACUOUS)} {escape(MEANINGS[VACUOUS])}.</p>" + (
            f"<p><b>Why:</b> {why}.</p>" if why else ""
        )
    claim = f"<h2>Claim and verdict</h2><p class=big>{shown}</p>{proved}"
    if not content.checked:
        claim = (
            f"<h2>Not certified</h2><p class=big>{_verdict(content.verdict)} {escape(NOT_CERTIFIED)}</p>"
            f"<p><b>{escape(_checked(content))}</b></p><p>It claimed {shown}. Do not rely on it: the claim is "
            "not proved, whatever rollouts say.</p>"
        )
    w, field = content.audit, content.field
    tests = [
        (_mark(v.verdict), f"<b>Rollouts</b>: {_verdict(v.verdict)} {escape(MEANINGS.get(v.verdict, ''))}"),
        ("yes" if content.checked else "no", f"<b>Separate check</b>: {escape(_checked(content))}"),
    ]
    # What speaks of one start has neither audit nor map.
    if w is not None and field is not None:
        tests.append((_mark(w.verdict), f"<b>Every step</b>: {escape(w.verdict)}, {w.tests} tests"))
        tests.append(
            (_mark(field.verdict), f"<b>Other starts</b>: {escape(field.verdict)}, {len(field.states)} of them")
        )
    items = "".join(f"<li class={mark}>{words}</li>" for mark, words in tests)
    rates = (
        f"{v.successes} of {counted(v.episodes, 'episode')} satisfied the task: {v.estimate:.6f}, "
        f"{100 * v.confidence:g} % limits [{v.ci_low:.6f}, {v.ci_high:.6f}]."
    )
    word = "certified" if content.checked else "claimed"
    blue = "from the lower to the upper bound" if upper is not None else f"the {word} bound, and what lies above it"
    caption = f"{_key('bound')}{blue}. {_key('run')}{escape(rates)}"
    drawing = meter((v.lower_bound, upper), (v.estimate, v.ci_low, v.ci_high), word)
    left = f"<div>{claim}<ul class=tests>{items}</ul></div>"
    return f'<section class="answer is-{escape(content.verdict)}">{left}{_figure("", drawing, caption)}</section>'


def _mark(verdict: str) -> str:
    return {"confirmed": "yes", "refuted": "no"}.get(verdict, "open")


def _checked(content: ReportContent) -> str:
    return "holds" if content.checked else "; ".join(content.checked.failures)


def _key(role: str) -> str:
    """Return a square in the colour of a role, for captions."""
    return f'<span class="key k-{role}"></span>'


def _episodes(content: ReportContent) -> dict[str, Any]:
    """Return what the player of the page shows."""
    return episodes_of(content, panels(content.certificate.problem)[:MOST_PANELS_DRAWN])


def _names(panel: Panel) -> str:
    """Return the agents of a panel with their colours, and what the colours of its regions mean."""
    agents = [f'<span class="key k-agent{c.number % len(AGENTS)}"></span>{escape(c.name)}' for c in panel.curves[:12]]
    rest = f" and {len(panel.curves) - 12} more" if len(panel.curves) > 12 else ""
    shown = dict.fromkeys(region.role for region in panel.regions if LOOKS[region.role].word)
    looks = "".join(f"; {_key(role)}{LOOKS[role].word}" for role in shown)
    return ", ".join(agents) + rest + looks


def _tubes(content: ReportContent, panel: Panel) -> dict[int, Tube]:
    """Return the tubes along nominal paths that a panel shows, by the numbers of their curves."""
    found = {curve.number: tube_along(content.certificate, curve.rows) for curve in panel.curves}
    return {number: tube for number, tube in found.items() if tube is not None}


def _about(tubes: Iterable[Tube]) -> str:
    """Return what is said of the tubes of a picture; nothing if there are none."""
    shown = list(tubes)
    if not all(tube.is_normal for tube in shown):
        return OTHER_TUBE.format(max(tube.radius for tube in shown))
    return "" if not shown else TUBE if all(tube.is_linear for tube in shown) else LINEAR_TUBE


def _rollouts(content: ReportContent) -> str:
    """Return the section of drawn rollouts, one figure per panel, and the player."""
    shown = panels(content.certificate.problem)
    lost = int((~content.success).sum())
    figures = []
    for number, panel in enumerate(shown[:MOST_PANELS_DRAWN]):
        tubes = _tubes(content, panel)
        drawing = rollouts_picture(panel, content.states, content.success, number, tubes)
        figures.append(_figure("", drawing, _names(panel) + _about(tubes.values())))
    words = f"{counted(len(content.success), 'rollout')} of the continuous system"
    words += f"; the {lost} with broken lines did not satisfy the task." if lost else ", which all satisfied the task."
    if len(shown) > MOST_PANELS_DRAWN:
        words += f" {counted(len(shown) - MOST_PANELS_DRAWN, 'more panel')} not drawn."
    player = (
        '<div class="player" hidden><button type="button">Play</button><select aria-label="episode">'
        + "".join(
            f'<option value="{m}">{escape(name)}</option>' for m, name in enumerate(_episodes(content)["episodes"])
        )
        + '</select><input type="range" min="0" value="0" aria-label="control step"><output></output></div>'
    )
    figures += [f"<div>{_drawing(task)}{_automaton(task)}</div>" for task in _tasks(content.certificate)]
    return _section("Rollouts", f"<p class=soft>{words}</p>{player}<div class=row>{''.join(figures)}</div>")


def _starts(content: ReportContent) -> str:
    """Return the section of the tests at many starts: two maps, or one line; nothing if there were none."""
    field, problem = content.field, content.certificate.problem
    if field is None:
        return ""
    names = " and ".join(coordinate_name(problem, k) for k in content.axes)
    w, refuted, below = field.weakest, int(field.refuted.sum()), bool((field.margins < 0).any())
    note = (
        f"{len(field.states)} starts that differ in {names}, {counted(int(field.episodes.min()), 'episode')} each, "
        f"tested together: refuted at {refuted}, confirmed at {int(field.confirmed.sum())}, nothing claimed at "
        f"{int(field.vacuous.sum())}. Weakest "
        f"at ({', '.join(f'{x:.4g}' for x in field.states[w])}): bound {rounded_down(field.lower_bounds[w], 4)}, "
        f"rollouts {field.estimates[w]:.4f}."
    )
    red = f" {_key('bad')}refuted." if refuted else ""
    if len(content.axes) == 1:
        captions = [f"{_key('bound')}bound; {_key('run')}rollouts with their limits.{red}"]
    else:
        orange = f" {_key('run')}They lie below it, by chance unless a cell is refuted." if below else ""
        captions = [
            f"{_key('bound')}The stronger the colour, the better the odds. {_key('good')}confirmed by rollouts.{red}",
            f"{_key('bound')}The rollouts lie above the bound; the stronger the colour, the farther.{orange}{red}",
        ]
    figures = [
        _figure(title, drawing, words)
        for (title, drawing), words in zip(margin_pictures(problem, field, content.axes).items(), captions)
    ]
    return _section("Other starts", f"<p class=soft>{escape(note)}</p><div class=row>{''.join(figures)}</div>")


def _steps(content: ReportContent) -> str:
    """Return the section about time: the bound against the number of steps, and the tests step by step, if any."""
    v, audit = content.validation, content.audit
    if audit is None or content.bounds is None:
        return ""
    # The curve is about one start; rollouts from a box of starts estimate a mean, which is not on it.
    estimate = (v.estimate, v.ci_low, v.ci_high) if start_of_claim(content.certificate) == "point" else None
    where = "the start" if estimate else "the middle of the initial box"
    end = f" {_key('run')}the rollouts with their limits." if estimate else ""
    note = f"{_key('bound')}certified from {where} if only the last k steps of the policies are played.{end}"
    curve = _figure("Bound against horizon", bound_curve(content.bounds, estimate), note)
    facts = {
        "tests": f"{audit.tests} of pairs of time and task state, on {counted(audit.episodes, 'episode')}",
        "all steps together": f"p = {audit.overall_p:.2g}",
        "contradictions": audit.contradictions,
    }
    findings = "".join(f"<p class=soft>{escape(str(f))}</p>" for f in audit.findings[:FINDINGS_SHOWN])
    findings = findings or "<p class=soft>No step is suspicious.</p>"
    tested = (
        f"<div><h3>Audit of every step</h3>{_verdict(audit.verdict)}"
        "<p>The bound of every state is compared with what becomes of it one step later, so that errors that "
        f"cancel over a whole episode are seen.</p>{_list(facts)}{findings}</div>"
    )
    return _section("Step by step", f"<div class=row>{curve}{tested}</div>")


def _tasks(certificate: Certificate) -> list[Problem]:
    """Return the problem, or of independent tasks those that differ in more than names."""
    return [members_of(certificate)[same[0]].problem for same in alike_members(certificate)][:MOST_AUTOMATA]


def _drawing(problem: Problem) -> str:
    """Return the figure of a task automaton; nothing if it is too large to be drawn."""
    automaton = problem.automaton
    if automaton.n_states > STATES_DRAWN:
        return ""
    left_out = "" if automaton.n_states <= FEW_STATES else " Arrows to red states are left out."
    dead = f" Red: acceptance can no longer be reached.{left_out}" if automaton.dead.any() else ""
    note = f"The task automaton. Double circle: accepting.{dead}"
    return _figure("", automaton_picture(automaton, edges(problem)), note)


def _automaton(problem: Problem) -> str:
    """Return the table of one automaton: the letters that take each transition."""
    automaton = problem.automaton
    if automaton.n_states > STATES_LISTED:
        return f"<p class=soft>{automaton.n_states} states, not listed</p>"
    names, transitions = automaton.state_names, edges(problem)
    rows = [
        f"<tr><td>{escape(names[edge.source])}</td><td>{escape(names[edge.target])}</td>"
        f"<td><code>{escape(edge.guard)}</code></td></tr>"
        for edge in transitions[:MOST_TRANSITIONS]
    ]
    rest = len(transitions) - MOST_TRANSITIONS
    more = f"<p class=soft>{counted(rest, 'more transition')}</p>" if rest > 0 else ""
    return f"<div class=scroll><table><tr><th>from<th>to<th>when</tr>{''.join(rows)}</table></div>{more}"


def _trust(content: ReportContent) -> str:
    """Return the section of everything that a repetition needs."""
    certificate, v, details = content.certificate, content.validation, content.validation.details
    text = json.dumps(certificate.settings, indent=1, sort_keys=True, default=str)
    facts = {
        "method": f"{v.method} ({certificate.proof.bound} bound, rank {v.rank})",
        **certificate.proof.about,
        **({"tried": "; ".join(tried)} if (tried := tried_lines(v.details)) else {}),
        "separate check": _checked(content),
        "fingerprint": certificate.fingerprint,
        "seed": details["seed"],
        "worlds per chunk": details["chunk"],
        "confidence": v.confidence,
        "versions": f"certigym {details['certigym']}, numpy {details['numpy']}, python {platform.python_version()}",
    }
    command = f"certigym validate CERT --episodes {v.episodes} --seed {details['seed']} --confidence {v.confidence}"
    settings = f"<details><summary>Settings of the synthesis</summary><pre>{escape(_cut(text, 20_000))}</pre></details>"
    again = (
        f"<p>Run it again, with the same numbers on one worker or many:</p><pre>{escape(command)}</pre>"
        "<p class=soft>A bound is about the model only.</p>"
    )
    return _section("What it rests on", _list(facts) + settings + again)
