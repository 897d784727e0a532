"""Blocks: agents of equal sizes, stacked into arrays, so that the dynamics compute with many at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..agents import counted, read_only
from ..problem import Problem

Sparse = tuple[np.ndarray, tuple[int, ...]]
"""Entries (k, n, 1) of a row of the agents' matrices, and their positions in the row.

Entries that are 0 for all agents are left out; one stays if all are 0.
"""


@dataclass(frozen=True, eq=False, repr=False)
class Block:
    """Agents of equal sizes, stacked.

    Attributes
    ----------
    agents : np.ndarray of int, shape (n,)
        Positions of the agents in the problem.
    A, B, C, noise_factor : np.ndarray, shape (d, d, n, 1), (d, m, n, 1), (p, d, n, 1), (d, d, n, 1)
    offset, state_low, state_high, initial_low, initial_high : np.ndarray, shape (d, n, 1)
    input_low, input_high : np.ndarray, shape (m, n, 1)
    identity_output : bool
        Whether y = x for all agents.
    propositions, owners : np.ndarray of int, shape (k,)
        Propositions of these agents, and for each of them the position of its agent in the block.
    region_low, region_high : np.ndarray, shape (p, k, 1)
    columns : np.ndarray of int, shape (d, n)
        Positions of the components in a joint state.
    """

    agents: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    noise_factor: np.ndarray
    offset: np.ndarray
    state_low: np.ndarray
    state_high: np.ndarray
    initial_low: np.ndarray
    initial_high: np.ndarray
    input_low: np.ndarray
    input_high: np.ndarray
    identity_output: bool
    propositions: np.ndarray
    owners: np.ndarray
    region_low: np.ndarray
    region_high: np.ndarray
    columns: np.ndarray

    def __repr__(self) -> str:
        (m, n), d, p = self.input_low.shape[:2], len(self.state_low), len(self.C)
        sizes = (counted(d, "state"), counted(m, "input"), counted(p, "output"))
        return f"Block({counted(n, 'agent')} with {', '.join(sizes)})"

    @cached_property
    def motion(self) -> tuple[tuple[Sparse, Sparse, np.ndarray, Sparse], ...]:
        """Rows of A, B, offset and noise factor; if all agents have equal entries, the entries of one, to broadcast."""
        # A product with one agent's entries has the same bits and reads less memory.
        matrices = (self.A, self.B, self.offset[:, None], self.noise_factor)
        single = (stack[..., :1, :] if np.all(stack == stack[..., :1, :]) else stack for stack in matrices)
        return tuple((_sparse(a), _sparse(b), c[0], _sparse(factor)) for a, b, c, factor in zip(*single))

    @cached_property
    def input_range(self) -> tuple[float, float]:
        """Largest interval in which every component of every agent's input is admissible."""
        return float(self.input_low.max()), float(self.input_high.min())


def block_of(problem: Problem, group: list[int]) -> Block:
    """Return the block of some agents of a problem, named by their positions; all must have equal sizes."""
    agents = [problem.agents[i] for i in group]
    labeling = problem.labeling

    # Agents become the last axis but one; the last one is that of the worlds.
    def stacked(arrays: Sequence[np.ndarray | None]) -> np.ndarray:
        return read_only(np.stack([np.asarray(a) for a in arrays], axis=-1)[..., None])

    # Propositions of all agents of the block stand side by side; `owners` says which agent each belongs to.
    regions_low = np.concatenate([labeling.low[i] for i in group], axis=1)
    regions_high = np.concatenate([labeling.high[i] for i in group], axis=1)
    counts = [len(labeling.agent_propositions[i]) for i in group]
    return Block(
        agents=read_only(np.array(group)),
        A=stacked([a.A for a in agents]),
        B=stacked([a.B for a in agents]),
        C=stacked([a.output_matrix for a in agents]),
        noise_factor=stacked([a.noise_factor for a in agents]),
        offset=stacked([a.offset for a in agents]),
        state_low=stacked([a.state_low for a in agents]),
        state_high=stacked([a.state_high for a in agents]),
        initial_low=stacked([a.initial_low for a in agents]),
        initial_high=stacked([a.initial_high for a in agents]),
        input_low=stacked([a.input_low for a in agents]),
        input_high=stacked([a.input_high for a in agents]),
        identity_output=all(a.has_identity_output for a in agents),
        propositions=read_only(np.concatenate([labeling.agent_propositions[i] for i in group])),
        owners=read_only(np.repeat(np.arange(len(group)), counts)),
        region_low=read_only(regions_low[..., None]),
        region_high=read_only(regions_high[..., None]),
        # Components of an agent are consecutive in a joint state; here they are the rows.
        columns=read_only(
            np.stack([np.arange(problem.columns[i].start, problem.columns[i].stop) for i in group], axis=1)
        ),
    )


def _sparse(row: np.ndarray) -> Sparse:
    positions = np.flatnonzero(np.any(row != 0.0, axis=(1, 2)))
    positions = positions if len(positions) else np.array([0])
    return row[positions], tuple(positions.tolist())
