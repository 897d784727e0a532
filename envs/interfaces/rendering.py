"""Pictures of episodes, drawn with Pillow: tracks over time, a map for planar agents, automaton state, letter, time.

Axes, regions and names never change, so they are drawn once; a frame is a copy of them with the curves on top. Pillow,
from the extra `viz`, is imported when the first picture is made.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..systems.arguments import shown
from ..tasks.problem import Problem
from ..tasks.regions import Pair
from .label_places import Cell, Labels, beside
from .palette import LOOKS, agent_color, rgb
from .scene import Curve, Panel, Region, figure, panels
from .task_roles import roles
from .window import Window

WIDTH, HEIGHT, SIDE = 720, 480, 210
"""Pixels of a frame, and of the column at its right that holds the texts."""

_MARGIN = (34, 16, 10, 24)  # left, top, right, bottom of a panel: room for the numbers at its axes
_INK, _PALE, _PAPER = (34, 40, 49), (150, 156, 166), (255, 255, 255)

_VERDICTS = {"satisfied": (34, 130, 60), "failed": (190, 40, 40), "not satisfied": (190, 40, 40)}
_VALUE = (61, 122, 186)
_TINT, _FAINT, _LINES, _SPACING = 46, 21, 120, 8
"""Opacity of regions, of those of crowded panels, and of the lines of a hatch, of 255; and pixels from line to line."""

_MOVED = 1.5
"""Pixels that an agent without a heading moves before it points there."""

_TRAIL = 6
"""Steps for which a way is drawn strongly: what moved last is seen at once."""

_FEW = 8
"""Agents of a panel that have names, marks and thick lines; more would cover one another."""

_FAMILY_LISTED = 4
"""Members up to which a family is listed by name."""

_LINE = 13
"""Height of a line of small text in pixels."""

_STATES_SHOWN, _PANELS_SHOWN = 9, 12
"""As many automaton states fit below each other at the side, and as many panels stay readable."""


def checked_render_mode(value: Any, modes: Sequence[str]) -> str | None:
    """Return a render mode if it is None or one of `modes`, or raise ValueError."""
    if value is not None and value not in modes:
        raise ValueError(f"`render_mode`: expected None or {' or '.join(map(repr, modes))}, got {shown(value)}")
    return None if value is None else str(value)


def _direction(curve: Curve, state: np.ndarray, points: Sequence[tuple[float, float]]) -> float | None:
    """Return the angle at which an agent on a map points: its heading, or where it last moved; None if it did not."""
    if curve.heading is not None:
        return float(state[curve.heading]) if np.isfinite(state[curve.heading]) else None
    x, y = points[-1]
    moved = ((x - a, b - y) for a, b in reversed(points[:-1]) if np.hypot(x - a, y - b) > _MOVED)
    return next((float(np.arctan2(up, across)) for across, up in moved), None)


def verdict_text(satisfied: bool, failed: bool, over: bool) -> str:
    """Return the verdict on an episode in words; "" while it is undecided."""
    return "satisfied" if satisfied else "failed" if failed else "not satisfied" if over else ""


class Picture:
    """Painter of the episodes of one problem.

    Parameters
    ----------
    problem : Problem
    caption : str
        A line below the name, such as a certified bound.

    Raises
    ------
    ImportError
        If Pillow is not installed.
    """

    def __init__(self, problem: Problem, caption: str = "") -> None:
        try:
            from PIL import Image, ImageChops, ImageDraw, ImageFont
        except ImportError as error:
            raise ImportError("pictures need Pillow; install it with `pip install certigym[viz]`") from error
        self._draw = ImageDraw.Draw
        self._font, self._small = ImageFont.load_default(13), ImageFont.load_default(11)
        self._problem = problem
        self._panels = panels(problem)[:_PANELS_SHOWN]
        self._frames = [_in_scale(panel, cell) for panel, cell in zip(self._panels, _cells(len(self._panels)))]
        self._roles = roles(problem)
        self._image, self._multiply = Image, ImageChops.multiply
        self._hatches = {look.hatch: self._hatch(look.hatch) for look in LOOKS.values()}
        # All that never changes is drawn once.
        self._background = Image.new("RGB", (WIDTH, HEIGHT), _PAPER)
        self._window: Window | None = None
        draw = self._draw(self._background, "RGBA")
        self._names: list[list[Cell]] = []  # where names of regions stand, per panel
        for panel, cell in zip(self._panels, self._frames):
            for region in panel.regions:
                if region.time is None or not panel.is_map:
                    self._region(self._background, panel, cell, region)
            self._axes(draw, panel, cell)
        self._side(draw, caption)

    def frame(
        self,
        track: np.ndarray,
        q: int,
        letter: Sequence[str],
        verdict: str,
        value: float | None = None,
        part: float = 1.0,
    ) -> np.ndarray:
        """Return one picture, uint8 (height, width, 3).

        Parameters
        ----------
        track : np.ndarray, shape (t + 1, D)
            Joint states at times 0 to t.
        q : int
            Automaton state.
        letter : sequence of str
            Propositions that hold.
        verdict : str
            "" while undecided.
        value : float, optional
            Certified lower bound on the probability of success from here on, drawn as a meter.
        part : float
            Share of the last step that is over, in (0, 1]: between two steps the last state is one on the way.
        """
        now = len(track) - 1 if part >= 1.0 else len(track) - 2
        image = self._background.copy()
        draw = self._draw(image)
        for panel, cell, names in zip(self._panels, self._frames, self._names):
            # On maps, regions that move are where they are now.
            here = [region for region in panel.regions if panel.is_map and region.time == now]
            for region in here:
                self._region(image, panel, cell, region)
            self._curves(draw, panel, cell, track, Labels(cell, names), part)
            self._rings(draw, panel, cell, track[-1], letter)
        self._status(draw, now, q, letter, verdict)
        if value is not None:
            self._meter(draw, value)
        return np.array(image)

    def _curves(
        self, draw: Any, panel: Panel, cell: Cell, track: np.ndarray, labels: Labels, part: float = 1.0
    ) -> None:
        """Draw each agent: its way, strong where it is recent, itself where it is now, and its name if they are few."""
        few = len(panel.curves) <= _FEW
        radius, width, long = (5, 2, 13) if few else (3, 1, 6)
        ends = []
        for curve in panel.curves:
            points = self._points(panel, cell, track @ curve.rows.T, part)
            color = rgb(agent_color(curve.number))
            recent = points[-_TRAIL - 1 :]
            if len(points) > len(recent):
                draw.line(points[: len(points) - len(recent) + 1], fill=_paler(color), width=1)
            if len(recent) > 1:
                draw.line(recent, fill=color if few else _paler(color), width=width)
            for x, y in recent[:-1] if few else ():
                draw.rectangle((x - 1, y - 1, x + 1, y + 1), fill=color)
                labels.keep_free((x - 3, y - 3, x + 3, y + 3))
            ends.append((curve, points[-1], color, _direction(curve, track[-1], points) if panel.is_map else None))
        # Dots and names come after all ways, so that no line covers them.
        for curve, (x, y), color, angle in ends:
            if angle is None:
                draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=color, outline=_PAPER)
            for corners, is_body in () if angle is None else figure((curve.name, self._problem.name), angle):
                places = [(x + long * a, y - long * b) for a, b in corners.tolist()]
                draw.polygon(places, fill=color if is_body else _PAPER, outline=_PAPER if is_body else None)
            room = radius if angle is None else long
            labels.keep_free((x - room, y - room, x + room, y + room))
        for curve, (x, y), color, angle in ends if few else ():
            spots = beside(x, y, 3 + (radius if angle is None else long), self._small.getlength(curve.name), _LINE)
            place = labels.place(spots, self._small.getlength(curve.name), _LINE, at_least=True)
            draw.text(place, curve.name, fill=color, font=self._small)

    def show(self, frame: np.ndarray) -> None:
        """Show a frame in a window, which needs pygame."""
        if self._window is None:
            self._window = Window(self._problem.name, WIDTH, HEIGHT)
        self._window.show(frame)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def _points(self, panel: Panel, cell: Cell, y: np.ndarray, part: float = 1.0) -> list[tuple[float, float]]:
        """Return the pixels of a curve (t + 1, k), moved to the rim of the panel if they lie beyond it."""
        left, top, right, bottom = cell
        # Positions as shares of the axes; a point beyond the panel is drawn just outside its rim.
        share = (y - np.array(panel.low)) / (np.array(panel.high) - np.array(panel.low))
        share = np.clip(np.nan_to_num(share, nan=0.0), -0.02, 1.02)
        times = np.minimum(np.arange(len(y)), len(y) - 2 + part)
        across = share[:, 0] if panel.is_map else times / self._problem.horizon
        return list(zip((left + across * (right - left)).tolist(), (bottom - share[:, -1] * (bottom - top)).tolist()))

    def _region(self, image: Any, panel: Panel, cell: Cell, region: Region) -> None:
        """Draw a region in the colour and hatch of its role: a box on a map, a band over time."""
        left, _, right, _ = cell
        (x0, y1), (x1, y0) = self._points(panel, cell, np.array([region.low, region.high]))
        if not panel.is_map:
            x0, x1 = (left + t / self._problem.horizon * (right - left) for t in region.span(self._problem.horizon))
        look = LOOKS[region.role]
        # Where the region is, its tint; and of the hatch what lies there.
        place = self._image.new("L", image.size, 0)
        has_shape = panel.is_map and region.outline is not None
        fills, edges = region.polygons if has_shape else ((), ())
        for fill in fills:
            self._draw(place).polygon(self._points(panel, cell, fill), fill=255)
        if not has_shape:
            self._draw(place).rectangle((x0, y0, x1, y1), fill=255)
        tint = _FAINT if (crowded := panel.is_crowded(self._problem.horizon)) else _TINT
        image.paste(look.rgb, mask=place.point([v * tint // 255 for v in range(256)]))
        if not crowded:
            image.paste(look.rgb, mask=self._multiply(place, self._hatches[look.hatch]))
        for edge in edges:
            self._draw(image).line(self._points(panel, cell, np.concatenate([edge, edge[:1]])), fill=look.rgb)
        if not has_shape and (panel.is_map or region.time is None):
            self._draw(image).rectangle((x0, y0, x1, y1), outline=look.rgb)

    def _hatch(self, hatch: str) -> Any:
        r"""Return lines all over a frame, as a mask: ``/`` and ``\`` slanted, ``x`` both, ``-``, ``|``."""
        lines = self._image.new("L", (WIDTH, HEIGHT), 0)
        draw = self._draw(lines)
        for k in range(-HEIGHT, WIDTH, _SPACING):
            if hatch in ("/", "x"):
                draw.line((k, HEIGHT, k + HEIGHT, 0), fill=_LINES)
            if hatch in ("x", "\\"):
                draw.line((k, 0, k + HEIGHT, HEIGHT), fill=_LINES)
            if hatch == "-":
                draw.line((0, k, WIDTH, k), fill=_LINES)
            if hatch == "|":
                draw.line((k, 0, k, HEIGHT), fill=_LINES)
        return lines

    def _legend(self, draw: Any) -> None:
        """Draw at the foot of the column what the colours of the regions mean, for the roles that there are."""
        x, y = WIDTH - SIDE + 12.0, HEIGHT - 16
        # Pairs of agents have rings instead of regions.
        shown_roles = [region.role for panel in self._panels for region in panel.regions]
        shown_roles += [
            self._roles[name] for name, about in self._problem.propositions.items() if isinstance(about, Pair)
        ]
        for role in dict.fromkeys(shown_roles):
            look = LOOKS[role]
            if look.word:
                draw.rectangle((x, y + 2, x + 8, y + 10), fill=look.rgb)
                draw.text((x + 12, y - 1), look.word, fill=_INK, font=self._small)
                x += 20 + self._small.getlength(look.word)

    def _axes(self, draw: Any, panel: Panel, cell: Cell) -> None:
        """Draw what a panel always shows over its regions: their names, the frame and its limits."""
        left, top, right, bottom = cell
        # Names come after all regions, each in a corner of its region that is free, those of small regions first.
        labels, written = Labels(cell), set()
        for region in sorted(panel.named, key=lambda r: float(np.prod(np.subtract(r.high, r.low)))):
            if panel.is_map and region.time is not None:
                continue
            (x0, y1), (x1, y0) = self._points(panel, cell, np.array([region.low, region.high]))
            x0, x1 = (x0, x1) if panel.is_map else (left, right)
            width = self._small.getlength(region.name)
            corners = [
                (x0 + 3, y0 + 1),
                (x0 + 3, y1 - _LINE - 2),
                (x1 - width - 3, y0 + 1),
                (x1 - width - 3, y1 - _LINE - 2),
            ]
            spots = corners if panel.is_map or region.time is not None else corners[::-1]
            # Regions of one family lie over each other: one name tells all.
            if y1 - y0 < _LINE - 2 or (key := (region.name, region.low, region.high)) in written:
                continue
            place = labels.place(spots, width, _LINE)
            if place is not None:
                written.add(key)
                draw.text(place, region.name, fill=(70, 74, 82), font=self._small)
        self._names.append(labels.taken)
        draw.rectangle(cell, outline=_INK)
        for value, y in ((panel.high[-1], top - 4), (panel.low[-1], bottom - 10)):
            text = f"{value:g}"
            draw.text((left - 5 - self._small.getlength(text), y), text, fill=_INK, font=self._small)
        # Limits of the axes: the coordinate, or time from 0 to the horizon.
        ends = (panel.low[0], panel.high[0]) if panel.is_map else (0, self._problem.horizon)
        draw.text((left, bottom + 4), f"{ends[0]:g}" if panel.is_map else "t = 0", fill=_INK, font=self._small)
        end = f"{ends[1]:g}"
        draw.text((right - self._small.getlength(end), bottom + 4), end, fill=_INK, font=self._small)

    def _side(self, draw: Any, caption: str) -> None:
        """Draw what the column at the right always shows."""
        x = WIDTH - SIDE + 12
        draw.text((x, 14), self._problem.name[:32], fill=_INK, font=self._font)
        draw.text((x, 32), caption[:36], fill=_INK, font=self._small)
        draw.text((x, 104), "task automaton", fill=_PALE, font=self._small)
        for k, q in enumerate(self._listed()):
            self._state(draw, k, q, False)
        draw.text((x, 346), "holds", fill=_PALE, font=self._small)
        self._legend(draw)

    def _rings(self, draw: Any, panel: Panel, cell: Cell, state: np.ndarray, letter: Sequence[str]) -> None:
        """Draw a ring around each of two agents about whom a proposition holds, and a line between them."""
        curves = {curve.name: curve for curve in panel.curves}
        for name in letter:
            about = self._problem.written[name]
            if not isinstance(about, Pair) or not panel.is_map or not all(agent in curves for agent in about.agents):
                continue
            ends = [self._points(panel, cell, (curves[agent].rows @ state)[None])[0] for agent in about.agents]
            color = LOOKS[self._roles[name]].rgb
            draw.line(ends, fill=color, width=2)
            for x, y in ends:
                draw.ellipse((x - 9, y - 9, x + 9, y + 9), outline=color, width=2)

    def _status(self, draw: Any, time: int, q: int, letter: Sequence[str], verdict: str) -> None:
        """Draw what the column at the right shows at this time."""
        x = WIDTH - SIDE + 12
        draw.text((x, 54), f"t = {time} of {self._problem.horizon}", fill=_INK, font=self._font)
        # A state beyond the list is shown below it while the automaton is in it.
        if q in (listed := self._listed()):
            self._state(draw, listed.index(q), q, True)
        else:
            self._state(draw, _STATES_SHOWN, q, True)
        for k, text in enumerate(self._wrapped(self._told(letter), SIDE - 20, 5)):
            draw.text((x, 362 + 14 * k), text, fill=_INK, font=self._small)
        if verdict:
            draw.text((x, 440), verdict, fill=_VERDICTS[verdict], font=self._font)

    def _told(self, letter: Sequence[str]) -> list[str]:
        """Return the propositions that hold in few words: large families as counts, with those that are missing."""
        holding, words, told = set(letter), [], set()
        for family, members in self._problem.families.items():
            if len(members) > _FAMILY_LISTED and holding & set(members):
                missing = [name for name in members if name not in holding]
                words.append(f"{family}: {len(members) - len(missing)} of {len(members)}")
                words += [f"not {name}" for name in missing] if len(missing) <= 3 else []
                told |= set(members)
        return [*words, *(name for name in letter if name not in told)] or ["none"]

    def _wrapped(self, words: Sequence[str], width: float, most: int) -> list[str]:
        """Return words in at most `most` lines of some width, separated by commas; dots stand for what does not fit."""
        lines, line = [], ""
        for word in words:
            longer = word if not line else f"{line}, {word}"
            if line and self._small.getlength(longer) > width:
                lines.append(line)
                longer = word
            line = longer
        lines.append(line)
        return lines if len(lines) <= most else [*lines[: most - 1], "..."]

    def _meter(self, draw: Any, value: float) -> None:
        """Draw the certified value as a bar with its number."""
        left, top, right = WIDTH - SIDE + 12, 76, WIDTH - 14
        draw.rectangle((left, top, right, top + 8), outline=_PALE)
        draw.rectangle((left, top, left + max(0.0, min(1.0, value)) * (right - left), top + 8), fill=_VALUE)
        # Rounded down: what is certified is at least this.
        text = f"from here: at least {np.floor(value * 1e4) / 1e4:.4f}"
        draw.text((left, top + 11), text, fill=_INK, font=self._small)

    def _listed(self) -> list[int]:
        """Return the automaton states that are always shown."""
        return list(range(min(self._problem.automaton.n_states, _STATES_SHOWN)))

    def _state(self, draw: Any, place: int, q: int, current: bool) -> None:
        """Draw one automaton state in the list at the right."""
        x, y = WIDTH - SIDE + 22, 130 + 21 * place
        automaton = self._problem.automaton
        fill = _INK if current else _PAPER
        draw.ellipse((x - 8, y - 8, x + 8, y + 8), fill=fill, outline=_INK)
        if automaton.accepting[q]:
            draw.ellipse((x - 5, y - 5, x + 5, y + 5), outline=_PAPER if current else _INK)
        name = automaton.state_names[q] + (" (no way out)" if automaton.dead[q] else "")
        draw.text((x + 14, y - 7), name[:26], fill=_INK if current else _PALE, font=self._small)


def _paler(color: tuple[int, int, int]) -> tuple[int, ...]:
    """Return a colour mixed with white."""
    return tuple((c + 2 * 255) // 3 for c in color)


def _in_scale(panel: Panel, cell: Cell) -> Cell:
    """Return the part of a cell in which both axes of a map have one scale, unless one is much longer."""
    if (proportion := panel.proportion) is None:
        return cell
    left, top, right, bottom = cell
    width = min(right - left, round((bottom - top) / proportion))
    return left, top, left + width, top + round(width * proportion)


def _cells(n: int) -> list[tuple[int, int, int, int]]:
    """Return the places of n panels, in one column up to three and in two from four on: left, top, right, bottom."""
    columns = 1 if n <= 3 else 2
    rows = -(-n // columns)
    width, height = (WIDTH - SIDE) // columns, HEIGHT // rows
    left, top, right, bottom = _MARGIN
    result = []
    for k in range(n):
        x, y = (k % columns) * width, (k // columns) * height
        result.append((x + left, y + top, x + width - right, y + height - bottom))
    return result
