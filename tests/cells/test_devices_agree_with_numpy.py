"""Sweeps on the arrays of another library give numpy's values to rounding, and certificates that are checked alike."""

from __future__ import annotations

import gc
import os
import weakref
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import certigym as cg
from certigym.cli.main import main
from certigym.envs.systems.backends import beside, device_put, libraries, to_host
from certigym.synthesis.abstraction.kernels.kernel import AxisTable, Kernel, gaussian_table
from certigym.synthesis.abstraction.models.action_tables import Policies
from certigym.synthesis.abstraction.models.joint import join, start_of
from certigym.synthesis.certificates.value_functions.devices import Residents, add_rows, add_runs, concatenate, take
from certigym.synthesis.policy_search.ascent.coordinate_ascent import Sweep, resting_policies, sweep
from certigym.synthesis.policy_search.ascent.limits import Limits
from certigym.synthesis.policy_search.ascent.occupancy import forward
from certigym.synthesis.policy_search.bounds.certified import robust_loss
from certigym.synthesis.verbs.abstract import abstract
from kinds import mostly_thorough

DEVICE = os.environ.get("CERTIGYM_DEVICE", "torch:cpu")
"""`CERTIGYM_DEVICE=torch:cuda` or `cupy` tests an accelerator of this machine."""

CLOSE = 1e-11
"""Relative difference allowed: far below the reserve for rounding, 1e-11 per agent and ten more."""

TASKS: dict[str, tuple[cg.Problem, dict[str, Any]]] = {
    "reach-avoid": (cg.make_problem("reach-avoid-v0"), {"cells": 200}),
    "several terms": (cg.make_problem("package-delivery-v0", horizon=12), {"cells": 60}),
    "planar": (cg.make_problem("reach-avoid-planar-v0"), {"cells": 30}),
    "many agents": (cg.make_problem("invariance-b-20-v0"), {"cells": 40}),
    "menu of inputs": (cg.make_problem("reach-avoid-v0"), {"cells": 200, "relation": "paper"}),
}


@pytest.fixture(autouse=True)
def _torch() -> None:
    pytest.importorskip(DEVICE.partition(":")[0])
    pytest.importorskip("array_api_compat")


def swept(name: str, device: str, policies: Policies | None, **how: Any) -> Sweep:
    problem, model = TASKS[name]
    joint = join(problem, abstract(problem, **model), device)
    if policies is None:
        return sweep(joint, resting_policies(joint), None, Limits(), improve=True)
    return sweep(joint, policies, start_of(problem, joint), Limits(), **how)


@mostly_thorough("name", TASKS, first=2)
def test_frozen_sweeps_agree_to_rounding(name: str) -> None:
    policies = swept(name, "numpy", None).policies
    ours, theirs = (swept(name, device, policies, improve=False) for device in ("numpy", DEVICE))
    assert 0.0 < ours.value == pytest.approx(theirs.value, rel=CLOSE)
    assert theirs.rank == ours.rank and theirs.dropped == pytest.approx(ours.dropped, rel=1e-6, abs=1e-15)
    for mine, other in zip(ours.terms.factors, theirs.terms.factors, strict=True):
        assert type(other) is np.ndarray and other.dtype == np.float64
        np.testing.assert_allclose(other, mine, rtol=CLOSE, atol=1e-300)
    for one, two in zip(ours.merge_log, theirs.merge_log, strict=True):
        for rows, others in zip((*one.origin, *one.kept), (*two.origin, *two.kept), strict=True):
            np.testing.assert_array_equal(rows, others)


@mostly_thorough("name", TASKS)
def test_best_responses_gain_the_same(name: str) -> None:
    """Choices may differ where two are worth the same to rounding; what they are worth may not."""
    policies = swept(name, "numpy", None).policies
    ours, theirs = (swept(name, device, policies, improve=True) for device in ("numpy", DEVICE))
    assert 0.0 < ours.value == pytest.approx(theirs.value, rel=1e-8)


def test_occupancies_and_robust_losses_agree() -> None:
    name = "menu of inputs"
    problem, model = TASKS[name]
    policies = swept(name, "numpy", None).policies
    ours, theirs = (swept(name, device, policies, improve=False, loss=robust_loss) for device in ("numpy", DEVICE))
    assert 0.0 < ours.value == pytest.approx(theirs.value, rel=CLOSE)
    joints = [join(problem, abstract(problem, **model), device) for device in ("numpy", DEVICE)]
    masses = [forward(joint, policies, start_of(problem, joint), Limits()) for joint in joints]
    for mine, other in zip(*masses, strict=True):
        for q in range(joints[0].n_states):
            assert mine.masses(q).sum() == pytest.approx(other.masses(q).sum(), rel=CLOSE, abs=1e-300)


