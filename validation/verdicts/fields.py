"""Test a certificate over a whole set of initial states, and search for its weakest one.

At every state the value function is a claim of its own, ``P_x >= V(x)``. All of them are tested at once: exact binomial
p-values, Holm-adjusted over the states, the claims and their opposites as two families. A true certificate is then
refuted anywhere with probability at most ``(1 - confidence) / 2``, whatever the number of states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from ...envs.agents import write_json
from ...synthesis.certificates import as_certificate, rounded_down
from ..simulation import ChunkResult, Loop, Mismatch, TrialOptions, TrialPlan, collect, planned, stream
from ..statistics import CONFIRMED, CONSISTENT, REFUTED, check_confidence, clopper_pearson, holm, p_at_least, p_at_most
from .starts import corner_starts, neighbours, random_starts


@dataclass(frozen=True, eq=False)
class FieldReport:
    """Claims and rollouts at N initial states.

    Parameters
    ----------
    states : (N, D) array
        Joint initial states, in state units.
    lower_bounds : (N,) array
        The certificate's claims there.
    successes, episodes : (N,) int arrays
    ci_low, ci_high : (N,) arrays
        Exact limits at ``confidence``, each state for itself (for maps; the tests below are simultaneous).
    p_refuted, p_confirmed : (N,) arrays
        Holm-adjusted p-values against the claims and against their opposites.
    confidence : float
    seed, chunk : int
    shape : tuple of int
        Points per axis if the states are a slice, else ``(N,)``.
    interrupted : bool
        Whether fewer episodes were run than asked for.
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
        """Estimates minus claims (N,); negative where the rollouts fall short."""
        return self.estimates - self.lower_bounds

    @property
    def refuted(self) -> NDArray[np.bool_]:
        """Where (N,) the claim is refuted, all states tested together."""
        return np.asarray(self.p_refuted <= 0.5 * (1.0 - self.confidence))

    @property
    def confirmed(self) -> NDArray[np.bool_]:
        """Where (N,) the claim is confirmed, all states tested together."""
        return np.asarray((self.p_confirmed <= 0.5 * (1.0 - self.confidence)) | (self.lower_bounds <= 0.0))

    @property
    def verdict(self) -> str:
        """``refuted`` if the claim is refuted anywhere, ``confirmed`` if everywhere confirmed, else ``consistent``."""
        return REFUTED if self.refuted.any() else CONFIRMED if self.confirmed.all() else CONSISTENT

    @property
    def fraction_refuted(self) -> float:
        """Share of the states at which the claim is refuted."""
        return float(self.refuted.mean())

    @property
    def weakest(self) -> int:
        """Number of the state with the smallest p-value against the claim; ties go to the smallest margin."""
        return int(np.lexsort((self.margins, self.p_refuted))[0])

    def to_dict(self) -> dict[str, Any]:
        """Everything as JSON values."""
        arrays = ("states", "lower_bounds", "successes", "episodes", "ci_low", "ci_high", "p_refuted", "p_confirmed")
        w = self.weakest
        return {
            "verdict": self.verdict, "n_states": len(self.states), "fraction_refuted": self.fraction_refuted,
            "fraction_confirmed": float(self.confirmed.mean()), "confidence": self.confidence, "seed": self.seed,
            "chunk": self.chunk, "shape": list(self.shape), "interrupted": self.interrupted,
            "weakest": {"state": self.states[w].tolist(), "lower_bound": float(self.lower_bounds[w]),
                        "estimate": float(self.estimates[w]), "ci_low": float(self.ci_low[w]),
                        "ci_high": float(self.ci_high[w]), "p_refuted": float(self.p_refuted[w])},
            **{name: getattr(self, name).tolist() for name in arrays},
            "margins": self.margins.tolist(),
        }  # fmt: skip

    def save(self, path: str | Path) -> None:
        """Write ``to_dict()`` as JSON."""
        write_json(path, self.to_dict())

    def __str__(self) -> str:
        w = self.weakest
        state = ", ".join(f"{x:.4g}" for x in self.states[w])
        return "\n".join(
            [
                f"field        {len(self.states)} initial states, {int(self.episodes.sum())} episodes",
                f"refuted      at {int(self.refuted.sum())} of them ({100 * self.fraction_refuted:.1f} %)",
                f"confirmed    at {int(self.confirmed.sum())} of them",
                f"weakest      ({state}): claimed {rounded_down(self.lower_bounds[w])}, "
                f"simulated {self.estimates[w]:.6f} [{self.ci_low[w]:.6f}, {self.ci_high[w]:.6f}], "
                f"adjusted p {self.p_refuted[w]:.2g}",
                f"verdict      {self.verdict}",
            ]
        )


