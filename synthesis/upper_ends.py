"""Upper ends: at most how often certified controllers, or deployed networks, succeed.

They are certified for the *opposite* task, whose automaton is that of the task with the other states accepting at the
horizon. No run satisfies both. So one minus a lower bound for the opposite is an upper bound for the task, and
relation, search and check are those of all certificates (docs/theory/bounds.md, "The other end of any certificate").
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from ..envs.arrays import on_one_thread
from ..envs.problem import opposite_of
from .certificates import OnGrid, Synthesis, any_certificate, changed, with_claims
from .choosing import Effort, settings_of
from .models import Settings
from .on_cells import Plan, continued
from .raw_networks import evaluated_again
from .search import Search


@on_one_thread
def bound_above(certificate: Any) -> Any:
    """Return a certificate with a certified upper bound on how often its controllers satisfy its task.

    It is for all certificates on cells, and for what is put together of them; others are returned as they are, and
    those that have an upper end already. It takes about as long as an evaluation of the policies. Runs that leave the
    workspaces count as if they might have succeeded: the end is too large by as much as leaves.

    The end becomes part of the certificate (``opposite``, ``gap``, ``upper_bound``): it is saved with it, verified by
    ``check``, and compared with rollouts by ``validate``.

    Parameters
    ----------
    certificate : Synthesis, Certificate or path
        Its policies, cells, relations and their settings are taken, and evaluated anew for the opposite task.

    Raises
    ------
    ValueError
        If its policies cannot be evaluated.
    """
    return with_claims(any_certificate(certificate), _with_end)


def synthesis_above(synthesis: Synthesis) -> Synthesis:
    """Return a synthesis whose certificate has an upper end, if it can have one."""
    certificate = bound_above(synthesis.certificate)
    return replace(synthesis, certificate=certificate, controller=certificate.controller)


def _with_end(certificate: OnGrid) -> OnGrid:
    """Return the certificate of one task with an upper end."""
    if certificate.gap is not None:
        return certificate
    opposite = opposite_of(certificate.problem)
    try:
        if any("network" in part.relation for part in certificate.proof.agents):
            found = evaluated_again(opposite, certificate)
        else:
            kinds = [part.relation["kind"] for part in certificate.proof.agents]
            plan = Plan(Settings(**settings_of(certificate, kinds)), Search(max_sweeps=0), None, Effort())
            found = continued(opposite, None, kinds, plan, certificate).certificate
    except ValueError as error:
        raise ValueError(f"`certificate`: its policies cannot be evaluated for the opposite task: {error}") from error
    above = min(1.0, math.nextafter(1.0 - found.lower_bound, 2.0))
    # Rounded up: the sum of bound and gap must not be below the end.
    gap = max(0.0, math.nextafter(above - certificate.lower_bound, 2.0))
    return changed(certificate, opposite=found, gap=gap)
