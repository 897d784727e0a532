"""The search for trajectories and feedback gains.

The search for trajectories and their feedback gains, for one agent and for teams.
"""

from .counted_work import CountedWork
from .path_search import path_certificate, refuse_without_path
from .policy_paths import networks_along
from .start_cells import networks_from
