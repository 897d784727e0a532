"""Baselines that learn: PPO and SAC of Stable-Baselines3 on the worlds of a problem (the extra ``rl``).

``ppo``          decentralised: one network for all agents; each agent sees its state, the automaton state, the time
                 left and which agent it is, the same information as under certified policies.
``ippo``         like ``ppo``, with networks of their own for each agent.
``mappo``        like ``ppo``, while the critic, which only training needs, sees the states of all agents.
``central-ppo``  one learner sees the states of all agents and moves all of them.
``sac``          like ``central-ppo``, but learning off policy.

A warm start clones certified controllers first (``imitation``) and goes on learning from there. Such a learner was
helped: it is no independent baseline, and says so wherever it is shown.

The settings are those of ``settings.toml``. Now and then the actor of the moment plays episodes of its own; the best
one is kept, since learners also forget. Training uses the start and the dynamics of the problem. The seed decides
everything: network, worlds, batches. The same seed, versions and machine give the same actor.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...envs.suite import as_problem
from ...envs.systems.arguments import checked_count, counted, tree_text, write_bytes, write_json, write_text
from ...envs.tasks.problem import Problem
from ...synthesis.certificates.proofs import Certificate, certificate_from
from ...synthesis.extended_check.shields import Shield
from ...synthesis.verbs.synthesize import synthesize
from ..statistical_tests import rollout
from .actors import Actor, networks_of, save_actor
from .imitation import clone, demonstrate
from .learning import (
    Progress,
    actor_now,
    begin_again,
    begins_anywhere,
    check_settings,
    enter,
    learn,
    new_learner,
    new_watcher,
    numbers_of,
)
from .settings import Phase, Piece, Settings, settings_for
from .views import CentralView, SharedView, TeamView, View

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

ALGORITHMS = ("ppo", "ippo", "mappo", "central-ppo", "sac")

CLONED = "cloned from certified controllers"
"""The help that a warm start is."""

CURVE_POINTS = 50
"""Points of a training curve."""

PIECES = 12
"""Parts of a training after each of which the actor is judged: often enough to catch a good one, and cheap."""

PATIENCE, LITTLE = 3, 0.01
"""Parts after which a learner begins again, with episodes that begin anywhere, if the best of its actors has had fewer
successes than this: at once such episodes cost more than they gain where the start alone teaches enough."""

JUDGED = 2000
"""Episodes that judge an actor while it is trained: a success rate to about .01, in a fraction of a second."""


@dataclass(frozen=True, eq=False, repr=False)
class Training:
    """A trained actor and how it was trained.

    Parameters
    ----------
    problem : Problem
    algorithm : str
    seed : int
    steps : int
        World steps taken.
    seconds : float
        Wall-clock time of learning.
    curve : tuple of dict
        The training curve: ``steps`` and ``seconds`` since the beginning; over the episodes since the point before,
        ``episodes``, ``success`` (share of satisfied ones, exploration included) and mean ``return``.
    actor : Actor
    settings : dict
    model : BaseAlgorithm
        The learner with the numbers of the actor, to continue with Stable-Baselines3.
    help : str
        What the learner was given beside the problem: "" for nothing, or "cloned from certified controllers".
    """

    problem: Problem
    algorithm: str
    seed: int
    steps: int
    seconds: float
    curve: tuple[dict[str, float], ...]
    actor: Actor
    settings: dict[str, Any]
    model: BaseAlgorithm
    help: str = ""

    def __repr__(self) -> str:
        first, *others = networks_of(self.actor)
        shapes = " x ".join(str(bias.size) for bias in first.biases)
        each = " for each agent" if others else ""
        rows = [
            ("trained", f"{counted(self.steps, 'world step')} in {self.seconds:.1f} s, seed {self.seed}"),
            ("sees", self.information),
            ("network", f"layers of {shapes} numbers, {first.activation}{each}"),
        ]
        if self.curve:
            rows.append(("success", f"{self.curve[-1]['success']:.3f} while exploring, at the end of the training"))
        return tree_text(f"Training of {self.algorithm!r} on {self.problem.name!r}", rows)

    @property
    def information(self) -> str:
        """What the actor sees, and how it was helped."""
        return f"{self.actor.information}; {self.help}" if self.help else self.actor.information

    def to_dict(self) -> dict[str, Any]:
        """Return everything but actor and model as JSON values."""
        return {
            "problem": self.problem.name,
            "fingerprint": self.problem.fingerprint,
            "algorithm": self.algorithm,
            "information": self.information,
            "seed": self.seed,
            "steps": self.steps,
            "seconds": self.seconds,
            "help": self.help,
            "settings": self.settings,
            "curve": list(self.curve),
        }

    def save(self, folder: str | Path) -> Path:
        """Write ``actor.npz``, ``training.json``, ``curve.csv`` and ``model.zip``; return the actor's path.

        ``model.zip`` is the learner of Stable-Baselines3, with which ``train(resume=folder)`` goes on.
        """
        target = Path(folder)
        target.mkdir(parents=True, exist_ok=True)
        record = self.to_dict()
        save_actor(
            self.actor, target / "actor.npz", **{k: record[k] for k in ("algorithm", "seed", "steps", "seconds")}
        )
        write_json(target / "training.json", record)
        columns = ("steps", "seconds", "episodes", "success", "return")
        lines = [",".join(columns), *(",".join(f"{point[name]:.10g}" for name in columns) for point in self.curve)]
        write_text(target / "curve.csv", "\n".join(lines) + "\n")
        model = BytesIO()
        self.model.save(model)
        write_bytes(target / "model.zip", model.getvalue())
        return target / "actor.npz"


KEYWORDS = (
    *("problem", "algorithm", "steps", "seed", "warm_start", "resume", "shield", "progress"),
    *("worlds", "reward", "learning_rate", "deviation", "fixed", "spread", "care", "hidden", "phases", "seconds"),
)
"""Arguments of ``train`` that are not the learner's."""


