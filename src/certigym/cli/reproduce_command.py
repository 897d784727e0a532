"""The command ``reproduce``: what was published, what is expected, what is found here, and whether it passes."""

from __future__ import annotations

import sys
import time
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tqdm import tqdm

from ..envs.systems.arguments import checked_count
from ..envs.systems.arguments import write_json as save_json
from ..validation.presentation.paper import (
    AIM,
    TARGETS,
    Reproduction,
    certified_networks,
    computed,
    lines_of,
    lines_text,
    network_table,
    summary_text,
    target_of,
    write_networks,
)
from .given import say, write_json

SILENCE = 15.0
"""Seconds after which it is said again what is computed, where there is no bar that shows it."""


def reproduce(options: Namespace) -> int:
    """Recompute what was published, print it beside ours; the status is 1 if a number is not as it was recorded."""
    if options.out and Path(options.out).exists() and not Path(options.out).is_dir():
        raise ValueError(f"`--out`: expected a folder, got the file {options.out!r}; name a folder, it is made")
    if options.row is not None and options.what != "arch":
        raise ValueError("`--row`: expected only with arch; leave it out")
    if (options.weights is not None) != (options.what == "lograsm"):
        raise ValueError("`--weights`: expected with lograsm, and with it alone: the folder of the networks")
    if options.what == "lograsm":
        return _networks(options)
    workers = checked_count(options.workers, "--workers")
    began, folder = time.perf_counter(), Path(options.out or "reproduced")
    names = TARGETS if options.what == "all" else (options.what,)
    asked = {name: target_of(name, options.row) for name in names}
    told = {}
    with _told(sum(len(whole.pieces) for whole in asked.values())) as telling:
        for name, found in computed(asked, telling, workers):
            told[name] = _written(name, asked[name], found, folder, options.row)
            with tqdm.external_write_mode():
                say(options, f"{name}\n{lines_text(told[name]['lines'])}")
    lines = {name: of_target["lines"] for name, of_target in told.items()}
    failed = [line for of_target in lines.values() for line in of_target if line["wrong"] is not None]
    if options.what == "all":
        say(options, f"all\n{summary_text(lines)}")
    # After many lines those that fail are shown once more.
    if failed and options.what == "all":
        say(options, f"failed\n{lines_text(failed)}")
    end = (
        "PASS: every number is as it was recorded" if not failed else f"FAIL: {len(failed)} numbers are not as recorded"
    )
    say(options, f"{end}; {(time.perf_counter() - began) / 60:.1f} minutes; written to {folder}")
    write_json(options, told if options.what == "all" else told[options.what])
    return int(bool(failed))


def _networks(options: Namespace) -> int:
    """Certify the networks of a folder beside what was published; the status is 1 if one fails with more than 1e-6."""
    rows = []
    for row in certified_networks(Path(options.weights)):
        rows.append(row)
        print(f"{row.network}: failure at most {row.failure:.2g}, {row.search:.1f} s", file=sys.stderr)
    folder = Path(options.out or "reproduced")
    write_networks(rows, folder)
    missed = [row.network for row in rows if not row.failure <= AIM]
    end = f"FAIL: {', '.join(missed)}" if missed else f"PASS: every one fails with at most {AIM:g} from every start"
    say(options, f"{network_table(rows)}{end}; written to {folder}")
    write_json(options, [asdict(row) for row in rows])
    return int(bool(missed))


def _written(name: str, whole: Reproduction, found: Sequence[Any], folder: Path, row: str | None) -> dict[str, Any]:
    """Write the files of a target, and return its result and its judged lines."""
    result = whole.joined(found, folder)
    lines = lines_of(name, result, row)
    folder.mkdir(parents=True, exist_ok=True)
    save_json(folder / f"{name}-lines.json", lines)
    if name.startswith("fig") and not (folder / f"{name}.png").exists():
        print('certigym: no figure without matplotlib; install "certigym[viz]" for it', file=sys.stderr)
    return {"result": result, "lines": lines}


class _Telling:
    """Tells on standard error what is found and what is computed: a line for each piece, and a bar on a terminal."""

    def __init__(self, bar: tqdm[Any]) -> None:
        self._bar = bar
        self._names: list[str] = []
        self._began = self._last = time.monotonic()
        self._count = 0

    def now(self, names: Sequence[str]) -> None:
        """Show what is computed: in the bar, or in a line at first and after some silence."""
        if not self._bar.disable:
            self._bar.set_description_str("; ".join(names))
        elif not self._names or time.monotonic() - self._last >= SILENCE:
            self._line(f"computing {'; '.join(names)}")
        self._names = list(names)

    def found(self, name: str, words: str, seconds: float) -> None:
        """Write a line about a piece that was found."""
        self._count += 1
        self._line(f"[{self._count}/{self._bar.total}] {name}: {words} ({seconds:.0f} s)")
        self._bar.update()

    def _line(self, words: str) -> None:
        minutes, seconds = divmod(int(time.monotonic() - self._began), 60)
        tqdm.write(f"{minutes:3}:{seconds:02}  {words}", file=sys.stderr)
        self._last = time.monotonic()


@contextmanager
def _told(total: int) -> Iterator[_Telling]:
    """Open what tells of so many pieces."""
    form = "[{elapsed}] {n_fmt}/{total_fmt}, now: {desc}"
    with tqdm(total=total, bar_format=form, disable=None, leave=False, file=sys.stderr) as bar:
        yield _Telling(bar)
