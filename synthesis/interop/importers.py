"""`as_policy`: any model as a policy of a problem."""

from __future__ import annotations

import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.suite import as_problem
from ...envs.tasks.problem import Problem
from ..certificates.controllers import InputTable, Vectorized, decentralised, vectorized
from ..certificates.proofs import certificate_from
from ..relations.grids import RelationRefused
from . import onnx_files, stable_baselines3, torch_modules, weight_arrays
from .actor_files import NotAnActor, read_actor
from .detected import ELSE, REMEMBERS, Detected, Reader
from .environments import matched
from .local_policies import LocalController
from .model_policies import Model, OwnModels, TeamModels, policy_of
from .observation_maps import ObservationMap
from .written_feedback import is_written, symbolic_policies

READERS: tuple[Reader, ...] = (stable_baselines3, torch_modules, onnx_files, weight_arrays)
"""Libraries in the order in which they are asked: modules of torch are last of those that are made of such modules."""

FILES: dict[str, Any] = {
    ".zip": stable_baselines3, ".onnx": onnx_files, ".pt": torch_modules, ".pth": torch_modules,
}  # fmt: skip
"""Who reads files, by their ends."""

UNREADABLE = (zipfile.BadZipFile, pickle.UnpicklingError, RuntimeError, EOFError, KeyError)
"""What libraries raise at files that are not theirs."""

RUN = frozenset({".zip", ".pt", ".pth"})
"""Ends of files that may run code as they are read."""

FACTS = ("activation", "squashed", "trust")
"""What may be said of a model that it does not say itself."""


def as_policy(model: Any, problem: Any, env: Any = None, **facts: Any) -> Any:
    """Return a model of any library as a policy of a problem, for every verb that takes a policy.

    The policy sees what the model saw in training, and nothing is guessed: sizes and ranges of what it observes must be
    those of an environment of the problem, and where several environments would fit, ``env`` says which.

    Parameters
    ----------
    model : object, str or Path
        A model or policy of Stable-Baselines3 or sb3-contrib; a module of torch; layers as arrays (JAX, flax); the path
        of a file: ``.zip`` (Stable-Baselines3), ``.onnx``, ``.pt``, a certificate. A mapping from agent names to these,
        a model for each agent. Or what is a policy already: a function ``u = f(x, q, time)`` of the agent's own state
        (d,), automaton state and time, a table, a controller, a certificate, anything with ``batch(dynamics)``.
    problem : Problem, id or path
        On which it acts.
    env : environment or str, optional
        In which it was trained, or how that is made: ``cg.parallel_env(id, actions="unit")``, or
        ``"parallel_env(actions=unit)"``. Needed where a model does not say what it observes.
    **facts
        ``activation`` ("tanh", "relu", "sigmoid", "elu" or "silu") and ``squashed`` (whether tanh follows the
        outputs) of arrays; ``trust``, whether files may run code that is in them (default: True). Reading ``.zip`` and
        ``.pt`` runs such code (pickle), unless a ``.pt`` holds numbers alone: give only files that you trust, or
        ``trust=False``.

    Returns
    -------
    policy
        With ``batch(dynamics)`` and ``information`` (what agents see, in words). If agents see their own state alone,
        it has ``inputs(agent, states, q, time)``, can be certified, and says in ``why_not_as_it_is`` whether it can be
        certified as it is (``certify``: feed-forward networks, exactly, in single
        precision). Models that see other agents or remember say in ``why_not_certified`` why they are judged by
        rollouts alone.

    Raises
    ------
    ValueError
        If the object is of no kind that is known, if its sizes are those of no environment of the problem, or if
        several environments fit.

    Examples
    --------
    >>> import certigym as cg
    >>> layers = [(np.full((7, 1), -0.5, np.float32), np.zeros(1, np.float32))]
    >>> policy = cg.as_policy(layers, "reach-avoid-v0", env="shared_vec_env")
    >>> policy.information, policy.why_not_as_it_is
    ('own state, automaton state, time', '')
    """
    unknown = sorted(set(facts) - set(FACTS))
    if unknown:
        raise ValueError(f"`{unknown[0]}`: expected {', '.join(FACTS)}, got another fact about a model")
    return batchable(model, as_problem(problem), env, facts)


