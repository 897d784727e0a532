"""Agents with independent axes, split into agents of fewer states.

Where the matrices of an agent fall apart into blocks of axes (the state matrix, the covariance, the rows of the output
matrix, and what each input acts on; input set, workspace and start are boxes anyhow), the blocks are agents of their
own: a robot in the plane becomes one that moves along x and one that moves along y. `split_axes` says the same problem
in these terms. A box region becomes the conjunction of its sides, a union of boxes the disjunction of such.

States, noise, letters and outcome of the split problem are those of the original, with the components in another order
(`axis_order`), so under the same inputs both succeed in the same runs: **a bound certified for the split problem holds
for the original**, with controllers that act on each block by its own state, the shared automaton state and the time.
These are fewer policies than an agent kept whole has: its x input may answer to its y position, that of a split one
may not. What is gained is size: two axes of n cells each instead of n * n cells.

The components stay in agent order, blocks in the order of their first components; within a block nothing moves. So the
joint state keeps its order unless the blocks of an agent interleave.

Reference: THEORY section 0 (agents may be any partition of the components into independent ones).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..agents import LinearAgent, Proposition
from ..logic import Formula, parse_formula, with_sides
from .record import Problem, checked_problem
from .specification import Specification

Block = tuple[list[int], list[int], list[int]]
"""Components of the state, the inputs that act on them and the rows of the output matrix that read them."""


def split_axes(problem: Problem) -> Problem:
    """Return the same problem with every agent split into its independent blocks of axes (exact).

    Agents of one block stay as they are, and so does a problem of such agents. Blocks are named by their components
    (`robot_x0`, `robot_x1`), the sides of regions likewise (`goal_x0`, `goal_x1`); sides that hold in the whole
    workspace are left out, and a region with a single side left keeps its name. Axes that no input moves get an input
    that is 0.

    Parameters
    ----------
    problem : Problem

    Raises
    ------
    ValueError
        If `problem` is none.

    Examples
    --------
    >>> from certigym import make_problem
    >>> planar = split_axes(make_problem("package-delivery-single-v0"))
    >>> planar.agent_names, planar.specification.formula
    (('robot_0_x0', 'robot_0_x1'), 'F (p1_x0 & p1_x1 & !(p2_x0 & p2_x1) U (p3_x0 & p3_x1))')
    """
    blocks = [_blocks(agent) for agent in checked_problem(problem).agents]
    if all(len(own) == 1 for own in blocks):
        return problem
    taken = set(problem.agent_names)
    agents: list[LinearAgent] = []
    parts: dict[str, list[LinearAgent]] = {}
    for agent, own in zip(problem.agents, blocks, strict=True):
        parts[agent.name] = [agent] if len(own) == 1 else [_part(agent, block, taken) for block in own]
        agents += parts[agent.name]
    propositions: dict[str, Proposition] = {}
    sides: dict[str, tuple[str, ...]] = {}
    taken = set(problem.propositions)
    by_name = {agent.name: (agent, own) for agent, own in zip(problem.agents, blocks, strict=True)}
    for name, proposition in problem.propositions.items():
        agent, own = by_name[proposition.agent]
        found = _sides(agent, own, parts[agent.name], proposition)
        names = [name] if len(found) == 1 else [_fresh(f"{name}_{_axes(block)}", taken) for block, _ in found]
        sides[name] = tuple(names)
        propositions |= {side: part for side, (_, part) in zip(names, found, strict=True)}
    specification = _substituted(problem.specification, problem.families, sides)
    return Problem(
        name=problem.name, horizon=problem.horizon, agents=agents, propositions=propositions,
        specification=specification,
    )  # fmt: skip


def axis_order(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return where the components of the split problem stand in the original.

    Returns
    -------
    states : np.ndarray of int, shape (D,)
        ``x_split = x[states]`` for joint states in agent order; the noise likewise.
    inputs : np.ndarray of int
        ``u_split = u[inputs]`` for joint inputs in agent order, but for -1: an axis that no input moves, whose input
        is 0.

    Examples
    --------
    >>> from certigym import make_problem
    >>> axis_order(make_problem("package-delivery-single-v0"))
    (array([0, 1]), array([0, 1]))
    """
    states: list[int] = []
    inputs: list[int] = []
    first_state = first_input = 0
    for agent in checked_problem(problem).agents:
        for components, own, _ in _blocks(agent):
            states += [first_state + k for k in components]
            inputs += [first_input + k for k in own] or [-1]
        first_state, first_input = first_state + agent.n_states, first_input + agent.n_inputs
    return np.array(states), np.array(inputs)


