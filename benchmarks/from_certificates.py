"""What does a certificate buy a learner? ``python benchmarks/from_certificates.py [--steps N] [--seeds N] [ID ...]``

PPO with the same seeds, settings and world steps, in six ways: alone; with the certified value in time as the potential
of the reward `shaped`; with episodes that begin anywhere, but where the certified value is at least a half; behind a
shield whose kept probability falls from nine tenths of the bound over a half to nothing; from a clone of the certified
controllers; and from a clone, behind that shield. Afterwards each actor plays 10,000 episodes, alone. Writes
docs/from_certificates.md, and beside it the numbers; rows that are there already stay. Needs the extra `rl`.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import certigym as cg
from certigym.envs.dynamics import Dynamics, Worlds, joint
from certigym.envs.interfaces import scattering, vector_env
from certigym.synthesis.certificates import rounded_down
from certigym.synthesis.shielding import shield_of
from probes import certificate_of

EPISODES = 10_000
IDS = ("needle-v0", "patrol-recharge-v0", "car-park-v0", "meeting-v0", "reach-avoid-planar-v0")
PAGE = Path(__file__).parents[1] / "docs" / "from_certificates.md"
FALLING = (0.9, 0.5, None)
"""Shares of the bound that the shield keeps, for a third of the steps each; in the last third there is none."""

TRIES = 5
"""How often a start of little value is drawn again."""


@dataclass(frozen=True, eq=False)
class CertifiedPotential:
    """The certified value in time, in the place of `shaping.Potential`; at the end of an episode it counts as 0."""

    value: Any
    dynamics: Dynamics

    def at(self, worlds: Worlds) -> np.ndarray:
        """Return lower bounds (M,) on the success probability of the certified controllers from here."""
        problem = self.dynamics.problem
        time = np.broadcast_to(worlds.time, worlds.q.shape)
        # At the horizon, and in a world that has failed, there is nothing left to reach.
        open_ = (time < problem.horizon) & ~worlds.failed & ~problem.automaton.absorbing[worlds.q]
        result = np.where(worlds.accepted, 1.0, 0.0)
        if open_.any():
            states = joint(self.dynamics, worlds)[open_]
            result[open_] = self.value.at(states, worlds.q[open_], time[open_])
        return result


def shaped(value: Any) -> Any:
    """Return what puts the certified value in the place of the potential, while it is active."""
    return patch.object(vector_env.Potential, "of", lambda dynamics: CertifiedPotential(value, dynamics))


def valued_starts(value: Any) -> Any:
    """Return what draws scattered starts again where the certified value is below a half, while it is active."""

    def drawn(dynamics: Dynamics, worlds: Worlds, chosen: np.ndarray, rng: Any) -> Worlds:
        for _ in range(TRIES):
            worlds = scattering.scattered(dynamics, worlds, chosen, rng)
            chosen = chosen & (CertifiedPotential(value, dynamics).at(worlds) < 0.5)
            if not chosen.any():
                break
        return worlds

    return patch.object(vector_env, "scattered", drawn)


def falling_shield(certificate: Any, steps: int, seed: int, warm: bool) -> Any:
    """Train behind a shield that keeps less and less, and at last without one."""
    before: str | None = None
    with tempfile.TemporaryDirectory() as folder:
        for k, share in enumerate(FALLING):
            shield = None if share is None else shield_of(certificate, share * certificate.lower_bound)
            start: dict[str, Any] = {"resume": before} if before else {"warm_start": certificate if warm else None}
            training = cg.train(
                certificate.problem, "ppo", steps // len(FALLING), seed, shield=shield, spread=0.0, **start
            )
            before = str(Path(folder) / str(k))
            training.save(before)
    return training


def trained(way: str, certificate: Any, value: Any, steps: int, seed: int) -> Any:
    """Train in one of the ways; return the training."""
    settings: dict[str, Any] = {}
    with ExitStack() as stack:
        if way == "shaped by the value":
            stack.enter_context(shaped(value))
            settings = {"reward": "shaped"}
        elif way == "starts of value":
            stack.enter_context(valued_starts(value))
        elif way == "falling shield":
            return falling_shield(certificate, steps, seed, warm=False)
        elif way == "cloned, falling shield":
            return falling_shield(certificate, steps, seed, warm=True)
        elif way == "cloned":
            settings = {"warm_start": certificate}
        return cg.train(certificate.problem, "ppo", steps, seed, **settings)


WAYS = ("alone", "shaped by the value", "starts of value", "falling shield", "cloned", "cloned, falling shield")


HEAD = """# What a certificate buys a learner

PPO of `certigym train` with the same seeds, settings and world steps, in six ways. Only the first is without help.

