"""Options of searches: one record, and the keywords that stood in its place until 0.3."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from ...envs.systems.arguments import near, unknown_argument
from ..abstraction.models import Settings
from ..policy_search.ascent import Limits, Search

OF_RELATIONS = tuple(field.name for field in fields(Settings))
"""Options that finite models are made with: those of ``abstract`` and ``certify``."""

PACKAGE = __name__.partition(".")[0]


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Options of a search: of the ascent, and of the finite models that it searches on.

    Defaults are what an id without options gets. They can change which certificate is found; none
    of them changes what a certificate means, or how it is checked.

    Parameters
    ----------
    max_sweeps : int
        Most improving sweeps after the first, at least 0 (default: 8). The search stops earlier when nothing improves.
        More sweeps never lower the bound.
    restarts : int
        Further starts of the search, at least 0 (default: 0), from the best policies with their plans advanced or
        delayed. Each takes about as long as the first search. More starts never lower the bound.
    stationary : bool
        Whether policies must not depend on the time, as for tasks without a deadline (default: False).
    value : "auto", "tree" or "train"
        Form of the value function: a tree of products, exact up to what is pruned; or tensor trains, rounded with a
        certified error, for tasks whose trees grow too many terms. Default: whatever fits the task.
    limits : Limits, optional
        How trees are pruned during the search: shares of the value (dimensionless) and numbers of terms. Less pruning
        takes more time and memory, and may raise the bound. Default: ``Limits()``.
    targets_per_cell : int, optional
        Relation ``exact``: lattice points per cell and axis; with more of them rounding wastes fewer of the admissible
        inputs. ``linear`` and ``boxes``: points per cell and axis at which values are read. Default: 2 (``exact``, one
        or two states), 1 (``exact``, more states), otherwise what noise and cells ask for, at least 4.
    epsilon : float, optional
        Relation ``paper``: half width of the relation, in units of the outputs. Default: 0.1.
    feedback : float, optional
        Relation ``paper``: feedback gain K of the interface, in units of inputs per unit of the state. Default: 0.
    inputs : int, optional
        Relation ``paper``: number of abstract inputs. Default: 10.
    delta : float, optional
        Relation ``paper``: largest probability per step and agent that the relation is lost, in [0, 1), in place of the
        smaller closed form.

    Raises
    ------
    ValueError
        If an option does not exist, or is out of range.

    Notes
    -----
    With ``start=``, options of relations that are not given are those of the certificate.

    Examples
    --------
    >>> import certigym as cg
    >>> cg.SearchOptions(max_sweeps=2, restarts=1)
    SearchOptions(max_sweeps=2, restarts=1)
    """

    max_sweeps: int = 8
    restarts: int = 0
    stationary: bool = False
    value: str = "auto"
    limits: Limits | None = None
    targets_per_cell: int | None = None
    epsilon: float | None = None
    feedback: float | None = None
    inputs: int | None = None
    delta: float | None = None

    def __post_init__(self) -> None:
        # The records that searches work with check their fields.
        self.search()
        Settings(**self.of_relations)

    def __repr__(self) -> str:
        return f"SearchOptions({', '.join(f'{name}={value!r}' for name, value in self.given.items())})"

    @property
    def given(self) -> dict[str, Any]:
        """Options that differ from their defaults, by name."""
        own = {field.name: getattr(self, field.name) for field in fields(self)}
        return {field.name: own[field.name] for field in fields(self) if own[field.name] != field.default}

    @property
    def of_relations(self) -> dict[str, Any]:
        """Options of relations that are given, by name: arguments of ``Settings``."""
        return {name: getattr(self, name) for name in OF_RELATIONS if getattr(self, name) is not None}

    def search(self, **others: Any) -> Search:
        """Return the record of the ascent; ``others`` are fields of ``Search`` that no user gives."""
        limits = Limits() if self.limits is None else self.limits
        own = {"stationary": self.stationary, **others}
        return Search(self.max_sweeps, limits, self.value, self.restarts, **own)


OPTIONS = tuple(field.name for field in fields(SearchOptions))
"""Names of all options."""

_made = SearchOptions.__init__


def _init(self: SearchOptions, **options: Any) -> None:
    """Make the record; an option that does not exist is refused with the name of the nearest one."""
    for name in options:
        if name not in OPTIONS:
            raise unknown_argument(name, "`SearchOptions`", OPTIONS)
    _made(self, **options)


_init.__wrapped__ = _made  # type: ignore[attr-defined]  # signatures are those of the fields
SearchOptions.__init__ = _init  # type: ignore[method-assign]


def options_of(
    search: SearchOptions | None,
    old: Mapping[str, Any],
    verb: str,
    keywords: Collection[str],
    used: Collection[str] = OPTIONS,
) -> SearchOptions:
    """Return the options that a verb was given, in the record or by the keywords of 0.3.

    Parameters
    ----------
    search : SearchOptions or None
        The record; None: all defaults.
    old : mapping
        Keywords that the signature of the verb does not name.
    verb : str
        Name of the verb, for messages.
    keywords : collection of str
        Names in its signature, among which the nearest to an unknown one is looked for.
    used : collection of str
        Options that the verb uses; others are refused.

    Raises
    ------
    ValueError
        If ``search`` is something else, a keyword does not exist, or an option is given that the verb does not use.
    """
    if search is not None and not isinstance(search, SearchOptions):
        raise ValueError(
            f"`search`: expected a record such as SearchOptions(max_sweeps=2), got {type(search).__name__}; "
            f"options are {', '.join(used)}"
        )
    for name in old:
        if name not in OPTIONS:
            meant = near(name, [*keywords, *used])
            written = f"search=SearchOptions({meant}=...)" if meant in used else meant
            raise unknown_argument(name, f"`{verb}`", keywords, written)
    options = SearchOptions() if search is None else search
    if old:
        options = replace(options, **old)
        written = ", ".join(f"{name}={value!r:.40}" for name, value in old.items())
        _warn(f"`{verb}`: options of the search are one record since 0.4; write search=cg.SearchOptions({written})")
    for name in options.given:
        if name not in used:
            raise ValueError(
                f"`{name}`: expected an option that `{verb}` uses ({', '.join(used)}), got {name!r} in `search`; "
                "leave it out"
            )
    return options


def _warn(text: str) -> None:
    """Warn of an old keyword where the caller wrote it, outside of the package."""
    frame, depth = sys._getframe(1), 2  # level 1 of warnings is this function
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == PACKAGE:
        frame, depth = frame.f_back, depth + 1
    warnings.warn(text, DeprecationWarning, stacklevel=depth)
