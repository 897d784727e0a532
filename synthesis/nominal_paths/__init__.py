"""Certificates along a path: letters chosen from the automaton, a nominal path through them, and feedback."""

from .path_search import path_certificate

__all__ = ["path_certificate"]
