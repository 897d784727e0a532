"""A proposition about one agent: a box in its output space, which may move with the time, or a shape in its states.

A corner is a number or an expression in `t`, the number of control steps taken: 0 at the start, and the horizon at the
end. Corners that move are rounded to twelve decimals, so that they are the same numbers on every machine, whose sines
differ in their last digits; a check that needs more encloses `trees` itself. Where a corner is not below the other one,
the region is empty at that time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ...systems.arguments import box_text, checked_states, read_only, shown
from ...systems.expressions import Tree
from .shapes import SHAPES, Shape, read_shape
from .timed_corners import Corner, read_corners, values_over


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Proposition:
    """A box in the output space of one agent, half-open: `low <= y < high`; or another shape in its state space.

    Parameters
    ----------
    agent : str
        Name of the agent. A name with one `*` makes the proposition a family: one member per agent that matches.
    low, high : array_like, shape (p,), or sequences of numbers and strings
        Corners, finite, `low < high`. They may lie beyond the workspace. Strings are expressions in the time `t`, such
        as `"2*sin(0.4*t) - 0.5"`: then the region moves, and is empty at times at which `low < high` does not hold.
    of : str, int, or sequence of them, optional
        What corners, or a shape, are about, in order: states by name or number, or outputs as they are written. Without
        it corners are about all outputs, and shapes about the first states.
    **shape
        In the place of corners, one shape by its word: `disc`, `ball`, `box`, `polygon`, `polytope`, `halfspace`,
        `cone`, `heading`, `union`, `intersection` or `complement`, with the same table as in problem files
        (docs/how-to/own_problem.md, "Regions by what they are").

    Attributes
    ----------
    low, high : np.ndarray, shape (p,)
        Corners of a region that stands still; ValueError for one that moves, which has them `at` each time, and for a
        shape or a box `of` some states, which have them in a problem alone (`problem.propositions`).
    shape : Shape or None
        The shape as it is written; that of a box where `of` says what its corners are about.
    of_states : tuple of str or int, or None
        What `of` names.

    Raises
    ------
    ValueError
        If an argument is wrong, or an expression names anything but `t`.

    Examples
    --------
    >>> band = Proposition("robot", ["2*sin(0.4*t) - 0.5"], ["2*sin(0.4*t) + 0.5"])
    >>> band.moves, band.at(0)
    (True, Proposition('robot', [-0.5, 0.5)))
    >>> Proposition("ship", disc={"centre": [1, 2], "radius": 0.5})
    Proposition('ship', disc(centre=(1, 2), radius=0.5))
    >>> Proposition("craft", [5, 1], [7, 3], of=["x", "y"])
    Proposition('craft', [5, 1] to [7, 3] of (x, y))
    """

    agent: str
    low: np.ndarray
    high: np.ndarray
    corners: tuple[Corner, Corner] | None
    shape: Shape | None
    of_states: tuple[str | int, ...] | None

    trees: tuple[tuple[Tree, ...], tuple[Tree, ...]]
    """Corners of a region that moves, as expressions in `t`."""

    def __init__(self, agent: str, low: Any = None, high: Any = None, of: Any = None, **shape: Any) -> None:
        if not isinstance(agent, str) or agent.count("*") > 1:
            raise ValueError(f"`agent`: expected a name with at most one `*`, got {shown(agent)}")
        states = None if of is None else checked_states(of)
        if shape:
            if len(shape) > 1 or low is not None or high is not None:
                raise ValueError(
                    f"`{next(iter(shape))}`: expected one shape, or `low` and `high`, got more; unite them in a "
                    "`union` or an `intersection`"
                )
            self._keep(agent=agent, corners=None, shape=_shape_about(read_shape(shape), states), of_states=states)
            return
        for value, name in ((low, "low"), (high, "high")):
            if value is None:
                raise ValueError(f"`{name}`: expected `low` and `high`, or a shape: {', '.join(SHAPES)}")
        region = read_corners(low, high)
        if states is None:
            self._keep(agent=agent, shape=None, of_states=None, **region)
        else:
            self._keep(agent=agent, corners=None, shape=_box_about(region, states), of_states=states)

    def _keep(self, **values: Any) -> None:
        for key, value in values.items():
            object.__setattr__(self, key, value)

    if not TYPE_CHECKING:  # types are those of the attributes
        # Asked for what the region has not: whoever reads corners without a time must not go on with any.
        def __getattr__(self, name: str) -> Any:
            if name in ("low", "high") and self.shape is not None:
                raise ValueError(f"`proposition`: expected a box, got {self!r}; ask for `problem.propositions`")
            if name in ("low", "high"):
                raise ValueError(f"`proposition`: expected a region that stands still, got {self!r}; ask `at` a time")
            raise AttributeError(name)

    # Rebuilt from its arguments: a pickled array would come back writable.
    def __reduce__(self) -> tuple[Any, ...]:
        if self.shape is not None:
            return _shaped, (self.agent, self.shape, self.of_states)
        if self.corners is not None:
            return Proposition, (self.agent, *self.corners)
        return _standing, (self.agent, self.low, self.high)

    def __repr__(self) -> str:
        if self.shape is not None:
            return f"Proposition({self.agent!r}, {self.text})"
        if self.corners is None:
            return f"Proposition({self.agent!r}, {box_text(self.low, self.high, closed=False)})"
        return f"Proposition({self.agent!r}, {self.text})"

    @property
    def moves(self) -> bool:
        """Whether a corner names the time."""
        return self.corners is not None

    @property
    def size(self) -> int:
        """Number of outputs p."""
        return len(self.low) if self.corners is None else len(self.corners[0])

    @property
    def text(self) -> str:
        """The corners, or the shape, as they are written, for people."""
        of = "" if self.of_states is None else f" of ({', '.join(map(str, self.of_states))})"
        if self.shape is not None and not self._is_box:
            return self.shape.text + of
        low, high = self._written_corners
        shown_low, shown_high = (
            ", ".join(entry if isinstance(entry, str) else f"{entry:g}" for entry in corner) for corner in (low, high)
        )
        return f"[{shown_low}] to [{shown_high}]{of}"

    @property
    def named_states(self) -> tuple[str | int, ...]:
        """Names and numbers of states, and outputs, that it says it is about."""
        tables = () if self.shape is None else self.shape.tables
        inner = [checked_states(table["of"]) for table in tables if "of" in table]
        return (*(self.of_states or ()), *(state for own in inner for state in own))

    @property
    def _is_box(self) -> bool:
        """Whether it is a box of states that `of` names: it has a shape, and is written with corners."""
        return self.shape is not None and self.of_states is not None and self.shape.key == "box"

    @property
    def _written_corners(self) -> tuple[list[float | str], list[float | str]]:
        if self.shape is not None:
            return self.shape.data["low"], self.shape.data["high"]
        if self.corners is not None:
            return list(self.corners[0]), list(self.corners[1])
        return self.low.tolist(), self.high.tolist()

    def of(self, agent: str) -> Proposition:
        """Return the same region for another agent, which has its own outputs."""
        if self.shape is not None:
            return _shaped(agent, self.shape, self.of_states)
        if self.corners is not None:
            return Proposition(agent, *self.corners)
        return _standing(agent, self.low, self.high)

    def at(self, time: int) -> Proposition:
        """Return the region at a time, which may be empty (`low >= high`); itself if it stands still.

        Raises
        ------
        ValueError
            If a corner is not finite at this time.
        """
        if self.corners is None:
            return self
        low, high = self.over(np.array([float(time)]))
        return _standing(self.agent, low[:, 0], high[:, 0])

    def over(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return both corners at times (n,): two arrays (p, n), with the same bits for one time and for many.

        Raises
        ------
        ValueError
            If a corner is not finite at one of them.
        """
        if self.corners is None:
            low, high = (np.repeat(corner[:, None], len(times), axis=1) for corner in (self.low, self.high))
            return low, high
        low, high = (values_over(own, times) for own in self.trees)
        wrong = ~(np.isfinite(low) & np.isfinite(high)).all(axis=0)
        if wrong.any():
            raise ValueError(
                f"expected finite corners at every time, got {self.text}, which is not finite at t = "
                f"{times[int(np.argmax(wrong))]:g}"
            )
        return low, high

    def to_dict(self) -> dict[str, Any]:
        """Return the proposition as plain values, keyed as in problem files (exact)."""
        data: dict[str, Any] = {"agent": self.agent}
        if self.of_states is not None:
            data["of"] = list(self.of_states)
        if self.shape is not None and not self._is_box:
            return data | {self.shape.key: self.shape.data}
        low, high = self._written_corners
        return data | {"low": low, "high": high}


