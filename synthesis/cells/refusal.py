"""The one way to say that a relation does not apply, told apart from mistakes of the caller."""

from __future__ import annotations


class RelationRefused(ValueError):
    """No relation of the kind that was asked for ties this agent to these cells; the text says what to try.

    A search over relations or cells catches it and continues; other errors are mistakes of the caller and end it.
    """
