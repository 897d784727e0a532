"""Boxes of starts that cross a region: why that is hard to certify, and the boxes to ask for instead."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...systems.arguments import vector_text
from .record import Problem

MOST_PIECES = 12
"""Boxes that are named: more are no advice."""

FloatArray = NDArray[np.float64]


def crossed_starts(problem: Problem) -> str:
    """Return why starts that the task tells apart are hard to certify, and which boxes are not, in words; "" of others.

    Paths are for starts that leave the automaton in one state, and grids have to resolve what a box crosses.
    """
    if problem.groups and not problem.labeling.pairs:
        return next((why for task in problem.tasks if (why := crossed_starts(task))), "")
    if problem.initial_q is not None or problem.starts_outside:
        return ""
    crossed = [name for name in problem.propositions if next(_cut(problem, name), None) is not None]
    what = f"starts cross {', '.join(f'`{name}`' for name in crossed[:4])}" if crossed else "starts are told apart"
    why = f"{what}: the task goes on differently from them, so that no path is for all"
    pieces = _pieces(problem)
    if not pieces:
        return f"{why}; ask for boxes of starts that are within regions, or beyond them"
    each = ", ".join(f"{_text(problem, piece)} with {_share(problem, piece):.4g} of them" for piece in pieces)
    return (
        f"{why}; ask for each of these boxes (`initial_low`, `initial_high`) instead, and add up their shares: {each}"
    )


def _pieces(problem: Problem) -> list[Problem]:
    """Return the problem from boxes that are the starts together, none of which crosses a region; none if unknown."""
    waiting, done = [problem], list[Problem]()
    while waiting:
        piece = waiting.pop(0)
        if piece.initial_q is not None:
            done.append(piece)
            continue
        parts = next((cut for name in piece.propositions if (cut := [*_cut(piece, name)])), [])
        if not parts or len(done) + len(waiting) + len(parts) > MOST_PIECES:
            return []
        waiting = [*parts, *waiting]
    return done


def _cut(problem: Problem, name: str) -> Iterator[Problem]:
    """Yield the problem from the start box within a region, and from boxes beside it; nothing if it is not crossed."""
    labeling, p = problem.labeling.at(0), problem.automaton.propositions.index(name)
    if p >= labeling.first_pair:
        return
    (i,) = labeling.owners[p]
    agent, k = problem.agents[i], p - int(labeling.agent_propositions[i][0])
    low, high = agent.initial.low.copy(), agent.initial.high.copy()
    beside = list[tuple[FloatArray, FloatArray]]()
    for output, ends in enumerate(zip(labeling.low[i][:, k], labeling.high[i][:, k], strict=True)):
        if not np.any(np.isfinite(ends)):
            continue
        axis = agent.output_axis(output)
        if axis is None or agent.wrapped_axes[axis[0]]:
            return
        s, first, last = axis[0], *sorted(end / axis[1] for end in ends)
        if last <= low[s] or (first > low[s] if low[s] == high[s] else first >= high[s]):
            return
        if low[s] < first:
            beside.append((low.copy(), np.where(np.arange(len(low)) == s, first, high)))
            low[s] = first
        if last < high[s]:
            beside.append((np.where(np.arange(len(low)) == s, last, low), high.copy()))
            high[s] = last
    for lower, upper in [(low, high), *beside] if beside else []:
        yield problem.replace(initial_low={agent.name: lower}, initial_high={agent.name: upper})


def _text(problem: Problem, piece: Problem) -> str:
    """Return the starts of agents that do not start at a point, in words."""
    boxes = [(agent.name, agent.initial) for agent in piece.agents if not agent.initial.is_point]
    names = [f"{name} " if problem.n_agents > 1 else "" for name, _ in boxes]
    ends = [f"[{vector_text(box.low)}, {vector_text(box.high)})" for _, box in boxes]
    return " and ".join(f"{name}{box}" for name, box in zip(names, ends, strict=True))


def _share(problem: Problem, piece: Problem) -> float:
    """Return the share of a piece in the starts of a problem (rounded)."""
    share = 1.0
    for whole, part in zip(problem.agents, piece.agents, strict=True):
        width = whole.initial.high - whole.initial.low
        part_width = (part.initial.high - part.initial.low)[width > 0.0]
        share *= float(np.prod(part_width / width[width > 0.0]))
    return share
