"""Tails of linear deviations whose noise varies with them, by exponential moments, for many candidates at once.

The square of a scale that depends on the state is below a linear function of the linear deviation g on the tube, and
with that ``exp(theta . g)`` has a mean of which the logarithm is found backwards, row by row: its mean times
``exp(-theta . g)`` is a supermartingale until a row fails. The search goes by it; the checker counts the largest scale.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...relations.grids import FloatArray
from .limit_rows import Worth

FACTORS = (1.0, 0.8, 0.6, 0.4)
"""Factors of moments that are tried, as shares of the best one of noise that does not vary."""

NEGLIGIBLE = 1e-13
"""Tails below which no other bounds are looked for."""


@dataclass(eq=False)
class ExponentialMoments:
    """What is known of N candidates: closed loops, squares and tilts of each step; and rows that are asked for."""

    n: int
    d: int
    covariance: FloatArray = field(init=False)
    """Covariances (N, d, d) with the squares, without what tilts add."""

    loops: list[FloatArray] = field(default_factory=list)
    squares: list[FloatArray] = field(default_factory=list)
    tilts: list[FloatArray] = field(default_factory=list)
    asked: list[tuple[int, int, FloatArray, FloatArray]] = field(default_factory=list)
    """Numbers of rows of the worth, times, forms (N, J, d) and variances (N, J)."""

    def __post_init__(self) -> None:
        self.covariance = np.zeros((self.n, self.d, self.d))

    def variances(self, rows: FloatArray) -> FloatArray:
        """Return about the variances (N, J) of rows (J, d) or (N, J, d)."""
        return np.asarray(np.sum(np.matmul(rows, self.covariance) * rows, axis=-1))

    def ask(self, number: int, t: int, rows: FloatArray) -> None:
        """Ask for the tails of rows at a time, of which there are ``number`` parts before."""
        self.asked.append((number, t, np.broadcast_to(rows, (self.n, *rows.shape[-2:])), self.variances(rows)))

    def tilt(self, scale: tuple[FloatArray, ...], deviations: FloatArray, largest: FloatArray) -> None:
        """Note squares of a step: scales are b + a . g, up to an error (N, d), with ``|a . g|`` below a reach (N, d).

        ``largest`` (N, d) are those with the largest scales, which count where they are less.
        """
        b, off, reach, a = scale
        squares = (b**2 + reach**2 + 2.0 * off * (np.abs(b) + reach) + off**2) * deviations**2
        is_less = squares < largest
        self.squares.append(np.where(is_less, squares, largest))
        self.tilts.append(np.where(is_less[..., None], (2.0 * b * deviations**2)[..., None] * a, 0.0))

    def advance(self, closed: FloatArray) -> None:
        """Go on by a step with closed loops (N, d, d)."""
        self.loops.append(closed)
        moved = np.matmul(np.matmul(closed, self.covariance), closed.swapaxes(1, 2))
        self.covariance = np.clip(moved, -1e60, 1e60) + self.squares[-1][..., None] * np.eye(self.d)

    def bound(self, worth: Worth, which: np.ndarray) -> None:
        """Set further bounds on the tails of rows of some candidates, bool (N,)."""
        here, asked = np.flatnonzero(which), [one for one in self.asked if one[1]]
        if not len(here) or not asked:
            return
        times = np.concatenate([np.full(forms.shape[1], t) for _, t, forms, _ in asked])
        forms = np.concatenate([forms[here] for _, _, forms, _ in asked], axis=1)
        variance = np.concatenate([known[here] for *_, known in asked], axis=1)
        found = []
        for sign, sides in ((-1.0, worth.low), (1.0, worth.high)):
            ends = np.concatenate([np.minimum(sides[k], worth.strip[k])[here] for k, *_ in asked], axis=1)
            found.append(self._tails(here, times, sign * forms, ends, variance))
        first = 0
        for k, _, rows, _ in asked:
            part = slice(first, first := first + rows.shape[1])
            for kept, tail in zip((worth.below, worth.above), found, strict=True):
                kept[k] = kept[k].copy()
                kept[k][here] = tail[:, part]

    def _tails(
        self, here: np.ndarray, times: np.ndarray, forms: FloatArray, ends: FloatArray, variance: FloatArray
    ) -> FloatArray:
        """Return bounds (N, R) on the probabilities that forms (N, R, d) at times (R,) exceed ends (N, R)."""
        with np.errstate(all="ignore"):
            usable = (ends > 0.0) & np.isfinite(ends) & (variance > 0.0)
            # Rows of small tails are as good as they have to be.
            rows = np.flatnonzero(np.any(usable & (ends**2 < -2.0 * np.log(NEGLIGIBLE) * 4.0 * variance), axis=0))
            result = np.where(ends == np.inf, 0.0, np.full(ends.shape, np.inf))
            at = times[rows]
            best = np.where(usable, ends / variance, np.nan)[:, rows]
            factors = np.array(FACTORS)[:, None, None] * best
            theta, total = factors[..., None] * forms[:, rows], np.zeros(factors.shape)
            for s in range(len(self.loops) - 1, -1, -1):
                active = slice(int(np.searchsorted(at, s + 1)), None)
                now = theta[:, :, active]
                square = now**2
                total[:, :, active] += 0.5 * np.einsum("lnrk,nk->lnr", square, self.squares[s][here])
                tilted = np.matmul(square, self.tilts[s][here])
                theta[:, :, active] = np.matmul(now, self.loops[s][here]) + 0.5 * tilted
            exponent = np.min(np.nan_to_num(total - factors * ends[:, rows], nan=np.inf), axis=0)
            result[:, rows] = np.where(exponent < 0.0, np.exp(exponent), np.inf)
        return np.asarray(result)
