"""The commands about policies: ``train``, ``probe``, ``leaderboard``, ``record``, ``compare``, ``certify``,
``save-policy``."""

from __future__ import annotations

from argparse import Namespace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from ..envs.suite import as_problem
from ..envs.systems.arguments import counted, write_json, write_text
from ..envs.tasks.problem import policy_in_file
from ..synthesis.certificates.proofs import save_certificate, shown_bound
from ..synthesis.extended_check.claims import standing
from ..synthesis.extended_check.shields import shield_of
from ..synthesis.interop import as_policy, is_model
from ..synthesis.interop import save_policy as save_for_others
from ..synthesis.verbs.certify import certify as certify_policy
from ..synthesis.verbs.certify import improve as improve_policy
from ..synthesis.verbs.certify import is_certified_as_given
from ..validation.policies import (
    ALGORITHMS,
    Leaderboard,
    Recording,
    Sources,
    Standing,
    certificate_of,
    given,
    judged,
    judging_plan,
    label_of,
    page_of,
    record_tiers,
    replayed,
    save_actor,
    smoothed,
)
from ..validation.policies import compare as compare_policies
from ..validation.policies import leaderboard as fill_leaderboard
from ..validation.policies import probe as probe_certificate
from ..validation.policies import record as record_episodes
from ..validation.presentation.figures import draw_comparison, draw_curves
from ..validation.statistical_tests import planned
from .given import cells_of, problem_of, relation_of, say, show
from .network_commands import UNCERTIFIED, certify_raw, is_actor, is_wrapping, problem_of_actor
from .policy_words import policy_of_file, policy_of_word
from .work import trained, trials


def train(options: Namespace) -> int:
    """Train a baseline with one seed or several, save it, and print how it went."""
    if options.steps is not None and options.steps < 1:
        raise ValueError(f"`--steps`: expected a positive whole number, got {options.steps}")
    problem, seeds = problem_of(options), options.seeds or [options.seed]
    chosen = {name: getattr(options, name) for name in ("worlds", "reward", "warm_start", "resume")}
    if options.warm_start is not None:  # one certificate for all seeds
        chosen["warm_start"] = certificate_of(problem, options.warm_start)
    if (options.shield is None) != (options.probability is None):
        raise ValueError("`--shield`, `--probability`: expected both or neither")
    if options.shield is not None:  # one shield for all seeds
        chosen["shield"] = shield_of(certificate_of(problem, options.shield), options.probability)
    drawn = chosen["warm_start"] or options.bound
    bound = standing(certificate_of(problem, drawn)).lower_bound if drawn and options.plot else None
    trainings, texts = [], []
    for seed in seeds:
        training = trained(problem, options.algo, options.steps, seed, **chosen)
        folder = Path(options.out) if len(seeds) == 1 else Path(options.out) / f"seed-{seed}"
        training.save(folder)
        trainings.append(training)
        last = training.curve[-1]["success"] if training.curve else float("nan")
        texts.append(
            f"{problem.name}: {options.algo}, seed {seed}, {training.steps} world steps in {training.seconds:.1f} s; "
            f"success while exploring {last:.3f}; saved to {folder}"
        )
        texts += _smoothed(training, folder) if options.certify else []
    if options.plot:
        draw_curves(trainings, options.plot, bound)
    texts += [f"agents see: {trainings[0].information}", f"settings: {trainings[0].settings}"]
    data: Any = trainings[0].to_dict()
    if len(seeds) > 1:
        result = compare_policies(problem, {options.algo: trainings})
        texts.append(str(result))
        data = {"trainings": [training.to_dict() for training in trainings], "comparison": result.to_dict()}
    show(options, "\n".join(texts), data)
    return 0


def _smoothed(training: Any, folder: Path) -> list[str]:
    """Certify an actor as it is, or a smoother one, which is saved with its certificate, and say what is certified."""
    found = smoothed(training.actor, seed=training.seed)
    if found.certified is None:
        return [f"certified as it is: nothing; {text}" for text in found.tried.values()]
    name = "actor.npz" if found.actor is training.actor else "smooth_actor.npz"
    save_actor(found.actor, folder / name, algorithm=training.algorithm, seed=training.seed)
    save_certificate(found.certified.certificate, folder / "certificate.npz")
    return [f"certified as it is: {shown_bound(found.certified.certificate.lower_bound, None)} for {folder / name}"]


