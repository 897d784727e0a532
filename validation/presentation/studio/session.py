"""What all tabs of one page share: the text, what it shows, and the certificate. Every change has a number.

Nothing here reads what users write: that is done in processes of their own, so that an answer is given at any time.
"""

from __future__ import annotations

import secrets
import threading
import time
from pathlib import Path
from typing import Any

from .folder import TaskFile, place
from .process import Worker
from .toml_edits import edited

LOOKING = 30.0
"""Seconds after which the reading of a text is given up."""

MOST_TEXT = 400_000
"""Characters of a text."""

MOST_TOLD = 400
"""Points of the curve of bounds that are kept."""


class Refused(Exception):
    """The page asked for something that is not possible now; the message says why."""


class Session:
    """The state of a page.

    Parameters
    ----------
    folder : Path
    name : str
        The file in it that is edited; it need not exist.
    text : str, optional
        Text to begin with where it does not.
    """

    def __init__(self, folder: Path, name: str, text: str | None = None) -> None:
        self.folder, self.file = folder.resolve(), TaskFile(folder.resolve(), name)
        self.id = secrets.token_hex(8)
        self.closed = False
        self._changed = threading.Condition()
        self._version, self._revision = 0, 0
        self._text = (text or "") if self.file.known is None else self.file.known
        self._seen: dict[str, Any] | None = None
        self._seen_revision = -1
        self._waiting = False
        self._looking_since: float | None = None
        self._job: dict[str, Any] = {"state": "none", "number": 0}
        self._run: dict[str, Any] | None = None
        self._kept = False
        self._giving = False
        self._message = ""
        self._looker = Worker(self._hear_look)
        self._computer: Worker | None = None
        threading.Thread(target=self._watch, daemon=True).start()
        with self._changed:
            self._look()

    def close(self) -> None:
        """End all processes, and answer whoever waits."""
        with self._changed:
            if self.closed:
                return
            self.closed = True
            self._touch()
        self._looker.close()
        if self._computer is not None:
            self._computer.close()

    # What the page sees.

    def state(self, since: int, timeout: float) -> dict[str, Any]:
        """Return the state as soon as it is another than the one with this number, or after the timeout."""
        with self._changed:
            self._changed.wait_for(lambda: self._version != since or self.closed, timeout)
            return {
                "session": self.id,
                "version": self._version,
                "revision": self._revision,
                "text": self._text,
                "file": {"name": self.file.name, "folder": str(self.folder), "saved": self.file.known == self._text}
                | {"exists": self.file.known is not None},
                "seen": self._seen,
                "current": self._seen_revision == self._revision,
                "job": self._job,
                "run": self._run,
                "message": self._message,
            }

    def _worker(self) -> Worker:
        """Return the process that computes; it is begun once the first text was read, which comes first."""
        if self._computer is None:
            self._computer = Worker(self._hear_work)
            self._computer.send({"job": "ready", "number": -1})
        return self._computer

    def _touch(self) -> None:
        self._version += 1
        self._changed.notify_all()

    # The text.

    def _is_newest(self, base: Any) -> bool:
        """Whether a tab knows the text as it is; True is no revision, although Python takes it for 1."""
        return type(base) is int and base == self._revision

    def put_text(self, text: Any, base: Any) -> None:
        """Take a text from a tab that knew revision `base`; Refused if another tab was faster."""
        if not isinstance(text, str) or len(text) > MOST_TEXT:
            raise ValueError(f"`text`: expected at most {MOST_TEXT} characters")
        with self._changed:
            if not self._is_newest(base) and text != self._text:
                raise Refused("the text was changed in another tab")
            self._set(text)

    def edit(self, edit: Any, base: Any) -> None:
        """Change the text as the picture asks; Refused if it is about another text."""
        with self._changed:
            if not self._is_newest(base):
                raise Refused("the text was changed in another tab")
            try:
                self._set(edited(self._text, edit))
            except (ValueError, RecursionError) as error:
                raise ValueError(" ".join(str(error).split())) from None

    def _set(self, text: str) -> None:
        if text == self._text:
            return
        self._text, self._message = text, ""
        self._revision += 1
        self._look()
        self._touch()

    def _look(self) -> None:
        """Have the text read; while one is being read, only the newest of those that follow waits."""
        if self._looking_since is not None:
            self._waiting = True
            return
        self._waiting, self._looking_since = False, time.monotonic()
        job = {"job": "look", "number": self._revision, "text": self._text}
        self._looker.send(job | {"source": self.file.name, "folder": str(self.folder)})

    def _hear_look(self, message: dict[str, Any]) -> None:
        with self._changed:
            self._looking_since = None
            if "seen" in message:
                old = self._seen
                self._seen, self._seen_revision = message["seen"], message["number"]
                if old is not None and self._seen["picture"] is None:
                    # What was drawn last stays until something can be drawn again.
                    self._seen["picture"], self._seen["faded"] = old["picture"], True
            else:
                self._fail(message.get("failed", "the process that reads the text has ended"))
            if self._waiting or self._seen_revision != self._revision:
                self._look()
            if not self.closed:
                self._worker()
            self._touch()

    def _fail(self, why: str) -> None:
        error = {"message": why, "mark": None, "line": None, "column": None}
        old = self._seen or {"picture": None, "facts": None, "formula": None, "fingerprint": None}
        self._seen, self._seen_revision = {**old, "error": error, "faded": True}, self._revision
        self._waiting = False

    def _watch(self) -> None:
        """Give up the reading of a text that takes too long."""
        while not self.closed:
            time.sleep(1.0)
            with self._changed:
                since = self._looking_since
                if since is None or time.monotonic() - since < LOOKING or self.closed:
                    continue
                self._looking_since = None
                self._looker.replace()
                waited = self._waiting
                self._fail(f"reading this took more than {LOOKING:.0f} s and was given up; ask for less")
                if waited:
                    self._look()
                self._touch()

    # Certifying and playing.

    def certify(self, seconds: Any) -> None:
        """Begin to certify the text."""
        if seconds is not None and not (type(seconds) in (int, float) and 0 < seconds <= 86_400):
            raise ValueError("`seconds`: expected a number from 0 to 86400")
        with self._changed:
            if self._job["state"] in ("running", "stopping", "playing"):
                raise Refused("something is being computed already; stop it first")
            number = self._job["number"] + 1
            kept = self._job.get("result") if self._job["state"] == "done" else None
            self._job = {"state": "running", "number": number, "told": [], "now": None, "result": None, "before": kept}
            self._job |= {"revision": self._revision}
            job = {"job": "certify", "number": number, "text": self._text, "seconds": seconds}
            self._worker().send(job | {"source": self.file.name, "folder": str(self.folder)})
            self._touch()

    def stop(self) -> None:
        """Break off what is being computed; the second time at once, whatever it does."""
        with self._changed:
            state = self._job["state"]
            if state in ("running", "playing"):
                self._job |= {"state": "stopping"}
                self._worker().stop()
            elif state == "stopping":
                self._worker().replace()
                self._end("stopped at once")
            self._touch()

    def play(self, seed: Any) -> None:
        """Simulate the certified controllers."""
        if type(seed) is not int or not 0 <= seed < 2**31:
            raise ValueError("`seed`: expected a whole number from 0 on")
        with self._changed:
            if self._job["state"] != "done" or not self._job.get("result"):
                raise Refused("there is nothing to play; certify first")
            self._job |= {"state": "playing"}
            self._worker().send({"job": "play", "number": self._job["number"], "seed": seed})
            self._touch()

    def _hear_work(self, message: dict[str, Any]) -> None:
        with self._changed:
            if "told" in message:
                if message["told"] == self._job["number"]:
                    self._take_told(message)
            elif "died" in message:
                self._give_back()
                if self._job["state"] in ("running", "stopping", "playing"):
                    self._end("the process that computes has ended; is there enough memory?")
            elif message["done"] in ("ready", "take"):
                self._giving = False  # one is ready after it has taken what it begins with
                return
            elif message["done"] == "save":
                self._message = (
                    f"saved {message['saved']}" if "saved" in message else message.get("failed", "not saved")
                )
            elif message["done"] == "maps":
                if message["number"] == self._job["number"] and self._job["result"] and "maps" in message:
                    self._job["result"] = self._job["result"] | {"maps": message["maps"]}
            elif message["number"] == self._job["number"]:
                self._take_done(message)
            self._touch()

    def _take_told(self, message: dict[str, Any]) -> None:
        """Keep a message about the search: the newest, and a curve of bounds over time."""
        job = self._job
        now = {**(job["now"] or {}), **{key: value for key, value in message.items() if key != "told"}}
        now["way"] = message["way"] or (job["now"] or {}).get("way", "")
        curve = [*job["told"], [round(message["seconds"], 3), message["bound"]]]
        self._job = job | {"now": now, "told": curve if len(curve) <= MOST_TOLD else [*curve[::2], curve[-1]]}

    def _take_done(self, message: dict[str, Any]) -> None:
        if message["done"] == "play":
            self._job |= {"state": "done"}
            if "panels" in message:
                self._run = {"number": message["number"]} | {k: v for k, v in message.items() if k != "done"}
            else:
                self._message = message.get("failed", "stopped")
            return
        if "certificate" not in message:
            self._end(message.get("failed", "stopped before anything was certified"))
            return
        stopped = self._job["state"] == "stopping"
        self._worker().begin_with({"job": "take", "number": -1, "kept": message["kept"]})
        self._kept = True
        result = message["certificate"] | {"valid": message["valid"], "failures": message["failures"]}
        result |= {"seconds": message["seconds"], "stopped": stopped}
        self._job |= {"state": "done", "result": result, "before": None, "why": ""}
        self._run = None
        self._worker().send({"job": "maps", "number": message["number"]})

    def _give_back(self) -> None:
        """Hand the last certificate to a new process: the one that had it is gone."""
        if self._giving:
            # The new one has ended, too: it would go on like that.
            self._kept, self._giving = False, False
            self._worker().begin_with(None)
            self._job |= {"state": "failed", "result": None, "before": None, "why": "the certificate was lost"}
        if self._kept and not self.closed:
            self._giving = True
            self._worker().send({"job": "ready", "number": -1})

    def _end(self, why: str) -> None:
        """Note that what was begun gave nothing; what was certified before is kept."""
        before = self._job.get("result") or self._job.get("before")
        state = {"state": "done", "result": before} if before else {"state": "failed", "result": None}
        self._job |= {**state, "why": why}

    # Files.

    def save(self, anyway: bool) -> None:
        """Write the text to its file; Refused if the file was changed by somebody else."""
        with self._changed:
            if not self.file.save(self._text, anyway):
                raise Refused("the file was changed by another program since it was read; save again to replace it")
            self._message = f"saved {self.file.name}"
            self._touch()

    def save_certificate(self, name: Any) -> None:
        """Write the certificate, a report about it, or an animation of it."""
        path = place(self.folder, name, ".npz", ".html", ".gif")
        with self._changed:
            if self._job["state"] != "done" or not self._job.get("result"):
                raise Refused("there is no certificate; certify first")
            self._worker().send({"job": "save", "number": self._job["number"], "path": str(path)})
            if path.suffix != ".npz":
                self._message = f"{path.name} is being written"
                self._touch()
