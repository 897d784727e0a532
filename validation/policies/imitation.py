"""Imitation: a network learns by supervised regression what a controller does in its own episodes.

``demonstrate`` lets a controller play and writes down what each row of a view saw and did. ``clone`` fits the policy of
a learner to the actions by least squares, and its critic to the outcomes of the episodes. A certified controller shows
its information (own state, automaton state, time) to the shared view, so its clone starts a learner with that same
information; what a network cannot express, such as jumps between cells, is smoothed.

A small disturbance of the demonstrated inputs spreads the states that are seen, and the controller shows how to return
from them (Laskey and others 2017, "DART"). The clone carries no certificate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.simulation import Dynamics, joint
from ...envs.simulation import batch_simulator as core
from ...envs.systems.arguments import counted, tree_text
from ..statistical_tests import Batchable
from .views import View

Array = NDArray[Any]

EPISODES = 1500
"""Demonstrated episodes: some 30,000 rows for each agent of the small problems, in about a second."""

DISTURBANCE = 0.05
"""Standard deviation of the disturbance of demonstrated inputs, in half widths of the input box: little, for teams that
have to move in step."""

ROUNDS, BATCH, FIRST_RATE = 6000, 512, 2e-3
"""Steps of the regression, rows per step, and the first learning rate, which falls to 0: some fifteen CPU seconds."""


@dataclass(frozen=True, eq=False, repr=False)
class Demonstrations:
    """What a controller saw and did.

    Parameters
    ----------
    rows : (N, n) float32 array
        Observations of the view.
    actions : (N, m) float32 array
        Actions in [-1, 1]; 0 in components that an agent does not have.
    used : (N, m) float32 array
        1 for components that the agent of the row has, else 0.
    outcomes : (N,) float32 array
        1 if the episode of the row satisfied its task, else 0.
    episodes : int
    """

    rows: NDArray[np.float32]
    actions: NDArray[np.float32]
    used: NDArray[np.float32]
    outcomes: NDArray[np.float32]
    episodes: int

    def __repr__(self) -> str:
        rows = [("rows", len(self.rows)), ("satisfied", f"{self.outcomes.mean():.3f} of the rows")]
        return tree_text(f"Demonstrations: {counted(self.episodes, 'episode')}", rows)


def demonstrate(
    view: View,
    controller: Batchable,
    episodes: int = EPISODES,
    seed: int = 0,
    disturbance: float = DISTURBANCE,
    noise_factor: float = 1.0,
) -> Demonstrations:
    """Return what a controller does in episodes of its problem, in the rows of a view.

    Parameters
    ----------
    view : SharedView or CentralView
    controller : object with ``batch(dynamics)``
        Such as the controller of a certificate.
    episodes, seed : int
    disturbance : float
        Deviation of the inputs that are applied from those that are written down, in half widths of the input box.
    noise_factor : float
        What the noise of the problem is multiplied with.
    """
    dynamics = Dynamics.of(view.problem)
    policy = controller.batch(dynamics)
    own, noise = (np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(2))
    worlds = core.initial(dynamics, noise, episodes)
    memory = policy.begin(worlds, own)
    seen: list[tuple[Array, Array, Array]] = []
    for _ in range(view.problem.horizon):
        # Episodes that are decided teach nothing; their states may be anything.
        going = np.flatnonzero(~(worlds.failed | view.problem.automaton.absorbing[worlds.q]))
        if not going.size:
            break
        inputs, memory = policy.act(worlds, memory)
        time = np.full(going.size, worlds.time)
        rows = view.observations(joint(dynamics, worlds)[going], worlds.q[going], time)
        seen.append((rows, view.row_actions(_unit(dynamics, inputs)[going]), going))
        moved = _disturbed(dynamics, inputs, disturbance, noise)
        drawn = tuple(noise_factor * part for part in core.noise(dynamics, noise, episodes))
        worlds = core.transition(dynamics, worlds, moved, drawn)
    satisfied = np.asarray(core.satisfied(dynamics, worlds))
    rows, actions = (np.concatenate([entry[k] for entry in seen]).astype(np.float32) for k in (0, 1))
    # All rows of a world share the outcome of its episode.
    outcomes = np.concatenate([np.repeat(satisfied[going], view.rows) for *_, going in seen]).astype(np.float32)
    used = np.tile(view.used_actions, (len(rows) // view.rows, 1)).astype(np.float32)
    return Demonstrations(rows, actions, used, outcomes, episodes)


def clone(model: Any, shown: Demonstrations, rounds: int | None = None, seed: int = 0) -> float:
    """Fit the policy and the critic of a PPO learner to demonstrations; return the last mean square error of actions.

    Parameters
    ----------
    model : stable_baselines3.PPO
        Changed in place.
    shown : Demonstrations
    rounds : int, optional
        Steps of the regression; default: ``ROUNDS``.
    seed : int
        Of the batches; with the seed of the model it decides the outcome.
    """
    import torch

    policy, rounds = model.policy, ROUNDS if rounds is None else rounds
    device = policy.device
    rows, actions, used, outcomes = (
        torch.as_tensor(a, device=device) for a in (shown.rows, shown.actions, shown.used, shown.outcomes)
    )
    parameters = [p for name, p in policy.named_parameters() if name != "log_std"]
    optimizer = torch.optim.Adam(parameters, lr=FIRST_RATE)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.0, rounds)
    rng, error = np.random.default_rng(seed), float("nan")
    for _ in range(rounds):
        batch = torch.as_tensor(rng.integers(0, len(shown.rows), BATCH), device=device)
        hidden_policy, hidden_value = policy.mlp_extractor(policy.extract_features(rows[batch]))
        miss = (((policy.action_net(hidden_policy) - actions[batch]) * used[batch]) ** 2).mean()
        judged = ((policy.value_net(hidden_value)[:, 0] - outcomes[batch]) ** 2).mean()
        optimizer.zero_grad()
        (miss + 0.5 * judged).backward()
        optimizer.step()
        schedule.step()
        error = float(miss.detach())
    return error


def _unit(dynamics: Dynamics, inputs: tuple[Array, ...]) -> Array:
    """Return the joint actions (M, sum of m_i) in [-1, 1] that stand for inputs (m, n, M) per block."""
    problem = dynamics.problem
    result = np.empty((inputs[0].shape[-1], problem.n_inputs))
    for block, u in zip(dynamics.blocks, inputs, strict=True):
        middle, half = 0.5 * (block.input_low + block.input_high), 0.5 * (block.input_high - block.input_low)
        scaled = np.clip(np.divide(u - middle, half, out=np.zeros_like(u), where=half > 0.0), -1.0, 1.0)
        for k, agent in enumerate(block.agents):
            result[:, problem.input_columns[agent]] = scaled[:, k].T
    return result


def _disturbed(
    dynamics: Dynamics, inputs: tuple[Array, ...], disturbance: float, rng: np.random.Generator
) -> tuple[Array, ...]:
    """Return the inputs with a normal disturbance, within the input boxes."""
    result = []
    for block, u in zip(dynamics.blocks, inputs, strict=True):
        half = 0.5 * (block.input_high - block.input_low)
        moved = u + disturbance * half * rng.standard_normal(u.shape)
        result.append(np.clip(moved, block.input_low, block.input_high))
    return tuple(result)
