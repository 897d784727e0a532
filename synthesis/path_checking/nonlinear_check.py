"""Certificates along a nonlinear path, nominal states with a feedback at each step, once more: for any dynamics.

The nominal states xbar and inputs ubar are numbers of the certificate: any sequence will do. With ``x = xbar + e`` and
``u = ubar + K_t e`` the deviation obeys ``e' = F_t e + r_t(e) + w`` with any matrix F_t, and r_t is what the dynamics
are off from it. Where ``|r_t| <= R_t`` on a tube around xbar_t, e is off the linear deviation ``g' = F_t g + w`` by no
more than the support function of all R_s before (``linear_deviations``); where r_s lies around a middle other than 0,
all of that is shifted by what middles add up to. The tube is ``|e_k| <= slab_k + drift_k`` with
a slab on the linear deviation, met with the closed workspace and the input box, which are inequalities, too. So on the
event that all inequalities on g hold, e is in the tube at each time by induction, and every limit is kept
(docs/theory/paths.md, "Agents of any dynamics").

Where dynamics or regions name the time, the dynamics of step t are those of t, and the regions after it those of t + 1.

All of this is computed here from the problem, the nominal numbers, gains and slabs: intervals and second derivatives by
``own_bends``. Disturbances are anywhere in their ranges, and may know the noise. So are states of others; but where
these have paths of their own, they are in their tubes at the same time, as long as all inequalities of all agents have
held (``side_by_side``). What multiplies
the noise is its nominal value; what it varies on the tube, times a slab on the noise, joins r. Or, where there is no
such slab, variances are those of the largest scale on the tube, and tails those of a Brownian motion that is stopped
earlier (``gaussian_inequalities``); then disturbances must not know the noise of their step.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import replace

import numpy as np

from ...envs.agents import AnyAgent, place_of
from ...envs.problem import Problem
from ..cells import FloatArray
from ..certificates import AgentPath, AlongPath
from .gaussian_inequalities import Inequalities, shortened
from .law_moments import LONG, NORMAL, moments_of
from .limits_kept import add_limits
from .linear_deviations import Chain, Tilted
from .moment import Arrival, Moment
from .moving import Moving, NothingKnownError
from .own_angles import HALF_TURN, ROUNDED, axes_of_angles
from .own_bends import Feedback, expansion
from .roundings import TAIL, UNIT


def moments(
    agent: AnyAgent, path: AgentPath, rows: Inequalities, beside: Callable[[FloatArray], FloatArray] = np.copy
) -> Iterator[Moment]:
    """Yield an agent at times 0 to S; inequalities on its inputs and its noise are added to ``rows`` on the way.

    What is unknown at the last time that was yielded lies in the ranges (2, k) that ``beside`` makes of those of all
    times, once it is asked for the next one.

    Raises
    ------
    NothingKnownError
        If a nominal number is outside of its range, or nothing is known of the next step.
    """
    units = _near(agent.state_high - agent.state_low)
    assert path.states is not None and path.slabs is not None
    d, m = agent.n_states, agent.n_inputs
    start = agent.initial
    moving = Moving.of(_at(agent, 0))
    first = path.states[0]
    free = np.where(axes_of_angles(agent) > 0.0, np.inf, 0.0)  # nothing leaves its workspace by turning
    spread = np.maximum(np.maximum(start.high - first, first - start.low), 0.0) * (1.0 + 2.0 * UNIT)
    chain, arrival = Chain(units, spread), None
    for t, (at, slabs) in enumerate(zip(path.states, path.slabs, strict=True)):
        # Where dynamics name the time, they are those of this step.
        now = _at(agent, min(t, path.n_steps - 1))
        moving = Moving.of(now) if agent.names_time else moving
        if np.any((at < agent.state_low - free) | (at > agent.state_high + free)):
            raise NothingKnownError(f"agent `{agent.name}`: its nominal state leaves the workspace at step {t}")
        # The start has no noise: it is as far off as the set of starts is wide.
        slab = slabs[:d] if t else np.zeros(d)
        shift, drift = chain.drift(np.eye(d))
        reach = (slab + drift) * TAIL
        if np.any((reach + np.abs(shift))[free > 0.0] > HALF_TURN):
            raise NothingKnownError(
                f"agent `{agent.name}`: at step {t} an angle may be half a turn from where it should be"
            )
        lowest, highest = agent.state_low - free, agent.state_high + free
        # The tube lies around what the path is shifted to; the nominal state is in the box, too.
        reach = reach + 4.0 * UNIT * (np.abs(at) + np.abs(shift))
        box = np.stack([np.maximum(at + np.minimum(shift - reach, 0.0), lowest),
                        np.minimum(at + np.maximum(shift + reach, 0.0), highest)])  # fmt: skip
        box = np.stack([np.maximum(np.nextafter(box[0], -np.inf), lowest),
                        np.minimum(np.nextafter(box[1], np.inf), highest)])  # fmt: skip
        yield Moment(t, moving, now, at, box, slabs[:d], chain, arrival)
        if t == path.n_steps:
            return
        here = replace(moving, ranges=beside(moving.ranges))
        arrival = _step(now, here, path, Moment(t, here, now, at, box, slabs[d:], chain), rows)
        assert len(slabs) == 2 * d + m


def _at(agent: AnyAgent, time: int) -> AnyAgent:
    """The agent as it moves at a step."""
    try:
        return agent.at(time)
    except ValueError as error:  # an expression such as 1/t is not defined at this time
        raise NothingKnownError(str(error)) from None


def _step(agent: AnyAgent, moving: Moving, path: AgentPath, now: Moment, rows: Inequalities) -> Arrival:
    """Go on by a step: inputs, the remainder on the tube, and the noise; return what the step was."""
    t, d, m, chain = now.t, agent.n_states, agent.n_inputs, now.chain
    assert path.states is not None
    gain, u, following = path.gains[t], path.inputs[t], path.states[t + 1]
    far = now.reach
    around, rounding = _inputs(agent, now, gain, u, rows)
    ranges = np.hstack([now.box, around, moving.ranges])
    calm = np.clip(0.5 * moving.ranges[0] + 0.5 * moving.ranges[1], moving.ranges[0], moving.ranges[1])
    centre = np.concatenate([now.at, u, calm])
    names = (*moving.states, *moving.inputs, *moving.unknown)
    found = expansion(moving.trees, names, centre, ranges, d + m, Feedback(gain, rounding))
    A, B = found.matrix[:, :d], found.matrix[:, d : d + m]
    closed = A + B @ gain
    # The closed loop is what was computed; what it is off from A + B K, and from rounded inputs, joins the remainder.
    matrix_off = (m + 3.0) * UNIT * (np.abs(A) + np.abs(B) @ np.abs(gain))
    # What is missed on the way to the next nominal state is the middle of the remainder.
    middle = 0.5 * (found.values[0] + found.values[1]) - following
    missed = np.abs(found.values - following - middle).max(axis=0)
    missed = missed + 8.0 * UNIT * (np.abs(found.values).max(axis=0) + np.abs(following) + np.abs(middle))
    remainder = found.off + missed + matrix_off @ far + np.abs(B) @ rounding
    remainder = remainder + ROUNDED * axes_of_angles(agent)
    noise, more = _noise(agent, moving, now, centre, ranges, rows)
    tilted = None
    assert path.slabs is not None
    if moving.scales and moving.noise.tail != LONG:  # Laplace's law has more moments than its variance says
        slab = path.slabs[t][:d] if t else np.zeros(d)
        tilted = _tilted(moving, now, slab, (centre, ranges), Feedback(gain, rounding), noise)
    remainder = (remainder + more) * TAIL
    if not np.all(np.isfinite(remainder + np.abs(middle))):
        raise NothingKnownError(f"agent `{agent.name}`: nothing is known of its dynamics on the tube at step {t}")
    if not np.all(np.isfinite(closed)) or float((remainder + np.abs(middle)).max()) > 1e100:
        raise NothingKnownError(f"agent `{agent.name}`: its drift grows beyond all limits at step {t}")
    before = chain.as_it_is()
    chain.advance(closed, middle, remainder, noise, tilted)
    return Arrival(now, before, closed, middle, remainder, noise)


def _inputs(
    agent: AnyAgent, now: Moment, gain: FloatArray, u: FloatArray, rows: Inequalities
) -> tuple[FloatArray, FloatArray]:
    """Return the box (2, m) of inputs and what (m,) they are rounded by; add their limits, which nothing cuts."""
    low, high, chain, m = agent.input_low, agent.input_high, now.chain, agent.n_inputs
    if np.any((u < low) | (u > high)):
        raise NothingKnownError(f"agent `{agent.name}`: its nominal input leaves the input box at step {now.t}")
    moved = np.any(gain != 0.0, axis=1)
    # Without feedback an input is its nominal value to the last bit; else sums and products round.
    size = np.abs(gain) @ (now.reach + UNIT * np.abs(now.at)) * TAIL
    rounding = np.where(moved, 4.0 * (len(now.at) + 3.0) * UNIT * (np.abs(u) + size), 0.0)
    rounding = rounding + np.abs(gain) @ (ROUNDED * axes_of_angles(agent))
    shift, drift = chain.drift(gain)
    wide = now.slab[:m] + drift if now.t else drift
    # No input is farther from its nominal value than the states that it follows.
    below, above = (np.minimum(np.maximum(wide + sign * shift, 0.0), size) + rounding for sign in (-1.0, 1.0))
    below, above = (np.where(moved, reach + 4.0 * UNIT * np.abs(shift), 0.0) * TAIL for reach in (below, above))
    box = np.stack(
        [np.maximum(np.nextafter(u - below, -np.inf), low), np.minimum(np.nextafter(u + above, np.inf), high)]
    )
    box = np.where(moved, box, u)
    spare = 4.0 * UNIT * (np.abs(u) + np.maximum(np.abs(low), np.abs(high)))
    spare = spare + rounding * TAIL
    ends = shortened(u - low - spare, high - u - spare, shift, drift * TAIL)
    here = moved
    slab = now.slab[:m][here] if now.t else np.full(here.sum(), np.inf)
    bounds = chain.exponential_tails(gain[here], *(np.minimum(end[here], slab) for end in ends))
    variance, largest = chain.spreads(gain)
    rows.add(ends[0][here], ends[1][here], slab, variance[here], largest[here], bounds)
    return box, rounding


def _noise(
    agent: AnyAgent, moving: Moving, now: Moment, centre: FloatArray, ranges: FloatArray, rows: Inequalities
) -> tuple[FloatArray, FloatArray]:
    """Return the covariance (d, d) of a step's noise, and what (d,) its scale on the tube adds to the remainder."""
    d, m, noise = agent.n_states, agent.n_inputs, moving.noise
    rows.tail, rows.lost = max(rows.tail, noise.tail), rows.lost + noise.lost
    if not moving.scales:
        return noise.covariance, noise.off
    names = (*moving.states, *moving.inputs, *moving.unknown)
    found = expansion(moving.scales, names, centre, ranges, 0)
    nominal = 0.5 * (found.values[0] + found.values[1])
    varied = (found.off + np.maximum(found.values[1] - nominal, nominal - found.values[0])) * TAIL
    # A scale that depends on nothing but the time is a number: variances are those of the largest it may be.
    is_number = found.off == 0.0
    varied = np.where(is_number, 0.0, varied)
    is_known = is_number & (found.values[0] == found.values[1])
    largest = np.where(is_known, np.abs(nominal), (np.abs(found.values).max(axis=0) + found.off) * TAIL)
    here = (varied != 0.0) & (noise.deviations != 0.0)
    # Slabs on the noise are for normal numbers.
    slab = np.full(d, np.inf) if noise.tail != NORMAL else now.slab[m:]
    # Without a slab on the noise its scale is anything up to the largest one on the tube.
    is_stopped = here & np.isinf(slab)
    rows.is_stopped |= bool(np.any(is_stopped))
    here &= ~is_stopped
    variance = (np.where(is_stopped | is_number, largest, nominal) * noise.deviations) ** 2 * (1.0 + 8.0 * UNIT)
    rows.add(np.full(d, np.inf)[here], np.full(d, np.inf)[here], slab[here], np.ones(d)[here])
    more = np.where(noise.off == 0.0, 0.0, largest * noise.off)
    more[here] += varied[here] * noise.deviations[here] * slab[here] * TAIL
    return np.diag(variance), more


