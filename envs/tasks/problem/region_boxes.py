"""Regions of any shape, put into boxes: each agent gets an output for each form that its shapes have limits on.

A piece of a shape is a box in the outputs of the agent: its own limits along the forms, and along all other outputs
ends beyond what they are anywhere in the workspace. What is made of several pieces, by union, intersection or
complement, is a formula of them, which takes its place where the automaton of the task reads letters. So letters, runs
and verdicts are those of the shapes as they are written (docs/theory/regions.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ...systems.agents import MOST_OUTPUTS, Agent, AnyAgent, LinearAgent, with_expressions, with_matrices
from ...systems.arguments import shown
from ...systems.expressions import Name
from ..automata import Formula
from ..regions import Combined, Form, Frame, Limit, Pair, Piece, Proposition, of_hint
from .families import AnyProposition

SPARE = 1000.0
"""How far ends that restrict nothing lie beyond what an output is in the workspace, in sizes of its numbers.

They are never met, and so far out that no proof pays for keeping away from them, and no search goes by them.
"""

Ends = tuple[list[float | str], list[float | str]]


@dataclass(frozen=True, eq=False)
class Regions:
    """What the propositions of a problem are, as boxes.

    Attributes
    ----------
    agents : tuple of AnyAgent
        With the outputs that boxes need.
    boxes : mapping from str to Proposition or Pair
        The propositions that automaton and labelling read.
    meanings : mapping from str to Formula
        Of those that were written and are no box themselves: a formula of `boxes`.
    pieces : mapping from str to Piece
        Shapes of `boxes` that come from shapes, for pictures.
    """

    agents: tuple[AnyAgent, ...]
    boxes: Mapping[str, AnyProposition]
    meanings: Mapping[str, Formula] = field(default_factory=dict)
    pieces: Mapping[str, Piece] = field(default_factory=dict)


def regions_of(
    agents: Sequence[AnyAgent],
    written: Mapping[str, AnyProposition],
    families: Mapping[str, tuple[str, ...]],
    horizon: int,
) -> Regions:
    """Return propositions without `*` as boxes, and the agents with the outputs that they are about.

    Raises
    ------
    ValueError
        If a shape does not suit its agent, names what is not there, or goes round in a circle.
    """
    by_name = {agent.name: agent for agent in agents}
    _check_compared(written, by_name)
    shaped = {p.agent for p in written.values() if isinstance(p, Proposition) and p.shape is not None}
    between = {
        name: _Between.of(name, pair, by_name, horizon)
        for name, pair in written.items()
        if isinstance(pair, Pair) and pair.shape is not None
    }
    shaped |= {agent for one in between.values() for agent in one.agents}
    if not shaped:
        return Regions(tuple(agents), dict(written))
    reader = _Reader(written, families, {agent.name: agent for agent in agents if agent.name in shaped}, horizon)
    for name, proposition in written.items():
        if isinstance(proposition, Proposition) and proposition.shape is not None:
            reader.read(name)
    made = {}
    for agent in (agent for agent in agents if agent.name in shaped):
        compared = [form for one in between.values() for form in one.forms(agent.name)]
        made[agent.name] = _with_forms(agent, list(dict.fromkeys([*reader.forms(agent.name), *compared])))
    boxes: dict[str, AnyProposition] = {}
    for name, proposition in written.items():
        if name in between:
            boxes[name] = between[name].box(name, made)
        elif isinstance(proposition, Pair) or proposition.agent not in made:
            boxes[name] = proposition
        elif proposition.shape is None:
            boxes[name] = made[proposition.agent].widened(name, proposition)
        for part in reader.parts.get(name, ()):
            assert isinstance(proposition, Proposition)
            boxes[part] = made[proposition.agent].box(part, reader.pieces[part])
    members = tuple(made[agent.name].agent if agent.name in made else agent for agent in agents)
    return Regions(members, boxes, reader.meanings, reader.pieces)


def _check_compared(written: Mapping[str, AnyProposition], agents: Mapping[str, AnyAgent]) -> None:
    """Raise ValueError if a pair names outputs by numbers that its agents have not."""
    for name, pair in written.items():
        if isinstance(pair, Pair) and pair.outputs is not None:
            for agent, axes in zip((agents[str(own)] for own in pair.agents), pair.outputs, strict=True):
                last = max((k for k in axes if not isinstance(k, str)), default=-1)
                if last >= agent.n_outputs:
                    wanted = f"outputs of {agent.name} below {agent.n_outputs}"
                    raise ValueError(f"`propositions.{name}`: expected {wanted}, got {last}")


@dataclass(frozen=True, eq=False)
class _Between:
    """A flat shape that the difference of two agents is in: the limits, and the form of either agent for each.

    The difference of a linear form of both is that form of the difference, so that the shape is a box like others.
    """

    agents: tuple[str, str]
    limits: tuple[Limit, ...]
    sides: tuple[tuple[Form, ...], tuple[Form, ...]]

    @classmethod
    def of(cls, name: str, pair: Pair, agents: Mapping[str, AnyAgent], horizon: int) -> _Between:
        """Read the shape of a pair; ValueError if it does not suit the agents."""
        assert pair.shape is not None and isinstance(pair.agents, tuple)
        first, second = (agents[agent] for agent in pair.agents)
        count = len(pair.of_states or range(min(first.n_states, second.n_states)))
        try:
            states = []
            for agent in (first, second):
                low, high = tuple(agent.state_low.tolist()), tuple(agent.state_high.tolist())
                states.append(Frame(agent.state_names, low, high).states(pair.of_states, count))
            (a, b) = (list(own) for own in states)
            least, most = first.state_low[a] - second.state_high[b], first.state_high[a] - second.state_low[b]
            piece = pair.shape.combined(Frame((), tuple(least.tolist()), tuple(most.tolist()), times=horizon + 1)).piece
            if piece is None or not all(limit.form.row for limit in piece.limits):
                raise ValueError("expected a shape with flat faces, got one that is round, or wider than half a turn")
        except ValueError as error:
            raise ValueError(_of(name, error)) from None
        frames = [Frame((), (0.0,) * agent.n_states, (0.0,) * agent.n_states) for agent in (first, second)]
        rows = [limit.form.row for limit in piece.limits]
        forms = [tuple(Form(frame.row(own, row)) for row in rows) for frame, own in zip(frames, states, strict=True)]
        return cls(pair.agents, piece.limits, (forms[0], forms[1]))

    def forms(self, agent: str) -> tuple[Form, ...]:
        """Return the forms of an agent that are compared."""
        return self.sides[self.agents.index(agent)] if agent in self.agents else ()

    def box(self, name: str, made: Mapping[str, _Fitted]) -> Pair:
        """Return the pair as a box in outputs of both agents."""
        first, second = (made[agent] for agent in self.agents)
        places = [[own.places[form] for form in forms] for own, forms in zip((first, second), self.sides, strict=True)]
        low: list[float | str] = []
        high: list[float | str] = []
        for limit, k, m in zip(self.limits, *places, strict=True):
            # Ends that restrict nothing lie beyond all differences.
            low.append(first.ends[0][k] - second.ends[1][m] if limit.low is None else limit.low)
            high.append(first.ends[1][k] - second.ends[0][m] if limit.high is None else limit.high)
        try:
            return Pair(self.agents, low, high, outputs=places)
        except ValueError as error:
            raise ValueError(f"`propositions.{name}`: {error}") from None


def _frame(agent: AnyAgent, proposition: Proposition, horizon: int) -> Frame:
    """Return what a proposition is a region of: the states of its agent, and outputs if it names some."""
    angles = frozenset(np.flatnonzero(agent.wrapped_axes).tolist())
    low, high = tuple(agent.state_low.tolist()), tuple(agent.state_high.tolist())
    frame = Frame(agent.state_names, low, high, angles, horizon + 1, proposition.of_states)
    named = {*proposition.named_states} - {*agent.state_names}
    others = _other_outputs(agent)
    if not named & {agent.output_names[k] for k in others}:
        return frame
    ends = [end[list(others)].tolist() for end in agent.output_ends]
    return frame.with_outputs([agent.output_names[k] for k in others], *ends)


def _other_outputs(agent: AnyAgent) -> tuple[int, ...]:
    """Return which outputs have names, and are no states: shapes that name some have them behind the states."""
    axes = [agent.output_axis(k) for k in range(len(agent.output_names))]
    return tuple(k for k, axis in enumerate(axes) if axis is None or axis[1] != 1.0)


class _Reader:
    """Shapes read one after the other: which pieces they have, and what they mean."""

    def __init__(
        self,
        written: Mapping[str, AnyProposition],
        families: Mapping[str, tuple[str, ...]],
        agents: Mapping[str, AnyAgent],
        horizon: int,
    ) -> None:
        self._written, self._families = written, families
        self._agents, self._horizon = agents, horizon
        self._taken = {*written, *families}
        self._open: list[str] = []
        self._known: dict[str, Formula] = {}
        self.meanings: dict[str, Formula] = {}
        self.pieces: dict[str, Piece] = {}
        self.parts: dict[str, list[str]] = {}

    def forms(self, agent: str) -> list[Form]:
        """Return the forms that the pieces of an agent have limits on, each once."""
        own = [part for name, parts in self.parts.items() if self._written[name].agent == agent for part in parts]
        return list(dict.fromkeys(limit.form for part in own for limit in self.pieces[part].limits))

    def read(self, name: str) -> Formula:
        """Return what a proposition means, as a formula of boxes."""
        proposition = self._written[name]
        if not isinstance(proposition, Proposition) or proposition.shape is None:
            return Formula("atom", name=name)
        if name in self._open:
            circle = " -> ".join([*self._open[self._open.index(name) :], name])
            raise ValueError(f"`propositions.{name}`: expected a shape made of others, got itself again: {circle}")
        if name not in self._known:
            self._open.append(name)
            try:
                whole = proposition.shape.combined(_frame(self._agents[proposition.agent], proposition, self._horizon))
                meaning = self._formula(name, whole, whole)
            except ValueError as error:
                raise ValueError(_of(name, error)) from None
            self._open.pop()
            self._known[name] = meaning
            if meaning != Formula("atom", name=name):
                self.meanings[name] = meaning
        return self._known[name]

    def _formula(self, owner: str, node: Combined, whole: Combined) -> Formula:
        if node.kind == "name":
            return self.read(self._named(owner, node.name))
        if node.piece is not None:
            part = owner if node is whole else self._fresh(owner)
            self.pieces[part] = node.piece
            self.parts.setdefault(owner, []).append(part)
            return Formula("atom", name=part)
        operator = {"and": "&", "or": "|", "not": "!"}[node.kind]
        return Formula(operator, tuple(self._formula(owner, part, whole) for part in node.parts))

    def _named(self, owner: str, name: str) -> str:
        """Return the proposition that a shape names; of a family the member of the same agent."""
        agent = self._written[owner].agent
        for member in self._families.get(name, (name,)):
            proposition = self._written.get(member)
            if isinstance(proposition, Proposition) and proposition.agent == agent:
                return member
        if name in self._written or name in self._families:
            raise ValueError(
                f"expected names of propositions of agent {agent}, got {shown(name)}, which is about others; write "
                "`a | b` in the formula"
            )
        own = [key for key, p in self._written.items() if isinstance(p, Proposition) and p.agent == agent]
        raise ValueError(f"expected names of propositions, got {shown(name)}; agent {agent} has {', '.join(own[:8])}")

    def _fresh(self, owner: str) -> str:
        number = 1 + len(self.parts.get(owner, ()))
        while (name := f"{owner}_{number}") in self._taken:
            number += 1
        self._taken.add(name)
        return name


def _of(name: str, error: ValueError) -> str:
    said = str(error)
    return said if said.startswith("`propositions.") else f"`propositions.{name}`: {said}"


@dataclass(frozen=True, eq=False)
class _Fitted:
    """An agent with the outputs that its shapes need: which output each form is, and ends beyond all of them."""

    agent: AnyAgent
    places: Mapping[Form, int]
    ends: tuple[list[float], list[float]]
    n_given: int

    def box(self, name: str, piece: Piece) -> Proposition:
        """Return a piece as a box."""
        low: list[float | str] = [*self.ends[0]]
        high: list[float | str] = [*self.ends[1]]
        for limit in piece.limits:
            k = self.places[limit.form]
            low[k] = low[k] if limit.low is None else limit.low
            high[k] = high[k] if limit.high is None else limit.high
            self._check(name, limit, k)
        try:
            return Proposition(self.agent.name, low, high)
        except ValueError as error:
            raise ValueError(f"`propositions.{name}`: {error}") from None

    def _check(self, name: str, limit: Limit, k: int) -> None:
        """Raise ValueError if a face has the whole workspace on its outer side."""
        least, most = self.ends[0][k], self.ends[1][k]
        low, high = limit.low, limit.high
        if (isinstance(low, float) and low >= most) or (isinstance(high, float) and high <= least):
            raise ValueError(
                f"`propositions.{name}`: expected a region that meets the workspace of agent {self.agent.name}, got a "
                f"face that has all of it outside; correct the region or the workspace"
            )

    def widened(self, name: str, region: Proposition) -> Proposition:
        """Return a box that was written over the agent's own outputs as one over all of them."""
        count, own = region.size, self.agent.n_outputs - self.agent.added_outputs
        if count not in (own, self.n_given):
            raise ValueError(
                f"`propositions.{name}`: expected corners of length {own} (outputs of agent {self.agent.name}), got "
                f"length {count}{of_hint(self.agent, count)}"
            )
        low, high = (region.low.tolist(), region.high.tolist()) if region.corners is None else region.corners
        return Proposition(region.agent, [*low, *self.ends[0][count:]], [*high, *self.ends[1][count:]])


