"""Tasks that decompose: conjunctions whose conjuncts concern different agents.

Noise and policies of different agents are independent. If a formula is a conjunction of formulas over disjoint groups
of agents, then the outcomes of the groups are independent, too, and the probability of the whole is the **product** of
theirs. The automaton of the whole would need as many states as there are combinations of the groups' states (fifty
pairs that have to meet: 2^50); the automata of the groups stay small.

Conjuncts are collected below ``&``, ``all``, ``G``, ``G[a,b]``, ``X`` and ``N``, and below the negations of ``|``,
``any``, ``->``, ``F`` and ``F[a,b]``: all of these distribute over conjunction. An agent that appears in no conjunct
has to stay in its workspace, and forms a group by itself.

A co-safe task of the whole is satisfied at the step at which the last group accepts. Until then every agent has to
stay in its workspace, even the agents of groups that have accepted already. So a group of a co-safe task is judged at
the horizon, like one of a finite trace: it has to be accepted, and its agents have to stay in the workspace to the end.
That asks for at least as much as the whole does, so lower bounds stay lower bounds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from ...systems.arguments import counted
from ..automata import Automaton, AutomatonSizeError, Formula, NormalForm, parse_formula, translate

MOST_STATES = 1000
"""Largest product of the groups' numbers of states up to which the automaton of the whole is built.

