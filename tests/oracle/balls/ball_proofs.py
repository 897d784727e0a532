"""Proofs, in ball arithmetic, of what the check states: one function for every kind of statement.

Numbers of the problem and of the certificate are the doubles that they are; everything that follows from them is
computed anew with python-flint, each result being a ball that holds the true number. A function returns how many
numbers it looked at, and what is wrong in words. What laws of noise mean is said by ``ball_laws``;
no special function of scipy or numpy is used, and what is guessed in doubles is proved.
"""

from __future__ import annotations

from collections.abc import Callable

from .ball_masses import hats, lost, masses, near
from .ball_memory import Proof
from .ball_numbers import angles, error_function, function, interpolation_error, spans
from .ball_relations import disturbance, mean_targets, targets
from .ball_sums import differences, spare, sums

PROOFS: dict[str, Callable[..., Proof]] = {
    "masses": masses, "lost": lost, "hats": hats, "near": near, "charge": interpolation_error, "erf": error_function,
    "function": function, "spans": spans,
    "aims": mean_targets, "targets": targets,
    "disturbance": disturbance,
    "spare": spare, "angles": angles, "sums": sums, "differences": differences,
}  # fmt: skip
"""By the names of statements."""
