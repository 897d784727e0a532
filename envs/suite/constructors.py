"""Environments for the id, the file or the record of a problem: PettingZoo, Gymnasium, and batches of Gymnasium.

The shells of ``interfaces`` take a `Problem`; this module finds the problem behind a name or a path.
"""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Any

from gymnasium.envs.registration import EnvSpec
from pettingzoo import AECEnv
from pettingzoo.utils.conversions import parallel_to_aec

from ..interfaces import CentralEnv, DeviceTeamEnv, ProblemEnv, ProblemVectorEnv, Specified, TasksEnv, TeamEnv
from ..systems.arguments import UnknownArgument
from ..systems.backends import HOST
from ..tasks.problem import Problem, load_problem
from .catalogue import made_by, problem_of_id
from .certified_bounds import CERTIFIED
from .ids import CENTRAL_ENTRY, MODULES, VECTOR_ENTRY, gymnasium_id

SIGHT = ("scale", "automaton", "sensor_noise")
"""Arguments of all environments that say how states and the automaton state are seen."""

OPTIONS = (
    "observation",
    "neighbours",
    *SIGHT,
    "reward",
    "discount",
    "dtype",
    "actions",
    "infos",
    "caption",
    "disturbance",
)
"""Arguments of `parallel_env` that say how a problem is shown, not which problem."""

CENTRAL_OPTIONS = (*SIGHT, "reward", "discount", "dtype", "actions", "infos", "disturbance")
"""The same of `central_env`."""

VECTOR_OPTIONS = (
    *SIGHT,
    "autoreset_mode",
    "reward",
    "credit",
    "discount",
    "dtype",
    "actions",
    "disturbance",
)
"""The same of `vector_env`."""

LEARNER = {"scale": "unit", "dtype": "float32", "actions": "unit"}
"""What `preset="learner"` stands for: states and inputs in [-1, 1], single precision; other arguments go before it."""

TEAM_OPTIONS = ("device", "observation", "neighbours", *SIGHT, "actions", "reward", "discount", "disturbance")
"""The same of `team_env`."""


def parallel_env(
    problem: Problem | str | Path, render_mode: str | None = None, **arguments: Any
) -> ProblemEnv | TasksEnv:
    """Return the PettingZoo parallel environment of a problem; independent tasks share one (`TasksEnv`).

    Parameters
    ----------
    problem : Problem, str or Path
        A problem, the id of a suite problem, or the path of a problem file (`.toml`).
    render_mode : None, "ansi", "rgb_array" or "human"
    **arguments
        Options of `ProblemEnv`; with an id also the arguments of `make_problem`. `preset="learner"` stands for
        ``{'scale': 'unit', 'dtype': 'float32', 'actions': 'unit'}`` where nothing else is said.

    Examples
    --------
    >>> env = parallel_env("reach-avoid-v0", horizon=7)
    >>> observations, infos = env.reset(seed=0)
    >>> env.agents
    ['agent_0', 'agent_1']
    """
    options = _options(arguments, OPTIONS)
    resolved = resolve(problem, arguments, OPTIONS)
    if resolved.groups:
        return TasksEnv(resolved, render_mode, **options)
    return ProblemEnv(resolved, render_mode, **options)


def aec_env(problem: Problem | str | Path, render_mode: str | None = None, **arguments: Any) -> AECEnv:  # type: ignore[type-arg, unused-ignore]
    """Return the PettingZoo agent-environment-cycle form of `parallel_env`, which takes the same arguments."""
    return parallel_to_aec(parallel_env(problem, render_mode, **arguments))


def central_env(problem: Problem | str | Path, render_mode: str | None = None, **arguments: Any) -> CentralEnv:
    """Return the centralised Gymnasium environment of a problem.

    Parameters
    ----------
    problem : Problem, str or Path
        A problem, the id of a suite problem, or the path of a problem file (`.toml`).
    render_mode : None, "ansi", "rgb_array" or "human"
    **arguments
        Options of `CentralEnv`; with an id also the arguments of `make_problem`. `preset="learner"` stands for
        ``{'scale': 'unit', 'dtype': 'float32', 'actions': 'unit'}`` where nothing else is said.

    Examples
    --------
    >>> env = central_env("reach-avoid-v0", horizon=7)
    >>> observation, info = env.reset(seed=0)
    >>> observation.shape, env.action_space.shape
    ((6,), (2,))
    """
    given, options = dict(arguments), _options(arguments, CENTRAL_OPTIONS)
    env = CentralEnv(resolve(problem, arguments, CENTRAL_OPTIONS), render_mode, **options)
    _registered(env, problem, given)
    return env


def make(problem: Problem | str | Path, render_mode: str | None = None, **arguments: Any) -> CentralEnv:
    """Return the Gymnasium environment of a problem, as ``gymnasium.make`` does: the same as `central_env`."""
    return central_env(problem, render_mode, **arguments)


