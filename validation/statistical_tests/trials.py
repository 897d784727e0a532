"""How many episodes are simulated, from which seed, and where: one record for every verb that simulates.

Verbs take a plan, a number of episodes, or the fields of a plan as keywords:
``validate(result, 5000, seed=3)`` is ``validate(result, TrialPlan(episodes=5000, seed=3))``.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import TypedDict, TypeVar

from tqdm import tqdm

from ...envs.systems.arguments import checked_count, names_arguments
from .loop import CHUNK
from .spread import Executor, interrupts_at_checkpoints

Result = TypeVar("Result")


class TrialOptions(TypedDict, total=False):
    """The fields of a ``TrialPlan`` as keyword arguments."""

    episodes: int | None
    seed: int
    confidence: float | None
    chunk: int
    executor: Executor | None
    progress: Callable[[int], None] | bool | None


names_plan = names_arguments(*TrialOptions.__annotations__)
"""Decorator of verbs that take these: another keyword is refused, and the nearest one named."""


@dataclass(frozen=True)
class TrialPlan:
    """How many rollouts are made, from which random numbers, and how sure their limits are.

    Parameters
    ----------
    episodes : int, optional
        Number of episodes, at least 1; each verb has its default.
    seed : int
        Together with ``chunk`` it determines every number drawn.
    confidence : float, optional
        Confidence of two-sided limits and verdicts, between 0 and 1; each verb has its default.
    chunk : int
        Worlds per chunk of the simulation; part of the random record.
    executor : Executor, optional
        Where chunks are computed; default: this process. The results are the same on every executor.
    progress : callable or True, optional
        Called with the number of episodes finished since the last call; True: a bar, in notebooks, too.

    Raises
    ------
    ValueError
        If a number is out of range.
    """

    episodes: int | None = None
    seed: int = 0
    confidence: float | None = None
    chunk: int = CHUNK
    executor: Executor | None = None
    progress: Callable[[int], object] | bool | None = None

    def __post_init__(self) -> None:
        if self.episodes is not None:
            checked_count(self.episodes, "episodes")
        for name, least in (("seed", 0), ("chunk", 1)):
            checked_count(getattr(self, name), name, least)
        if self.progress is True:
            object.__setattr__(self, "progress", tqdm(desc="rollouts", unit=" episodes", leave=False).update)
        if self.executor is not None and not hasattr(self.executor, "submit"):
            raise ValueError(
                f"`executor`: expected an object with `submit`, got {self.executor!r}; open one with `executor_for`, "
                "or take a pool of `concurrent.futures`"
            )

    def tell(self, count: int) -> None:
        """Pass on to ``progress`` that so many more episodes are finished."""
        if callable(self.progress):
            self.progress(count)


class Plan(TrialPlan):
    """A plan in which the number of episodes and the confidence are settled."""

    episodes: int
    confidence: float


def planned(plan: TrialPlan | int | None, options: TrialOptions, episodes: int, confidence: float = 0.999) -> Plan:
    """Return the plan that a caller gave in any form, with the defaults of the verb filled in.

    Parameters
    ----------
    plan : TrialPlan or int, optional
        A whole number stands for a number of episodes.
    options : TrialOptions
        Fields that replace those of ``plan``.
    episodes : int
    confidence : float
        Defaults of the verb.
    """
    if plan is not None and not isinstance(plan, TrialPlan):
        checked_count(plan, "episodes")
        plan = TrialPlan(episodes=plan)
    # Keywords win over the plan, and the plan over the defaults of the verb.
    whole = replace(TrialPlan() if plan is None else plan, **options)
    settled = {
        "episodes": episodes if whole.episodes is None else whole.episodes,
        "confidence": confidence if whole.confidence is None else whole.confidence,
    }
    return Plan(**{**vars(whole), **settled})


def collect(results: Generator[Result, None, None], take: Callable[[Result], bool | None]) -> bool:
    """Hand results to ``take`` until there are no more or it returns True; return whether Ctrl-C came first.

    This is the one way in which a simulation is interrupted: the results taken by then stay, and the caller reports
    about them.

    Raises
    ------
    KeyboardInterrupt
        If Ctrl-C came before the first result: there is nothing to report.
    """
    taken = 0
    try:
        # Ctrl-C is held back while a result is made and taken, so that none is counted in part.
        with interrupts_at_checkpoints() as checkpoint:
            for result in results:
                taken += 1
                if take(result):
                    break
                checkpoint()
    except KeyboardInterrupt:
        if taken == 0:
            raise
        return True
    finally:
        results.close()
    return False