def _tilted(
    moving: Moving,
    now: Moment,
    slab: FloatArray,
    where: tuple[FloatArray, FloatArray],
    feedback: Feedback,
    noise: FloatArray,
) -> Tilted:
    """Return what squares of deviations of the noise are below, as they vary with the linear deviation g (d,).

    The scale is ``b + a . g``, up to an error, with the derivatives a of the closed loop, so that its square is at most
    ``b^2 + r^2 + 2 b a . g`` where ``|a . g| <= r``. Else it is at most the largest one on the tube.

    ``slab`` (d,) bounds g, ``where`` is the point that is expanded around, and the box; ``noise`` is the covariance
    with the largest scales.
    """
    d, m, gain = len(now.at), len(feedback.gain), feedback.gain
    names = (*moving.states, *moving.inputs, *moving.unknown)
    found = expansion(moving.scales, names, *where, d + m, feedback)
    A, B = found.matrix[:, :d], found.matrix[:, d : d + m]
    a = A + B @ gain
    own_shift, own_drift = now.chain.drift(np.eye(d))
    shift, drift = now.chain.drift(a)
    # The linear deviation is off the true one by shift and drift.
    sizes = (now.reach + np.abs(own_shift) + own_drift) * TAIL
    reach = np.abs(a) @ np.minimum(slab, sizes) * TAIL
    nominal = 0.5 * (found.values[0] + found.values[1])
    b = nominal + shift
    off = found.off + np.abs(found.values - nominal).max(axis=0) + drift
    off = off + (m + 3.0) * UNIT * ((np.abs(A) + np.abs(B) @ np.abs(gain)) @ now.reach) + np.abs(B) @ feedback.rounding
    size = np.abs(b) + reach
    off = (off + 8.0 * UNIT * (np.abs(nominal) + np.abs(shift) + size)) * TAIL
    deviations, most = moving.noise.deviations, np.diag(noise)
    squares = (b**2 + reach**2 + 2.0 * off * size + off**2) * TAIL + 32.0 * UNIT * size**2
    squares, tilts = squares * deviations**2 * TAIL, (2.0 * b * deviations**2)[:, None] * a
    # A slab on the noise keeps it at its nominal size.
    varies = np.isinf(now.slab[m:]) | (moving.noise.tail != NORMAL)
    is_less = varies & np.all(np.isfinite(tilts), axis=1) & (squares < most)
    return Tilted(np.where(is_less, squares, most), np.where(is_less[:, None], tilts, 0.0), sizes)


