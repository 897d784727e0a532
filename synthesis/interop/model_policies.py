"""Models of other libraries as policies: asked by the rows with which they were trained."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics, Worlds
from ...envs.systems.arguments import tree_text
from ...envs.tasks.problem import Problem
from ..relations.kinds import JointNetworkPolicy, Network, NetworkPolicy, OwnView, inputs_of
from .detected import ELSE, Detected
from .local_policies import LocalBatch
from .observation_maps import ObservationMap

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Model:
    """A model, and what it sees.

    Parameters
    ----------
    found : Found
    sight : Sight
    """

    found: Detected
    observation_map: ObservationMap

    def inputs(self, problem: Problem, i: int, actions: Array) -> Array:
        """Return the inputs (m, N) of agent i, within its box, for answers (N, k)."""
        agent = problem.agents[i]
        own = np.asarray(actions, dtype=float)
        if own.ndim != 2 or own.shape[1] < agent.n_inputs or not np.isfinite(own).all():
            raise ValueError(
                f"`model`: expected {agent.n_inputs} finite numbers per row for agent `{agent.name}`, got "
                f"{'numbers that are not finite' if own.ndim == 2 and np.isnan(own).any() else own.shape}"
            )
        own = own[:, : agent.n_inputs].T
        if self.observation_map.actions == "unit" or self.found.shares:
            return inputs_of(agent.input_box, own)
        return np.clip(own, agent.input_low[:, None], agent.input_high[:, None])

    def rows(self, problem: Problem, i: int, states: Any, q: Array, time: int) -> Array:
        """Return the rows (N, n) of agent i, filled up with zeros behind if the model observes more."""
        rows = self.observation_map.rows(problem, i, states, q, time)
        spare = 0 if self.found.observed is None else self.found.observed - rows.shape[1]
        return np.pad(rows, ((0, 0), (0, spare)))


@dataclass(frozen=True, eq=False, repr=False)
class OwnModels:
    """Models that see the state of the agent that they move, and none else: decentralised policies.

    Parameters
    ----------
    problem : Problem
    models : tuple of Model
        One for all agents, or one for each.
    """

    problem: Problem
    models: tuple[Model, ...]

    def __repr__(self) -> str:
        return tree_text(f"Policy of {self.problem.name!r}: {self.models[0].found.name}", _rows(self))

    @property
    def information(self) -> str:
        """What agents see, in words."""
        return self.models[0].observation_map.information

    @property
    def why_not_as_it_is(self) -> str:
        """Why the models are not certified as they are; empty if they can be."""
        found = (why_not_as_it_is(self.problem, model, i) for i, model in enumerate(self._each))
        return next(filter(None, found), "")

    @cached_property
    def _each(self) -> tuple[Model, ...]:
        """The model of every agent."""
        return self.models if len(self.models) > 1 else self.models * self.problem.n_agents

    @cached_property
    def _networks(self) -> tuple[NetworkPolicy, ...]:
        """The networks of all agents in the form in which they are certified."""
        return tuple(network_policy(self.problem, model, i) for i, model in enumerate(self._each))

    def agent_policy(self, agent: int) -> NetworkPolicy:
        """Return the network of one agent.

        Raises
        ------
        ValueError
            If the models are not certified as they are; the message says why, and what is possible.
        """
        why = self.why_not_as_it_is
        if why:
            raise ValueError(
                f"`policy`: expected a network that can be certified as it is, got {self.models[0].found.name}: {why}; "
                f"{ELSE}"
            )
        return self._networks[agent]

    def inputs(self, agent: int, states: Array, q: Array, time: int) -> Array:
        """Return the inputs (m, N) of one agent at states (d, N), automaton states (N,) and a time."""
        if not self.why_not_as_it_is:
            return self._networks[agent].inputs(states, np.asarray(q), time)
        model = self._each[agent]
        assert model.found.act is not None  # a model that remembers is one of a team
        seen = [states if k == agent else states[:0] for k in range(self.problem.n_agents)]
        rows = model.rows(self.problem, agent, seen, np.asarray(q), time)
        return model.inputs(self.problem, agent, _answered(model.found.act(rows)))

    def batch(self, dynamics: Dynamics) -> LocalBatch:
        """Return the policy for batched rollouts."""
        return LocalBatch(self, dynamics)

    def save(self, path: Any, agent: str | None = None) -> Any:
        """Write the policy as a file that other programs read; see ``save_policy``."""
        from .writing import save_policy

        return save_policy(self, path, agent)


@dataclass(frozen=True, eq=False, repr=False)
class TeamModels:
    """Models that see states of other agents, certified along their run, or remember, which rollouts judge alone.

    Parameters
    ----------
    problem : Problem
    models : tuple of Model
        One for all agents, or one for each.
    """

    problem: Problem
    models: tuple[Model, ...]

    def __repr__(self) -> str:
        return tree_text(f"Policy of {self.problem.name!r}: {self.models[0].found.name}", _rows(self))

    @property
    def information(self) -> str:
        """What agents see, in words."""
        seen = self.models[0].observation_map.information
        return f"{seen}, what it remembers" if self.models[0].found.memory is not None else seen

    @property
    def why_not_certified(self) -> str:
        """Why models wrapped on a grid are not certified."""
        if any(model.found.memory is not None for model in self.models):
            return "it remembers earlier observations"
        return f"it sees {self.models[0].observation_map.information}"

    @property
    def why_not_as_it_is(self) -> str:
        """Why the models are not certified along their run; empty if they can be."""
        if any(model.found.memory is not None for model in self.models):
            return "it remembers earlier observations"
        if any(model.observation_map.affine(self.problem, 0) is None for model in self.models):
            return f"it sees {self.models[0].observation_map.information}, and the nearest ones change places"
        each = (why_not_as_it_is(self.problem, self.models[i % len(self.models)], i) for i in self._numbers)
        return next(filter(None, each), "")

    @property
    def _numbers(self) -> range:
        return range(self.problem.n_agents)

    def agent_policy(self, agent: int) -> JointNetworkPolicy:
        """Return the network of one agent; ValueError if it cannot be certified along its run."""
        if why := self.why_not_as_it_is:
            raise ValueError(
                f"`policy`: expected a network that can be certified as it is: {why}; judge it by rollouts"
            )
        return joint_policy(self.problem, self.models[agent % len(self.models)], agent)

    def batch(self, dynamics: Dynamics) -> TeamBatch:
        """Return the policy for batched rollouts."""
        return TeamBatch(self, dynamics)


@dataclass(frozen=True, eq=False)
class TeamBatch:
    """Models of a team arranged for batches; the memory holds what each model remembers of all worlds."""

    policy: TeamModels
    dynamics: Dynamics

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> tuple[Any, ...]:
        """Return the memory at time 0: nothing yet."""
        return (None,) * self.dynamics.problem.n_agents

    def act(self, worlds: Worlds, memory: tuple[Any, ...]) -> tuple[tuple[Array, ...], tuple[Any, ...]]:
        """Return inputs (m, n, M) per block; decided worlds, whose states may be anything, get the input 0."""
        problem, models = self.dynamics.problem, self.policy.models
        going = ~(worlds.failed | worlds.accepted)
        # Models are asked about all worlds, because what they remember is of all; states that mean nothing are 0.
        states = [np.where(going, worlds.states[block][:, place], 0.0) for block, place in self.dynamics.position]
        asked = range(1) if models[0].observation_map.central else range(problem.n_agents)
        answers, remembered = [], list(memory)
        for i in asked:
            model = models[i % len(models)]
            rows = model.rows(problem, i, states, worlds.q, int(worlds.time))
            if model.found.memory is not None:
                answer, remembered[i] = model.found.memory(rows, memory[i])
            else:
                assert model.found.act is not None
                answer = model.found.act(rows)
            answers.append(_answered(answer))
        if models[0].observation_map.central:
            answers = [answers[0][:, columns] for columns in problem.input_columns]
        pairs = zip(answers, range(problem.n_agents), strict=True)
        inputs = [np.where(going, models[i % len(models)].inputs(problem, i, answer), 0.0) for answer, i in pairs]
        blocks = self.dynamics.blocks
        return tuple(np.stack([inputs[i] for i in block.agents], axis=1) for block in blocks), tuple(remembered)


def policy_of(problem: Problem, models: tuple[Model, ...]) -> OwnModels | TeamModels:
    """Return the policy that models are: decentralised if each sees its own state alone and remembers nothing."""
    is_own = all(model.observation_map.is_own(problem) and model.found.memory is None for model in models)
    return OwnModels(problem, models) if is_own else TeamModels(problem, models)


def why_not_as_it_is(problem: Problem, model: Model, i: int) -> str:
    """Return why a model that moves agent i is not certified as it is; empty if it can be.

    What is certified must be the network itself, number by number: nothing is rounded to bring it into form.
    """
    found, observation_map, agent = model.found, model.observation_map, problem.agents[i]
    if not found.networks:
        return found.why_not or "it is not a feed-forward network that can be read"
    network = found.networks[i % len(found.networks)]
    in_units = observation_map.actions == "input" and not found.shares
    if in_units and not network.squashed and np.any(agent.input_low >= agent.input_high):
        return "its inputs lie in a box that is flat; train with actions='unit'"
    # A library that knows its space of actions moves what tanh answers onto it; otherwise tanh is an input in its unit.
    box_is_unit = np.all(agent.input_low == -1.0) and np.all(agent.input_high == 1.0)
    if in_units and network.squashed and found.action_space is None and not box_is_unit:
        return "its tanh answers with inputs between -1 and 1, not with shares of the input box"
    if observation_map.automaton == "number":
        column = network.weights[0][:, observation_map.size(problem, i) - 2 - problem.n_agents * observation_map.told]
        exact = np.multiply.outer(np.arange(problem.automaton.n_states), column.astype(float))
        if not np.array_equal(exact, exact.astype(np.float32)):
            return "it sees the automaton state as a number; train with automaton='one-hot'"
    return ""


def network_policy(problem: Problem, model: Model, i: int) -> NetworkPolicy:
    """Return the network that moves agent i in the form in which it is certified: the same function, exactly.

    Columns of the first layer move to where certified networks see what they stand for, and columns of zeros come
    beside them, which add nothing in any order of summation.
    """
    found, observation_map, agent = model.found, model.observation_map, problem.agents[i]
    network, n_q, n = found.networks[i % len(found.networks)], problem.automaton.n_states, problem.n_agents
    width = max(each.n_states for each in problem.agents)
    view = OwnView(i, n, width, n_q, problem.horizon, observation_map.scale)
    seen = width if observation_map.padded else agent.n_states
    changed = _arranged(problem, model, network, seen, width)
    return NetworkPolicy(changed, view, agent.workspace, agent.input_box)


def joint_policy(problem: Problem, model: Model, i: int) -> JointNetworkPolicy:
    """Return the network that moves agent i and sees states of others in the form in which it is certified."""
    found, agent, n_q = model.found, problem.agents[i], problem.automaton.n_states
    network, seen = found.networks[i % len(found.networks)], model.observation_map.affine(problem, i)
    assert seen is not None
    if model.observation_map.central:  # its answer moves all agents
        own = problem.input_columns[i]
        weights, biases = (
            (*network.weights[:-1], network.weights[-1][own]),
            (*network.biases[:-1], network.biases[-1][own]),
        )
        network = replace(network, weights=weights, biases=biases)
    told = len(seen[1])
    changed = _arranged(problem, model, network, told, told)
    rest = np.zeros(changed.weights[0].shape[1] - told)
    if model.observation_map.told:
        rest[n_q + 1 + i] = 1.0
    matrix = np.concatenate([seen[0], np.zeros((len(rest), problem.n_states))])
    offset = np.concatenate([seen[1], rest])
    return JointNetworkPolicy(changed, matrix, offset, told, n_q, problem.horizon, agent.input_box)


def _arranged(problem: Problem, model: Model, network: Network, seen: int, width: int) -> Network:
    """Return a network whose row holds states in ``width`` columns, the automaton state, the time, and who asks."""
    observation_map, n_q, n = model.observation_map, problem.automaton.n_states, problem.n_agents
    first = network.weights[0]
    wide = np.zeros((len(first), width + n_q + 1 + n), dtype=first.dtype)
    wide[:, :seen] = first[:, :seen]
    tail = first[:, seen:]
    if observation_map.automaton == "one-hot":
        wide[:, width : width + n_q], tail = tail[:, :n_q], tail[:, n_q:]
    elif observation_map.automaton == "number":
        wide[:, width : width + n_q], tail = np.multiply.outer(tail[:, 0], np.arange(n_q)), tail[:, 1:]
    wide[:, width + n_q] = tail[:, 0]
    if observation_map.told:
        wide[:, width + n_q + 1 :] = tail[:, 1 : 1 + n]
    outputs = "unit" if network.squashed or observation_map.actions == "unit" or model.found.shares else "box"
    return replace(network, weights=(wide, *network.weights[1:]), outputs=outputs)


def _answered(answer: Any) -> Array:
    """Return answers as an array of numpy."""
    array = answer.detach().cpu().numpy() if hasattr(answer, "detach") else np.asarray(answer)
    return array[:, None] if array.ndim == 1 else array


def _rows(policy: OwnModels | TeamModels) -> list[tuple[str, str]]:
    """Return what is told of a policy: what it sees, and how it is judged."""
    how = "as it is, or wrapped on cells (`wrap=True`)"
    why = policy.why_not_as_it_is
    if isinstance(policy, TeamModels):
        how = f"no, only by rollouts: {why}" if why else "as it is, along its run"
    elif why:
        how = f"wrapped on a grid, not as it is: {why}"
    kinds = [("agents", "one model for all")] if len(policy.models) == 1 else [("agents", "a model for each")]
    return [
        ("trained in", policy.models[0].observation_map.maker),
        ("sees", policy.information),
        *kinds,
        ("certified", how),
    ]
