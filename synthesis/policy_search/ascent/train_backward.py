"""The value function as tensor trains: the recursion of ``tree``, rounded to small rank with a certified error.

With W the masked sum of the successors' trains, ``W_q = sum_q' 1[the letter leads q to q'] V_q',t``, one step back is

    V_q,t+1 = (P_1^pi x .. x P_I^pi) W_q .

Kernels and gathers act on one core each and are contractions in the sup norm, so that an error does not grow:
``err_q,t+1 = max over successors q' of err_q',t + what rounding W_q changed`` (docs/theory/tree.md, "Uniting terms"),
floating point included. A certified value is the computed one less the error. In the exact case the computed value
itself is at most that much below the truth, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ...abstraction.models import AgentModel, JointModel, Policies, StepPolicy
from ...certificates.value_functions import (
    Cells,
    Core,
    Routes,
    Train,
    Trains,
    added,
    arrival,
    assembled,
    core_backup,
    ones,
    routes,
)

Choose = Callable[[int, int, Train], Sequence[StepPolicy]]
"""Policies of all agents, given the time, the automaton state and the value of arriving."""


def terminal(joint: JointModel, cells: Cells = None) -> Trains:
    """Return the value with no step to go (exact)."""
    return Trains(tuple(ones(joint.n_cells, cells) if accepted else None for accepted in joint.accepting))


def moved(arriving: Train, models: Sequence[AgentModel], policies: Sequence[StepPolicy], cells: Cells = None) -> Train:
    """Return the expected value one step before arriving, within its error, at the given cells (all by default)."""
    where = [None] * len(models) if cells is None else cells
    agents = zip(models, policies, where, strict=True)
    cores = [expected(arriving, i, model, policy, at) for i, (model, policy, at) in enumerate(agents)]
    return assembled(arriving, cores, [model.kernel.shape for model in models], cells)


def expected(
    arriving: Train, i: int, model: AgentModel, policy: StepPolicy, at: NDArray[np.integer] | None = None
) -> Core:
    """Return the expected matrices (r, n, r') of agent i under a policy (S,), at n cells; 0 where it has no choice."""
    points = model.choices.points(policy)
    return core_backup(arriving, i, model.n_cells, points if at is None else points[at], model.kernel.backup)


def backward(
    joint: JointModel,
    ways: Routes,
    choose: Choose,
    tolerance: float,
    each: Callable[[int, Trains], None] | None = None,
    visited: Sequence[Cells] | None = None,
    beside: Callable[[int, int], Train | None] | None = None,
) -> Trains:
    """Return the value function at time 0 under the policies that ``choose`` gives, with its certified error.

    Parameters
    ----------
    joint : JointModel
    ways : Routes
        Which joint cells lead from each automaton state to each of its successors.
    choose : callable
        Policies of all agents at a time and automaton state.
    tolerance : float
        What rounding may change in all, in the sup norm.
    each : callable, optional
        Called as ``each(t, value)`` with the value function at every time t = T - 1 .. 0.
    visited : sequence of Cells, optional
        Cells at times 0 .. T. A run that leaves them counts as failed: a lower bound still, with far less to round.
    beside : callable, optional
        ``beside(t, q)`` is added to the value of a step from which acceptance can still be reached (see
        ``evaluate_above``).
    """
    where = [None] * (joint.horizon + 1) if visited is None else visited
    value = terminal(joint, where[-1])
    # Errors add up over time: each step gets an equal share of the tolerance.
    share = tolerance / max(1, joint.horizon)
    for t in reversed(range(joint.horizon)):
        states: list[Train | None] = []
        for q in range(joint.n_states):
            # Where nothing is left to decide the value is 1 or 0.
            if joint.absorbing[q]:
                states.append(ones(joint.n_cells, where[t]) if joint.accepting[q] else None)
                continue
            # Read the letter of the next cell: the masked sum W_q, rounded.
            arriving = arrival(value, ways[q], share)
            if arriving is None:
                states.append(None)
                continue
            # Then take expectations, core by core.
            train = moved(arriving, joint.models, choose(t, q, arriving), where[t])
            states.append(added(train, None if beside is None else beside(t, q)))
        value = Trains(tuple(states))
        if each is not None:
            each(t, value)
    return value


def evaluate(joint: JointModel, policies: Policies, tolerance: float, visited: Sequence[Cells] | None = None) -> Trains:
    """Return the value function at time 0 of given policies, with its certified error; see ``backward``."""
    ways = routes(joint.guards, joint.masks, joint.n_states)
    return backward(joint, ways, lambda t, q, _: [policy[t, q] for policy in policies], tolerance, None, visited)
