"""What proofs in balls remember of one another: rows that were proved, what they lack, what sums may have gained."""

from __future__ import annotations

from typing import Any

from flint import arb

from certigym.envs.systems.agents import AnyAgent
from certigym.synthesis.certificates.cell_probabilities import AgentRecord, kernel_key

UNIT = 2.0**-53

Balls = Any
"""Array of balls; numpy adds, multiplies and compares them as objects."""

Proof = tuple[int, list[str]]
"""Numbers that were proved, and what is wrong."""


class Memory:
    """What was proved before: which rows of tables are known, what they lack at most, and what sums may have gained."""

    def __init__(self) -> None:
        self.rows: dict[tuple[object, int], set[int]] = {}
        self.deficits: dict[tuple[object, int], Any] = {}
        self.hats: dict[object, Any] = {}
        self.sums = self.differences = 0.0

    def missing(self, agent: AnyAgent, part: AgentRecord) -> Any:
        """What the rows of an agent that were proved lack at most, all axes together."""
        key = kernel_key(agent, part)
        return sum((self.deficits.get((key, k), arb(0)) for k in range(len(part.grid.shape))), arb(0))
