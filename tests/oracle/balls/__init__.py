"""Every number that a check takes from libraries, proved in ball arithmetic."""

from .rigorous import RigorousReport, check_rigorous

__all__ = ["RigorousReport", "check_rigorous"]
