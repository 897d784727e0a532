"""Who takes part in the leaderboard: policies read from folders, or made within a budget and kept there."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ...envs.suite import as_problem, problem_ids
from ...envs.systems.arguments import write_json
from ...envs.tasks.problem import Problem
from ...synthesis.certificates.proofs import Certificate, Synthesis, load_certificate, save_certificate
from ...synthesis.extended_check.shields import Shield, shield_of
from ...synthesis.verbs.synthesize import synthesize
from .actors import load_actor
from .comparison import Contestant, contestants_of
from .probing import Probe, probe
from .rollout_policies import RandomController
from .shielded_policy import ShieldedController
from .training import CLONED, Training, certificate_of, train

CLONE, SHIELD = "clone", "shield"

LEARNERS: dict[str, tuple[str, str | None]] = {
    "ppo": ("ppo", None),
    "warm-ppo": ("ppo", CLONE),
    "shielded-ppo": ("ppo", SHIELD),
    "ippo": ("ippo", None),
    "mappo": ("mappo", None),
    "central-ppo": ("central-ppo", None),
    "sac": ("sac", None),
}
"""Learners by the name of their column: algorithm, and whether it starts from the certified controllers or learns, and
is judged, behind their shield."""

KEPT = 0.5
"""Share of the certified bound that the shield of a shielded learner keeps: more leaves a learner little to decide."""

POLICIES: tuple[str, ...] = ("certified", "probe", "ppo", "warm-ppo", "sac", "random")
"""The columns that are filled by default."""

SECONDS = 60.0
"""Default budget of each learner: small problems are learned in it; ``docs/learners.md`` gives them more."""


@dataclass(frozen=True)
class Sources:
    """Where policies come from that are not given.

    Parameters
    ----------
    certificates, learners : Path, optional
        Folders to read from and to keep in.
    seconds : float
        Budget of each learner that is trained, and of each probe.
    seeds : tuple of int
        Training seeds.
    """

    certificates: Path | None = None
    learners: Path | None = None
    seconds: float = SECONDS
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
        place = None if folder is None else folder / self.label / policy / f"seed-{seed}"
        algorithm, help_ = LEARNERS.get(policy, (policy, None))
        shield = self._shield if help_ == SHIELD else None
        if place is not None and (place / "actor.npz").is_file():
            return _behind(shield, saved(self.problem, policy, place))
        if policy == "probe":
            found = probe(self.problem, self.certificate, seconds=self.sources.seconds, seed=seed)
            return _probed(self.problem, found, seed, place)
        start = self.certificate if help_ == CLONE else None
        training = train(
            self.problem, algorithm, seed=seed, warm_start=start, shield=shield, seconds=self.sources.seconds
        )
        if place is not None:
            training.save(place)
        return _behind(shield, given(self.problem, policy, training)[0])

    @cached_property
    def _shield(self) -> Shield:
        """The shield behind which learners are trained and judged.

        Raises
        ------
        ValueError
            If the certificate has none, or one of several tasks: learners are trained on one task.
        """
        found = shield_of(self.certificate, KEPT * self.certificate.lower_bound)
        if not isinstance(found, Shield):
            raise ValueError(
                "`policies`: expected one task for 'shielded-ppo', got several, each with a shield of its own"
            )
        return found


def label_of(given: Any) -> str:
    """Return the name of a problem in the leaderboard: the id of the suite, under which pages and files are found."""
    return given if isinstance(given, str) and given in problem_ids() else as_problem(given).name


def given(problem: Problem, name: str, policy: Any) -> list[Competitor]:
    """Return a policy in any form that ``compare`` takes as an entrant, a sequence as one for each element."""
    steps = policy.steps if isinstance(policy, Training) else None
    return [Competitor(problem, contestant, steps) for contestant in contestants_of(problem, name, policy)]


def saved(problem: Problem, name: str, folder: Path) -> Competitor:
    """Return the actor in a folder that ``Training.save`` has written, or that of a probe.

    Raises
    ------
    ValueError
        If the actor or its record does not fit the problem.
    """
    actor, record = load_actor(folder / "actor.npz", problem), folder / "training.json"
    facts = json.loads(record.read_text(encoding="utf-8"))
    if facts["fingerprint"] != problem.fingerprint:
        raise ValueError(f"`{record}`: expected a training on this {problem.name!r}, got one on another version of it")
    contestant = Contestant(
        name, name, facts["information"], actor, seconds=float(facts["seconds"]), seed=int(facts["seed"])
    )
    return Competitor(problem, contestant, int(facts["steps"]))


def _behind(shield: Shield | None, entrant: Competitor) -> Competitor:
    """Return a policy behind a shield, which gives it a bound; or as it is."""
    if shield is None:
        return entrant
    bare = entrant.contestant
    guarded = ShieldedController(bare.controller, shield)
    told = replace(bare, controller=guarded, information=guarded.information, lower_bound=guarded.kept)
    return replace(entrant, contestant=told)


def _probed(problem: Problem, found: Probe, seed: int, place: Path | None) -> Competitor:
    """Return what a probe found, and keep it beside its record."""
    steps = sum(attempt.steps for attempt in found.attempts)
    information = f"{found.information}; {CLONED}"
    if place is not None:
        place.mkdir(parents=True, exist_ok=True)
        found.save_actor(place / "actor.npz")
        record = {"fingerprint": problem.fingerprint, "information": information, "seed": seed}
        write_json(place / "training.json", {**record, "steps": steps, "seconds": found.seconds})
    contestant = Contestant("probe", "probe", information, found.actor, seconds=found.seconds, seed=seed)
    return Competitor(problem, contestant, steps)
