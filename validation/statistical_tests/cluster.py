"""Executors for rollouts: local processes, and Dask distributed (the extra ``distributed``).

Both give the same numbers as no executor, bit by bit. Dask runs the jobs of a killed worker again.
"""

from __future__ import annotations

import logging
import os
import pickle
import signal
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

from ...envs.systems.arguments import checked_count
from .spread import Executor

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""What libraries of linear algebra read when they are loaded: how many threads they use."""


@dataclass(frozen=True, eq=False)
class DaskExecutor:
    """An executor on a Dask cluster.

    Parameters
    ----------
    client : distributed.Client or str
        A client, or the address of a scheduler, for which a client is opened.

    Raises
    ------
    ValueError
        If `client` is neither, or if Dask distributed is not installed.

    Examples
    --------
    ``validate(certificate, executor=DaskExecutor("tcp://head:8786"))``
    """

    client: Any

    def __post_init__(self) -> None:
        if isinstance(self.client, str):
            object.__setattr__(self, "client", _client_of(self.client))
        if not hasattr(self.client, "submit"):
            raise ValueError(f"`client`: expected a Dask client or the address of a scheduler, got {self.client!r}")

    def share(self, shared: Any) -> Any:
        """Send an object that all jobs share, and return its future.

        The object is the result of a task: if the worker that holds it is lost, another worker computes it again.
        """
        data = pickle.dumps(shared, protocol=pickle.HIGHEST_PROTOCOL)
        with warnings.catch_warnings():  # Dask warns of large arguments, but this one is sent once
            warnings.filterwarnings("ignore", message="(?s)Sending large graph", category=UserWarning)
            return self.client.submit(pickle.loads, data, pure=False)

    def submit(self, function: Callable[..., Any], /, *arguments: Any) -> Any:
        """Start ``function(*arguments)`` on some worker and return a future."""
        return self.client.submit(function, *arguments, pure=False, retries=3)


@contextmanager
def dask_cluster(address: str, workers: int | None = None) -> Iterator[DaskExecutor]:
    """Open an executor on the scheduler at ``address``, or on new worker processes of this machine for ``local``.

    Raises
    ------
    ValueError
        If Dask distributed is not installed, or the number of workers is not a positive whole number.
    OSError
        If no scheduler answers.
    """
    if address != "local":
        with _client_of(address) as client:
            yield DaskExecutor(client)
        return
    Client, LocalCluster = _distributed()
    settings = {"n_workers": _checked_workers(workers), "threads_per_worker": 1, "processes": True}
    with LocalCluster(**settings, dashboard_address=":0") as local, Client(local, set_as_default=False) as client:
        client.run(_ignore_interrupts)
        yield DaskExecutor(client)


def _client_of(address: str) -> Any:
    """Return a client of the scheduler at an address."""
    Client, _ = _distributed()
    return Client(address, timeout="15s", set_as_default=False)


def _distributed() -> tuple[Any, Any]:
    """Return the classes of Dask's client and local cluster; raise ValueError if Dask distributed is not installed."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise ValueError("`--dask`: needs Dask distributed; pip install 'certigym[distributed]'") from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # lost workers are expected and dealt with
    return Client, LocalCluster


@contextmanager
def processes(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Open an executor on ``workers`` new processes of this machine; Ctrl-C reaches the calling process alone.

    Each has one thread for its linear algebra: those of several processes would wait for one another.
    """
    count = _checked_workers(workers)
    pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_ignore_interrupts)
    try:
        with _children_ignore_interrupts(), _children_have_one_thread():
            # No process is idle yet, so each of these jobs starts one.
            for started in [pool.submit(int) for _ in range(workers)]:
                started.result()
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def executor_for(dask: str | None, workers: int | None) -> Iterator[Executor | None]:
    """Open the executor that ``--dask`` and ``--workers`` ask for; None for this process alone."""
    if dask is not None:
        with dask_cluster(dask, workers) as cluster:
            yield cluster
    elif (count := _checked_workers(workers)) is not None and count > 1:
        with processes(count) as pool:
            yield pool
    else:
        yield None


@contextmanager
def _children_ignore_interrupts() -> Iterator[None]:
    """Let processes that are started meanwhile ignore Ctrl-C, which a terminal sends to all processes."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _children_have_one_thread() -> Iterator[None]:
    """Let libraries of linear algebra use one thread in processes that are started meanwhile, unless the user says."""
    # They read these names when they are loaded, which no initializer comes before.
    added = [name for name in THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


def _ignore_interrupts() -> None:
    """Make this process ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _checked_workers(workers: int | None) -> int | None:
    """Return a number of workers, or None; raise ValueError if it is not a positive whole number."""
    return None if workers is None else checked_count(workers, "workers")
