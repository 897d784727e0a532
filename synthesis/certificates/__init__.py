"""The certified claim, everything it rests on, and its file."""

from .archive import packed
from .certificate import Certificate, checked_certificate
from .certificate_file import (
    UNREADABLE,
    AnyCertificate,
    certificate_in,
    load_certificate,
    save_certificate,
)
from .checked_kernel import axis_tables, grid_noise, kernel_key, lost_to_rounding, smooth
from .checked_laws import law_charge, law_error, probability_below, scale_charge
from .claim import Claim, joint_states
from .digits import EXACT_GAP, rounded_down, rounded_up, shown_bound, significant_down, significant_up
from .given_certificate import any_certificate, as_certificate, certificate_on_grids, of_one_task, speaks_of_one_start
from .mixed_certificate import MixedCertificate
from .mixed_states import known_letters, pairs_between, reached_states
from .pairs_certificate import PairsCertificate
from .part import AgentPart
from .path_certificate import AgentPath, PathCertificate
from .path_tube import KEPT, Tube, tube_along
from .product import ProductCertificate, nameless, product_certificate
from .regrown_trains import BrokenTrainError, regrow_trains
from .result import Synthesis
from .seen import Seen
from .start_hull import StartHull
from .stated import Statement, noted, state
from .team_certificate import TeamCertificate
from .timed_certificate import TimedCertificate
from .two_ended import Offer, TwoEnded, require

__all__ = [
    "AgentPart",
    "AgentPath",
    "AnyCertificate",
    "BrokenTrainError",
    "Certificate",
    "Claim",
    "EXACT_GAP",
    "KEPT",
    "MixedCertificate",
    "Offer",
    "PairsCertificate",
    "PathCertificate",
    "ProductCertificate",
    "Seen",
    "StartHull",
    "Statement",
    "Synthesis",
    "TeamCertificate",
    "TimedCertificate",
    "Tube",
    "TwoEnded",
    "UNREADABLE",
    "any_certificate",
    "as_certificate",
    "certificate_on_grids",
    "axis_tables",
    "packed",
    "certificate_in",
    "checked_certificate",
    "grid_noise",
    "kernel_key",
    "known_letters",
    "joint_states",
    "load_certificate",
    "law_charge",
    "law_error",
    "probability_below",
    "scale_charge",
    "lost_to_rounding",
    "nameless",
    "noted",
    "of_one_task",
    "pairs_between",
    "product_certificate",
    "reached_states",
    "regrow_trains",
    "require",
    "rounded_down",
    "rounded_up",
    "save_certificate",
    "shown_bound",
    "significant_down",
    "significant_up",
    "speaks_of_one_start",
    "smooth",
    "state",
    "tube_along",
]
