"""Registration of the suite with PettingZoo and Gymnasium, at the import of `certigym`.

Afterwards `pettingzoo.make("parallel", "certigym/reach-avoid-v0")`, `pettingzoo.make("aec", ...)`,
`gymnasium.make("certigym/ReachAvoid-v0")` and `gymnasium.make_vec` work. Both libraries know a problem by both names,
since the one has ids in small letters and the other in capitals. Entry points are strings, so no environment is loaded
before it is made.
"""

from __future__ import annotations

import gymnasium
from pettingzoo import aec_registry, parallel_registry, register

from .ids import IDS, NAMESPACE, gymnasium_id


def register_suite() -> None:
    """Register every suite problem that is not registered yet."""
    for id in IDS:
        for name in (f"{NAMESPACE}/{id}", gymnasium_id(id)):
            _register(name, id)


def _register(name: str, id: str) -> None:
    """Register one suite problem under one of its two names, with both libraries."""
    if name not in parallel_registry:
        register("parallel", name, "certigym.envs.suite.constructors:parallel_env", kwargs={"problem": id})
    if name not in aec_registry:
        register("aec", name, "certigym.envs.suite.constructors:aec_env", kwargs={"problem": id})
    if name not in gymnasium.registry:
        gymnasium.register(
            name,
            entry_point="certigym.envs.suite.constructors:central_env",
            vector_entry_point="certigym.envs.suite.constructors:vector_env",
            kwargs={"problem": id},
        )
