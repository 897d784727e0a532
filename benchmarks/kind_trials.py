"""Trials of single kinds of claims: certified, checked, and refuted if an independent simulation can.

A claim is *honest* if the simulator of ``independent`` does not refute it; the check must then accept it. It is
*non-trivial* if its bound lies between ``LEAST`` and ``MOST``. Its inflation by ``INFLATION`` *would have been seen*
if the same test, at the same level, refutes the claim made larger by so much.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.stats import binom

import certigym as cg
from cell_forgeries import forgeries_of
from certigym.synthesis.certificates.proofs import GridProof, PathProof, ProductProof, StartsProof, changed
from certigym.synthesis.relations.kinds import Network
from certigym.synthesis.verbs.raw_networks import certify_network, differences
from certigym.synthesis.verbs.upper_bounds import bound_above
from certigym.validation.policies.actors import SharedActor
from deployed import Deployed, Followed, Networked, arguments_of, problem_of
from independent import successes
from random_problems import Spec
from small_problems import small_spec

LEAST, MOST = 0.02, 0.9999
"""Bounds between these are non-trivial; of upper ends, what one minus them is."""

INFLATION = 0.01
"""A claim that is false by so much counts as visible if it would have been refuted."""

FIRST = 20_000
"""Episodes of a first look; where an inflation may be visible, a second one has ``more`` times as many."""

RESERVES = 1e-5
"""By how much stored values may grow and still be proved: reserves of searches that the check does not need."""

Act = Callable[..., Any]


class Refuted(Exception):
    """A claim that the simulation refutes."""


def _tested(spec: Spec, act: Callable[[int, int], Act], claim: float, more: int, level: float) -> tuple[bool, float]:
    """Whether an inflation of a lower bound would have been seen, and the estimate; raise ``Refuted`` if it is wrong.

    Two looks share the level; the second has noise of its own, so that it does not matter why it was taken.
    """
    estimate, seen = 0.0, False
    for seed, episodes in ((1, FIRST), (2, FIRST * more)):
        number, beyond = successes(spec, act(episodes, seed), episodes, seed)
        estimate = number / episodes
        if binom.cdf(number, episodes, claim) < level / 2:
            raise Refuted(f"claimed {claim}, {number} of {episodes} succeeded")
        if beyond > 1e-9 and claim > 0:
            raise Refuted(f"an input was outside of its box by {beyond:.3g} of its width")
        seen = bool(binom.cdf(number, episodes, min(1.0, claim + INFLATION)) < level / 2)
        if seen or more == 0 or estimate > claim + INFLATION + 0.01:
            break
    return seen, estimate


def trial(kind: str, seed: int, level: float, more: int = 15) -> dict[str, Any]:
    """One random problem of a kind: certified, checked, and simulated by other code; ``finding`` is empty if all agree.

    ``level`` is the probability that a true claim is refuted here.
    """
    spec = small_spec(kind, seed)
    row: dict[str, Any] = {"seed": seed, "text": spec["text"], "lower": 0.0, "finding": "", "visible": False}
    try:
        problem = problem_of(spec)
        claims, refusals = CLAIMS.get(kind, _of_synthesis)(problem, spec)
    except ValueError as error:
        return row | {"outcome": "refused", "reason": str(error).split("\n", 1)[0]}
    lower = min(claim for _, _, claim in claims)
    estimates = []
    # The checked claim is tested by every behaviour that it is about; what one of them shows is seen.
    try:
        for own, act, claim in claims:
            if LEAST < claim < MOST:
                seen, estimate = _tested(own, act, claim, more, level / len(claims))
                row["visible"] |= seen
                estimates.append(estimate)
    except Refuted as error:
        return row | {"outcome": "REFUTED", "lower": lower, "finding": f"{error}; check: {refusals or 'valid'}"}
    outcome = "certified" if LEAST < lower < MOST else "trivial"
    row |= {"outcome": outcome, "lower": lower, "estimate": min(estimates, default=np.nan)}
    return row | ({"finding": f"true, and refused: {refusals}"} if refusals else {})


Claims = list[tuple[Spec, Callable[[int, int], Act], float]]
"""Problems as plain numbers, controllers by (episodes, seed), and lower bounds for them."""


def _of_synthesis(problem: cg.Problem, spec: Spec) -> tuple[Claims, str]:
    """The certificate of a problem, as it is."""
    certificate = cg.synthesize(problem, **arguments_of(spec)).certificate
    return [(spec, lambda n, seed: Deployed(certificate, n, seed), certificate.lower_bound)], _refused(certificate)


def _refused(claim: Any) -> str:
    """Why the check refuses a claim; empty if it does not."""
    report = cg.check(claim)
    return "" if report else "; ".join(report.failures)


def _of_path(problem: cg.Problem, spec: Spec) -> tuple[Claims, str]:
    """A certificate along a path, whose inputs are computed by other code."""
    found = cg.synthesize(problem, **arguments_of(spec)).certificate
    if not isinstance(found.proof, PathProof):  # independent tasks
        return [(spec, lambda n, seed: Deployed(found, n, seed), found.lower_bound)], _refused(found)
    return [(spec, lambda n, seed: Followed(spec, found.proof.paths), found.lower_bound)], _refused(found)


def _of_nonlinear(problem: cg.Problem, spec: Spec) -> tuple[Claims, str]:
    """The same, against disturbances that jump at random, and against those that push outward or inward."""
    claims, refusals = _of_path(problem, spec)
    return [*claims, *_blown(*claims[0])], refusals


def _blown(spec: Spec, act: Any, bound: float) -> Claims:
    """The same claim, under disturbances that push outward or inward if there are any."""
    ways = ("outward", "inward") if any(agent.get("winds") for agent in spec["agents"]) else ()
    return [({**spec, "blowing": way}, act, bound) for way in ways]


def _of_networks(problem: cg.Problem, spec: Spec) -> tuple[Claims, str]:
    """A random network as it is, on cells or along its run, whose actions are computed by other code."""
    actor, certificate = _moved_by_network(problem, spec)
    others = [] if isinstance(certificate.proof, PathProof | StartsProof) else differences(certificate, actor)
    claim = spec, lambda n, seed: Networked(spec, problem, actor.network, n), certificate.lower_bound
    return [claim, *_blown(*claim)], "; ".join(filter(None, [_refused(certificate), *others]))


def _moved_by_network(problem: cg.Problem, spec: Spec) -> tuple[SharedActor, Any]:
    actor, cells = SharedActor(problem, random_network(problem, spec)), spec["options"].get("cells")
    found = certify_network(problem, actor, cells) if cells else cg.certify(problem, actor, relation="path")
    return actor, found.certificate


def random_network(problem: cg.Problem, spec: Spec) -> Network:
    """A random network that leads states about to the middle of the workspace."""
    facts, d = spec["network"], max(len(agent["A"]) for agent in spec["agents"])
    rng = np.random.default_rng(facts["seed"])
    size = d + problem.automaton.n_states + 1 + problem.n_agents
    n_out = max(len(agent["B"][0]) for agent in spec["agents"])
    sizes = [size, *facts["hidden"], n_out]
    weights = [0.7 * rng.standard_normal((b, a)) / np.sqrt(a) for a, b in zip(sizes[:-1], sizes[1:])]
    biases = [0.2 * rng.standard_normal(n) for n in sizes[1:]]
    if not facts["hidden"]:  # against the state
        weights[0][:, :d] -= np.sign(np.array(spec["agents"][0]["B"])[:, :n_out].T[:, :d] if n_out <= d else 0.0)
    first, second = (tuple(np.asarray(array, dtype=np.float32) for array in arrays) for arrays in (weights, biases))
    return Network(first, second, facts["activation"], facts["squashed"])


def _of_upper_end(problem: cg.Problem, spec: Spec) -> tuple[Claims, str]:
    """The other end of a certificate: at least so often its controllers fail."""
    certificate: Any = cg.synthesize(problem, **arguments_of(spec)).certificate
    if isinstance(certificate.proof, ProductProof):
        raise ValueError("of independent tasks")
    end = bound_above(certificate)
    report = cg.check(end)
    failing = {**spec, "fails": True}
    claims: Claims = [(failing, lambda n, seed: Deployed(certificate, n, seed), 1.0 - end.upper_bound)]
    return claims, "; ".join(report.failures)


CLAIMS: dict[str, Callable[[cg.Problem, Spec], tuple[Claims, str]]] = {
    "paths": _of_path,
    "nonlinear": _of_nonlinear,
    "fleets": _of_nonlinear,
    "networks": _of_networks,
    "network_runs": _of_networks,
    "upper": _of_upper_end,
}
"""How claims are made; all other kinds are certificates of ``synthesize``."""


# --- forgeries of one cell
def forged_cells(kind: str, seed: int, each: int, level: float) -> list[tuple[str, str, str]]:
    """What was changed in an honest claim of a kind, what became of it, and a finding if something false was accepted.

    Empty if the problem has no claim that says something.
    """
    spec = small_spec(kind, seed)
    try:
        problem = problem_of(spec)
        claim, verify = _honest(problem, spec)
    except ValueError:
        return []
    if claim is None or not LEAST < claim.lower_bound < MOST or not verify(claim):
        return []
    rng, found = np.random.default_rng([20261201, seed]), []
    for name, forged in forgeries_of(claim, rng, each):
        outcome, finding = _judged(spec, claim, forged, verify, level)
        found.append((name, outcome, finding))
    return found


def _honest(problem: cg.Problem, spec: Spec) -> tuple[Any, Callable[[Any], Any]]:
    """A claim that a forger begins with, and its check."""
    if "network" in spec:
        return _moved_by_network(problem, spec)[1], cg.check
    certificate: Any = cg.synthesize(problem, **arguments_of(spec)).certificate
    if isinstance(certificate.proof, ProductProof):
        return None, cg.check
    return certificate, cg.check


def _claiming(claim: Any, lower: float) -> Any:
    """The same claim with another bound."""
    if isinstance(claim.proof, PathProof):
        return changed(claim, failure=1.0 - lower)
    return changed(claim, lower_bound=lower, bounds={claim.proof.bound: lower}, gap=None)


def _judged(spec: Spec, honest: Any, forged: Any, verify: Callable[[Any], Any], level: float) -> tuple[str, str]:
    """What becomes of a forgery: the forger asks what would be proved, claims that, and is tested by simulation."""
    try:
        report = verify(_claiming(forged, 1e-9))
        if not report:
            return "refused", ""
        lower = report.recomputed * (1.0 - 1e-9) - 1e-12
        forged = _claiming(forged, lower)
        if not verify(forged):
            return "refused", ""
        if verify(_claiming(forged, min(1.0, lower * 1.001 + 1e-6))):
            return "ACCEPTED", f"more than was recomputed, {lower}"
    except ValueError:
        return "refused", ""
    except Exception as error:  # noqa: BLE001 a crash is a finding
        return "crashed", f"{type(error).__name__}: {error}"
    # What is said of other starts must not grow by more than reserves, unless policies are others.
    if (
        isinstance(forged, cg.Certificate)
        and isinstance(forged.proof, GridProof)
        and all(
            np.array_equal(one.policy, other.policy) and one.relation == other.relation
            for one, other in zip(forged.proof.agents, honest.proof.agents)
        )
    ):
        rng, agents = np.random.default_rng(0), honest.problem.agents
        low, high = (np.concatenate([getattr(a.workspace, side) for a in agents]) for side in ("low", "high"))
        states = low + (high - low) * rng.random((400, len(low)))
        if np.any(forged.at(states) > honest.at(states) + RESERVES):
            return "ACCEPTED", "it says more of other starts than the honest one"
    for own, act in _behaviours(spec, forged):
        number, beyond = successes(own, act, FIRST, 1)
        if binom.cdf(number, FIRST, lower) < level:
            return "ACCEPTED", f"claims {lower}, {number} of {FIRST} succeeded"
        if beyond > 1e-9 and lower > 0:
            return "ACCEPTED", f"an input was outside of its box by {beyond:.3g} of its width"
    return "true all the same", ""


def _behaviours(spec: Spec, claim: Any) -> Iterator[tuple[Spec, Act]]:
    """Problems and controllers that a claim is about."""
    if isinstance(claim.proof, PathProof):
        yield spec, Followed(spec, claim.proof.paths)
    else:
        yield spec, Deployed(claim, FIRST, 1)