def _near(width: FloatArray) -> FloatArray:
    """Return powers of two near widths."""
    return np.asarray(2.0 ** np.round(np.log2(width)))


def wrong_nonlinear_path(agent: AnyAgent, path: AgentPath, steps: int) -> list[str]:
    """What is wrong with the form of a nonlinear path: laws, shapes, numbers."""
    d, m = agent.n_states, agent.n_inputs
    name = f"agent `{agent.name}`"
    if any(moments_of(law) is None for law in agent.laws or ()):
        return [f"no moments of the noise of {name} are known"]
    assert path.states is not None
    if path.slabs is None or path.gains.shape != (steps, m, d) or path.inputs.shape != (steps, m):
        return [f"the inputs of {name} do not fit"]
    if path.states.shape != (steps + 1, d) or path.slabs.shape != (steps + 1, 2 * d + m):
        return [f"the nominal states or slabs of {name} do not fit"]
    finite = all(np.all(np.isfinite(array)) for array in (path.states, path.inputs, path.gains))
    if not finite or np.any(np.isnan(path.slabs)) or np.any(path.slabs < 0.0):
        return [f"the inputs, states or slabs of {name} are no numbers"]
    return []


def side_by_side(
    problem: Problem, paths: Mapping[int, AgentPath], rows: Mapping[int, Inequalities]
) -> Iterator[dict[int, Moment]]:
    """Yield agents with their paths at times 0 to S, all of them at each; ``rows`` get what ``moments`` adds.

    Who names a state of another one of them finds it in the box of that path at the same time, by induction over time
    for all agents together. So the inequalities of one agent rest on those of others.

    Raises
    ------
    NothingKnownError
        As ``moments`` does.
    """
    now: dict[int, Moment] = {}

    def beside(i: int) -> Callable[[FloatArray], FloatArray]:
        places = named_states(problem, i, paths)

        def met(ranges: FloatArray) -> FloatArray:
            result = ranges.copy()
            for k, (j, state) in places.items():
                low, high = now[j].box[:, state]
                result[:, k] = np.maximum(ranges[0, k], low), np.minimum(ranges[1, k], high)
            return result

        return met

    walks = {i: moments(problem.agents[i], path, rows[i], beside(i)) for i, path in paths.items()}
    while True:
        after = {i: moment for i, walk in walks.items() if (moment := next(walk, None)) is not None}
        if not after:
            return
        now = after
        yield now


