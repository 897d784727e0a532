"""Write the tiers of the suite from the recorded leaderboard, and its bounds from the recorded defaults:
`python docs/rate_problems.py`.

The rule is `certigym.validation.policies.tier_rule.tier_of`; a test computes all tiers again and compares.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import certigym as cg
from certigym.envs.suite import certified_bounds as suite_bounds
from certigym.envs.suite import tiers as suite_tiers
from certigym.validation.policies import Leaderboard, tier_of

RECORDED = Path(__file__).parent / "leaderboard.json"
DEFAULTS = Path(__file__).parent / "defaults.json"


def computed_tiers() -> dict[str, str]:
    """Return the tier of every id, by its rows about the problem as it is now."""
    rows = Leaderboard.load(RECORDED).rows
    current = {id: cg.make_problem(id).fingerprint for id in cg.problem_ids()}
    return {
        id: tier_of(row for row in rows if row.problem == id and row.fingerprint == fingerprint)
        for id, fingerprint in current.items()
    }


def certified_bounds() -> dict[str, float]:
    """Return the bound of every id, rounded down to nine digits."""
    found = json.loads(DEFAULTS.read_text(encoding="utf-8"))
    return {id: math.floor(1e9 * found[id]["certified"]) / 1e9 for id in cg.problem_ids()}


def main() -> None:
    """Write the tables of the suite."""
    path = Path(suite_bounds.__file__)
    head, _, _ = path.read_text(encoding="utf-8").partition("CERTIFIED: dict[str, float] = {")
    table = "".join(f'    "{id}": {bound!r},\n' for id, bound in sorted(certified_bounds().items()))
    path.write_text(f"{head}CERTIFIED: dict[str, float] = {{\n{table}}}\n", encoding="utf-8")
    print(f"{len(certified_bounds())} bounds in {path}")
    path = Path(suite_tiers.__file__)
    head, _, _ = path.read_text(encoding="utf-8").partition("TIERS: dict[str, str] = {")
    table = "".join(f'    "{id}": "{tier}",\n' for id, tier in sorted(computed_tiers().items()))
    path.write_text(f"{head}TIERS: dict[str, str] = {{\n{table}}}\n", encoding="utf-8")
    print(f"{len(computed_tiers())} tiers in {path}")


if __name__ == "__main__":
    main()
