"""Agents, propositions, task automata, problems and the environments that step them.

The problems of the suite can be imported from here as modules, as in other environment packages:
``from certigym.envs import reach_avoid_v0``.
"""

from typing import Any

from .suite.ids import MODULES

if __name__ == "envs":
    raise ImportError("import `certigym.envs`, not `envs`: this folder is a part of the package certigym")


def __getattr__(name: str) -> Any:
    ids = [id for id, module in MODULES.items() if module == name]
    if not ids:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .suite import module_of

    module = globals()[name] = module_of(ids[0])
    return module


def __dir__() -> list[str]:
    return sorted({*globals(), *MODULES.values()})