def named_states(problem: Problem, i: int, members: Container[int]) -> dict[int, tuple[int, int]]:
    """Which of the unknowns of agent i are states of which members, by their numbers.

    Inputs are left out, and so are angles, of which boxes hold one copy.
    """
    agent = problem.agents[i]
    found, first = {}, len(agent.unknowns) - len(agent.others)
    for k, name in enumerate(agent.others):
        owner, state, is_input = place_of(name, problem.agents)
        if not is_input and owner in members and not np.any(axes_of_angles(problem.agents[owner])):
            found[first + k] = owner, state
    return found


def nonlinear_failures(certificate: AlongPath) -> tuple[dict[int, float], bool]:
    """Return upper bounds on the probability that an inequality of each agent with a nonlinear path fails.

    Beside them is whether inequalities of agents rest on those of others: then these probabilities add up.
    """
    problem = certificate.problem
    paths = {i: path for i, path in enumerate(certificate.proof.paths) if path.states is not None}
    are_tied = any(named_states(problem, i, paths) for i in paths)
    rows = {i: Inequalities() for i in paths}
    try:
        for now in side_by_side(problem, paths, rows):
            for i, moment in now.items():
                if moment.t:
                    add_limits(moment, certificate, rows[i])
    except NothingKnownError:
        return dict.fromkeys(paths, 1.0), are_tied
    return {i: each.failure() for i, each in rows.items()}, are_tied
