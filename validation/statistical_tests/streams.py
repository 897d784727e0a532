"""Random numbers of several chunks side by side: each comes from the generator of its chunk."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Streams:
    """The generators of some chunks as one source of draws, for those of their worlds that are left.

    Every generator draws for all worlds of its chunk, as if the chunk were simulated alone. A generator whose worlds
    have all left draws no more.

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
        """The generators, made when first needed: most policies make no draws, and making a generator takes time."""
        return tuple(np.random.default_rng(seed) for seed in self._seeds)

    def keep(self, which: NDArray[Any]) -> None:
        """Draw from now on for the worlds ``which`` alone, (k,) increasing numbers over the worlds of all chunks."""
        self._which, self._left = which, None

    def _in_chunks(self) -> list[NDArray[Any] | None]:
        """Return the worlds of each chunk that are left, by their numbers in the chunk; None for all of them."""
        if self._left is None:
            assert self._which is not None
            # The numbers increase, so each chunk has a range of them; count from the chunk's first world.
            firsts = self._size * np.arange(len(self._seeds) + 1)
            ends = np.searchsorted(self._which, firsts).tolist()
            self._left = [
                None if last - first == self._size else self._which[first:last] - zero
                for zero, first, last in zip(firsts.tolist(), ends, ends[1:], strict=False)
            ]
        return self._left

    def standard_normal(self, shape: tuple[int, ...], /) -> NDArray[Any]:
        """Return standard normal numbers (.., M) for the M worlds that are left."""
        return self._side_by_side("standard_normal", shape)

    def random(self, shape: tuple[int, ...], /) -> NDArray[Any]:
        """Return uniform numbers (.., M) from [0, 1) for the M worlds that are left."""
        return self._side_by_side("random", shape)

    def _side_by_side(self, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return the draws of one distribution, of all chunks with worlds left."""
        draws = []
        for rng, left in zip(self.rngs, self._in_chunks(), strict=True):
            if left is None or len(left):
                drawn = getattr(rng, name)((*shape[:-1], self._size))
                draws.append(drawn if left is None else drawn.take(left, axis=-1))
        return draws[0] if len(draws) == 1 else np.concatenate(draws, axis=-1)
