"""Write the table of what cannot be asked of which certificate, and why, into the page of limits.

`python docs/limits_table.py`; the table is that of `tests/claims/test_everything_composes.py`, whose tests ask
everything.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "limits.md"
FIRST, LAST = "<!-- what cannot be -->", "<!-- the end of what cannot be -->"


def table(cannot: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a row for each reason: what is asked, of which certificates, and why it cannot be."""
    rows: dict[tuple[str, tuple[str, ...]], list[str]] = {}
    for column, reasons in cannot.items():
        of_reason: dict[str, list[str]] = {}
        for row, reason in reasons.items():
            of_reason.setdefault(reason.why, []).append(row)
        for why, names in of_reason.items():
            rows.setdefault((why, tuple(names)), []).append(column)
    lines = ["| asked | of | why not |", "|---|---|---|"]
    return "\n".join(lines + [f"| {', '.join(asked)} | {', '.join(of)} | {why} |" for (why, of), asked in rows.items()])


def with_table(page: str, text: str) -> str:
    """Return the page with a table between its marks."""
    before, rest = page.split(FIRST)
    return f"{before}{FIRST}\n\n{text}\n\n{LAST}{rest.split(LAST)[1]}"


def main() -> None:
    """Write the table into the page."""
    sys.path[:0] = [str(ROOT / folder) for folder in ("tests", "tests/claims", "tests/oracle")]
    from test_everything_composes import CANNOT

    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), table(CANNOT)), encoding="utf-8")


if __name__ == "__main__":
    main()
