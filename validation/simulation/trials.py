"""How many episodes are simulated, from which seed, where: one record for every verb that simulates.

Verbs take a plan, a number of episodes, or the fields of a plan as keywords:
``validate(result, 5000, seed=3)`` is ``validate(result, TrialPlan(episodes=5000, seed=3))``.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, replace
from typing import TypedDict, TypeVar

from .loop import CHUNK, check_whole
from .spread import Executor, interrupts_at_checkpoints

Part = TypeVar("Part")


class TrialOptions(TypedDict, total=False):
    """The fields of a ``TrialPlan`` as keyword arguments."""

    episodes: int | None
    seed: int
    confidence: float | None
    chunk: int
    executor: Executor | None
    progress: Callable[[int], None] | None


@dataclass(frozen=True)
class TrialPlan:
    """How rollouts are made and how sure their limits are.

    Parameters
    ----------
    episodes : int, optional
        How many, a positive number; default: that of the verb.
    seed : int
        Determines every number drawn, together with ``chunk``.
    confidence : float, optional
        Of two-sided limits and verdicts, between 0 and 1; default: that of the verb.
    chunk : int
        Worlds per chunk of the simulation; part of the random record.
    executor : Executor, optional
        Where chunks are computed; default: this process. Results are the same for any.
    progress : callable, optional
        Called with the number of episodes finished since the last call.

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
    progress: Callable[[int], None] | None = None

    def __post_init__(self) -> None:
        if self.episodes is not None:
            check_whole("episodes", self.episodes, 1)
        for name, least in (("seed", 0), ("chunk", 1)):
            check_whole(name, getattr(self, name), least)
        if self.executor is not None and not hasattr(self.executor, "submit"):
            raise ValueError(
                f"`executor`: expected an object with `submit`, got {self.executor!r}; open one with `executor_for`, "
                "or take a pool of `concurrent.futures`"
            )

    def tell(self, count: int) -> None:
        """Report that so many more episodes are finished."""
        if self.progress is not None:
            self.progress(count)


class Plan(TrialPlan):
    """A plan in which the number of episodes and the confidence are settled."""

    episodes: int
    confidence: float


def planned(plan: TrialPlan | int | None, options: TrialOptions, episodes: int, confidence: float = 0.999) -> Plan:
    """The plan that was given, in any form, with the defaults of the verb."""
    if plan is not None and not isinstance(plan, TrialPlan):
        check_whole("episodes", plan, 1)
        plan = TrialPlan(episodes=plan)
    whole = replace(TrialPlan() if plan is None else plan, **options)
    settled = {
        "episodes": episodes if whole.episodes is None else whole.episodes,
        "confidence": confidence if whole.confidence is None else whole.confidence,
    }
    return Plan(**{**vars(whole), **settled})


def collect(parts: Generator[Part, None, None], take: Callable[[Part], bool | None]) -> bool:
    """Hand parts to ``take`` until there are no more or it returns True; whether Ctrl-C came first.

    The one way in which a simulation is interrupted: what was taken by then stays, and the caller reports about it.
    Interrupted before the first part, KeyboardInterrupt is raised, for there is nothing to report.
    """
    taken = 0
    try:
        with interrupts_at_checkpoints() as checkpoint:
            for part in parts:
                taken += 1
                if take(part):
                    break
                checkpoint()
    except KeyboardInterrupt:
        if taken == 0:
            raise
        return True
    finally:
        parts.close()
    return False
