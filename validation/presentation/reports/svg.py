"""Small inline SVG drawings: axes, lines, rectangles, text. Functions take numbers and return strings without style.

Classes name the roles of shapes (``grid``, ``bound``, ``region`` ...). The style sheet of the page gives them colours,
so that one drawing serves a light and a dark page. All text is escaped.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

Points = Sequence[tuple[float, float]]
"""Points of a picture."""


@dataclass(frozen=True)
class Axes:
    """Data limits, and the margins around the plot inside a picture of ``width`` by ``height`` units."""

    low: tuple[float, float]
    high: tuple[float, float]
    width: float = 360.0
    height: float = 250.0
    left: float = 44.0
    right: float = 10.0
    top: float = 20.0
    bottom: float = 34.0

    def at(self, x: float, y: float) -> tuple[float, float]:
        """Return the picture coordinates of a data point; an empty range of data counts as length 1."""
        # Pictures count y downwards.
        across = (x - self.low[0]) / ((self.high[0] - self.low[0]) or 1.0)
        up = (y - self.low[1]) / ((self.high[1] - self.low[1]) or 1.0)
        plot_width, plot_height = self.width - self.left - self.right, self.height - self.top - self.bottom
        return self.left + across * plot_width, self.top + (1.0 - up) * plot_height


def picture(axes: Axes, shapes: Iterable[str], title: str) -> str:
    """Return an ``<svg>`` element that scales with the page; screen readers read ``title`` aloud."""
    box = f"0 0 {axes.width:g} {axes.height:g}"
    return f'<svg viewBox="{box}" role="img"><title>{escape(title)}</title>{"".join(shapes)}</svg>'


def frame(axes: Axes, x_name: str, y_name: str, whole: bool = False) -> list[str]:
    """Return grid lines, ticks and names of both axes; ``whole`` puts the ticks of x on whole numbers."""
    shapes = []
    for x in ticks(axes.low[0], axes.high[0], 6, whole):
        px, bottom = axes.at(x, axes.low[1])
        shapes.append(line((px, axes.at(x, axes.high[1])[1]), (px, bottom), "grid"))
        shapes.append(text(px, bottom + 13, number(x), "tick middle"))
    for y in ticks(axes.low[1], axes.high[1], 5):
        left, py = axes.at(axes.low[0], y)
        shapes.append(line((left, py), (axes.at(axes.high[0], y)[0], py), "grid"))
        shapes.append(text(left - 4, py + 3.5, number(y), "tick end"))
    middle = axes.left + 0.5 * (axes.width - axes.left - axes.right)
    shapes.append(text(middle, axes.height - 4, x_name, "name middle"))
    shapes.append(text(4, 10, y_name, "name"))
    return shapes


def ticks(low: float, high: float, most: int, whole: bool = False) -> list[float]:
    """Return round numbers between the limits (both included), about ``most`` of them.

    Examples
    --------
    >>> ticks(0.0, 1.0, 5)
    [0.0, 0.25, 0.5, 0.75, 1.0]
    """
    span = high - low
    if not span > 0:
        return [low]
    # The smallest round step, 1, 2, 2.5 or 5 times a power of ten, that gives few enough ticks.
    raw = span / max(1, most - 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(s * power for s in (1.0, 2.0, 2.5, 5.0, 10.0) if s * power >= raw * (1 - 1e-9))
    step = max(1.0, math.ceil(step)) if whole else step
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 10) + 0.0 for k in range(first, math.floor(high / step + 1e-9) + 1)]


def number(value: float) -> str:
    """Return a number with four significant digits."""
    return f"{value:.4g}"


def line(a: tuple[float, float], b: tuple[float, float], role: str) -> str:
    """Return a straight line between two picture points."""
    return f'<line class="{role}" x1="{a[0]:.1f}" y1="{a[1]:.1f}" x2="{b[0]:.1f}" y2="{b[1]:.1f}"/>'


def polyline(points: Sequence[tuple[float, float]], role: str) -> str:
    """Return a polygonal line through picture points."""
    return f'<polyline class="{role}" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}"/>'


def polygon(points: Sequence[tuple[float, float]], role: str) -> str:
    """Return a filled polygon through picture points."""
    return f'<polygon class="{role}" points="{" ".join(f"{x:.1f},{y:.1f}" for x, y in points)}"/>'


def outlined(fills: Sequence[Points], edges: Sequence[Points], role: str, hint: str) -> str:
    """Return filled polygons without edges, and edges of polygons, with a hint that appears under the mouse pointer."""
    drawn = [
        f'<path class="{role}" style="{style}" d="{" ".join(_closed(points) for points in polygons)}"/>'
        for polygons, style in ((fills, "stroke:none"), (edges, "fill:none"))
    ]
    return f"<g><title>{escape(hint)}</title>{''.join(drawn)}</g>"


def _closed(points: Points) -> str:
    return "M" + " L".join(f"{x:.1f},{y:.1f}" for x, y in points) + " Z"


def rectangle(a: tuple[float, float], b: tuple[float, float], role: str, hint: str = "", style: str = "") -> str:
    """Return a rectangle between two opposite picture points, with a hint that appears under the mouse pointer."""
    x, y, w, h = min(a[0], b[0]), min(a[1], b[1]), abs(a[0] - b[0]), abs(a[1] - b[1])
    inner = f"<title>{escape(hint)}</title>" if hint else ""
    extra = f' style="{escape(style, quote=True)}"' if style else ""
    return f'<rect class="{role}"{extra} x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}">{inner}</rect>'


def circle(at: tuple[float, float], radius: float, role: str) -> str:
    """Return a circle around a picture point."""
    return f'<circle class="{role}" cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="{radius:.1f}"/>'


def text(x: float, y: float, words: Any, role: str) -> str:
    """Return text at a picture point."""
    return f'<text class="{role}" x="{x:.1f}" y="{y:.1f}">{escape(str(words))}</text>'
