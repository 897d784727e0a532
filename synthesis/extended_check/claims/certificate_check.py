"""Independent verification of a certificate, from its policies and its tree alone.

The check uses no code of the search: it verifies guards against the automaton instead of compiling them, it compares
inputs with the input box, and it grows the value tree again, vertex by vertex, with a kernel of its own. The sum over
any set of vertices of a tree is a lower bound. So a certificate is right if

1. its grids tile the workspaces, and the noise is independent along their axes;
2. every relation holds (``verify_relation``), and every choice can be commanded from every related state;
3. guards out of one state are disjoint, and every letter of the states related to a guard's cells leads to its target
   (or, for co-safe tasks, to acceptance);
4. the regrown value at the start, less what lost relations can cost, is at least ``lower_bound``, and no stored factor
   exceeds its regrown one;
5. where it says how far above its bound the probability can be (``gap``), either nothing is lost anywhere, and its
   policies, evaluated forward in time, attain no more than that (``upper_end``); or the same policies have a
   certificate of the opposite task, which holds (``complement_task``).

United terms are regrown by a rule that is sound for any choice: ``a x b + a' x b' >= min(a, a') x (b + b')``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ....envs.suite import as_problem
from ....envs.systems.backends import on_one_thread
from ....envs.systems.distributions import laws_by_author
from ....envs.tasks.problem import Problem, complement_inside, complement_of
from ...certificates.cell_probabilities import BrokenTrainError, noted, state
from ...certificates.proofs import (
    AlongPath,
    Certificate,
    CheckReport,
    GridProof,
    NotCanonicalError,
    OfStarts,
    OnGrid,
    PathProof,
    ProductProof,
    StartsProof,
    TimedProof,
    UnionBoundProof,
    VertexProof,
    VertexTeamProof,
    alarm_of,
    alike_members,
    certificate_from,
    delta_of,
    verdict_of,
    wrong_angles,
)
from ...certificates.value_functions import UNIT, Terms
from ...checker import Verdict, bound_of
from ...relations.grids import FloatArray, lattice_axes
from ..steps import execution_of, label_margin, places_of, verify_relation, wrong_actions
from .complement_task import other_controllers, wrong_complement
from .forward_occupancy import TooManyProducts, masses
from .grid_check import uneven_lattices, wrong_grids
from .guard_check import wrong_guards
from .network_check import wrong_networks
from .pairs_check import wrong_pairs
from .regrown_tree import BrokenTreeError, regrow, tree_start_value
from .timed_check import wrong_in_time
from .train_check import Value, regrown_trains, train_start_value
from .upper_bound import MOST, attained, inexact
from .vertex_check import check_vertex_team, check_vertices

DROPPED, SPARE = 1e-12, 1e-9
"""Undecided mass that may be dropped per step, and what is added to it for rounding."""


@on_one_thread
def check(certificate: Any, problem: Any = None) -> CheckReport:
    """Verify a certificate against a problem (by default the one inside it).

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
    problem : Problem, id or path, optional
        The certificate must have been made for exactly this problem (fingerprint).

    Returns
    -------
    CheckReport
        Truthy if the lower bounds of the certificate were verified: at its start and, factor by factor, elsewhere; and
        the upper end of its claim (``gap``) where it has one, unless ``above`` is None.
    """
    certificate = certificate_from(certificate)
    problem = certificate.problem if problem is None else as_problem(problem)
    laws = (law for agent in problem.agents for law in laws_by_author(agent.laws or ()))
    return replace(_checked(certificate, problem), assumed=tuple(dict.fromkeys(map(repr, laws))))


def _checked(certificate: Any, problem: Problem) -> CheckReport:
    """Verify a certificate by its kind."""
    proof = type(certificate.proof)
    if any(part.proof.kind not in proof.inside for part in certificate.proof.parts):
        failures = ("its parts are proved in other ways than parts of it can be",)
        return CheckReport(False, certificate.lower_bound, float("nan"), failures)
    if proof is ProductProof and not problem.joint_noise:
        return _check_product(certificate, problem)
    if problem.joint_noise and proof not in (PathProof, StartsProof):
        failures = ("its problem has agents that share noise, which it takes for independent",)
        return CheckReport(False, certificate.lower_bound, float("nan"), failures)
    if problem.names_time and proof in (GridProof, UnionBoundProof):
        failures = ("its problem names the time, of which it knows nothing",)
        return CheckReport(False, certificate.lower_bound, float("nan"), failures)
    if problem.labeling.pairs and proof is GridProof:
        failures = ("its problem has propositions about pairs of agents, of which it knows nothing",)
        return CheckReport(False, certificate.lower_bound, float("nan"), failures)
    if proof not in (PathProof, StartsProof) and (wrong := wrong_angles(problem)):
        return CheckReport(False, certificate.lower_bound, float("nan"), (wrong,))
    try:
        # What overflows decides nothing: neither infinities nor numbers that are none are compared with anything.
        with np.errstate(over="raise", invalid="raise", divide="raise"):
            return CHECKS[proof](certificate, problem)
    except FloatingPointError as error:
        failures = (f"its numbers are too large or too small to be computed with ({error})",)
        return CheckReport(False, certificate.lower_bound, float("nan"), failures)
    except (IndexError, ValueError) as error:
        # The reader of files refuses arrays that do not fit together; in memory nobody has looked at them.
        failures = (f"its arrays do not fit together ({error})",)
        return CheckReport(False, certificate.lower_bound, float("nan"), failures)


def _check_pairs(certificate: Certificate[UnionBoundProof], problem: Problem) -> CheckReport:
    """Verify a certificate by subtraction: its base like any other, and then what pairs may spoil."""
    failures: list[str] = []
    if certificate.fingerprint != problem.fingerprint:
        failures.append("it was made for another problem (the fingerprints differ)")
    near, base = 1.0, CheckReport(False, 0.0, float("nan"), ())
    if not failures:
        base = check(certificate.proof.base)
        failures += [f"without pairs: {failure}" for failure in base.failures]
    if not failures:
        failures, near = wrong_pairs(certificate, problem)
    if not failures and not near <= certificate.proof.near:
        failures.append(
            f"it says that pairs spoil {certificate.proof.near:.6g} at most, but what was recomputed is {near:.6g}"
        )
    recomputed = float("nan") if failures else max(0.0, base.recomputed - near)
    # Runs in which a pair was not as usual may be satisfied, too.
    known = not failures and certificate.gap is not None and base.above is not None
    above = min(1.0, (base.above + near) * (1.0 + 8.0 * UNIT)) if known and base.above is not None else None
    return CheckReport(not failures, certificate.lower_bound, recomputed, tuple(failures), above)


def _check_timed(certificate: Certificate, problem: Problem) -> CheckReport:
    """Verify the certificate of a problem that names the time: that its base is that problem, and like any other."""
    failures: list[str] = []
    if certificate.fingerprint != problem.fingerprint:
        failures.append("it was made for another problem (the fingerprints differ)")
    failures = failures or wrong_in_time(certificate)
    if failures:
        return CheckReport(False, certificate.lower_bound, float("nan"), tuple(failures))
    return check(certificate.proof.base)


def _check_path(certificate: AlongPath | OfStarts, problem: Problem) -> CheckReport:
    """Verify a certificate along a path, or one from each cell of starts: the checker proves it from its file."""
    failures: list[str] = []
    failure, told = 1.0, ""
    if certificate.fingerprint != problem.fingerprint:
        failures.append("it was made for another problem (the fingerprints differ)")
    if not failures:
        try:
            verdict = verdict_of(certificate)
        except NotCanonicalError as reason:
            failures.append(str(reason))
        else:
            failure, told = verdict.recomputed, alarm_of(certificate, verdict)
            failures += [verdict.reason] if not verdict.proved else []
    if not failures and not failure <= certificate.proof.failure:
        claimed = f"it says that it fails with probability {certificate.proof.failure:.6g} at most"
        failures.append(f"{claimed}, but what was recomputed is {failure:.6g}")
    if not failures and isinstance(certificate.proof, StartsProof):
        worst = max(found for found, *_ in verdict.steps)
        if not worst <= certificate.proof.worst:
            claimed = f"it says that it fails with probability {certificate.proof.worst:.6g} at most from every start"
            failures.append(f"{claimed}, but what was recomputed is {worst:.6g}")
    recomputed = float("nan") if failures else bound_of(failure)
    return CheckReport(not failures, certificate.lower_bound, recomputed, tuple(failures), alarm=told)


def _check_one(certificate: OnGrid, problem: Problem) -> CheckReport:
    """Verify the certificate of one task."""
    failures: list[str] = []
    recomputed, above, told = float("nan"), None, ""
    if certificate.fingerprint != problem.fingerprint:
        failures.append("it was made for another problem (the fingerprints differ)")
    for step in (_check_form, wrong_grids, wrong_networks):
        failures = failures or step(certificate)
    if not failures:
        failures, margins, loss = _check_agents(certificate)
    failures = failures or wrong_guards(certificate, margins)
    if not failures:
        try:
            value = _regrown(certificate)
        except (BrokenTreeError, BrokenTrainError) as error:
            failures.append(str(error))
        else:
            recomputed = _start_value(certificate, value, loss)
            state("sums", certificate, recomputed, loss)
            failures += _check_values(certificate, value, recomputed)
            told = "" if failures else alarm_of(certificate, Verdict(True, 1.0, 1.0 - recomputed - loss, (), ""))
            if certificate.gap is not None and not failures:
                above, failures = _check_above(certificate, certificate.gap, loss)
    return CheckReport(not failures, certificate.lower_bound, recomputed, tuple(failures), above, alarm=told)


def _check_product(product: Certificate[ProductProof], problem: Problem) -> CheckReport:
    """Every part is of the task it stands for, and holds; what their product claims follows."""
    if product.fingerprint != problem.fingerprint:
        failures = ["it was made for another problem (the fingerprints differ)"]
        return CheckReport(False, product.lower_bound, float("nan"), tuple(failures))
    failures, recomputed, above, told = [], 1.0, 1.0, ""
    if [part.fingerprint for part in product.proof.parts] != [task.fingerprint for task in problem.tasks_apart]:
        failures.append("its parts are not the independent tasks of its problem")
    for same in alike_members(product):
        report = check(part := product.proof.parts[same[0]])
        recomputed *= report.recomputed ** len(same)
        above *= (np.nan if report.above is None else report.above) ** len(same)
        failures += [f"{part.problem.name}: {failure}" for failure in report.failures]
        told = told or report.alarm
    known = not failures and product.gap is not None and above >= 0.0
    most = min(1.0, above * (1.0 + 4.0 * len(product.proof.parts) * UNIT)) if known else None
    return CheckReport(not failures, product.lower_bound, recomputed, tuple(failures), most, alarm=told)


def _check_form(certificate: OnGrid) -> list[str]:
    """Check that the value function covers the horizon and that its bound has a name that fits it."""
    failures = []
    if any(
        (part.relation["kind"] in ("boxes", "exact", "linear")) != (part.input_set is None)
        for part in certificate.proof.agents
    ):
        failures.append("a relation and its choices do not belong together")
    tree = certificate.proof.rounding is None
    if not all(part.is_additive for part in certificate.proof.agents):
        own_end = certificate.gap is not None and certificate.proof.complement is None
        if not tree or certificate.proof.bound != "nominal" or own_end:
            failures.append("agents whose steps are not additive have a value or a bound that is not for them")
        failures += uneven_lattices(certificate)
    if tree and len(certificate.proof.merge_log) != certificate.problem.horizon:
        failures.append("its tree does not cover its horizon")
    if certificate.proof.complement is not None and certificate.gap is None:
        failures.append("it rests on the opposite task, and says nothing of an upper end")
    if certificate.proof.bound not in (
        ("nominal", "a-posteriori", "robust tree") if tree else ("nominal", "a-posteriori")
    ):
        failures.append(f"its bound {certificate.proof.bound!r} is none that is known for its value function")
    return failures


def _check_agents(certificate: OnGrid) -> tuple[list[str], list[FloatArray | None], float]:
    """What is wrong with relations and controllers; label margins; and what carrying the policies out can cost.

    Agents that share everything are verified once.
    """
    failures: list[str] = []
    margins: list[FloatArray | None] = []
    loss = 0.0
    verified: dict[object, tuple[FloatArray | None, float]] = {}
    try:
        controllers = certificate.controller.agents
    except ValueError as error:  # a relation that cannot be made from its numbers
        return [str(error)], margins, loss
    for agent, part, controller in zip(certificate.problem.agents, certificate.proof.agents, controllers, strict=True):
        key = (*part.sharing_key(agent), *agent.output_key, repr(lattice_axes(agent)), part.content_digest())
        if key not in verified:
            relation = controller.relation
            execution = execution_of(agent, part, relation)
            wrong = verify_relation(agent, part, relation, execution)
            with noted():  # what is seen as controllers run proves nothing, and is not stated
                wrong = wrong or wrong_actions(agent, part, controller, execution)
            failures += [f"agent `{agent.name}`: {text}" for text in wrong]
            verified[key] = label_margin(part, relation, execution), execution.loss
        margins.append(verified[key][0])
        loss += verified[key][1]
    return failures, margins, loss * certificate.problem.horizon


def _check_above(certificate: OnGrid, gap: float, loss: float) -> tuple[float | None, list[str]]:
    """What the policies attain at most, and whether the certificate says less."""
    above: float | None
    if certificate.proof.complement is not None:
        above, failures = _check_opposite(certificate, certificate.proof.complement)
    else:
        failures = inexact(certificate)
        above = None if failures else attained(certificate)
        above = None if above is None else min(1.0, above + loss)
    if above is not None and not above <= certificate.lower_bound + gap:
        most = certificate.lower_bound + gap
        failures.append(f"it says that the probability is at most {most:.12g}, but what was recomputed is {above:.12g}")
    return above, failures


def _check_opposite(certificate: OnGrid, complement: OnGrid) -> tuple[float | None, list[str]]:
    """What the policies attain at most: a lower bound for the opposite task, taken off 1.

    The opposite task is made of the task itself, whatever problem its certificate says that it is about: names of
    agents may be others.
    """
    if complement.proof.complement is not None:
        return None, ["its upper end has an upper end again"]
    # Files of earlier versions hold opposites that read no exits: runs that leave satisfy neither task.
    make = complement_of if complement.problem.automaton.reads_exits else complement_inside
    try:
        complement = replace(complement, problem=make(certificate.problem))
    except ValueError as error:
        return None, [f"its upper end: {error}"]
    failures = wrong_complement(certificate.problem, complement.problem) or other_controllers(certificate, complement)
    report = check(complement) if not failures else None
    if report is None or not report:
        return None, [f"its upper end: {text}" for text in (failures if report is None else report.failures)]
    return min(1.0, math.nextafter(1.0 - report.recomputed, 2.0)), []


def _regrown(certificate: OnGrid) -> Terms | Value:
    """Value function at time 0, grown again from the policies."""
    return regrow(certificate) if certificate.proof.rounding is None else regrown_trains(certificate)


def _start_value(certificate: OnGrid, value: Terms | Value, loss: float) -> float:
    """Regrown value at the problem's start, less ``loss`` and what lost relations can cost."""
    if certificate.proof.bound == "nominal" and delta_of(certificate) > 0:
        return float("nan")  # the nominal value proves nothing then
    if not isinstance(value, Terms):
        total, steps = train_start_value(certificate, value), float(certificate.problem.horizon)
    else:
        total, steps = tree_start_value(certificate, value), 0.0
    if certificate.proof.bound == "a-posteriori":
        loss += delta_of(certificate) * (steps or _undecided(certificate)) * (1 + 1e-9)
    return max(0.0, total - loss)


