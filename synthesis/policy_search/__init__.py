"""Policies on cells by value iteration, and their bounds.

Policy search on cells: value iteration, bounds, and which relations and cells are tried.
"""