def _blocks(agent: LinearAgent) -> list[Block]:
    """The finest blocks that no matrix couples, in the order of their first components."""
    d = agent.n_states
    linked = (agent.A != 0) | (agent.noise_covariance != 0)
    for columns in (agent.B.T, agent.output_matrix):  # what one input acts on, what one output reads
        for row in columns != 0:
            linked |= row[:, None] & row[None]
    linked |= linked.T | np.eye(d, dtype=bool)
    for _ in range(d):
        linked = (linked.astype(int) @ linked.astype(int)) > 0
    groups = sorted({tuple(np.flatnonzero(row).tolist()) for row in linked})
    return [
        (
            list(group),
            [k for k, column in enumerate(agent.B.T) if _owner(column, groups) == group],
            [k for k, row in enumerate(agent.output_matrix) if _owner(row, groups) == group],
        )
        for group in groups
    ]


def _owner(row: np.ndarray, groups: list[tuple[int, ...]]) -> tuple[int, ...]:
    """The group whose components a row speaks of; the first one, if it speaks of none."""
    used = np.flatnonzero(row)
    return groups[0] if used.size == 0 else next(group for group in groups if int(used[0]) in group)


def _part(agent: LinearAgent, block: Block, taken: set[str]) -> LinearAgent:
    """The agent of one block."""
    components, inputs, outputs = block
    start = agent.initial
    return LinearAgent(
        name=_fresh(f"{agent.name}_{_axes(block)}", taken),
        A=agent.A[np.ix_(components, components)],
        B=agent.B[np.ix_(components, inputs)] if inputs else np.zeros((len(components), 1)),
        noise_covariance=agent.noise_covariance[np.ix_(components, components)],
        state_low=agent.state_low[components],
        state_high=agent.state_high[components],
        input_low=agent.input_low[inputs] if inputs else [0.0],
        input_high=agent.input_high[inputs] if inputs else [0.0],
        initial_low=start.low[components],
        initial_high=start.high[components],
        output_matrix=_output(agent, block) if outputs else None,
        offset=agent.offset[components],
    )


def _output(agent: LinearAgent, block: Block) -> np.ndarray:
    """Output matrix of a block, doubled where it would be the identity but that of the agent is not.

    The regions of an agent with `y = x` are closed at the upper edge of the workspace, those of others are not.
    Doubling, of regions as well, is exact and keeps them half-open.
    """
    components, _, outputs = block
    return agent.output_matrix[np.ix_(outputs, components)] * _scale(agent, block)


def _scale(agent: LinearAgent, block: Block) -> float:
    """Factor on outputs and regions of a block."""
    components, _, outputs = block
    own = agent.output_matrix[np.ix_(outputs, components)]
    return 2.0 if not agent.has_identity_output and np.array_equal(own, np.eye(len(components))) else 1.0


def _sides(
    agent: LinearAgent, blocks: list[Block], parts: list[LinearAgent], proposition: Proposition
) -> list[tuple[Block, Proposition]]:
    """The sides of a region on the blocks of its agent, but those that hold in the whole workspace."""
    found = []
    for block, part in zip(blocks, parts, strict=True):
        rows = block[2]
        if rows:
            scale = _scale(agent, block) if len(blocks) > 1 else 1.0
            side = Proposition(part.name, proposition.low[rows] * scale, proposition.high[rows] * scale)
            found.append((block, side))
    if not agent.has_identity_output:
        return found
    bound = [
        (block, side)
        for block, side in found
        if np.any(side.low > agent.state_low[block[0]]) or np.any(side.high < agent.state_high[block[0]])
    ]
    return bound or found[:1]


def _axes(block: Block) -> str:
    """Components in a name."""
    return "_".join(f"x{k}" for k in block[0])


def _fresh(name: str, taken: set[str]) -> str:
    """`name`, made longer until nothing else is called so."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _substituted(
    specification: Specification, families: Mapping[str, tuple[str, ...]], sides: Mapping[str, tuple[str, ...]]
) -> Specification:
    """The specification with every proposition replaced by the conjunction of its sides."""
    if specification.automaton is not None:
        return Specification(automaton=with_sides(specification.automaton, sides))
    formula = _in_formula(parse_formula(specification.formula or ""), families, sides)
    return Specification(str(formula), specification.semantics)


def _in_formula(
    formula: Formula, families: Mapping[str, tuple[str, ...]], sides: Mapping[str, tuple[str, ...]]
) -> Formula:
    if formula.operator == "atom":
        return _joined("&", [Formula("atom", name=side) for side in sides[formula.name]])
    if formula.operator in ("all", "any"):
        members = [_in_formula(Formula("atom", name=member), families, sides) for member in families[formula.name]]
        return _joined("&" if formula.operator == "all" else "|", members)
    operands = [_in_formula(part, families, sides) for part in formula.operands]
    if formula.operator in ("&", "|"):
        return _joined(formula.operator, operands)
    return replace(formula, operands=tuple(operands), text="")


def _joined(operator: str, operands: list[Formula]) -> Formula:
    """Conjunction or disjunction, without parentheses around operands of the same kind."""
    flat: list[Formula] = []
    for operand in operands:
        flat += operand.operands if operand.operator == operator else (operand,)
    return flat[0] if len(flat) == 1 else Formula(operator, tuple(flat))
