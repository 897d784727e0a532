"""Draw the figures of README and documentation into ``docs/figures``: ``python docs/draw_figures.py [NAME ...]``."""

from __future__ import annotations

import contextlib
import io
import json
import re
import shlex
import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import certigym as cg
import numbers_of_pages
from certigym.cli.main import main as main_of_certigym
from certigym.envs.interfaces import AGENTS
from certigym.synthesis.interop import stored
from certigym.validation.policies.competitors import published
from certigym.validation.policies.tier_rule import ALONE
from certigym.validation.presentation.figures import certificate_figures as figures
from certigym.validation.presentation.figures import figure_scenes
from certigym.validation.presentation.figures.figure_style import SOFT, new_figure

FOLDER = Path(__file__).parent / "figures"


def _reach_avoid(horizon: int, cells: int, **settings: Any) -> cg.Certificate:
    return cg.synthesize(cg.make_problem("reach-avoid-v0", horizon=horizon), cells=cells, **settings).certificate


def tree() -> Any:
    """The tree of a short task."""
    return figure_scenes.tree_figure(_reach_avoid(3, 200))


def value() -> Any:
    """A map of starts."""
    return figures.value_figure(_reach_avoid(6, 1000))


def ranks() -> Any:
    """Growth and pruning."""
    return figures.rank_figure(_reach_avoid(16, 500))


def automaton() -> Any:
    """A task with two stages."""
    return figure_scenes.automaton_figure(cg.make_problem("meeting-v0"))


TIERS = {
    "open": "Open: half of the way, or more",
    "hard": "Hard: less than half of the way",
    "unrated": "Unrated: no learner was judged",
    "solved": "Solved: a learner alone is there",
}
"""What the figure of the suite says of each tier."""


def suite() -> Any:
    """Success on open and hard problems, and how many are solved; narrow, so that a phone shows its words large."""
    rates = _rates()
    kinds = {
        "random": ("x", SOFT, "random inputs"),
        "alone": ("D", AGENTS[4], "best learner alone"),
        "certified": ("o", AGENTS[0], "certified controllers"),
    }
    # From the top: what a tier is, its problems, from those that learners reach to those that they do not, a gap.
    heights, names, y = {}, [], 0.0
    for tier, title in TIERS.items():
        ids = cg.problem_ids(tier)
        names += [(y, f"{title} ({len(ids)})")] if ids else []
        if tier == "solved" or not ids:
            continue
        for id in sorted(ids, key=lambda id: (-rates[id].get("alone", 0.0), id)):
            y -= 1.0
            heights[id] = y
        y -= 1.7
    order = list(heights)
    figure, (plot,) = new_figure(4.4, 0.2 * -y + 1.4)
    for policy, (mark, color, name) in kinds.items():
        points = [(rates[id][policy], heights[id]) for id in order if policy in rates[id]]
        face = color if mark in "ox" else "white"
        style: Any = {"marker": mark, "markerfacecolor": face, "markeredgecolor": color, "linestyle": "none"}
        plot.plot(*zip(*points), label=name, markersize=5.5, **style)
    lengths = [rates[id]["bound"] for id in order]
    places = [heights[id] for id in order]
    plot.barh(places, lengths, height=0.7, color="#cfe0f4", label="certified bound", zorder=0)
    plot.set_yticks(places, [id.removesuffix("-v0") for id in order], fontsize=9.5)
    for height, title in names:
        # Over names and bars: the words of a tier begin at the left edge of the figure.
        plot.annotate(
            title, (0, height), (3, 0), ("figure points", "data"), "offset points",
            fontsize=9.5, fontweight="bold", va="center", ha="left", annotation_clip=False,
            bbox={"boxstyle": "square,pad=0.25", "facecolor": "white", "edgecolor": "none"},
        )  # fmt: skip
    plot.set_ylim(y - 0.7, 0.8)
    plot.set_xlim(-0.03, 1.03)
    plot.set_xticks([0.0, 0.5, 1.0], ["0", ".5", "1"])
    plot.set_xlabel("probability of success")
    plot.grid(axis="y", visible=False)
    words: dict[str, Any] = {"fontsize": 9.5, "columnspacing": 1.0, "handletextpad": 0.3}
    figure.legend(loc="outside upper center", ncols=2, frameon=False, **words)
    return figure


