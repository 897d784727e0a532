"""Mutation testing of the trusted base: who notices one wrong line?

    python benchmarks/mutations.py [--only FROM TO] [--covered DATA] [--json PATH] [--page]

Every mutant (``mutants``) is made in a temporary copy of the tree. There certificates are made and judged in a process
of its own:

*claim*     whether a certificate of the mutant is false: refuted by a simulator that shares no code with the package
            (``independent``), at a probability below 1e-7.
*check*     whether the mutant's own ``check`` refuses all false certificates, or any others. A mutant of a module that
            search and check share may deceive both.
*rollouts*  whether the package's own rollouts refute a false one.
*forgeries* which of a few forged certificates the mutant's check accepts; an honest check accepts none.
*tests*     the first test that fails. The one that noticed last time (``docs/mutations.json``) is asked first, then
            those that run the line, the quickest first, if ``--covered`` names what ``coverage`` wrote with one context
            per test (``dynamic_context = test_function``); otherwise a fixed selection.

With ``--json`` rows are added to those that the file has, so that a run may be cut in parts.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.stats import binom

from measuring import Row, Rows, save, show
from mutants import MUTANTS, Mutant

ROOT = Path(__file__).resolve().parents[1]
EPISODES, LEVEL = 30_000, 1e-7
TREES = (
    "envs", "synthesis", "validation", "src", "tests", "benchmarks", "docs", "examples", "pyproject.toml", "Makefile",
    "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "constraints.txt",
)  # fmt: skip
TESTS = (
    "test_one_row_of_one_step_decides.py", "test_noise_of_any_law.py", "test_the_check_grows_trains_itself.py",
    "test_claims_agree_with_an_independent_evaluation.py", "test_kernel_is_a_lower_bound.py",
    "test_cells_are_found_exactly.py", "test_labeling.py", "test_regions_are_what_they_are.py",
    "test_controllers_carry_out_what_is_certified.py",
    "test_guards_of_certificates_are_verified.py", "test_proofs_ask_about_the_start.py",
    "test_guards_are_disjoint.py", "test_tube_relation.py", "test_certificates_are_checked.py",
    "test_ellipsoid_certificates.py", "test_paper_relation.py", "test_ellipsoid_relation.py",
    "test_translation_is_correct.py", "test_tree_equals_dense_programming.py",
    "test_claims_hold_in_ball_arithmetic.py", "test_guarantees_rest_on_checked_certificates.py",
    "test_networks_move_bent_agents.py", "test_certificates_have_another_end.py",
    "test_nonlinear_paths_are_certified.py", "test_fleets_are_certified_along_paths.py",
)  # fmt: skip
"""From the quickest to the slowest; the first failure ends the run."""

TEST_SECONDS, JUDGE_SECONDS = 300, 300

MOST_TESTS = 150
"""Tests that are asked, of those that run a line."""

FOUND = ROOT / "docs" / "mutations.json"
"""What came out last time, from which the page is written."""

TRIALS = (
    ("paths", 3), ("paths", 5), ("nonlinear", 5), ("nonlinear", 8), ("fleets", 4), ("states", 1),
    ("laws", 1), ("neighbours", 1), ("common", 1), ("networks", 1), ("upper", 1),
)  # fmt: skip
"""Random problems of other kinds (``small_problems``) that are certified, checked and simulated, too."""

OF_PATHS = ("paths", "nonlinear", "fleets")
"""Kinds of which alone something is claimed through the room ``path_checking``."""


# --- what a mutant certifies -----------------------------------------------------------------------------------
def _agent(name: str, **changes: Any) -> dict[str, Any]:
    agent: dict[str, Any] = {
        "name": name, "A": [[0.9]], "B": [[1.0]], "noise_covariance": [[0.03]], "state_low": [-1.0],
        "state_high": [1.0], "input_low": [-0.6], "input_high": [0.4], "initial_state": [-0.3],
    }  # fmt: skip
    return agent | changes


def _pair() -> dict[str, Any]:
    """Two scalar agents, a wall, and an order of goals."""
    regions = {
        "goal": {"agent": "one", "low": [0.5], "high": [1.0]},
        "wall": {"agent": "one", "low": [-1.0], "high": [-0.75]},
        "door": {"agent": "two", "low": [-0.75], "high": [-0.25]},
    }
    two = _agent("two", A=[[1.0]], noise_covariance=[[0.05]], initial_state=[0.1])
    formula = ("and", ("U", ("not", "wall"), ("is", "goal")), ("F", 0, None, ("is", "door")))
    return {
        "agents": [_agent("one"), two], "propositions": regions, "formula": formula,
        "text": "(!wall U goal) & F door", "semantics": "co-safe", "horizon": 4,
    }  # fmt: skip


def _plane(correlated: bool = False, weak: bool = False) -> dict[str, Any]:
    """A robot in the plane that must stay in a region; with one input for two states if ``weak``."""
    low, high = [-2.0, -2.0], [2.0, 2.0]
    covariance = [[0.04, 0.03], [0.03, 0.05]] if correlated else [[0.04, 0.0], [0.0, 0.05]]
    agent = _agent(
        "robot", A=[[0.9, 0.1], [0.3, 0.9]], B=[[1.0, 0.0], [0.2, 1.0]], noise_covariance=covariance, state_low=low,
        state_high=high, input_low=[-1.5, -1.5], input_high=[1.0, 1.5], initial_state=[0.5, 0.5],
    )  # fmt: skip
    if weak:
        agent |= {"A": [[0.5, 0.4], [0.0, 0.5]], "B": [[0.0], [1.0]], "input_low": [-1.0], "input_high": [1.0]}
        agent["noise_covariance"] = [[0.02, 0.0], [0.0, 0.02]]
    side = 1.2 if weak else 1.0
    return {
        "agents": [agent], "propositions": {"safe": {"agent": "robot", "low": [-side, -side], "high": [side, side]}},
        "formula": ("G", 0, None, ("is", "safe")), "text": "G safe", "semantics": "finite-trace", "horizon": 4,
    }  # fmt: skip


def _windows() -> dict[str, Any]:
    """A start box, a window, and a region that must be left again."""
    agent = _agent(
        "one", input_low=[-0.3], input_high=[0.3], noise_covariance=[[0.02]], initial_low=[-0.4], initial_high=[0.3]
    )
    agent.pop("initial_state")
    formula = ("and", ("F", 1, 3, ("is", "goal")), ("G", 0, 2, ("not", "wall")))
    regions = {
        "goal": {"agent": "one", "low": [0.1], "high": [0.7]},
        "wall": {"agent": "one", "low": [-1.0], "high": [-0.7]},
    }
    return {
        "agents": [agent], "propositions": regions, "formula": formula, "text": "F[1,3] goal & G[0,2] !wall",
        "semantics": "finite-trace", "horizon": 5,
    }  # fmt: skip


PROBLEMS: dict[str, tuple[Any, dict[str, Any]]] = {
    "exact": (_pair, {"cells": 16, "relation": "exact"}),
    "tube": (_pair, {"cells": 24, "relation": "tube"}),
    "paper": (_pair, {"cells": 8, "relation": "paper", "epsilon": 0.125, "feedback": -0.85}),
    "trains": (_pair, {"cells": 16, "relation": "exact", "value": "train"}),
    "plane": (_plane, {"cells": 16, "relation": "exact"}),
    "correlated": (lambda: _plane(correlated=True), {"cells": 16, "relation": "exact"}),
    "weak": (lambda: _plane(weak=True), {"cells": 24, "relation": "tube"}),
    "ellipsoid": (lambda: _plane(weak=True), {"cells": 24, "relation": "ellipsoid", "delta": 0.02}),
    "windows": (_windows, {"cells": 30, "relation": "exact"}),
}


def judge(of_paths: bool) -> Row:
    """What the package on the path certifies, checks and refutes, of paths alone or of everything.

    It is run in the mutant's tree.
    """
    import certigym as cg
    from adversary import Deployed, problem_of
    from independent import successes

    outcome: Row = {"false": [], "refused": [], "refuted": [], "errors": [], "forged": []}
    for name, (make, options) in PROBLEMS.items() if not of_paths else ():
        spec = make()
        try:
            certificate = cg.synthesize(problem_of(spec), **options).certificate
            number, beyond = successes(spec, Deployed(certificate, EPISODES, 1), EPISODES, 1)
            false = bool(binom.cdf(number, EPISODES, certificate.lower_bound) < LEVEL)
            above = certificate.lower_bound + (certificate.gap if certificate.gap is not None else 1.0)
            false |= bool(binom.sf(number - 1, EPISODES, min(1.0, above)) < LEVEL)
            false |= (
                beyond > 1e-9
                and all(agent.relation.delta == 0.0 for agent in certificate.controller.agents)
                and certificate.lower_bound > 0
            )
            report = cg.check(certificate)
            outcome["refused"] += [] if report else [name]
            if false:
                outcome["false"].append(name)
                verdict = cg.validate(certificate, EPISODES, confidence=1 - 1e-6).verdict
                outcome["refuted"] += [name] if verdict == "refuted" else []
            outcome["forged"] += [f"{name}: {title}" for title in _accepted(cg, certificate)]
        except Exception as error:  # noqa: BLE001 a crash is an answer, too
            outcome["errors"].append(f"{name}: {type(error).__name__}")
    for kind, seed in TRIALS:
        if kind in OF_PATHS or not of_paths:
            _try(kind, seed, outcome)
    return outcome


def _try(kind: str, seed: int, outcome: Row) -> None:
    """Judge what is claimed of a random problem of a kind."""
    from kind_trials import trial

    name = f"{kind} {seed}"
    try:
        finding = trial(kind, seed, LEVEL, more=1)["finding"]
    except Exception as error:  # noqa: BLE001 a crash is an answer, too
        outcome["errors"].append(f"{name}: {type(error).__name__}")
        return
    outcome["false"] += [name] if finding.startswith("refuted") else []
    outcome["refused"] += [name] if finding and not finding.endswith("check: valid") else []


def guards_twice(certificate: Any) -> Any:
    """Every guard listed twice, and the last step back taken through both: the value at time 0 is doubled."""
    step, count = certificate.proof.skeleton[0], len(certificate.proof.guard_source)
    again = np.array([count, 0])
    origin = tuple(np.concatenate([rows, rows + again]) for rows in step.origin)
    kept = tuple(np.concatenate([rows, rows + len(o)]) for rows, o in zip(step.kept, step.origin, strict=True))
    pairs = zip(certificate.proof.terms.index, step.origin, strict=True)
    index = tuple(np.concatenate([rows, rows]) if len(o) else rows for rows, o in pairs)
    return changed(
        certificate,
        skeleton=(replace(step, origin=origin, kept=kept), *certificate.proof.skeleton[1:]),
        terms=replace(certificate.proof.terms, index=index),
        **{
            name: np.concatenate([getattr(certificate.proof, name)] * 2)
            for name in ("guard_source", "guard_target", "guard_mask")
        },
    )


def changed(certificate: Any, **entries: Any) -> Any:
    """Return a certificate with other entries of its proof; it may be that of another copy of the package."""
    return replace(certificate, proof=replace(certificate.proof, **entries))


def _accepted(cg: Any, certificate: Any) -> list[str]:
    """Forgeries that the check accepts."""
    certificate = changed(certificate, gap=None)
    part = certificate.proof.agents[0]
    lower = min(1.0, certificate.lower_bound + 0.01)
    forged = {"bound": changed(certificate, lower_bound=lower, bounds={certificate.proof.bound: lower}, gap=None)}
    everywhere = replace(part, masks=np.ones_like(part.masks))
    forged["guards"] = changed(certificate, agents=(everywhere, *certificate.proof.agents[1:]))
    if len({*certificate.proof.guard_target.tolist()}) > 1:
        forged["targets"] = changed(certificate, guard_target=certificate.proof.guard_target[::-1].copy())
    if part.menu is None:
        rolled = replace(part, policy=np.roll(part.policy, len(part.policy[0, 0]) // 2, axis=2))
        forged["policy"] = changed(certificate, agents=(rolled, *certificate.proof.agents[1:]))
    else:
        feedback = part.relation["feedback"]
        wilder = [[5.0 * entry for entry in row] for row in feedback] if isinstance(feedback, list) else -feedback
        wild = replace(part, relation={**part.relation, "feedback": wilder})
        forged["feedback"] = changed(certificate, agents=(wild, *certificate.proof.agents[1:]))
    if certificate.proof.skeleton:
        step = certificate.proof.skeleton[0]
        origin = tuple(np.concatenate([rows, rows]) for rows in step.origin)
        kept = tuple(np.concatenate([rows, rows + len(o)]) for rows, o in zip(step.kept, step.origin, strict=True))
        index = tuple(np.concatenate([rows, rows]) if len(o) else rows
                      for rows, o in zip(certificate.proof.terms.index, step.origin, strict=True))  # fmt: skip
        twice = (replace(step, origin=origin, kept=kept), *certificate.proof.skeleton[1:])
        forged["twice"] = changed(certificate, skeleton=twice, terms=replace(certificate.proof.terms, index=index))
        forged["guards twice"] = guards_twice(certificate)
    return [title for title, one in forged.items() if one.lower_bound > 0 and cg.check(one)]


# --- running mutants -------------------------------------------------------------------------------------------
def _tree(folder: Path, mutant: Mutant | None) -> None:
    """A copy of the tree with one wrong line."""
    for name in TREES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder / name)
    if mutant is not None:
        path = folder / mutant.path
        text = path.read_text(encoding="utf-8")
        if mutant.old not in text:
            raise ValueError(f"{mutant.path}: no longer has {mutant.old!r}")
        path.write_text(text.replace(mutant.old, mutant.new, 1), encoding="utf-8")


def _run(folder: Path, words: list[str], seconds: float) -> subprocess.CompletedProcess[str] | None:
    """Run Python in the copy of the tree; None if it takes too long."""
    path = os.pathsep.join(str(folder / name) for name in ("src", "tests", "docs", "benchmarks"))
    environment = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, *words]
    try:
        return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        return None


def row_of(mutant: Mutant | None, tests: list[str] | None) -> Row:
    """What becomes of one mutant (None: of the tree as it is), and of these tests, in their order."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        _tree(folder, mutant)
        which = "paths" if mutant is not None and "path_checking" in mutant.path else "all"
        done = _run(folder, [str(folder / "benchmarks" / "mutations.py"), "--judge", which], JUDGE_SECONDS)
        found = json.loads(done.stdout.splitlines()[-1]) if done is not None and done.returncode == 0 else None
        noticed = None if tests is None else _first_failure(folder, tests)
    row: Row = {
        "module": "-" if mutant is None else mutant.path,
        "line": "the tree as it is" if mutant is None else mutant.new,
        "was": "" if mutant is None else mutant.old,
        "false claims": None, "check": None, "rollouts": None, "forgeries": None, "tests": noticed,
    }  # fmt: skip
    if found is None:
        return row | {"false claims": "crash"}
    false, refused = found["false"], found["refused"]
    missed = [name for name in false if name not in refused]
    row["false claims"] = ", ".join(false) + (" crash" if found["errors"] and not false else "")
    row["check"] = "MISSES " + ", ".join(missed) if missed else "refuses" if refused else ""
    row["rollouts"] = "" if not {*false} & PROBLEMS.keys() else "refute" if found["refuted"] else "pass"
    row["forgeries"] = ", ".join(found["forged"])
    return row