- **alone**: the defaults, nothing from the certificate;
- **shaped by the value**: the reward `shaped`, with the certified value in time ([`cg.value_in_time`](api/index.md)) as
  its potential, which keeps the optimal policies;
- **starts of value**: half of the episodes of the first phase begin anywhere, as by default, but where the certified
  value is at least a half (a curriculum by the value in time);
- **falling shield**: a third of the steps behind a [shield](how-to/shields.md) that keeps .9 of the bound, a third
  behind one that keeps .5, and a third without any;
- **cloned**: from a clone of the certified controllers (imitation);
- **cloned, falling shield**: both.

Afterwards every actor plays {episodes:,} episodes alone, on common random numbers. Each training has {steps:,} world
steps, which is little: the defaults have 1,500,000. Made by `python benchmarks/from_certificates.py`; the numbers are
also in `from_certificates.json`.

What was found on five problems with five seeds each (four in some rows): only the clone matters. From it all seeds come
near what is certified or above it, behind the shield as well as without, and behind it in a third of the time or less.
(The episodes that the clone is fitted to are not among the world steps.) The certified value as a potential changes
nothing on one problem and spoils three, on which every seed stays at 0; starts where the value is large change little;
on `meeting-v0` nothing but the clone succeeds at all. After a shield that fell away no actor was better than
alone, and most were worse, or failed. Why was not tested.

![Success after {steps:,} world steps by problem and way, a dot for each seed](figures/from_certificates.png)

| problem | certified | way | success, a number for each seed | mean | seconds of training, mean |
|---|---|---|---|---|---|
"""


def page_of(rows: list[dict[str, Any]]) -> str:
    """Return the page: a row for each problem and way."""
    lines = [HEAD.format(episodes=EPISODES, steps=rows[0]["steps"])]
    for id in dict.fromkeys(row["id"] for row in rows):
        for way in WAYS:
            found = [row for row in rows if (row["id"], row["way"]) == (id, way)]
            if found:
                rates, spent = ([row[key] for row in found] for key in ("rate", "seconds"))
                bound = rounded_down(found[0]["bound"], 4)
                each = " ".join(f"{rate:.3f}" for rate in rates)
                lines.append(f"| {id} | {bound} | {way} | {each} | {np.mean(rates):.3f} | {np.mean(spent):.0f} |\n")
    return "".join(lines)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw a dot for each seed, by problem and way, and the bounds as lines."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    ids = list(dict.fromkeys(row["id"] for row in rows))
    figure = Figure(figsize=(3.2 * len(ids), 3.2), layout="constrained")
    axes = figure.subplots(1, len(ids), sharey=True, squeeze=False)[0]
    for axis, id in zip(axes, ids, strict=True):
        mine = [row for row in rows if row["id"] == id]
        axis.axhline(mine[0]["bound"], color="#1f5fa8", linewidth=1.2)
        places = [WAYS.index(row["way"]) for row in mine]
        axis.scatter(places, [row["rate"] for row in mine], color="#3a7d44", s=18, alpha=0.8)
        axis.set_xticks(range(len(WAYS)), WAYS, rotation=60, ha="right", fontsize=7)
        axis.set_ylim(-0.03, 1.03)
        axis.set_title(id, fontsize=9)
    axes[0].set_ylabel("success")
    FigureCanvasAgg(figure).print_figure(path, dpi=130)


def main() -> None:
    """Train what is missing, seed by seed so that all problems and ways have as many, and write after each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", default=IDS)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--certificates", type=Path)
    options = parser.parse_args()
    table = PAGE.with_suffix(".json")
    rows = json.loads(table.read_text(encoding="utf-8")) if table.is_file() else []
    known = {(row["id"], row["way"], row["seed"]) for row in rows}
    certificates = {id: certificate_of(id, options.certificates) for id in options.ids}
    values = {id: cg.value_in_time(certificate) for id, certificate in certificates.items()}
    for seed in range(options.seeds):
        for id in options.ids:
            for way in WAYS:
                if (id, way, seed) in known:
                    continue
                training = trained(way, certificates[id], values[id], options.steps, seed)
                rate = cg.rollout(certificates[id].problem, training, EPISODES, seed=77).successes / EPISODES
                row = {"id": id, "way": way, "seed": seed, "bound": certificates[id].lower_bound, "rate": rate}
                row |= {"steps": options.steps, "seconds": round(training.seconds, 1)}
                rows.append(row)
                print(row, flush=True)
                table.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(page_of(rows), encoding="utf-8")
    draw(rows, PAGE.parent / "figures" / "from_certificates.png")


if __name__ == "__main__":
    main()
