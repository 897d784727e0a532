"""From a formula to its minimal deterministic automaton.

A state of the translator is a positive Boolean function of obligations (`obligations`), expanded letter by
letter from the formula. The sub-diagrams below the propositions are its successors, so letters are never enumerated.
For co-safe semantics acceptance is then made absorbing and closed under "all successors accept" (`saturated`). Finally
equivalent states are merged. The first letter that the automaton reads is that of x0.

Reference: docs/theory/setting.md, "Letters and words" and "Satisfaction".
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .automaton import Automaton, check_semantics
from .by_hand import automaton_from_transitions
from .decision_diagram import DecisionDiagrams, DiagramSizeError
from .hoa import automaton_from_hoa
from .minimal import StateGraph, minimal_automaton, saturated
from .normal_form import NormalForm, Term, Terms, check_names
from .obligations import Obligations
from .parser import Formula, FormulaError, parse_formula

MOST_NODES = 5_000_000
"""Most nodes of the diagrams that are built: about a gigabyte."""

MOST_STEPS = 1_500_000
"""Steps of decision diagrams that the states of one automaton may take.

They are counted, not timed, so that a formula is refused everywhere or nowhere.
"""


class AutomatonSizeError(FormulaError):
    """An automaton has more states, or its diagrams more nodes, than may be built."""


def translate(
    task: str | Formula | Mapping[str, Any],
    propositions: Sequence[str],
    semantics: str = "co-safe",
    families: Mapping[str, Sequence[str]] | None = None,
    max_states: int = 10_000,
    max_nodes: int = MOST_NODES,
) -> Automaton:
    """Return the complete automaton of a task (exact): minimal, but for one that is written state by state.

    Parameters
    ----------
    task : str, Formula or mapping
        A formula, whose syntax is described in `certigym.envs.tasks.automata.parser`; the text of a terminal
        deterministic Buchi automaton in HOA format, which begins with ``HOA:``; or states and guarded transitions as in
        problem files: ``states``, ``initial``, ``accepting``, ``transitions``, ``otherwise`` (see
        ``automaton_from_transitions``).
    propositions : sequence of str
        All propositions; their order becomes the variable order of the diagrams.
    semantics : str
        ``"co-safe"``: satisfied once no continuation can violate it (the formula must be syntactically co-safe).
        ``"finite-trace"``: LTLf, judged after the last letter.
    families : mapping, optional
        Members of each family, for ``all(family)`` and ``any(family)``.
    max_states : int
        Largest number of states that is built, before minimisation.
    max_nodes : int
        Largest number of nodes of the diagrams from which it is built. Both limits count what is built, not seconds.

    Raises
    ------
    FormulaError
        If the formula cannot be read, or is not co-safe where it must be.
    AutomatonSizeError
        If the automaton needs more states or nodes than may be built; a ``FormulaError``.
    ValueError
        If another argument is wrong, or if an automaton is not of that form.

    Examples
    --------
    >>> translate("F a", ["a"], "co-safe").n_states
    2
    >>> translate("G a", ["a"], "finite-trace").accepts([{"a"}, set()])
    False
    >>> rows = [("wait", "a", "done"), ("wait", "!a", "wait")]
    >>> by_hand = {"states": ["wait", "done"], "initial": "wait", "accepting": ["done"], "transitions": rows}
    >>> translate(by_hand, ["a"]).accepts([{"a"}])
    True
    """
    check_semantics(semantics)
    if isinstance(task, Mapping):
        return automaton_from_transitions(propositions, semantics=semantics, families=families, **task)
    if isinstance(task, str) and task.lstrip().startswith("HOA:"):
        if semantics != "co-safe":
            raise ValueError(f"`semantics`: expected 'co-safe' for an automaton in HOA format, got {semantics!r}")
        return automaton_from_hoa(task, propositions)
    formula = task
    families = families or {}
    check_names(propositions, families)
    if not isinstance(formula, Formula):
        formula = parse_formula(formula)
    co_safe = semantics == "co-safe"
    reader = NormalForm(propositions, families, co_safe)
    term = reader.read(formula)
    try:
        graph = _explore(term, reader.terms, tuple(propositions), co_safe, (max_states, max_nodes))
        return minimal_automaton(saturated(graph) if co_safe else graph, semantics, judge_empty_word=co_safe)
    except DiagramSizeError as error:
        raise AutomatonSizeError(f"the automaton is too large: {error}; simplify the formula", formula.text) from error


def _explore(
    term: Term, terms: Terms, propositions: tuple[str, ...], co_safe: bool, most: tuple[int, int]
) -> StateGraph:
    """Return the automaton whose states are the functions of obligations that remain after some word.

    It has at most so many states, and each of its two managers of diagrams so many nodes.
    """
    max_states, max_nodes = most
    source, target = DecisionDiagrams(max_nodes, step_limit=MOST_STEPS), DecisionDiagrams(max_nodes)
    obligations = Obligations(source, terms, len(propositions), co_safe)
    start = obligations.start(term)
    number = {start: 0}
    pending = [start]
    roots: list[int] = []
    memo: dict[int, int] = {}

    # An expanded state tests propositions first: what lies below them is the state after the letter. Number the new
    # ones, and replace them by terminals.
    def successor(n: int) -> int | None:
        if source.variable(n) < len(propositions):
            return None
        if n not in number:
            number[n] = len(number)
            pending.append(n)
            if len(number) > max_states:
                raise AutomatonSizeError(
                    f"the automaton needs more than `max_states` = {max_states} states; "
                    "each `F` beside others doubles them: say an order, such as `F (a & F b)`, or what is at once, "
                    "`F (a & b)`; shorten bounds, or raise the limit"
                )
        return target.terminal(number[n])

    for state in pending:  # grows while it is read
        roots.append(source.rebuild(obligations.advance(state), target, successor, memo))
    accepting = [obligations.holds_at_end(state) for state in pending]
    return StateGraph(propositions, target, roots, accepting, 0)
