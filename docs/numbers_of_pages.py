"""Write every number about a suite id that a page shows: `python docs/numbers_of_pages.py`.

The numbers of the certificates come from `docs/defaults.json`, which `python benchmarks/defaults.py` measures; those of
learners from `docs/leaderboard.json`. This script writes the pages *defaults*, *leaderboard* and *arch*, and on other
pages the parts between `<!-- numbers: NAME -->` and `<!-- end of numbers -->`: tables, and what a command prints. A
test writes all of it again and compares.

Below .99 a bound is shown as a success probability of four digits, rounded down; from .99 on as a failure probability
of two digits, rounded up. A measured rate has its exact limits, or says that it is within noise of the bound.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
import shlex
from pathlib import Path
from typing import Any

import certigym as cg
from certigym.envs.suite import tier_of_id
from certigym.synthesis.certificates.proofs.digits import rounded_down, rounded_up, significant_up
from certigym.validation.policies.ranking import Leaderboard, Standing
from certigym.validation.policies.ranking_page import ORDER
from certigym.validation.policies.tier_rule import ALONE, reached_of

DOCS = Path(__file__).parent
FAILURE_FROM = 0.99
"""Bounds from here on are shown as failures."""

PARTS = re.compile(r"(<!-- numbers: ([^\n]+?) -->\n).*?(<!-- end of numbers -->)", re.DOTALL)
CHANGING = re.compile(r"^times .*$|  \d+\.\d s$| \(exact to [^)]*\)|(?<=\.\d{6})\d+|(?<=, rank )\d+", re.MULTILINE)
"""What a command prints that differs from run to run or from machine to machine: times, and what rounding decides."""


def table(name: str) -> Any:
    """Return the numbers of a JSON file of this folder; empty if there is none."""
    path = DOCS / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def proved(entry: dict[str, Any]) -> str:
    """Return what is certified, rounded to the safe side.

    Examples
    --------
    >>> proved({"certified": 0.98749, "failure": 0.01251}), proved({"certified": 0.9969, "failure": 0.00302})
    ('P >= 0.9874', 'failure <= 3.1e-3')
    """
    if entry["certified"] < FAILURE_FROM:
        return f"P >= {rounded_down(entry['certified'], 4)}"
    return f"failure <= {scientific_up(entry['failure'])}"


def scientific_up(value: float) -> str:
    """Return two digits of a small number, rounded up: 3.1e-3.

    Examples
    --------
    >>> scientific_up(0.00302), scientific_up(1.25e-10), scientific_up(0.0)
    ('3.1e-3', '1.3e-10', '0')
    """
    return scientific(float(significant_up(value, 2)) if value else 0.0)


def scientific(value: float) -> str:
    """Return two digits of a small number."""
    if value == 0.0:
        return "0"
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa}e{int(exponent)}"


def scientific_down(value: float) -> str:
    """Return two digits of a small number, rounded down."""
    if value <= 0.0:
        return "0"
    exponent = int(f"{value:e}".split("e")[1])
    digits = int(value * 10.0 ** (1 - exponent))
    return f"{digits / 10}e{exponent}"


def measured(entry: dict[str, Any]) -> str:
    """Return the measured rate with its exact limits, on the scale of the bound; say where it is within noise of it."""
    runs = entry["rollouts"]
    noise = " within noise" if runs["successes"] / runs["episodes"] < entry["certified"] else ""
    return _limits(runs, failures=entry["certified"] >= FAILURE_FROM) + noise


def _limits(runs: dict[str, Any], failures: bool) -> str:
    """Return the rate of rollouts and its limits, as failures or as successes."""
    if failures:
        rate = scientific((runs["episodes"] - runs["successes"]) / runs["episodes"])
        return f"{rate} [{scientific_down(1.0 - runs['high'])}, {scientific_up(1.0 - runs['low'])}]"
    rate = runs["successes"] / runs["episodes"]
    return f"{rate:.4f} [{rounded_down(runs['low'], 4)}, {rounded_up(runs['high'], 4)}]"


def random_inputs(entry: dict[str, Any]) -> str:
    """Return the success rate of uniformly random inputs."""
    return f"{entry['random']['successes'] / entry['random']['episodes']:.4f}"


def at_most(entry: dict[str, Any]) -> str:
    """Return the upper bound for any policy of the continuous system, on the scale of the certified bound.

    A dash where none is computed, or where it says no more than that probabilities are at most 1.
    """
    above = entry["any policy"]
    if above is None or above >= 1.0 or (entry["certified"] < FAILURE_FROM and rounded_up(above, 4) == "1.0000"):
        return "-"
    if entry["certified"] < FAILURE_FROM:
        return f"P <= {rounded_up(above, 4)}"
    return f"failure >= {scientific_down(1.0 - above)}"


def seconds(entry: dict[str, Any]) -> str:
    """Return CPU seconds."""
    return f"{entry['seconds']:.0f}" if entry["seconds"] >= 9.95 else f"{entry['seconds']:.1f}"


def verdict(entry: dict[str, Any]) -> str:
    """What the rollouts say of the bound, at their confidence."""
    rollouts, bound, gap = entry["rollouts"], entry["certified"], entry["gap"]
    if rollouts["high"] < bound or (entry["exact"] and rollouts["low"] > bound + gap):
        return "refuted"
    if bound <= 0.0:
        return "vacuous"
    return "confirmed" if rollouts["low"] >= bound else "consistent"


def page_link(id: str, folder: str = "environments/") -> str:
    """Return a link to the page that shows an id: variants have the page of their base."""
    from environment_pages import page_of_id  # which imports this module

    return f"[{id}]({folder}{page_of_id(id)}.md)"


DEFAULTS_HEAD = """# What the defaults certify