def batchable(
    model: Any, problem: Problem, env: Any = None, facts: Mapping[str, Any] | None = None, argument: str = "policy"
) -> Any:
    """Return what ``as_policy`` returns; messages speak of an argument of this name."""
    policy = brought(model, problem, env, facts, argument)
    return policy if hasattr(policy, "batch") else LocalController(decentralised(problem, policy))


def brought(
    model: Any, problem: Problem, env: Any = None, facts: Mapping[str, Any] | None = None, argument: str = "policy"
) -> Any:
    """Return models of other libraries as policies, and everything else as the policy that it is or carries.

    A function, a table or a mapping of these comes back as it is: ``decentralised`` takes it.

    Raises
    ------
    ValueError
        As for ``as_policy``.
    """
    known = dict(facts or {})
    if isinstance(model, str | Path):
        return _of_file(Path(model), problem, env, known)
    # What knows how to act on this package's worlds; models of other libraries do not.
    for attribute in ("controller", "actor"):
        if hasattr(getattr(model, attribute, None), "batch"):
            return getattr(model, attribute)
    if hasattr(model, "batch") or callable(getattr(model, "inputs", None)):
        return model
    if is_written(model, problem):
        return symbolic_policies(model, problem)
    reader = _reader(model)
    if reader is not None:
        return _made(problem, [reader.read(model, known)], env)
    if isinstance(model, Mapping) and any(isinstance(each, str | Path) for each in model.values()):
        return _made_of_files(model, problem, env, known)
    if isinstance(model, Mapping) and set(model) == set(problem.agent_names):
        readers = {name: _reader(each) for name, each in model.items()}
        if all(readers.values()):
            order = problem.agent_names
            return _made(problem, [readers[name].read(model[name], known) for name in order], env)  # type: ignore[union-attr]
        if not any(readers.values()):
            return model
        return _mixed(model, problem, env, known)
    if callable(model) or isinstance(model, Mapping | InputTable | Vectorized):
        return model
    understood = ", ".join(reader.SAYS for reader in READERS)
    raise ValueError(
        f"`{argument}`: expected a function or a table, or a model that is known, got {type(model).__name__}; "
        f"understood are functions `u = f(x, q, time)`, controllers, {understood}, and one of these for each agent by "
        "name (see `as_policy`)"
    )


def is_model(model: Any) -> bool:
    """Return whether an object is a model of a library that is known."""
    return _reader(model) is not None


def certifiable(problem: Problem, policy: Any, along: bool = False) -> Any:
    """Return what ``decentralised`` takes of a policy in any form, or raise ValueError if it cannot be certified.

    Models that see other agents can be only ``along`` their run, and so can models whose layers are known.
    """
    policy = brought(policy, problem)
    if not isinstance(policy, OwnModels | TeamModels):
        return policy
    name, why = policy.models[0].found.name, policy.why_not_as_it_is
    if any(model.found.memory is not None for model in policy.models):
        raise ValueError(f"`policy`: {name}: {REMEMBERS}; or put it behind a shield")
    if isinstance(policy, TeamModels) and (why or not along):
        raise ValueError(
            f"`policy`: expected a policy of own state, automaton state and time, got {name}: "
            f"{why if along else policy.why_not_certified}; judge it by rollouts (`compare`, `rollout`), or put it "
            "behind a shield"
        )
    if why and along:
        raise RelationRefused(f"`policy`: expected a network that can be certified as it is, got {name}: {why}; {ELSE}")
    return policy


def _reader(model: Any) -> Reader | None:
    """Return who reads a model; None if it is of no library that is known."""
    return next((reader for reader in READERS if reader.recognises(model)), None)


