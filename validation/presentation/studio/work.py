"""The process that reads tasks, certifies them and simulates, so that the page answers at any time.

It has one job at a time and talks through a pipe. Breaking off is what Ctrl-C does in the command line: the search
returns the best certificate so far.
"""

from __future__ import annotations

import os
import queue
import signal
import threading
from _thread import interrupt_main
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from .looking import look

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
    """Who does the jobs: texts are read here, and all else by a `Certifier`, which is loaded when it is needed."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self._certifier: Any = None

    def do(self, job: dict[str, Any]) -> dict[str, Any]:
        """Do one job, and return what it gave."""
        if job["job"] == "look":
            return {"seen": look(job["text"], job["source"], Path(job["folder"]))}
        if self._certifier is None:
            from .certifying import Certifier

            self._certifier = Certifier(self._send)
        kinds = {name: getattr(self._certifier, name) for name in ("certify", "play", "maps", "save", "take")}
        # The first job of a process that computes is to be ready for the others.
        return {} if job["job"] == "ready" else kinds[job["job"]](job)
