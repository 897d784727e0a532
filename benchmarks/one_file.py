"""PPO in one file in the manner of CleanRL, on the worlds of `team_env`: one network for all agents.

An agent sees what `team_env` shows it, and which agent it is. No help, no schedule, no seeds but that of torch: a loop
that whoever has a loop of their own may begin with. Used by ``benchmarks/come_back.py`` and ``noisy_sensors.py``.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import torch
from torch import nn

ROUND, EPOCHS, BATCH = 32, 4, 4096
"""Steps between two updates, passes over them, and rows of a batch."""


class Agent(nn.Module):
    """Actor and critic, two layers each."""

    def __init__(self, observed: int, answered: int, width: int = 64) -> None:
        super().__init__()
        sizes = (observed, width), (width, width)
        hidden = [[part for size in sizes for part in (nn.Linear(*size), nn.Tanh())] for _ in range(2)]
        self.actor_mean = nn.Sequential(*hidden[0], nn.Linear(width, answered))
        self.critic = nn.Sequential(*hidden[1], nn.Linear(width, 1))
        self.actor_logstd = nn.Parameter(torch.full((1, answered), -0.5))

    def law(self, rows: torch.Tensor) -> torch.distributions.Normal:
        """Return the law of the actions at rows (..., observed)."""
        return torch.distributions.Normal(self.actor_mean(rows), self.actor_logstd.exp())


def rows_of(env: Any, step: Any) -> torch.Tensor:
    """Return what agents see, and which they are: (worlds, agents, observed)."""
    marks = np.eye(len(env.agents), dtype=np.float32)
    parts = [
        np.concatenate([step.observations[name], np.tile(marks[i], (env.num_envs, 1))], 1)
        for i, name in enumerate(env.agents)
    ]
    return torch.as_tensor(np.stack(parts, 1))


def inputs_of(env: Any, actions: torch.Tensor) -> dict[str, np.ndarray]:
    """Return actions (worlds, agents, answered) by agent."""
    return {name: actions[:, i].numpy() for i, name in enumerate(env.agents)}


def ppo(env: Any, seconds: float, seed: int = 0) -> tuple[Agent, int]:
    """Train for some seconds of wall time; return the agent and the world steps taken."""
    torch.manual_seed(seed)
    told, steps = env.reset(seed=seed), 0
    agent = Agent(rows_of(env, told).shape[-1], env.problem.agents[0].n_inputs)
    adam = torch.optim.Adam(agent.parameters(), lr=1e-3, eps=1e-5)
    until = time.perf_counter() + seconds
    while time.perf_counter() < until:
        kept: list[tuple[torch.Tensor, ...]] = []
        for _ in range(ROUND):
            rows = rows_of(env, told)
            with torch.no_grad():
                law = agent.law(rows)
                action = law.sample()
                chance, worth = law.log_prob(action).sum(-1), agent.critic(rows)[..., 0]
            told = env.step(inputs_of(env, action))
            numbers = (torch.as_tensor(np.asarray(x, dtype=np.float32))[:, None] for x in (told.rewards, told.ended))
            kept.append((rows, action, chance, worth, *numbers))
            steps += env.num_envs
        with torch.no_grad():
            after = agent.critic(rows_of(env, told))[..., 0]
        _update(agent, adam, kept, after)
    return agent, steps


def _update(agent: Agent, adam: Any, kept: list[tuple[torch.Tensor, ...]], after: torch.Tensor) -> None:
    """Update the agent by a round of steps; `after` is the value of what follows."""
    advantage, found = torch.zeros_like(after), []
    for *_, worth, reward, ended in reversed(kept):
        advantage = reward + (1 - ended) * after - worth + 0.95 * (1 - ended) * advantage
        found.append(advantage)
        after = worth
    better = torch.stack(found[::-1]).flatten()
    rows, actions, chances, worths = (torch.stack(x).flatten(0, 2) for x in list(zip(*kept, strict=True))[:4])
    for _ in range(EPOCHS):
        for pick in torch.randperm(len(better)).split(BATCH):
            law = agent.law(rows[pick])
            ratio = (law.log_prob(actions[pick]).sum(-1) - chances[pick]).exp()
            gain = (better[pick] - better[pick].mean()) / (better[pick].std() + 1e-8)
            loss = -torch.minimum(ratio * gain, ratio.clip(0.8, 1.2) * gain).mean()
            loss = loss + 0.5 * (agent.critic(rows[pick])[:, 0] - worths[pick] - better[pick]).square().mean()
            adam.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            adam.step()
