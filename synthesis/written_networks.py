"""Networks of problems that are written in another way: the same functions of what agents see there.

Written out in time, a network is told of the automaton state of the problem, and a clock is no input of its. As a joint
agent the networks of a team are one: their layers stand side by side, with zeros between them, which add nothing in any
order of summation (docs/theory/networks.md, "Problems written in another way").
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from ..envs.agents import AnyAgent
from ..envs.problem import Problem, states_in_time
from .cells import RelationRefused
from .relations import NetworkPolicy, OwnView


def told_in_time(problem: Problem, base: Problem, policies: Sequence[NetworkPolicy]) -> list[NetworkPolicy]:
    """Return networks of a problem that names the time as those of the problem written out."""
    table = states_in_time(problem, base)
    told = np.full(base.automaton.n_states, -1)
    for q in range(problem.automaton.n_states):
        told[table[table[:, q] >= 0, q]] = q
    told[base.automaton.absorbing] = -1
    return [
        replace(policy, view=replace(policy.view, told=tuple(told.tolist())), has_clock=agent.has_clock)
        for policy, agent in zip(policies, base.agents, strict=True)
    ]


def side_by_side(problem: Problem, team: AnyAgent, policies: Sequence[NetworkPolicy]) -> NetworkPolicy:
    """Return the networks of a problem of several agents as that of their joint agent.

    Raises
    ------
    RelationRefused
        If they have different numbers of layers, activations or forms.
    """
    forms = {
        (len(own.network.weights), own.network.activation, own.network.squashed, own.network.outputs, own.view.scale)
        for own in policies
    }
    if len(forms) > 1:
        raise RelationRefused(
            "`policy`: expected networks of one form for a joint agent, got others: numbers of layers, activations and "
            "outputs have to be the same; train them alike"
        )
    view = OwnView(0, 1, problem.n_states, problem.automaton.n_states, problem.horizon, policies[0].view.scale)
    columns = zip(*(_layers(own, view, place) for own, place in zip(policies, problem.columns, strict=True)))
    layers = [[*layer] for layer in columns]
    # The first layers read the same row, all others what is theirs.
    weights = [np.concatenate([w for w, _ in layers[0]]), *(block_diag(*(w for w, _ in layer)) for layer in layers[1:])]
    biases = [np.concatenate([b for _, b in layer]) for layer in layers]
    network = replace(policies[0].network, weights=tuple(weights), biases=tuple(biases))
    return NetworkPolicy(network, view, team.workspace, team.input_box)


def _layers(policy: NetworkPolicy, view: OwnView, place: slice) -> list[tuple[NDArray[Any], NDArray[Any]]]:
    """Return the layers of one agent, cut to its inputs; the first one reads rows of a team, at its own place."""
    own, m = policy.view, policy.input_box.dimension
    weights, biases = [*policy.network.weights], [*policy.network.biases]
    weights[-1], biases[-1] = weights[-1][:m], biases[-1][:m]
    first, count = weights[0], place.stop - place.start
    wide = np.zeros((len(first), view.size), dtype=first.dtype)
    wide[:, place] = first[:, :count]
    # Automaton states and time, and behind them a number that is 1 for everybody.
    wide[:, view.width : -1] = first[:, own.width : own.width + own.states + 1]
    wide[:, -1] = first[:, own.width + own.states + 1 + own.agent]
    return list(zip([wide, *weights[1:]], biases, strict=True))
