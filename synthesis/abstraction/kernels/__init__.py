"""One-step Bellman backups of values, from below.

One-step Bellman backups, from below: at points, over boxes, at the corners of cells.
"""

from .box_kernel import MOST_SCALED, MOST_SCALES, BoxKernel, box_kernel_of, box_lattice, points_per_cell, scale_levels
from .box_minima import each_window_minima, least_over_boxes
from .kernel import Kernel, gaussian_table, law_table
from .lattice_kernel import LatticeKernel, lattice_kernel_of
from .linear_kernel import hat_table
from .multilinear_kernel import BESIDE, FAR, Images, MultilinearKernel, in_chunks
from .second_derivative_bounds import SecondDerivativeBounds
