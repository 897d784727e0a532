"""The checker: reads a certificate file and proves its claim, with numpy alone and nothing else of the package.

Read it in this order: ``rigorous``, ``intervals``, ``expressions``, ``jets``; ``fields``, ``file``, ``problem`` (with
``distributions``); ``automaton``, ``formula``; ``letters``, ``angles``, ``crossings``, ``constraints``,
``error_system``, ``linearization``, ``trajectories``; ``labels``, ``tables``, ``motions``, ``cells``, ``tree``,
``trains``, ``cell_proofs``; ``selftest``, ``verdict``, ``controller``. Each file begins with its theorem.
"""

from .angles import check_angles
from .fields import Refused, Unreadable
from .file import FORMAT, MOST_BYTES, VERSION, Contents, is_certificate, parse_file, read_file
from .motions import affine_dynamics
from .problem import Agent as CheckedAgent
from .problem import read_problem
from .verdict import Verdict, bound_of, check, check_contents, shown

__all__ = [
    "FORMAT", "MOST_BYTES", "VERSION", "CheckedAgent", "Contents", "Refused", "Unreadable", "Verdict",
    "affine_dynamics", "bound_of", "check", "check_angles", "check_contents", "is_certificate", "parse_file",
    "read_file", "read_problem", "shown",
]  # fmt: skip