def learning_curves() -> Any:
    """Success while training, against world steps, of every published actor on open and hard problems."""
    ids = [id for tier in ("open", "hard") for id in cg.problem_ids(tier)]
    curves: dict[str, dict[str, list[Any]]] = {}
    for id in ids:
        for learner, numbers in published(FOLDER.parent / "actors", id).items():
            for seed in numbers:
                path = FOLDER.parent / "actors" / id / learner / f"seed-{seed}.npz"
                facts, _ = stored(path, cg.make_problem(id).n_agents)
                curves.setdefault(id, {}).setdefault(learner, []).append(np.array(facts["curve"]).reshape(-1, 2).T)
    rates, colours = _rates(), dict(zip(("ppo", "ippo", "mappo", "sac"), AGENTS, strict=False))
    columns = 3
    lines = -(-len(curves) // columns)
    figure, panels = new_figure(9.6, 2.1 * lines + 0.5, lines, columns)
    for plot in panels[len(curves) :]:
        plot.axis("off")
    for plot, (id, learners) in zip(panels, curves.items(), strict=False):
        plot.axhline(rates[id]["bound"], color=SOFT, linestyle="--", linewidth=1.0)
        for learner, seeds in learners.items():
            for number, (steps, success) in enumerate(seeds):
                label = learner if number == 0 else None
                plot.plot(steps / 1000.0, success, color=colours[learner], linewidth=0.9, alpha=0.8, label=label)
        plot.set_title(id, fontsize=9)
        plot.set_ylim(-0.03, 1.03)
    for plot in panels[max(0, len(curves) - columns) : len(curves)]:
        plot.set_xlabel("thousand world steps", fontsize=8)
    labelled: dict[str, Any] = {}
    for plot in panels:
        handles, labels = plot.get_legend_handles_labels()
        labelled |= dict(zip(labels, handles, strict=True))
    figure.legend(labelled.values(), labelled.keys(), loc="outside upper center", ncols=3, frameon=False)
    return figure


RUNS = {"random": "random", "certified": "rollouts"}
"""Rates of the figure of the suite, and where `defaults.json` has them."""


def _rates() -> dict[str, dict[str, float]]:
    """Return by problem the success rates of its policies, and the bound that is certified.

    Learners are those of the leaderboard, bounds and the other rates those of the defaults. Of learners without help
    the best one counts (``alone``), as in the rule of tiers.
    """
    rows = json.loads((FOLDER.parent / "leaderboard.json").read_text(encoding="utf-8"))["rows"]
    rates: dict[str, dict[str, float]] = {}
    for row in rows:
        here = rates.setdefault(row["problem"], {})
        rate = sum(row["successes"]) / (row["episodes"] * max(1, len(row["successes"])))
        here[row["policy"]] = rate
        if row["policy"] in ALONE:
            here["alone"] = max(rate, here.get("alone", 0.0))
    for id, found in numbers_of_pages.table("defaults").items():
        here = rates.setdefault(id, {})
        here |= {kind: found[key]["successes"] / found[key]["episodes"] for kind, key in RUNS.items()}
        here["bound"] = found["certified"]
    return rates


def tutorial(name: str, file: str) -> Any:
    """Return the picture that the blocks of a tutorial write, run in order in a folder of their own."""
    from PIL import Image

    names: dict[str, Any] = {}
    page = (FOLDER.parent / "tutorials" / f"{name}.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for language, block in re.findall(r"^```(toml|python|console)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL):
            if language == "toml":
                Path(f"{name}.toml").write_text(block, encoding="utf-8")
            elif language == "python":
                exec(compile(block, name, "exec"), names)
            else:
                lines = re.sub(r"\\\n +", "", block).splitlines()
                for line in lines:
                    assert main_of_certigym(shlex.split(line, comments=True)[2:]) == 0, line
        return Image.open(file).convert("RGB")


TUTORIALS = {
    "tutorial_robot": ("my_robot", "robot.png"),
    "tutorial_policy": ("sb3_policy", "policy.png"),
    "tutorial_shield": ("safety_filter", "shield.png"),
    "tutorial_check": ("check_a_certificate", "claim.png"),
    "tutorial_paper": ("paper_plot", "horizon.png"),
}
"""Pictures of tutorials: the page, and the file that it writes."""

FIGURES: dict[str, Callable[[], Any]] = {
    draw.__name__: draw for draw in (tree, value, ranks, automaton, suite, learning_curves)
} | {name: partial(tutorial, *page) for name, page in TUTORIALS.items()}


def main(names: list[str]) -> None:
    """Draw the named figures, or all, as PNG with a palette: small enough to commit."""
    from PIL import Image

    FOLDER.mkdir(exist_ok=True)
    for name in names or list(FIGURES):
        buffer, drawn = io.BytesIO(), FIGURES[name]()
        if not isinstance(drawn, Image.Image):
            drawn.savefig(buffer, format="png", dpi=130)
            drawn = Image.open(buffer).convert("RGB")
        path = FOLDER / f"{name}.png"
        drawn.quantize(192, dither=Image.Dither.NONE).save(path, optimize=True)
        print(f"{path.name}: {path.stat().st_size // 1024} KiB")


if __name__ == "__main__":
    main(sys.argv[1:])
