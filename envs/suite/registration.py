"""Registration of the suite with PettingZoo and Gymnasium, at the import of `certigym`.

Afterwards `pettingzoo.make("parallel", "certigym/reach-avoid-v0")`, `pettingzoo.make("aec", ...)`,
`gymnasium.make("certigym/ReachAvoid-v0")` and `gymnasium.make_vec` work. Entry points are strings, so no environment is
loaded before it is made.
"""

from __future__ import annotations

import gymnasium
from pettingzoo import aec_registry, parallel_registry, register

from .ids import MODULES, NAMESPACE, gymnasium_id


def register_suite() -> None:
    """Register every suite problem that is not registered yet."""
    for id, module in MODULES.items():
        name = f"{NAMESPACE}/{id}"
        if name not in parallel_registry:
            register("parallel", name, f"certigym.envs.suite.{module}:parallel_env")
        if name not in aec_registry:
            register("aec", name, f"certigym.envs.suite.{module}:env")
        if gymnasium_id(id) not in gymnasium.registry:
            gymnasium.register(
                gymnasium_id(id),
                entry_point="certigym.envs.suite.make:central_env",
                vector_entry_point="certigym.envs.suite.make:vector_env",
                kwargs={"problem": id},
            )
