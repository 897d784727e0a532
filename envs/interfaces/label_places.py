"""Where labels stand: inside their frame, and not on top of one another."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Cell = tuple[float, float, float, float]
"""A rectangle in pixels: left, top, right, bottom."""


class Labels:
    """The labels of one frame, placed one after the other.

    Parameters
    ----------
    frame : tuple of float
        Left, top, right, bottom in pixels: no label leaves it.
    taken : iterable of tuple
        Rectangles that are to stay free.
    """

    def __init__(self, frame: Cell, taken: Iterable[Cell] = ()) -> None:
        self._frame = frame
        self.taken = list(taken)

    def keep_free(self, rectangle: Cell) -> None:
        """Let no later label cover a rectangle."""
        self.taken.append(rectangle)

    def place(
        self, spots: Sequence[tuple[float, float]], width: float, height: float, at_least: bool = False
    ) -> tuple[float, float] | None:
        """Return the first spot (left, top) at which a label fits and covers nothing, and keep it free.

        If there is none, the result is None, or with ``at_least`` the spot where it covers least, moved into the frame.
        """
        left, top, right, bottom = self._frame
        best: tuple[float, tuple[float, float]] | None = None
        for x, y in spots:
            inside = left <= x and x + width <= right and top <= y and y + height <= bottom
            if not inside and not at_least:
                continue
            x, y = max(left, min(x, right - width)), max(top, min(y, bottom - height))
            covered = sum(_overlap((x, y, x + width, y + height), other) for other in self.taken)
            if best is None or covered < best[0]:
                best = covered, (x, y)
            if covered == 0:
                break
        if best is None or (best[0] > 0 and not at_least):
            return None
        x, y = best[1]
        self.taken.append((x, y, x + width, y + height))
        return best[1]


def beside(x: float, y: float, gap: float, width: float, height: float) -> list[tuple[float, float]]:
    """Return spots for a label around a point: right, left, above, below, and at the corners."""
    right, left, middle = x + gap, x - gap - width, y - height / 2
    above, below, centre = y - gap - height, y + gap, x - width / 2
    return [
        (right, middle),
        (left, middle),
        (centre, above),
        (centre, below),
        (right, above),
        (right, below),
        (left, above),
        (left, below),
    ]


def _overlap(a: Cell, b: Cell) -> float:
    """Return the common area of two rectangles."""
    across = min(a[2], b[2]) - max(a[0], b[0])
    down = min(a[3], b[3]) - max(a[1], b[1])
    return across * down if across > 0 and down > 0 else 0.0
