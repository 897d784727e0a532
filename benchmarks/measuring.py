"""CPU time, tables and JSON for the scripts of this folder."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
Row = dict[str, Any]
Rows = list[Row]


def once(work: Callable[[], T]) -> tuple[float, T]:
    """Return the CPU seconds of a single call, and what it returned."""
    began = time.process_time()
    result = work()
    return time.process_time() - began, result


def show(title: str, rows: Rows) -> None:
    """Print rows as a table under their keys."""
    print(f"\n{title}")
    if not rows:
        return
    heads = list(rows[0])
    cells = [[_shown(row.get(key)) for key in heads] for row in rows]
    widths = [max(len(head), *(len(line[k]) for line in cells)) for k, head in enumerate(heads)]
    for line in [heads, *cells]:
        print("  " + "  ".join(text.rjust(width) for text, width in zip(line, widths)), flush=True)


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    return "" if value is None else str(value)


def save(results: dict[str, Any], path: str | None) -> None:
    """Write results as JSON if a path is given."""
    if path:
        Path(path).write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
