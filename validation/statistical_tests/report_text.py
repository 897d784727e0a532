"""How reports print themselves: labelled lines for people, small tables for notebooks."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from ...envs.systems.arguments import write_json

LABEL_WIDTH = 14
"""Characters before the text of a line: the longest label, "these models", and two blanks."""

INTERRUPTED = "by Ctrl-C; this is about the episodes finished by then"
"""What a report that is marked ``interrupted`` says of itself."""

Rows = Sequence[tuple[str, str]]
"""Label and text of each line of a report."""


class Saved(ABC):
    """A report that can be written to a file."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON values."""

    def save(self, path: str | Path) -> None:
        """Write ``to_dict()`` as JSON."""
        write_json(path, self.to_dict())


def labelled_lines(rows: Rows) -> str:
    """Return one line per row: its label, padded to a fixed width, and its text.

    Examples
    --------
    >>> print(labelled_lines([("certified", "P >= 0.9"), ("verdict", "consistent")]))
    certified     P >= 0.9
    verdict       consistent
    """
    return "\n".join(f"{label:<{LABEL_WIDTH}}{text}" for label, text in rows)


def html_table(title: str, rows: Sequence[Sequence[str]], head: Sequence[str] = ()) -> str:
    """Return a table for notebooks, the first cell of each row as its heading and every text escaped.

    Examples
    --------
    >>> print(html_table("a < b", [("verdict", "consistent")]))
    <table>
    <caption>a &lt; b</caption>
    <tr><th>verdict</th><td>consistent</td></tr>
    </table>
    """
    lines = ["<table>", f"<caption>{escape(title)}</caption>"]
    if head:
        lines.append(f"<tr>{''.join(f'<th>{escape(cell)}</th>' for cell in head)}</tr>")
    for label, *cells in rows:
        lines.append(f"<tr><th>{escape(label)}</th>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>")
    return "\n".join([*lines, "</table>"])
