"""What is asked of an agent at one time of a nonlinear path: workspace, tube, and regions that hold or do not."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...envs.agents import Proposition
from ..cells import FloatArray
from ..certificates import SOMETIME, AlongPath
from .crossings import add_jumps, limits_of
from .gaussian_inequalities import Inequalities, shortened
from .moment import Moment, of_copies
from .moving import NothingKnownError
from .own_angles import axes_of_angles
from .own_regions import RegionSpan
from .roundings import UNIT


def add_limits(now: Moment, certificate: AlongPath, rows: Inequalities) -> None:
    """Add the inequalities on the state: workspace, tube, and regions that are to hold or not."""
    eye = np.eye(len(now.at))
    # Nothing leaves its workspace by turning.
    ends = np.where(axes_of_angles(now.agent) > 0.0, np.inf, 0.0)
    lowest, highest = now.agent.state_low - ends, now.agent.state_high + ends
    # Row, nominal value from below and above, limits, what the form is off, and its slab.
    asked = [(eye[k], now.at[k], now.at[k], lowest[k], highest[k], 0.0, now.slab[k]) for k in range(len(now.at))]
    asked += [(*form, np.inf) for form in _regions(now, certificate)]
    # Forms of one row are one: the narrowest limits say all.
    merged: dict[bytes, list[float]] = {}
    order = []
    for row, least, most, low, high, off, slab in asked:
        rounded = 4.0 * UNIT * (abs(least) + abs(most))
        # A lower limit that is infinite above is one that nothing keeps.
        below = least - low - off - rounded - (4.0 * UNIT * abs(low) if np.isfinite(low) else 0.0)
        above = high - most - off - rounded - (4.0 * UNIT * abs(high) if np.isfinite(high) else 0.0)
        # What is no number keeps nothing, and would be lost among numbers.
        below, above = (-np.inf if np.isnan(distance) else distance for distance in (below, above))
        key = (row + 0.0).tobytes()
        if key not in merged:
            order.append(row)
            merged[key] = [below, above, slab]
        merged[key] = [min(a, b) for a, b in zip(merged[key], (below, above, slab), strict=True)]
    forms, ends = np.array(order), np.array(list(merged.values()))
    below, above = shortened(ends[:, 0], ends[:, 1], *now.chain.drift(forms))
    slab = ends[:, 2]
    bounds = now.chain.exponential_tails(forms, np.minimum(below, slab), np.minimum(above, slab))
    rows.add(below, above, slab, *now.chain.spreads(forms), bounds=bounds)
    add_jumps(now, certificate, rows)


def _regions(now: Moment, certificate: AlongPath) -> Iterator[tuple[FloatArray, float, float, float, float, float]]:
    """Yield row, nominal value from below and above, both limits, and the remainder, of forms of regions."""
    problem = certificate.problem
    for p, name in enumerate(problem.automaton.propositions):
        value = int(certificate.proof.letters[now.t, p])
        if value == 0 or p >= problem.labeling.first_pair:
            continue
        proposition = problem.propositions[name]
        if proposition.agent != now.agent.name:
            continue
        # Where it is at this time, the corners on the side on which less is claimed.
        assert isinstance(proposition, Proposition)
        region = RegionSpan.of(proposition, now.t)
        faces = range(region.low.shape[1])
        limits = [(k, float(region.low[1, k]), float(region.high[0, k])) for k in faces]
        limits = [of_copies(now, *limit, holds=True) for limit in limits]
        if value == SOMETIME:
            limits = limits_of(certificate.proof, now.t, p, limits)
        if value < 0:
            limits = [(k, float(region.low[0, k]), float(region.high[1, k])) for k in faces]
            face = int(certificate.proof.faces[now.t, p])
            if not 0 <= face < 2 * len(limits):
                raise NothingKnownError(f"region `{name}` is passed on no side at step {now.t}")
            k, low, high = limits[face // 2]
            is_angle = k in now.agent.angle_outputs
            limits = [(k, high, np.inf) if face % 2 else (k, -np.inf, low)]
            limits = [of_copies(now, k, low, high, holds=False)] if is_angle else limits
        found = now.outputs
        for k, low, high in limits:
            yield found.matrix[k], found.values[0, k], found.values[1, k], low, high, float(found.off[k])
