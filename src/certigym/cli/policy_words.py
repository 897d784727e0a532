"""Policies by their words on the command line."""

from __future__ import annotations

import sys
from argparse import Namespace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from ..envs.tasks.problem import Problem
from ..synthesis.certificates.proofs import load_certificate
from ..synthesis.interop import RUN, as_policy
from ..synthesis.verbs.synthesize import synthesize
from ..validation.policies import ALGORITHMS, IdleController, NotAnActor, RandomController, load_actor
from .given import cells_of, relation_of
from .work import trained


def policy_of_word(problem: Problem, name: str, options: Namespace) -> Any:
    """Return a policy by its word on the command line."""
    if name == "certified":
        return synthesize(problem, cells_of(options), **relation_of(options))
    if name in ALGORITHMS:
        return [trained(problem, name, options.steps, seed) for seed in options.train_seeds]
    if name in ("random", "idle"):
        return RandomController() if name == "random" else IdleController()
    return policy_of_file(problem, name, options.trust)


def policy_of_file(problem: Problem, name: str, trust: bool) -> Any:
    """Return a policy from a file: an actor, a certificate, or an object of a Python file.

    Files of other libraries that run code as they are read have to be trusted.
    """
    # FILE.py:NAME runs the file and takes the object of this name.
    path, _, attribute = name.rpartition(":")
    if path.endswith(".py"):
        spec = spec_from_file_location(Path(path).stem, path)
        if not Path(path).is_file() or spec is None or spec.loader is None:
            raise ValueError(f"`{name}`: expected a Python file before the colon, found none")
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        if not hasattr(module, attribute):
            raise ValueError(f"`{name}`: expected the name of a policy in {path}, found no {attribute!r}")
        return getattr(module, attribute)
    # FILE@ENV says in which environment a model was trained.
    file = Path(name if Path(name).exists() else name.rpartition("@")[0])
    if str(file) == "." or not file.exists():
        raise ValueError(
            f"`{name}`: expected certified, {', '.join(ALGORITHMS)}, random, idle, FILE.py:NAME or an existing file: "
            ".npz (actor or certificate), .zip (Stable-Baselines3), .onnx, .pt, followed by @ENV "
            "where it was trained in another environment than it says"
        )
    if file.suffix != ".npz":
        if trust and file.suffix in RUN:
            print(f"certigym: `{file}` may run code that is in it as it is read (--trust)", file=sys.stderr)
        return as_policy(name, problem, trust=trust)
    try:
        return load_actor(name, problem)
    except NotAnActor:  # an actor that does not fit the problem is refused above; any other file is a certificate
        return load_certificate(name)
