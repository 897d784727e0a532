"""Certificates along a nominal path: the search for the path and its feedback, for one agent and for teams."""

from .counted_work import CountedWork
from .path_search import path_certificate, refuse_without_path

__all__ = ["CountedWork", "path_certificate", "refuse_without_path"]