Above it the joint automaton soon exceeds what the translator builds (`translate`, `max_states`).
"""

MOST_OF_TRACES = 64
"""The same for tasks that are judged at the horizon, of which the product is exact: every further group of two states
doubles the terms of one task. Smaller ones stay together: environments, values and learners are those of one task."""


MOST_NODES = 200_000
"""Most nodes of diagrams from which the automaton of a task that cannot be taken apart is built: about a second."""


@dataclass(frozen=True, eq=False, repr=False)
class Group:
    """Agents whose task is independent of the tasks of all other agents.

    Parameters
    ----------
    agents : tuple of int
        Positions in the problem, increasing.
    formula : Formula
        Conjunction of the conjuncts that concern these agents, with families written out.
    automaton : Automaton
        Its automaton over the propositions of these agents, judged at the horizon.
    """

    agents: tuple[int, ...]
    formula: Formula
    automaton: Automaton

    def __repr__(self) -> str:
        return f"Group({counted(len(self.agents), 'agent')}, {self.automaton!r})"


def independent_groups(
    formula: str,
    semantics: str,
    names: Sequence[str],
    families: Mapping[str, Sequence[str]],
    owners: Sequence[frozenset[int]],
    n_agents: int,
    *,
    always: bool = False,
) -> tuple[Group, ...]:
    """Return the groups of agents with independent tasks; none if the task is one, or its automaton is small anyway.

    Parameters
    ----------
    formula, semantics
        The task.
    names : sequence of str
        Propositions.
    families : mapping
        Members of each family.
    owners : sequence of frozenset of int
        Agents of each proposition: those of a pair have to stay in one group.
    n_agents : int
    always : bool
        Whether they are asked for also where the automaton of the whole is small.

    Raises
    ------
    FormulaError
        If the formula cannot be read.
    """
    whole = parse_formula(formula)
    owner = dict(zip(names, owners, strict=True))
    conjuncts = _conjuncts(whole, families, True)
    if len(conjuncts) < 2:
        return ()
    NormalForm(names, families, semantics == "co-safe").read(whole)  # errors point at the formula as it was written
    # Collect the conjuncts by the agents that they link; a conjunct about no agent belongs to the whole.
    linked = _united([_agents_of(conjunct, families, owner) for conjunct in conjuncts])
    gathered: dict[tuple[int, ...], list[Formula]] = {}
    for conjunct, agents in zip(conjuncts, linked, strict=True):
        gathered.setdefault(agents, []).append(conjunct)
    if len(gathered) < 2 or () in gathered:
        return ()
    for i in set(range(n_agents)).difference(*gathered):
        gathered[i,] = [Formula("true")]
    groups = _translated_groups(gathered, semantics, names, families, owner)
    # The dead states of a group are one in the automaton of the whole: they do not multiply.
    states = 1
    for group in groups:
        states = min(states * int((~group.automaton.dead).sum()), MOST_STATES + 1)
    most = MOST_STATES if semantics == "co-safe" else min(MOST_STATES, MOST_OF_TRACES)
    return tuple(groups) if always or states > most else ()


def joint_automaton(
    formula: str, semantics: str, names: Sequence[str], families: Mapping[str, Sequence[str]]
) -> Automaton | None:
    """Return the automaton of a task whose groups are coupled, if it is small after all; None if it is not.

    The product of the groups' states is the number of states only if no two of them always move together: windows that
    open and close at the same times are counted once. So the automaton is built, up to ``MOST_STATES`` states before
    they are united and ``MOST_NODES`` nodes, which counts what is built and not seconds.
    """
    try:
        return translate(formula, names, semantics, families, max_states=MOST_STATES, max_nodes=MOST_NODES)
    except AutomatonSizeError:
        return None


def _translated_groups(
    gathered: Mapping[tuple[int, ...], list[Formula]],
    semantics: str,
    names: Sequence[str],
    families: Mapping[str, Sequence[str]],
    owner: Mapping[str, frozenset[int]],
) -> list[Group]:
    """Return the groups with their automata, by their first agents."""
    # A pair of agents of two groups is in none of the conjuncts: no group reads it.
    group_of = {i: agents for agents in gathered for i in agents}
    names_of: dict[tuple[int, ...], list[str]] = {}
    for name in names:
        if len(of_name := {group_of[i] for i in owner[name]}) == 1:
            names_of.setdefault(of_name.pop(), []).append(name)
    groups, translated = [], dict[str, Automaton]()
    for agents, conjuncts in sorted(gathered.items()):
        joined = conjuncts[0] if len(conjuncts) == 1 else Formula("&", tuple(conjuncts))
        joined = _renamed(joined, {name: name for name in names}, families)
        group_names = names_of.get(agents, [])
        automaton = _automaton(joined, semantics, group_names, translated)
        groups.append(Group(agents, joined, replace(automaton, semantics="finite-trace")))
    return groups


def _conjuncts(formula: Formula, families: Mapping[str, Sequence[str]], positive: bool) -> list[Formula]:
    """Return formulas whose conjunction is the formula, or its negation; no formula at all for true."""
    operator, operands = formula.operator, formula.operands
    if operator == "!":
        return _conjuncts(operands[0], families, not positive)
    if operator == ("true" if positive else "false"):
        return []
    if operator == ("&" if positive else "|"):
        return [conjunct for operand in operands for conjunct in _conjuncts(operand, families, positive)]
    if operator == ("all" if positive else "any"):
        atoms = [Formula("atom", name=name) for name in families.get(formula.name, ())]
        return (atoms if positive else [Formula("!", (atom,)) for atom in atoms]) or [formula]
    if operator == "->" and not positive:
        return _conjuncts(operands[0], families, True) + _conjuncts(operands[1], families, False)
    # G, X and N distribute over conjunction; a negated F is a G of the negation.
    if operator in (("G", "X", "N") if positive else ("F",)):
        outer = operator if positive else "G"
        conjuncts = _conjuncts(operands[0], families, positive)
        if operator == "X" and not conjuncts:
            return [formula]  # `X true` asks for another letter
        return [Formula(outer, (conjunct,), bounds=formula.bounds) for conjunct in conjuncts]
    return [formula if positive else Formula("!", (formula,))]


def _agents_of(
    formula: Formula, families: Mapping[str, Sequence[str]], owner: Mapping[str, frozenset[int]]
) -> frozenset[int]:
    """Return the agents whose propositions appear in a formula."""
    agents: set[int] = set()
    for subformula in formula.subformulas():
        if subformula.operator == "atom" and subformula.name in owner:
            agents.update(owner[subformula.name])
        elif subformula.operator in ("all", "any"):
            agents.update(i for name in families.get(subformula.name, ()) for i in owner[name])
    return frozenset(agents)


def _united(sets: Sequence[frozenset[int]]) -> list[tuple[int, ...]]:
    """Return, for each set, all agents that it is linked to by sets that overlap, increasing."""
    # Union-find: every agent points towards the root of its group; paths are halved on the way.
    parent: dict[int, int] = {}

    def root(i: int) -> int:
        while parent.setdefault(i, i) != i:
            parent[i] = parent[parent[i]]
            i = parent[i]
        return i

    for agents in sets:
        for i in agents:
            parent[root(i)] = root(min(agents))
    members: dict[int, list[int]] = {}
    for i in sorted(parent):
        members.setdefault(root(i), []).append(i)
    return [tuple(members[root(min(agents))]) if agents else () for agents in sets]


def _automaton(formula: Formula, semantics: str, names: Sequence[str], translated: dict[str, Automaton]) -> Automaton:
    """Return the automaton of a group; groups whose tasks read alike share the work."""
    # Number the propositions, so that fifty pairs with one task are translated once.
    places = {name: f"p{k}" for k, name in enumerate(names)}
    text = str(_renamed(formula, places, {}))
    key = f"{len(names)} {text}"
    if key not in translated:
        translated[key] = translate(text, list(places.values()), semantics)
    return replace(translated[key], propositions=tuple(names))


def _renamed(formula: Formula, places: Mapping[str, str], families: Mapping[str, Sequence[str]]) -> Formula:
    """Return the formula with its propositions renamed and families written out."""
    if formula.operator == "atom":
        return Formula("atom", name=places[formula.name])
    if formula.operator in ("all", "any"):
        atoms = tuple(Formula("atom", name=places[name]) for name in families[formula.name])
        return atoms[0] if len(atoms) == 1 else Formula("&" if formula.operator == "all" else "|", atoms)
    operands = tuple(_renamed(operand, places, families) for operand in formula.operands)
    return Formula(formula.operator, operands, formula.name, formula.bounds)
