"""Trials of shields: whoever proposes, the promised share of the episodes succeeds.

``python benchmarks/shields.py [--episodes N] [--steps N] [--certificates FOLDER] [--out FILE.json] [ID ...]``

For each problem, and five shares of its certified bound: episodes with random inputs, with those of an adversary that
looks one step ahead for the least expected value, and with those of an untrained network; and all episodes of a PPO and
a SAC learner while they are trained behind the shield. A row is refuted if so few successes would have a probability
below 1e-6, divided by the number of rows, were each at least p. Times are of whole steps in batches, per
agent, the proposer included. Needs the extra `rl`.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binom

import certigym as cg
from certigym.baselines import RandomController
from certigym.envs.dynamics import Dynamics
from certigym.envs.dynamics import worlds as core
from certigym.synthesis.shielding import shield_of
from certigym.validation.policies.actors import Network, actor_of
from certigym.validation.policies.views import SharedView
from certigym.validation.shields.shielded_batches import in_blocks, states_of, times_of
from certigym.validation.simulation import Loop, frames
from probes import certificate_of

PAGE = Path(__file__).parents[1] / "docs" / "how-to" / "shields.md"
BEGIN, END = "<!-- trials, written by benchmarks/shields.py -->\n", "<!-- end of trials -->"
SHARES = (0.5, 0.8, 0.9, 0.95, 0.99)
FALSE_ALARM = 1e-6
CANDIDATES = 4
"""Random corners of the input boxes among which the adversary chooses; more find hardly worse ones."""

PROBLEMS: dict[str, dict[str, Any]] = {
    "reach-avoid-v0": {"horizon": 5},
    "car-park-v0": {},
    "meeting-v0": {},
    "reach-avoid-n-v0": {},
    "invariance-20-v0": {},
}
"""Problems by default, each with the arguments that keep its bound away from 1."""


@dataclass(frozen=True, eq=False)
class Adversary:
    """A policy that tries to fail: of some extreme inputs it proposes those with the least expected value."""

    shield: cg.Shield
    information = "everything, and it wants to fail"

    def batch(self, dynamics: Dynamics) -> AdversaryBatch:
        """Return the policy for batches."""
        return AdversaryBatch(self.shield, dynamics)


@dataclass(frozen=True, eq=False)
class AdversaryBatch:
    """The adversary arranged for batches; the memory is its generator."""

    shield: cg.Shield
    dynamics: Dynamics

    def begin(self, worlds: core.Worlds, rng: np.random.Generator) -> np.random.Generator:
        """Return the generator as the memory."""
        return rng

    def act(self, worlds: core.Worlds, memory: np.random.Generator) -> Any:
        """Return inputs (m, n, M) per block."""
        values, count = self.shield.values, worlds.n_worlds
        agents, states = self.shield.problem.agents, states_of(self.dynamics, worlds)
        least, at = np.full(count, np.inf), int(times_of(worlds)[0])
        chosen = [np.repeat(0.5 * (a.input_box.low + a.input_box.high)[:, None], count, axis=1) for a in agents]
        for _ in range(CANDIDATES):
            tried = []
            for agent in agents:
                low, high = agent.input_box.low[:, None], agent.input_box.high[:, None]
                tried.append(np.where(memory.random((len(low), count)) < 0.5, low, high))
            for q in np.flatnonzero(~self.shield.problem.automaton.absorbing):
                here = np.flatnonzero((worlds.q == q) & ~worlds.failed)
                if len(here):
                    cut = [tuple(array[:, here] for array in arrays) for arrays in (states, tried)]
                    worth = values.of_inputs(at, int(q), *cut)
                    worse = here[worth < least[here]]
                    least[here] = np.minimum(least[here], worth)
                    for u, new in zip(chosen, tried, strict=True):
                        u[:, worse] = new[:, worse]
        return in_blocks(self.dynamics, tuple(chosen)), memory


def untrained(problem: cg.Problem, seed: int = 0) -> Any:
    """Return an actor with random weights, large enough that it uses all of its input box."""
    view, rng = SharedView(problem), np.random.default_rng(seed)
    sizes = [view.size, 64, 64, view.n_actions]
    weights = tuple(rng.standard_normal((b, a)) for a, b in zip(sizes, sizes[1:], strict=False))
    biases = tuple(rng.standard_normal(b) for b in sizes[1:])
    return actor_of(view, (Network(weights, biases, "tanh", False),))


def trial(policy: Any, shield: cg.Shield, episodes: int, seed: int) -> dict[str, Any]:
    """Run episodes of a policy behind a shield; return counts and the share of proposals that were overridden."""
    loop = Loop(shield.problem, cg.shield(policy, shield), seed)
    dynamics, batch = loop.arranged
    successes = done = overridden = steps = 0
    began = time.process_time()
    for number in range(max(1, episodes // loop.chunk)):
        memory = None
        for frame in frames(loop, dynamics, batch, number):
            memory, last = (frame.memory if frame.memory is not None else memory), frame.worlds
        done, successes = done + loop.chunk, successes + int(core.satisfied(dynamics, last).sum())
        overridden, steps = overridden + memory.overridden, steps + memory.steps
    return {
        "episodes": done,
        "successes": successes,
        "overridden": overridden / max(1, steps),
        "seconds": time.process_time() - began,
        "agent_steps": steps,
    }


def training(algorithm: str, shield: cg.Shield, steps: int) -> dict[str, Any]:
    """Train a learner behind a shield from the problem's start; return the counts of its training episodes."""
    made = cg.train(shield.problem, algorithm, steps, shield=shield, spread=0.0)
    episodes = sum(int(point["episodes"]) for point in made.curve)
    successes = sum(round(point["episodes"] * point["success"]) for point in made.curve)
    return {"episodes": episodes, "successes": successes, "seconds": made.seconds}