def train(
    problem: Any,
    algorithm: str = "ppo",
    steps: int | None = None,
    seed: int = 0,
    *,
    warm_start: Any = None,
    resume: str | Path | None = None,
    shield: Shield | None = None,
    progress: Progress | None = None,
    **settings: Any,
) -> Training:
    """Train a baseline on a problem; nothing about the result is certified.

    Parameters
    ----------
    problem : Problem, id or path
    algorithm : "ppo", "ippo", "mappo", "central-ppo" or "sac"
    steps : int, optional
        World steps of all worlds together; default: see ``settings.toml``. The learner finishes the round in which it
        reaches them.
    seed : int
    warm_start : optional
        Certified controllers to clone first: a Synthesis, a certificate, the path of one, or "certificate" for the one
        that ``synthesize`` makes with its defaults. Not for SAC.
    resume : str or Path, optional
        Folder that ``Training.save`` has written: go on with its learner, with the settings of a warm start.
    shield : Shield, optional
        What keeps a success probability in every episode that begins at the problem's start, while the learner is
        trained (`synthesis.shielding.shield_of`). The actor that is returned acts without it; put it behind the same
        shield (`shield`) to keep the probability.
    progress : callable, optional
        Called with the world steps taken since the last call and the latest success rate.
    **settings
        Values that replace those of ``settings.toml``: ``worlds`` side by side, ``reward`` ("sparse", "shaped" or
        "progress", for all of the training), ``learning_rate``, ``deviation``, ``spread``, ``care``, ``hidden``;
        ``device``; ``seconds`` after which to stop (cloning comes before; the result then depends on the machine); and
        whatever the learner of Stable-Baselines3 takes.

    Raises
    ------
    ValueError
        If an argument is unknown or out of range, or Stable-Baselines3 is not installed.
    """
    problem = as_problem(problem)
    _check(algorithm, seed, warm_start, resume, steps=steps, worlds=settings.get("worlds"))
    _check_shield(problem, shield)
    check_settings(algorithm, settings, KEYWORDS)
    view = view_of(problem, algorithm)
    before = None if resume is None else _record(Path(resume), problem, algorithm)
    if before is not None:
        settings = {"hidden": before["settings"]["hidden"], **settings}
    used = settings_for(algorithm, view, warm=warm_start is not None or resume is not None, steps=steps, **settings)
    used = replace(used, shield=shield)
    shown = None if warm_start is None else demonstrate(view, certificate_of(problem, warm_start).controller, seed=seed)
    began = time.perf_counter()
    model = new_learner(algorithm, view, used, seed)
    if shown is not None:
        clone(model, shown, seed=seed)
    if resume is not None:
        model.set_parameters(str(Path(resume) / "model.zip"), device=model.device)
    watcher = new_watcher(view.rows, max(1, used.steps // CURVE_POINTS), progress)
    actor = _best(model, view, used, watcher, seed, start_counts=shown is not None or before is not None)
    seconds = time.perf_counter() - began
    taken = int(model.num_timesteps) // view.rows
    helped = str(before["help"]) if before is not None else "" if shown is None else CLONED
    if shield is not None:
        helped = "; ".join(filter(None, (helped, f"trained behind a shield that keeps {shield.probability:.6g}")))
    return Training(
        problem, algorithm, int(seed), taken, seconds, tuple(watcher.curve), actor, used.to_dict(), model, helped
    )


def view_of(problem: Problem, algorithm: str) -> View:
    """Return what the learner of an algorithm sees."""
    views = {"ppo": SharedView, "ippo": SharedView, "mappo": TeamView}
    view: View = views.get(algorithm, CentralView)(problem)
    return view


def certificate_of(problem: Problem, given: Any) -> Certificate:
    """Return a certificate of the problem, of any kind: the one given, or for "certificate" that of ``synthesize``.

    Raises
    ------
    ValueError
        If it is about other agents than those of the problem.
    """
    if isinstance(given, str) and given == "certificate":
        return synthesize(problem).certificate
    certificate: Certificate = certificate_from(given)
    if certificate.fingerprint != problem.fingerprint:
        raise ValueError(
            f"`warm_start`: expected a certificate of {problem.name!r}, got one about another problem "
            f"({certificate.problem.name!r})"
        )
    return certificate


def score(problem: Problem, actor: Actor, seed: int, episodes: int = JUDGED) -> float:
    """Return the share of successes in episodes that decide which actor is kept (an estimate, and biased by that)."""
    return rollout(problem, actor, episodes, seed=seed).successes / episodes


def _best(model: Any, view: View, settings: Settings, watcher: Any, seed: int, start_counts: bool) -> Actor:
    """Send a learner through its phases; return the best of its actors, the later of two that are as good.

    The learner itself ends with the numbers of this actor.
    """
    judge = np.random.SeedSequence([seed, 1]).generate_state(1)[0].item()
    best, best_score, numbers = actor_now(model, view), -1.0, numbers_of(model)
    if start_counts:  # a clone may be best of all; an untrained network is none
        best_score = score(view.problem, best, judge)
    untrained, share = numbers, 0.0
    for number, phase in enumerate(settings.phases):
        # Time is shared out as steps are, so that the last phase, which learns the task itself, has its turn.
        share += phase.share
        if settings.seconds is not None:
            watcher.deadline = watcher.began + share * settings.seconds
        enter(model, view, settings, phase, seed + number, is_later=number > 0)
        pieces, done = _pieces(replace(phase, spread=0.0), settings), 0
        while pieces and time.perf_counter() < watcher.deadline:
            learn(model, view, pieces.pop(0), watcher)
            actor = actor_now(model, view)
            now = score(view.problem, actor, judge)
            if now >= best_score:
                best, best_score, numbers = actor, now, numbers_of(model)
            done += 1
            if done == PATIENCE and pieces and best_score < LITTLE and begins_anywhere(model, phase):
                begin_again(model, untrained)
                left = len(pieces) / (len(pieces) + done)
                pieces = _pieces(replace(phase, share=left * phase.share), settings)
    model.policy.load_state_dict(numbers)
    return best


def _pieces(phase: Phase, settings: Settings) -> list[Piece]:
    """Return the parts of a phase."""
    total = max(1, round(phase.share * settings.steps))
    # A learner always finishes its round, so parts shorter than a round would add up to more than was asked for.
    count = max(1, min(round(phase.share * PIECES), total // settings.round))
    edges = np.linspace(0, total, count + 1).round().astype(int).tolist()
    # Over the phase the rate falls to a tenth, the spread to 0, and care rises to 1.
    rates = (phase.learning_rate * np.linspace(1.0, 0.1, count + 1)).tolist()
    pieces = []
    for k in range(count):
        left = 1.0 - k / count
        spread, care = left * phase.spread, 1.0 - left * (1.0 - phase.care)
        pieces.append(Piece(edges[k + 1] - edges[k], (rates[k], rates[k + 1]), spread, care))
    return pieces


def _record(folder: Path, problem: Problem, algorithm: str) -> dict[str, Any]:
    """Return the record of the training that is to be continued; raise ValueError if it does not fit."""
    if not (folder / "training.json").is_file() or not (folder / "model.zip").is_file():
        raise ValueError(f"`resume`: expected a folder with training.json and model.zip, got {str(folder)!r}")
    record: dict[str, Any] = json.loads((folder / "training.json").read_text(encoding="utf-8"))
    # Another horizon or start is welcome (a curriculum), other agents or tasks are another network.
    if record["problem"] != problem.name or record["algorithm"] != algorithm:
        found = f"{record['algorithm']!r} on {record['problem']!r}"
        raise ValueError(f"`resume`: expected {algorithm!r} on {problem.name!r}, got {found}")
    return record


def _check_shield(problem: Problem, shield: Any) -> None:
    """Raise ValueError unless there is no shield, or one of the problem."""
    if shield is not None and not isinstance(shield, Shield):
        raise ValueError(
            f"`shield`: expected a Shield of one task, got {type(shield).__name__}; make one with `shield_of`"
        )
    if shield is not None and shield.problem.fingerprint != problem.fingerprint:
        raise ValueError(
            f"`shield`: expected one of {problem.name!r}, got one about another problem ({shield.problem.name!r})"
        )


def _check(algorithm: str, seed: int, warm_start: Any, resume: Any, **counts: int | None) -> None:
    """Raise ValueError unless the algorithm exists and all numbers that are given are whole and large enough."""
    if algorithm not in ALGORITHMS:
        raise ValueError(f"`algorithm`: expected {', '.join(map(repr, ALGORITHMS))}, got {algorithm!r}")
    if warm_start is not None and algorithm == "sac":
        raise ValueError("`warm_start`: expected only with learners of PPO; SAC has no actor that clones fit")
    if warm_start is not None and resume is not None:
        raise ValueError("`resume`: expected without `warm_start`; a learner that goes on is not cloned again")
    checked_count(seed, "seed", least=0)
    for name, value in counts.items():
        if value is not None:
            checked_count(value, name)
