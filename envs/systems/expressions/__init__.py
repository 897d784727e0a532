"""Expressions: read, computed, enclosed on boxes.

Expressions of dynamics: read safely, computed on numbers, enclosed on boxes. Knows no agents.
"""

from .affine_inputs import split_at, substituted
from .compiled import Compiled
from .enclosure import Affine, enclosed, gradients, roundings
from .evaluation import computed
from .expression_tree import Name, Number, Operation, Tree, affine, names_in, operations_in, whole_exponent
from .intervals import Interval
from .linear_systems import AffineForm, affine_form, replaced, solved
from .programs import Program
from .reading import ExpressionError, checked_variable, read_expression
from .repeating import turns
