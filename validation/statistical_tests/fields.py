"""Test a certificate at a whole set of initial states, and search for the state at which it is weakest.

At every state the value function makes a claim, ``P_x >= V(x)``. All claims are tested at once: exact binomial p-values
are adjusted by Holm's method over the states, the claims and their opposites as two families. A true certificate is
then refuted anywhere with probability at most ``(1 - confidence) / 2``, for any number of states
(docs/theory/evidence.md, "Many claims").
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from ...envs.systems.arguments import counted, shortened, tree_text
from ...synthesis.certificates.proofs import certificate_on_grids, rounded_down
from .binomial import (
    CONFIRMED,
    CONSISTENT,
    REFUTED,
    VACUOUS,
    check_confidence,
    clopper_pearson,
    holm,
    p_at_least,
    p_at_most,
)
from .chunks import ChunkResult
from .loop import Loop
from .mismatch import Mismatch
from .report_text import INTERRUPTED, Rows, Saved, html_table, labelled_lines
from .rollouts import stream
from .starts import corner_starts, neighbours, random_starts
from .trials import TrialOptions, TrialPlan, collect, names_plan, planned

CANDIDATES = 192
"""Random states with which a search begins; with up to 64 corners they make 256, enough for five rounds."""

MEANINGS_OF_FIELDS = {
    CONFIRMED: "the rollouts confirm the claim at every state",
    CONSISTENT: "the rollouts refute no claim",
    REFUTED: "the rollouts contradict the claim at some states",
    VACUOUS: "the certificate claims P >= 0 at every state, which says nothing",
}
"""What each verdict on all states together says."""


@dataclass(frozen=True, eq=False, repr=False)
class FieldReport(Saved):
    """The claims of a certificate at N initial states beside what rollouts show there.

    Parameters
    ----------
    states : (N, D) array
        Joint initial states, in state units.
    lower_bounds : (N,) array
        The certificate's claims there.
    successes, episodes : (N,) int arrays
    ci_low, ci_high : (N,) arrays
        Exact limits at ``confidence`` for each state alone; they are for maps, while the tests are simultaneous.
    p_refuted, p_confirmed : (N,) arrays
        Holm-adjusted p-values against the claims and against their opposites.
    confidence : float
    seed, chunk : int
    shape : tuple of int
        Points per axis if the states are a slice, otherwise ``(N,)``.
    interrupted : bool
        Whether Ctrl-C ended the rollouts early.
    """

    states: NDArray[Any]
    lower_bounds: NDArray[Any]
    successes: NDArray[Any]
    episodes: NDArray[Any]
    ci_low: NDArray[Any]
    ci_high: NDArray[Any]
    p_refuted: NDArray[Any]
    p_confirmed: NDArray[Any]
    confidence: float
    seed: int
    chunk: int
    shape: tuple[int, ...]
    interrupted: bool = False

    @property
    def estimates(self) -> NDArray[Any]:
        """Shares (N,) of successes."""
        return np.asarray(self.successes / np.maximum(self.episodes, 1))

    @property
    def margins(self) -> NDArray[Any]:
        """Estimates minus claims (N,); negative where the share of successes is below the bound."""
        return self.estimates - self.lower_bounds

    @property
    def refuted(self) -> NDArray[np.bool_]:
        """Whether the claim is refuted (N,), all states tested together."""
        return np.asarray(self.p_refuted <= 0.5 * (1.0 - self.confidence))

    @property
    def confirmed(self) -> NDArray[np.bool_]:
        """Whether the claim is confirmed (N,), all states tested together; a claim of 0 never is."""
        return np.asarray((self.p_confirmed <= 0.5 * (1.0 - self.confidence)) & ~self.vacuous)

    @property
    def vacuous(self) -> NDArray[np.bool_]:
        """Whether the certificate claims nothing (N,): a bound of 0, which holds for every system."""
        return np.asarray(self.lower_bounds <= 0.0)

    @property
    def verdict(self) -> str:
        """``refuted`` if that at some state; ``confirmed`` or ``vacuous`` if that at all; otherwise ``consistent``."""
        if self.refuted.any():
            return REFUTED
        if self.vacuous.all():
            return VACUOUS
        return CONFIRMED if self.confirmed.all() else CONSISTENT

    @property
    def fraction_refuted(self) -> float:
        """Share of the states at which the claim is refuted."""
        return float(self.refuted.mean())

    @property
    def weakest(self) -> int:
        """Index of the state with the smallest p-value against the claim; ties go to the smallest margin."""
        return int(np.lexsort((self.margins, self.p_refuted))[0])

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        arrays = ("states", "lower_bounds", "successes", "episodes", "ci_low", "ci_high", "p_refuted", "p_confirmed")
        w = self.weakest
        return {
            "verdict": self.verdict,
            "n_states": len(self.states),
            "fraction_refuted": self.fraction_refuted,
            "fraction_confirmed": float(self.confirmed.mean()),
            "fraction_vacuous": float(self.vacuous.mean()),
            "confidence": self.confidence,
            "seed": self.seed,
            "chunk": self.chunk,
            "shape": list(self.shape),
            "interrupted": self.interrupted,
            "weakest": {
                "state": self.states[w].tolist(),
                "lower_bound": float(self.lower_bounds[w]),
                "estimate": float(self.estimates[w]),
                "ci_low": float(self.ci_low[w]),
                "ci_high": float(self.ci_high[w]),
                "p_refuted": float(self.p_refuted[w]),
            },
            **{name: getattr(self, name).tolist() for name in arrays},
            "margins": self.margins.tolist(),
        }

    def __str__(self) -> str:
        return labelled_lines([("field", self._title()), *self._rows()])

    def __repr__(self) -> str:
        return tree_text(f"FieldReport: {self._title()}", self._rows())

    def _repr_html_(self) -> str:
        return html_table(f"Field: {self._title()}", self._rows())

    def _title(self) -> str:
        """Return the numbers of states and episodes."""
        return f"{counted(len(self.states), 'initial state')}, {counted(int(self.episodes.sum()), 'episode')} in all"

    def _rows(self) -> Rows:
        """Return the numbers of refuted and confirmed states, the weakest state and the verdict, by label."""
        w = self.weakest
        state = shortened(", ".join(f"{x:.4g}" for x in self.states[w]), 80)
        estimate = f"simulated {self.estimates[w]:.6f} [{self.ci_low[w]:.6f}, {self.ci_high[w]:.6f}]"
        return [
            ("refuted", f"at {counted(int(self.refuted.sum()), 'state')} ({100 * self.fraction_refuted:.1f} %)"),
            ("confirmed", f"at {counted(int(self.confirmed.sum()), 'state')}, all states tested together"),
            *([("vacuous", f"at {counted(int(self.vacuous.sum()), 'state')}: P >= 0")] if self.vacuous.any() else []),
            ("weakest", f"at ({state}): certified P >= {rounded_down(self.lower_bounds[w])}, {estimate}"),
            *([("interrupted", INTERRUPTED)] if self.interrupted else []),
            ("verdict", f"{self.verdict}: {MEANINGS_OF_FIELDS[self.verdict]}"),
        ]


@names_plan
def validate_field(
    certificate: Any,
    states: Any,
    plan: TrialPlan | int | None = None,
    *,
    shape: tuple[int, ...] | None = None,
    mismatch: Mismatch | None = None,
    **trial: Unpack[TrialOptions],
) -> FieldReport:
    """Test the claims of a certificate at many initial states together.

    A true certificate is refuted anywhere with probability at most ``(1 - confidence) / 2``.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
    states : array_like, shape (N, D)
        Joint initial states (see ``validation.verdicts.starts``).
    plan, **trial
        Episodes per state (default 2000), seed, confidence (.999), chunk, executor, progress; see ``TrialPlan``. After
        Ctrl-C the report is about the episodes finished by then, about equally many per state.
    shape : tuple of int, optional
        Points per axis, if the states are a slice.
    mismatch : Mismatch, optional
        Simulate a system that differs from the certified model.

    Raises
    ------
    ValueError
        If a shape or number is wrong.
    KeyboardInterrupt
        If Ctrl-C came before every state had an episode.
    """
    settled = planned(plan, trial, 2000)
    certificate = certificate_on_grids(certificate)
    check_confidence(settled.confidence)
    states = np.atleast_2d(np.asarray(states, dtype=float))
    claims = certificate.at(states)
    shape = (len(states),) if shape is None else tuple(shape)
    if int(np.prod(shape)) != len(states):
        raise ValueError(f"`shape`: expected sizes whose product is {len(states)}, got {shape}")
    loop = Loop(certificate.problem, certificate.controller, settled.seed, settled.chunk, states, mismatch)
    successes, tried = (np.zeros(len(states), dtype=np.int64) for _ in range(2))

    def take(result: ChunkResult) -> None:
        # Episode r began at state r modulo N, so that all states get their episodes at the same pace.
        which = np.arange(tried.sum(), tried.sum() + len(result.success)) % len(states)
        successes[:] += np.bincount(which, weights=result.success, minlength=len(states)).astype(np.int64)
        tried[:] += np.bincount(which, minlength=len(states))
        settled.tell(len(result.success))

    interrupted = collect(stream(loop, settled.episodes * len(states), settled.executor), take)
    if tried.min() == 0:  # a state without any episode has no estimate
        raise KeyboardInterrupt
    limits = [clopper_pearson(int(k), int(n), settled.confidence) for k, n in zip(successes, tried, strict=True)]
    return FieldReport(
        states=states,
        lower_bounds=claims,
        successes=successes,
        episodes=tried,
        ci_low=np.array([low for low, _ in limits]),
        ci_high=np.array([high for _, high in limits]),
        p_refuted=holm(p_at_least(successes, tried, claims)),
        p_confirmed=holm(p_at_most(successes, tried, claims)),
        confidence=settled.confidence,
        seed=settled.seed,
        chunk=settled.chunk,
        shape=shape,
        interrupted=interrupted,
    )


def find_weakest(
    certificate: Any,
    plan: TrialPlan | int | None = None,
    *,
    candidates: Any = None,
    keep: int = 8,
    **trial: Unpack[TrialOptions],
) -> FieldReport:
    """Search for the initial state at which a certificate is weakest, then test the finalists on fresh noise.

    Half of the episodes are spent on rounds. Each round keeps the third of the candidates with the smallest p-values
    against the claim, and adds neighbours of the worst of them. The other half of the episodes tests the ``keep``
    finalists with another seed, so that the selection does not bias the test.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
    plan, **trial
        Episodes in all (default 100,000), seed, confidence (.999), chunk, executor, progress; see ``TrialPlan``.
    candidates : array_like, shape (N, D), optional
        States with which the search begins; default: corners of the workspaces and 192 random states.
    keep : int
        Number of finalists.

    Returns
    -------
    FieldReport
        About the finalists; after Ctrl-C, about the candidates of the round that was under way.
    """
    settled = planned(plan, trial, 100_000)
    certificate, seed = certificate_on_grids(certificate), settled.seed
    problem = certificate.problem
    if candidates is None:
        candidates = np.concatenate([corner_starts(problem), random_starts(problem, CANDIDATES, seed)])
    states = np.atleast_2d(np.asarray(candidates, dtype=float))
    # Each round about halves the candidates, until the finalists are left.
    rounds = max(1, int(np.ceil(np.log2(max(len(states) / keep, 2)))))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2**31 + 1,)))
    for k in range(rounds):
        # A short test of all candidates with a fresh seed.
        each = max(1, settled.episodes // (2 * rounds * len(states)))
        pilot = validate_field(certificate, states, replace(settled, episodes=each, seed=_derived(seed, k)))
        if pilot.interrupted:
            return pilot
        # Keep the worst ones, and look around the worst half of these; the last round leaves the finalists.
        order = np.lexsort((pilot.margins, p_at_least(pilot.successes, pilot.episodes, pilot.lower_bounds)))
        last = k == rounds - 1
        worst = states[order[: keep if last else max(keep, len(states) // 3)]]
        states = worst if last else np.concatenate([worst, neighbours(certificate, worst[: len(worst) // 2], rng)])
    each = max(1, settled.episodes // (2 * len(states)))
    return validate_field(certificate, states, replace(settled, episodes=each, seed=_derived(seed, rounds)))


def _derived(seed: int, number: int) -> int:
    """Return the seed of one round, unrelated to the seeds of the others."""
    return int(np.random.SeedSequence(seed, spawn_key=(2**31 + 2, number)).generate_state(1, np.uint64)[0] >> 1)