def vector_env(
    problem: Problem | str | Path, num_envs: int = 1, render_mode: str | None = None, **arguments: Any
) -> ProblemVectorEnv:
    """Return the batched Gymnasium environment of a problem.

    Parameters
    ----------
    problem : Problem, str or Path
        A problem, the id of a suite problem, or the path of a problem file (`.toml`).
    num_envs : int
        Number of worlds M.
    render_mode : None or "rgb_array"
    **arguments
        Options of `ProblemVectorEnv`; with an id also the arguments of `make_problem`. `preset="learner"` stands for
        ``{'scale': 'unit', 'dtype': 'float32', 'actions': 'unit'}`` where nothing else is said.

    Examples
    --------
    >>> envs = vector_env("reach-avoid-v0", num_envs=1000)
    >>> observations, infos = envs.reset(seed=0)
    >>> observations.shape
    (1000, 6)
    """
    steps = arguments.pop("max_episode_steps", None)  # of a specification: `make_vec` hands it on
    given, options = dict(arguments), _options(arguments, VECTOR_OPTIONS)
    resolved = resolve(problem, arguments, VECTOR_OPTIONS)
    if steps not in (None, resolved.horizon):
        raise ValueError(f"`max_episode_steps`: expected the horizon, {resolved.horizon}; ask for another by `horizon`")
    envs = ProblemVectorEnv(resolved, num_envs, render_mode, **options)
    _registered(envs, problem, given)
    return envs


def team_env(problem: Problem | str | Path, num_envs: int = 1, **arguments: Any) -> TeamEnv | DeviceTeamEnv:
    """Return the batched environment of a problem with one array per agent.

    Parameters
    ----------
    problem : Problem, str or Path
        A problem, the id of a suite problem, or the path of a problem file (`.toml`).
    num_envs : int
        Number of worlds M.
    **arguments
        Options of `TeamEnv`; with an id also the arguments of `make_problem`. With `device="torch:cpu"`,
        `"torch:cuda"`, `"cupy"` or `"jax:cpu"` the worlds stay on that device (`DeviceTeamEnv`).

    Examples
    --------
    >>> team = team_env("reach-avoid-v0", 1000, automaton="number")
    >>> team.reset(seed=0).observations["agent_1"].shape
    (1000, 3)
    """
    options = _options(arguments, TEAM_OPTIONS)
    resolved = resolve(problem, arguments, TEAM_OPTIONS)
    if options.get("device", HOST) == HOST:
        options.pop("device", None)
        return TeamEnv(resolved, num_envs, **options)
    return DeviceTeamEnv(resolved, num_envs, **options)


def resolve(problem: Any, arguments: dict[str, Any], options: tuple[str, ...] = ()) -> Problem:
    """Return the problem for a Problem, a suite id (with arguments) or the path of a problem file.

    The options of the environment are taken elsewhere; an error about an unknown argument lists them, too.

    Raises
    ------
    ValueError
        If `problem` is not one of these, or if there are arguments without an id (`UnknownArgument`).
    """
    # A text is the path of a problem file if it ends like one, and an id otherwise.
    if isinstance(problem, str) and not problem.endswith(".toml"):
        return problem_of_id(problem, arguments, (*options, "preset", "render_mode") if options else ())
    if isinstance(problem, str | Path):
        problem = load_problem(problem)
    if not isinstance(problem, Problem):
        raise ValueError(f"`problem`: expected a Problem or the id of one, got {type(problem).__name__}")
    for name in arguments:
        raise UnknownArgument(
            f"`{name}`: expected only with a problem id; use `problem.replace`, or correct the name of the option "
            f"(got an unexpected keyword argument {name!r})"
        )
    return problem


def module_of(id: str) -> ModuleType:
    """Return what is imported of a suite problem: `problem`, and `parallel_env`, `env` and `raw_env` of PettingZoo.

    The latter take `render_mode` and the arguments of the problem. `env` and `raw_env` return the
    agent-environment-cycle form, the one with and the other without PettingZoo's check of the call order.
    """

    def parallel(render_mode: str | None = None, **arguments: Any) -> Any:
        """Return the parallel environment."""
        return parallel_env(id, render_mode, **arguments)

    def env(render_mode: str | None = None, **arguments: Any) -> Any:
        """Return the agent-environment-cycle form; calls out of order are refused."""
        return aec_env(id, render_mode, **arguments)

    def raw_env(render_mode: str | None = None, **arguments: Any) -> Any:
        """Return the agent-environment-cycle form without checks."""
        return env(render_mode, **arguments).env

    make, about = made_by(id)
    module = ModuleType(f"certigym.envs.{MODULES[id]}", about)
    vars(module).update(problem=make, parallel_env=parallel, env=env, raw_env=raw_env)
    return module


def _options(arguments: dict[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    """Take the options with these names out of the arguments, with what a preset says of those that are not there."""
    preset = arguments.pop("preset", None)
    if preset not in (None, "learner"):
        raise ValueError(f"`preset`: expected None or 'learner', got {preset!r}")
    defaults = {name: value for name, value in LEARNER.items() if name in names} if preset else {}
    return defaults | {name: arguments.pop(name) for name in names if name in arguments}


def _registered(env: Specified, problem: Any, given: dict[str, Any]) -> None:
    """Tell an environment of a suite id how it is registered, and what is certified of the id as it is."""
    if not isinstance(problem, str) or problem.endswith(".toml"):
        return
    # A threshold is a probability where the reward is 1 for success, and that of the id where nothing was changed.
    plain = given.keys() <= {*CENTRAL_OPTIONS, *VECTOR_OPTIONS, "preset"} - CHANGES
    if plain and given.get("reward", "sparse") == "sparse":
        env.reward_threshold = CERTIFIED[problem]
    kwargs = {"problem": problem, **given}
    env.spec = EnvSpec(gymnasium_id(problem), CENTRAL_ENTRY, kwargs=kwargs, vector_entry_point=VECTOR_ENTRY)


CHANGES = frozenset(("disturbance", "sensor_noise", "discount"))
"""Options with which success has another probability, or is not what the reward counts."""
