"""Distributions of the noise, and their envelopes.

Distributions of the noise: distribution functions, quantiles, and sub-Gaussian envelopes.
"""

from .composed_laws import ScipyLaw
from .envelopes import Envelope, Tail
from .laws import Gaussian, Law, Uniform
from .noise import declared_noise, is_own_law, laws_by_author, laws_of
