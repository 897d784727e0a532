"""The published T = 6 certificate of Fig. 3 against the continuous system at the stated noise.

The published value at a cell is a claim about the satisfaction probability from the states of that cell under the
published policy. Here this policy is carried out on the continuous system: each agent uses the input of the cell of its
state. The claims at many initial states are tested at once (Holm's method over the states).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.simulation import Dynamics, Worlds
from ....envs.simulation import batch_simulator as core
from ....envs.suite import make_problem
from ....synthesis.relations.grids import FloatArray
from ....synthesis.verbs.synthesize import synthesize
from ...statistical_tests import REFUTED, holm, p_at_least, validate
from .published import INPUTS, PublishedStep, published_curve, published_grid
from .reproduction import PieceResult, Reproduction


@dataclass(frozen=True, eq=False)
class PublishedPolicy:
    """The published policies as a controller: each agent uses the input of the cell of its state."""

    policies: NDArray[Any]

    def batch(self, dynamics: Dynamics) -> PublishedPolicy:
        """Return the policy itself, which serves batches."""
        return self

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> None:
        """Return no memory."""

    def act(self, worlds: Worlds, memory: None) -> tuple[tuple[FloatArray, ...], None]:
        """Return the inputs (1, 2, M) of both agents."""
        # States outside the workspace have failed; they count as in the nearest cell.
        grid = published_grid()
        (states,) = worlds.states
        edges = grid.edges[0]
        cells = grid.cell_of(np.clip(states, edges[0], edges[-1]))
        return (INPUTS[self.policies[worlds.time][np.arange(2)[:, None], cells]][None],), None


def refute_published(
    horizon: int = 6,
    states: tuple[int, int] = (40, 5),
    episodes: int = 20_000,
    seed: int = 0,
    confidence: float = 0.999,
) -> dict[str, Any]:
    """Test the published certificate, and certificates of this package at the stated noise, by rollouts.

    These are the numbers of ``certigym reproduce refutation``.

    Parameters
    ----------
    horizon : int
        Horizon T of the certificate.
    states : (int, int)
        Initial states per agent, evenly spread over the region x1 in [-20, 0], x2 in [-5, -2.5] (cell centres).
    episodes : int
        Rollouts per initial state.
    seed : int
    confidence : float
        If all claims are true, any is refuted with probability at most ``1 - confidence`` (Holm).

    Returns
    -------
    dict
        ``T, initial_states, refuted, fraction_refuted, worst_initial_state, worst_excess, verdict,
        right_noise_verdict`` and more detail.
    """
    step = published_curve(horizon)[-1]
    starts, claims = _field(step, states)
    successes = _simulate(step, starts, episodes, seed)
    refuted = holm(p_at_least(successes, episodes, np.minimum(claims, 1.0))) <= 1.0 - confidence
    # Where the success rate is furthest below the claim.
    estimates = successes / episodes
    excess = claims - estimates
    worst = int(np.argmax(excess))
    right = _right_noise(horizon, episodes * 5, seed, confidence)
    return {
        "T": horizon,
        "initial_states": len(starts),
        "episodes_per_state": episodes,
        "refuted": int(refuted.sum()),
        "fraction_refuted": float(refuted.mean()),
        "fraction_below_claim": float(np.mean(excess > 0)),
        "published_mean": step.mean,
        "simulated_mean": float(estimates.mean()),
        "worst_initial_state": [float(x) for x in starts[worst]],
        "worst_claim": float(claims[worst]),
        "worst_estimate": float(estimates[worst]),
        "worst_excess": float(excess[worst]),
        "verdict": REFUTED if refuted.any() else "consistent",
        "right_noise_verdict": right["verdict"],
        "right_noise": right,
        "confidence": confidence,
        "seed": seed,
    }


def _field(step: PublishedStep, states: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """Return initial states (N, 2), centres of cells of the region, and the published claims (N,) there."""
    centres = published_grid().centres[:, 0]
    first = np.linspace(0, 799, states[0]).round().astype(int)
    second = np.linspace(0, 99, states[1]).round().astype(int)
    rows, columns = (numbers.ravel() for numbers in np.meshgrid(first, second, indexing="ij"))
    return np.column_stack([centres[rows], centres[600 + columns]]), step.field[rows, columns]


def _simulate(step: PublishedStep, starts: FloatArray, episodes: int, seed: int) -> NDArray[np.int64]:
    """Return the successes (N,) of ``episodes`` rollouts from each start, at the stated noise; one generator each."""
    # Chunks would mix starts; here every start has one batch of worlds and one generator.
    dynamics = Dynamics.of(make_problem("reach-avoid-v0", horizon=step.horizon))
    policy = PublishedPolicy(step.policies)
    successes = np.empty(len(starts), dtype=np.int64)
    for k, start in enumerate(starts):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(k,)))
        worlds = core.initial_at(dynamics, np.tile(start, (episodes, 1)))
        for _ in range(step.horizon):
            inputs, _ = policy.act(worlds, None)
            worlds = core.transition(dynamics, worlds, inputs, core.noise(dynamics, rng, episodes))
        successes[k] = int(core.satisfied(dynamics, worlds).sum())
    return successes


def _right_noise(horizon: int, episodes: int, seed: int, confidence: float) -> dict[str, Any]:
    """Return the tests of certificates at the stated noise, under the paper's relation and the exact one.

    They are tested by rollouts whose starts are uniform in the region.
    """
    problem = make_problem("reach-avoid-v0", horizon=horizon)
    outcomes = {}
    for relation in ("paper", "exact"):
        report = validate(synthesize(problem, 1000, relation=relation), episodes, seed=seed, confidence=confidence)
        outcomes[relation] = {"lower_bound": report.lower_bound, "estimate": report.estimate, "verdict": report.verdict}
    wrong = [outcome["verdict"] for outcome in outcomes.values() if outcome["verdict"] == REFUTED]
    return {"verdict": REFUTED if wrong else outcomes["paper"]["verdict"], **outcomes}


def refutation() -> Reproduction:
    """Refute the published certificate: one piece, whose result is its only row."""
    return Reproduction({"the certificate at T = 6": _refuted}, _only)


def _refuted() -> PieceResult:
    result = refute_published()
    return PieceResult(result, f"{result['verdict']} at {result['refuted']} of {result['initial_states']} states")


def _only(found: Sequence[Any], out: Path) -> Any:
    """Return the only result; its lines are all that is written."""
    (result,) = found
    return result
