"""Certificates that stand: checked once, before a guaranteed number is computed from what they hold.

A file says what it likes of relations, guards and lattices. A verb that makes another guarantee out of them (a rate, a
shield, menus, values in the middle of a run) asks here first. Verbs that *test* a claim (``validate``, ``audit``) take
it as it is: a false one is what they look for.
"""

from __future__ import annotations

from typing import TypeVar
from weakref import WeakKeyDictionary

from ..certificates import Certificate
from .certificate_check import check

Claimed = TypeVar("Claimed", bound=Certificate)

_failures: WeakKeyDictionary[object, tuple[str, ...]] = WeakKeyDictionary()
"""What ``check`` found wrong with certificates, which never change: it is asked once for each."""


def standing(certificate: Claimed) -> Claimed:
    """Return a certificate that ``check`` verifies, against the problem inside it; it is checked once.

    Raises
    ------
    ValueError
        If ``check`` refuses it; the text says why.
    """
    if certificate not in _failures:
        _failures[certificate] = check(certificate).failures
    wrong = _failures[certificate]
    if wrong:
        raise ValueError(
            f"`certificate`: expected one that `check` verifies, got one that it refuses: {wrong[0]}; make it anew"
        )
    return certificate