def _of_file(path: Path, problem: Problem, env: Any, facts: dict[str, Any]) -> Any:
    """Return what a file or folder holds as a policy; ``PATH@ENV`` says in which environment it was trained."""
    name, at, told = str(path).rpartition("@")
    if at and not path.exists():
        path, env = Path(name), told if env is None else env
    if not path.exists():
        raise ValueError(
            f"`policy`: expected a function or a table, a model, or the path of a file or folder that exists, got "
            f"{str(path)!r}"
        )
    reader = FILES.get(path.suffix)
    if reader is None:
        try:
            found, own = read_actor(path, problem.n_agents)
        except NotAnActor:
            return certificate_from(str(path)).controller
        return _made(problem, [found], own if env is None else env)
    try:
        found = reader.read_file(path, facts)
        if env is None and reader is onnx_files:
            env = onnx_files.env_of(path)
        return _made(problem, [found], env)
    except ImportError as error:
        raise ValueError(f"`{path}`: expected the library that reads it, found none: {error}") from error
    except AttributeError as error:  # a class of the script that has saved it
        raise ValueError(
            f"`{path}`: expected classes that can be imported, got {error}; load it in a Python file that has "
            "them, and give FILE.py:NAME or the object"
        ) from error
    except UNREADABLE as error:
        raise ValueError(f"`{path}`: expected a file that its library has saved: {error}") from error


def _made_of_files(model: Mapping[str, Any], problem: Problem, env: Any, facts: dict[str, Any]) -> Any:
    """Return files, one for each agent, as a policy."""
    if set(model) != set(problem.agent_names):
        raise ValueError(f"`policy`: expected a file for each of {', '.join(problem.agent_names)}, got others")
    parts = [_of_file(Path(model[name]), problem, env, facts) for name in problem.agent_names]
    if not all(isinstance(part, OwnModels) for part in parts):
        raise ValueError("`policy`: expected files of models of one agent each, which see its own state alone")
    return OwnModels(problem, tuple(part.models[0] for part in parts))


def _mixed(model: Mapping[str, Any], problem: Problem, env: Any, facts: dict[str, Any]) -> Any:
    """Return a mapping of models and functions as functions of each agent."""
    policies: dict[str, Any] = {}
    for name, each in model.items():
        reader = _reader(each)
        policies[name] = each if reader is None else _alone(problem, name, reader.read(each, facts), env)
    return policies


def _alone(problem: Problem, name: str, found: Detected, env: Any) -> Any:
    """Return a model of one agent as a function of many of its states."""
    i = problem.agent_names.index(name)
    policy = policy_of(problem, (Model(found, matched(problem, found, env, range(i, i + 1))),))
    if isinstance(policy, TeamModels):
        raise ValueError(f"`policy`: expected models of own states beside functions, got {found.name} for {name!r}")
    return vectorized(lambda x, q, time: policy.inputs(i, x, np.full(x.shape[1], q), time))


def _made(problem: Problem, found: list[Detected], env: Any) -> OwnModels | TeamModels:
    """Return models as a policy: matched with what they see."""
    everyone = range(problem.n_agents)
    moved = [everyone] if len(found) == 1 else [range(i, i + 1) for i in everyone]
    models = tuple(Model(each, _seen(problem, each, env, agents)) for each, agents in zip(found, moved, strict=True))
    if len(found) > 1 and any(model.observation_map.central for model in models):
        raise ValueError("`policy`: expected models of one agent each, got one that moves all of them")
    return policy_of(problem, models)


def _seen(problem: Problem, found: Detected, env: Any, agents: range) -> ObservationMap:
    """Return what a model sees that moves these agents; of one that remembers the message says first what it is for."""
    try:
        return matched(problem, found, env, agents)
    except ValueError as error:
        if found.memory is None:
            raise
        raise ValueError(f"`policy`: {found.name}: {REMEMBERS}; to roll it out: {error}") from error
