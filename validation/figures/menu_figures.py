"""Figures of permissive certificates: how much freedom their menus leave, and where."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...synthesis.certificates import rounded_down
from ...synthesis.permissions import Permission
from .figure_style import MAP, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def menu_figure(permission: Permission, agent: int = 0, q: int | None = None, time: int = 0) -> Figure:
    """Draw how many choices are on the menus of an agent.

    A scalar agent is drawn over its cells and all times, a planar one over its cells at one time.

    Parameters
    ----------
    permission : Permission
    agent : int
        Number of the agent.
    q : int, optional
        Automaton state; default: the first one in which something is left to decide.
    time : int
        Time, for planar agents.

    Raises
    ------
    ValueError
        If there is no such agent, state or time, or the agent has more than two components.
    """
    problem = permission.problem
    undecided = np.flatnonzero(~problem.automaton.absorbing)
    state = int(undecided[0]) if q is None else q
    limits = {
        "agent": (agent, problem.n_agents),
        "q": (state, problem.automaton.n_states),
        "time": (time, problem.horizon),
    }
    for name, (number, count) in limits.items():
        if not 0 <= number < count:
            raise ValueError(f"`{name}`: expected a number from 0 to {count - 1}, got {number}")
    part, counts = permission.certificate.proof.agents[agent], permission.menus[agent].counts[:, state]
    if len(part.lattice) > 2:
        raise ValueError(f"`agent`: expected one of one or two components, got {len(part.lattice)}")
    figure, (plot,) = new_figure(6.8, 4.2)
    edges = part.grid.edges
    if len(edges) == 1:
        x, y, sizes, label = edges[0], np.arange(problem.horizon + 1) - 0.5, counts, "time (control steps)"
    else:
        x, y, sizes, label = edges[0], edges[1], counts[time].reshape(part.grid.shape).T, "x2 (grid units)"
    image = plot.pcolormesh(x, y, sizes, cmap=MAP, vmin=0, shading="flat", rasterized=True)
    figure.colorbar(image, ax=plot, label="choices on the menu", pad=0.02)
    plot.set_xlabel(f"{problem.agent_names[agent]}: x1 (grid units)")
    plot.set_ylabel(label)
    plot.set_title(
        f"{problem.name}: automaton state {state}, P >= {rounded_down(permission.lower_bound, 4)}",
        loc="left",
        fontsize=10,
    )
    return figure
