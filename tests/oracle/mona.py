"""Translation by the program MONA, where it is installed: an independent second opinion.

A formula in negation normal form becomes a first-order sentence over the positions of a finite string (M2L-Str): each
term becomes a formula with one free position p, and the whole formula is read at position 0. MONA answers with the
minimal automaton, its transitions as ternary cubes. Its first step reads Boolean variables; these sentences have none,
so that step is skipped. Everything happens in a private temporary directory.

For co-safe formulas the sentence says "this finite string proves the formula" (X and windows are strong, and there is
no release). Every extension of the string proves it, too. The accepting states are then made absorbing and closed like
those of the built-in translator.

Reference: MONA 1.4, https://www.brics.dk/mona/.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from certigym.envs.tasks.automata.automaton import Automaton
from certigym.envs.tasks.automata.decision_diagram import DecisionDiagrams
from certigym.envs.tasks.automata.formula import FormulaError
from certigym.envs.tasks.automata.guard_diagrams import CONFLICT, MISSING, joined_guards
from certigym.envs.tasks.automata.minimal import StateGraph, minimal_automaton, saturated
from certigym.envs.tasks.automata.normal_form import NormalForm, Term
from certigym.envs.tasks.automata.parser import parse_formula

_TIMEOUT = 120.0
"""Seconds that MONA may take; sentences of the sizes met here take well below one."""


def mona_available() -> bool:
    """Return whether the program ``mona`` is on the path."""
    return shutil.which("mona") is not None


def translated(
    formula: str,
    propositions: Sequence[str],
    semantics: str,
    families: Mapping[str, Sequence[str]] | None = None,
    max_states: int = 10_000,
) -> Automaton:
    """Return the automaton of a formula as MONA computes it, with the same arrays as ``certigym.translate``."""
    co_safe = semantics == "co-safe"
    term = NormalForm(propositions, families or {}, co_safe).read(parse_formula(formula))
    graph = mona_states(term, tuple(propositions), co_safe, max_states)
    return minimal_automaton(saturated(graph) if co_safe else graph, semantics, judge_empty_word=co_safe)


def mona_states(term: Term, propositions: tuple[str, ...], co_safe: bool, max_states: int) -> StateGraph:
    """Return the automaton of `term` as MONA computes it, for finite strings; accepting states do not absorb yet.

    Raises
    ------
    ValueError
        If the program is not on the path or fails.
    FormulaError
        If the automaton needs more than `max_states` states, or MONA more than two minutes.
    """
    # Declare the propositions that occur, and say that the term holds at the position without a predecessor.
    used = sorted(_used(term))
    declaration = f"var2 {', '.join(f'P{i}' for i in used)};\n" if used else ""
    text = f"m2l-str;\n{declaration}ex1 p: (~(ex1 q: q < p) & {_Encoder(co_safe).at(term, 'p')});\n"
    return _parsed(_run(text), used, propositions, max_states)


def _used(term: Term) -> set[int]:
    """Return the propositions that occur in a term."""
    propositions: set[int] = set()
    seen: set[Term] = set()
    stack = [term]
    while stack:
        subterm = stack.pop()
        if subterm not in seen:
            seen.add(subterm)
            stack.extend(subterm.operands)
            if subterm.literal is not None:
                propositions.add(subterm.literal[0])
    return propositions


class _Encoder:
    """Writer of terms as MONA formulas with one free position."""

    def __init__(self, co_safe: bool) -> None:
        self.co_safe = co_safe
        self.count = 0

    def fresh(self) -> str:
        self.count += 1
        return f"x{self.count}"

    def at(self, term: Term, p: str) -> str:
        """Return the MONA formula which says that `term` holds at position `p`."""
        if term.literal is not None:
            proposition, positive = term.literal
            return f"{p} in P{proposition}" if positive else f"{p} notin P{proposition}"
        if term.operator in ("true", "false"):
            return term.operator
        if term.operator in ("&", "|"):
            return "(" + f" {term.operator} ".join([self.at(operand, p) for operand in term.operands]) + ")"
        if term.bounds is not None:
            return self.window(term, term.bounds, p)
        # Until and release: r runs over the positions from p up to, but without, q.
        q, r = self.fresh(), self.fresh()
        left, right = self.at(term.operands[0], r), self.at(term.operands[1], q)
        between = f"{p} <= {r} & {r} < {q}"
        if term.operator == "U":
            return f"(ex1 {q}: ({p} <= {q} & {right} & (all1 {r}: (({between}) => {left}))))"
        return f"(all1 {q}: ({p} <= {q} => ({right} | (ex1 {r}: ({between} & {left})))))"

    def window(self, term: Term, bounds: tuple[int, int], p: str) -> str:
        """Return the MONA formula of a window at position `p`; with co-safe semantics its last letter must come."""
        low, high = bounds
        q = self.fresh()
        body = self.at(term.operands[0], q)
        inside = f"({p} + {low} <= {q} & {q} <= {p} + {high})"
        if term.operator == "F[]":
            return f"(ex1 {q}: ({inside} & {body}))"
        always = f"(all1 {q}: ({inside} => {body}))"
        if not self.co_safe:
            return always
        end = self.fresh()
        return f"({always} & (ex1 {end}: {end} = {p} + {high}))"


def _run(text: str) -> str:
    """Return the text that MONA prints about the sentence in `text`."""
    program = shutil.which("mona")
    if program is None:
        raise ValueError("expected the program mona on the path, found none")
    # No shell is involved, and the file name is fixed: formulas cannot reach the command line.
    with tempfile.TemporaryDirectory(prefix="certigym-mona-") as folder:
        (Path(folder) / "formula.mona").write_text(text, encoding="ascii")
        try:
            done = subprocess.run(
                [program, "-q", "-w", "-u", "formula.mona"],
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=_TIMEOUT,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise FormulaError(f"mona took more than {_TIMEOUT:.0f} s; simplify the formula") from error
    if done.returncode != 0 or "Transitions:" not in done.stdout:
        message = (done.stderr or done.stdout).strip()[:300]
        raise ValueError(f"mona failed with status {done.returncode}: {message}")
    return done.stdout


def _parsed(output: str, used: list[int], propositions: tuple[str, ...], max_states: int) -> StateGraph:
    """Return the automaton that MONA has printed."""
    count = re.search(r"^Automaton has (\d+) states?", output, re.MULTILINE)
    accept = re.search(r"^Accepting states: *([\d ]*)$", output, re.MULTILINE)
    if count is None or accept is None:
        raise ValueError(f"cannot read the answer of mona: {output[:300]!r}")
    n_states = int(count.group(1))
    if n_states > max_states + 1:
        raise FormulaError(f"the automaton needs more than `max_states` = {max_states} states")
    # A cube such as 0X1 is a conjunction of literals over the declared propositions; X leaves one open.
    diagrams = DecisionDiagrams()
    guarded: list[list[tuple[int, int]]] = [[] for _ in range(n_states)]
    for source, cube, target in re.findall(r"^State (\d+): ([01X]*) *-> state (\d+)$", output, re.MULTILINE):
        literals = [diagrams.literal(p, bit == "1") for p, bit in zip(used, cube, strict=True) if bit != "X"]
        guarded[int(source)].append((diagrams.conjoin_all(literals), int(target)))
    roots = [joined_guards(diagrams, pairs) for pairs in guarded]
    for root in roots:
        if set(diagrams.leaves(root)) & {MISSING, CONFLICT}:
            raise ValueError("the transitions printed by mona are not deterministic and complete")
    # State 0 reads the Boolean variables: its only successor is the state before the first letter.
    if not diagrams.is_terminal(roots[0]):
        raise ValueError("expected the first step of mona's automaton to depend on no proposition")
    accepting = {int(q) for q in accept.group(1).split()}
    initial = diagrams.value(roots[0])
    return StateGraph(propositions, diagrams, roots, [q in accepting for q in range(n_states)], initial)
