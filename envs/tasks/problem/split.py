"""Agents with independent axes, split into agents of fewer states.

The matrices of an agent may decompose into blocks of axes: the state matrix, the covariance, the rows of the output
matrix, and the columns of the input matrix. (Input set, workspace and start are boxes, so they always decompose.) Then
each block can be an agent by itself: a robot in the plane becomes one that moves along x and one that moves along y.
`split_axes` states the same problem in these terms. A box region becomes the conjunction of its sides, and a union of
boxes becomes the disjunction of such conjunctions.

The split problem has the states, noise, letters and outcome of the original, with the components in another order
(`axis_order`). Under the same inputs both succeed in the same runs, so **a bound certified for the split problem holds
for the original**, with controllers that act on each block by the state of the block, the shared automaton state and
the time. These are fewer policies than those of the whole agent: its x input may depend on its y position, that of a
split agent may not. The gain is in size: two axes of n cells each instead of n * n cells.

The components stay in agent order, and blocks in the order of their first components; within a block nothing moves. So
the joint state keeps its order unless the blocks of an agent interleave.

Reference: docs/theory/setting.md, "Agents": any partition of the components into independent ones may be the agents.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ...systems.agents import AnyAgent, LinearAgent, with_matrices
from ..automata import Formula, parse_formula, with_sides
from ..regions import REFUSAL, Proposition
from .joint_noise import refuse_joint_noise
from .record import Problem, checked_problem
from .specification import Specification

Block = tuple[list[int], list[int], list[int]]
"""Components of the state, inputs that act on them, and rows of the output matrix that read them."""


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
        If `problem` is not a Problem.

    Examples
    --------
    >>> from certigym import make_problem
    >>> planar = split_axes(make_problem("package-delivery-single-v0"))
    >>> planar.agent_names, planar.specification.formula
    (('robot_0_x0', 'robot_0_x1'), 'F (p1_x0 & p1_x1 & !(p2_x0 & p2_x1) U (p3_x0 & p3_x1))')
    """
    if checked_problem(problem).labeling.pairs:
        raise ValueError(REFUSAL)
    refuse_joint_noise(problem)
    blocks = [_blocks(agent) for agent in problem.agents]
    if all(len(agent_blocks) == 1 for agent_blocks in blocks):
        return problem
    _refuse_shapes(problem)
    # Agents of several blocks are replaced by one agent per block.
    taken = set(problem.agent_names)
    agents: list[AnyAgent] = []
    pieces: dict[str, tuple[AnyAgent, list[Block], list[AnyAgent]]] = {}
    for agent, agent_blocks in zip(problem.agents, blocks, strict=True):
        replacements: list[AnyAgent] = [agent]
        if len(agent_blocks) > 1:
            agent = with_matrices(agent)
            replacements = [_agent_of_block(agent, block, taken) for block in agent_blocks]
        pieces[agent.name] = agent, agent_blocks, replacements
        agents += replacements
    # Every region is replaced by its sides; the formula then asks for all of them.
    propositions: dict[str, Proposition] = {}
    side_names: dict[str, tuple[str, ...]] = {}
    taken = set(problem.propositions)
    for name, proposition in problem.propositions.items():
        assert isinstance(proposition, Proposition)  # pairs were refused
        sides = _sides(*pieces[proposition.agent], proposition)
        names = [name] if len(sides) == 1 else [_fresh(f"{name}_{_axes(block)}", taken) for block, _ in sides]
        side_names[name] = tuple(names)
        propositions |= {side_name: side for side_name, (_, side) in zip(names, sides, strict=True)}
    return Problem(
        name=problem.name,
        horizon=problem.horizon,
        agents=agents,
        propositions=propositions,
        specification=_substituted(problem.specification, problem.families, side_names),
    )


def _refuse_shapes(problem: Problem) -> None:
    """Raise ValueError if a region is no box of states or outputs that its agent has."""
    changed = {own.name for own, was in zip(problem.agents, problem.written_agents, strict=True) if own is not was}
    for name, region in problem.written.items():
        about = region.agent if isinstance(region, Proposition) and region.shape else None
        if about is not None and (about in changed or name in problem.meanings or problem.pieces[name].by_time):
            raise ValueError(
                f"`problem`: expected regions with `low` and `high` alone, got the shape `{name}`; write boxes, or "
                "leave the agents whole"
            )


