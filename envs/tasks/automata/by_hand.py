"""Automata written by hand: states, and transitions whose guards are Boolean expressions over the propositions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .automaton import Automaton, check_semantics
from .decision_diagram import DecisionDiagrams
from .formula import NEXT_LIKE, UNTIL_LIKE
from .guard_diagrams import CONFLICT, MISSING, completed, joined_guards, letter_text, propositional_diagram
from .normal_form import NormalForm, check_names
from .parser import Formula, parse_formula
from .rebuilt import automaton_from_diagrams


def automaton_from_transitions(
    propositions: Sequence[str],
    states: Sequence[str],
    initial: str,
    accepting: Sequence[str],
    transitions: Sequence[tuple[str, str, str]],
    semantics: str,
    otherwise: str | None = None,
    families: Mapping[str, Sequence[str]] | None = None,
) -> Automaton:
    """Return the automaton with these states and guarded transitions (exact; states are neither merged nor reordered).

    Parameters
    ----------
    propositions : sequence of str
        All propositions, in the wanted order.
    states : sequence of str
        Names of the states.
    initial : str
        State before the first letter; the first letter read is that of x0.
    accepting : sequence of str
        Accepting states. With co-safe semantics they are made absorbing and need no transitions.
    transitions : sequence of (source, guard, target)
        Guards are written like formulas without temporal operators, such as ``a & !b`` or ``all(safe)``.
    semantics : str
        ``"co-safe"`` or ``"finite-trace"``.
    otherwise : str, optional
        Target of the letters for which no guard of a state holds. Without it, every letter needs a guard.
    families : mapping, optional
        Members of each family.

    Raises
    ------
    ValueError
        If a name is unknown, or if for some letter no guard holds or guards with different targets do; the message
        shows the letter.

    Examples
    --------
    >>> automaton_from_transitions(["a"], ["wait", "done"], "wait", ["done"],
    ...     [("wait", "a", "done"), ("wait", "!a", "wait")], "co-safe").accepts([{"a"}])
    True
    """
    check_semantics(semantics)
    families = families or {}
    index = _checked_states(propositions, families, states, initial, accepting)
    diagrams = DecisionDiagrams()
    reader = NormalForm(propositions, families, co_safe=False)
    guarded = _guarded(transitions, index, diagrams, reader)
    fallback = None if otherwise is None else _state("otherwise", otherwise, index)
    # The diagram of a state joins its guards; every letter must then have exactly one target.
    roots: list[int] = []
    for q, name in enumerate(states):
        if semantics == "co-safe" and name in accepting:  # absorbing
            roots.append(diagrams.terminal(q))
            continue
        root = joined_guards(diagrams, guarded.get(q, []))
        if fallback is not None:
            root = completed(diagrams, root, fallback)
        _check_root(diagrams, root, name, propositions)
        roots.append(root)
    accepts = [name in accepting for name in states]
    return automaton_from_diagrams(propositions, semantics, states, index[initial], accepts, diagrams, roots)


def _checked_states(
    propositions: Sequence[str],
    families: Mapping[str, Sequence[str]],
    states: Sequence[str],
    initial: str,
    accepting: Sequence[str],
) -> dict[str, int]:
    """Return the states' indices by name; raise ValueError if a list is malformed or a state is unknown."""
    for field, names in (("propositions", propositions), ("states", states), ("accepting", accepting)):
        if isinstance(names, str) or not isinstance(names, Sequence) or not all(isinstance(n, str) for n in names):
            raise ValueError(f"`{field}`: expected a list of names, got {names!r}")
    check_names(propositions, families)
    index = {name: q for q, name in enumerate(states)}
    for field, name in [("initial", initial), *(("accepting", name) for name in accepting)]:
        _state(field, name, index)
    return index


def _guarded(
    transitions: object, index: Mapping[str, int], diagrams: DecisionDiagrams, reader: NormalForm
) -> dict[int, list[tuple[int, int]]]:
    """Return, per state with transitions, their guards as diagrams, each with its target."""
    guarded: dict[int, list[tuple[int, int]]] = {}
    for source, guard, target in _triples(transitions):
        node = propositional_diagram(reader.read(_parsed(guard)), diagrams, {})
        q = _state("transitions", source, index)
        guarded.setdefault(q, []).append((node, _state("transitions", target, index)))
    return guarded


def _triples(transitions: object) -> list[tuple[str, str, str]]:
    """Return the transitions as triples of strings, or raise ValueError."""
    if isinstance(transitions, str) or not isinstance(transitions, Sequence):
        raise ValueError(f"`transitions`: expected a list of [source, guard, target], got {transitions!r}")
    triples: list[tuple[str, str, str]] = []
    for entry in transitions:
        if isinstance(entry, str) or not isinstance(entry, Sequence) or [type(text) for text in entry] != [str] * 3:
            raise ValueError(f"`transitions`: expected three strings [source, guard, target], got {entry!r}")
        triples.append((entry[0], entry[1], entry[2]))
    return triples


def _parsed(guard: str) -> Formula:
    """Return a guard as a formula; raise FormulaError if it has a temporal operator."""
    formula = parse_formula(guard)
    for subformula in formula.subformulas():
        operator = subformula.operator
        if operator in NEXT_LIKE or operator in UNTIL_LIKE:
            raise subformula.error(f"`transitions`: expected guards without temporal operators, got {operator}")
    return formula


def _state(field: str, name: object, index: Mapping[str, int]) -> int:
    """Return the index of a state, or raise ValueError."""
    if not isinstance(name, str) or name not in index:
        declared = ", ".join(list(index)[:10]) or "none"
        raise ValueError(f"`{field}`: expected one of the states {declared}, got {name!r}")
    return index[name]


def _check_root(diagrams: DecisionDiagrams, root: int, name: str, propositions: Sequence[str]) -> None:
    """Raise ValueError, with a letter, if guards of a state overlap or leave letters without a transition."""
    conflict = diagrams.find(root, CONFLICT)
    if conflict is not None:
        raise ValueError(
            f"`transitions`: guards of state {name!r} with different targets overlap, for example on the letter "
            f"{letter_text(conflict, propositions)}; make them exclude each other"
        )
    missing = diagrams.find(root, MISSING)
    if missing is not None:
        raise ValueError(
            f"`transitions`: state {name!r} has no transition for the letter {letter_text(missing, propositions)}; "
            "add one or give `otherwise`"
        )
