"""What certificates offer to those who ask for more than their bound, and what is said where one of them does not."""

from __future__ import annotations

from enum import Enum
from typing import Any


class Offer(Enum):
    """What may be asked of a certificate; the text says what was expected where it lacks that."""

    VALUES = "one with values of all states"
    """Values at every state, automaton state and time: shields, audits, fields, figures, menus."""
    OWN_STATES = "one whose agents each look at their own state"
    """Cells of every agent by itself: figures of an agent."""


def require(certificate: Any, *offers: Offer) -> None:
    """Raise ValueError, with what can be done instead, unless a certificate and its members offer all of this."""
    for offer in offers:
        for member in certificate.members:
            if offer in member.lacks:
                raise ValueError(f"`certificate`: expected {offer.value}, got {member.lacks[offer]}")
