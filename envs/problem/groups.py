"""Tasks that fall apart: conjunctions whose parts speak of different agents.

Noises and policies of different agents are independent. Where a formula is a conjunction of formulas over disjoint
groups of agents, so is the outcome of every group, and the probability of the whole is the **product** of theirs. The
automaton of the whole would need as many states as there are combinations of the groups' states (fifty pairs that are
to meet: 2^50); the groups' own automata stay small.

Conjunctions are found below ``&``, ``all``, ``G``, ``G[a,b]``, ``X`` and ``N``, and below the negations of ``|``,
``any``, ``->``, ``F`` and ``F[a,b]``, all of which distribute over them. An agent that no conjunct speaks of is to stay
in its workspace.

A co-safe task of the whole is satisfied at the step at which the last group accepts, and until then every agent has to
stay in its workspace, also those of groups that are done. So a group of a co-safe task is judged at the horizon, like
one of a finite trace: it has to be accepted, and stay in the workspace to the end. That is at least as much as the
whole asks for; lower bounds stay lower bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ..logic import Automaton, Formula, NormalForm, parse_formula, translate

MOST_STATES = 1000
"""States of the groups together, multiplied, from which the automaton of the whole is not built."""


@dataclass(frozen=True, eq=False)
class Group:
    """Agents whose task is independent of that of the others.

    Parameters
    ----------
    agents : tuple of int
        Positions in the problem, increasing.
    formula : Formula
        Conjunction of what the task says about them, families written out.
    automaton : Automaton
        Its automaton over the propositions of these agents, judged at the horizon.
    """

    agents: tuple[int, ...]
    formula: Formula
    automaton: Automaton


def independent_groups(
    formula: str, semantics: str, names: Sequence[str], families: Mapping[str, Sequence[str]], owners: Sequence[int],
    n_agents: int,
) -> tuple[Group, ...]:  # fmt: skip
    """Groups of agents with independent tasks; none if the automaton of the whole is small, or nothing falls apart.

    Parameters
    ----------
    formula, semantics
        The task.
    names : sequence of str
        Propositions.
    families : mapping
        Members of each family.
    owners : sequence of int
        Agent of each proposition.
    n_agents : int

    Raises
    ------
    FormulaError
        If the formula cannot be read.
    """
    whole = parse_formula(formula)
    owner = dict(zip(names, owners, strict=True))
    parts = _conjuncts(whole, families, True)
    if len(parts) < 2:
        return ()
    NormalForm(names, families, semantics == "co-safe").read(whole)  # errors point at the formula as it was written
    gathered: dict[tuple[int, ...], list[Formula]] = {}
    for part, own in zip(parts, _united([_agents_of(part, families, owner) for part in parts]), strict=True):
        gathered.setdefault(own, []).append(part)
    if len(gathered) < 2 or () in gathered:
        return ()
    for i in set(range(n_agents)).difference(*gathered):
        gathered[i,] = [Formula("true")]
    named: list[list[str]] = [[] for _ in range(n_agents)]
    for name in names:
        named[owner[name]].append(name)
    groups, states, known = [], 1, dict[str, Automaton]()
    for own, mine in sorted(gathered.items()):
        joined = _renamed(mine[0] if len(mine) == 1 else Formula("&", tuple(mine)), {n: n for n in names}, families)
        automaton = _automaton(joined, semantics, [name for i in own for name in named[i]], known)
        groups.append(Group(own, joined, replace(automaton, semantics="finite-trace")))
        states = min(states * int((~automaton.dead).sum()), MOST_STATES + 1)
    return tuple(groups) if states > MOST_STATES else ()


def _conjuncts(formula: Formula, families: Mapping[str, Sequence[str]], positive: bool) -> list[Formula]:
    """Formulas whose conjunction is the formula, or its negation; none for true."""
    operator, operands = formula.operator, formula.operands
    if operator == "!":
        return _conjuncts(operands[0], families, not positive)
    if operator == ("true" if positive else "false"):
        return []
    if operator == ("&" if positive else "|"):
        return [part for operand in operands for part in _conjuncts(operand, families, positive)]
    if operator == ("all" if positive else "any"):
        atoms = [Formula("atom", name=name) for name in families.get(formula.name, ())]
        return (atoms if positive else [Formula("!", (atom,)) for atom in atoms]) or [formula]
    if operator == "->" and not positive:
        return _conjuncts(operands[0], families, True) + _conjuncts(operands[1], families, False)
    if operator in (("G", "X", "N") if positive else ("F",)):
        kept = operator if positive else "G"
        parts = _conjuncts(operands[0], families, positive)
        if operator == "X" and not parts:
            return [formula]  # `X true` asks for another letter
        return [Formula(kept, (part,), bounds=formula.bounds) for part in parts]
    return [formula if positive else Formula("!", (formula,))]


def _agents_of(formula: Formula, families: Mapping[str, Sequence[str]], owner: Mapping[str, int]) -> frozenset[int]:
    """Agents that a formula speaks of."""
    found: set[int] = set()
    for part in formula.subformulas():
        if part.operator == "atom" and part.name in owner:
            found.add(owner[part.name])
        elif part.operator in ("all", "any"):
            found.update(owner[name] for name in families.get(part.name, ()))
    return frozenset(found)


def _united(sets: Sequence[frozenset[int]]) -> list[tuple[int, ...]]:
    """For each set, all agents that it is linked to by sets that overlap, increasing."""
    parent: dict[int, int] = {}

    def root(i: int) -> int:
        while parent.setdefault(i, i) != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for own in sets:
        for i in own:
            parent[root(i)] = root(min(own))
    members: dict[int, list[int]] = {}
    for i in sorted(parent):
        members.setdefault(root(i), []).append(i)
    return [tuple(members[root(min(own))]) if own else () for own in sets]


def _automaton(formula: Formula, semantics: str, names: Sequence[str], known: dict[str, Automaton]) -> Automaton:
    """Automaton of a group; groups whose tasks read alike share the work."""
    places = {name: f"p{k}" for k, name in enumerate(names)}
    text = str(_renamed(formula, places, {}))
    key = f"{len(names)} {text}"
    if key not in known:
        known[key] = translate(text, list(places.values()), semantics)
    return replace(known[key], propositions=tuple(names))


def _renamed(formula: Formula, places: Mapping[str, str], families: Mapping[str, Sequence[str]]) -> Formula:
    """The formula with its propositions renamed and families written out."""
    if formula.operator == "atom":
        return Formula("atom", name=places[formula.name])
    if formula.operator in ("all", "any"):
        atoms = tuple(Formula("atom", name=places[name]) for name in families[formula.name])
        return atoms[0] if len(atoms) == 1 else Formula("&" if formula.operator == "all" else "|", atoms)
    operands = tuple(_renamed(operand, places, families) for operand in formula.operands)
    return Formula(formula.operator, operands, formula.name, formula.bounds)
