"""Soft costs of limits: a distance of z deviations from one costs ``-log Phi(z)``, with its derivatives."""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr

from ...relations.grids import FloatArray


def soft_costs(
    values: FloatArray,
    ends: tuple[FloatArray, FloatArray] | FloatArray,
    sharp: FloatArray,
    linearization_error: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return costs, slopes and second derivatives of values (S, k, n) between limits (S, k) or (k,)."""
    total, slope, bend = np.zeros(values.shape), np.zeros(values.shape), np.zeros(values.shape)
    for side, end in ((1.0, ends[0]), (-1.0, ends[1])):
        if not np.any(np.isfinite(end)):
            continue
        wide = np.broadcast_to(end, values.shape[:2])[:, :, None]
        with np.errstate(all="ignore"):
            z = (side * (values - wide) - linearization_error[:, :, None]) / sharp[:, :, None]
            z = np.where(np.isfinite(wide), np.clip(z, -1e6, 1e6), 1e6)
            log = log_ndtr(z)
            hazard = np.exp(np.minimum(-0.5 * z * z - 0.9189385332046727 - log, 700.0))
        hazard = np.where(z < -1e3, -z, hazard)
        total -= np.where(np.isnan(z), -np.inf, log)
        slope -= side * hazard / sharp[:, :, None]
        bend += np.maximum(hazard * (z + hazard), 0.0) / sharp[:, :, None] ** 2
    return total, slope, bend
