"""Convex sets of starts as entries of a file: numbers are put into a pool of arrays, and read with suspicion."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.arrays import is_whole
from ...envs.problem import problem_from_dict
from .start_hull import StartHull


def hull_in(header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> StartHull:
    """Return the set of starts that a header and its arrays describe; raise ValueError if they do not."""
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    failure, entry = header["failure"], header["hull"]
    if isinstance(failure, bool) or not isinstance(failure, int | float) or not 0.0 <= failure <= 1.0:
        raise ValueError("its probability of failing is none")
    if problem.n_agents != 1:
        raise ValueError("a set of starts is about one agent")
    agent = problem.agents[0]
    letters, faces = (np.asarray(arrays[str(int(entry[name]))]) for name in ("letters", "faces"))
    if (
        not (is_whole(letters, signed=True) and is_whole(faces, signed=True))
        or letters.ndim != 2
        or letters.shape != faces.shape
    ):
        raise ValueError("its letters are no whole numbers")
    if not 2 <= len(letters) <= problem.horizon + 1:
        raise ValueError("its paths do not fit the horizon")
    corners, inputs, gain = (
        np.asarray(arrays[str(int(entry[name]))], dtype=float) for name in ("corners", "inputs", "gain")
    )
    n = len(corners)
    wanted = (n, agent.n_states), (n, len(letters) - 1, agent.n_inputs), (agent.n_inputs, agent.n_states)
    if (corners.shape, inputs.shape, gain.shape) != wanted or n == 0:
        raise ValueError("its corners and inputs do not fit")
    if not all(np.all(np.isfinite(array)) for array in (corners, inputs, gain)):
        raise ValueError("its corners or inputs are no numbers")
    axes = tuple(int(axis) for axis in entry["axes"])
    return StartHull(problem, axes, corners, inputs, gain, letters, faces, float(failure))
