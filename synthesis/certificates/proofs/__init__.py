"""Proofs of claims, one kind a file, and archives.

What a claim rests on, one kind of proof a file, and certificates in files.
"""

from .archive import MAX_BYTES
from .canonical import (
    ClaimsMoreError,
    NotCanonicalError,
    alarm_of,
    canonical_bytes,
    canonical_problem,
    contents_of,
    require_about,
    verdict_of,
    wrong_angles,
)
from .certificate import (
    Certificate,
    alike_members,
    changed,
    is_exact,
    lasting_bound,
    member_agents,
    members_of,
    nameless,
    on_cells,
    path_under,
    relations_tried,
    require,
    seen_by,
    start_of_claim,
    why_nothing,
    with_claims,
)
from .certificate_file import load_certificate, save_certificate
from .check_report import CheckReport, told_assumed, told_claim
from .claim import Claim, joint_states
from .digits import EXACT_GAP, in_runs, rounded_down, rounded_up, shown_bound, significant_down, significant_up
from .given_certificate import (
    as_certificate,
    certificate_from,
    certificate_on_grids,
    checked_certificate,
    of_first_task,
    speaks_of_one_start,
)
from .grid_proof import GridProof, OnGrid, delta_of, value_of
from .path_proof import SOMETIME, AgentPath, AlongPath, GivenPolicy, PathProof
from .path_tube import KEPT, Tube, tube_along
from .product_proof import ProductProof, product_certificate, split
from .projection import RunProjection
from .proof import Capability
from .result import BROKEN_OFF, Synthesis
from .starts_proof import Cut, OfStarts, StartsProof
from .timed_proof import TimedProof, timed_certificate
from .union_bound_proof import UnionBoundProof
from .vertex_grid import VertexGrid
from .vertex_proof import VertexProof, VertexTeamProof