def _first_failure(folder: Path, tests: list[str]) -> str:
    """The first test that fails in a copy of the tree, with its file; empty if none does."""
    done = _run(folder, ["-m", "pytest", "-x", "-q", "-rfE", "-p", "no:cacheprovider", *tests], TEST_SECONDS)
    if done is None:
        return "no end"
    failed = [line.split(" - ")[0] for line in done.stdout.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    if not failed:
        return "" if done.returncode == 0 else "crash"
    file, *name = failed[0].split(" ", 1)[1].split("::")
    return "::".join([Path(file).name, *name])


def _line_of(mutant: Mutant) -> tuple[int, int]:
    """The first and the last line that a mutant changes."""
    text = (ROOT / mutant.path).read_text(encoding="utf-8")
    first = text[: text.index(mutant.old)].count("\n") + 1
    return first, first + mutant.old.count("\n")


def _placed(test: str) -> str:
    """A test with the folder that it is in now."""
    file, *name = test.split("::")
    place = next((ROOT / "tests").rglob(file)).relative_to(ROOT)
    return "::".join([place.as_posix(), *name])


def tests_of(mutant: Mutant, before: dict[tuple[str, str, str], str], covered: Any) -> list[str]:
    """The tests that a mutant is shown to: who noticed last time, and who runs its line or a fixed selection."""
    last = before.get((mutant.path, mutant.new, mutant.old), "")
    first = [_placed(last)] if ".py" in last else []
    if covered is None:
        return [*first, *map(_placed, TESTS)]
    lines, (start, end) = covered.contexts_of(mutant.path), _line_of(mutant)
    running = {test for line in range(start, end + 1) for test in lines.get(line, ())}
    # Files that are about what is trusted come first: others run the line without looking at what it is for.
    order = sorted(
        running, key=lambda test: (Path(test.split("::")[0]).name not in TESTS, covered.seconds.get(test, 1.0))
    )
    return [*first, *order[:MOST_TESTS]] or [_placed(test) for test in TESTS]


class Covered:
    """Which test functions run which lines, as ``coverage`` saw it, and how long they take."""

    def __init__(self, path: str, durations: str | None) -> None:
        import re

        from coverage import CoverageData  # of `pip install coverage`, which nothing else needs

        self.data: Any = CoverageData(path)
        self.data.read()
        self.seconds: dict[str, float] = {}
        for line in Path(durations).read_text(encoding="utf-8").splitlines() if durations else ():
            if match := re.match(r"\s*([\d.]+)s call +(tests/\S+?\.py::\w+)", line):
                name = _placed(match[2].rsplit("/", 1)[-1])
                self.seconds[name] = self.seconds.get(name, 0.0) + float(match[1])

    def contexts_of(self, path: str) -> dict[int, set[str]]:
        """The tests that run each line of a file."""
        found = [file for file in self.data.measured_files() if file.endswith(f"/{path}")]
        result: dict[int, set[str]] = {}
        for file in found:
            for line, contexts in self.data.contexts_by_lineno(file).items():
                for context in contexts:
                    *_, module, test = ["", "", *str(context).split(".")]
                    if module.startswith("test_") and test.startswith("test_"):
                        result.setdefault(line, set()).add(_placed(f"{module}.py::{test}"))
        return result


def page_of(rows: Rows) -> str:
    """The table as a part of a page of the documentation."""
    heads = ["module", "line", "false claims", "check", "rollouts", "forgeries", "tests"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for row in rows:
        shown = row if row["line"] else row | {"line": f"(left out) {row['was']}"}
        cells = [str(shown[head] or "").replace("|", "&#124;") for head in heads]
        cells[1] = f"`{' '.join(cells[1].split())[:70]}`"
        cells[6] = f"`{cells[6].split('[')[0].removeprefix('test_').replace('.py::test_', ': ')}`" if cells[6] else ""
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def summary_of(rows: Rows) -> str:
    """What came out, in a sentence or two."""
    mutants = [row for row in rows if row["module"] != "-"]
    false = [row for row in mutants if row["false claims"] and row["false claims"].strip() != "crash"]
    missed = [row for row in false if str(row["check"]).startswith("MISSES")]
    refused = [row for row in mutants if row["check"] == "refuses"]
    judged = [row for row in mutants if row["check"] is not None]
    noticed = [row for row in mutants if row["tests"]]
    return (
        f"{len(mutants)} mutants, of which tests notice {len(noticed)}. The claims of {len(judged)} were judged: "
        f"{len(false)} claim something visibly false, of which the check refuses {len(false) - len(missed)}; in "
        f"{len(refused)} copies the check refuses claims."
    )


def merged(path: Path, rows: Rows) -> Rows:
    """Rows in the order of the mutants, with those that a file has of mutants that are not among them."""
    known = json.loads(path.read_text(encoding="utf-8"))["rows"] if path.exists() else []
    found = {(row["module"], row["line"], row["was"]): row for row in [*known, *rows]}
    order = [("-", "the tree as it is", ""), *((mutant.path, mutant.new, mutant.old) for mutant in MUTANTS)]
    return [found[key] for key in order if key in found]


def write_page(rows: Rows) -> None:
    """Write summary and table into the page, after its marks."""
    page = ROOT / "docs" / "mutations.md"
    head = page.read_text(encoding="utf-8").split("<!-- what came out -->")[0]
    page.write_text(f"{head}<!-- what came out -->\n\n{summary_of(rows)}\n\n{page_of(rows)}", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--judge", choices=("all", "paths"), help=argparse.SUPPRESS)
    parser.add_argument("--only", nargs=2, type=int, metavar=("FROM", "TO"), default=(0, len(MUTANTS)))
    parser.add_argument("--again", action="store_true", help="only those of which the file says too little")
    parser.add_argument("--no-tests", action="store_true")
    parser.add_argument("--covered", metavar="DATA", help="what coverage wrote, with one context per test")
    parser.add_argument("--durations", metavar="FILE", help="what pytest printed with --durations=0 -vv")
    parser.add_argument("--json", metavar="PATH")
    parser.add_argument("--page", action="store_true", help="write docs/mutations.md from docs/mutations.json and stop")
    given = parser.parse_args()
    if given.judge:
        print(json.dumps(judge(given.judge == "paths")))
        return
    if given.page:
        write_page(merged(FOUND, []))
        return
    before = {(row["module"], row["line"], row["was"]): str(row["tests"] or "") for row in merged(FOUND, [])}
    covered = Covered(given.covered, given.durations) if given.covered else None
    rows: Rows = []
    known = {
        (row["module"], row["line"], row["was"]): row for row in (merged(Path(given.json), []) if given.json else [])
    }
    for mutant in MUTANTS[slice(*given.only)]:
        row = known.get((mutant.path, mutant.new, mutant.old), {})
        if given.again and row.get("check") is not None and "::" in (row["tests"] or ""):
            continue
        rows.append(row_of(mutant, None if given.no_tests else tests_of(mutant, before, covered)))
        print(rows[-1], flush=True)
        if given.json:
            save({"rows": merged(Path(given.json), rows)}, given.json)
    if not given.no_tests:
        # Who noticed something has to notice nothing in the tree as it is.
        noticed = sorted({_placed(str(row["tests"])) for row in rows if ".py" in str(row["tests"])})
        rows.insert(0, row_of(None, noticed))
        print(rows[0], flush=True)
        if given.json:
            save({"rows": merged(Path(given.json), rows)}, given.json)
    show("Mutants", rows)


if __name__ == "__main__":
    main()
