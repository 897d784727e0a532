"""What is certified of a policy as it is, in a number or in a word: for tables of many policies."""

from __future__ import annotations

from dataclasses import dataclass
from multiprocessing import TimeoutError, get_context
from typing import Any

from ...envs.suite import as_problem
from ...envs.tasks.problem import Problem
from ..abstraction.models import Relations
from ..certificates.proofs import shown_bound
from ..interop import TeamModels, as_policy
from ..relations.grids import NoRunFound
from .certify import certify, is_certified_as_given
from .raw_networks import FEW_STATES, PLENTY

WORDS = {
    "memory": "the policy remembers earlier observations",
    "neighbours": "it sees the nearest other agents, which change places",
    "layers": "it is no network that can be read, nor expressions",
    "off course": "its run without noise does not satisfy the task",
    "wide tube": "noise moves it farther than its bends allow to prove",
    "time": "it takes longer than the table waits",
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


def as_it_is(problem: Any, policy: Any, env: Any = None, seconds: float | None = None) -> AsItIs:
    """Return what is certified of a policy as it is, without options: along its run, or on cells of few states.

    Parameters
    ----------
    problem : Problem, id or path
    policy : whatever `as_policy` takes
    env : environment or str, optional
        In which it was trained, as for `as_policy`.
    seconds : float, optional
        Wall-clock time for its run, and again for cells, after which they are given up; default: no limit.
    """
    given = as_problem(problem)
    brought = as_policy(policy, given, env)
    if not is_certified_as_given(brought, None):
        why = str(getattr(brought, "why_not_as_it_is", "") or WORDS["layers"])
        words = {"memory": "remembers", "neighbours": "nearest"} if isinstance(brought, TeamModels) else {}
        return AsItIs(None, next((word for word, part in words.items() if part in why), "layers"), why)
    if seconds is None:
        return _certified(given, brought, "auto")
    found = AsItIs(None, "time", WORDS["time"])
    is_small = all(agent.n_states <= FEW_STATES for agent in given.agents)
    for relation in ("path", "auto")[: 1 + is_small]:
        with get_context("spawn").Pool(1) as pool:  # its process ends with it, whatever it is doing
            try:
                found = pool.apply_async(_certified, (given, brought, relation)).get(seconds)
            except TimeoutError:
                break
        if found.bound is not None and 1.0 - found.bound <= PLENTY:
            break
    return found


def _certified(problem: Problem, policy: Any, relation: Relations) -> AsItIs:
    """Return what is certified of a policy that may be certified as it is."""
    try:
        return AsItIs(certify(problem, policy, relation=relation).certificate.lower_bound)
    except NoRunFound as refused:
        return AsItIs(None, "off course", str(refused))
    except ValueError as refused:
        return AsItIs(None, "wide tube", str(refused))
