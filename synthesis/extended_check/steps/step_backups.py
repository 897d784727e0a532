"""One-step Bellman backups of the check: factors of a step later read at points, over boxes, or at corners of cells.

A *backup* takes the factors of a value function, and the choices of the cells, to factors one step earlier that are
below the truth at every state of each cell. There is one for each form in which motions are known: a mean that is the
same for the whole cell (points), anywhere in a box (boxes), or an affine function of the state (corners).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ....envs.systems.agents import AnyAgent
from ...certificates.cell_probabilities import AgentRecord, axis_tables, backup
from ...certificates.proofs import OnGrid
from ...relations.grids import FloatArray
from .boxes_check import BoxTables, box_tables, box_values
from .execution import execution_of
from .linear_check import linear_values
from .symbolic_linear import SymbolicTables, symbolic_tables


class StepBackup(Protocol):
    """How factors are read around the motions of one agent's choices.

    Attributes
    ----------
    proves_given : bool
        Whether factors that a certificate stores need not be those that are best here, but are proved below the truth.
    """

    proves_given: bool

    def values(
        self, part: AgentRecord, factors: FloatArray, rows: Iterable[tuple[int, int]], known: dict[object, FloatArray]
    ) -> list[FloatArray]:
        """Return factors (n, places) one step earlier, lower bounds, for each of some rows (t, q) of the policy.

        They are 0 in cells without a choice. ``known`` remembers what agents with one kernel have in common.
        """

    def proved(self, part: AgentRecord, factors: FloatArray, row: tuple[int, int], given: FloatArray) -> bool:
        """Return whether given factors (n, places) are below the truth as well."""


@dataclass(frozen=True, eq=False)
class Points:
    """Choices are lattice points, which the means are for the whole cell."""

    tables: list[FloatArray]
    lost: float
    proves_given = False

    def values(
        self, part: AgentRecord, factors: FloatArray, rows: Iterable[tuple[int, int]], known: dict[object, FloatArray]
    ) -> list[FloatArray]:
        """Return smoothed factors at the points, less what relations that are lost take from them."""
        alike, found = (id(self.tables), factors.tobytes()), []
        if alike not in known:
            known[alike] = backup(factors, self.tables)
        for row in rows:
            points = part.points(*row)
            values = known[alike][:, np.maximum(points, 0)]
            if self.lost:
                values = np.maximum(0.0, values - self.lost * factors.max(axis=1, initial=0.0)[:, None])
            found.append(np.asarray(values * (points >= 0)))
        return found

    def proved(self, part: AgentRecord, factors: FloatArray, row: tuple[int, int], given: FloatArray) -> bool:
        """Return that nothing is proved of given factors."""
        return False


@dataclass(frozen=True, eq=False)
class Boxes:
    """Means are anywhere in the box of a cell and its choice."""

    agent: AnyAgent
    tables: BoxTables
    proves_given = False

    def values(
        self, part: AgentRecord, factors: FloatArray, rows: Iterable[tuple[int, int]], known: dict[object, FloatArray]
    ) -> list[FloatArray]:
        """Return the least of what is below the smoothed factors, over each box."""
        return box_values(self.agent, part, self.tables, factors, list(rows))

    def proved(self, part: AgentRecord, factors: FloatArray, row: tuple[int, int], given: FloatArray) -> bool:
        """Return that nothing is proved of given factors."""
        return False


@dataclass(frozen=True, eq=False)
class Corners:
    """Means are affine in the state of a cell; factors are multilinear in each cell, and held by its corners."""

    tables: SymbolicTables
    proves_given = True

    def values(
        self, part: AgentRecord, factors: FloatArray, rows: Iterable[tuple[int, int]], known: dict[object, FloatArray]
    ) -> list[FloatArray]:
        """Return multilinear functions below the smoothed factors."""
        return [linear_values(part, self.tables, factors, t, q)[0] for t, q in rows]

    def proved(self, part: AgentRecord, factors: FloatArray, row: tuple[int, int], given: FloatArray) -> bool:
        """Return whether given factors, any multilinear functions, are below the truth."""
        return bool(np.all(linear_values(part, self.tables, factors, *row, given)[1]))


def step_backups_of(certificate: OnGrid) -> list[StepBackup]:
    """Return the reading of every agent; agents that are alike, policies included, have the same one."""
    is_robust, tables = certificate.proof.bound == "robust tree", dict[tuple[bytes, ...], list[FloatArray]]()
    known, found = dict[object, StepBackup](), list[StepBackup]()
    for agent, part in zip(certificate.problem.agents, certificate.proof.agents, strict=True):
        key = (*part.sharing_key(agent), part.content_digest())
        if key not in known:
            known[key] = step_backup_of(agent, part, tables, is_robust)
        found.append(known[key])
    return found


def step_backup_of(
    agent: AnyAgent, part: AgentRecord, tables: dict[tuple[bytes, ...], list[FloatArray]], is_robust: bool
) -> StepBackup:
    """Return the reading of one agent, whose policy says which motions are enclosed."""
    relation = part.relation_of(agent)
    if part.is_linear:
        return Corners(symbolic_tables(agent, part, execution_of(agent, part, relation).mean))
    if part.relation["kind"] == "boxes":
        return Boxes(agent, box_tables(agent, part, execution_of(agent, part, relation).mean, tables))
    return Points(axis_tables(agent, part, tables), relation.delta if is_robust else 0.0)
