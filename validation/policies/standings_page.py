"""The leaderboard as a page in Markdown."""

from __future__ import annotations

from ...synthesis.certificates import rounded_down, rounded_up
from .standings import Leaderboard, Standing

HEAD = """# Leaderboard

Every problem of the suite, and what is known to succeed on it. "At least" is the certified lower bound of the defaults.
The other columns are shares of episodes that satisfy the task, on the same starts and noise for all policies of a
problem:

- **certified**: the controllers of that certificate;
- **probe**: the best of several learners that start from a clone of them (`certigym probe`);
- **ppo, ippo, mappo, central-ppo, sac**: learners **without help** from any certificate, described in
  [learned policies](how-to/learned_policies.md);
- **warm-ppo**: PPO that starts from a clone of the certified controllers: helped, so no independent baseline;
- **random**: uniformly random inputs.

How long a learner learned is in the second table: a short time where a dash would stand else. What `certigym train`
reaches with its defaults is in [learners](learners.md), how much a probe gains in two minutes in [probes](probes.md). A
dash means not measured. Made by `certigym leaderboard`; the numbers are also in `leaderboard.json`.
[How to submit a row](how-to/leaderboard.md).
"""

DETAILS = """
## Limits, returns, cost

Limits are exact (Clopper-Pearson), {confidence:g} % for both together, for the mean success probability of the actors
of the seeds that are listed. "Progress" is the mean undiscounted return of the reward `progress` (an estimate); that of
the reward `sparse` is the success rate itself. Steps and seconds of training are sums over the seeds; those of
"certified" are of the synthesis, if it was made for this table.

| id | policy | success | limits | progress | world steps | seconds | seeds | agents see |
|---|---|---|---|---|---|---|---|---|
"""


def page_of(board: Leaderboard) -> str:
    """Return the page: one table of success rates, and one of limits, returns and cost."""
    names = board.policies
    lines = [HEAD, f"| id | at least | {' | '.join(names)} |", "|---" * (len(names) + 2) + "|"]
    for problem in dict.fromkeys(row.problem for row in board.rows):
        held = board.row(problem, "certified")
        bound = "-" if held is None or held.lower_bound is None else rounded_down(held.lower_bound, 4)
        rates = (board.row(problem, name) for name in names)
        shown = " | ".join("-" if row is None else f"{row.rate:.4f}" for row in rates)
        lines.append(f"| [{problem}](environments/{problem}.md) | {bound} | {shown} |")
    confidence = 100 * max((row.confidence for row in board.rows), default=0.999)
    text = "\n".join(lines) + "\n" + DETAILS.format(confidence=confidence)
    return text + "".join(_details(row) + "\n" for row in board.rows)


def _details(row: Standing) -> str:
    """Return the row of a policy in the second table."""
    progress = "-" if row.gained is None else f"{row.gained:.2f}"
    cost = " | ".join("-" if number is None else f"{number:,.0f}" for number in (row.steps, row.seconds))
    seeds = ", ".join(map(str, row.seeds)) or "-"
    limits = f"[{rounded_down(row.low, 4)}, {rounded_up(row.high, 4)}]"
    success = f"{row.rate:.4f}"
    return (
        f"| {row.problem} | {row.policy} | {success} | {limits} | {progress} | {cost} | {seeds} | {row.information} |"
    )
