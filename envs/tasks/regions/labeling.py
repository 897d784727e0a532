"""Which propositions hold where: simulator, first letter and synthesizer all use the one decision of membership here.

A proposition is a box in the output space of one agent, or for the difference of two agents' outputs (`Pair`). A
*class* of an agent is the set of its own propositions that hold at a point; a *letter* is one class per agent, and the
pairs that hold. Rules:

- the workspace is closed: `low <= x <= high`;
- a region is half-open: `low <= y < high`, so that neighbours share no point;
- with `C = I`, a region that reaches the upper edge of the workspace is closed there (its upper bound becomes
  infinite: leaving the workspace is decided separately, and first); outputs that were added for shapes change nothing
  of this;
- a region may move with the time; at each time the rules above hold for where it is then;
- the box of a pair is half-open: `low <= y_a - y_b < high`, the difference as floating point computes it;
- where exits are read as letters (opposite tasks), no proposition of an agent holds outside its workspace.

Reference: docs/theory/setting.md, "Letters and words".
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...systems.agents import AnyAgent
from ...systems.arguments import counted, names_text, read_only, tree_text
from .pair import REFUSAL, Pair, PairRegion, holds, pair_region
from .proposition import Proposition

MOVING_REFUSAL = (
    "`problem`: expected regions that stand still, got some whose corners name the time `t`; ask the labelling `at` a "
    "time, and certify with the relation `path`, or `boxes`"
)
"""What is said where regions that move are not understood."""

MOST_TIMES = 2048
"""Times of which the regions are remembered: beyond them the memory starts afresh."""


def inside(x: Any, low: Any, high: Any) -> Any:
    """Return whether points lie in a closed box (exact; NaN lies nowhere).

    Parameters
    ----------
    x, low, high : sequence of components
        An array with the components on axis 0, or a tuple of numbers: the same rule for a batch and for one point.
    """
    result = (low[0] <= x[0]) & (x[0] <= high[0])
    for k in range(1, len(x)):
        result = result & (low[k] <= x[k]) & (x[k] <= high[k])
    return result


def contains(y: Any, low: Any, high: Any) -> Any:
    """Return whether points lie in a half-open box `low <= y < high` (exact); components as in `inside`."""
    result = (low[0] <= y[0]) & (y[0] < high[0])
    for k in range(1, len(y)):
        result = result & (low[k] <= y[k]) & (y[k] < high[k])
    return result


def at_the_edge(agent: AnyAgent, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return corners (p, S) of regions, infinite where the upper edge of the workspace decides: with y = x.

    A region that reaches it is closed there; one that begins there, as it may where it moves, holds nowhere.
    """
    # The faces of outputs that were added have no edge of the workspace.
    edge = np.full((len(low), 1), np.inf)
    edge[: agent.state_outputs, 0] = agent.state_high[: agent.state_outputs]
    return np.where(low >= edge, np.inf, low), np.where((high >= edge) & (low < high), np.inf, high)


class _NoCorners:
    """What stands in the place of corners that depend on the time: whoever reads it is told so."""

    def _refused(self, *_: Any) -> Any:
        raise ValueError(MOVING_REFUSAL)

    __getitem__ = __iter__ = __len__ = _refused

    def __reduce__(self) -> tuple[Any, ...]:
        return _NoCorners, ()


_NO_CORNERS: Any = _NoCorners()


