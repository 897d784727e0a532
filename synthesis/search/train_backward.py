"""The value function as tensor trains: the same recursion as ``value``, rounded to small rank with a certified error.

With W the masked sum of the successors' trains, ``W_q = sum_q' 1[the letter leads q to q'] V_q',t``, one step back is

    V_q,t+1 = (P_1^pi x .. x P_I^pi) W_q .

Kernels and gathers act on one core each and are contractions in the sup norm, so an error stays what it was:
``err_q,t+1 = max over successors q' of err_q',t + what rounding W_q changed`` (THEORY section 8), floating point
included. A certified value is the computed one less the error; in the exact case it is also at most that much below.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..models import AgentModel, JointModel, Policies, StepPolicy
from ..values import Cells, Core, Routes, Train, Trains, added, arrival, assembled, ones, routes, smoothed_core


def terminal(joint: JointModel, cells: Cells = None) -> Trains:
    """Value with no step to go."""
    return Trains(tuple(ones(joint.n_cells, cells) if accepted else None for accepted in joint.accepting))


def moved(arriving: Train, models: Sequence[AgentModel], policies: Sequence[StepPolicy], cells: Cells = None) -> Train:
    """Expected value one step before arriving, under one policy per agent, at the given cells (all by default)."""
    where = [None] * len(models) if cells is None else cells
    cores = [expected(arriving, i, *own) for i, own in enumerate(zip(models, policies, where, strict=True))]
    return assembled(arriving, cores, [model.kernel.shape for model in models], cells)


def expected(
    arriving: Train, i: int, model: AgentModel, policy: StepPolicy, at: NDArray[np.integer] | None = None
) -> Core:
    """Expected matrices (r, n, r') of agent i under a policy (S,), at n cells; 0 where there is no choice."""
    points = model.choices.points(policy)
    return smoothed_core(arriving, i, model.n_cells, points if at is None else points[at], model.kernel.smooth)


Choose = Callable[[int, int, Train], Sequence[StepPolicy]]
"""Laws of all agents, given the time, the automaton state and the value of arriving."""


def backward(
    joint: JointModel,
    ways: Routes,
    choose: Choose,
    tolerance: float,
    each: Callable[[int, Trains], None] | None = None,
    visited: Sequence[Cells] | None = None,
    beside: Callable[[int, int], Train | None] | None = None,
) -> Trains:
    """Value function at time 0 under the policies that ``choose`` gives, rounded by at most ``tolerance`` in all.

    ``each(t, value)`` is called with the value function at every time t = T - 1 .. 0. With ``visited``, the cells at
    times 0 .. T, a run that leaves them counts as failed: a lower bound still, with far less to be rounded.
    ``beside(t, q)`` is added to the value of a step where acceptance can still be reached (see ``train_above``).
    """
    where = [None] * (joint.horizon + 1) if visited is None else visited
    value = terminal(joint, where[-1])
    share = tolerance / max(1, joint.horizon)
    for t in reversed(range(joint.horizon)):
        states: list[Train | None] = []
        for q in range(joint.n_states):
            if joint.absorbing[q]:
                states.append(ones(joint.n_cells, where[t]) if joint.accepting[q] else None)
                continue
            arriving = arrival(value, ways[q], share)
            if arriving is None:
                states.append(None)
                continue
            own = moved(arriving, joint.models, choose(t, q, arriving), where[t])
            states.append(added(own, None if beside is None else beside(t, q)))
        value = Trains(tuple(states))
        if each is not None:
            each(t, value)
    return value


def evaluate(
    joint: JointModel,
    policies: Policies,
    tolerance: float,
    each: Callable[[int, Trains], None] | None = None,
    visited: Sequence[Cells] | None = None,
) -> Trains:
    """Value function at time 0 of given policies; see ``backward``."""
    ways = routes(joint.guards, joint.masks, joint.n_states)
    return backward(joint, ways, lambda t, q, _: [policy[t, q] for policy in policies], tolerance, each, visited)
