"""Transitions of a task automaton and the letters that take them, as short text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ..tasks.automata import Cube, DecisionDiagrams, DiagramSizeError, cover
from ..tasks.problem import Problem

_MOST_CUBES = 5000
"""Cubes that are made at most on the way to a guard: a fraction of a second."""

_SHOWN_CUBES = 6
"""Cubes that the text of a guard shows: more are no help to a reader."""

NOT_SHOWN = "letters not shown"
"""The guard where letters cannot be told in few words."""


@dataclass(frozen=True)
class Edge:
    """One transition between two states, with its guard as text."""

    source: int
    target: int
    guard: str


def edges(problem: Problem) -> list[Edge]:
    """Return the transitions that a letter of the workspace can take, ordered by source.

    Guards are short covers: letters that no point has count as they are convenient, so that regions which exclude or
    imply each other shorten the text, and families appear by their names. The longest guard of a state reads
    "otherwise".
    """
    automaton = problem.automaton
    manager, roots = automaton.diagrams()
    result = []
    try:
        possible = possible_letters(problem, manager)
    except DiagramSizeError:
        return [Edge(q, target, NOT_SHOWN) for q, root in enumerate(roots) for target in manager.leaves(root)]
    impossible = manager.negate(possible)
    for q, root in enumerate(roots):
        guards: dict[int, list[Cube] | None] = {}
        for target in manager.leaves(root):
            letters = _indicator(manager, root, target)
            taken = manager.conjoin(letters, possible)
            if taken != manager.terminal(0):
                guards[target] = cover(manager, taken, manager.disjoin(letters, impossible), _MOST_CUBES)
        # The target with the longest guard is "otherwise"; a dead one among equals.
        longest = max(guards, key=lambda target: (_size(guards[target]), automaton.dead[target], target))
        for target, cubes in guards.items():
            if target == longest and len(guards) > 1 and (cubes is None or len(cubes) > 1):
                text = "otherwise"
            else:
                text = (
                    NOT_SHOWN
                    if cubes is None
                    else guard_text(cubes, automaton.propositions, problem.families, _written(problem))
                )
            result.append(Edge(q, target, text))
    return result


def possible_letters(problem: Problem, manager: DecisionDiagrams) -> int:
    """Return the function that holds for the letters which every agent can have somewhere in its workspace.

    Where regions move, all letters count as possible: which of them are depends on the time.
    """
    if problem.labeling.moves:
        return manager.conjoin_all([])
    agents, labeling = [], problem.labeling.without_pairs()  # pairs may hold or not, wherever their agents are
    for positions, classes in zip(labeling.agent_propositions, labeling.classes):
        cubes = [
            manager.conjoin_all(manager.literal(int(p), bool(value)) for p, value in zip(positions, row))
            for row in classes
        ]
        agents.append(manager.disjoin_all(cubes))
    return manager.conjoin_all(agents)


def _indicator(manager: DecisionDiagrams, root: int, target: int) -> int:
    """Return the function that holds for the letters which lead to one target."""
    wanted = manager.terminal(target)
    return manager.rebuild(root, manager, lambda n: int(n == wanted) if manager.is_terminal(n) else None, {})


def _size(cubes: list[Cube] | None) -> float:
    """Return how long a guard is: its literals, and infinitely many where it cannot be told."""
    return float("inf") if cubes is None else len(cubes) + sum(map(len, cubes))


def _written(problem: Problem) -> dict[str, str]:
    """Return regions that were written, such as a heading through pi, by the box that is their complement."""
    return {
        meaning.operands[0].name: name
        for name, meaning in problem.meanings.items()
        if meaning.operator == "!" and meaning.operands[0].operator == "atom"
    }


def guard_text(
    cubes: Sequence[Cube],
    propositions: Sequence[str],
    families: Mapping[str, Sequence[str]],
    complements: Mapping[str, str] | None = None,
) -> str:
    """Return a union of cubes as text; families whose members appear alike are named once.

    Propositions in `complements` are the complements of what was written, which is named in their place.

    Examples
    --------
    >>> guard_text([{0: True, 2: True}, {1: True, 2: True}], ["a_0", "a_1", "b"], {"a": ("a_0", "a_1")})
    'any(a) & b'
    >>> guard_text([{0: False, 1: False}], ["west_1", "b"], {}, {"west_1": "west"})
    'west & !b'
    """
    written = complements or {}
    # A factor of a product is a literal or a word about a family: a name, and what is said of it.
    products = [
        frozenset(
            (written.get(name := propositions[p], name), "" if value != (name in written) else "!")
            for p, value in cube.items()
        )
        for cube in cubes
    ]
    propositions = [written.get(name, name) for name in propositions]
    for family, members in families.items():
        if len(members) > 1:
            products = [_all_alike(product, family, members) for product in products]
            for sign, word in (("", "any"), ("!", "!all")):
                products = _one_of(products, {(member, sign) for member in members}, (f"{word}({family})", ""))
    texts = [_product(product, propositions) for product in products[:_SHOWN_CUBES]]
    more = f" or {len(products) - _SHOWN_CUBES} more" if len(products) > _SHOWN_CUBES else ""
    return " or ".join(texts) + more


_Product = frozenset[tuple[str, str]]


def _all_alike(product: _Product, family: str, members: Iterable[str]) -> _Product:
    """Return a product in which one word stands for a family whose members all hold, or all fail."""
    for sign, word in (("", "all"), ("!", "!any")):
        literals = {(member, sign) for member in members}
        if literals <= product:
            return (product - literals) | {(f"{word}({family})", "")}
    return product


def _one_of(products: list[_Product], literals: set[tuple[str, str]], word: tuple[str, str]) -> list[_Product]:
    """Return the products, with one in place of those that differ only in which member of a family they name."""
    result = list(products)
    for product in products:
        for literal in product & literals:
            alike = [(product - {literal}) | {other} for other in literals]
            if all(other in result for other in alike):
                place = min(map(result.index, alike))
                result = [p for p in result if p not in alike]
                result.insert(place, (product - {literal}) | {word})
    return result


def _product(product: _Product, propositions: Sequence[str]) -> str:
    """Return a product as text: families first, then propositions in their order."""
    order = {name: k for k, name in enumerate(propositions)}
    factors = sorted(product, key=lambda factor: (order.get(factor[0], -1), factor[0]))
    return " & ".join(sign + name for name, sign in factors) or "any letter"