All {count} problems with an id and no options (`certigym run ID`): the numbers that every page shows.

- *proved*: the certified lower bound, which `certigym check` verified. From .99 on it is written as a failure
  probability, rounded up.
- *measured*: {episodes:,} rollouts of the certified controllers with exact 99.9 % limits, on the scale of the bound.
- *any policy*: an upper bound on what any policy of the continuous system attains. A dash: none is computed (agents
  with expressions, pairs of agents), or it is 1.
- *seconds*: CPU seconds of one process for the synthesis. Rank, peak memory, random inputs: `defaults.json`.

`python benchmarks/defaults.py` measures them, `python docs/numbers_of_pages.py` writes them to the pages. The order in
which methods are tried is [one table](how-to/choose_cells.md#the-default). A path is kept if its bound is .99 or more
and it was cheaper than grids, or if every grid that was tried fails more than 1.05 times as often: a grid also has
values, shields and other starts.

| id | proved | measured | any policy | relation | cells | seconds |
|---|---|---|---|---|---|---|
"""

LONGER_HEAD = """
## What ten minutes certify

The defaults are within .02 of the upper bound for any policy, or of 1, except on these problems. Settings of some
minutes were tried for them (`python benchmarks/defaults.py --longer`):

| id | defaults | settings | proved | seconds |
|---|---|---|---|---|
"""


def defaults_page() -> str:
    """Return the page of all that was measured with the defaults."""
    kept = table("defaults")
    rows, slow = [], []
    for id in cg.problem_ids():
        entry = kept[id]
        cells = [proved(entry), measured(entry), at_most(entry), entry["relation"], entry["cells"]]
        rows.append(f"| {page_link(id)} | {' | '.join(cells)} | {seconds(entry)} |")
        slow += [
            f"| {id} | {proved(entry)} | {one['settings']} | {proved(one)} | {one['seconds']} |"
            for one in entry.get("longer", [])
        ]
    head = DEFAULTS_HEAD.format(count=len(rows), episodes=100_000)
    return head + "\n".join(rows) + "\n" + LONGER_HEAD + "\n".join(slow) + "\n"


BOARD_HEAD = """# Leaderboard: certified controllers and learners

All {count} problems: what is proved, and the share of episodes that satisfy the task, on the same starts and noise for
all policies of a problem.

| column | what it is |
|---|---|
| proved, certified | bound and measured rate of the certified controllers ([defaults](defaults.md)) |
| {learners} | **without help**: [learned policies](how-to/learned_policies.md), [how long](how-to/leaderboard.md) |
| as it is | what `certify` proves of the best network, or why nothing |
| random | uniformly random inputs |

**Tier** says what is left to learn. *Known* is the largest of the bound and the lower limits of all rows. A problem is
**solved** if a learner without help comes within .01 of it, **hard** if all of them stay below half of it, **open**
otherwise. *Left* is the difference. The best learner is bold.

| id | proved | certified | tier | left | {names} |
|---|---|---|---|---|{lines}|
"""

BOARD_TAIL = """
Limits, world steps, training time and seeds of every row: [leaderboard.csv](leaderboard.csv). Rates of several seeds
are means. [Actors, curves, and how to submit a row](how-to/leaderboard.md).
"""


def board_page() -> str:
    """Return the leaderboard: a row for each problem, what is open first."""
    kept, board = table("defaults"), Leaderboard.load(DOCS / "leaderboard.json")
    names = [name for name in board.policies if name not in ("certified", "random")]
    rows: dict[str, list[Standing]] = {id: [] for id in cg.problem_ids()}
    for row in board.rows:
        rows[row.problem].append(row)
    left = {id: left_on(id, kept[id], found) for id, found in rows.items()}
    order = sorted(rows, key=lambda id: (ORDER.index(tier_of_id(id)), -round(left[id] or 0.0, 2), id))
    lines = []
    for id in order:
        rates = {row.policy: row.rate for row in rows[id]}
        best = max((rate for name, rate in rates.items() if name in ALONE), default=2.0)
        cells = [_rate(rates.get("ppo"), rates.get("ppo") == best > 0.0)]
        others = [name for name in names if name != "ppo" and name in rates]
        first = max(others, key=lambda name: rates[name], default="")
        cells.append(f"{first} {_rate(rates[first], rates[first] == best > 0.0)}" if first else "-")
        gap = "-" if left[id] is None else f"{left[id]:.2f}"
        mine = [row for row in rows[id] if row.policy in ALONE]
        cells.append(as_it_is(max(mine, key=lambda row: row.rate, default=None)))
        measures = f"{proved(kept[id])} | {measured(kept[id])} | {tier_of_id(id)} | {gap}"
        lines.append(f"| {page_link(id)} | {measures} | {' | '.join(cells)} | {random_inputs(kept[id])} |")
    head = BOARD_HEAD.format(
        count=len(lines),
        learners=", ".join(names),
        names="ppo | best other | as it is | random",
        lines="---|" * 3 + "---",
    )
    return head + "\n".join(lines) + "\n" + BOARD_TAIL.format()


def left_on(id: str, entry: dict[str, Any], rows: list[Standing]) -> float | None:
    """Return what is known to be possible and reached by no learner without help; None if none was judged."""
    reached = reached_of(rows)
    known = max(entry["certified"], entry["rollouts"]["low"], *(row.low for row in rows), 0.0)
    return None if reached is None else max(known - reached, 0.0)


def as_it_is(row: Standing | None) -> str:
    """Return what is proved of the best actor of a row as it was trained, or why nothing, in a word."""
    found = None if row is None else row.best_as_it_is
    return proved({"certified": found, "failure": 1.0 - found}) if isinstance(found, float) else found or "-"


def _rate(rate: float | None, is_best: bool) -> str:
    if rate is None:
        return "-"
    return f"**{rate:.4f}**" if is_best else f"{rate:.4f}"


def board_csv() -> str:
    """Return limits and cost of every row of the leaderboard."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    heads = ["id", "policy", "success", "low", "high", "middle of seeds", "as it is", "world steps", "seconds", "seeds"]
    writer.writerow([*heads, "agents see"])
    for row in Leaderboard.load(DOCS / "leaderboard.json").rows:
        middle = f"{row.middle_rate:.4f}" if len(row.seeds) > 1 else ""
        limits = [rounded_down(row.low, 4), rounded_up(row.high, 4), middle, as_it_is(row)]
        cost = ["" if number is None else f"{number:.10g}" for number in (row.steps, row.seconds)]
        seeds = " ".join(map(str, row.seeds))
        writer.writerow([row.problem, row.policy, f"{row.rate:.4f}", *limits, *cost, seeds, row.information])
    return text.getvalue()


ARCH_HEAD = """# The field's benchmarks

Rows of the stochastic category of the friendly competition, and of StochasticBarrier.jl, PRoTECT and logRASM (which
trains its networks), certified here beside what was published: `certigym reproduce arch` (about seven minutes). Problem
files and published numbers are in `benchmarks/arch`. Every certificate was checked and met by 100,000 rollouts. All
columns, and a note on how each row is read: [arch.csv](arch.csv).

- *asked*: what `synthesize` was told, where the defaults take longer than a row should;
- *proved*: from .99 on the failure, rounded up; *seconds*: processor seconds of ours, and those that others report of
  their machines, which is no race;
- a published .9999 is the cap of a solver: such rows differ in time only. Where a name stands for several systems, each
  reading is a row ([reading published numbers](field_audit.md)). A row called *mean* is about a start drawn from all
  starts that are neither in the target nor lost at once.

| row | tool | published | seconds | asked | proved | seconds | outcome |
|---|---|---|---|---|---|---|---|
"""


def arch_page() -> str:
    """Return the page of the field's benchmarks."""
    lines = []
    for row in table("arch"):
        theirs = ["-" if row[key] is None else f"{row[key]:.10g}" for key in ("published", "published_seconds")]
        cells = [row["row"], row["tool"] or "-", *theirs, row["asked"], proved(row), f"{row['seconds']:.2g}"]
        lines.append(f"| {' | '.join([*cells, row['outcome'].replace('no published number', '-')])} |")
    return ARCH_HEAD + "\n".join(lines) + "\n"


SHOWN = (
    ("meeting-v0", "two robots meet, then return to their desks"),
    ("car-park-planar-v0", "a car parks in the plane"),
    ("door-formation-v0", "three robots pass a door one after the other"),
    ("quadrotor-v0", "a quadrotor with twelve states flies through a gate of 1 m"),
    ("fleet-v0", "twenty vehicles on a circle swap places and keep apart"),
    ("invariance-b-100-v0", "a hundred agents stay in a safe set under unit noise"),
    ("package-delivery-kinematic-v0", "four robots with velocities deliver packages"),
    ("patrol-recharge-v0", "two robots guard a post and recharge"),
)
"""Rows of README: an id, and its task in words."""


def readme_table() -> str:
    """Return the table of README."""
    kept = table("defaults")
    lines = ["| task (`certigym run ID`) | proved | measured | CPU s |", "|---|---|---|---|"]
    for id, task in SHOWN:
        entry = kept[id]
        words = f"{task}: {page_link(id, 'docs/environments/')}"
        lines.append(f"| {words} | {proved(entry)} | {measured(entry)} | {seconds(entry)} |")
    return "\n".join(lines)


def offline_table() -> str:
    """Return what offline learners make of three tiers of data, measured by `docs/offline_learners.py`."""
    lines = ["| id | tier | in the data | cloned | IQL |", "|---|---|---|---|---|"]
    for key, row in table("offline").items():
        id, tier = key.split("/")
        shares = [_limits(row[name], failures=False) if name in row else "-" for name in ("data", "bc", "iql")]
        lines.append(f"| {id} | {tier} | {' | '.join(shares)} |")
    return "\n".join(lines)


def printed(command: str) -> str:
    """Return what a command prints, as a block of words; of it the first line if that is asked for."""
    from certigym.cli.main import main

    command, first, _ = command.partition(", first line")
    text = io.StringIO()
    with contextlib.chdir(DOCS.parent), contextlib.redirect_stdout(text), contextlib.redirect_stderr(io.StringIO()):
        main(shlex.split(command)[1:])
    lines = [line.rstrip() for line in text.getvalue().splitlines()]
    shown = "\n".join([lines[0], "..."] if first else lines)
    return f"```text\n$ {command}\n{shown}\n```"


def number(word: str) -> str:
    """Return one number: the bound of an id, or its measured rate."""
    what, id = word.split()
    return {"proved": proved, "measured": measured}[what](table("defaults")[id])


def part(name: str) -> str:
    """Return the text of a part of a page: a table, a number, or what a command prints."""
    tables = {"readme": readme_table, "offline": offline_table}
    if name in tables:
        return tables[name]()
    return printed(name) if name.startswith("certigym ") else number(name)


def with_parts(text: str) -> str:
    """Return a page with all its parts written anew."""
    return PARTS.sub(lambda found: f"{found[1]}\n{part(found[2])}\n\n{found[3]}", text)


def pages() -> dict[Path, str]:
    """Return the text of every page with numbers of the suite, but for those of the environments."""
    whole = {"defaults.md": defaults_page(), "leaderboard.md": board_page(), "leaderboard.csv": board_csv()}
    whole["arch.md"] = arch_page()
    result = {DOCS / name: text for name, text in whole.items()}
    for path in (DOCS.parent / "README.md", *sorted(DOCS.rglob("*.md"))):
        if "_build" not in path.parts and path not in result:
            text = path.read_text(encoding="utf-8")
            if PARTS.search(text):
                result[path] = with_parts(text)
    return result


def main() -> None:
    """Write all pages."""
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")
        print(path.relative_to(DOCS.parent))


if __name__ == "__main__":
    main()