def probe(options: Namespace) -> int:
    """Let a learner try to beat the certified controllers, and print by how much it did."""
    with tqdm(desc="probe", unit=" steps", disable=None, leave=False) as bar:

        def learned(count: int, success: float) -> None:
            bar.set_postfix_str(f"success {success:.3f}")
            bar.update(count)

        with trials(options, 2 * options.episodes) as plan:
            found = probe_certificate(
                problem_of(options),
                options.certificate,
                plan,
                seconds=options.seconds,
                steps=options.steps,
                learned=learned,
            )
    if options.out:
        found.save_actor(options.out)
    show(options, found, found.to_dict())
    return 0


def leaderboard(options: Namespace) -> int:
    """Fill what the leaderboard does not hold yet; page and JSON are written after each row.

    The status is 1 if it shows a certificate that the check refuses.
    """
    if options.replay:
        return _replay(options)
    page = Path(options.out)
    table = page.with_suffix(".json")
    board = Leaderboard.load(table) if table.is_file() else Leaderboard()

    def finished(filled: Leaderboard, row: Standing) -> None:
        write_json(table, filled.to_dict())
        write_text(page, page_of(filled))
        seconds = "" if row.seconds is None else f", {row.seconds:.0f} s"
        refused = "" if row.refused is None else f", {row.refused}"
        say(options, f"{row.problem}: {row.policy} {row.rate:.4f} [{row.low:.4f}, {row.high:.4f}]{seconds}{refused}")

    with trials(options) as plan:
        if options.add:
            board = _with_own_row(board, options, plan, finished)
        else:
            sources = Sources(
                _made(options.certificates), _made(options.learners), options.steps, tuple(options.train_seeds)
            )
            policies = options.policies.split(",")
            board = fill_leaderboard(
                options.ids or None, policies, plan, sources=sources, board=board, finished=finished
            )
    show(options, f"{counted(len(board.rows), 'row')} in {page} and {table}", board.to_dict())
    return int(any(row.refused is not None for row in board.rows))


PUBLISHED = "docs/actors"
"""Where the repository keeps the actors of its leaderboard."""


def _replay(options: Namespace) -> int:
    """Judge published actors again and compare with the record; the status is 1 if a row is outside its limits."""
    learners = Path(options.learners or PUBLISHED)
    if options.add or not learners.is_dir():
        raise ValueError(f"`--replay`: expected no `--add`, and `--learners DIR` with actors; there is no {learners}")
    # The record is the page that is named, or the one beside the folder.
    tables = (Path(options.out).with_suffix(".json"), learners.parent / "leaderboard.json")
    recorded = next((Leaderboard.load(table) for table in tables if table.is_file()), Leaderboard())
    outside: list[str] = []

    def finished(_: Leaderboard, row: Standing) -> None:
        known = recorded.row(row.problem, row.policy)
        if known is None:
            verdict = "not recorded"
        elif known.successes == row.successes and known.episodes == row.episodes:
            verdict = "the same episodes succeed as recorded"
        elif known.low <= row.rate <= known.high:
            verdict = f"recorded {known.rate:.4f}, within its limits"
        else:
            verdict = f"recorded {known.rate:.4f}: OUTSIDE [{known.low:.4f}, {known.high:.4f}]"
            outside.append(f"{row.problem}: {row.policy}")
        say(options, f"{row.problem}: {row.policy} {row.rate:.4f} [{row.low:.4f}, {row.high:.4f}], {verdict}")

    with trials(options) as plan:
        board = replayed(learners, options.ids or None, plan, finished=finished)
    summary = f"{counted(len(board.rows), 'row')} judged again, {len(outside)} outside the recorded limits"
    show(options, summary, {**board.to_dict(), "outside": outside})
    return int(bool(outside))


def _with_own_row(board: Leaderboard, options: Namespace, plan: Any, finished: Any) -> Leaderboard:
    """Return the leaderboard with the row of a policy that somebody gives."""
    name, _, file = options.add.partition("=")
    if not name or not file or len(options.ids) != 1:
        raise ValueError(f"`--add`: expected one ID and NAME=POLICY, got {options.ids} and {options.add!r}")
    if name in ("certified", "random", *ALGORITHMS):
        raise ValueError(f"`--add`: expected a name that is not a column of its own, got {name!r}")
    problem, settled = as_problem(options.ids[0]), judging_plan(planned(plan, {}, options.episodes))
    row = judged(
        label_of(options.ids[0]), name, given(problem, name, policy_of_file(problem, file, options.trust)), settled
    )
    board = board.with_row(row)
    finished(board, row)
    return board


