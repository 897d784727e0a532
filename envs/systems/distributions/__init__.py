"""Distributions of the noise: distribution functions, quantiles, and sub-Gaussian envelopes."""

from .composed_laws import ScipyLaw
from .laws import Gaussian, Law, Uniform
from .majorants import Majorant, Tail
from .noise import declared_noise, is_own_law, laws_by_author, laws_of

__all__ = [
    "Gaussian",
    "Law",
    "Majorant",
    "ScipyLaw",
    "Tail",
    "Uniform",
    "declared_noise",
    "is_own_law",
    "laws_by_author",
    "laws_of",
]
