"""Where in a text of TOML the mistake stands of which an error speaks: the caret of the command line, in the file."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from .toml_spans import Path, Places, places

_AT_LINE = re.compile(r"\(at line (\d+), column (\d+)\)")
_CHARACTER = re.compile(r"\(character (\d+) of the formula\)")
_AGENT = re.compile(r"\[\[agents\]\] number (\d+)")
_NAMED_AGENT = re.compile(r"\[agents\.'?([^\]']+)'?\]")
_PROPOSITION = re.compile(r"\[propositions\] '([^']+)'")
_DOTTED_PROPOSITION = re.compile(r"`propositions\.([^`]+)`")
_KEY = re.compile(r"`([A-Za-z_]+)(?:\[(\d+)\])?`")
_UNKNOWN = re.compile(r"unknown key '([^']+)'")

Mark = tuple[int, int]
"""The characters of a mistake, first and behind the last."""


def mark(text: str, message: str) -> Mark | None:
    """Return which characters of a text an error message is about; None if it does not say.

    Examples
    --------
    >>> mark("a = 1\\nb = = 2", "expected TOML, got: Invalid value (at line 2, column 5)")
    (10, 11)
    """
    if not text:
        return None
    found = _AT_LINE.search(message)
    if found:
        lines = text.splitlines(keepends=True)
        at = sum(map(len, lines[: int(found[1]) - 1])) + int(found[2]) - 1
        return (at, at + 1) if at < len(text) else _last(text)
    try:
        data = tomllib.loads(text)
    except (ValueError, RecursionError):
        return _last(text)
    found_places = places(text)
    return (
        _in_formula(text, found_places, message) or _below_a_line(text, message) or _named(data, found_places, message)
    )


def line_and_column(text: str, at: int) -> tuple[int, int]:
    """Return line and column of a character, counted from 1."""
    return text.count("\n", 0, at) + 1, at - text.rfind("\n", 0, at)


def _last(text: str) -> Mark:
    return len(text) - 1, len(text)


def _in_formula(text: str, found: Places, message: str) -> Mark | None:
    """Return the character of the formula that a message counts."""
    number = _CHARACTER.search(message)
    span = found.values.get(("specification", "formula")) or found.values.get(("specification",))
    if number is None or span is None:
        return None
    quotes = 3 if text[span.start : span.start + 3] in ('"""', "'''") else 1
    at = min(span.start + quotes + int(number[1]) - 1, span.end - quotes)
    return at, at + 1


def _below_a_line(text: str, message: str) -> Mark | None:
    """Return what the caret below an expression points to: the expression is looked for in the text."""
    lines = message.split("\n")
    if len(lines) < 3 or lines[-1].strip() != "^":
        return None
    shown = lines[-2].removeprefix("    ")
    column = lines[-1].index("^") - 4
    cut = shown.strip(".")
    begin = text.find(cut) if cut else -1
    if begin < 0:
        return None
    at = begin + max(0, column - shown.index(cut))
    return at, at + 1


def _named(data: Any, found: Places, message: str) -> Mark | None:
    """Return the value, or the key, of the table that a message names."""
    table = _table(data, message)
    unknown = _UNKNOWN.search(message)
    if unknown:
        span = next(
            (s for path, s in found.values.items() if path[-1] == unknown[1] and path[: len(table)] == table), None
        )
        return None if span is None else (span.key, span.key + len(unknown[1]))
    for key in _KEY.finditer(message):
        for base in (table, ()):
            path = (*base, key[1])
            exact = (*path, int(key[2])) if key[2] else path
            span = found.values.get(exact) or found.values.get(path)
            if span is not None:
                return span.start, span.end
    if table in found.values:
        return found.values[table].start, found.values[table].end
    return next(((begin, end) for path, begin, end in found.headings if path == table and table), None)


def _table(data: Any, message: str) -> Path:
    """Return the path of the table that a message names; the text itself if it names none."""
    numbered, named = _AGENT.search(message), _NAMED_AGENT.search(message)
    if numbered:
        agents = data.get("agents")
        position = int(numbered[1]) - 1
        names = list(agents) if isinstance(agents, dict) else []
        return ("agents", names[position] if position < len(names) else position)
    if named:
        return ("agents", named[1])
    proposition = _PROPOSITION.search(message) or _DOTTED_PROPOSITION.search(message)
    if proposition:
        return ("propositions", proposition[1])
    return ("specification",) if "[specification]" in message else ()
