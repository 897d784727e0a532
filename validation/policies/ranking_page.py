"""The leaderboard as a page in Markdown."""

from __future__ import annotations

from ...synthesis.certificates.proofs import rounded_down, rounded_up, shown_bound
from .ranking import Leaderboard, Standing
from .tier_rule import ALONE, left_of, tier_of

HEAD = """# Leaderboard

Every problem of the suite, and what is known to succeed on it. "At least" is the certified lower bound of the defaults.
The other columns are shares of episodes that satisfy the task, on the same starts and noise for all policies of a
problem:

- **certified**: the controllers of that certificate;
- **ppo, ippo, mappo, central-ppo, sac**: learners **without help** from any certificate, described in
  [learned policies](how-to/learned_policies.md);
- **as it is**: what `certify` proves of that very actor: its lower bound, or in a word why there is none;
- **random**: uniformly random inputs.

**Tiers** say what is left to learn. *Known* to be possible is the bound, or the lower limit of any row if that is
larger. A problem is **solved** if a learner without help comes within .01 of what is known, **hard** if all of them
stay below half of it (or next to nothing is known), and **open** otherwise. "Left" is what is known to be possible and
reached by no learner without help: open and hard problems come first, and of each tier those where most is left. The
best learner without help is bold.

Rates of learners with several seeds are means over them. A dash means not measured. Made by `certigym leaderboard`; the
numbers are also in `leaderboard.json`. [Seeds, curves, and how to submit a row](how-to/leaderboard.md).
"""

DETAILS = """
## Limits and cost

Limits are exact (Clopper-Pearson), {confidence:g} % for both together, for the mean success probability of the actors
of the seeds that are listed. "Middle" is the interquartile mean over the seeds, of which a quarter is left out at each
end: it describes these seeds, and is a dash where there is one alone. Steps and seconds of training are sums over the
seeds; those of "certified" are of the synthesis, if it was made for this table.

| id | policy | success | limits | middle | world steps | seconds | seeds | agents see |
|---|---|---|---|---|---|---|---|---|
"""


def page_of(board: Leaderboard) -> str:
    """Return the page: one table of success rates, and one of limits and cost."""
    names = board.policies
    heads = [*names, *(f"{name} as it is" for name in names if name in ALONE)]
    lines = [HEAD, f"| id | at least | tier | left | {' | '.join(heads)} |", "|---" * (len(heads) + 4) + "|"]
    rows: dict[str, list[Standing]] = {}
    for standing in board.rows:
        rows.setdefault(standing.problem, []).append(standing)
    tiers = {problem: tier_of(found) for problem, found in rows.items()}
    left = {problem: left_of(found) for problem, found in rows.items()}
    # By tier, and in it by what is left, to the digits that are shown; ids decide between equals.
    for problem in sorted(
        rows, key=lambda problem: (ORDER.index(tiers[problem]), -round(left[problem] or 0.0, 2), problem)
    ):
        gap = "-" if left[problem] is None else f"{left[problem]:.2f}"
        held = board.row(problem, "certified")
        bound = "-" if held is None or held.lower_bound is None else rounded_down(held.lower_bound, 4)
        bound = bound if held is None or held.refused is None else "claimed, NOT valid"
        rates = {name: row.rate for name in names if (row := board.row(problem, name)) is not None}
        best = max((rate for name, rate in rates.items() if name in ALONE), default=2.0)
        cells = ["-" if name not in rates else _rate(rates[name], name in ALONE, best) for name in names]
        cells += [_as_it_is(board.row(problem, name)) for name in names if name in ALONE]
        lines.append(
            f"| [{problem}](environments/{problem}.md) | {bound} | {tiers[problem]} | {gap} | {' | '.join(cells)} |"
        )
    confidence = 100 * max((row.confidence for row in board.rows), default=0.999)
    text = "\n".join(lines) + "\n" + DETAILS.format(confidence=confidence)
    return text + "".join(_details(row) + "\n" for row in board.rows)


ORDER = ("open", "hard", "unrated", "solved")
"""Tiers in the order of the page: what is left to learn comes first."""


def _as_it_is(row: Standing | None) -> str:
    """Return the best bound of a learner's actors as they were trained, or the reason why there is none."""
    found = None if row is None else row.best_as_it_is
    return "-" if found is None else found if isinstance(found, str) else shown_bound(found, None)


def _rate(rate: float, is_alone: bool, best: float) -> str:
    """Return a rate, bold if no learner without help has a larger one, and it is any."""
    return f"**{rate:.4f}**" if is_alone and rate == best > 0.0 else f"{rate:.4f}"


def _details(row: Standing) -> str:
    """Return the row of a policy in the second table."""
    cost = " | ".join("-" if number is None else f"{number:,.0f}" for number in (row.steps, row.seconds))
    seeds = ", ".join(map(str, row.seeds)) or "-"
    limits = f"[{rounded_down(row.low, 4)}, {rounded_up(row.high, 4)}]"
    numbers = f"{row.rate:.4f} | {limits} | {f'{row.middle_rate:.4f}' if len(row.seeds) > 1 else '-'}"
    return f"| {row.problem} | {row.policy} | {numbers} | {cost} | {seeds} | {row.information} |"
