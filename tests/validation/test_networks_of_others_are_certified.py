"""``certigym reproduce lograsm``: networks of a folder beside what was published, or where they are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from certigym.cli.main import main
from certigym.validation.presentation.paper.lograsm import BENCHMARKS


def a_network(folder: Path, name: str, gain: float) -> None:
    """A relu network that is ``-gain (0.6 x + 0.5 v)``, by both signs."""
    row = gain * np.array([[0.6], [0.5]])
    layers = {"kernel_0": np.hstack([row, -row]), "bias_0": np.zeros(2), "kernel_1": [[-1.0], [1.0]], "bias_1": [0.0]}
    arrays: dict[str, Any] = {key: np.asarray(value, dtype=np.float32) for key, value in layers.items()}
    np.savez(folder / name, **arrays)


def test_networks_are_certified_from_every_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a_network(tmp_path, "LinearSystem0_3.npz", 1.0)
    a_network(tmp_path, "LinearSystem0_4.npz", -1.0)  # away from the target
    a_network(tmp_path, "something_else.npz", 1.0)
    assert main(["reproduce", "lograsm", "--weights", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    printed = capsys.readouterr().out
    assert "| LinearSystem0_3 | 37 to 54 s | 1.1e-10 | 2 |" in printed
    assert "FAIL: LinearSystem0_4" in printed and "does not satisfy the task" in printed
    rows = json.loads((tmp_path / "out" / "lograsm.json").read_text(encoding="utf-8"))
    assert [row["failure"] <= 1e-6 for row in rows] == [True, False] and rows[0]["cells"] == 2


@pytest.mark.parametrize("name", BENCHMARKS)
def test_models_move_as_they_were_published(name: str) -> None:
    """Beside definitions written out by hand, at random states and inputs of the workspace."""
    benchmark, rng = BENCHMARKS[name], np.random.default_rng(0)
    agent = benchmark.problem(benchmark.starts[0]).agents[0]
    x, u = rng.uniform(-benchmark.limit, benchmark.limit, (2, 500)), rng.uniform(-1.0, 1.0, (agent.n_inputs, 500))
    if name.startswith("Linear"):
        expected = np.array([[1.0, 0.045], [0.0, 0.9]]) @ x + np.array([[0.45], [0.5]]) @ u
    elif name.startswith("MyPendulum"):
        v = 0.9 * x[1] + 0.75 * np.sin(x[0]) + 8.0 * u[0]
        expected = np.stack([x[0] + 0.05 * v, v])
    else:
        up = np.array([[0.0], [1.0]])
        first, second = (np.clip(np.linalg.norm(x - sign * up, axis=0) / 0.3, 0.0, 1.0) for sign in (1.0, -1.0))
        expected = x + 0.2 * (second * (2.0 * first * u + (1.0 - first) * up) - (1.0 - second) * up)
    assert np.allclose(agent.mean(x, u), expected, atol=1e-12)