def _standing(agent: str, low: np.ndarray, high: np.ndarray) -> Proposition:
    """Return a region that stands still, and may be empty."""
    region = object.__new__(Proposition)
    values = {"low": read_only(low), "high": read_only(high), "corners": None, "shape": None, "of_states": None}
    region._keep(agent=agent, **values)
    return region


def _shaped(agent: str, shape: Shape, of_states: tuple[str | int, ...] | None) -> Proposition:
    """Return a region of a shape that has been read."""
    region = object.__new__(Proposition)
    region._keep(agent=agent, corners=None, shape=shape, of_states=of_states)
    return region


def _shape_about(shape: Shape, of_states: tuple[str | int, ...] | None) -> Shape:
    """Return a shape; raise ValueError if `of` says beside it what each of its parts says itself."""
    if of_states is not None and all("of" in table for table in shape.tables):
        raise ValueError(
            "`of`: expected a shape that does not say itself which states it is about, got one that does, or one that "
            "consists of names; leave `of` out"
        )
    return shape


def _box_about(region: Mapping[str, Any], of_states: tuple[str | int, ...]) -> Shape:
    """Return a box of some states as a shape: problems say which outputs they are."""
    ends = region["corners"] or (region["low"], region["high"])
    if len(ends[0]) != len(of_states):
        raise ValueError(f"`of`: expected {len(ends[0])} states, as `low` has entries, got {shown(list(of_states))}")
    return read_shape({"box": {"low": ends[0], "high": ends[1]}})
