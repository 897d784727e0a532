"""Record what reproductions gave: ``certigym reproduce all --out DIR``, then ``python docs/record_reproduced.py DIR``.

Look at the difference before you commit it: a number that falls is a finding, not a new record.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from certigym.envs.systems.arguments import write_json
from certigym.synthesis.certificates.proofs import significant_down
from certigym.validation.presentation.paper import RECORDED, TARGETS


def recorded(folder: Path) -> dict[str, dict[str, list[object]]]:
    """Return number (six digits; bounds are rounded down) and verdict of every line, by target and name."""
    return {
        target: {
            line["name"]: [_rounded(line["ours"], line["kind"]), line["verdict"]]
            for line in json.loads((folder / f"{target}-lines.json").read_text(encoding="utf-8"))
            if line["ours"] is not None
        }
        for target in TARGETS
    }


def _rounded(number: float, kind: str) -> float:
    return float(significant_down(number, 6) if kind in ("bound", "digits") else f"{number:.6g}")


if __name__ == "__main__":
    write_json(RECORDED, recorded(Path(sys.argv[1])))
