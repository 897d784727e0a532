"""Worlds of a problem as a ``VecEnv`` of Stable-Baselines3 (the extra ``rl``).

All worlds move in one batch (``envs.interfaces.ProblemVectorEnv``). A view turns them into rows: one row per world and
agent for a shared decentralised policy, or one row per world. The rows of a world share its end; an agent earns
satisfaction and the differences of its own level. The contract with Stable-Baselines3:

- a row that ends is reset in the same step; its last observation is in ``infos[row]["terminal_observation"]``;
- ``infos[row]["TimeLimit.truncated"]`` says whether the row ended undecided at the horizon;
- ``infos[row]["is_success"]`` says whether the task was satisfied (missing of episodes that began anywhere),
  ``infos[row]["episode"]`` holds return and length;
- dones are Booleans, rewards are float32, and ``seed(n)`` decides every number drawn from the next ``reset`` on.

The observation holds the time left, so the horizon really ends the decision problem, and nothing comes after it. After
a truncation learners would add the value of later steps. ``horizon_ends="terminated"`` reports the horizon as an end
like any other, and ``train`` uses that; the default follows the environments.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from ...envs.interfaces import ProblemVectorEnv, checked_option
from ...envs.tasks.problem import Problem
from ...synthesis.extended_check.shields import Shield
from .scattered_batches import ScatteredVectorEnv
from .shielded_batches import ShieldedVectorEnv
from .views import CentralView, SharedView, View

HORIZON_ENDS = ("truncated", "terminated")


class WorldsVecEnv(VecEnv):
    """The worlds of one problem as rows for Stable-Baselines3; see the module docstring for the contract.

    Parameters
    ----------
    view : SharedView or CentralView
    worlds : int
        Number of worlds M; there are ``M * view.rows`` rows.
    reward : "sparse", "shaped" or "progress"
    discount : float
        Discount factor of the learner, which shapes the reward, too.
    horizon_ends : "truncated" or "terminated"
    render_mode : None or "rgb_array"
        One picture per world, so that `VecVideoRecorder` of Stable-Baselines3 has something to film.
    shield : Shield, optional
        What keeps a success probability while the learner acts.
    spread : float
        Share of the episodes that begin anywhere (`ScatteredVectorEnv`), of which infos tell no success; 0 with a
        shield.

    Examples
    --------
    >>> import certigym as cg
    >>> env = shared_vec_env(cg.make_problem("reach-avoid-v0"), worlds=3)
    >>> env.seed(0)[0], env.reset().shape
    (0, (6, 7))
    """

    def __init__(
        self,
        view: View,
        worlds: int = 64,
        *,
        reward: str = "shaped",
        discount: float = 1.0,
        horizon_ends: str = "truncated",
        render_mode: str | None = None,
        shield: Shield | None = None,
        spread: float = 0.0,
    ) -> None:
        self.view = view
        self.render_mode = render_mode
        options: dict[str, Any] = {"reward": reward, "discount": discount, "actions": "unit"}
        options |= {"autoreset_mode": "SameStep", "render_mode": render_mode}
        # Agents whose rows they are earn what they have done themselves.
        self._has_own = view.rows > 1
        options |= {"credit": "own" if self._has_own else "team"}
        self.worlds: ProblemVectorEnv
        if shield is not None:
            self.worlds = ShieldedVectorEnv(view.problem, shield, worlds, **options)
        elif spread > 0.0:
            self.worlds = ScatteredVectorEnv(view.problem, spread, worlds, **options)
        else:
            self.worlds = ProblemVectorEnv(view.problem, worlds, **options)
        # If the horizon counts as an end, learners must not add the value of what would come after it.
        self._bootstrap = checked_option(horizon_ends, "horizon_ends", HORIZON_ENDS) == "truncated"
        self._returns, self._lengths = np.zeros(worlds), np.zeros(worlds, dtype=np.int64)
        self._actions: NDArray[Any] = np.zeros(0)
        observed = spaces.Box(-1.0, 1.0, (view.size,), dtype=np.float32)
        super().__init__(worlds * view.rows, observed, spaces.Box(-1.0, 1.0, (view.n_actions,), dtype=np.float32))

    def reset(self) -> NDArray[np.float32]:
        """Begin episodes in all worlds and return the observations; a seed set by ``seed`` is used once."""
        _, infos = self.worlds.reset(seed=self._seeds[0])
        self._reset_seeds()
        self._reset_options()
        self._returns[:], self._lengths[:] = 0.0, 0
        return self._observed(infos)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Set the seed that the next ``reset`` uses; one generator serves all rows."""
        self._seeds = [seed] * self.num_envs
        return list(self._seeds)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Take the actions (rows, m) of the next step."""
        self._actions = np.array(actions)

    def step_wait(self) -> Any:
        """Move all worlds; return observations, rewards, dones (rows,) and infos."""
        # Ended worlds are reset in the same step; their last states are in `final_info`.
        joint = self.view.joint_actions(self._actions)
        counts = ~self.worlds.scattered if isinstance(self.worlds, ScatteredVectorEnv) else True
        _, rewards, terminated, truncated, infos = self.worlds.step(joint)
        ended = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        rows: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if ended.any():
            self._fill(rows, ended, truncated, counts & ended, infos["final_info"])
            self._returns[ended], self._lengths[ended] = 0.0, 0
        # All rows of a world share its end, and its reward unless they are agents.
        per = self.view.rows
        each = self.worlds.own_rewards.T.ravel() if self._has_own else rewards
        return self._observed(infos), each.astype(np.float32), np.repeat(ended, per), rows

    def close(self) -> None:
        """Do nothing: no resource is held."""

    def get_images(self) -> Sequence[NDArray[Any] | None]:
        """Return one picture per world in the render mode "rgb_array"."""
        return list(self.worlds.render() or ())

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return one attribute, the same for all rows."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of all rows."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Refuse the call: rows are not environments."""
        raise ValueError(f"`method_name`: rows share their worlds, so no row has a method {method_name!r}")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Return False for all rows: they are never wrapped."""
        return [False] * len(list(self._get_indices(indices)))

    def _observed(self, infos: dict[str, Any]) -> NDArray[np.float32]:
        """Return the rows of the view for the worlds that the infos describe."""
        return self.view.observations(infos["state"], infos["automaton_state"], infos["time"])

    def _fill(
        self,
        rows: list[dict[str, Any]],
        ended: NDArray[Any],
        truncated: NDArray[Any],
        counts: NDArray[Any],
        final: dict[str, Any],
    ) -> None:
        """Write the infos of the rows that end."""
        last, per = self._observed(final), self.view.rows
        for world in np.flatnonzero(ended):
            episode = {"r": float(self._returns[world]), "l": int(self._lengths[world]), "t": 0.0}
            for row in range(world * per, (world + 1) * per):
                rows[row].update(
                    {
                        "terminal_observation": last[row],
                        "TimeLimit.truncated": bool(truncated[world]) and self._bootstrap,
                        "episode": episode,
                    }
                )
                if counts[world]:
                    rows[row]["is_success"] = bool(final["satisfied"][world])


def shared_vec_env(problem: Problem, worlds: int = 64, **arguments: Any) -> WorldsVecEnv:
    """Return worlds x agents as rows, for one policy that all agents share; arguments as for ``WorldsVecEnv``."""
    return WorldsVecEnv(SharedView(problem), worlds, **arguments)


def central_vec_env(problem: Problem, worlds: int = 64, **arguments: Any) -> WorldsVecEnv:
    """Return worlds as rows, for one policy of the joint state; arguments as for ``WorldsVecEnv``."""
    return WorldsVecEnv(CentralView(problem), worlds, **arguments)
