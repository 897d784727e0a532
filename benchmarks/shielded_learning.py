"""Does a shield help a learner? Failures during training and success afterwards, with and without one.

``python benchmarks/shielded_learning.py [--steps N] [--seeds S ...] [--certificates FOLDER] [ID ...]``

PPO with the same seeds, settings and world steps, all episodes from the problem's start: alone, and behind the shield
of the default certificate at nine tenths of its bound. Afterwards both actors play 10,000 episodes alone, and behind
the shield. Writes the numbers, the table into ``docs/how-to/shields.md``, and the curves beside it (extra `rl`).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import certigym as cg
from certigym.synthesis.shielding import shield_of
from probes import certificate_of
from shields import PAGE, PROBLEMS

EPISODES = 10_000
KEPT = 0.9
"""Share of the certified bound that is kept: a tenth is left to explore with."""
IDS = ("reach-avoid-v0", "car-park-v0", "meeting-v0", "reach-avoid-n-v0")
BEGIN, END = "<!-- learning, written by benchmarks/shielded_learning.py -->\n", "<!-- end of learning -->"


def learned(name: str, seed: int, options: argparse.Namespace) -> dict[str, Any]:
    """Train with one seed, with and without a shield, and return what happened."""
    arguments = PROBLEMS.get(name, {})
    if arguments:
        certificate: Any = cg.synthesize(cg.make_problem(name, **arguments)).certificate
    else:
        certificate = certificate_of(name, options.certificates)
    problem, shield = certificate.problem, shield_of(certificate, KEPT * certificate.lower_bound)
    row: dict[str, Any] = {"problem": name, "seed": seed, "p": shield.probability, "steps": options.steps}
    for way, given in (("alone", None), ("shielded", shield)):
        training = cg.train(problem, "ppo", options.steps, seed, shield=given, spread=0.0)
        episodes = sum(point["episodes"] for point in training.curve)
        failures = sum(point["episodes"] * (1.0 - point["success"]) for point in training.curve)
        played = cg.rollout(problem, training.actor, EPISODES, seed=77).successes / EPISODES
        guarded = cg.rollout(problem, cg.shield(training, shield), EPISODES, seed=77).successes / EPISODES
        row[way] = {"episodes": episodes, "failures": round(failures), "actor": played, "behind": guarded}
        row[way] |= {"curve": [[point["steps"], point["success"]] for point in training.curve]}
        row[way]["seconds"] = training.seconds
    print(
        name,
        seed,
        {way: {k: v for k, v in row[way].items() if k != "curve"} for way in ("alone", "shielded")},
        flush=True,
    )
    return row


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table for the page."""
    lines = [
        "| problem | seed | world steps | p | training episodes that failed, alone | shielded | "
        "actor afterwards, trained alone | trained shielded | the same behind the shield: alone | shielded |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        a, s = row["alone"], row["shielded"]
        failed = [
            f"{way['failures']} of {way['episodes']:.0f} ({way['failures'] / way['episodes']:.3f})" for way in (a, s)
        ]
        ends = [f"{number:.4f}" for number in (a["actor"], s["actor"], a["behind"], s["behind"])]
        start = f"{row['problem']} | {row['seed']} | {row['steps']:,} | {row['p']:.4f}"
        lines.append(f"| {start} | {' | '.join([*failed, *ends])} |")
    return "\n".join(lines) + "\n"


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw success while exploring against world steps, one picture for each problem."""
    import matplotlib.pyplot as plt

    names = sorted({row["problem"] for row in rows if row["shielded"]["curve"]})
    figure, axes = plt.subplots(1, len(names), figsize=(3.2 * len(names), 2.6), sharey=True, squeeze=False)
    for axis, name in zip(axes[0], names, strict=True):
        for row in (row for row in rows if row["problem"] == name):
            for way, colour in (("alone", "tab:orange"), ("shielded", "tab:blue")) if row["alone"]["curve"] else ():
                axis.plot(*zip(*row[way]["curve"], strict=True), color=colour, lw=1.2, label=way)
            axis.axhline(row["p"], color="black", ls=":", lw=1.0, label="p")
        axis.set_title(name, fontsize=9)
        axis.set_xlabel("world steps")
    axes[0, 0].set_ylabel("success in training")
    handles = dict(zip(*axes[0, 0].get_legend_handles_labels()[::-1], strict=True))
    axes[0, 0].legend(handles.values(), handles.keys(), fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Train, and write numbers, table and picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", default=list(IDS))
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--seeds", nargs="*", type=int, default=[0, 1, 2])
    parser.add_argument("--page", action="store_true", help="only write table and picture from the numbers")
    parser.add_argument("--certificates", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/how-to/shielded_learning.json"))
    options = parser.parse_args()
    rows: list[dict[str, Any]] = json.loads(options.out.read_text("utf-8")) if options.out.is_file() else []
    for name in () if options.page else options.ids:
        rows = [row for row in rows if (row["problem"], row["seed"]) not in {(name, seed) for seed in options.seeds}]
        rows += [learned(name, seed, options) for seed in options.seeds]
        rows.sort(key=lambda row: (IDS.index(row["problem"]), row["seed"]))
        options.out.write_text(json.dumps(rows) + "\n", encoding="utf-8")
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN, 1)
    PAGE.write_text(f"{before}{BEGIN}\n{table(rows)}{END}{rest.split(END, 1)[1]}", encoding="utf-8")
    draw(rows, PAGE.with_name("shielded_learning.png"))


if __name__ == "__main__":
    main()
