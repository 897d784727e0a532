"""Random numbers of several chunks side by side: each from its chunk's own generator, whatever else is simulated."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Streams:
    """The generators of some chunks as one source of draws, for the worlds that are left.

    Every generator draws for all worlds of its chunk, as it would alone; one whose worlds have all left draws no more.

    Parameters
    ----------
    seeds : sequence of numpy.random.SeedSequence
        One per chunk.
    size : int
        Worlds per chunk.
    """

    def __init__(self, seeds: Sequence[np.random.SeedSequence], size: int) -> None:
        self._seeds, self._size = tuple(seeds), size
        self._which: NDArray[Any] | None = None
        self._left: list[NDArray[Any] | None] | None = [None] * len(seeds)

    @cached_property
    def rngs(self) -> tuple[np.random.Generator, ...]:
        """The generators, made when they are first needed."""
        return tuple(np.random.default_rng(seed) for seed in self._seeds)

    def keep(self, which: NDArray[Any]) -> None:
        """From now on draws are for the worlds ``which`` alone, (k,) increasing numbers of the worlds of all chunks."""
        self._which, self._left = which, None

    def _in_chunks(self) -> list[NDArray[Any] | None]:
        """The worlds that are left of each chunk, by their numbers in it; None for all."""
        if self._left is None:
            assert self._which is not None
            firsts = self._size * np.arange(len(self._seeds) + 1)
            ends = np.searchsorted(self._which, firsts).tolist()
            self._left = [
                None if last - first == self._size else self._which[first:last] - zero
                for zero, first, last in zip(firsts.tolist(), ends, ends[1:], strict=False)
            ]
        return self._left

    def standard_normal(self, shape: tuple[int, ...], /) -> NDArray[Any]:
        """Standard normal numbers (.., M) for the M worlds that are left."""
        return self._side_by_side("standard_normal", shape)

    def random(self, shape: tuple[int, ...], /) -> NDArray[Any]:
        """Uniform numbers (.., M) for the M worlds that are left."""
        return self._side_by_side("random", shape)

    def _side_by_side(self, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
        parts = []
        for rng, left in zip(self.rngs, self._in_chunks(), strict=True):
            if left is None or len(left):
                drawn = getattr(rng, name)((*shape[:-1], self._size))
                parts.append(drawn if left is None else drawn.take(left, axis=-1))
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)
