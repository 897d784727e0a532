"""The process that reads tasks, certifies them and simulates, so that the page answers at any time.

It has one job at a time and talks through a pipe. Breaking off is what Ctrl-C does in the command line: the search
returns the best certificate so far.
"""

from __future__ import annotations

import os
import queue
import signal
import threading
import time
from _thread import interrupt_main
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.pictures import AGENTS, panels
from ...envs.problem import problem_from_toml
from ...synthesis.certificates import Synthesis, rounded_down, rounded_up, save_certificate, shown_bound
from ...synthesis.checking import check
from ...synthesis.synthesize import synthesize
from ..simulation import Loop, paths, rollout
from .looking import MOST_PANELS, look

EPISODES = 24
"""Episodes that are played."""

COUNTED = 2000
"""Episodes from which the share of successes is estimated."""

MOST_CURVES = 40
"""Curves of one episode that are sent to the page."""

PAUSE = 0.1
"""Seconds between two messages about one search at least: sweeps may be shorter."""

Send = Callable[[dict[str, Any]], None]


@dataclass
class _Job:
    """Whether a job is under way, which Ctrl-C may break off."""

    busy: bool = False


def serve(pipe: Connection) -> None:
    """Do jobs from a pipe until it is closed."""
    if hasattr(os, "setsid"):
        os.setsid()  # Ctrl-C in the terminal is for the server, which then closes the pipe
    jobs: queue.Queue[dict[str, Any]] = queue.Queue()
    under_way = _Job()

    def on_signal(number: int, frame: object) -> None:
        if under_way.busy:
            raise KeyboardInterrupt

    signal.signal(signal.SIGINT, on_signal)
    threading.Thread(target=_listen, args=(pipe, jobs, under_way), daemon=True).start()
    desk = Desk(pipe.send)
    while True:
        job = jobs.get()
        answer: dict[str, Any] = {"broken": True}
        try:
            under_way.busy = True
            answer = _answer(desk, job)
            under_way.busy = False
        except KeyboardInterrupt:
            under_way.busy = False
        pipe.send({"done": job["job"], "number": job["number"], **answer})


def _answer(desk: Desk, job: dict[str, Any]) -> dict[str, Any]:
    """Return what a job gave, or why it gave nothing."""
    try:
        return desk.do(job)
    except (ValueError, OSError, MemoryError, OverflowError) as error:
        return {"failed": str(error) or type(error).__name__}
    except Exception as error:  # noqa: BLE001 a mistake of ours is told, and the page goes on
        return {"failed": f"unexpected {type(error).__name__}: {error}; please report it"}


def _listen(pipe: Connection, jobs: queue.Queue[dict[str, Any]], under_way: _Job) -> None:
    """Put jobs into the queue, and break off the one under way when that is asked for."""
    while True:
        try:
            job = pipe.recv()
        except (EOFError, OSError):
            os._exit(0)  # the server is gone
        if job["job"] != "stop":
            jobs.put(job)
        elif under_way.busy:
            interrupt_main()


class Desk:
    """What the jobs need of one another: the last synthesis."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self._result: Synthesis | None = None

    def do(self, job: dict[str, Any]) -> dict[str, Any]:
        """Do one job, and return what it gave."""
        kinds: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
            "look": self._look,
            "certify": self._certify,
            "play": self._play,
            "save": self._save,
        }
        return kinds[job["job"]](job)

    def _look(self, job: dict[str, Any]) -> dict[str, Any]:
        return {"seen": look(job["text"], job["source"], Path(job["folder"]))}

    def _certify(self, job: dict[str, Any]) -> dict[str, Any]:
        """Certify a text, and tell on the way what the terminal shows."""
        problem = problem_from_toml(job["text"], job["source"], Path(job["folder"]))
        telling = _Telling(self._send, job["number"])
        result = synthesize(problem, progress=telling, seconds=job.get("seconds"))
        self._result = result
        told = {"certificate": result_facts(result), "seconds": telling.elapsed}
        try:
            telling("way: the separate check", result.certificate.lower_bound)
            report = check(result.certificate)
            return told | {"valid": bool(report), "failures": list(report.failures)[:3]}
        except KeyboardInterrupt:
            return told | {"valid": None, "failures": []}

    def _play(self, job: dict[str, Any]) -> dict[str, Any]:
        """Simulate the certified controllers, and return paths on the panels of the page."""
        assert self._result is not None
        problem = self._result.certificate.problem
        states, success = paths(Loop(problem, self._result.controller, job["seed"], EPISODES), EPISODES)
        counted = rollout(problem, self._result, COUNTED, seed=job["seed"] + 1)
        shown = []
        for panel in panels(problem)[:MOST_PANELS]:
            tracks = [(c.number % len(AGENTS), states @ c.rows.T) for c in panel.curves[:MOST_CURVES]]
            shown.append([{"color": color, "paths": _lists(track)} for color, track in tracks])
        return {
            "panels": shown,
            "success": success.tolist(),
            "lengths": (~np.isnan(states[:, :, 0])).sum(axis=0).tolist(),
            "estimate": counted.successes / counted.episodes,
            "episodes": counted.episodes,
            "seed": job["seed"],
        }

    def _save(self, job: dict[str, Any]) -> dict[str, Any]:
        assert self._result is not None
        save_certificate(self._result.certificate, job["path"])
        return {"saved": Path(job["path"]).name}


class _Telling:
    """Passes progress on: each way and level, the best bound so far, and what the search under way has reached."""

    def __init__(self, send: Send, number: int) -> None:
        self._send, self._number = send, number
        self._began, self._last = time.monotonic(), 0.0
        self._bound = 0.0

    @property
    def elapsed(self) -> float:
        return time.monotonic() - self._began

    def __call__(self, text: str, value: float) -> None:
        begins = text.startswith("way: ")
        self._bound = max(self._bound, value) if begins else self._bound
        if not begins and self.elapsed - self._last < PAUSE:
            return
        self._last = self.elapsed
        said = text.removeprefix("way: ") if begins else None
        told = {"way": said, "search": None if begins else float(value), "seconds": self.elapsed}
        self._send({"told": self._number, "bound": self._bound, "shown": rounded_down(self._bound), **told})


def _lists(track: np.ndarray) -> list[list[Any]]:
    """Return the paths (T + 1, M, k) episode by episode, each up to its decision."""
    ends = (~np.isnan(track[:, :, 0])).sum(axis=0)
    return [np.round(track[: ends[m], m], 5).tolist() for m in range(track.shape[1])]


def result_facts(result: Synthesis) -> dict[str, Any]:
    """Return what the page says of a synthesis: printed lower bounds are rounded down, upper ones up."""
    certificate: Any = result.certificate
    above: Any = result.stats.get("continuous_upper_bound")
    tried: Any = result.stats.get("tried") or {}
    return {
        "lower_bound": certificate.lower_bound,
        "shown": rounded_down(certificate.lower_bound),
        "claim": shown_bound(certificate.lower_bound, certificate.gap),
        "above": above,
        "above_shown": None if above is None else rounded_up(above),
        "method": certificate.method,
        "start": certificate.start,
        "fingerprint": certificate.problem.fingerprint,
        "nothing": result.stats.get("nothing"),
        "tried": [[name, rounded_down(x) if isinstance(x, float) else str(x)] for name, x in tried.items()],
    }
