"""Published numbers beside ours: expected and found, a verdict on each, and whether all are as they were recorded.

A reproduction is a list of lines. What the lines gave when the page about published results was written is kept in
``recorded.json``; a line that gives less, or another verdict, fails. So what is lost is seen by whoever runs the
command.

The class of a line says how it is judged.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

RECORDED = Path(__file__).with_name("recorded.json")
"""What each line of each target gave when the pages were written: a number, rounded down, and a verdict."""

AGREES, HIGHER, LOWER, REFUTED_CLAIM, OURS_ALONE = "agrees", "higher", "lower", "published claim refuted", "ours alone"
DIFFERS, STANDS = "differs", "published claim not refuted"

NEAR = 0.02
"""Relative difference up to which counts and estimates agree with those that were published or recorded."""


@dataclass(frozen=True)
class Line:
    """One published number and ours: measured, a count or an estimate of a fixed seed, which has to be near.

    Parameters
    ----------
    name : str
        What the number is.
    published : float or None
        None where nothing was published.
    ours : float
    digits : float
        Half a unit of the last published digit, for ``digits``.
    """

    name: str
    published: float | None
    ours: float
    digits: float = 5.1e-7

    kind: ClassVar[str] = "measured"
    """What tables call the class."""

    @property
    def verdict(self) -> str:
        """What ours says about the published number."""
        return OURS_ALONE if self.published is None else self._beside(self.published)

    def _beside(self, published: float) -> str:
        return AGREES if abs(self.ours - published) <= NEAR * abs(published) else DIFFERS

    def _wrong_beside(self, recorded: float) -> str | None:
        return f"far from the recorded {recorded:.6g}" if abs(self.ours - recorded) > NEAR * abs(recorded) else None

    def judged(self, recorded: tuple[float, str] | None) -> dict[str, Any]:
        """Return the line as JSON values, with its difference, its verdict, and what is wrong with it, if anything."""
        wrong = None
        if recorded is None:
            wrong = "not recorded"
        elif self.verdict != recorded[1]:
            wrong = f"recorded as {recorded[1]}"
        else:
            wrong = self._wrong_beside(recorded[0])
        difference = None if self.published is None else self.ours - self.published
        expected = None if recorded is None else recorded[0]
        return {
            **asdict(self),
            "kind": self.kind,
            "expected": expected,
            "difference": difference,
            "verdict": self.verdict,
            "wrong": wrong,
        }


class Claim(Line):
    """The published number is a claim about a probability, ours is the upper limit of rollouts on it."""

    kind = "claim"

    def _beside(self, published: float) -> str:
        return REFUTED_CLAIM if self.ours < published else STANDS


class Bound(Line):
    """Ours is a certified lower bound; it must not be below the recorded one."""

    kind = "bound"

    def _beside(self, published: float) -> str:
        return HIGHER if self.ours >= published else LOWER

    def _wrong_beside(self, recorded: float) -> str | None:
        return f"below the recorded {recorded:.6g}" if self.ours < recorded else None


class Digits(Bound):
    """Ours repeats a published computation, and has to have its digits."""

    kind = "digits"

    def _beside(self, published: float) -> str:
        return AGREES if abs(self.ours - published) <= self.digits else DIFFERS


def judged_lines(
    target: str, lines: Sequence[Line], path: Path = RECORDED, only: str | None = None
) -> list[dict[str, Any]]:
    """Return the lines of a target with difference and verdict; a recorded line that is missing is wrong, too.

    With ``only`` one row of the target was computed, and no line can be missing.
    """
    recorded: dict[str, list[Any]] = json.loads(path.read_text(encoding="utf-8")).get(target, {})
    before = {name: (float(value), str(verdict)) for name, (value, verdict) in recorded.items()}
    found = [line.judged(before.get(line.name)) for line in lines]
    missing = [] if only is not None else sorted(set(before) - {line.name for line in lines})
    nothing = {"published": None, "ours": None, "difference": None, "verdict": "missing", "wrong": "not computed"}
    return [*found, *({"name": name, "expected": before[name][0], **nothing} for name in missing)]


def lines_text(judged: Sequence[dict[str, Any]]) -> str:
    """Return judged lines as a table: what, published, expected, found, verdict on the published, pass or fail.

    Expected is what was recorded; bounds may be higher.
    """
    rows = [("what", "published", "expected", "found", "published number", "")]
    for line in judged:
        numbers = [_shown(line[name]) for name in ("published", "expected", "ours")]
        rows.append((line["name"], *numbers, line["verdict"], f"FAIL: {line['wrong']}" if line["wrong"] else "pass"))
    return _aligned(rows)


def summary_text(judged: Mapping[str, Sequence[dict[str, Any]]]) -> str:
    """Return how many lines of each target are as they were recorded, and how many of all."""
    rows = [("target", "lines", "pass", "fail")]
    for target, lines in judged.items():
        wrong = sum(line["wrong"] is not None for line in lines)
        rows.append((target, str(len(lines)), str(len(lines) - wrong), str(wrong)))
    sums = [str(sum(int(row[k]) for row in rows[1:])) for k in (1, 2, 3)]
    return _aligned([*rows, ("all", *sums)])


def _aligned(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as text, their columns below each other."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return "\n".join("  ".join(f"{word:<{width}}" for word, width in zip(row, widths)).rstrip() for row in rows)


def _shown(number: float | None) -> str:
    """Return a number with the six digits that are published of the largest ones."""
    return "-" if number is None else f"{number:.6g}"
