"""Networks for teams, as policies of Stable-Baselines3 (torch is loaded with this file).

``CentralCriticPolicy``  one actor for all agents, which sees the row of its agent; a critic that also sees the states
                         of all agents. Only the critic is central, so the actors stay decentralised ("MAPPO", Yu and
                         others 2022).
``OwnParametersPolicy``  an actor and a critic for each agent, chosen by the agent's mark in the row ("IPPO" with
                         independent parameters, de Witt and others 2020).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from torch import Tensor, nn


class CentralCriticPolicy(ActorCriticPolicy):
    """A policy whose actor sees the first ``seen`` numbers of a row, and whose critic sees all of them."""

    def __init__(self, *arguments: Any, seen: int, **keywords: Any) -> None:
        self.seen = seen
        super().__init__(*arguments, **keywords)

    def _build_mlp_extractor(self) -> None:
        arguments = self.net_arch, self.activation_fn, self.device
        self.mlp_extractor = _Split(
            self.seen, MlpExtractor(self.seen, *arguments), MlpExtractor(self.features_dim, *arguments)
        )  # type: ignore[assignment]


class OwnParametersPolicy(ActorCriticPolicy):
    """A policy with networks of its own for each agent; the mark of the agent is the last ``agents`` numbers of a row.

    The deviation of the actions is common to all agents.
    """

    def __init__(self, *arguments: Any, agents: int, **keywords: Any) -> None:
        self.agents = agents
        super().__init__(*arguments, **keywords)

    def _build_mlp_extractor(self) -> None:
        assert isinstance(self.net_arch, list), "the layers of actor and critic are the same"
        outputs = int(np.prod(self.action_space.shape or (1,)))
        self.mlp_extractor = _Own(self.agents, [self.features_dim, *self.net_arch], self.activation_fn, outputs)  # type: ignore[assignment]
        self.mlp_extractor.to(self.device)

    def _build(self, lr_schedule: Any) -> None:
        super()._build(lr_schedule)
        # The networks of the agents end in actions and values already, with the gains that the common last layers have.
        own: Any = self.mlp_extractor
        for networks, gain in ((own.actors, 0.01), (own.critics, 1.0)):
            for network in networks:
                network[-1].apply(partial(self.init_weights, gain=gain))
        self.action_net, self.value_net = nn.Identity(), nn.Identity()  # type: ignore[assignment]
        # The optimizer that has just been made holds the layers that were replaced.
        self.optimizer = self.optimizer_class(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)  # type: ignore[call-arg]


class _Split(nn.Module):
    """Actor and critic behind one another's back: each reads its part of the row."""

    def __init__(self, seen: int, actor: MlpExtractor, critic: MlpExtractor) -> None:
        super().__init__()
        self.seen = seen
        self.policy_net, self.value_net = actor.policy_net, critic.value_net
        self.latent_dim_pi, self.latent_dim_vf = actor.latent_dim_pi, critic.latent_dim_vf

    def forward(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        return self.forward_actor(rows), self.forward_critic(rows)

    def forward_actor(self, rows: Tensor) -> Tensor:
        return self.policy_net(rows[:, : self.seen])

    def forward_critic(self, rows: Tensor) -> Tensor:
        return self.value_net(rows)


class _Own(nn.Module):
    """Whole networks, last layers included, for each agent."""

    def __init__(self, agents: int, sizes: list[int], activation: type[nn.Module], outputs: int) -> None:
        super().__init__()
        self.actors = nn.ModuleList(_layers([*sizes, outputs], activation) for _ in range(agents))
        self.critics = nn.ModuleList(_layers([*sizes, 1], activation) for _ in range(agents))
        self.latent_dim_pi, self.latent_dim_vf = outputs, 1

    def forward(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        return self.forward_actor(rows), self.forward_critic(rows)

    def forward_actor(self, rows: Tensor) -> Tensor:
        return self._each(self.actors, self.latent_dim_pi, rows)

    def forward_critic(self, rows: Tensor) -> Tensor:
        return self._each(self.critics, 1, rows)

    @staticmethod
    def _each(networks: nn.ModuleList, outputs: int, rows: Tensor) -> Tensor:
        """Send each row through the network of its agent."""
        agents = rows[:, -len(networks) :].argmax(dim=1)
        result = rows.new_zeros((len(rows), outputs))
        for agent, network in enumerate(networks):
            which = torch.nonzero(agents == agent)[:, 0]
            if len(which):
                result = result.index_copy(0, which, network(rows[which]))
        return result


def _layers(sizes: list[int], activation: type[nn.Module]) -> nn.Sequential:
    """Return linear layers with an activation between them, none behind the last."""
    layers: list[nn.Module] = []
    for inputs, outputs in zip(sizes[:-1], sizes[1:], strict=True):
        layers += [nn.Linear(inputs, outputs), activation()]
    return nn.Sequential(*layers[:-1])