def validate_field(
    certificate: Any,
    states: Any,
    plan: TrialPlan | int | None = None,
    *,
    shape: tuple[int, ...] | None = None,
    mismatch: Mismatch | None = None,
    **trial: Unpack[TrialOptions],
) -> FieldReport:
    """Test the claims at many initial states together.

    A true certificate is refuted anywhere with probability at most ``(1 - confidence) / 2``.

    Parameters
    ----------
    certificate : Synthesis, Certificate, ProductCertificate or path
    states : array_like, shape (N, D)
        Joint initial states (see ``validation.verdicts.starts``).
    plan, **trial
        Episodes of each state (default 2000), seed, confidence (.999), chunk, executor, progress; see ``TrialPlan``.
        After Ctrl-C the report is about those finished, about equally many of each state.
    shape : tuple of int, optional
        Shape of the slice that the states are.
    mismatch : Mismatch, optional
        As in ``validate``.

    Raises
    ------
    ValueError
        If a shape or number is wrong.
    """
    settled = planned(plan, trial, 2000)
    certificate = as_certificate(certificate)
    check_confidence(settled.confidence)
    states = np.atleast_2d(np.asarray(states, dtype=float))
    claims = certificate.at(states)
    shape = (len(states),) if shape is None else tuple(shape)
    if int(np.prod(shape)) != len(states):
        raise ValueError(f"`shape`: expected sizes whose product is {len(states)}, got {shape}")
    loop = Loop(certificate.problem, certificate.controller, settled.seed, settled.chunk, states, mismatch)
    successes, tried = (np.zeros(len(states), dtype=np.int64) for _ in range(2))

    def take(part: ChunkResult) -> None:
        # episode r began at state r modulo N
        which = np.arange(tried.sum(), tried.sum() + len(part.success)) % len(states)
        successes[:] += np.bincount(which, weights=part.success, minlength=len(states)).astype(np.int64)
        tried[:] += np.bincount(which, minlength=len(states))
        settled.tell(len(part.success))

    interrupted = collect(stream(loop, settled.episodes * len(states), settled.executor), take)
    if tried.min() == 0:  # some state has not been tried at all
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

    Half of the episodes go into rounds that each keep the worse half of the candidates (by p-value against the claim)
    and add neighbours of them; the other half tests the ``keep`` last ones with another seed, so that the selection
    does not bias the test.

    Parameters
    ----------
    certificate : Synthesis, Certificate, ProductCertificate or path
    plan, **trial
        Episodes in all (default 100,000), seed, confidence (.999), chunk, executor, progress; see ``TrialPlan``.
    candidates : array_like, shape (N, D), optional
        Where the search begins; default: the corners of the workspaces and 192 random states.
    keep : int
        Finalists.

    Returns
    -------
    FieldReport
        About the finalists; after Ctrl-C, about the candidates of the round that was going on.
    """
    settled = planned(plan, trial, 100_000)
    certificate, seed = as_certificate(certificate), settled.seed
    problem = certificate.problem
    if candidates is None:
        candidates = np.concatenate([corner_starts(problem), random_starts(problem, 192, seed)])
    states = np.atleast_2d(np.asarray(candidates, dtype=float))
    rounds = max(1, int(np.ceil(np.log2(max(len(states) / keep, 2)))))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2**31 + 1,)))
    for k in range(rounds):
        each = max(1, settled.episodes // (2 * rounds * len(states)))
        pilot = validate_field(certificate, states, replace(settled, episodes=each, seed=_derived(seed, k)))
        if pilot.interrupted:
            return pilot
        order = np.lexsort((pilot.margins, p_at_least(pilot.successes, pilot.episodes, pilot.lower_bounds)))
        last = k == rounds - 1
        worst = states[order[: keep if last else max(keep, len(states) // 3)]]
        states = worst if last else np.concatenate([worst, neighbours(certificate, worst[: len(worst) // 2], rng)])
    each = max(1, settled.episodes // (2 * len(states)))
    return validate_field(certificate, states, replace(settled, episodes=each, seed=_derived(seed, rounds)))


def _derived(seed: int, number: int) -> int:
    """Seed of one round, unrelated to the seeds of others."""
    return int(np.random.SeedSequence(seed, spawn_key=(2**31 + 2, number)).generate_state(1, np.uint64)[0] >> 1)
