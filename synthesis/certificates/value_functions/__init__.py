"""Value functions: sums of products, tensor trains.

Value functions as sums of products and as tensor trains with certified error: records and algebra.
"""

from .row_sums import UNIT, add_rows
from .tensor_train import Cells, Core, Diagram, Train, added, ones, rounded
from .terms import (
    BoolArray,
    Guards,
    IndexArray,
    MergeLog,
    Merges,
    Occupancy,
    Terms,
    compress,
    distinct,
    merge_rows,
    sum_factors,
    term_depths,
    term_masses,
    tree_rows,
)
from .train_values import (
    Backup,
    Rounding,
    Routes,
    Trains,
    Unread,
    arrival,
    assembled,
    core_backup,
    core_rows,
    counted_as_failed,
    routes,
    start_above,
    start_value,
)
from .value_function import ValueFunction
