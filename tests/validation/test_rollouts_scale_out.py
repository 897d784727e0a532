"""One worker or many, killed or interrupted: the same numbers, nothing lost, memory of the chunks under way only."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import OnGrid
from certigym.validation.presentation.reports.gathering import report
from certigym.validation.statistical_tests.cluster import dask_cluster, processes
from certigym.validation.statistical_tests.fields import find_weakest, validate_field
from certigym.validation.statistical_tests.loop import Loop
from certigym.validation.statistical_tests.rollouts import NUMBERS_SIDE_BY_SIDE, stream
from certigym.validation.statistical_tests.spread import in_order
from certigym.validation.statistical_tests.step_tests import audit
from certigym.validation.statistical_tests.stress_test import stress
from certigym.validation.statistical_tests.sweeps import sweep
from problems import two_agents

EPISODES, CHUNK = 21_300, 500


@pytest.fixture(scope="module")
def certificate() -> OnGrid:
    return cg.synthesize(two_agents("F (a & F c)", horizon=4, noise_covariance=[[0.8]]), 60).certificate


@pytest.fixture(scope="module")
def alone(certificate: OnGrid) -> np.ndarray:
    return cg.rollout(certificate.problem, certificate.controller, EPISODES, seed=3, chunk=CHUNK).success


def runs(certificate: OnGrid, executor: Any, progress: Callable[[int], None] | None = None) -> np.ndarray:
    return cg.rollout(
        certificate.problem, certificate.controller, EPISODES, seed=3, chunk=CHUNK, executor=executor, progress=progress
    ).success


class Backwards:
    """An executor that finishes what it was given last first."""

    def __init__(self) -> None:
        self.jobs: list[tuple[Future[Any], Any]] = []
        self.done: dict[Future[Any], Any] = {}
        self.most = 0

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Any:
        future: Future[Any] = Future()
        self.jobs.append((future, (function, arguments)))
        self.most = max(self.most, len(self.jobs))
        future.result = partial(self._result, future)  # type: ignore[method-assign]
        return future

    def _result(self, wanted: Future[Any], timeout: float | None = None) -> Any:
        while wanted not in self.done:
            future, (function, arguments) = self.jobs.pop()
            self.done[future] = function(*arguments)
        return self.done.pop(wanted)


def test_order_of_completion_does_not_matter(certificate: OnGrid, alone: np.ndarray) -> None:
    executor = Backwards()
    np.testing.assert_array_equal(runs(certificate, executor), alone)
    assert executor.most <= 32


@pytest.mark.thorough
def test_processes_give_the_same_bits_and_a_killed_one_loses_nothing(certificate: OnGrid, alone: np.ndarray) -> None:
    with processes(2) as pool:
        np.testing.assert_array_equal(runs(certificate, pool), alone)
        victims = list(pool._processes)

        def kill(_: int) -> None:
            if victims:
                os.kill(victims.pop(), signal.SIGKILL)
                victims.clear()

        with pytest.warns(RuntimeWarning, match="continuing in this process"):
            np.testing.assert_array_equal(runs(certificate, pool, kill), alone)


@pytest.mark.thorough
@pytest.mark.filterwarnings("default::ResourceWarning", "default::DeprecationWarning")
def test_dask_gives_the_same_bits_and_a_killed_worker_loses_nothing(certificate: OnGrid, alone: np.ndarray) -> None:
    pytest.importorskip("distributed")
    with dask_cluster("local", 2) as executor:
        np.testing.assert_array_equal(runs(certificate, executor), alone)
        victims = list(executor.client.run(os.getpid).values())
        assert len(victims) == 2

        def kill(_: int) -> None:
            while len(victims) > 1:
                os.kill(victims.pop(), signal.SIGKILL)

        np.testing.assert_array_equal(runs(certificate, executor, kill), alone)
        assert len(victims) == 1
        states = [[0.3, 0.3], [1.5, 1.5]]
        field, same = (validate_field(certificate, states, 900, executor=e) for e in (executor, None))
        np.testing.assert_array_equal(field.successes, same.successes)


@pytest.mark.thorough
def test_rows_of_a_sweep_are_the_same_bits_on_workers_and_those_of_each_setting() -> None:
    problem = two_agents("F (a & F c)", horizon=4, noise_covariance=[[0.8]])
    over: dict[str, list[float]] = {"noise": [1.0, 0.5], "horizon": [3, 4]}

    def rows(executor: Any = None) -> list[dict[str, Any]]:
        found = [row.to_dict() for row in sweep(problem, over, 400, {"cells": 20}, seed=3, executor=executor)]
        assert all(row.pop("seconds") > 0.0 for row in found)
        return found

    here = rows()
    with processes(2) as pool:
        assert rows(pool) == here
    assert [row["changes"] for row in here] == [{"noise": s, "horizon": t} for s in (1.0, 0.5) for t in (3, 4)]
    alone = cg.synthesize(problem.replace(horizon=4, disturbance_scale=0.5), 20)
    assert here[-1]["lower_bound"] == alone.lower_bound
    assert here[-1]["successes"] == cg.validate(alone, 400, seed=3).successes


def test_a_setting_without_models_is_a_row_and_the_others_go_on() -> None:
    problem = cg.make_problem("invariance-v0")
    rows = [*sweep(problem, {"cells": [0, 10], "horizon": [1]}, 100, {"relation": "exact"})]
    assert [row.verdict == "refused" for row in rows] == [True, False] and "cells" in rows[0].method


@pytest.mark.thorough
def test_memory_does_not_grow_with_the_number_of_rollouts(certificate: OnGrid) -> None:
    loop = Loop(certificate.problem, certificate.controller, 0, CHUNK)

    def peak(episodes: int) -> int:
        tracemalloc.start()
        assert sum(int(part.success.sum()) for part in stream(loop, episodes)) > 0
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(CHUNK)
    few, many = peak(NUMBERS_SIDE_BY_SIDE), peak(8 * NUMBERS_SIDE_BY_SIDE)
    assert many < 1.2 * few + 50_000


def test_every_verb_keeps_what_was_finished(certificate: OnGrid, tmp_path: Path) -> None:
    states = [[0.3, 0.3], [1.0, 1.0]]
    search = find_weakest(certificate, 40_000, candidates=states, chunk=CHUNK, progress=_interrupt_at_once())
    assert search.interrupted and search.episodes.sum() == CHUNK
    seen: list[int] = []

    def interrupt(count: int) -> None:
        seen.append(count)
        if len(seen) == 3:
            raise KeyboardInterrupt

    audited = audit(certificate, EPISODES, chunk=CHUNK, progress=interrupt)
    assert audited.interrupted and audited.episodes == 3 * CHUNK
    seen.clear()
    stressed = stress(certificate, CHUNK, chunk=CHUNK, progress=interrupt)
    assert stressed.interrupted and len(stressed.rungs) == 1
    seen.clear()
    page = report(certificate, tmp_path / "page.html", EPISODES, chunk=CHUNK, progress=interrupt)
    assert page.validation.details["interrupted"] and page.validation.episodes == 3 * CHUNK


def _interrupt_at_once() -> Callable[[int], None]:
    def interrupt(_: int) -> None:
        raise KeyboardInterrupt

    return interrupt


DRIVER = """
import signal
import sys
import certigym.cli.work as commands
from certigym.cli.main import main
class Bar(commands.tqdm):
    def update(self, n=1):
        print("tick", flush=True)
        return super().update(n)
