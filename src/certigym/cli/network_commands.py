"""What ``certify`` does with networks: certificates of networks as they are deployed."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np

from ..envs.tasks.problem import Problem
from ..synthesis.certificates.proofs import rounded_up, save_certificate
from ..synthesis.verbs.certify import OF_NETWORKS
from ..synthesis.verbs.certify import certify as certify_policy
from ..synthesis.verbs.search_options import SearchOptions
from ..validation.policies import compare as compare_policies
from .given import cells_of, named_problem, show
from .work import trials

UNCERTIFIED = "Nothing is certified of a policy whose certificate is NOT valid."
"""What stands in the place of what a bound holds for."""


def problem_of_actor(path: str, horizon: int | None) -> Problem:
    """Return the problem on which an actor was trained, by the name in its file."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            name = str(json.loads(str(stored["header"]))["problem"])
    except (KeyError, ValueError, TypeError, EOFError) as error:
        raise ValueError(f"`{path}`: expected the file of an actor (.npz of `certigym train`)") from error
    return named_problem(name, horizon)


def is_actor(options: Namespace) -> bool:
    """Return whether an actor stands in the place of the problem."""
    return options.policy is None and options.problem.endswith(".npz") and Path(options.problem).is_file()


def is_wrapping(options: Namespace) -> bool:
    """Return whether what is asked of the relation is about policies that are wrapped on cells."""
    return options.delta is not None or len(options.relation) > 1 or options.relation[0] not in OF_NETWORKS


def certify_raw(options: Namespace, problem: Problem, policy: Any) -> int:
    """Certify networks as they are; the status is 1 if check or rollouts refute a bound."""
    cells = cells_of(options)
    search = SearchOptions(targets_per_cell=options.targets)
    policies: dict[str, Any] = {"deployed": policy}
    found = certify_policy(problem, policy, cells, relation=options.relation[0], above=options.above, search=search)
    policies["certified"] = found
    if options.out:
        save_certificate(found.certificate, options.out)
    with trials(options, options.episodes * len(policies)) as plan:
        result = compare_policies(problem, policies, plan)
    holds = "The bound of `certified` holds for the deployed policy: it is the same."
    lines = [str(result), UNCERTIFIED if result.is_invalid else holds]
    above: float | None = None
    if options.above and not result.is_invalid:
        above = found.certificate.upper_bound
        lines.append(f"The deployed policy succeeds with P <= {rounded_up(above, 6)}.")
    show(options, "\n".join(lines), {**result.to_dict(), "above": above})
    too_low = above is not None and any(e.name == "deployed" and e.ci_low > above for e in result.entries)
    return int(too_low or result.is_invalid or result.is_refuted)
