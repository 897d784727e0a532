"""Linear deviations along a path and how far the true ones drift from them: both from products of closed loops.

With ``Phi(t, s) = F_(t-1) ... F_s`` the linear deviation is ``g_t = sum_s Phi(t, s+1) w_s``, and the true deviation
adds ``sum_s Phi(t, s+1) r_s + Phi(t, 0) e_0`` with ``|r_s - m_s| <= R_s`` and ``|e_0| <= h``. So a row c of it is
shifted by ``sum_s c Phi(t, s+1) m_s``, and no farther from there than ``sum_s |c Phi(t, s+1)| R_s + |c Phi(t, 0)| h``:
a support function of the whole past. Nothing is handed on as a box from step to step.

Products are computed one after the other. That of times s to t is off by a sum of true products from j + 1 to t times
the rounding at j, so that Frobenius norms of true products bound it, and these by induction.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field

import numpy as np

from ..cells import FloatArray
from ..masses import state
from .roundings import SMALLEST, TAIL, UNIT

FACTORS = (1.0, 0.85, 0.7, 0.55, 0.4, 0.25)
"""Factors of exponential moments that are tried, as shares of the best one of noise that does not vary."""


@dataclass(frozen=True, eq=False)
class Tilted:
    """Squares of deviations of a step's noise, component by component: at most ``squares + tilts @ g`` on the tube.

    ``squares`` (d,), ``tilts`` (d, d), and upper bounds ``sizes`` (d,) on the components of the linear deviation g.
    """

    squares: FloatArray
    tilts: FloatArray
    sizes: FloatArray


@dataclass(eq=False)
class Chain:
    """Products of closed loops up to now, with what entered at each step.

    All arrays are in ``units`` (d,) of the states, powers of two near the widths of their ranges: norms take states
    together, and in units of their own what a large one is off by would be charged to a small one.
    """

    units: FloatArray
    spread: FloatArray
    """Half widths (d,) of the set of starts."""

    products: FloatArray = field(init=False)
    """``Phi(t, s)`` (t + 1, d, d) for s = 0 .. t, as computed."""

    norms: FloatArray = field(init=False)
    """Upper bounds (t + 1,) on their true norms."""

    errors: FloatArray = field(init=False)
    """Upper bounds (t + 1,) on the norms of the differences."""

    rounded: list[FloatArray] = field(default_factory=list)
    """Bounds (t + 1,) on what the product at each time t, for s = 0 .. t, was rounded by."""

    middles: list[FloatArray] = field(default_factory=list)
    drifts: list[FloatArray] = field(default_factory=list)
    noises: list[FloatArray] = field(default_factory=list)
    loops: list[FloatArray] = field(default_factory=list)
    tilted: list[Tilted] = field(default_factory=list)
    """Of each step whose noise varies, what its squares are below."""

    def __post_init__(self) -> None:
        d = len(self.units)
        self.products, self.errors = np.eye(d)[None], np.zeros(1)
        self.norms = np.full(1, np.sqrt(d) * TAIL)
        self.spread = self.spread / self.units

    def advance(
        self, closed: FloatArray, middle: FloatArray, drift: FloatArray, noise: FloatArray, tilted: Tilted | None = None
    ) -> None:
        """Go on by a step: the closed loop (d, d), the remainder, the covariance (d, d) of the noise.

        The remainder is within ``drift`` (d,) of ``middle`` (d,). ``tilted`` says more of noise that varies.
        """
        u = self.units
        F, d = closed * (u[None, :] / u[:, None]), len(u)
        sizes = _norms(self.products)
        self.rounded.append((d + 2.0) * UNIT * _norms(F[None])[0] * sizes)
        self.products = np.concatenate([np.einsum("ij,sjk->sik", F, self.products), np.eye(d)[None]])
        t = len(self.products) - 1
        computed = _norms(self.products)
        self.errors, self.norms = np.zeros(t + 1), np.full(t + 1, np.sqrt(d) * TAIL)
        for s in range(t - 1, -1, -1):
            # What was rounded at times j = s .. t - 1 is carried on by the true products from j + 1 on.
            lost = np.array([self.rounded[j][s] for j in range(s, t)])
            self.errors[s] = float(self.norms[s + 1 :] @ lost) * TAIL
            self.norms[s] = computed[s] + self.errors[s]
        self.middles.append(middle / u)
        self.drifts.append(drift / u)
        self.noises.append(noise / u[:, None] / u[None, :])
        self.loops.append(F)
        if tilted is not None:
            squares, tilts = tilted.squares / u**2, tilted.tilts * (u[None, :] / u[:, None] ** 2)
            self.tilted.append(Tilted(squares, tilts, tilted.sizes / u))

    def as_it_is(self) -> Chain:
        """Return a copy that stays as it is when this one goes on: arrays are never changed, lists grow."""
        result = copy(self)
        for name in ("rounded", "middles", "drifts", "noises", "loops", "tilted"):
            setattr(result, name, [*getattr(self, name)])
        return result

    def drift(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What rows (J, d) of the deviation are off those of the linear one: shifts (J,), and upper bounds around them.

        What shifts are rounded by is in the bounds.
        """
        rows = rows * self.units
        lengths = np.linalg.norm(rows, axis=1) * TAIL
        moved, wrong = self._moved(rows, lengths)
        total = np.abs(moved[:, 0]) @ self.spread + wrong[:, 0] * float(np.linalg.norm(self.spread))
        shift = np.zeros(len(rows))
        if self.drifts:
            drifts, middles = np.array(self.drifts), np.array(self.middles)
            total = total + np.sum(np.abs(moved[:, 1:]) * drifts, axis=(1, 2))
            total = total + wrong[:, 1:] @ (np.linalg.norm(drifts, axis=1) + np.linalg.norm(middles, axis=1))
            shift = np.sum(moved[:, 1:] * middles, axis=(1, 2))
            size = np.sum(np.abs(moved[:, 1:]) * np.abs(middles), axis=(1, 2))
            total = total + (middles.size + 8.0) * UNIT * size
        return shift, np.asarray(total * TAIL)

    def variances(self, rows: FloatArray) -> FloatArray:
        """Upper bounds (J,) on the variances of rows (J, d) of the linear deviation."""
        return self.spreads(rows)[0]

    def spreads(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Upper bounds (J,) on the variances of rows (J, d) of the linear deviation, and on what one step adds."""
        # Squares of tiny rows underflow; a variance of 0 would say that nothing can happen.
        least = np.where(np.any(rows != 0.0, axis=1), SMALLEST, 0.0)
        rows = rows * self.units
        lengths, d = np.linalg.norm(rows, axis=1) * TAIL, len(self.units)
        moved, wrong = self._moved(rows, lengths)
        if not self.noises:
            return np.zeros(len(rows)), np.zeros(len(rows))
        noises, parts = np.array(self.noises), moved[:, 1:].swapaxes(0, 1)
        sizes = np.sqrt(np.einsum("sij,sij->s", noises, noises)) * TAIL
        # One sum over states, then one over times: what is added rounds d and then t times.
        each = np.sum(np.matmul(parts, noises) * parts, axis=2)
        total = np.sum(each, axis=0)
        length, off = np.sqrt(np.sum(parts**2, axis=2)) * TAIL, wrong[:, 1:].T
        error = 2.0 * length * off + off**2 + (2.0 * d + len(noises) + 4.0) * UNIT * length**2
        variance = np.asarray(np.maximum(total, 0.0) + (sizes @ error) * TAIL) + least
        return variance, np.max(np.maximum(each, 0.0) + sizes[:, None] * error * TAIL, axis=0) + least

    def exponential_tails(self, rows: FloatArray, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Upper bounds (J,) on the probabilities that rows (J, d) are the first below ``-low`` or above ``high``.

        By exponential moments of noise that varies (docs/theory/paths.md, "Noise that varies much"); 1 where nothing is
        known.
        """
        ends = np.concatenate([low, high])
        if len(self.tilted) < len(self.noises) or not self.noises:
            return np.ones(len(low)), np.ones(len(high))
        forms = np.concatenate([-rows, rows]) * self.units
        moved, _ = self._moved(np.concatenate([-rows, rows]) * self.units, np.zeros(len(ends)))
        squares = np.array([step.squares for step in self.tilted])
        variance = np.einsum("jsd,sd->j", moved[:, 1:] ** 2, squares)
        asked = (ends > 0.0) & np.isfinite(ends) & (variance > 0.0)
        tail = np.where(ends == np.inf, 0.0, 1.0)
        if not asked.any():
            return tail[: len(low)], tail[len(low) :]
        # Any positive factors will do: these are near the best one, which is a little below the first.
        factors = np.array(FACTORS)[:, None] * (ends[asked] / variance[asked])
        exponent = self._log_moments(factors[..., None] * forms[asked]) - factors * ends[asked] * (1.0 - 8.0 * UNIT)
        least = np.min(np.where(np.isnan(exponent), np.inf, exponent), axis=0)
        z = np.sqrt(np.maximum(-least, 0.0)) * (1.0 - 4.0 * UNIT)
        tail[asked] = np.where(
            z > 0.0, np.minimum(1.0, np.exp(-np.square(z) * (1.0 - 4.0 * UNIT)) * TAIL + SMALLEST), 1.0
        )
        state("light", z, tail[asked])
        return tail[: len(low)], tail[len(low) :]

    def _log_moments(self, theta: FloatArray) -> FloatArray:
        """Upper bounds (..) on logarithms of means of ``exp(theta . g)``, for rows (.., d), stopped at a failure."""
        d = theta.shape[-1]
        total, lost = np.zeros(theta.shape[:-1]), np.zeros(theta.shape[:-1])
        with np.errstate(all="ignore"):
            for F, step in zip(reversed(self.loops), reversed(self.tilted), strict=True):
                square = theta**2
                total += 0.5 * (square @ step.squares)
                # What this row and the next one are rounded by counts with the largest deviation there may be.
                size = np.abs(theta) @ np.abs(F) + 0.5 * (square @ np.abs(step.tilts))
                theta = theta @ F + 0.5 * (square @ step.tilts)
                lost += (2.0 * d + 12.0) * UNIT * (size @ step.sizes)
        return np.asarray(total * (1.0 + (4.0 * d + 8.0) * (len(self.loops) + 4.0) * UNIT) + lost * TAIL)

    def covariance(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Covariance (J, J) of rows (J, d) of the linear deviation as computed, and bounds (J, J) on what it is off."""
        rows = rows * self.units
        moved, wrong = self._moved(rows, np.linalg.norm(rows, axis=1) * TAIL)
        count, d = len(rows), len(self.units)
        total, error = np.zeros((2, count, count))
        for s, noise in enumerate(self.noises):
            part, off = moved[:, s + 1], wrong[:, s + 1]
            size, length = float(np.linalg.norm(noise)) * TAIL, np.linalg.norm(part, axis=1) * TAIL
            total += part @ noise @ part.T
            lengths = np.outer(length, length)
            rounded = (2.0 * d + len(self.noises) + 4.0) * UNIT * lengths
            error += size * (np.outer(length, off) + np.outer(off, length) + np.outer(off, off) + rounded) * TAIL
        return 0.5 * (total + total.T), (0.5 * (error + error.T) + UNIT * np.abs(total)) * TAIL + SMALLEST

    def by_sources(self, rows: FloatArray, factors: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what each number of shared noise adds to rows (J, d) of the linear deviation, and what it is off.

        Parameters
        ----------
        rows : (J, d) array
        factors : (d, K) array
            What one number of each source adds to the states, at every step.

        Returns
        -------
        (J, t K) array, and upper bounds (J,) on the Euclidean lengths of the differences from the true rows.
        """
        rows, factors = rows * self.units, factors / self.units[:, None]
        moved, wrong = self._moved(rows, np.linalg.norm(rows, axis=1) * TAIL)
        size, d = float(np.linalg.norm(factors)) * TAIL, len(self.units)
        each = moved[:, 1:] @ factors
        off = size * (wrong[:, 1:] + (d + 2.0) * UNIT * np.linalg.norm(moved[:, 1:], axis=2) * TAIL)
        return each.reshape(len(rows), -1), np.linalg.norm(off, axis=1) * TAIL

    def _moved(self, rows: FloatArray, lengths: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows times products (J, t + 1, d) as computed, and bounds (J, t + 1) on the lengths of what they are off."""
        moved = np.einsum("jd,sde->jse", rows, self.products)
        wrong = lengths[:, None] * (self.errors + (len(self.units) + 2.0) * UNIT * self.norms)[None]
        return moved, wrong * TAIL


def _norms(matrices: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.einsum("sij,sij->s", matrices, matrices)) * TAIL)
