"""Registration of the suite with PettingZoo, done when `certigym` is imported.

`pettingzoo.make("parallel", "certigym/reach-avoid-v0")` and `pettingzoo.make("aec", ...)` then work. Entry points are
texts: no environment is loaded before it is made.
"""

from __future__ import annotations

from pettingzoo import aec_registry, parallel_registry, register

from .suite_ids import MODULES, NAMESPACE


def register_suite() -> None:
    """Register every suite problem that is not registered yet."""
    for id, module in MODULES.items():
        name = f"{NAMESPACE}/{id}"
        if name not in parallel_registry:
            register("parallel", name, f"certigym.envs.{module}:parallel_env")
        if name not in aec_registry:
            register("aec", name, f"certigym.envs.{module}:env")
