"""Write the problem files of this folder, and ``rows.json``: what the field has published about each.

Definitions are those of the stochastic category of the friendly competition (reports of 2019 and 2020, and the formal
definitions of the group, repository ArchCompStochasticModels.jl). Where one name stands for several systems, each
reading is a row. ``verified.json`` holds rows of tools that verify (StochasticBarrier.jl, PRoTECT) or train (logRASM).
Run ``python benchmarks/arch/write_problems.py`` to write files again, and ``certigym reproduce arch`` to certify them.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import grid_rows  # the file beside this one
import numpy as np

HERE = Path(__file__).parent


def chain(n: int) -> dict[str, Any]:
    """Return the chain of n integrators: safe for five steps, and in the target at the fifth."""
    tau = 0.1
    A = [[tau ** (j - i) / math.factorial(j - i) if j >= i else 0.0 for j in range(n)] for i in range(n)]
    agent = {
        "name": "chain",
        "A": A,
        "B": [[tau ** (n - i) / math.factorial(n - i)] for i in range(n)],
        "noise_covariance": (0.01 * np.eye(n)).tolist(),
        "state_low": [-10.0] * n,
        "state_high": [10.0] * n,
        "input_low": [-1.0],
        "input_high": [1.0],
        "initial_state": [0.0] * n,
    }
    target = {"agent": "chain", "low": [-8.0] * n, "high": [8.0] * n}
    return problem(f"chain-{n}", 5, agent, {"target": target}, "X X X X X target", "co-safe")


def anaesthesia(name: str, covariance: np.ndarray, input_matrix: list[float]) -> dict[str, Any]:
    """Return the patient who is to stay safe for ten steps."""
    agent = {
        "name": "patient",
        "A": [[0.8192, 0.03412, 0.01265], [0.01646, 0.9822, 0.0001], [0.0009, 0.00002, 0.9989]],
        "B": [[b] for b in input_matrix],
        "noise_covariance": (0.5 * (covariance + covariance.T)).tolist(),
        "state_low": [1.0, 0.0, 0.0],
        "state_high": [6.0, 10.0, 10.0],
        "input_low": [0.0],
        "input_high": [7.0],
        "initial_state": [3.5, 5.0, 5.0],
    }
    safe = {"agent": "patient", "low": [1.0, 0.0, 0.0], "high": [6.0, 10.0, 10.0]}
    return problem(name, 10, agent, {"safe": safe}, "G safe", "finite-trace")


def two_zones(
    name: str, deviation: np.ndarray, box: list[list[float]], inputs: list[float], first: float, start: list[float]
) -> Any:
    """Return two heated zones with one boiler, as one agent with four states."""
    free_low, free_high = ([0.0, 0.0], [80.0, 80.0]) if len(box[0]) == 2 else ([], [])
    agent = {
        "name": "building",
        "A": [[0.6682, 0, 0.02632, 0], [0, 0.683, 0, 0.02096], [1.0005, 0, -0.000499, 0], [0, 0.8004, 0, 0.1996]],
        "B": [[0.132], [0.1402], [0.0], [0.0]],
        "offset": [first, 2.9272, 13.0207, 10.4166],
        "noise_covariance": np.diag(deviation**2).tolist(),
        "state_low": box[0] + free_low,
        "state_high": box[1] + free_high,
        "input_low": [inputs[0]],
        "input_high": [inputs[1]],
        "initial_state": start,
    }
    safe = {"agent": "building", "low": agent["state_low"], "high": agent["state_high"]}
    return problem(name, 6, agent, {"safe": safe}, "G safe", "finite-trace")


def seven_states() -> dict[str, Any]:
    """Return the building with seven states, whose noise has rank four."""
    A = np.array(
        [
            [0.9678, 0, 0.0036, 0, 0.0036, 0, 0.0036],
            [0, 0.9682, 0, 0.0034, 0, 0.0034, 0.0034],
            [0.0106, 0, 0.9494, 0, 0, 0, 0],
            [0, 0.0097, 0, 0.9523, 0, 0, 0],
            [0.0106, 0, 0, 0, 0.9494, 0, 0],
            [0, 0.0097, 0, 0, 0, 0.9523, 0],
            [0.0106, 0.0097, 0, 0, 0, 0, 0.9794],
        ]
    )
    Bw = np.zeros((7, 6))
    Bw[0, [2, 4]], Bw[1, [3, 5]] = (1.9381e-4, 7.924e-4), (5.7769e-6, 6.094e-4)
    Bw[2, 0], Bw[3, 0], Bw[4, 1], Bw[5, 1] = 0.0084, 0.0074, 0.0073, 0.0066
    mean, variances = np.array([9.0, 15.0, 500.0, 500.0, 35.0, 35.0]), np.array([1.0, 1.0, 100.0, 100.0, 5.0, 5.0])
    covariance = Bw * variances @ Bw.T
    offset = np.array([0.0493, -0.0055, 0.0387, 0.0189, 0.011, 0.0108, 0.0109]) + Bw @ mean
    agent = {
        "name": "building",
        "A": A.tolist(),
        "B": [[0.0195], [0.02], [0], [0], [0], [0], [0]],
        "offset": offset.tolist(),
        "noise_covariance": (0.5 * (covariance + covariance.T)).tolist(),
        "state_low": [19.5, 0, 0, 0, 0, 0, 0],
        "state_high": [20.5, 60, 60, 60, 60, 60, 60],
        "input_low": [15.0],
        "input_high": [22.0],
        "initial_state": [20.0] * 7,
    }
    safe = {"agent": "building", "low": agent["state_low"], "high": agent["state_high"]}
    return problem("bas-7", 6, agent, {"safe": safe}, "G safe", "finite-trace")


def almost_identity(n: int) -> dict[str, Any]:
    """Return n states that couple in a ring, without input."""
    A = 0.7 * np.eye(n) - 0.1 * np.roll(np.eye(n), 1, axis=1)
    agent = {
        "name": "ring",
        "A": A.tolist(),
        "B": [[0.0]] * n,
        "noise_covariance": (0.01 * np.eye(n)).tolist(),
        "state_low": [-1.0] * n,
        "state_high": [1.0] * n,
        "input_low": [0.0],
        "input_high": [0.0],
        "initial_state": [0.0] * n,
    }
    safe = {"agent": "ring", "low": [-1.0] * n, "high": [1.0] * n}
    return problem(f"almost-identity-{n}", 10, agent, {"safe": safe}, "G safe", "finite-trace")


def problem(name: str, horizon: int, agent: Any, propositions: Any, formula: str, semantics: str) -> dict[str, Any]:
    """Return a problem of one agent."""
    task = {"formula": formula, "semantics": semantics}
    return {"name": name, "horizon": horizon, "agents": [agent], "propositions": propositions, "specification": task}


def toml(content: dict[str, Any]) -> str:
    """Return a problem as the text of a file."""
    lines = [f'name = "{content["name"]}"', f"horizon = {content['horizon']}"]
    for agent in content["agents"]:
        lines += ["", "[[agents]]", *(f"{key} = {written(value)}" for key, value in agent.items())]
    lines += ["", "[propositions]"]
    for name, region in content["propositions"].items():
        lines.append(f"{name} = {{ {', '.join(f'{key} = {json.dumps(value)}' for key, value in region.items())} }}")
    task = content["specification"].items()
    return "\n".join([*lines, "", "[specification]", *(f"{key} = {json.dumps(value)}" for key, value in task)]) + "\n"


def written(value: Any) -> str:
    """Return a value as TOML: JSON, but for tables."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{key} = {written(entry)}' for key, entry in value.items())} }}"
    return f"[{', '.join(map(written, value))}]" if isinstance(value, list) else json.dumps(value)


