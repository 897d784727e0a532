"""Exact maps, boxes, linear cells, (epsilon, delta).

What ties a state to its cell: exact maps, boxes, linear cells, the paper's (epsilon, delta), networks.
"""

from .affine_means import AffineBoxes, AffineMeans, MapRelation, block_of, map_relation
from .boxes import BoxRelation, MeanBoxes, box_relation
from .coupled import CoupledRelation, couple, joint_delta
from .description import GONE, Relation, check_description, describe_relation, relation_from
from .exact import ExactOnCells, ExactRelation, aimed_relation
from .input_forms import Turn
from .inverse_means import SymbolicOnCells, SymbolicTargets, symbolic_targets
from .joint_networks import JointNetworkPolicy, joint_network_policy, seen_jointly
from .network_maps import NetworkMaps, network_linear_relation
from .networks import (
    ACTIVATIONS,
    ON_CELLS,
    Network,
    NetworkPolicy,
    OwnView,
    check_network,
    inputs_of,
    network_policy,
    scaled,
    write_task,
)
from .rounding import mean_loss, mean_off
from .rows import Row, product, rows_of, times
from .scalar import paper_relation
from .symbolic_means import SymbolicMeans
from .symbolic_policies import SymbolicPolicy
