"""Colours of reports on a terminal."""

from __future__ import annotations

import os
import re
import sys

LABEL_WIDTH = 14
"""Columns of a label: those of reports (``validation.simulation``), which are not loaded for a number."""

_GREEN, _RED, _CYAN, _YELLOW, _BOLD, _FAINT = 32, 31, 36, 33, 1, 2

_WORDS = {
    "confirmed": _GREEN,
    "valid": _GREEN,
    "consistent": _CYAN,
    "vacuous": _YELLOW,
    "refuted": _RED,
    "invalid": _RED,
    "failed": _RED,
}
"""Words of verdicts and their colours."""

_LABEL = re.compile(rf"(?=.{{{LABEL_WIDTH}}}\S)(?P<label>[a-z ]{{{LABEL_WIDTH - 1}}} )")
"""A label at the beginning of a line, padded to its width."""


def wants_colors() -> bool:
    """Return whether standard output is a terminal that shows colours (https://no-color.org)."""
    return sys.stdout.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def colored(text: str) -> str:
    """Return a report with faint labels, a strong claim, and the word of each verdict in its colour."""
    return "\n".join(_line(line) for line in text.splitlines())


def _line(line: str) -> str:
    """Return one line of a report with colours."""
    if proved := re.match(r"PROVED P >= \S+", line):
        return _painted(proved[0], _BOLD) + line[proved.end() :]
    label = _LABEL.match(line)
    if label is None or not label[0].strip():
        return re.sub(r"(?<=: )(valid|invalid)(?=:)", lambda m: _painted(m[0], _WORDS[m[0]]), line)
    rest = line[label.end() :]
    if label[0].strip() == "invalid":
        return _painted(line, _RED)
    if label[0].strip() == "certified":
        rest = _painted(rest, _BOLD)
    elif (first := re.match(r"\w+", rest)) and first[0] in _WORDS:
        rest = _painted(first[0], _WORDS[first[0]]) + rest[first.end() :]
    return _painted(label[0], _FAINT) + rest


def _painted(text: str, color: int) -> str:
    return f"\033[{color}m{text}\033[0m"
