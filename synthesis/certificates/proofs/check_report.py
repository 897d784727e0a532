"""What a check says of a certificate, and what its bound is called then: where it is refused, a claim alone."""

from __future__ import annotations

from dataclasses import dataclass

from .digits import significant_down, significant_up


@dataclass(frozen=True)
class CheckReport:
    """Outcome of ``check``: truthy if the certificate holds.

    Parameters
    ----------
    valid : bool
    claimed : float
        The certificate's lower bound.
    recomputed : float
        Value at the start computed again (NaN if it was not reached); a lower bound up to rounding.
    failures : tuple of str
        What is wrong, in words.
    above : float or None
        Upper bound on the satisfaction probability of the certificate's controller, computed anew; None if the
        certificate claims none, or if it was too large a computation (``gap`` is unverified then).
    assumed : tuple of str
        Laws of noise, of scipy or of users, whose probabilities are numbers that their authors state.
    alarm : str
        How what the search believed differs from what the checker recomputed, in words; empty if it does not.
    """

    valid: bool
    claimed: float
    recomputed: float
    failures: tuple[str, ...]
    above: float | None = None
    assumed: tuple[str, ...] = ()
    alarm: str = ""

    def __bool__(self) -> bool:
        return self.valid

    def __str__(self) -> str:
        told = f"; {self.alarm}" if self.alarm else ""
        if self.valid:
            above = "" if self.above is None else f", at most {significant_up(self.above, 9)}"
            lower, again = (significant_down(number, 9) for number in (self.claimed, self.recomputed))
            return f"valid: lower bound {lower}, recomputed {again}{above}{told_assumed(self.assumed)}{told}"
        return "NOT valid: " + "; ".join(self.failures) + told


def told_assumed(laws: tuple[str, ...]) -> str:
    """Return which laws of noise a verdict takes from their authors, as the end of a sentence."""
    return f"; with what their authors state of {', '.join(laws)}" if laws else ""


def told_claim(shown: str, checked: CheckReport | None) -> str:
    """Return a bound in words, as it is where a check holds; None stands for a check that was stopped."""
    if checked is None:
        return f"claimed, not checked: {shown}"
    return shown if checked else f"claimed, {checked} ({shown})"
