"""Expressions that say how agents move: read safely, computed on numbers, enclosed on boxes. Knows no agents."""

from .affine_inputs import split_at, substituted
from .enclosure import Affine, enclosed, gradients
from .evaluation import computed
from .expression_tree import Name, Number, Operation, Tree, names_in, whole_exponent
from .intervals import Interval
from .reading import RESERVED, ExpressionError, checked_variable, read_expression

__all__ = [
    "Affine",
    "ExpressionError",
    "Interval",
    "Name",
    "Number",
    "Operation",
    "RESERVED",
    "Tree",
    "checked_variable",
    "computed",
    "enclosed",
    "gradients",
    "names_in",
    "read_expression",
    "split_at",
    "substituted",
    "whole_exponent",
]
