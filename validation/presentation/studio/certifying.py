"""What the process of the page does with a task that it can read: it certifies it, and simulates what was certified.

Loaded when the first task is certified, so that texts are read before the rest of the package is there.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ....envs.interfaces import AGENTS, Panel, panels
from ....envs.tasks.problem import problem_from_toml
from ....synthesis.certificates.proofs import (
    Synthesis,
    in_runs,
    rounded_down,
    rounded_up,
    save_certificate,
    start_of_claim,
)
from ....synthesis.verbs.synthesize import synthesize
from ...statistical_tests import Loop, OddsScale, paths, rollout
from ..figures import Player, render_episode
from ..reports import bounds_of_starts, coordinates_of, report
from .looking import MOST_PANELS

EPISODES = 24
"""Episodes that are played."""

COUNTED = 2000
"""Episodes from which the share of successes is estimated."""

REPORTED, FPS = 20_000, 8
"""Episodes of a report, and control steps a second of an animation."""

MOST_MAPS, MAP_WORK = 4, 800
"""Agents of a panel with maps of their starts, and states of a path times starts that are checked for one of these."""

MOST_CURVES = 40
"""Curves of one episode that are sent to the page."""

PAUSE = 0.1
"""Seconds between two messages about one search at least: sweeps may be shorter."""

Send = Callable[[dict[str, Any]], None]


class Certifier:
    """What the jobs need of one another: the last certificate."""

    def __init__(self, send: Send) -> None:
        self._send = send
        self._certificate: Any = None

    def take(self, job: dict[str, Any]) -> dict[str, Any]:
        """Take the certificate of a process that is gone, as `certify` of that process gave it away."""
        self._certificate = pickle.loads(job["kept"])  # from a process of this page, through its own pipe
        return {}

    def certify(self, job: dict[str, Any]) -> dict[str, Any]:
        """Certify a text, and tell on the way what the terminal shows."""
        problem = problem_from_toml(job["text"], job["source"], Path(job["folder"]))
        telling = _Telling(self._send, job["number"])
        result = synthesize(problem, progress=telling, seconds=job.get("seconds"))
        self._certificate = result.certificate
        kept = pickle.dumps(result.certificate)
        told = {"certificate": result_facts(result), "seconds": telling.elapsed, "kept": kept}
        report = result.checked
        failures = [] if report is None else list(report.failures)[:3]
        return told | {"valid": None if report is None else report.valid, "failures": failures}

    def play(self, job: dict[str, Any]) -> dict[str, Any]:
        """Simulate the certified controllers, and return paths on the panels of the page."""
        problem, controller = self._certificate.problem, self._certificate.controller
        states, success = paths(Loop(problem, controller, job["seed"], EPISODES), EPISODES)
        counted = rollout(problem, controller, COUNTED, seed=job["seed"] + 1)
        shown = []
        for panel in panels(problem)[:MOST_PANELS]:
            shown.append(
                [
                    {
                        "color": curve.number % len(AGENTS),
                        "paths": _lists(states @ curve.rows.T),
                        "headings": None if curve.heading is None else _lists(states[:, :, curve.heading]),
                    }
                    for curve in panel.curves[:MOST_CURVES]
                ]
            )
        return {
            "panels": shown,
            "success": success.tolist(),
            "lengths": (~np.isnan(states[:, :, 0])).sum(axis=0).tolist(),
            "estimate": counted.successes / counted.episodes,
            "episodes": counted.episodes,
            "seed": job["seed"],
        }

    def maps(self, job: dict[str, Any]) -> dict[str, Any]:
        """Return of each panel what is certified from other starts of each agent: shades by odds, -1 where unknown."""
        problem = self._certificate.problem
        return {"maps": [self._maps_of(panel) if panel.is_map else [] for panel in panels(problem)[:MOST_PANELS]]}

    def _maps_of(self, panel: Panel) -> list[dict[str, Any]]:
        maps = []
        for curve in panel.curves[:MOST_MAPS]:
            if axes := coordinates_of(curve):
                starts, shape, _, bounds = bounds_of_starts(self._certificate, axes, MAP_WORK)
                odds = OddsScale.of(bounds[~np.isnan(bounds)])
                shades = [-1.0 if np.isnan(b) else round(odds.at(b), 3) for b in bounds]
                points = [np.unique(starts[:, k]) for k in axes]
                facts = {"points": [x.tolist() for x in points], "shades": shades, "shape": list(shape)}
                facts["ticks"] = [[name, odds.at(p)] for name, p in odds.ticks]
                facts["shown"] = ["" if np.isnan(b) else rounded_down(b) for b in bounds]
                maps.append({"color": curve.number % len(AGENTS), **facts})
        return maps

    def save(self, job: dict[str, Any]) -> dict[str, Any]:
        """Write the certificate, a report about it, or an animation of an episode, by the ending of the name."""
        path, certificate = Path(job["path"]), self._certificate
        if path.suffix == ".html":
            report(certificate, path, REPORTED)
        elif path.suffix == ".gif":
            render_episode(certificate.problem, [Player.of(path.stem, certificate)], str(path), 0, FPS)
        else:
            save_certificate(certificate, path)
        return {"saved": path.name}


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
    """Return the paths (T + 1, M, k), or numbers (T + 1, M), episode by episode, each up to its decision."""
    ends = (~np.isnan(track.reshape(*track.shape[:2], -1)[:, :, 0])).sum(axis=0)
    return [np.round(track[: ends[m], m], 5).tolist() for m in range(track.shape[1])]


def result_facts(result: Synthesis) -> dict[str, Any]:
    """Return what the page says of a synthesis: printed lower bounds are rounded down, upper ones up."""
    certificate: Any = result.certificate
    above: Any = result.stats.get("continuous_upper_bound")
    tried: Any = result.stats.get("tried") or {}
    return {
        "lower_bound": certificate.lower_bound,
        "shown": rounded_down(certificate.lower_bound),
        "claim": result.claim,
        "words": in_runs(certificate.lower_bound),
        "above": above,
        "above_shown": None if above is None else rounded_up(above),
        "method": certificate.proof.method,
        "start": start_of_claim(certificate),
        "fingerprint": certificate.problem.fingerprint,
        "nothing": result.stats.get("nothing"),
        "tried": [[name, rounded_down(x) if isinstance(x, float) else str(x)] for name, x in tried.items()],
    }
