"""Figures, reports, the studio, and the paper's tables."""
