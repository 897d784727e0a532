"""An adversary: random problems, forged certificates and hostile files, against code that is not the package's own.

    python benchmarks/adversary.py claims --trials 800        random problems; certificates against ``independent``
    python benchmarks/adversary.py forgeries --trials 40      every field of certificates changed, digest recomputed
    python benchmarks/adversary.py kinds --kind paths         small problems of one kind, until 300 say something
    python benchmarks/adversary.py cells --kind paths         one entry of honest claims of one kind changed
    python benchmarks/adversary.py files                      hostile files and formulas, under limits

Every finding is printed with the seed that makes it. A claim is refuted if what was seen has probability below 1e-6,
divided by the number of trials, under the claim.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.stats import binom

import certigym as cg
from certigym.synthesis.certificates.proofs import ProductProof, delta_of, is_exact
from deployed import Deployed, arguments_of, problem_of
from forgeries import Forgery, forgeries, opened, written
from hostile import CASES, limited
from independent import successes
from kind_trials import INFLATION, forged_cells, trial
from measuring import Rows, show
from random_expressions import aimed_spec, polar_spec, uneven_spec, written_spec
from random_problems import Spec, random_spec
from small_problems import MAKERS

FALSE_ALARM = 1e-6
"""Probability that a campaign of true claims reports a refuted one."""


def drawn(seed: int, relation: str | None) -> Spec:
    """A random problem; those of `written`, `aimed`, `polar` and `uneven` have agents with expressions."""
    kinds = {"aimed": aimed_spec, "written": written_spec, "polar": polar_spec, "uneven": uneven_spec}
    return kinds[relation](seed) if relation in kinds else random_spec(seed, relation)


def claim(seed: int, episodes: int, level: float, relation: str | None = None) -> dict[str, Any]:
    """One random problem: certified, checked, and simulated by other code. ``finding`` is empty if all agree."""
    spec = drawn(seed, relation)
    result: dict[str, Any] = {"seed": seed, "text": spec["text"], "relation": spec["options"].get("relation", "auto")}
    try:
        problem = problem_of(spec)
        found = cg.synthesize(problem, **arguments_of(spec))
    except ValueError as error:
        return result | {"outcome": "refused", "reason": str(error).split("\n", 1)[0], "finding": ""}
    certificate, findings = found.certificate, []
    report = cg.check(certificate)
    if not report:
        findings.append(f"check refuses an honest certificate: {report}")
    number, beyond = successes(spec, Deployed(certificate, episodes, seed), episodes, seed)
    lower, gap = certificate.lower_bound, certificate.gap
    if binom.cdf(number, episodes, lower) < level:
        findings.append(f"claimed {lower}, {number} of {episodes} succeeded")
    if gap is not None and binom.sf(number - 1, episodes, min(1.0, lower + gap)) < level:
        findings.append(f"claimed at most {lower + gap}, {number} of {episodes} succeeded")
    most = found.stats.get("continuous_upper_bound")
    if isinstance(most, float) and binom.sf(number - 1, episodes, min(1.0, most)) < level:
        findings.append(f"no policy was to exceed {most}, {number} of {episodes} succeeded")
    if beyond > 0 and delta_of(certificate) == 0 and lower > 0:
        findings.append(f"an input was outside of its box by {beyond:.3g} of its width")
    visible = bool(lower > INFLATION and binom.cdf(number, episodes, min(1.0, lower + INFLATION)) < level)
    return result | {
        "outcome": "certified" if lower > 0 else "nothing certified",
        "lower": lower, "estimate": number / episodes, "visible": visible, "exact": is_exact(certificate),
        "finding": "; ".join(findings),
    }  # fmt: skip


def claims(trials: int, episodes: int, first: int, relation: str | None = None) -> int:
    """All random problems; the number of findings."""
    level, rows, reasons, began = FALSE_ALARM / (3 * trials), [], Counter[str](), time.time()
    for seed in range(first, first + trials):
        try:
            row = claim(seed, episodes, level, relation)
        except Exception as error:  # noqa: BLE001 a traceback is a finding, too
            row = {"seed": seed, "outcome": "error", "finding": f"{type(error).__name__}: {error}"}
        if row["finding"]:
            print(f"seed {row['seed']}: {row['finding']}", flush=True)
        if row["outcome"] == "refused":
            reasons[row["reason"][:70]] += 1
        rows.append(row)
        if sys.stderr.isatty():
            print(f"\r{len(rows)} of {trials}", end="", file=sys.stderr, flush=True)
    outcomes = Counter(str(row["outcome"]) for row in rows)
    certified = [row for row in rows if row["outcome"] == "certified"]
    table: Rows = [
        {
            "trials": trials, **outcomes, "exact": sum(bool(row["exact"]) for row in certified),
            f"visible +{INFLATION}": sum(bool(row["visible"]) for row in certified),
            "findings": sum(bool(row["finding"]) for row in rows), "minutes": (time.time() - began) / 60,
        }
    ]  # fmt: skip
    show("Random problems against an independent simulator", table)
    show("Reasons for refusing", [{"times": n, "reason": reason} for reason, n in reasons.most_common(12)])
    return sum(bool(row["finding"]) for row in rows)


def of_kind(kind: str, wanted: int, first: int, most: int, more: int) -> int:
    """Problems of one kind until so many are certified and non-trivial; the number of findings."""
    level, rows, reasons, began = FALSE_ALARM / most, list[dict[str, Any]](), Counter[str](), time.time()
    for seed in range(first, first + most):
        try:
            row = trial(kind, seed, level, more)
        except Exception as error:  # noqa: BLE001 a traceback is a finding, too
            row = {"seed": seed, "outcome": "error", "visible": False, "finding": f"{type(error).__name__}: {error}"}
        if row["finding"]:
            print(f"{kind}, seed {row['seed']}: {row['outcome']}: {row['finding']}", flush=True)
        if row["outcome"] == "refused":
            reasons[row["reason"][:70]] += 1
        rows.append(row)
        if sum(row["outcome"] in ("certified", "REFUTED") for row in rows) >= wanted:
            break
    count = Counter(str(row["outcome"]) for row in rows)
    told: Rows = [
        {
            "kind": kind, "problems": len(rows), "certified": count["certified"] + count["REFUTED"],
            "trivial": count["trivial"], "refused in words": count["refused"], "refuted": count["REFUTED"],
            "true, and refused": sum(row["finding"].startswith("true, and") for row in rows), "errors": count["error"],
            f"visible +{INFLATION}": sum(bool(row["visible"]) for row in rows), "minutes": (time.time() - began) / 60,
        }
    ]  # fmt: skip
    show("Small problems against an independent simulator", told)
    show("Reasons for refusing", [{"times": n, "reason": reason} for reason, n in reasons.most_common(12)])
    return sum(bool(row["finding"]) for row in rows)


def forged(spec: Spec, file: Path, forgery: Forgery, episodes: int, level: float) -> tuple[str, str]:
    """What became of one forgery, and a finding if it was accepted, or crashed something."""
    header, arrays = opened(file)
    forge, target = forgery[1], file.with_suffix(".forged.npz")
    try:
        forge(header, arrays)
        written(target, header, arrays)
    except (ValueError, TypeError, IndexError, OverflowError, KeyError):
        return "no such forgery", ""
    try:
        certificate = cg.load(target)
        report = cg.check(certificate)
        if report.recomputed > 0:  # the forger learns, and claims what would be proved
            lower = report.recomputed * (1 - 1e-9) - 1e-12
            header["proof"] |= {"lower_bound": lower, "bounds": {header["proof"]["bound"]: lower}, "gap": None}
            written(target, header, arrays)
            certificate = cg.load(target)
            report = cg.check(certificate)
    except ValueError:
        return "refused when read", ""
    except Exception as error:  # noqa: BLE001
        return "crashed", f"{type(error).__name__}: {error}"
    if not report:
        return "refused by the check", ""
    number, beyond = successes(spec, Deployed(certificate, episodes, 1), episodes, 1)
    lower, gap = certificate.lower_bound, certificate.gap
    if binom.cdf(number, episodes, lower) < level:
        return "ACCEPTED", f"claims {lower}, {number} of {episodes} succeeded"
    if gap is not None and report.above is not None and binom.sf(number - 1, episodes, min(1.0, lower + gap)) < level:
        return "ACCEPTED", f"claims at most {lower + gap}, {number} of {episodes} succeeded"
    if beyond > 1e-9 and lower > 0:
        return "ACCEPTED", f"an input was outside of its box by {beyond:.3g} of its width"
    return "true all the same", ""


def forge_all(trials: int, episodes: int, first: int, per_array: int, relation: str | None = None) -> int:
    """Forgeries of the certificates of ``trials`` random problems; the number of findings."""
    outcomes, findings, seed, done = Counter[str](), 0, first, 0
    kinds: Counter[str] = Counter()
    with TemporaryDirectory() as folder:
        while done < trials:
            seed += 1
            spec = drawn(seed, relation)
            try:
                certificate = cg.synthesize(problem_of(spec), **arguments_of(spec)).certificate
            except ValueError:
                continue
            if not 0.05 < certificate.lower_bound < 0.99 or isinstance(certificate.proof, ProductProof):
                continue
            done += 1
            kinds.update("+".join(sorted({part.relation["kind"] for part in certificate.proof.agents})).split("|"))
            file = Path(folder) / "certificate.npz"
            cg.save(certificate, file)
            rng = np.random.default_rng(seed)
            for forgery in list(forgeries(*opened(file), rng, per_array)):
                outcome, finding = forged(spec, file, forgery, episodes, FALSE_ALARM / (1000 * trials))
                outcomes[outcome] += 1
                if finding:
                    findings += 1
                    print(f"seed {seed}: {forgery[0]}: {outcome}: {finding}", flush=True)
    show("Forgeries", [{"certificates": trials, **outcomes, "findings": findings}])
    show("Relations", [dict(kinds)])
    return findings


def forge_cells(kind: str, wanted: int, first: int, each: int) -> int:
    """Forgeries of one cell of so many honest claims of a kind; the number of findings."""
    outcomes, sorts, findings, done, seed = Counter[str](), Counter[str](), 0, 0, first
    while done < wanted and seed < first + 40 * wanted:
        forged = forged_cells(kind, seed, each, FALSE_ALARM / (1000 * wanted))
        for name, outcome, finding in forged:
            outcomes[outcome] += 1
            sorts[f"{name}: {outcome}"] += 1
            if finding:
                findings += 1
                print(f"{kind}, seed {seed}: {name}: {outcome}: {finding}", flush=True)
        done, seed = done + bool(forged), seed + 1
    show("Forgeries of one cell", [{"kind": kind, "claims": done, **outcomes, "findings": findings}])
    show("Sorts", [{"times": n, "what": sort} for sort, n in sorted(sorts.items())])
    return findings


def files() -> int:
    """All hostile files, formulas and numbers, each in a process of its own; the number of findings."""
    rows = [row for name in CASES for row in limited([name])]
    findings = [row for row in rows if row["outcome"].startswith("crashed")]
    for row in findings:
        print(f"{row['case']}: {row['outcome']}", flush=True)
    outcomes = Counter(row["outcome"] for row in rows if row not in findings)
    slowest = max(row.get("seconds", 0.0) for row in rows)
    largest = max(row.get("bytes", 0) for row in rows) / 2**20
    table: Rows = [
        {"cases": len(rows), **outcomes, "findings": len(findings), "slowest s": slowest, "largest MiB": largest}
    ]
    show("Hostile files, formulas and numbers", table)
    return len(findings)


def main() -> int:
    """Run one part of the campaign; the exit status is 1 if there are findings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=["claims", "kinds", "cells", "forgeries", "files"])
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--episodes", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0, help="first seed")
    parser.add_argument(
        "--relation", help="one relation, such as linear; `written`, `aimed`, `polar`, `uneven`: expressions"
    )
    parser.add_argument("--kind", choices=sorted(MAKERS), default="states", help="kind of small problems")
    parser.add_argument("--more", type=int, default=15, help="how much longer the second look is")
    parser.add_argument("--per-array", type=int, default=4, help="forgeries of each array of a certificate")
    given = parser.parse_args()
    if given.part == "files":
        return int(files() > 0)
    if given.part == "kinds":
        return int(of_kind(given.kind, given.trials, given.seed, 10 * given.trials, given.more) > 0)
    if given.part == "cells":
        return int(forge_cells(given.kind, given.trials, given.seed, given.per_array) > 0)
    if given.part == "claims":
        return int(claims(given.trials, given.episodes, given.seed, given.relation) > 0)
    return int(forge_all(given.trials, given.episodes // 5, given.seed, given.per_array, given.relation) > 0)


if __name__ == "__main__":
    raise SystemExit(main())
