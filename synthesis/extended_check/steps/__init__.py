"""One step of one agent, found again.

One step of one agent, found again: where it goes, and what values are there.
"""

from .carrying_out import wrong_actions
from .execution import execution_of
from .geometry import OUTWARD, cell_boxes, classes_in_boxes, start_shares
from .linear_check import hat_weights, masks_of, places_of
from .mean_enclosures import Enclosed, enclosed_means, enclosed_scales
from .network_enclosures import network_maps
from .relation_check import label_margin, verify_relation, wrong_for_uneven_noise
from .step_backups import step_backup_of, step_backups_of
from .step_regions import RegionSpan