def _undecided(certificate: OnGrid) -> float:
    """Upper bound on the expected number of undecided steps."""
    try:
        passed = list(masses(certificate, DROPPED, MOST))
    except TooManyProducts:
        return float(certificate.problem.horizon)
    state("spare", certificate, SPARE)
    return sum(min(1.0, mass.alive + mass.dropped + SPARE) for mass in passed[:-1])


def _check_values(certificate: OnGrid, terms: Terms | Value, recomputed: float) -> list[str]:
    """Check that no claim is larger than what was grown again."""
    failures = []
    agents = certificate.proof.agents
    n = certificate.problem.horizon * sum(places_of(p) + 1 for p in agents) + len(agents)
    counted = max((len(kept) for step in certificate.proof.merge_log for kept in step.kept), default=0)
    rounding = (n + max(certificate.proof.rank, counted) + 2) * 2.0**-53
    if not certificate.lower_bound <= recomputed * (1.0 - rounding):
        failures.append(f"the bound {certificate.lower_bound:.12g} exceeds the recomputed value {recomputed:.12g}")
    elif any(not value <= recomputed * (1.0 - rounding) for value in certificate.proof.bounds.values()):
        failures.append(f"it lists a bound that exceeds the recomputed value {recomputed:.12g}")
    if not rounding + 1e-11 * len(certificate.proof.agents) <= certificate.proof.relative_rounding <= 1.0:
        failures.append("its reserve for rounding is too small")
    tolerance = 1.0 + 1e-11
    stored, regrown = certificate.proof.terms, terms
    if stored is None or not isinstance(regrown, Terms):
        return failures if stored is None else [*failures, "it stores a value tree beside its tensor trains"]
    if any(len(a) != len(b) for a, b in zip(stored.index, regrown.index, strict=True)):
        return [*failures, "the stored value function has other terms than the tree"]
    if any(not np.all(own >= 0.0) for own in stored.factors):
        return [*failures, "the stored value function has factors that are negative or no numbers"]
    for i, (mine, yours) in enumerate(zip(stored.factors, regrown.factors, strict=True)):
        linear = certificate.proof.agents[i].relation["kind"] == "linear"
        for q, rows in enumerate(stored.index):
            if linear and not certificate.problem.automaton.finished[q]:
                continue  # these were proved one by one as the tree was grown; those of finished states are 1
            if np.any(mine[rows[:, i]] > yours[regrown.index[q][:, i]] * tolerance + 1e-250):
                failures.append(
                    f"a stored factor of agent `{certificate.problem.agents[i].name}` exceeds its regrown value"
                )
                break
    return failures


CHECKS: dict[type, Callable[[Any, Problem], CheckReport]] = {
    GridProof: _check_one,
    PathProof: _check_path,
    VertexProof: check_vertices,
    VertexTeamProof: check_vertex_team,
    StartsProof: _check_path,
    UnionBoundProof: _check_pairs,
    TimedProof: _check_timed,
}
"""How each kind of proof is checked."""
