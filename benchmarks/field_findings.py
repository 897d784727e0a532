"""Findings about published numbers that a row of a table does not show by itself (docs/field_audit.md).

``python benchmarks/field_findings.py NAME`` prints one of them: `rooms` (a noise of 0), `oscillator` (two systems of
one name), `samples` (a range of means from samples that misses the true one). Run it at the root of a checkout.
"""

from __future__ import annotations

import math
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from certigym import load, rollout, synthesize
from certigym.envs.systems.expressions import Affine, enclosed
from certigym.envs.tasks.problem import problem_from_dict

ROWS = Path("benchmarks/arch")
EPISODES = 20_000


def rooms() -> list[str]:
    """Return what `sqrt(1/50)` is in C++, and what becomes of three rooms with that noise and with the stated one."""
    lines = [f"sqrt(1/50) in C++: {_in_cpp('std::sqrt(1/50)')}; the square root of .02 is {math.sqrt(1 / 50):.4f}"]
    data = tomllib.loads((ROWS / "rooms_3_two_heaters.toml").read_text(encoding="utf-8"))
    data["agents"] = [_held(data["agents"][0], 0.45)]
    for name, variance in (("noise of variance .02", 0.02), ("noise of variance 0", 0.0)):
        data["agents"][0]["noise_covariance"] = (variance * np.eye(3)).tolist()
        problem = problem_from_dict(data)
        found: Any = synthesize(problem, relation="path").certificate
        share = rollout(problem, found.controller, EPISODES, seed=0).successes / EPISODES
        lines.append(f"{name}: certified {found.lower_bound:.4f}, {share:.4f} of {EPISODES} rollouts succeed")
    return lines


def _held(house: dict[str, Any], power: float) -> dict[str, Any]:
    """Return three rooms whose two heaters are held at one power, which leaves a linear system; no input is left."""
    heat = np.array([power, 0.0, power])
    kept = {name: house[name] for name in ("name", "state_low", "state_high")}
    return {
        **kept,
        "A": (np.full((3, 3), 0.2) + np.diag(0.378 - 0.05 * heat)).tolist(),
        "B": [[0.0]] * 3,
        "offset": (2.5 * heat - 0.022).tolist(),
        "input_low": [0.0],
        "input_high": [0.0],
        "initial_state": [20.51, 19.42, 20.51],
    }


def _in_cpp(expression: str) -> str:
    """Return the value of an expression in C++, or how it follows from whole numbers where no compiler is found."""
    compiler = shutil.which("c++")
    if compiler is None:
        return f"{math.sqrt(1 // 50):g} (by division of whole numbers; no compiler was found)"
    text = f'#include <cmath>\n#include <cstdio>\nint main() {{ std::printf("%g", {expression}); }}\n'
    with tempfile.TemporaryDirectory() as folder:
        source, program = Path(folder, "value.cpp"), Path(folder, "value")
        source.write_text(text, encoding="utf-8")
        subprocess.run([compiler, str(source), "-o", str(program)], check=True, capture_output=True)
        return subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout


def oscillator() -> list[str]:
    """Return how often the oscillator reaches its target from one start, as it is run and as it is meant."""
    lines = []
    for name in ("as_run", "as_meant"):
        problem: Any = load(ROWS / f"van_der_pol_free_{name}.toml")
        problem = problem.replace(initial_state=[-0.8, -1.8])
        found: Any = synthesize(problem, 40, relation="linear").certificate  # no input: every policy does the same
        share = rollout(problem, found.controller, EPISODES, seed=0).successes / EPISODES
        lines.append(f"{problem.agents[0].dynamics[1]}: {share:.3f} of {EPISODES} rollouts from (-.8, -1.8)")
    return lines


def samples() -> list[str]:
    """Return the range of a mean of the vehicle over one cell: of its corners, of a point inside, and enclosed."""
    agent: Any = load(ROWS / "vehicle_3_largest.toml").agents[0]
    speed, steering = 4.0, 0.4
    low, high = np.array([0.25, 0.25, -0.4]), np.array([0.75, 0.75, 0.0])
    corners = np.stack([axis.ravel() for axis in np.meshgrid(*zip(low, high), indexing="ij")])
    inputs = np.array([[speed], [steering]])
    means = agent.mean(corners, np.repeat(inputs, 8, axis=1))[0]
    # The car moves most along x where heading and slip cancel, which is inside of the cell.
    inside = np.array([high[0], 0.5, -math.atan(math.tan(steering) / 2)])
    there = float(agent.mean(inside[:, None], inputs)[0, 0])
    names = {name: Affine(np.zeros(1), {k: np.ones(1)}) for k, name in enumerate((*agent.states, *agent.inputs))}
    box = [*zip(low[:, None], high[:, None]), *zip(inputs, inputs)]
    ((least, most), *_) = enclosed(agent.trees, names, box)
    return [
        f"mean of x over the cell {low.tolist()} to {high.tolist()}, speed {speed:g}, steering {steering:g}",
        f"corners:   {means.min():.5f} to {means.max():.5f}",
        f"a state inside, heading {inside[2]:.4f}: {there:.5f}, {there - means.max():.5f} above the corners",
        f"enclosure: {float(least[0]):.5f} to {float(most[0]):.5f}",
    ]


FINDINGS = {"rooms": rooms, "oscillator": oscillator, "samples": samples}


if __name__ == "__main__":
    for chosen in sys.argv[1:] or FINDINGS:
        print("\n".join([f"{chosen}:", *FINDINGS[chosen]()]))
