"""CPU time, tables and JSON for the scripts of this folder."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")
Row = dict[str, Any]
Rows = list[Row]


def cpu(work: Callable[[], T], rounds: int = 3, least: float = 0.02) -> tuple[float, T]:
    """Return the CPU seconds of one call, the least over rounds of at least so many seconds, and what it returned."""
    best, result = float("inf"), work()
    for _ in range(rounds):
        began, calls = time.process_time(), 0
        while calls == 0 or time.process_time() - began < least:
            result = work()
            calls += 1
        best = min(best, (time.process_time() - began) / calls)
    return best, result


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


def options(doc: str | None, extra: Sequence[str] = ()) -> argparse.Namespace:
    """Return the options that every script has, and the flags of this one."""
    parser = argparse.ArgumentParser(description=(doc or "").split("\n", 1)[0])
    parser.add_argument("--json", metavar="PATH")
    for flag in extra:
        parser.add_argument(flag, action="store_true")
    return parser.parse_args()


def save(results: dict[str, Any], path: str | None) -> None:
    """Write results as JSON if a path is given."""
    if path:
        Path(path).write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