CAP = "the published .9999 is the cap of the solver, not a difference between methods"
DEVIATION = np.array([0.0774, 0.0774, 0.3872, 0.3098])


PEAK = "published: the largest value over all starts; ours is from one start that was looked for"


def rows() -> list[dict[str, Any]]:
    """Return every row: problem, published number, its tool, seconds and machine, and what to know about it."""
    reach, aws, b = "SReachTools", "AWS, MATLAB and Gurobi", np.array([0.01883, 0.0002, 0.00001])
    box, full = [[19.5, 19.5], [20.5, 20.5]], [[19.0, 19.0, 30.0, 30.0], [21.0, 21.0, 36.0, 36.0]]
    free, inputs = [19.85, 20.05, 30.5, 47.0], [15.0, 22.0]
    result = []
    for n, seconds in ((2, 5.12), (3, 6.27), (10, 16.43), (20, 25.8), (40, 51.2), (100, 228.8)):
        note = CAP + "; target at exactly step 5, start at 0"
        # By default two states get a grid, which says something of every start and takes longer than a row should.
        relation = "path" if n == 2 else "auto"
        result.append(row(chain(n), note, 0.9999, reach, seconds, aws, relation))
    through = anaesthesia("anaesthesia-through-b", 5.0 * np.outer(b, b), b.tolist())
    note = CAP + "; reading: noise of variance 5 enters with the input"
    result.append(row(through, note, 0.9999, reach, 7.87, aws))
    automated = anaesthesia("anaesthesia-automated", 1e-3 * np.eye(3), b.tolist())
    result.append(row(automated, "reading: variance .001 in every state"))
    deviation = two_zones("bas-4-deviation", DEVIATION, box, inputs, 3.3378, free)
    note = "reading: .0774 is a standard deviation; states 3 and 4 are free. "
    result.append(row(deviation, note + PEAK, 0.997837, reach, 2.44, aws))
    variance = two_zones("bas-4-variance", np.sqrt(DEVIATION), box, inputs, 3.3378, [20.0, 20.0, 33.0, 33.0])
    result.append(row(variance, "reading: .0774 is a variance"))
    gridded = two_zones("ba-4d", np.sqrt(DEVIATION), full, [17.0, 20.0], 3.4378, [19.3, 20.45, 33.7, 35.9])
    result.append(row(gridded, "on a grid. " + PEAK, 0.6673, "IMPaCT", 7.87, "see its report"))
    note = CAP + "; noise of rank four; start at 20"
    result.append(row(seven_states(), note, 0.9999, reach, 1.33, aws))
    result += [row(almost_identity(n), "") for n in (5, 20)]
    others = json.loads((Path(__file__).parent / "verified.json").read_text(encoding="utf-8"))
    return [*result, *(row(**entry) for entry in (*grid_rows.entries(), *others))]


def row(
    content: dict[str, Any],
    note: str,
    published: float | None = None,
    tool: str = "",
    seconds: float | None = None,
    machine: str = "",
    relation: str = "auto",
    **more: Any,
) -> dict[str, Any]:
    """Write the file of a problem, and return its row; ``more`` may be cells."""
    file = content["name"].replace("-", "_") + ".toml"
    (HERE / file).write_text(toml(content), encoding="utf-8")
    entry = {"row": content["name"], "problem": file, "relation": relation, "published": published, "tool": tool}
    note = note if published is not None or tool else "; ".join(filter(None, [note, "no published number was found"]))
    return {**entry, "seconds": seconds, "machine": machine, "note": note, **more}


if __name__ == "__main__":
    text = json.dumps(rows(), indent=1)
    (HERE / "rows.json").write_text(text + "\n", encoding="utf-8")
