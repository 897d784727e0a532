"""How results fit a terminal: lines that are too long are broken where they can be read, and words have colours."""

from __future__ import annotations

import re
import shutil
import sys
import textwrap

from .colors import LABEL_WIDTH, colored, wants_colors

_LABELLED = re.compile(rf"(?=.{{{LABEL_WIDTH - 1}}} \S)[a-z][a-z ]*\s+\S")
_GAP = re.compile(r"(?<=\S)\s{2,}(?=\S)")
_NUMBERS = re.compile(r"[\[(][-+\d.,e\s\[\]()]*[\])]")
_KEPT = "\N{NO-BREAK SPACE}"
_INDENT = 4
"""Blanks before what goes on in the next line."""


def on_terminal(text: str) -> str:
    """Return a text as it is printed: as it is, but on a terminal no wider than that, and with colours."""
    if sys.stdout.isatty():
        text = fitted(text, shutil.get_terminal_size().columns)
    return colored(text) if wants_colors() else text


def fitted(text: str, width: int) -> str:
    """Return a text whose lines are not longer than a terminal is wide; what is short stays as it is.

    Examples
    --------
    >>> print(fitted("tried         path: not computed, as there is more", 34))
    tried         path: not computed,
                  as there is more
    >>> print(fitted("meeting-v0  2 agents  !any(pillar) U all(cafe)", 34))
    meeting-v0  2 agents
        !any(pillar) U all(cafe)
    """
    return "\n".join(part for line in text.splitlines() for part in _broken(line, max(width, 2 * LABEL_WIDTH)))


def _broken(line: str, width: int) -> list[str]:
    """Return one line as lines that fit."""
    if len(line) <= width:
        return [line]
    if _LABELLED.match(line):
        return _wrapped(line, width, LABEL_WIDTH)
    # What stands last in a row of a table goes into lines of its own.
    gaps = list(_GAP.finditer(line))
    begin = len(line) - len(line.lstrip())
    if gaps:
        last = gaps[-1]
        rest = _wrapped(" " * (begin + _INDENT) + line[last.end() :], width, begin + _INDENT)
        return [*_broken(line[: last.start()], width), *rest]
    return _wrapped(line, width, begin + _INDENT)


def _wrapped(line: str, width: int, indent: int) -> list[str]:
    """Return a line in pieces; vectors and matrices that fit into a line stay in one."""

    def kept(found: re.Match[str]) -> str:
        return found[0].replace(" ", _KEPT) if len(found[0]) <= width - indent else found[0]

    whole = _NUMBERS.sub(kept, line)
    pieces = textwrap.wrap(whole, width, subsequent_indent=" " * indent, break_on_hyphens=False)
    return [piece.replace(_KEPT, " ") for piece in pieces] or [line]
