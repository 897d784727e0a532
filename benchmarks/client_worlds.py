"""Worlds in the forms that AgileRL and Xuance take: for ``benchmarks/come_back.py``; needs one of these libraries."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Box

import certigym as cg


def agile_worlds(id: str, n_worlds: int, **options: Any) -> Any:
    """Return the worlds of `team_env` as a vectorised environment of AgileRL: one batch, no processes.

    Actions have one number more than inputs, which is ignored: IPPO of AgileRL 2.58.0 does not learn with actions of
    one number, since it drops their axis and then adds up the logarithms of the densities of a whole batch.
    """
    from agilerl.vector.pz_vec_env import PettingZooVecEnv

    class Worlds(PettingZooVecEnv):  # type: ignore[misc, unused-ignore]
        def __init__(self) -> None:
            self.team = cg.team_env(id, n_worlds, **options)
            seen = self.team.reset(seed=0).observations
            inputs = {agent.name: agent.n_inputs for agent in self.team.problem.agents}
            super().__init__(
                n_worlds,
                {name: Box(-1.0, 1.0, x.shape[1:], np.float32) for name, x in seen.items()},
                {name: Box(-1.0, 1.0, (size + 1,), np.float32) for name, size in inputs.items()},
                list(self.team.agents),
            )

        def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
            return self.team.reset(seed=seed).observations, {}

        def step(self, actions: Any, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
            told = self.team.step({name: np.asarray(action)[:, :-1] for name, action in actions.items()})
            numbers = (told.rewards, told.terminated, told.truncated)
            return told.observations, *(dict.fromkeys(self.agents, value) for value in numbers), {}

    return Worlds()


def xuance_worlds(id: str, **options: Any) -> type:
    """Return the class of the parallel environment as Xuance registers it."""
    from xuance.environment import RawMultiAgentEnv

    class Worlds(RawMultiAgentEnv):  # type: ignore[misc, unused-ignore]
        def __init__(self, config: Any) -> None:
            super().__init__()
            self.env, self.seed = cg.parallel_env(id, **options), config.env_seed
            self.agents = self.env.possible_agents
            self.agent_groups, self.num_agents = [self.agents], len(self.agents)
            self.state_space = self.env.state_space
            self.observation_space = {name: self.env.observation_space(name) for name in self.agents}
            self.action_space = {name: self.env.action_space(name) for name in self.agents}
            self.max_episode_steps = self.env.problem.horizon
            self.gained = dict.fromkeys(self.agents, 0.0)

        def reset(self, **kwargs: Any) -> tuple[Any, Any]:
            # A seed is used once: later episodes go on with the generator.
            seen, infos = self.env.reset(seed=self.seed)
            self.seed, self.gained = None, dict.fromkeys(self.agents, 0.0)
            return seen, {"infos": infos, "individual_episode_rewards": self.gained}

        def step(self, actions: Any) -> tuple[Any, ...]:
            seen, rewards, terminated, truncated, infos = self.env.step(actions)
            self.gained = {name: self.gained[name] + rewards[name] for name in self.agents}
            told = {"infos": infos, "individual_episode_rewards": self.gained}
            return seen, rewards, terminated, any(truncated.values()), told

        def state(self) -> Any:
            return self.env.state()

        def avail_actions(self) -> None:
            return None

        def render(self, *args: Any) -> None:
            return None

        def close(self) -> None:
            self.env.close()

    return Worlds
