"""Figures of where networks lose most, over cells and times."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ....synthesis.certificates.proofs import OnGrid
from ....synthesis.extended_check.claims import claim_text
from ....synthesis.verbs.raw_networks import WeakPlaces
from .figure_style import MAP, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def network_figure(places: WeakPlaces, certificate: OnGrid | None = None, agent: int | None = None) -> Figure:
    """Draw what a network loses: a scalar agent over its cells and all times, a planar one over its cells.

    Losses are summed over automaton states, and over times for planar agents.

    Parameters
    ----------
    places : WeakPlaces
    certificate : Certificate, optional
        Of the repaired networks: cells in which they were replaced are marked (scalar agents).
    agent : int, optional
        Number of the agent; default: the one that loses most.

    Raises
    ------
    ValueError
        If there is no such agent, or it has more than two components.
    """
    problem = places.problem
    chosen = int(np.argmax([loss.sum() for loss in places.losses])) if agent is None else agent
    if not 0 <= chosen < problem.n_agents:
        raise ValueError(f"`agent`: expected a number from 0 to {problem.n_agents - 1}, got {agent}")
    edges, loss = places.edges[chosen], places.losses[chosen].sum(axis=1)
    if len(edges) > 2:
        raise ValueError(f"`agent`: expected one of one or two components, got {len(edges)}")
    figure, (plot,) = new_figure(6.8, 4.2)
    if len(edges) == 1:
        x, y, sizes, label = edges[0], np.arange(problem.horizon + 1) - 0.5, loss, "time (control steps)"
    else:
        shape = tuple(len(axis) - 1 for axis in edges)
        x, y, sizes, label = edges[0], edges[1], loss.sum(axis=0).reshape(shape).T, "x2 (grid units)"
    image = plot.pcolormesh(x, y, sizes, cmap=MAP, vmin=0, shading="flat", rasterized=True)
    figure.colorbar(image, ax=plot, label="loss (probability)", pad=0.02)
    if certificate is not None and len(edges) == 1:
        policy = certificate.proof.agents[chosen].policy
        replaced = np.any(policy >= problem.horizon * problem.automaton.n_states, axis=1)
        times, cells = np.nonzero(replaced)
        plot.plot(0.5 * (x[cells] + x[cells + 1]), times, ".", markersize=2, color="tab:red", label="replaced")
        plot.legend(loc="upper right", fontsize=8)
    plot.set_xlabel(f"{problem.agent_names[chosen]}: x1 (grid units)")
    plot.set_ylabel(label)
    bound = "" if certificate is None else f", repaired {claim_text(certificate)}"
    plot.set_title(f"{problem.name}: where the network loses{bound}", loc="left", fontsize=10)
    return figure
