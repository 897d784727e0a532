"""Who takes part in the leaderboard: policies read from folders, or made within a budget of steps and kept there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ...envs.suite import as_problem, problem_ids
from ...envs.tasks.problem import Problem
from ...synthesis.certificates.proofs import Certificate, Synthesis, load_certificate, save_certificate
from ...synthesis.interop import stored
from ...synthesis.verbs.synthesize import synthesize
from .actors import load_actor, save_actor
from .comparison import Contestant, contestants_of
from .rollout_policies import RandomController
from .training import ALGORITHMS, Training, certificate_of, train

POLICIES: tuple[str, ...] = ("certified", "ppo", "ippo", "mappo", "sac", "random")
"""The columns that are filled by default."""


@dataclass(frozen=True)
class Sources:
    """Where policies come from that are not given.

    Parameters
    ----------
    certificates, learners : Path, optional
        Folders to read from and to keep in: certificates `ID.npz`, actors `ID/LEARNER/seed-S.npz`.
    steps : int, optional
        World steps of each learner that is trained; default: those of ``settings.toml``.
    seeds : tuple of int
        Training seeds.
    """

    certificates: Path | None = None
    learners: Path | None = None
    steps: int | None = None
    seeds: tuple[int, ...] = (0,)


@dataclass(frozen=True, eq=False)
class Competitor:
    """A policy that takes part, and the world steps of its training, if it was trained."""

    problem: Problem
    contestant: Contestant
    steps: int | None = None


@dataclass(frozen=True, eq=False)
class Competitors:
    """The policies that take part on one problem."""

    problem: Problem
    label: str
    sources: Sources

    def of(self, policy: str) -> list[Competitor]:
        """Return the policy of this name: one entrant, or one for each training seed."""
        if policy == "certified":
            certificate = self.certificate  # kept in its folder, if there is one
            return given(self.problem, policy, self._synthesis or certificate)
        if policy == "random":
            return given(self.problem, policy, RandomController())
        return [self._learned(policy, seed) for seed in self.sources.seeds]

    @cached_property
    def certificate(self) -> Certificate:
        """The certificate in the folder, or the one of the defaults.

        Raises
        ------
        ValueError
            If the file is about another problem.
        """
        if self._synthesis is None:
            return certificate_of(self.problem, load_certificate(str(self._certificate_file)))
        if self._certificate_file is not None:
            save_certificate(self._synthesis.certificate, self._certificate_file)
        return self._synthesis.certificate

    @cached_property
    def _synthesis(self) -> Synthesis | None:
        """The synthesis with the defaults, which knows its time; None if there is a file."""
        if self._certificate_file is not None and self._certificate_file.is_file():
            return None
        return synthesize(self.problem)

    @property
    def _certificate_file(self) -> Path | None:
        folder = self.sources.certificates
        return None if folder is None else folder / f"{self.label}.npz"

    def _learned(self, policy: str, seed: int) -> Competitor:
        """Return one trained actor, from its folder if it is there."""
        folder = self.sources.learners
        place = None if folder is None else folder / self.label / policy / f"seed-{seed}.npz"
        if place is None or not place.is_file():
            training = train(self.problem, policy, self.sources.steps, seed)
            if place is None:
                return given(self.problem, policy, training)[0]
            publish(training, place)
        return saved(self.problem, policy, place)


def publish(training: Training, path: Path) -> None:
    """Write an actor with the facts that a leaderboard shows, and with its training curve."""
    path.parent.mkdir(parents=True, exist_ok=True)
    curve = [[point["steps"], round(point["success"], 4)] for point in training.curve]
    facts = {"algorithm": training.algorithm, "seed": training.seed, "steps": training.steps, "curve": curve}
    save_actor(training.actor, path, information=training.information, seconds=round(training.seconds, 1), **facts)


def label_of(given: Any) -> str:
    """Return the name of a problem in the leaderboard: the id of the suite, under which pages and files are found."""
    return given if isinstance(given, str) and given in problem_ids() else as_problem(given).name


def given(problem: Problem, name: str, policy: Any) -> list[Competitor]:
    """Return a policy in any form that ``compare`` takes as an entrant, a sequence as one for each element."""
    steps = policy.steps if isinstance(policy, Training) else None
    return [Competitor(problem, contestant, steps) for contestant in contestants_of(problem, name, policy)]


def saved(problem: Problem, name: str, path: Path) -> Competitor:
    """Return an actor that `publish` has written.

    Raises
    ------
    ValueError
        If the actor does not fit the problem, or was trained on another version of it.
    """
    actor, (facts, _) = load_actor(path, problem), stored(path, problem.n_agents)
    if facts["fingerprint"] != problem.fingerprint:
        raise ValueError(f"`{path}`: expected a training on this {problem.name!r}, got one on another version of it")
    seconds, seed = float(facts["seconds"]), int(facts["seed"])
    contestant = Contestant(name, name, facts["information"], actor, seconds=seconds, seed=seed)
    return Competitor(problem, contestant, int(facts["steps"]))


def published(learners: Path, label: str) -> dict[str, tuple[int, ...]]:
    """Return the learners of a problem whose actors are in a folder, and the seeds of each."""
    folder = learners / label
    found = {name: sorted(folder.glob(f"{name}/seed-*.npz")) for name in ALGORITHMS}
    return {name: tuple(sorted(int(path.stem[5:]) for path in paths)) for name, paths in found.items() if paths}
