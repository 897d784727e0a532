"""Draw the moving picture of the first page: ``python docs/draw_hero.py``.

One episode of ``meeting-v0`` under certified controllers: the task in words, of which the part under way is dark, and
beside it the proved probability of success from here on, on an axis of failures. Among the first episodes it is the
one that comes nearest to failing, and succeeds.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.patches import Circle, FancyBboxPatch
from PIL import Image

import certigym as cg
from draw_gallery import certificate

OUT = Path(__file__).parent / "figures" / "hero.gif"
ID, EPISODES = "meeting-v0", 60
FRAMES, WAIT, HOLD, COLORS = 8, 50, 2500, 64
"""Pictures of a control step, milliseconds for which each and the last one stay, and colours."""

INK, PALE, GRID, PAPER = "#1b2230", "#8a93a3", "#d5dae2", "#f7f8fa"
ROBOTS, GOAL, AVOID = ("#2558d6", "#d6255a"), "#0a9e73", "#c9ced8"
"""Colours of robots, of rooms, and of what is avoided, which no robot has."""

LEAST = 1e-5
"""Failure at the upper end of the axis."""

CLAUSES = ("Meet in one room at the same time,", "then be at both desks at the same time.")
ALWAYS = "Never touch the pillar."
PLACES = {"cafe_0": ("café", GOAL, 0), "lab_0": ("lab", GOAL, 0), "desk_0": ("desk", ROBOTS[0], 1),
          "desk_1": ("desk", ROBOTS[1], 1)}  # fmt: skip
"""Of propositions what the picture calls them, their colours, and the clauses that ask for them."""


@dataclass(frozen=True)
class Episode:
    """States (T + 1, 2, 2), which clause is under way, and lower bounds on success from each step on."""

    states: np.ndarray
    clauses: list[int]
    proved: np.ndarray


def episode(claim: cg.Certificate) -> Episode:
    """Return, of successful episodes, the one whose proved probability falls lowest on the way."""
    problem, env, best = claim.problem, cg.parallel_env(claim.problem), None
    values, first = cg.value_in_time(claim), problem.initial_q
    for seed in range(EPISODES):
        observations, infos = env.reset(seed=seed)
        claim.controller.reset(observations, infos)
        states, reached = [_states(observations)], [_automaton_state(observations, problem)]
        while env.agents:
            observations, _, _, _, infos = env.step(claim.controller.act(observations, infos))
            states.append(_states(observations))
            reached.append(_automaton_state(observations, problem))
        if not infos["robot_0"]["satisfied"]:
            continue
        times = problem.horizon - np.arange(len(states))
        each = zip(states[:-1], reached[:-1], times[:-1], strict=True)
        proved = np.array([*(float(np.ravel(values.at(x.reshape(1, -1), q, int(t)))[0]) for x, q, t in each), 1.0])
        if best is None or proved.min() < best.proved.min():
            best = Episode(np.array(states), [int(q != first) for q in reached], proved)
    assert best is not None
    return best


def _states(observations: Any) -> np.ndarray:
    return np.array([observations[robot][:2] for robot in ("robot_0", "robot_1")], dtype=float)


def _automaton_state(observations: Any, problem: cg.Problem) -> int:
    return int(np.argmax(observations["robot_0"][2 : 2 + problem.automaton.n_states]))


def picture(shown: Episode, problem: cg.Problem, k: int) -> Image.Image:
    """Return one picture: part k of the episode, in ``FRAMES`` parts of a step, eased from step to step."""
    step, part = divmod(min(k, (len(shown.states) - 1) * FRAMES), FRAMES)
    share = part / FRAMES
    share = share * share * (3.0 - 2.0 * share)
    after = min(step + 1, len(shown.states) - 1)
    at = (1.0 - share) * shown.states[step] + share * shown.states[after]
    heading = shown.states[after] - shown.states[step] if after > step else at - shown.states[step - 1]
    figure = plt.figure(figsize=(8.0, 4.2), dpi=90, facecolor="white")
    _map(figure.add_axes((0.01, 0.03, 0.5, 0.94)), problem, shown, step, at, heading)
    is_done = step == len(shown.states) - 1
    _words(figure, shown.clauses[step], is_done, shown.proved[step])
    _failures(figure.add_axes((0.62, 0.15, 0.35, 0.47)), shown, step, share, problem.horizon)
    with io.BytesIO() as file:
        figure.savefig(file, format="png")
        plt.close(figure)
        return Image.open(file).convert("RGB")


def _map(plot: Any, problem: cg.Problem, shown: Episode, step: int, at: np.ndarray, heading: np.ndarray) -> None:
    """Draw rooms, pillar, trails and robots."""
    low, high = problem.agents[0].state_low, problem.agents[0].state_high
    plot.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    plot.axis("off")
    _box(plot, low + 0.1, high - 0.1, PAPER, GRID, 1.0)
    for name, (label, color, clause) in PLACES.items():
        region = problem.propositions[name]
        x, y = 0.5 * (region.low[0] + region.high[0]), region.high[1] + 0.25
        _box(plot, region.low, region.high, color, color, 0.32 if shown.clauses[step] == clause else 0.12)
        plot.text(x, y, label, ha="center", color=INK)
    pillar, label = problem.propositions["pillar_0"], {"fc": AVOID, "ec": "none", "pad": 1}
    _box(plot, pillar.low, pillar.high, AVOID, PALE, 1.0, "////")
    plot.text(*(0.5 * (pillar.low + pillar.high)), "pillar", ha="center", va="center", color=INK, bbox=label)
    for robot, color in enumerate(ROBOTS):
        trail = np.vstack([shown.states[: step + 1, robot], at[robot]])
        for n, (a, b) in enumerate(zip(trail, trail[1:], strict=False)):
            faded = max(0.12, 1.0 - 0.12 * (len(trail) - 2 - n))
            plot.plot(*np.stack([a, b], axis=1), color=color, lw=2.4, alpha=faded, solid_capstyle="round")
        forward = heading[robot] / max(1e-9, float(np.hypot(*heading[robot])))
        plot.add_patch(Circle(at[robot], 0.45, fc=color, ec="white", lw=1.8, zorder=5))
        plot.add_patch(Circle(at[robot] + 0.22 * forward, 0.13, fc="white", ec="none", zorder=6))


def _box(plot: Any, low: Any, high: Any, fill: str, edge: str, alpha: float, hatch: str = "") -> None:
    shape = "round,pad=0,rounding_size=.3"
    plot.add_patch(FancyBboxPatch(low, *(np.asarray(high) - low), boxstyle=shape, fc=fill, ec="none", alpha=alpha))
    plot.add_patch(
        FancyBboxPatch(low, *(np.asarray(high) - low), boxstyle=shape, fc="none", ec=edge, lw=1.5, hatch=hatch)
    )


def _words(figure: Any, clause: int, is_done: bool, proved: float) -> None:
    """Write the task, of which what is under way is dark, and what is proved."""
    for k, text in enumerate(CLAUSES):
        dark = k == clause and not is_done
        done = is_done or k < clause
        figure.text(0.56, 0.90 - 0.06 * k, text, weight="bold", color=INK if dark else GOAL if done else PALE)
    figure.text(0.56, 0.78, ALWAYS, weight="bold", color=GOAL if is_done else INK)
    figure.text(0.56, 0.685, "done" if is_done else "proved from here on:", color=GOAL if is_done else INK)
    if not is_done:
        figure.text(0.78, 0.683, f"P ≥ {np.floor(proved * 1e4) / 1e4:.4f}", size=13, weight="bold", color=INK)


def _failures(plot: Any, shown: Episode, step: int, share: float, horizon: int) -> None:
    """Draw the failure that is still possible, downward from what is proved to be rare."""
    failure = np.maximum(1.0 - shown.proved, LEAST)
    times, values = list(range(step + 1)), failure[: step + 1].tolist()
    if step + 1 < len(failure) and share > 0.0:
        times.append(step + share)
        values.append(float(np.exp((1.0 - share) * np.log(failure[step]) + share * np.log(failure[step + 1]))))
    plot.semilogy(times, values, color=INK, lw=2)
    plot.plot(times[-1], values[-1], "o", color=INK, ms=6)
    plot.set(xlim=(0, horizon), ylim=(1.0, LEAST), xticks=range(0, horizon + 1, 5), xlabel="time step")
    plot.set_yticks([1.0, 0.1, 0.01, 1e-3, 1e-4, 1e-5], ["0", ".9", ".99", ".999", ".9999", ".99999"])
    plot.set_ylabel("certified lower bound")
    plot.minorticks_off()
    plot.tick_params(length=0)
    plot.spines[["top", "right"]].set_visible(False)
    plot.grid(alpha=0.25)


def main() -> None:
    """Write the animation, with one palette for all of its pictures."""
    mpl.use("Agg")
    claim = certificate(ID)
    shown = episode(claim)
    with mpl.rc_context({"font.size": 9}):
        frames = [picture(shown, claim.problem, k) for k in range((len(shown.states) - 1) * FRAMES + 1)]
    palette = frames[len(frames) // 2].quantize(COLORS)
    drawn = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [WAIT] * (len(drawn) - 1) + [HOLD]
    drawn[0].save(OUT, save_all=True, append_images=drawn[1:], duration=durations, loop=0, optimize=True)
    print(
        f"{OUT.name}: {OUT.stat().st_size // 1024} KiB, {len(drawn)} pictures, proved {shown.proved.min():.4f} at least"
    )


if __name__ == "__main__":
    main()
