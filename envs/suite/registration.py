"""Registration of the suite with PettingZoo and Gymnasium, as soon as both `certigym` and one of them are imported.

Afterwards `pettingzoo.make("parallel", "certigym/reach-avoid-v0")`, `pettingzoo.make("aec", ...)`,
`gymnasium.make("certigym/ReachAvoid-v0")` and `gymnasium.make_vec` work. Both libraries know a problem by both names,
since the one has ids in small letters and the other in capitals. Entry points are strings, so no environment is loaded
before it is made; and neither library is loaded before something else loads it, so that `certigym check` is quick.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType

from .ids import CENTRAL_ENTRY, IDS, NAMESPACE, VECTOR_ENTRY, gymnasium_id


def register_suite() -> None:
    """Register every suite problem with the libraries that are loaded, and with others when they are."""
    for library, register in LIBRARIES.items():
        if library in sys.modules:
            register()
        elif not any(isinstance(own, _Later) and own.library == library for own in sys.meta_path):
            sys.meta_path.insert(0, _Later(library, register))


def _names() -> list[tuple[str, str]]:
    """Return the names under which problems are registered, two for each, and their ids."""
    return [(name, id) for id in IDS for name in (f"{NAMESPACE}/{id}", gymnasium_id(id))]


def _in_gymnasium() -> None:
    import gymnasium

    for name, id in _names():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point=CENTRAL_ENTRY,
                vector_entry_point=VECTOR_ENTRY,
                kwargs={"problem": id},
            )


def _in_pettingzoo() -> None:
    from pettingzoo import aec_registry, parallel_registry, register

    for name, id in _names():
        if name not in parallel_registry:
            register("parallel", name, "certigym.envs.suite.constructors:parallel_env", kwargs={"problem": id})
        if name not in aec_registry:
            register("aec", name, "certigym.envs.suite.constructors:aec_env", kwargs={"problem": id})


LIBRARIES: dict[str, Callable[[], None]] = {"gymnasium": _in_gymnasium, "pettingzoo": _in_pettingzoo}


class _Later:
    """Finder of a library that lets others find it, and registers the suite once it is loaded."""

    def __init__(self, library: str, register: Callable[[], None]) -> None:
        self.library, self.register, self.asking = library, register, False

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of the library, with a loader that registers the suite; nothing for others."""
        if name != self.library or self.asking:
            return None
        self.asking = True
        try:
            spec = importlib.util.find_spec(name)
        finally:
            self.asking = False
        if spec is not None and spec.loader is not None:
            load = spec.loader.exec_module

            def load_and_register(module: ModuleType) -> None:
                load(module)
                self.register()

            spec.loader.exec_module = load_and_register  # type: ignore[method-assign]
        return spec
