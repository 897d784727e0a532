"""Figures, reports, the studio, the paper's tables.

Figures, reports, the studio, and the paper's tables.
"""
