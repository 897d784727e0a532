"""What a stranger's models get without any option: certify, check and simulate every file of ``examples/own``.

``python benchmarks/own_models.py [FILE ...]`` prints a line for each file (default: all). Rows of ``examples/own`` are
written to the page ``docs/own_models.md``, beside those of earlier runs. Seconds are processor seconds of search and
check. What is done by hand is measured where ``own_models.json`` has no such key.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import certigym as cg
from by_hand import by_hand
from certigym.envs.systems.arguments import write_json, write_text
from certigym.synthesis.certificates.proofs import significant_up

ROOT = Path(__file__).parent.parent
FOLDER, PAGE, NUMBERS = ROOT / "examples" / "own", ROOT / "docs" / "own_models.md", ROOT / "docs" / "own_models.json"

EPISODES, SEED = 100_000, 0

HEAD = """# Models from textbooks, with no options

The files of `examples/own`, written as a newcomer would, without an eye on what the package is good at. Each was
certified **without any option** and checked (all valid): `python benchmarks/own_models.py`.

- *size*: states/inputs of the agents, and time steps; *way*: the method that was kept, `+` with finer cells;
- *by hand*: success of what an engineer does first, a plan with textbook linear-quadratic feedback, clipped at the
  input box, the best of three (`benchmarks/by_hand.py`): exact 99.9 % limits from 20,000 rollouts;
- *failure at most*: proved, rounded up; *rollouts*: success rate of the certified controllers in 100,000 rollouts;
- *seconds*: of one core for search and check.
"""

TABLE = """
| file | size | by hand | way | failure at most | rollouts | seconds |
|---|---|---|---|---|---|---|
"""

MARK = "# large noise"
"""Beginning of files whose noise is large: what is certified of them says more than a row of nines."""


def measured(file: Path, known: dict[str, Any]) -> dict[str, Any]:
    """Return what one file gets: way, bound, share of rollouts, seconds and check, beside what is known by hand."""
    problem = cg.load(file)
    began = time.process_time()
    row: dict[str, Any] = {"file": file.name, "what": _what(problem)}
    try:
        result = cg.synthesize(problem)
    except ValueError as refusal:
        return {**row, "refused": " ".join(str(refusal).split()), "seconds": round(time.process_time() - began, 1)}
    report = cg.check(result.certificate, problem)
    seconds = time.process_time() - began
    rate = cg.validate(result, EPISODES, seed=SEED)
    tried = result.stats.get("tried") or {}
    bounds = {name: value for name, value in tried.items() if isinstance(value, float)}
    way = max(bounds, key=lambda name: bounds[name]) if bounds else _way(result.certificate)
    return {
        **row,
        "by_hand": known["by_hand"] if "by_hand" in known else by_hand(problem, SEED),
        "way": way,
        "certified": float(result.certificate.lower_bound),
        "rollouts": float(rate.estimate),
        "seconds": round(seconds, 1),
        "check": "valid" if report else "NOT valid",
    }


def _way(certificate: Any) -> str:
    settings = getattr(certificate, "settings", {})
    return str(settings.get("relation", type(certificate).__name__))


def _what(problem: cg.Problem) -> str:
    """Return agents, states, inputs and steps in a few words."""
    sizes = [f"{agent.n_states}/{agent.n_inputs}" for agent in problem.agents]
    kinds = ", ".join(
        f"{sizes.count(size)} x {size}" if sizes.count(size) > 1 else size for size in dict.fromkeys(sizes)
    )
    return f"{len(sizes)} agent{'s' * (len(sizes) > 1)} (states/inputs {kinds}), {problem.horizon} steps"


def _short(what: str) -> str:
    """Return agents, states, inputs and steps without the words between, as the head of the table says."""
    return what.split("inputs ")[1].replace(" x ", "x").replace("), ", "; ").removesuffix(" steps")


def page(rows: list[dict[str, Any]]) -> str:
    """Return the page, in two parts."""
    noisy = {file.name for file in FOLDER.glob("*.toml") if file.read_text(encoding="utf-8").startswith(MARK)}
    parts = [("Small noise", [row for row in rows if row["file"] not in noisy])]
    parts += [("Large noise", [row for row in rows if row["file"] in noisy])]
    return HEAD + "".join(f"\n## {title}\n{TABLE}{_lines(own)}" for title, own in parts if own)


def _lines(rows: list[dict[str, Any]]) -> str:
    """Return rows of a table."""
    lines = []
    for row in rows:
        if "refused" in row:
            lines.append(
                f"| {row['file']} | {_short(row['what'])} | | refused: {row['refused']} | | | {row['seconds']} |"
            )
            continue
        hand = row.get("by_hand")
        limits = f"[{hand[0]:.4f}, {hand[1]:.4f}]" if hand else "no plan" if "by_hand" in row else ""
        lines.append(
            f"| {row['file']} | {_short(row['what'])} | {limits} | {row['way'].replace(', finer cells', '+')} "
            f"| {significant_up(1.0 - row['certified'], 2)} | {row['rollouts']:.5f} | {row['seconds']} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    files = [Path(name) for name in sys.argv[1:]] or sorted(FOLDER.glob("*.toml"))
    rows = {row["file"]: row for row in json.loads(NUMBERS.read_text(encoding="utf-8"))}
    known = {file.name for file in FOLDER.glob("*.toml")}
    for file in files:
        found = measured(file, rows.get(file.name, {}))
        print(json.dumps(found), flush=True)
        rows |= {file.name: found} if file.resolve().parent == FOLDER else {}
        # After each file: what was measured stays if the rest is broken off.
        kept = [rows[name] for name in sorted(known & {*rows})]
        write_json(NUMBERS, kept)
        write_text(PAGE, page(kept))
