"""Certificates along a path as entries of a file: numbers are put into a pool of arrays, and read with suspicion."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.arrays import is_whole
from ...envs.problem import Problem, problem_from_dict
from .path_certificate import AgentPath, PathCertificate


def path_in(header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> PathCertificate:
    """Return the certificate along a path that a header and its arrays describe; raise ValueError if they do not."""
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    failure, entry = header["failure"], header["path"]
    if isinstance(failure, bool) or not isinstance(failure, int | float) or not 0.0 <= failure <= 1.0:
        raise ValueError("its probability of failing is none")
    if not isinstance(header["settings"], dict) or len(entry["agents"]) != problem.n_agents:
        raise ValueError("its settings or its agents are not those of a path")
    letters, faces = (np.asarray(arrays[str(int(entry[name]))]) for name in ("letters", "faces"))
    if (
        not (is_whole(letters, signed=True) and is_whole(faces, signed=True))
        or letters.ndim != 2
        or letters.shape != faces.shape
    ):
        raise ValueError("its letters are no whole numbers")
    if not 2 <= len(letters) <= problem.horizon + 1:
        raise ValueError("its path does not fit the horizon")
    paths = []
    for agent, numbers in zip(problem.agents, entry["agents"], strict=True):
        steps, d, m = len(letters) - 1, agent.n_states, agent.n_inputs
        shapes = [(steps, m), (m, d)] if len(numbers) == 2 else [(steps, m), (steps, m, d)]
        shapes += [] if len(numbers) == 2 else [(steps + 1, d), (steps + 1, 2 * d + m)]
        stored = [np.asarray(arrays[str(int(number))], dtype=float) for number in numbers]
        if [array.shape for array in stored] != shapes or not all(np.all(np.isfinite(array)) for array in stored[:3]):
            raise ValueError(f"the inputs of agent {agent.name!r} do not fit")
        if len(numbers) == 4 and not np.all(stored[3] >= 0.0):
            raise ValueError(f"the slabs of agent {agent.name!r} are none")
        paths.append(AgentPath(*stored))
    normals = _normals(problem, entry, arrays, len(letters))
    return PathCertificate(problem, tuple(paths), letters, faces, float(failure), header["settings"], normals)


def _normals(
    problem: Problem, entry: dict[str, Any], arrays: dict[str, NDArray[Any]], times: int
) -> NDArray[np.float64] | None:
    """Return the directions of pairs (S + 1, sum of p); None for tasks that are about none."""
    pairs = problem.labeling.pairs
    if ("normals" in entry) != bool(pairs):
        raise ValueError("it has directions of pairs and its problem has no pairs, or the other way round")
    if not pairs:
        return None
    normals = np.asarray(arrays[str(int(entry["normals"]))], dtype=float)
    if normals.shape != (times, sum(pair.size for pair in pairs)) or not np.all(np.isfinite(normals)):
        raise ValueError("its directions of pairs do not fit")
    return normals
