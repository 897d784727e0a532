"""Certificates that stand: checked once, before a guaranteed number is computed from what they hold.

A file says what it likes of relations, guards and lattices. A verb that makes another guarantee out of them (a rate, a
shield, values in the middle of a run) asks here first, and so does whoever prints a bound. Verbs that *test* a
claim (``validate``, ``audit``) take it as it is: a false one is what they look for.
"""

from __future__ import annotations

from typing import TypeVar
from weakref import WeakKeyDictionary

from ...certificates.proofs import Certificate, CheckReport, shown_bound, told_claim
from .certificate_check import check

Claimed = TypeVar("Claimed", bound=Certificate)

_reports: WeakKeyDictionary[object, CheckReport] = WeakKeyDictionary()
"""What ``check`` said of certificates, which never change: it is asked once for each."""


def checked_once(certificate: Certificate) -> CheckReport:
    """Return what ``check`` says of a certificate, against the problem inside it; it is asked once."""
    if certificate not in _reports:
        _reports[certificate] = check(certificate)
    return _reports[certificate]


def claim_text(certificate: Certificate) -> str:
    """Return the lower bound of a certificate in words, called a claim if ``check``, asked once, refuses it."""
    return told_claim(shown_bound(certificate.lower_bound, None), checked_once(certificate))


def standing(certificate: Claimed) -> Claimed:
    """Return a certificate that ``check`` verifies, against the problem inside it; it is checked once.

    Raises
    ------
    ValueError
        If ``check`` refuses it; the text says why.
    """
    wrong = checked_once(certificate).failures
    if wrong:
        raise ValueError(
            f"`certificate`: expected one that `check` verifies, got one that it refuses: {wrong[0]}; make it anew"
        )
    return certificate