def _with_forms(agent: AnyAgent, forms: Sequence[Form]) -> _Fitted:
    """Return an agent with an output for each form: one that it has, or one more."""
    fitted: AnyAgent
    if agent.is_affine and all(form.row for form in forms):
        fitted, places = _with_rows(with_matrices(agent), forms)
    else:
        fitted, places = _with_texts(symbolic_linear(agent), forms)
    low, high = (end[0] for end in fitted.output_range(fitted.state_low[None], fitted.state_high[None]))
    if not np.all(np.isfinite(low) & np.isfinite(high)):
        k = int(np.argmin(np.isfinite(low) & np.isfinite(high)))
        raise ValueError(
            f"`outputs[{k}]`: expected outputs with bounds in the whole workspace beside regions of shapes, got one of "
            f"agent {agent.name} without; take smaller workspaces, or outputs that are defined everywhere"
        )
    spare = SPARE * (1.0 + np.abs(low) + np.abs(high))
    return _Fitted(fitted, places, ((low - spare).tolist(), (high + spare).tolist()), agent.n_outputs)


def _with_rows(agent: LinearAgent, forms: Sequence[Form]) -> tuple[LinearAgent, dict[Form, int]]:
    """Return a linear agent with rows for linear forms; it stays one."""
    rows = [tuple(row) for row in agent.output_matrix.tolist()]
    own = len(rows)
    places: dict[Form, int] = {}
    for form in forms:
        if form.row not in rows:
            rows.append(form.row)
        places[form] = rows.index(form.row)
    if len(rows) == own:
        return agent, places
    return agent.replace(output_matrix=rows, added_outputs=agent.added_outputs + len(rows) - own), places


