"""Certificates along nonlinear paths of teams whose tasks speak of pairs of agents: rows across agents.

The deviations of all agents are one recursion with block-diagonal matrices, so that the difference of two agents is a
row like any other. Where a pair is not to hold, the certificate names a direction n for the time: the half-space
``n.(y_i - y_j) > max over the box of n.z`` does not meet the closed box. The maximum is computed here. Where a pair is
to hold, there are two limits for each output that is compared. Pairs that move are enclosed at the time: to be near is
asked of the least region that they may be, to keep apart of the largest. With the Jacobians C of outputs,

    variance   n' (C_i S_i C_i' + C_j S_j C_j') n,      drift   D_i(n'C_i) + D_j(n'C_j) + |n|'(off_i + off_j),
    shift      the sum of those of both rows,

where noises of different agents are independent, and both tubes hold (docs/theory/paths.md, "Teams"). Where agents
share sources of noise, what both sides make of the same numbers is added: twice the product of their coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...envs.agents import PairRegion
from ..cells import FloatArray
from ..certificates import AlongPath
from .gaussian_inequalities import Inequalities, shortened
from .limits_kept import add_limits
from .moment import Moment
from .moving import NothingKnownError
from .nonlinear_check import side_by_side
from .own_regions import pair_spans
from .roundings import TAIL, UNIT

LEAST_SIZE = 1e-6
"""Least and, inverted, largest size of the largest entry of a direction."""


@dataclass(frozen=True, eq=False)
class Form:
    """A linear form of the outputs that a pair compares, and its limits."""

    pair: PairRegion
    factors: FloatArray
    low: float
    high: float


def wrong_normals(certificate: AlongPath) -> list[str]:
    """What is wrong with the form of a team whose task speaks of pairs: paths of other kinds, directions."""
    problem = certificate.problem
    normals, pairs = certificate.proof.normals, problem.labeling.pairs
    if not pairs:
        return [] if normals is None else ["it has directions of pairs, and its problem has no pairs"]
    if any(path.states is None for path in certificate.proof.paths):
        return ["a task about pairs of agents asks for nominal states of all agents"]
    shape = (certificate.proof.n_steps + 1, sum(pair.size for pair in pairs))
    if normals is None or normals.shape != shape or not np.all(np.isfinite(normals)):
        return ["its directions of pairs do not fit, or are no numbers"]
    # Any multiple of a direction says the same, but tiny ones underflow, and ask for nothing then.
    first = np.concatenate([[0], np.cumsum([pair.size for pair in pairs])])[:-1]
    sizes = np.maximum.reduceat(np.abs(normals), first, axis=1)
    if np.any((sizes != 0.0) & ((sizes < LEAST_SIZE) | (sizes > 1.0 / LEAST_SIZE))):
        return ["a direction of a pair is far from a unit vector"]
    return []


def team_failure(certificate: AlongPath) -> float:
    """Return an upper bound on the probability that an inequality of an agent or of a pair fails."""
    rows, problem = Inequalities(), certificate.problem
    paths = dict(enumerate(certificate.proof.paths))
    try:
        # All agents at time 0, then all at time 1: pairs compare what they are at one time.
        for now in (list(each.values()) for each in side_by_side(problem, paths, dict.fromkeys(paths, rows))):
            if now[0].t:
                for moment in now:
                    add_limits(moment, certificate, rows)
                _add_pairs(now, _forms(certificate, now[0].t), rows, problem.shared_noise)
    except NothingKnownError:
        return 1.0
    return rows.failure()


def _forms(certificate: AlongPath, t: int) -> list[Form]:
    """Return what is asked of pairs at time t."""
    labeling, forms, at = certificate.problem.labeling, list[Form](), 0
    assert certificate.proof.normals is not None
    for p, pair in enumerate(labeling.pairs, start=labeling.first_pair):
        normal = certificate.proof.normals[t, at : at + pair.size]
        at += pair.size
        value = int(certificate.proof.letters[t, p])
        if not value:
            continue
        inner, outer = pair_spans(pair, t)
        if value > 0:
            faces, low, high = inner.inner_faces
            forms += [Form(pair, *each) for each in zip(faces, low.tolist(), high.tolist(), strict=True)]
        elif not outer.is_empty:
            if not np.any(normal):
                raise NothingKnownError(f"pair `{labeling.names[p]}` is kept apart in no direction at step {t}")
            # The largest value of the form on the closed box, or on the closed ball, rounded up.
            corner = np.maximum(normal * outer.low, normal * outer.high)
            largest = float(np.sum(corner)) + (len(normal) + 2.0) * UNIT * float(np.sum(np.abs(corner)))
            if outer.is_round:
                length = float(np.sqrt(np.sum(normal * normal)))
                largest = outer.radius * length * (1.0 + (len(normal) + 8.0) * UNIT)
            forms.append(Form(pair, normal, largest, np.inf))
    return forms


def _add_pairs(now: Sequence[Moment], forms: Sequence[Form], rows: Inequalities, shared: Sequence[FloatArray]) -> None:
    """Add inequalities on differences of two agents; ``shared`` (d, K) are factors of the noise that agents share."""
    if not forms:
        return
    below = np.empty(len(forms))
    above = np.full(len(forms), np.inf)
    shift, drift, variance, largest = np.zeros((4, len(forms)))
    of_agents: dict[int, list[tuple[int, FloatArray]]] = {}
    for k, form in enumerate(forms):
        least, most, off = 0.0, 0.0, 0.0
        for i, sign in ((form.pair.first, 1.0), (form.pair.second, -1.0)):
            row, ends, own_off = _of_agent(now[i], form, sign)
            least, most, off = least + ends[0], most + ends[1], off + own_off
            of_agents.setdefault(i, []).append((k, row))
        spare = 8.0 * UNIT * (abs(least) + abs(most))
        below[k] = least - form.low - off - spare - 8.0 * UNIT * abs(form.low)
        if form.high < np.inf:
            above[k] = form.high - most - off - spare - 8.0 * UNIT * abs(form.high)
    for i, members in of_agents.items():
        here, matrix = np.array([k for k, _ in members]), np.array([row for _, row in members])
        moved, wide = now[i].chain.drift(matrix)
        shift[here], drift[here] = shift[here] + moved, drift[here] + wide + 2.0 * UNIT * np.abs(moved)
        own, steps = now[i].chain.spreads(matrix)
        variance[here] += own
        largest[here] = np.maximum(largest[here], steps)
    if shared[0].shape[1]:
        common, rounded = _common(now, of_agents, shared, len(forms))
        # What is left may be next to nothing: rounding is a share of what was added and taken off.
        variance = np.maximum(variance + common, 0.0) + rounded + 8.0 * UNIT * variance
        largest = 4.0 * largest
    below, above = shortened(below, above, shift, drift * TAIL)
    rows.add(below, above, np.full(len(forms), np.inf), variance * TAIL, largest)


def _common(
    now: Sequence[Moment],
    of_agents: Mapping[int, Sequence[tuple[int, FloatArray]]],
    shared: Sequence[FloatArray],
    count: int,
) -> tuple[FloatArray, FloatArray]:
    """Return what sources that both agents share add (J,) to the variances of forms, and bounds on what that is off.

    With coefficients a and b of the two sides the variance of ``a e + b e`` is that of either side and twice ``a b``.
    """
    sides: list[list[tuple[FloatArray, float]]] = [[] for _ in range(count)]
    for i, members in of_agents.items():
        each, off = now[i].chain.by_sources(np.array([row for _, row in members]), shared[i])
        for (k, _), row, wrong in zip(members, each, off.tolist(), strict=True):
            sides[k].append((row, wrong))
    common, rounded = np.zeros((2, count))
    for k, ((a, a_off), (b, b_off)) in enumerate(sides):
        length = float(np.linalg.norm(a)) * TAIL, float(np.linalg.norm(b)) * TAIL
        common[k] = 2.0 * float(a @ b)
        wrong = length[0] * b_off + length[1] * a_off + a_off * b_off
        rounded[k] = 2.0 * (wrong + (len(a) + 4.0) * UNIT * length[0] * length[1]) * TAIL
    return common, rounded


def _of_agent(now: Moment, form: Form, sign: float) -> tuple[FloatArray, tuple[float, float], float]:
    """Return what one agent adds to a form: its row (d,), ends of its nominal value, and what it may be off by."""
    used = np.flatnonzero(form.factors != 0.0)
    outputs = form.pair.outputs[0 if sign > 0.0 else 1]
    places, factors = [outputs[k] for k in used], sign * form.factors[used]
    found, size = now.outputs, np.abs(factors)
    values, matrix = factors * found.values[:, places], found.matrix[places]
    least, most = float(np.sum(values.min(axis=0))), float(np.sum(values.max(axis=0)))
    # Rows and values are sums of products, which round: what rows are off by acts on deviations within the box.
    rounded = (len(size) + 4.0) * UNIT * float(np.sum(np.abs(values).max(axis=0)) + size @ np.abs(matrix) @ now.reach)
    is_known = bool(np.all(np.isfinite(found.off[places])))
    off = (float(size @ found.off[places]) + rounded) * TAIL if is_known else np.inf
    return factors @ matrix, (least, most), off