@dataclass(frozen=True, eq=False, repr=False)
class Labeling:
    """The labelling of one problem: its propositions, agent by agent, and their regions; then those about pairs.

    Attributes
    ----------
    agents : tuple of AnyAgent
    names : tuple of str
        Propositions, agent by agent; those about pairs come last.
    agent_propositions : tuple of np.ndarray of int
        Per agent: positions of its propositions in `names`.
    low, high : tuple of np.ndarray, shape (p_i, P_i)
        Per agent: corners of its regions; the upper ones are infinite where a region is closed at the workspace edge.
    pairs : tuple of PairRegion
        Propositions about two agents, in the order of the last names.
    moving : mapping from str to Proposition
        All propositions of single agents, if a region of one of them moves with the time; empty otherwise. Then there
        are no corners here, and whoever asks for them, or for letters, gets a ValueError: `at` a time there are.
    reads_exits : bool
        Whether agents have a class outside their workspaces, too: the last one, in which nothing holds.
    """

    agents: tuple[AnyAgent, ...]
    names: tuple[str, ...]
    agent_propositions: tuple[np.ndarray, ...]
    low: tuple[np.ndarray, ...]
    high: tuple[np.ndarray, ...]
    pairs: tuple[PairRegion, ...] = ()
    moving: Mapping[str, Proposition] = field(default_factory=dict)
    reads_exits: bool = False
    _known: dict[int, Labeling] = field(default_factory=dict)

    @classmethod
    def of(cls, agents: Sequence[AnyAgent], propositions: Mapping[str, Proposition | Pair]) -> Labeling:
        """Return the labelling for propositions without `*`, ordered agent by agent, then as declared."""
        by_name = {agent.name: agent for agent in agents}
        for name, proposition in propositions.items():
            if isinstance(proposition, Proposition):
                _check_region(name, proposition, by_name)
        return cls._of(agents, propositions)

    @classmethod
    def _of(cls, agents: Sequence[AnyAgent], propositions: Mapping[str, Proposition | Pair]) -> Labeling:
        """Return the labelling for regions that may lie beyond workspaces, or be empty."""
        names_of: dict[str, list[str]] = {agent.name: [] for agent in agents}
        of_pairs = {name: value for name, value in propositions.items() if isinstance(value, Pair)}
        of_agents = {name: value for name, value in propositions.items() if isinstance(value, Proposition)}
        for name, proposition in of_agents.items():
            names_of[proposition.agent].append(name)
        moving = of_agents if any(proposition.moves for proposition in of_agents.values()) else {}
        names: list[str] = []
        positions: list[np.ndarray] = []
        lows: list[np.ndarray] = []
        highs: list[np.ndarray] = []
        for agent in agents:
            agent_names = names_of[agent.name]
            positions.append(read_only(np.arange(len(names), len(names) + len(agent_names))))
            names.extend(agent_names)
            if moving:
                continue
            # The shape is spelled out for agents without propositions.
            shape = (len(agent_names), agent.n_outputs)
            low = np.array([of_agents[name].low for name in agent_names]).reshape(shape).T
            high = np.array([of_agents[name].high for name in agent_names]).reshape(shape).T
            for corners, own in zip((lows, highs), at_the_edge(agent, low, high), strict=True):
                corners.append(read_only(own))
        pairs = tuple(pair_region(name, pair, agents) for name, pair in of_pairs.items())
        first, last = (_NO_CORNERS if moving else tuple(corners) for corners in (lows, highs))
        return cls(tuple(agents), (*names, *of_pairs), tuple(positions), first, last, pairs, moving)

    @property
    def moves(self) -> bool:
        """Whether a region, or a pair, moves with the time."""
        return bool(self.moving) or any(pair.moves for pair in self.pairs)

    def at(self, time: int) -> Labeling:
        """Return the labelling with the regions and pairs of a time; itself if all of them stand still.

        Raises
        ------
        ValueError
            If a corner is not finite at this time.
        """
        if not self.moves:
            return self
        if time not in self._known:
            if len(self._known) >= MOST_TIMES:
                self._known.clear()
            still = {name: proposition.at(time) for name, proposition in self.moving.items()}
            here = Labeling._of(self.agents, still) if still else self
            pairs = tuple(pair.at(time) for pair in self.pairs)
            self._known[time] = replace(here, names=self.names, pairs=pairs, reads_exits=self.reads_exits, _known={})
        return self._known[time]

    def corners_over(self, agent: int, n_times: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the corners of the regions of an agent at times 0, 1, ...: two arrays (n_times, p, P_i).

        They are those of `at`, bit by bit.
        """
        names = [self.names[k] for k in self.agent_propositions[agent]]
        shape = (self.agents[agent].n_outputs, n_times, len(names))
        low, high = np.empty(shape), np.empty(shape)
        for k, name in enumerate(names):
            low[..., k], high[..., k] = self.moving[name].over(np.arange(n_times, dtype=float))
        ends = at_the_edge(self.agents[agent], low.reshape(len(low), -1), high.reshape(len(low), -1))
        first, last = (corners.reshape(shape).swapaxes(0, 1) for corners in ends)
        return first, last

    @property
    def first_pair(self) -> int:
        """Position in `names` of the first proposition about a pair: the number of those about single agents."""
        return len(self.names) - len(self.pairs)

    @cached_property
    def owners(self) -> tuple[frozenset[int], ...]:
        """Per proposition: the agents that it is about, one or two."""
        single = [frozenset([i]) for i, own in enumerate(self.agent_propositions) for _ in own]
        return (*single, *(frozenset([pair.first, pair.second]) for pair in self.pairs))

    def without_pairs(self) -> Labeling:
        """Return the labelling of the propositions of single agents alone."""
        return replace(self, names=self.names[: self.first_pair], pairs=(), _known={})

    def __repr__(self) -> str:
        numbers = Counter(len(positions) for positions in self.agent_propositions)
        per_agent = ", ".join(f"{number} ({counted(n, 'agent')})" for number, n in numbers.most_common(3))
        rows = [
            ("agents", f"{len(self.agents)}: {names_text([agent.name for agent in self.agents])}"),
            ("propositions", f"{len(self.names)}: {names_text(self.names)}" if self.names else "none"),
            ("per agent", f"{per_agent}, ..." if len(numbers) > 3 else per_agent),
        ]
        return tree_text("Labeling", rows)

    def class_at(self, agent: int, x: np.ndarray) -> np.ndarray:
        """Return which propositions of one agent hold at points (exact up to rounding of C x).

        Parameters
        ----------
        agent : int
        x : np.ndarray, shape (d, *S)

        Returns
        -------
        np.ndarray of bool, shape (P_i, *S)
        """
        model = self.agents[agent]
        y = model.outputs(x)
        # Axes of length 1 let the corners broadcast against the trailing axes of x.
        extra = (1,) * (x.ndim - 1)
        low, high = self.low[agent], self.high[agent]
        return contains(y[:, None], low.reshape(low.shape + extra), high.reshape(high.shape + extra))

    def letter(self, states: Sequence[Any]) -> np.ndarray:
        """Return which propositions hold at one joint state, a sequence of vectors (d_i,): bool (P,)."""
        classes = [self.class_at(i, np.asarray(x, dtype=float)) for i, x in enumerate(states)]
        if self.pairs:
            outputs = [agent.outputs(np.asarray(x, dtype=float)) for agent, x in zip(self.agents, states)]
            near = [
                holds(p.difference(outputs[p.first], outputs[p.second]), p.low, p.high, p.radius) for p in self.pairs
            ]
            classes.append(np.array(near, dtype=bool))
        return np.concatenate(classes) if classes else np.zeros(0, dtype=bool)

    @cached_property
    def classes(self) -> tuple[np.ndarray, ...]:
        """Per agent: the classes that occur in its workspace, bool (n_classes_i, P_i), rows in lexicographic order.

        Exact for `C = I`; a superset otherwise. That of the outside comes last, where exits are read.

        Raises
        ------
        ValueError
            If there are propositions about pairs: whoever reasons agent by agent would pass them over.
        """
        if self.pairs:
            raise ValueError(REFUSAL)
        # Agents with equal regions, outputs and workspaces have equal classes: compute them once.
        computed: dict[tuple[bytes, ...], np.ndarray] = {}
        result = []
        for i, agent in enumerate(self.agents):
            corners = (self.low[i], self.high[i], agent.state_low, agent.state_high)
            key = (*agent.output_key, *(array.tobytes() for array in corners))
            if key not in computed:
                candidates, possible = self._reachable(i, agent.state_low[None], agent.state_high[None])
                outside = np.zeros((int(self.reads_exits), candidates.shape[1]), dtype=bool)
                computed[key] = read_only(np.concatenate([candidates[possible[0]], outside]))
            result.append(computed[key])
        return tuple(result)

    def box_classes(self, agent: int, low: Any, high: Any) -> np.ndarray:
        """Return which classes the points `low <= x < high` of the workspace can have: bool (S, n_classes_i).

        The result is exact for `C = I` and a superset otherwise. A flat axis (`low == high`) holds its one coordinate.

        Parameters
        ----------
        agent : int
        low, high : array_like, shape (S, d)
            Boxes in the state space; the part beyond the workspace is ignored, unless exits are read.
        """
        if self.pairs:
            raise ValueError(REFUSAL)
        low, high = np.atleast_2d(np.asarray(low, dtype=float)), np.atleast_2d(np.asarray(high, dtype=float))
        candidates, possible = self._reachable(agent, low, high)
        # Number the candidates as in `classes`; those that no box meets may be missing there.
        position = {row.tobytes(): c for c, row in enumerate(self.classes[agent])}
        result = np.zeros((len(low), len(position)), dtype=bool)
        for c, row in enumerate(candidates):
            if possible[:, c].any():
                result[:, position[row.tobytes()]] = possible[:, c]
        if self.reads_exits:
            # Half-open boxes hold the upper face of the workspace if they end at the next number.
            space = self.agents[agent].workspace
            result[:, -1] = np.any((low < space.low) | (high > np.nextafter(space.high, np.inf)), axis=1)
        return result

    def _reachable(self, agent: int, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return all classes of the arrangement of regions, and which of them each box meets: (K, P_i) and (S, K)."""
        n_boxes, n_propositions = len(low), self.low[agent].shape[1]
        classes = np.ones((1, n_propositions), dtype=bool)
        possible = np.ones((n_boxes, 1), dtype=bool)
        # Axis by axis: a cell of the arrangement is one piece per axis, and its class the conjunction of theirs.
        for pieces, overlap in self._axes(agent, low, high):
            joint = (classes[:, None] & pieces[None]).reshape(len(classes) * len(pieces), n_propositions)
            meets = (possible[:, :, None] & overlap[:, None, :]).reshape(n_boxes, -1)
            # Cells of one class are one from here on; a box meets the class if it meets any of them.
            if n_propositions:
                classes, inverse = np.unique(joint, axis=0, return_inverse=True)
            else:  # numpy's unique refuses rows of length zero
                classes, inverse = joint[:1], np.zeros(len(joint), dtype=int)
            possible = np.zeros((n_boxes, len(classes)), dtype=bool)
            for source, target in enumerate(inverse.ravel()):
                possible[:, target] |= meets[:, source]
        return classes, possible

    def _axes(self, agent: int, low: np.ndarray, high: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return, per output axis, which propositions allow each piece between two edges, and which pieces boxes meet.

        Returns
        -------
        list of (np.ndarray of bool, shape (K, P_i); np.ndarray of bool, shape (S, K))
            K pieces, each from its edge up to, but without, the next one.
        """
        model = self.agents[agent]
        # Boxes beyond the workspace meet nothing; a half-open box that ends at its lower edge is beyond, too.
        flat = low >= high
        beyond = ((high < model.state_low) | (low > model.state_high) | ((high == model.state_low) & ~flat)).any(axis=1)
        low, high = np.maximum(low, model.state_low), np.minimum(high, model.state_high)
        states = model.state_outputs
        if model.has_identity_output:
            bottom, top, upper_face = model.state_low, model.state_high, flat
        else:  # bounds on the outputs of closed boxes, rounded outwards: a superset
            bottom, top = (bound[0] for bound in model.output_range(model.state_low[None], model.state_high[None]))
            outputs = model.output_range(low, high)
            upper_face = np.ones_like(outputs[0], dtype=bool)
            if states:  # outputs that are states are exact, whatever was added to them
                bottom[:states], top[:states], upper_face[:, :states] = model.state_low, model.state_high, flat
                outputs[0][:, :states], outputs[1][:, :states] = low, high
            low, high = outputs
        result = []
        for axis in range(model.n_outputs):
            region_low, region_high = self.low[agent][axis], self.high[agent][axis]
            edges = np.unique(np.concatenate([[bottom[axis]], region_low, region_high]))
            edges = edges[(edges >= bottom[axis]) & (edges <= top[axis])]
            if axis < states and len(edges) > 1 and edges[-1] == top[axis]:
                edges = edges[:-1]  # the last piece is closed at the top, so that its upper edge starts no new one
            pieces = (region_low <= edges[:, None]) & (edges[:, None] < region_high)
            # A box meets a piece if it starts below the end of the piece and reaches beyond its beginning.
            ends = np.append(edges[1:], np.inf)
            lower, upper = low[:, axis, None], high[:, axis, None]
            reaches = (upper > edges) | ((upper >= edges) & upper_face[:, axis, None])
            result.append((pieces, (lower < ends) & reaches & ~beyond[:, None]))
        return result


def of_hint(agent: AnyAgent, count: int) -> str:
    """Return what to do where corners have fewer numbers than an agent has outputs, for the end of a message."""
    if count >= agent.n_outputs - agent.added_outputs:
        return ""
    names = agent.state_names[:count] or range(min(count, agent.n_states))
    listed = ", ".join(f'"{name}"' if isinstance(name, str) else str(name) for name in names)
    return f"; say which states they are about, such as `of = [{listed}]`"


def _check_region(name: str, proposition: Proposition, agents: Mapping[str, AnyAgent]) -> None:
    """Raise ValueError unless the region has the outputs' dimension and meets the workspace of its agent."""
    agent = agents[proposition.agent]
    if proposition.size != agent.n_outputs:
        raise ValueError(
            f"`propositions.{name}`: expected corners of length {agent.n_outputs} (outputs of agent {agent.name}), "
            f"got length {proposition.size}{of_hint(agent, proposition.size)}"
        )
    for k in agent.angle_outputs:
        _check_angle(name, proposition, agent, k)
    if proposition.moves:
        return  # it may pass beyond the workspace, and be empty at times
    bottom, top = (end.copy() for end in agent.output_ends)
    states = agent.state_outputs
    bottom[:states], top[:states] = agent.state_low[:states], agent.state_high[:states]
    outside = (proposition.low > top) | (proposition.high <= bottom)
    outside[:states] |= proposition.low[:states] >= top[:states]
    if outside.any():
        axis = int(np.argmax(outside))
        along = f"`{agent.output_names[axis]}`" if axis < len(agent.output_names) else f"axis {axis}"
        raise ValueError(
            f"`propositions.{name}`: expected a region that meets the workspace of agent {agent.name}, got "
            f"[{proposition.low[axis]:g}, {proposition.high[axis]:g}] against [{bottom[axis]:g}, {top[axis]:g}] along "
            f"{along}; correct the region or the workspace, or leave out what never holds"
        )


def _check_angle(name: str, proposition: Proposition, agent: AnyAgent, k: int) -> None:
    """Raise ValueError unless a region is an interval of a turn along an output that is an angle, or all of it."""
    found = agent.output_axis(k)
    assert found is not None
    state = found[0]
    bottom, top = float(agent.state_low[state]), float(agent.state_high[state])
    corners = (proposition.low, proposition.high) if proposition.corners is None else proposition.corners
    low, high = corners[0][k], corners[1][k]
    if isinstance(low, str) or isinstance(high, str):
        raise ValueError(
            f"`propositions.{name}`: expected corners that stand still along the angle {agent.angles[0]!r} of agent "
            f"{agent.name}, got some that name the time; write a region of `cos` and `sin` of it as `outputs`"
        )
    if not (bottom <= low and high <= top) and not (low <= bottom and top <= high):
        raise ValueError(
            f"`propositions.{name}`: expected an interval of the turn [{bottom:g}, {top:g}] of an angle of agent "
            f"{agent.name}, got [{low:g}, {high:g}]; say it as `heading = {{ of = ..., from = ..., to = ... }}`, which "
            "goes on where a turn ends"
        )