def rows_of(name: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the rows of one problem."""
    arguments = PROBLEMS.get(name, {})
    certificate = (
        cg.synthesize(cg.make_problem(name, **arguments)).certificate
        if arguments
        else certificate_of(name, options.certificates)
    )
    rows = []
    for share in SHARES:
        shield = shield_of(certificate, share * certificate.lower_bound, options.form)
        runs = {
            "random": lambda s=shield: trial(RandomController(), s, options.episodes, 1),
            "adversary": lambda s=shield: trial(Adversary(s), s, options.episodes, 2),
            "untrained": lambda s=shield: trial(untrained(s.problem, 3), s, options.episodes, 3),
        }
        if share in options.train_at:
            runs["ppo, training"] = lambda s=shield: training("ppo", s, options.steps)
            runs["sac, training"] = lambda s=shield: training("sac", s, options.steps // 20)
        for who, run in runs.items():
            found = {"problem": name, "bound": certificate.lower_bound, "share": share, "p": shield.probability}
            found |= {"proposer": who, "form": options.form, **run()}
            found["rate"] = found["successes"] / found["episodes"]
            found["tail"] = float(binom.cdf(found["successes"], found["episodes"], shield.probability))
            cost = 1e6 * found["seconds"] / found["agent_steps"] if "agent_steps" in found else float("nan")
            print(
                f"{name} {share:.2f} p {found['p']:.4f} {who}: {found['rate']:.4f} of {found['episodes']}, "
                f"overridden {found.get('overridden', float('nan')):.3f}, {cost:.1f} us per agent and step",
                flush=True,
            )
            rows.append(found)
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """Return the trials as text for the page: a row for each problem and share, a column for each proposer."""
    who = ["random", "adversary", "untrained", "ppo, training", "sac, training"]
    lines = [f"| problem | bound | p | {' | '.join(who)} |", "|---|---|---|" + "---|" * len(who)]
    cases = {(row["problem"], row["form"], row["share"]): row for row in rows}
    for (name, form, share), case in cases.items():
        cells = []
        for proposer in who:
            found = [row for row in rows if (row["problem"], row["form"], row["share"]) == (name, form, share)]
            found = [row for row in found if row["proposer"] == proposer]
            over = f" ({100 * found[0]['overridden']:.0f} %)" if found and "overridden" in found[0] else ""
            cells.append(f"{found[0]['rate']:.4f}{over}" if found else "")
        label = name if form == "joint" else f"{name}, {form}"
        lines.append(f"| {label} | {case['bound']:.4f} | {case['p']:.4f} | {' | '.join(cells)} |")
    refuted = sum(row["tail"] < FALSE_ALARM / len(rows) for row in rows)
    episodes = sum(row["episodes"] for row in rows)
    closing = (
        f"Share of successes, and of proposals overridden in brackets; {episodes:,} episodes, {refuted} of {len(rows)} "
    )
    return "\n".join(lines) + f"\n\n{closing}promises refuted at 1e-6 for all together.\n"


def write_page(rows: list[dict[str, Any]]) -> None:
    """Write the table into its page."""
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN, 1)
    PAGE.write_text(f"{before}{BEGIN}\n{table(rows)}{END}{rest.split(END, 1)[1]}", encoding="utf-8")


def main() -> None:
    """Run all trials, write their numbers, and say whether any promise was refuted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", default=list(PROBLEMS))
    parser.add_argument("--episodes", type=int, default=14_000, help="of each policy and share (multiples of 2000)")
    parser.add_argument("--steps", type=int, default=100_000, help="world steps of PPO; SAC takes a twentieth")
    parser.add_argument("--train-at", nargs="*", type=float, default=[0.5, 0.9], help="shares at which learners train")
    parser.add_argument("--form", default="joint")
    parser.add_argument("--certificates", type=Path)
    parser.add_argument("--out", type=Path, default=Path("docs/how-to/shields.json"))
    parser.add_argument("--page", action="store_true", help="only write the page from the numbers of --out")
    options = parser.parse_args()
    if options.page:
        write_page(json.loads(options.out.read_text(encoding="utf-8")))
        return
    rows = json.loads(options.out.read_text(encoding="utf-8")) if options.out.is_file() else []
    for name in options.ids:
        rows = [row for row in rows if (row["problem"], row["form"]) != (name, options.form)]
        rows += rows_of(name, options)
        options.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    write_page(rows)
    refuted = [row for row in rows if row["tail"] < FALSE_ALARM / len(rows)]
    print(f"{sum(row['episodes'] for row in rows)} episodes, {len(rows)} rows, {len(refuted)} refuted")


if __name__ == "__main__":
    main()
