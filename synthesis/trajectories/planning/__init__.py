"""The search for trajectories and feedback gains.

The search for trajectories and their feedback gains, for one agent and for teams.
"""

from .counted_work import CountedWork
from .path_search import path_certificate, refuse_without_path
from .policy_paths import networks_along

__all__ = ["CountedWork", "networks_along", "path_certificate", "refuse_without_path"]