@mostly_thorough("relation", ["auto", "paper"])
def test_certificates_agree_and_are_checked(relation: str) -> None:
    problem = cg.make_problem("reach-avoid-v0")
    ours, theirs = (
        cg.synthesize(problem, 150, relation=relation, search=cg.SearchOptions(device=device))
        for device in ("numpy", DEVICE)
    )
    assert theirs.certificate.lower_bound == pytest.approx(ours.certificate.lower_bound, rel=1e-8)
    assert cg.check(theirs.certificate, problem)
    runs = cg.rollout(problem, theirs.controller, 2000)
    assert runs.inadmissible == 0 and runs.successes > 0


def test_the_command_line_takes_a_device(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "c.npz")
    assert main(["synthesize", "reach-avoid-v0", "--cells", "60", "--device", DEVICE, "--out", out]) == 0
    assert "reach-avoid-v0" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("device", "message"),
    [
        ("abacus", "expected `numpy`, `torch:cpu`"),
        (3, "expected `numpy`, `torch:cpu`"),
        ("torch:abacus", "expected one that is there"),
        ("torch:meta", "expected one that is there"),
    ],
)
def test_devices_that_are_not_there_are_refused(device: Any, message: str) -> None:
    for relation in ("auto", "best"):
        with pytest.raises(ValueError, match=message):
            cg.synthesize(
                cg.make_problem("reach-avoid-v0"), 20, relation=relation, search=cg.SearchOptions(device=device)
            )


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name, name=name)

    monkeypatch.setattr(libraries.importlib, "import_module", missing)
    with pytest.raises(ValueError, match=r"needs array_api_compat.*certigym\[device\]"):
        device_put("torch:cpu")


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 12), st.integers(1, 5), st.integers(0, 10**6))
def test_rows_are_taken_and_added_alike(n: int, m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values, number = rng.random((n, m)), rng.integers(0, 4, size=n)
    there = device_put(DEVICE)(values)
    np.testing.assert_allclose(to_host(add_rows(there, number, 4)), add_rows(values, number, 4), rtol=1e-14)
    starts = np.unique(np.append(0, rng.integers(0, n, size=3)))
    np.testing.assert_allclose(to_host(add_runs(there, starts)), add_runs(values, starts), rtol=1e-14)
    np.testing.assert_array_equal(to_host(take(there, number % n)), values[number % n])
    np.testing.assert_array_equal(to_host(take(there, number % m, axis=1)), values[:, number % m])
    np.testing.assert_array_equal(to_host(concatenate([there, there])), np.concatenate([values, values]))


def test_kernels_smooth_and_push_alike() -> None:
    rng, edges = np.random.default_rng(5), np.linspace(-2.0, 2.0, 301)
    banded, _ = gaussian_table(np.linspace(-2.5, 2.5, 500), edges, 0.1)
    assert len(banded.blocks) > 1
    plane = (banded, AxisTable.dense(gaussian_table(np.linspace(-1, 1, 7), np.linspace(-1, 1, 6), 0.3)[0].toarray()))
    for kernel in (Kernel((banded,)), Kernel(plane)):
        n_cells, n_points = int(np.prod(kernel.shape)), int(np.prod(kernel.lattice_shape))
        factors, masses = rng.random((7, n_cells)), rng.random((7, n_cells))
        policy = rng.integers(-1, n_points, size=n_cells)
        there = device_put(DEVICE)
        np.testing.assert_allclose(to_host(kernel.backup(there(factors))), kernel.backup(factors), rtol=1e-12)
        propagated = to_host(kernel.propagate(there(masses), policy))
        np.testing.assert_allclose(propagated, kernel.propagate(masses, policy), rtol=1e-11, atol=1e-60)


def test_tables_are_copied_once_and_forgotten_with_their_owner() -> None:
    residents, table, reference = Residents(), np.arange(6.0), device_put(DEVICE)(np.zeros(1))
    assert residents.beside(table, reference) is residents.beside(table, reference)
    assert len(residents.copies) == 1
    assert residents.beside(table, table) is table and beside(table, table) is table
    copy = weakref.ref(residents.beside(table, reference))
    del residents
    gc.collect()
    assert copy() is None