def _made(folder: str | None) -> Path | None:
    """Return a folder, which is made if there is none."""
    if folder is None:
        return None
    Path(folder).mkdir(parents=True, exist_ok=True)
    return Path(folder)


def record(options: Namespace) -> int:
    """Write episodes of a policy, or of three tiers, and say how many of them satisfied the task."""
    problem = problem_of(options)
    policy = policy_of_word(problem, options.policy, options)
    if not options.tiers:
        found = record_episodes(problem, policy, options.episodes, options.seed)
        show(options, found, _written(found, options.out, options.minari))
        return 0
    folder, data, told = Path(options.out), {}, []
    folder.mkdir(parents=True, exist_ok=True)
    for tier, found in record_tiers(problem, policy, options.episodes, options.seed).items():
        name = f"{options.minari}/{tier}-v0" if options.minari else None
        data[tier] = _written(found, str(folder / f"{tier}.npz"), name)
        told.append(f"{tier}: {found}")
    show(options, "\n".join(told), data)
    return 0


def _written(found: Recording, file: str, minari: str | None) -> dict[str, Any]:
    """Write episodes as arrays, and as a Minari dataset if it has a name; return what is known of them."""
    found.save(file)
    if minari:
        found.to_minari(minari)
    facts = {"problem": found.problem.name, "fingerprint": found.problem.fingerprint, "seed": found.seed}
    counts = {
        "episodes": len(found.lengths),
        "satisfied": int(found.satisfied.sum()),
        "steps": int(found.lengths.sum()),
    }
    return {**facts, **counts, "information": found.information, "file": file}


def save_policy(options: Namespace) -> int:
    """Write a policy as a file that other programs run."""
    problem = problem_of(options)
    policy = policy_of_word(problem, options.policy, options)
    path = save_for_others(policy[0] if isinstance(policy, list) else policy, options.out, options.agent)
    size = path.stat().st_size
    show(options, f"{path}: {size:,} bytes", {"path": str(path), "bytes": size, "agent": options.agent})
    return 0


def compare(options: Namespace) -> int:
    """Make or load the policies, simulate them, and print the table and the tests."""
    problem = problem_of(options)
    policies = {name: policy_of_word(problem, name, options) for name in options.policies.split(",")}
    with trials(options, options.episodes * len(policies)) as plan:
        result = compare_policies(problem, policies, plan)
    if options.plot:
        draw_comparison(result, options.plot)
    show(options, result, result.to_dict())
    return int(result.is_invalid)


def certify(options: Namespace) -> int:
    """Certify a network as it is, or a policy wrapped on cells; the status is 1 if check or rollouts refute it."""
    if is_actor(options):
        problem, file = problem_of_actor(options.problem, options.horizon), options.problem
    elif options.policy is None:
        written = policy_in_file(options.problem)
        if written is None:
            raise ValueError(
                "`--policy`: expected an actor (.npz) or FILE.py:NAME, an actor in place of the problem, or a problem "
                "file with a table [policy]"
            )
        problem, file = problem_of(options), ""
    else:
        problem, file = problem_of(options), options.policy
    policy = policy_of_file(problem, file, options.trust) if file else as_policy(written, problem)
    policy = as_policy(policy, problem) if is_model(policy) else policy
    wraps = options.wrap or options.improve or is_wrapping(options)
    if is_certified_as_given(policy, cells_of(options)) and not wraps:
        return certify_raw(options, problem, policy)
    cells = cells_of(options)
    # All forms of the policy are simulated beside each other; the last one is saved.
    policies: dict[str, Any] = {"raw": policy}
    last = policies["certified"] = certify_policy(
        problem, policy, cells, wrap=wraps, above=options.above, **relation_of(options)
    )
    if options.improve:
        last = policies["improved"] = improve_policy(problem, policy, cells, **relation_of(options))
    if options.out:
        save_certificate(last.certificate, options.out)
    with trials(options, options.episodes * len(policies)) as plan:
        result = compare_policies(problem, policies, plan)
    note = "The bounds hold for the policies wrapped on the cells (certified, improved), not for the raw one."
    show(options, f"{result}\n{UNCERTIFIED if result.is_invalid else note}", result.to_dict())
    return int(result.is_invalid or result.is_refuted)