commands.tqdm = Bar
if __name__ == "__main__":
    # A script that runs the tests in its background ignores SIGINT, and all that is started from there inherits that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.thorough
@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
@pytest.mark.parametrize("place", [[], ["--workers", "2"]], ids=str)
def test_control_c_leaves_a_report(certificate: OnGrid, tmp_path: Path, place: list[str]) -> None:
    """SIGINT to the whole process group, as a terminal sends it."""
    cg.save(certificate, tmp_path / "c.npz")
    (tmp_path / "driver.py").write_text(DRIVER)
    out = tmp_path / "r.json"
    command = [
        sys.executable,
        str(tmp_path / "driver.py"),
        "validate",
        str(tmp_path / "c.npz"),
        "--episodes",
        "500000000",
        "--json",
        str(out),
        *place,
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as run:
        assert run.stdout is not None and run.stderr is not None
        for _ in range(20):
            assert run.stdout.readline() == "tick\n", run.stderr.read()
        os.killpg(run.pid, signal.SIGINT)
        try:
            printed, said = run.communicate(timeout=30)
        finally:
            if run.poll() is None:
                os.killpg(run.pid, signal.SIGKILL)
    assert run.returncode == 130, (printed, said)
    report = json.loads(out.read_text())
    assert report["interrupted"] and report["episodes"] >= 20 * 2000 and report["verdict"] == "consistent"
    assert "Traceback" not in said, said
    again = cg.rollout(certificate.problem, certificate.controller, report["episodes"])
    assert again.successes == report["successes"]


def test_broken_executors_hand_over_without_losing_jobs() -> None:
    class Breaks:
        left = 3

        def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Any:
            self.left -= 1
            if self.left < 0:
                raise BrokenExecutor("gone")
            future: Future[Any] = Future()
            if self.left == 0:
                future.set_exception(BrokenExecutor("gone"))
            else:
                future.set_result(function(*arguments))
            return future

    with pytest.warns(RuntimeWarning, match="gone"):
        assert list(in_order(_plus, 10, range(50), Breaks())) == list(range(10, 60))


def _plus(a: int, b: int) -> int:
    return a + b


def test_errors_of_jobs_are_raised_and_the_rest_cancelled() -> None:
    cancelled = []

    class Slow:
        def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Any:
            future: Future[Any] = Future()
            future.cancel = lambda: cancelled.append(1) or True  # type: ignore[method-assign, func-returns-value]
            future.set_exception(ValueError("bad job"))
            return future

    with pytest.raises(ValueError, match="bad job"):
        list(in_order(_plus, 1, range(100), Slow(), ahead=8))
    assert len(cancelled) == 8
