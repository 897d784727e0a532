"""Certificates along a path: letters chosen from the automaton, a nominal path through them, and feedback."""

from .certified_starts import certified_starts
from .path_search import path_certificate

__all__ = ["certified_starts", "path_certificate"]
