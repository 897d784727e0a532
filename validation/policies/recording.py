"""Episodes of a policy as data: plain arrays in an ``.npz`` file, and a Minari dataset for offline learners.

Episodes are those of ``rollout`` with the same seed and chunk, to the last bit: the successes of both agree. The file
names the problem by its fingerprint, the policy by what its agents see, and the seed, so that it can be made again.
Data for offline learners come in three tiers (``record_tiers``).
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...envs.interfaces import CentralEnv
from ...envs.simulation import Dynamics, Worlds, joint
from ...envs.simulation import batch_simulator as core
from ...envs.suite import as_problem, central_env, problem_ids
from ...envs.systems.arguments import counted, names_arguments, tree_text, write_bytes
from ...envs.tasks.problem import Problem
from ..statistical_tests import CHUNK, BatchPolicy, Loop, chunks_of, frames, rollout
from .comparison import contestants_of
from .rollout_policies import NoisyController, RandomController

if TYPE_CHECKING:
    from minari import MinariDataset

Array = NDArray[Any]

RECORDING_FORMAT = "certigym recording 1"
"""Name and version of the file format, whose states have always been as they are."""

TRIED, HALVINGS = 1000, 8
"""Episodes that judge a share of random inputs, a rate to .03, and how often the share is halved: it is found to .004,
which changes the rate by less."""

RAW_STATES = "states as they are, outside of workspaces, too"
"""What the description of a Minari dataset says of its states."""


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """Episodes of one policy.

    Parameters
    ----------
    problem : Problem
    information : str
        What the agents of the policy see.
    seed, chunk : int
        Of the rollouts.
    lengths : (N,) int array
        Control steps until the episode was decided; T at most.
    decided, satisfied : (N,) bool arrays
        Whether an episode ended by a verdict rather than at the horizon, and whether it satisfied the task.
    states : (N, T + 1, D) array
        Joint states, components in agent order; NaN after the end of an episode.
    inputs : (N, T, m) array
        Joint inputs as they act, clipped to the input box; NaN from the end on.
    automaton_states : (N, T + 1) int array
        -1 after the end.
    """

    problem: Problem
    information: str
    seed: int
    chunk: int
    lengths: Array
    decided: Array
    satisfied: Array
    states: Array
    inputs: Array
    automaton_states: Array

    def __repr__(self) -> str:
        rows = [
            ("satisfied", f"{self.satisfied.mean():.4f} of the episodes"),
            ("steps", f"{int(self.lengths.sum())}"),
            ("seed", f"{self.seed}, {counted(self.chunk, 'world')} per chunk"),
            ("agents see", self.information),
        ]
        return tree_text(f"Recording of {self.problem.name!r}: {counted(len(self.lengths), 'episode')}", rows)

    def save(self, path: str | Path) -> None:
        """Write everything as ``.npz``; the facts that are no arrays are JSON in ``header``."""
        facts = {
            "format": RECORDING_FORMAT,
            "problem": self.problem.name,
            "fingerprint": self.problem.fingerprint,
            "agents": list(self.problem.agent_names),
            "horizon": self.problem.horizon,
            "information": self.information,
            "seed": self.seed,
            "chunk": self.chunk,
        }
        names = ("lengths", "decided", "satisfied", "states", "inputs", "automaton_states")
        arrays = {name: getattr(self, name) for name in names}
        file = io.BytesIO()
        np.savez_compressed(file, allow_pickle=False, header=np.array(json.dumps(facts)), **arrays)
        write_bytes(path, file.getvalue())

    def observations(self) -> Array:
        """Return what `central_env` shows, (N, T + 1, D + Q + 1): states as they are, automaton state, time left."""
        problem, (n, times, _) = self.problem, self.states.shape
        left = np.broadcast_to(1.0 - np.arange(times) / problem.horizon, (n, times))[..., None]
        one_hot = self.automaton_states[..., None] == np.arange(problem.automaton.n_states)
        return np.concatenate([self.states, one_hot, left], axis=2)

    def to_minari(self, name: str, **about: Any) -> MinariDataset:
        """Write a Minari dataset of the centralised environment with inputs as actions; return it.

        That of a suite problem recovers its environment (``dataset.recover_environment()``, after ``import certigym``);
        that of another one holds its spaces.

        Parameters
        ----------
        name : str
            Such as "certigym/meeting/certified-v0"; Minari keeps datasets in the folder MINARI_DATASETS_PATH.
        **about
            What else Minari is told: `author`, `author_email`, `code_permalink`, which it misses with a warning, ...

        Raises
        ------
        ValueError
            If Minari is not installed.
        """
        try:
            import minari
            from minari.data_collector import EpisodeBuffer
        except ImportError as error:
            raise ValueError('datasets of Minari need it: install "certigym[data]"') from error
        env, seen, buffers = _central_env(self.problem), self.observations(), []
        for k, length in enumerate(self.lengths.tolist()):
            # The reward is 1 at the end of a satisfied episode; the horizon is a truncation, as in the environment.
            marks = np.zeros((3, length), dtype=float)
            marks[:, -1:] = [[self.satisfied[k]], [self.decided[k]], [not self.decided[k]]]
            buffers.append(
                EpisodeBuffer(
                    id=k,
                    observations=list(seen[k, : length + 1]),
                    actions=list(self.inputs[k, :length]),
                    rewards=marks[0].tolist(),
                    terminations=marks[1].astype(bool).tolist(),
                    truncations=marks[2].astype(bool).tolist(),
                )
            )
        facts = f"{self.problem.name}, fingerprint {self.problem.fingerprint}, seed {self.seed}, chunk {self.chunk}"
        facts = f"{facts}; {RAW_STATES}"
        return minari.create_dataset_from_buffers(
            name,
            buffers,
            env=env.spec,
            eval_env=env.spec,
            observation_space=env.observation_space,
            action_space=env.action_space,
            algorithm_name=self.information,
            description=facts,
            **about,
        )


def _central_env(problem: Problem) -> CentralEnv:
    """Return the centralised environment of a problem, by its id where it is that of the suite at some horizon."""
    if problem.name in problem_ids():
        for changes in (dict[str, Any](), {"horizon": problem.horizon}):
            env = central_env(problem.name, actions="input", **changes)
            if env.problem.fingerprint == problem.fingerprint:
                return env
    return CentralEnv(problem, actions="input")


@names_arguments()
def record(problem: Any, policy: Any, episodes: int = 1000, seed: int = 0, chunk: int = CHUNK) -> Recording:
    """Return episodes of a policy as arrays.

    Parameters
    ----------
    problem : Problem, id or path
    policy : anything that ``compare`` takes
        A certificate, a training, an actor, a controller, a function of own state, automaton state and time.
    episodes, seed, chunk : int
        As for ``rollout``, whose episodes these are.

    Raises
    ------
    ValueError
        If the policy has an unknown form, or if the problem decomposes into independent tasks.

    Examples
    --------
    >>> import certigym as cg
    >>> found = record("invariance-v0", lambda x, q, t: -0.5 * x, 100)
    >>> found.states.shape, bool(found.satisfied.mean() > 0.9)
    ((100, 8, 4), True)
    """
    problem = as_problem(problem)
    if problem.groups:
        count = len(problem.groups)
        raise ValueError(f"`problem`: expected one task, got {count} independent ones; record each of `problem.tasks`")
    contestant = contestants_of(problem, "policy", policy)[0]
    loop = Loop(problem, contestant.controller, int(seed), chunk)
    parts = [_chunk(loop, number, count) for number, count in chunks_of(episodes, chunk)]
    arrays = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    return Recording(problem, contestant.information, int(seed), chunk, *arrays)


@names_arguments()
def record_tiers(
    problem: Any, expert: Any, episodes: int = 1000, seed: int = 0, chunk: int = CHUNK
) -> dict[str, Recording]:
    """Return episodes of three policies: "random" inputs, "medium", and "expert".

    The medium policy is the expert with random inputs at a share of the steps of each agent. That share is found by
    bisection, so that about half of what the expert gains over random inputs is left.

    Parameters
    ----------
    problem, episodes, seed, chunk
        As for `record`.
    expert : anything that ``record`` takes as a policy

    Examples
    --------
    >>> found = record_tiers("invariance-v0", lambda x, q, t: -0.5 * x, 100)
    >>> list(found)
    ['random', 'medium', 'expert']
    """
    problem = as_problem(problem)
    entrant = contestants_of(problem, "expert", expert)[0]

    def mixed(share: float) -> NoisyController:
        return NoisyController(entrant.controller, share, entrant.information)

    def successes(share: float) -> int:
        return rollout(problem, mixed(share), TRIED, seed=seed).successes

    aim, low, high = 0.5 * (successes(0.0) + successes(1.0)), 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if successes(middle) > aim else (low, middle)
    policies = {"random": RandomController(), "medium": mixed(high), "expert": entrant.controller}
    return {tier: record(problem, policy, episodes, seed, chunk) for tier, policy in policies.items()}


@dataclass(frozen=True, eq=False)
class _Listener:
    """A policy that writes down the inputs that another one chooses."""

    policy: BatchPolicy
    heard: list[tuple[Array, ...]]

    def begin(self, worlds: Worlds, rng: np.random.Generator) -> Any:
        return self.policy.begin(worlds, rng)

    def act(self, worlds: Worlds, memory: Any) -> tuple[tuple[Array, ...], Any]:
        inputs, memory = self.policy.act(worlds, memory)
        self.heard.append(inputs)
        return inputs, memory


def _chunk(loop: Loop, number: int, count: int) -> tuple[Array, ...]:
    """Return lengths, ends, verdicts, states, inputs and automaton states of the first ``count`` worlds of a chunk."""
    problem, (dynamics, policy) = loop.problem, loop.arranged
    listener, horizon = _Listener(policy, []), loop.problem.horizon
    lengths = np.full(loop.chunk, horizon)
    states = np.full((loop.chunk, horizon + 1, problem.n_states), np.nan)
    inputs = np.full((loop.chunk, horizon, problem.n_inputs), np.nan)
    automaton_states = np.full((loop.chunk, horizon + 1), -1)
    ended = np.zeros(loop.chunk, dtype=bool)
    satisfied = np.zeros(loop.chunk, dtype=bool)
    for time, frame in enumerate(frames(loop, dynamics, listener, number)):
        worlds, going = frame.worlds, ~ended
        states[going, time], automaton_states[going, time] = joint(dynamics, worlds)[going], worlds.q[going]
        now = going & (worlds.failed | problem.automaton.absorbing[worlds.q])
        lengths[now], ended = time, ended | now
        if time < len(listener.heard):  # an input was chosen for these worlds
            inputs[~ended, time] = _joined(dynamics, listener.heard[time])[~ended]
        satisfied = np.asarray(core.satisfied(dynamics, worlds))
    return tuple(array[:count] for array in (lengths, ended, satisfied, states, inputs, automaton_states))


def _joined(dynamics: Dynamics, inputs: tuple[Array, ...]) -> Array:
    """Return the joint inputs (M, m), clipped to the input boxes."""
    result = np.empty((inputs[0].shape[-1], dynamics.problem.n_inputs))
    for columns, u in _columns(dynamics, inputs):
        result[:, columns] = u.T
    return result


def _columns(dynamics: Dynamics, inputs: tuple[Array, ...]) -> Iterator[tuple[slice, Array]]:
    """Yield the columns of each agent in joint inputs, and its inputs (m, M), clipped."""
    for block, u in zip(dynamics.blocks, inputs, strict=True):
        clipped = np.clip(u, block.input_low, block.input_high)
        for place, agent in enumerate(block.agents):
            yield dynamics.problem.input_columns[agent], clipped[:, place]
