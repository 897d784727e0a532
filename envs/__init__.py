"""Agents, propositions, task automata, problems and the environments that step them.

The modules of the suite can be imported from here, as in other environment packages:
``from certigym.envs import reach_avoid_v0``.
"""

from importlib import import_module
from typing import Any

from .suite.ids import MODULES

if __name__ == "envs":
    raise ImportError("import `certigym.envs`, not `envs`: this folder is a part of the package certigym")


def __getattr__(name: str) -> Any:
    if name in MODULES.values():
        return import_module(f".suite.{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *MODULES.values()})
