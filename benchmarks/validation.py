"""Error rates and power of the tests in `validation`, by simulation, and rollouts per second on executors.

`python benchmarks/validation.py [--fast] [--json PATH]`. Error rates are measured at a level of 5 % per side, where
they can be seen; the tests themselves hold for every level.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import betaln

import certigym as cg
from certigym.synthesis.certificates import OnGrid
from certigym.validation.audits.step_tests import audit
from certigym.validation.audits.value_at import claimed_values
from certigym.validation.simulation.cluster import executor_for
from certigym.validation.statistics.binomial import REFUTED
from certigym.validation.statistics.sequential import log_e_at_least, log_e_at_most

LEVEL = 0.05


def first_crossings(log_e: np.ndarray) -> np.ndarray:
    """Return the first index (M,) at which rows (M, n) reach the level; n if they never do."""
    over = log_e >= -np.log(LEVEL)
    return np.where(over.any(axis=1), over.argmax(axis=1), log_e.shape[1])


def untruncated(k: np.ndarray, n: np.ndarray, bound: float) -> np.ndarray:
    """Return the mixture over all of [0, 1], with which limits exclude a P; no e-process against `P >= bound`."""
    mixture = betaln(0.5 + k, 0.5 + n - k) - betaln(0.5, 0.5)
    return np.asarray(mixture - k * np.log(bound) - (n - k) * np.log1p(-bound))


def sequential_rates(runs: int, length: int) -> list[dict[str, Any]]:
    """Measure how often sequential tests reject, and when, for true probabilities around a bound."""
    rows = []
    rng = np.random.default_rng(0)
    n = np.arange(1, length + 1)
    for bound in (0.1, 0.5, 0.9, 0.99):
        for shift in (-0.2, -0.05, 0.0, 0.05, 0.2):
            truth = bound + shift * min(bound, 1 - bound)
            refuted, confirmed, wrong, missed, steps = 0, 0, 0, 0, []
            for _ in range(runs // 500):
                k = np.cumsum(rng.random((500, length)) < truth, axis=1)
                against = first_crossings(log_e_at_least(k, n, bound))
                in_favour = first_crossings(log_e_at_most(k, n, bound))
                refuted += int((against < length).sum())
                confirmed += int((in_favour < length).sum())
                wrong += int((first_crossings(untruncated(k, n, bound)) < length).sum())
                steps += np.minimum(against, in_favour).tolist()
                missed += int((first_crossings(untruncated(k, n, truth)) < length).sum())
            rows.append(
                {
                    "bound": bound,
                    "truth": truth,
                    "refuted": refuted / runs,
                    "confirmed": confirmed / runs,
                    "untruncated_rejects": wrong / runs,
                    "median_episodes": float(np.median(steps)) + 1,
                    "limits_ever_missed": missed / runs,
                }
            )
    return rows


def loud_problem(cut: float = 0.0) -> cg.Problem:
    """Return a problem of two noisy scalar agents with a sequence of regions, cut back at each side."""
    agents = [
        cg.LinearAgent(
            name=name,
            A=[[0.9]],
            B=[[0.5]],
            noise_covariance=[[0.8]],
            state_low=[-4],
            state_high=[4],
            input_low=[-2],
            input_high=[2],
            initial_state=[0.3],
        )
        for name in ("one", "two")
    ]
    one, two = cg.Proposition("one", [1 + cut], [3 - cut]), cg.Proposition("two", [-3 + cut], [-1 - cut])
    task = cg.Specification("F (a & F c)", "co-safe")
    return cg.Problem(name="loud", horizon=4, agents=agents, propositions={"a": one, "c": two}, specification=task)


def audit_rates(runs: int) -> dict[str, float]:
    """Measure the false alarms of audits of a true, exact certificate at the level 5 %."""
    certificate = cg.synthesize(loud_problem(), 60).certificate
    values = claimed_values(certificate)
    alarms = sum(
        audit(certificate, 2000, seed=seed, values=values, confidence=1 - LEVEL).refuted for seed in range(runs)
    )
    return {"runs": runs, "level": LEVEL, "false_alarms": alarms / runs}


def needed(test: Any, most: int = 1_000_000) -> int | None:
    """Return the first of 250, 500, 1000 ... episodes with which a test refutes; None if no number does."""
    episodes = 250
    while episodes <= most:
        if test(episodes):
            return episodes
        episodes *= 2
    return None


def audit_power() -> list[dict[str, Any]]:
    """Measure the episodes until a sabotaged certificate is refuted at false alarm 1e-6, by audit and by outcomes."""
    believed = {f"noise x {f}": (loud_problem(), loud_problem().replace(disturbance_scale=f)) for f in (0.95, 0.9, 0.8)}
    believed |= {f"regions + {cut}": (loud_problem(cut), loud_problem()) for cut in (0.01, 0.05)}
    rows = []
    for name, (system, belief) in believed.items():
        wrong = cg.synthesize(belief, 80).certificate
        values = claimed_values(wrong)
        claim: OnGrid = replace(wrong, problem=system, exact=False)
        by_audit = needed(lambda m, c=claim, v=values: audit(c, m, values=v, confidence=1 - 1e-6).refuted)
        at_ends = needed(lambda m, c=claim: cg.validate(c, m, confidence=1 - 1e-6).verdict == REFUTED)
        rows.append({"believed": name, "claimed": wrong.lower_bound, "audit": by_audit, "end_points": at_ends})
    return rows


def throughput(episodes: int) -> list[dict[str, Any]]:
    """Measure rollouts per second on executors that are already running."""
    problem = cg.make_problem("reach-avoid-v0")
    controller = cg.synthesize(problem, 200).controller
    rows, first = [], None
    for name, dask, workers in (("alone", None, None), ("2 processes", None, 2), ("dask, 2 workers", "local", 2)):
        with executor_for(dask, workers) as executor:
            cg.rollout(problem, controller, 20_000, executor=executor)
            began = time.perf_counter()
            success = cg.rollout(problem, controller, episodes, executor=executor).success
            seconds = time.perf_counter() - began
        first = success if first is None else first
        same = bool(np.array_equal(success, first))
        rows.append({"executor": name, "episodes": episodes, "per_second": episodes / seconds, "same_bits": same})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--fast", action="store_true", help="a tenth of the runs")
    parser.add_argument("--json", metavar="PATH")
    options = parser.parse_args()
    scale = 1 if options.fast else 10
    result = {
        "sequential": sequential_rates(500 * scale, 2000),
        "audit_false_alarms": audit_rates(100 * scale),
        "audit_power": audit_power(),
        "throughput": throughput(100_000 * scale),
    }
    for name, rows in result.items():
        print(name)
        for row in rows if isinstance(rows, list) else [rows]:
            print("   ", "  ".join(f"{k}={v:.4g}" if isinstance(v, float) else f"{k}={v}" for k, v in row.items()))
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(result, file, indent=2)


if __name__ == "__main__":
    main()
