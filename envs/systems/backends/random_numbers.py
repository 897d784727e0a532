"""Random numbers that are made where they are used."""

from __future__ import annotations

import importlib
from typing import Any, Protocol

import numpy as np

from .libraries import Array, is_host, namespace


class Numbers(Protocol):
    """Source of random numbers in double precision, as `numpy.random.Generator` is one."""

    def standard_normal(self, size: tuple[int, ...], /) -> Array:
        """Return standard normal numbers."""

    def random(self, size: tuple[int, ...], /) -> Array:
        """Return numbers uniform on [0, 1)."""


def numbers_beside(reference: Array, seed: int | None) -> Numbers:
    """Return a source of random numbers that live beside an array; without a seed it begins anywhere."""
    seed = int(np.random.SeedSequence(seed).generate_state(1)[0])
    if is_host(reference):
        return np.random.default_rng(seed)
    library = namespace(reference).__name__
    if "torch" in library:
        return _Torch(reference.device, seed)
    if "jax" in library:
        return _Jax(seed)
    found: Numbers = importlib.import_module("cupy").random.default_rng(seed)
    return found


class _Torch:
    def __init__(self, device: Any, seed: int) -> None:
        self.torch = importlib.import_module("torch")
        self.options: dict[str, Any] = {"dtype": self.torch.float64, "device": device}
        self.options["generator"] = self.torch.Generator(device=device).manual_seed(seed)

    def standard_normal(self, size: tuple[int, ...], /) -> Array:
        return self.torch.randn(size, **self.options)

    def random(self, size: tuple[int, ...], /) -> Array:
        return self.torch.rand(size, **self.options)


class _Jax:
    def __init__(self, seed: int) -> None:
        self.source = importlib.import_module("jax.random")
        self.key = self.source.key(seed)

    def _next(self) -> Any:
        self.key, key = self.source.split(self.key)
        return key

    def standard_normal(self, size: tuple[int, ...], /) -> Array:
        return self.source.normal(self._next(), size, dtype=np.float64)

    def random(self, size: tuple[int, ...], /) -> Array:
        return self.source.uniform(self._next(), size, dtype=np.float64)
