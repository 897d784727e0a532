"""What the task asks of each proposition: whether it is to be reached, avoided or kept. The automaton knows.

A proposition *helps* in a state if, all others equal, letting it hold leads to a state from which strictly more words
are accepted, and *hurts* if strictly fewer are. What only hurts is avoided. What helps is reached, unless it only saves
from failure while the task stays where it is: that is kept. What helps at one place and hurts at another is both. What
hurts only while another one does, such as p and q in ``G !(p & q)``, is for one at a time. All this
is about letters that points of the workspace have; where none of them tells the role of a proposition, since its region
borders on others on all sides, it is about all letters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache, partial
from itertools import chain
from types import MappingProxyType

from ..tasks.automata import Automaton, DecisionDiagrams, DiagramSizeError
from ..tasks.problem import Problem
from .guard_texts import possible_letters
from .outlines import terms_of

REACHED, AVOIDED, KEPT, MIXED, FREE, SHARED = "reached", "avoided", "kept", "mixed", "free", "shared"
"""The roles: to be reached, avoided, kept; one now and another then; not asked about; for one agent at a time."""

_MOST_PAIRS = 3000
"""Pairs of states whose words are compared at most; beyond, states are told apart as lost, undecided and won alone."""

_MOST_WORK = 40_000
"""States times propositions up to which every pair of both is looked at: a second or two."""

_TURNED = {REACHED: AVOIDED, AVOIDED: KEPT, KEPT: AVOIDED, MIXED: MIXED, FREE: FREE, SHARED: MIXED}
"""Roles of what a region is the complement of, as roles of the region."""

Pairs = frozenset[tuple[int, int]]
"""Pairs of states that two functions of one letter lead to."""


@lru_cache(maxsize=16)
def roles(problem: Problem) -> Mapping[str, str]:
    """Return the role of each proposition, and of each family whose members agree or are told apart as ``mixed``.

    Propositions of automata that are too large to be looked at are ``free``.
    """
    of_tasks: dict[str, str] = {}
    for task in problem.tasks:
        of_tasks |= proposition_roles(task.automaton, partial(possible_letters, task))
    found = {name: of_tasks.get(name, FREE) for name in problem.propositions}
    for name, meaning in problem.meanings.items():
        found[name] = joined(
            found[part] if sign else _TURNED[found[part]] for sign, part in {*chain(*terms_of(meaning, True))}
        )
    for family, names in problem.families.items():
        found[family] = joined(found[name] for name in names)
    return MappingProxyType(found)


def joined(roles_of_members: Iterable[str]) -> str:
    """Return the role of propositions that are drawn as one.

    Examples
    --------
    >>> joined([REACHED, FREE]), joined([REACHED, KEPT]), joined([AVOIDED, KEPT])
    ('reached', 'reached', 'mixed')
    """
    told = set(roles_of_members) - {FREE} or {FREE}
    if told == {REACHED, KEPT}:
        return REACHED
    return told.pop() if len(told) == 1 else MIXED


def proposition_roles(
    automaton: Automaton, possible: Callable[[DecisionDiagrams], int] | None = None
) -> dict[str, str]:
    """Return the role of each proposition of an automaton.

    Parameters
    ----------
    automaton : Automaton
    possible : callable, optional
        Makes the Boolean function of the letters that there are, in the diagrams that it is given; default: all.

    Examples
    --------
    >>> from certigym.envs.tasks.automata import translate
    >>> proposition_roles(translate("!wall U goal", ["wall", "goal"], "co-safe"))
    {'wall': 'avoided', 'goal': 'reached'}
    """
    names = automaton.propositions
    if automaton.n_states * len(names) > _MOST_WORK:
        return dict.fromkeys(names, FREE)
    try:
        reading = _Reading(automaton)
        found = reading.roles(None)
        told = found if possible is None else reading.roles(possible(reading.manager))
    except DiagramSizeError:
        return dict.fromkeys(names, FREE)
    return {name: found[name] if told[name] == FREE else told[name] for name in names}


class _Reading:
    """An automaton whose states are compared by the words that they accept."""

    def __init__(self, automaton: Automaton) -> None:
        self._automaton = automaton
        self.manager, self._roots = automaton.diagrams()
        self._targets = [set(self.manager.leaves(root)) for root in self._roots]
        self._codes: dict[tuple[int, int], int] = {}
        self._reach = [self._from(q) for q in range(automaton.n_states)]
        self._lacking: dict[tuple[int, int], bool] = {}

    def roles(self, possible: int | None) -> dict[str, str]:
        """Return the role of each proposition, over the letters of a Boolean function, or over all of them."""
        automaton = self._automaton
        live = [q for q in sorted(self._reach[automaton.initial]) if not automaton.absorbing[q]]
        # What changes if one proposition holds: pairs of states, without it and with it.
        changes = {p: dict(self._changes(p, live, possible)) for p in range(len(automaton.propositions))}
        told = {pair for of_state in changes.values() for pairs in of_state.values() for pair in pairs}
        self._compare(told, possible)
        found = {name: self._role(changes[p]) for p, name in enumerate(automaton.propositions)}
        avoided = [p for p, name in enumerate(automaton.propositions) if found[name] == AVOIDED]
        for p in avoided if len(avoided) > 1 else ():
            # Does it hurt while no other one that is avoided holds?
            others = [self.manager.literal(other, False) for other in avoided if other != p]
            alone = self.manager.conjoin_all([*others, *([] if possible is None else [possible])])
            if self._role(dict(self._changes(p, live, alone))) == FREE:
                found[automaton.propositions[p]] = SHARED
        return found

    def _role(self, changes: dict[int, Pairs]) -> str:
        """Return the role of a proposition from the pairs of states that it decides between, by state."""
        helps = hurts = saves = stays = False
        for q, pairs in changes.items():
            for without, holding in pairs:
                # Words that one accepts and the other does not: both may be true of states that cannot be compared.
                if self._lacking[holding, without]:
                    hurts = True
                if self._lacking[without, holding]:
                    saved = bool(self._automaton.dead[without])
                    helps, saves = helps or not saved, saves or saved
                    stays = stays or (saved and q in self._reach[holding])
        if hurts:
            return MIXED if helps or saves else AVOIDED
        if saves and stays and not helps:
            return KEPT
        return REACHED if helps or saves else FREE

    def _changes(self, p: int, live: list[int], possible: int | None) -> Iterator[tuple[int, Pairs]]:
        """Yield for each state in which a proposition matters the pairs of states without it and with it."""
        manager = self.manager
        # Both letters have to be possible, the one with the proposition and the one without it.
        there = None if possible is None else manager.conjoin_all(_cofactors(manager, possible, p))
        for q in live:
            root = self._roots[q]
            if p in manager.support(root):
                pairs = self._pairs(*_cofactors(manager, root, p), there)
                yield q, frozenset(pair for pair in pairs if pair[0] != pair[1])

    def _pairs(self, f: int, g: int, there: int | None = None) -> Pairs:
        """Return the pairs of states to which two functions lead on a common letter, one of some letters if given."""
        n = self._automaton.n_states
        both = self.manager.apply(lambda a, b: a * n + b, f, g, self._codes)
        if there is not None:
            both = self.manager.apply(lambda code, holds: code if holds else -1, both, there, {})
        return frozenset(divmod(code, n) for code in self.manager.leaves(both) if code >= 0)

    def _from(self, q: int) -> set[int]:
        """Return the states that can be reached from one, itself included."""
        found, waiting = {q}, [q]
        while waiting:
            new = self._targets[waiting.pop()] - found
            found |= new
            waiting += new
        return found

    def _compare(self, wanted: set[tuple[int, int]], possible: int | None) -> None:
        """Note for pairs of states, and the same pairs turned round, whether the second accepts a word more.

        Words consist of possible letters alone.
        """
        wanted = wanted | {(b, a) for a, b in wanted}
        following: dict[tuple[int, int], Pairs] = {}
        waiting = list(wanted)
        while waiting and len(following) <= _MOST_PAIRS:
            pair = waiting.pop()
            if pair not in following:
                following[pair] = self._pairs(self._roots[pair[0]], self._roots[pair[1]], possible)
                waiting += [after for after in following[pair] if after[0] != after[1]]
        if waiting:
            self._lacking = {pair: self._rank(pair[0]) < self._rank(pair[1]) for pair in wanted}
            return
        # The second accepts a word more if it accepts now and the first does not, or after some letter.
        accepting = self._automaton.accepting
        lacking = {(a, b): bool(accepting[b] and not accepting[a]) for a, b in following}
        changed = True
        while changed:
            changed = False
            for pair, after in following.items():
                if not lacking[pair] and any(lacking.get(other, False) for other in after):
                    lacking[pair] = changed = True
        self._lacking = lacking

    def _rank(self, q: int) -> int:
        """Return 0 for a state that is lost, 2 for one that has won, 1 for the others."""
        return 0 if self._automaton.dead[q] else 2 if self._automaton.finished[q] else 1


def _cofactors(manager: DecisionDiagrams, f: int, p: int) -> tuple[int, int]:
    """Return what remains of a function if a proposition fails, and if it holds."""
    return manager.restrict(f, {p: False}), manager.restrict(f, {p: True})