def _with_texts(agent: Agent, forms: Sequence[Form]) -> tuple[Agent, dict[Form, int]]:
    """Return an agent with expressions for forms."""
    texts = list(agent.output_expressions)
    own, others = len(texts), _other_outputs(agent)
    names = (*agent.states, *(f"({texts[k]})" for k in others))
    # What outputs are that the agent has: states, and others that have their expressions as names.
    known = {f"({texts[k]})": k for k in others}
    for k in reversed(range(own)):
        known |= {axis: k for axis in agent.states if agent.output_trees[k] == Name(axis)}
    places: dict[Form, int] = {}
    for form in forms:
        text = form.text(names[: form.size])
        if text in known:
            places[form] = known[text]
            continue
        if text not in texts[own:]:
            texts.append(text)
        places[form] = own + texts[own:].index(text)
    if len(texts) == own:
        return agent, places
    if len(texts) > MOST_OUTPUTS:
        raise ValueError(
            f"`propositions`: expected shapes of agent {agent.name} with up to {MOST_OUTPUTS - own} different faces, "
            f"got {len(texts) - own}; take fewer"
        )
    return agent.replace(outputs=texts, added_outputs=agent.added_outputs + len(texts) - own), places


def symbolic_linear(agent: AnyAgent) -> Agent:
    """Return a linear agent as one with expressions: the same mean, noise, boxes and start; others as they are."""
    if not agent.is_affine:
        return with_expressions(agent)
    agent = with_matrices(agent)
    states = _fresh("x", agent.state_names, agent.n_states, agent.input_names)
    inputs = _fresh("u", agent.input_names, agent.n_inputs, states)
    data = {key: value for key, value in agent.to_dict().items() if key not in _MATRICES}
    texts = []
    for row, of_inputs, offset in zip(agent.A.tolist(), agent.B.tolist(), agent.offset.tolist(), strict=True):
        texts.append(_affine([*row, *of_inputs], [*states, *inputs], offset))
    outputs = [_affine(row, states, 0.0) for row in agent.output_matrix.tolist()]
    return Agent(**data, states=states, inputs=inputs, dynamics=texts, outputs=outputs)


def _fresh(letter: str, given: Sequence[str], count: int, taken: Sequence[str]) -> list[str]:
    """Return the names that are given, or numbered letters that are not taken."""
    while any(f"{letter}{k}" in taken for k in range(count)):
        letter += "_"
    return [*given] if given else [f"{letter}{k}" for k in range(count)]


_MATRICES = ("A", "B", "offset", "output_matrix", "states", "inputs")
"""What expressions say instead."""


def _affine(row: Sequence[float], names: Sequence[str], offset: float) -> str:
    """Return an affine form as an expression (exact)."""
    terms = [(a, name if abs(a) == 1.0 else f"{abs(a)!r}*{name}") for a, name in zip(row, names, strict=True) if a]
    terms += [(offset, repr(abs(offset)))] if offset or not terms else []
    first, *rest = terms
    text = f"-{first[1]}" if first[0] < 0 else first[1]
    return text + "".join(f" {'-' if a < 0 else '+'} {term}" for a, term in rest)
