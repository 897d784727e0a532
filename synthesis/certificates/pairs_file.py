"""Certificates of tasks about pairs as entries of a file, in which the file of another certificate lies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...envs.problem import problem_from_dict
from .certificate import Certificate
from .mixed_certificate import MixedCertificate
from .pairs_certificate import PairsCertificate
from .path_certificate import PathCertificate
from .team_certificate import TeamCertificate
from .timed_certificate import TimedCertificate


def pairs_in(
    header: dict[str, Any], arrays: dict[str, NDArray[Any]], read: Callable[[bytes], Certificate]
) -> PairsCertificate:
    """Return the certificate that a header and its arrays describe; ``read`` reads the file of its base.

    Raises
    ------
    ValueError
        If they describe none.
    """
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    near = header["near"]
    if isinstance(near, bool) or not isinstance(near, int | float) or not 0.0 <= near <= 1.0:
        raise ValueError("its probability of being near is none")
    usual = header["usual"]
    if not isinstance(usual, list) or len(usual) != len(problem.labeling.pairs) or not {*usual} <= {True, False}:
        raise ValueError("what it takes its pairs to be does not fit the problem")
    base = read(arrays[str(int(header["without_pairs"]))].astype(np.uint8).tobytes())
    if not isinstance(header["settings"], dict) or not isinstance(base, Certificate):
        raise ValueError("its settings or its base are none")
    if len(base.agents) != problem.n_agents or base.problem.automaton.n_states != problem.automaton.n_states:
        raise ValueError("its base does not fit the problem")
    return PairsCertificate(problem, base, tuple(bool(value) for value in usual), float(near), header["settings"])


def mixed_in(
    header: dict[str, Any],
    arrays: dict[str, NDArray[Any]],
    read: Callable[[bytes], Certificate | PathCertificate | PairsCertificate],
) -> MixedCertificate:
    """Return the certificate of a mixed team that a header and its arrays describe; raise ValueError otherwise."""
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    near, usual = header["near"], header["usual"]
    if isinstance(near, bool) or not isinstance(near, int | float) or not 0.0 <= near <= 1.0:
        raise ValueError("its probability of being near is none")
    if not isinstance(usual, list) or len(usual) != len(problem.labeling.pairs) or not {*usual} <= {True, False}:
        raise ValueError("what it takes its pairs to be does not fit the problem")
    grids, paths = (read(arrays[str(int(number))].astype(np.uint8).tobytes()) for number in header["mixed"])
    if not isinstance(paths, PathCertificate) or isinstance(grids, PathCertificate):
        raise ValueError("its parts are not one on grids and one along paths")
    if not isinstance(header["settings"], dict):
        raise ValueError("its settings are none")
    values = tuple(bool(value) for value in usual)
    return MixedCertificate(problem, grids, paths, values, float(near), header["settings"])


def timed_in(
    header: dict[str, Any], arrays: dict[str, NDArray[Any]], read: Callable[[bytes], Certificate]
) -> TimedCertificate:
    """Return the certificate of a problem that names the time, from a header and arrays; raise ValueError otherwise."""
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    base = read(arrays[str(int(header["written_out"]))].astype(np.uint8).tobytes())
    certificate = TimedCertificate(problem, base)
    if certificate.base.fingerprint != base.fingerprint:
        raise ValueError("its base is not its problem written out")
    return certificate


def team_in(
    header: dict[str, Any], arrays: dict[str, NDArray[Any]], read: Callable[[bytes], Certificate | PathCertificate]
) -> TeamCertificate:
    """Return the certificate of a joint agent that a header and its arrays describe; raise ValueError otherwise."""
    problem = problem_from_dict(header["problem"])
    if header["fingerprint"] != problem.fingerprint:
        raise ValueError("the fingerprint does not belong to the problem in it")
    base = read(arrays[str(int(header["team"]))].astype(np.uint8).tobytes())
    if base.problem.n_agents != 1 or base.problem.n_states != problem.n_states:
        raise ValueError("its base does not fit the problem")
    return TeamCertificate(problem, base)
