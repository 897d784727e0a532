"""What is certified of a policy as it is, in a number or in a word: for tables of many policies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ...envs.suite import as_problem
from ..certificates.proofs import shown_bound
from ..interop import TeamModels, as_policy
from ..relations.grids import NoRunFound
from .certify import certify, is_certified_as_given

WORDS = {
    "memory": "the policy remembers earlier observations",
    "neighbours": "it sees the nearest other agents, which change places",
    "layers": "it is no network that can be read, nor expressions",
    "off course": "its run without noise does not satisfy the task",
    "wide tube": "noise moves it farther than its bends allow to prove",
}
"""Reasons why nothing is certified of a policy as it is."""


@dataclass(frozen=True)
class AsItIs:
    """A certified lower bound for a policy as it is, or why there is none.

    Parameters
    ----------
    bound : float or None
        Lower bound on the satisfaction probability; None where nothing is certified.
    word : str
        One of ``WORDS`` then.
    why : str
        What `certify` says.
    """

    bound: float | None
    word: str = ""
    why: str = ""

    def __str__(self) -> str:
        return self.word if self.bound is None else shown_bound(self.bound, None)


def as_it_is(problem: Any, policy: Any, env: Any = None) -> AsItIs:
    """Return what is certified of a policy as it is, without options: along its run, or on cells of few states.

    Parameters
    ----------
    problem : Problem, id or path
    policy : whatever `as_policy` takes
    env : environment or str, optional
        In which it was trained, as for `as_policy`.
    """
    given = as_problem(problem)
    brought = as_policy(policy, given, env)
    if not is_certified_as_given(brought, None):
        why = str(getattr(brought, "why_not_as_it_is", "") or WORDS["layers"])
        words = {"memory": "remembers", "neighbours": "nearest"} if isinstance(brought, TeamModels) else {}
        return AsItIs(None, next((word for word, part in words.items() if part in why), "layers"), why)
    try:
        return AsItIs(certify(given, brought).certificate.lower_bound)
    except NoRunFound as refused:
        return AsItIs(None, "off course", str(refused))
    except ValueError as refused:
        return AsItIs(None, "wide tube", str(refused))