def axis_order(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return the positions, in the original problem, of the components of the split one.

    Returns
    -------
    states : np.ndarray of int, shape (D,)
        ``x_split = x[states]`` for joint states in agent order; the noise likewise.
    inputs : np.ndarray of int
        ``u_split = u[inputs]`` for joint inputs in agent order. An entry of -1 marks an axis that no input moves; its
        input is 0.

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
        for components, block_inputs, _ in _blocks(agent):
            states += [first_state + k for k in components]
            inputs += [first_input + k for k in block_inputs] or [-1]
        first_state, first_input = first_state + agent.n_states, first_input + agent.n_inputs
    return np.array(states), np.array(inputs)


def _blocks(agent: AnyAgent) -> list[Block]:
    """Return the finest blocks that no matrix couples, in the order of their first components.

    Agents whose dynamics are expressions are left whole.
    """
    d = agent.n_states
    if not agent.is_affine:
        return [(list(range(d)), list(range(agent.n_inputs)), list(range(agent.n_outputs)))]
    agent = with_matrices(agent)
    # Two components are linked if an entry of A or of the covariance couples them, or if one input acts on both or one
    # output reads both.
    linked = (agent.A != 0) | (agent.noise_covariance != 0) | (agent.noise_axes != 0)
    for columns in (agent.B.T, agent.output_matrix):
        for row in columns != 0:
            linked |= row[:, None] & row[None]
    linked |= linked.T | np.eye(d, dtype=bool)
    # The blocks are the connected components; d squarings close the relation.
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
    """Return the group that holds the nonzero components of a row; the first group for a row of zeros."""
    used = np.flatnonzero(row)
    return groups[0] if used.size == 0 else next(group for group in groups if int(used[0]) in group)


def _agent_of_block(agent: LinearAgent, block: Block, taken: set[str]) -> LinearAgent:
    """Return the agent of one block; a block without inputs gets one that is 0."""
    components, inputs, outputs = block
    start = agent.initial
    # Rows and columns of the block are cut out of every matrix; no other entry of these rows is nonzero.
    return LinearAgent(
        name=_fresh(f"{agent.name}_{_axes(block)}", taken),
        A=agent.A[np.ix_(components, components)],
        B=agent.B[np.ix_(components, inputs)] if inputs else np.zeros((len(components), 1)),
        **_noise(agent, components),
        state_low=agent.state_low[components],
        state_high=agent.state_high[components],
        input_low=agent.input_low[inputs] if inputs else [0.0],
        input_high=agent.input_high[inputs] if inputs else [0.0],
        initial_low=start.low[components],
        initial_high=start.high[components],
        output_matrix=_output(agent, block) if outputs else None,
        offset=agent.offset[components],
        states=[agent.state_names[k] for k in components] if agent.state_names else None,
    )


def _noise(agent: LinearAgent, components: list[int]) -> dict[str, Any]:
    """Return the noise of a block: no entry of covariance or axes links it to another one."""
    square = np.ix_(components, components)
    if agent.laws is None:
        return {"noise_covariance": agent.noise_covariance[square]}
    return {"noise": [agent.laws[k] for k in components], "noise_axes": agent.noise_axes[square]}


def _output(agent: LinearAgent, block: Block) -> np.ndarray:
    """Return the output matrix of a block, doubled where it would become the identity.

    The regions of an agent with `y = x` are closed at the upper edge of the workspace, those of other agents are not.
    If the agent's output matrix is not the identity but that of the block would be, outputs and regions are doubled:
    that is exact, and keeps the regions half-open.
    """
    components, _, outputs = block
    return agent.output_matrix[np.ix_(outputs, components)] * _scale(agent, block)


def _scale(agent: AnyAgent, block: Block) -> float:
    """Return the factor on outputs and regions of a block, 1 or 2."""
    agent = with_matrices(agent)
    components, _, outputs = block
    block_matrix = agent.output_matrix[np.ix_(outputs, components)]
    return 2.0 if not agent.has_identity_output and np.array_equal(block_matrix, np.eye(len(components))) else 1.0


def _sides(
    agent: AnyAgent, blocks: list[Block], replacements: list[AnyAgent], proposition: Proposition
) -> list[tuple[Block, Proposition]]:
    """Return the sides of a region on the blocks of its agent, without those that hold in the whole workspace."""
    sides = []
    for block, replacement in zip(blocks, replacements, strict=True):
        rows = block[2]
        if rows:
            scale = _scale(agent, block) if len(blocks) > 1 else 1.0
            side = Proposition(replacement.name, proposition.low[rows] * scale, proposition.high[rows] * scale)
            sides.append((block, side))
    if not agent.has_identity_output:
        return sides
    # With y = x the workspace can be compared with the side. One side stays even if none restricts anything.
    restricting = [
        (block, side)
        for block, side in sides
        if np.any(side.low > agent.state_low[block[0]]) or np.any(side.high < agent.state_high[block[0]])
    ]
    return restricting or sides[:1]


def _axes(block: Block) -> str:
    """Return the components of a block as they appear in names."""
    return "_".join(f"x{k}" for k in block[0])


def _fresh(name: str, taken: set[str]) -> str:
    """Return `name`, with underscores added until it is not taken, and note it as taken."""
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _substituted(
    specification: Specification, families: Mapping[str, tuple[str, ...]], sides: Mapping[str, tuple[str, ...]]
) -> Specification:
    """Return the specification with every proposition replaced by the conjunction of its sides."""
    if specification.automaton is not None:
        return Specification(automaton=with_sides(specification.automaton, sides))
    formula = _in_formula(parse_formula(specification.formula or ""), families, sides)
    return Specification(str(formula), specification.semantics)


def _in_formula(
    formula: Formula, families: Mapping[str, tuple[str, ...]], sides: Mapping[str, tuple[str, ...]]
) -> Formula:
    """Return the formula with every atom replaced by the conjunction of its sides, and families written out."""
    if formula.operator == "atom":
        return _joined("&", [Formula("atom", name=side) for side in sides[formula.name]])
    if formula.operator in ("all", "any"):
        members = [_in_formula(Formula("atom", name=member), families, sides) for member in families[formula.name]]
        return _joined("&" if formula.operator == "all" else "|", members)
    operands = [_in_formula(operand, families, sides) for operand in formula.operands]
    if formula.operator in ("&", "|"):
        return _joined(formula.operator, operands)
    return replace(formula, operands=tuple(operands), text="")


def _joined(operator: str, operands: list[Formula]) -> Formula:
    """Return a conjunction or disjunction, without parentheses around operands of the same kind."""
    # `a & (b & c)` would print its parentheses and hide that it is one conjunction.
    flat: list[Formula] = []
    for operand in operands:
        flat += operand.operands if operand.operator == operator else (operand,)
    return flat[0] if len(flat) == 1 else Formula(operator, tuple(flat))
