"""Certificates along a path, once more: from the matrices of the problem alone.

Deviations from the nominal path are ``e_t = sum_k F^k w_{t-1-k}`` with ``F = A + B K``, so that ``c e_t`` has the
variance ``sum_k c F^k Sigma F'^k c'``. What has to hold is read from the letters of the certificate, and the automaton
is followed through every letter that agrees with them. Numbers are off by rounding; each is moved to the side that
makes a failure more probable, by a bound that goes along with it: the same sums of absolute values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from ...envs.agents import LinearAgent, Proposition, with_matrices
from ...envs.problem import Problem
from ..cells import FloatArray
from ..certificates import SOMETIME, AgentPath, AlongPath
from ..masses import state
from .crossings import Met, closed, readings, wrong_windows
from .nonlinear_check import nonlinear_failures, wrong_nonlinear_path
from .own_regions import RegionSpan
from .pair_limits_check import team_failure, wrong_normals
from .roundings import SMALLEST, TAIL, UNIT
from .start_check import wrong_start


@dataclass(frozen=True, eq=False)
class Powers:
    """Powers ``F^k`` of a matrix as they were computed, and bounds on norms of the true ones and of the difference.

    With ``P_k+1 = fl(F P_k)``, the difference of P_k from ``F^k`` is a sum of ``F^j`` times the rounding of one
    product, so that its norm is bounded by norms of true powers, and these by induction (Frobenius norms).
    """

    computed: list[FloatArray]
    norms: list[float]
    errors: list[float]

    @classmethod
    def of(cls, matrix: FloatArray, off: float, count: int) -> Powers:
        """Return the powers 0 to count - 1 of a matrix that is known up to ``off``."""
        d = len(matrix)
        unit, size = (d + 2.0) * UNIT, float(np.linalg.norm(matrix)) * TAIL
        computed, norms, errors, rounded = [np.eye(d)], [float(np.sqrt(d)) * TAIL], [0.0], list[float]()
        for k in range(1, count):
            last = float(np.linalg.norm(computed[-1])) * TAIL
            rounded.append((unit * size + off) * last)
            computed.append(matrix @ computed[-1])
            errors.append(sum(norms[j] * rounded[k - 1 - j] for j in range(k)) * TAIL)
            norms.append(float(np.linalg.norm(computed[-1])) * TAIL + errors[-1])
        return cls(computed, norms, errors)

    def carried(self, each: list[float]) -> list[float]:
        """Return bounds on ``sum_s F^(t-1-s) r_s`` for all t, with r_s no longer than ``each[s]``."""
        return [sum(self.norms[t - 1 - s] * each[s] for s in range(t)) * TAIL for t in range(len(each) + 1)]


@dataclass(frozen=True, eq=False)
class System:
    """Matrices, ranges and start of a linear agent, in ``units`` (d,) of the states that are powers of two."""

    units: FloatArray

    A: FloatArray
    B: FloatArray
    offset: FloatArray
    noise_covariance: FloatArray
    start: FloatArray
    state_low: FloatArray
    state_high: FloatArray
    input_low: FloatArray
    input_high: FloatArray
    output_matrix: FloatArray


@dataclass(frozen=True, eq=False)
class Motion:
    """Nominal path of one agent, what means may be off by, and the deviations from it.

    ``states`` (S + 1, d) are nominal states as they were computed, ``off`` (S + 1,) bounds on how far the mean of the
    state may be from them, ``powers`` those of the closed loop.
    """

    name: str
    agent: System
    path: AgentPath
    states: FloatArray
    off: list[float]
    powers: Powers

    @classmethod
    def of(cls, moved: LinearAgent, followed: AgentPath) -> Motion:
        """Follow the nominal inputs of an agent, states and inputs in units in which they are of about one size."""
        agent, path = _in_even_units(moved, followed)
        steps, (d, m) = len(path.inputs), agent.B.shape
        unit = 2.0 * (d + m + 4.0) * UNIT
        size_B, size_K = float(np.linalg.norm(agent.B)) * TAIL, float(np.linalg.norm(path.gain)) * TAIL
        size_A, size_c = float(np.linalg.norm(agent.A)) * TAIL, float(np.linalg.norm(agent.offset)) * TAIL
        wrong = unit * (size_A + size_B * size_K) if size_K else 0.0  # without feedback nothing is added
        closed = Powers.of(agent.A + agent.B @ path.gain, wrong, steps + 1)
        states, rounded = np.zeros((steps + 1, d)), []
        states[0] = agent.start
        for t, u in enumerate(path.inputs):
            states[t + 1] = agent.A @ states[t] + agent.B @ u + agent.offset
            parts = size_A * float(np.linalg.norm(states[t])) + size_B * float(np.linalg.norm(u)) + size_c
            rounded.append(unit * parts * TAIL)
        # The nominal states are off by what is rounded, in the controller as well as here.
        off = Powers.of(agent.A, 0.0, steps + 1).carried(rounded)
        if size_K:
            # Its inputs are off by that, and by their own rounding; the loop carries on what they cause.
            largest = float(np.linalg.norm(np.maximum(np.abs(agent.state_low), np.abs(agent.state_high))))
            pushed = []
            for t, u in enumerate(path.inputs):
                span = largest + float(np.linalg.norm(states[t])) + off[t]
                pushed.append(size_B * (size_K * off[t] + unit * (float(np.linalg.norm(u)) + size_K * span)) * TAIL)
            off = [first + second for first, second in zip(off, closed.carried(pushed), strict=True)]
        return cls(moved.name, agent, path, states, off, closed)

    def variances(self, t: int, rows: FloatArray) -> FloatArray:
        """Variances (J,) of rows (J, d) of the deviation at time t, from above."""
        noise, powers = self.agent.noise_covariance, self.powers
        size, lengths, d = float(np.linalg.norm(noise)) * TAIL, np.linalg.norm(rows, axis=1) * TAIL, len(noise)
        # Rows (t, J, d) as all powers move them; one sum over states, then one over times: what is added rounds so.
        moved = np.matmul(rows, np.array(powers.computed[:t]).reshape(-1, d, d))
        total = np.sum(np.sum(np.matmul(moved, noise) * moved, axis=2), axis=0)
        moved_size = np.linalg.norm(moved, axis=2) * TAIL
        off = np.array(powers.errors[:t]) + (d + 2.0) * UNIT * np.array(powers.norms[:t])
        wrong = off[:, None] * lengths
        each = 2.0 * moved_size * wrong + wrong**2 + (2.0 * d + t + 4.0) * UNIT * moved_size**2
        error = size * np.sum(each, axis=0)
        # Squares of tiny rows underflow; a variance of 0 would say that nothing can happen.
        least = np.where(np.any(rows != 0.0, axis=1), SMALLEST, 0.0)
        return np.asarray(np.maximum(total, 0.0) + error * TAIL + least)


def _in_even_units(agent: LinearAgent, path: AgentPath) -> tuple[System, AgentPath]:
    """Return the matrices of an agent and its path, every state and input counted in a power of two near its range.

    Norms take states together: in units of their own, what a large one is off by would be charged to a small one. With
    powers of two every number keeps its digits, and so does every sum and product that the controller forms: what is
    off by rounding is the same in both units. Where numbers would leave the range of floating point, nothing is done.
    """
    state, push = _near(agent.state_high - agent.state_low), _near(agent.input_high - agent.input_low)
    output = np.ones(agent.n_outputs)
    # Every array, what its rows are counted in, and what its columns are counted per.
    units = {
        "A": (agent.A, state, state), "B": (agent.B, state, push), "offset": (agent.offset, state),
        "noise_covariance": (agent.noise_covariance, state, 1.0 / state), "start": (agent.initial.low, state),
        "state_low": (agent.state_low, state), "state_high": (agent.state_high, state),
        "input_low": (agent.input_low, push), "input_high": (agent.input_high, push),
        "output_matrix": (agent.output_matrix, output, state),
        "inputs": (path.inputs, np.ones(len(path.inputs)), 1.0 / push), "gain": (path.gain, push, state),
    }  # fmt: skip
    values, is_kept = {}, True
    for name, (array, rows, *columns) in units.items():
        factor = np.outer(1.0 / rows, columns[0]) if columns else 1.0 / rows
        values[name] = array * factor
        is_kept &= bool(np.array_equal(values[name] / factor, array))
    if not is_kept:
        state, values = np.ones(agent.n_states), {name: array for name, (array, *_) in units.items()}
    inputs, gain = values.pop("inputs"), values.pop("gain")
    return System(state, **values), AgentPath(inputs, gain)


def _near(width: FloatArray) -> FloatArray:
    """Return powers of two near widths; 1 for inputs of a single value."""
    return np.asarray(2.0 ** np.round(np.log2(np.where(width > 0.0, width, 1.0))))


def wrong_paths(certificate: AlongPath) -> tuple[list[str], float]:
    """What is wrong with a certificate along a path, and an upper bound on the probability of failing."""
    problem = certificate.problem
    failures = _wrong_form(certificate)
    if failures:
        return failures, 1.0
    failures = _wrong_word(certificate)
    if failures:
        return failures, 1.0
    if problem.labeling.pairs:
        return [], min(1.0, team_failure(certificate))
    each: list[float] = []
    log_kept = 0.0
    nonlinear, are_tied = nonlinear_failures(certificate)
    for i, (agent, path) in enumerate(zip(problem.agents, certificate.proof.paths, strict=True)):
        if i in nonlinear:
            failure = nonlinear[i]
        else:
            agent = with_matrices(agent)
            failure = _failure(certificate, Motion.of(agent, path))
        each.append(failure)
        log_kept += float(np.log1p(-min(1.0 - 1e-16, failure)))
    if problem.joint_noise or are_tied:
        # Agents that share noise, or whose inequalities rest on those of others, are not independent.
        return [], min(1.0, float(np.sum(each)) * TAIL)
    any_failure = min(1.0, float(-np.expm1(log_kept)) * TAIL)
    state("any", np.array(each), any_failure)
    return [], any_failure


def both_failures(certificate: AlongPath) -> tuple[float, float]:
    """Return upper bounds on the probability that the one agent of a certificate fails: Boole's, and by correlation.

    A bound is 1 unless every nominal value is on the right side of its limits, where both are convex in them.
    """
    agent = with_matrices(certificate.problem.agents[0])
    return _both(certificate, Motion.of(agent, certificate.proof.paths[0]))[1:]


def _wrong_form(certificate: AlongPath) -> list[str]:
    """Shapes, signs, kinds of agents, starts."""
    problem, steps = certificate.problem, certificate.proof.n_steps
    shape = (steps + 1, len(problem.automaton.propositions))
    failures = []
    if problem.groups:
        failures.append("it is of independent tasks, which have certificates of their own")
    elif not 1 <= steps <= problem.horizon or len(certificate.proof.paths) != problem.n_agents:
        failures.append("its path does not fit the horizon or the agents")
    elif certificate.proof.letters.shape != shape or certificate.proof.faces.shape != shape:
        failures.append("its letters do not fit the path")
    elif not np.all(np.isin(certificate.proof.letters, (-1, 0, 1, SOMETIME))):
        failures.append("its letters are none")
    elif not 0.0 <= certificate.proof.failure <= 1.0:
        failures.append("its probability of failing is none")
    for agent, path in zip(problem.agents, certificate.proof.paths):
        if path.states is not None:
            failures += wrong_nonlinear_path(agent, path, steps)
        elif not agent.is_linear_gaussian:
            failures.append(f"agent `{agent.name}` is not linear with Gaussian noise")
        elif not np.array_equal(agent.initial.low, agent.initial.high):
            failures.append(f"the start of agent `{agent.name}` is no point")
        elif path.inputs.shape != (steps, agent.n_inputs) or path.gain.shape != (agent.n_inputs, agent.n_states):
            failures.append(f"the inputs of agent `{agent.name}` do not fit")
        elif not (np.all(np.isfinite(path.inputs)) and np.all(np.isfinite(path.gain))):
            failures.append(f"the inputs of agent `{agent.name}` are no numbers")
        elif agent.angles:
            failures.append(f"agent `{agent.name}` has angles, and no nominal states")
    return failures or wrong_windows(certificate) or wrong_normals(certificate) or wrong_start(problem)


def _wrong_word(certificate: AlongPath) -> list[str]:
    """Whether every word that agrees with the letters is accepted."""
    problem, automaton = certificate.problem, certificate.problem.automaton
    assert problem.initial_q is not None  # others were refused
    # By what was met in open windows: what is known of a letter is the same in all states.
    reached: dict[Met, set[int]] = {frozenset(): {problem.initial_q}}
    for t in range(1, certificate.proof.n_steps + 1):
        after: dict[Met, set[int]] = {}
        for met, states in reached.items():
            for letter, by_now in readings(certificate.proof.letters[t].tolist(), met):
                # Where a window ends and nothing was met in it, no run is.
                if (rest := closed(certificate.proof, t, by_now)) is not None:
                    known = _known(problem, letter, t)
                    after.setdefault(rest, set()).update(*(_targets(certificate, q, known) for q in states))
        reached = after
    states = {q for own in reached.values() for q in own}
    if not automaton.is_co_safe and certificate.proof.n_steps != problem.horizon:
        return ["its path ends before the horizon, and the task is judged there"]
    if not all(automaton.accepting[q] for q in states):
        return ["a word that agrees with its letters is not accepted"]
    return []


def _known(problem: Problem, letter: list[int], t: int) -> dict[int, bool]:
    """What is known of propositions at a time: what the letter says, and that regions do not meet one that holds.

    A region that moves may be empty at this time: then it does not hold.
    """
    # Those about pairs come last, and are known by the letter alone.
    names, first = problem.automaton.propositions, problem.labeling.first_pair
    known = {p: value > 0 for p, value in enumerate(letter) if value}
    regions = [_region(problem, name, t) for name in names[:first]]
    for p, (agent, region) in enumerate(regions):
        if p not in known and region.is_empty:
            known[p] = False
        for q, value in enumerate(letter[:first]):
            if p in known or value <= 0 or agent != regions[q][0]:
                continue
            if region.is_apart_from(regions[q][1]):
                known[p] = False
    return known


def _region(problem: Problem, name: str, t: int) -> tuple[str, RegionSpan]:
    """The agent of a proposition, and where its region is at a time."""
    proposition = problem.propositions[name]
    assert isinstance(proposition, Proposition)
    return proposition.agent, RegionSpan.of(proposition, t)


def _targets(certificate: AlongPath, q: int, known: dict[int, bool]) -> set[int]:
    """States to which a state leads by the letters that agree with what is known."""
    automaton = certificate.problem.automaton
    entries, seen, targets = [int(automaton.root[q])], set(), set()
    while entries:
        entry = entries.pop()
        if entry < 0:
            targets.add(-1 - entry)
        elif entry not in seen:
            seen.add(entry)
            p = int(automaton.variable[entry])
            if known.get(p, True):
                entries.append(int(automaton.high[entry]))
            if not known.get(p, False):
                entries.append(int(automaton.low[entry]))
    return targets


def _failure(certificate: AlongPath, motion: Motion) -> float:
    """Upper bound on the probability that an inequality of an agent fails."""
    return min(_both(certificate, motion))


def _both(certificate: AlongPath, motion: Motion) -> tuple[float, float, float]:
    """Upper bounds on the probability that an inequality of an agent fails, in the units of its motion.

    By Boole, whatever the nominal values; the same where every nominal value keeps its limits, else 1; and by the
    correlation inequality.
    """
    agent, path = motion.agent, motion.path
    below, above = [], []
    for t in range(1, certificate.proof.n_steps + 1):
        rows, low, high = _limits(certificate, motion.name, agent, t)
        off = np.linalg.norm(rows, axis=1) * motion.off[t] * TAIL
        tails = _tails(rows @ motion.states[t], off, motion.variances(t, rows), low, high)
        below.append(tails[0])
        above.append(tails[1])
    if np.any(path.inputs < agent.input_low) or np.any(path.inputs > agent.input_high):
        return 1.0, 1.0, 1.0
    moved = _moved_inputs(agent, path)
    for t, u in enumerate(path.inputs):
        # An input that no deviation reaches is its nominal value, which is in the closed box: rounding is cut off at
        # the face, which brings it nearer to that value, so that what the motion charges for rounding covers it.
        here = moved[t]
        if not np.any(here):
            continue
        rows, u = path.gain[here], u[here]
        rounding = 16.0 * len(path.gain[0]) * UNIT * np.abs(u)
        off = np.linalg.norm(rows, axis=1) * motion.off[t] * TAIL + rounding
        tails = _tails(u, off, motion.variances(t, rows), agent.input_low[here], agent.input_high[here])
        below.append(tails[0])
        above.append(tails[1])
    left, right = np.concatenate(below), np.concatenate(above)
    boole = float(np.sum(left) + np.sum(right)) * TAIL
    nearer = np.maximum(left, right)
    if not np.all(nearer < 0.5):
        return min(1.0, boole), 1.0, 1.0
    correlated = float(-np.expm1(np.sum(np.log1p(-2.0 * nearer)))) * TAIL
    state("any", 2.0 * nearer, correlated)
    return min(1.0, boole), min(1.0, boole), min(1.0, correlated)


def _moved_inputs(agent: System, path: AgentPath) -> NDArray[np.bool_]:
    """Whether the feedback may move inputs (S, m), by where matrices have zeros: the others have deviations of 0."""
    steers = path.gain != 0.0
    passes = (agent.A != 0.0) | ((agent.B != 0.0) @ steers)
    noisy = np.any(agent.noise_covariance != 0.0, axis=1)
    reached, moved = np.zeros(len(agent.A), dtype=bool), []
    for _ in path.inputs:
        moved.append(steers @ reached)
        reached = noisy | (passes @ reached)
    return np.array(moved)


def _limits(certificate: AlongPath, owner: str, agent: System, t: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rows (J, d) of the inequalities on the state of an agent at time t, and their limits."""
    problem = certificate.problem
    # Limits are those of the problem: rows give outputs and states in its units.
    rows, low, high = [*np.diag(agent.units)], [*(agent.state_low * agent.units)], [*(agent.state_high * agent.units)]
    for p, name in enumerate(problem.automaton.propositions):
        value = int(certificate.proof.letters[t, p])
        if problem.propositions[name].agent != owner or value == 0:
            continue
        region = _region(problem, name, t)[1]
        outputs = range(len(agent.output_matrix))
        if value < 0:
            face = int(certificate.proof.faces[t, p])
            if not 0 <= face < 2 * len(agent.output_matrix):
                return np.zeros((1, len(agent.A))), np.array([1.0]), np.array([1.0])  # no side: it never holds
            k = face // 2
            rows.append(agent.output_matrix[k])
            low.append(region.high[1, k] if face % 2 else -np.inf)
            high.append(np.inf if face % 2 else region.low[0, k])
            continue
        for k in outputs:
            rows.append(agent.output_matrix[k])
            low.append(region.low[1, k])
            high.append(region.high[0, k])
    # Of several limits of one row the narrowest ones say all.
    distinct, which = np.unique(np.array(rows), axis=0, return_inverse=True)
    narrow_low, narrow_high = np.full(len(distinct), -np.inf), np.full(len(distinct), np.inf)
    np.maximum.at(narrow_low, which.ravel(), np.array(low))
    np.minimum.at(narrow_high, which.ravel(), np.array(high))
    return distinct, narrow_low, narrow_high


def _tails(
    at: FloatArray, off: FloatArray, variances: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Probabilities (J,) to be below and above limits, for means that may be off, from above."""
    tails = []
    for distance, limit in ((at - low, low), (high - at, high)):
        rounded = off + 4.0 * UNIT * (np.abs(at) + np.where(np.isfinite(limit), np.abs(limit), 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.where(variances > 0.0, (distance - rounded) / np.sqrt(2.0 * np.maximum(variances, 1e-300)), np.inf)
        # Without noise a limit either holds for sure or does not.
        z = np.where((variances <= 0.0) & ~(distance > rounded), -np.inf, z)
        tails.append(np.where(z == np.inf, 0.0, np.minimum(1.0, 0.5 * erfc(z) * TAIL + SMALLEST)))
        state("tails", z, tails[-1])
    return tails[0], tails[1]
