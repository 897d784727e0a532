"""A problem: agents, propositions, a specification and a horizon, checked once, when it is made.

The task is judged on the word `l_0 ... l_T` of the letters met at times 0 to T = `horizon`; `l_0` is the letter of the
start. An agent that leaves its workspace violates the task.

Reference: docs/theory/setting.md, "Letters and words" and "Satisfaction".
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import product
from types import MappingProxyType
from typing import Any

import numpy as np

from ...systems.agents import AnyAgent, tied
from ...systems.arguments import (
    checked_count,
    counted,
    float_array,
    names_arguments,
    names_text,
    shortened,
    shown,
    slices_of,
)
from ..automata import Automaton, Formula, over_propositions, translate, with_meanings, within
from ..regions import Labeling, PairRegion, Piece, Proposition, inside
from .default_horizon import default_horizon
from .families import AnyProposition, checked_propositions, expand
from .groups import MOST_STATES, Group, independent_groups, joint_automaton
from .joint_noise import checked_sources, scaled_sources, with_sources
from .region_boxes import regions_of
from .specification import Specification
from .summary import summary_html, summary_text

MOST_FIRST_LETTERS = 1024
"""Letters that a start box may have: beyond, where the automaton goes is not looked into."""

LONGEST_HORIZON = 10**6
"""Most control steps: more would be a slip of the keyboard, and would fill the memory with policies."""


@dataclass(frozen=True, eq=False, init=False, repr=False)
class Problem:
    """Agents and a task, validated; the task automaton and the labelling are built at construction.

    A task may decompose into so many independent tasks that its own automaton would be too large. Then that automaton
    is not built, and `tasks` holds one problem for each independent task (see `groups`).

    Parameters
    ----------
    name : str
    horizon : int, optional
        Number of control steps T, at least 1. Default: the last step of the windows of the formula; without windows,
        100 for a co-safe task. Other tasks need one.
    agents : LinearAgent or Agent, or a sequence of them
        Each with a start. Those with propositions of other shapes than boxes get outputs for them.
    propositions : mapping from str to Proposition or Pair, or to a dict of its arguments
        With one agent a box may be a pair (low, high), and a dict need not name the agent.
        A proposition belongs to one agent, or to a pair. An agent name with one `*` makes a family: one member per
        agent that matches, named by what the `*` stands for (`safe` on `drone_*` gives `safe_0`, `safe_1`, ...), or per
        pair (`near` on pairs of `drone_*` gives `near_0_1`, `near_0_2`, ...).
    specification : Specification, or a formula
    joint_noise : mapping from str to mapping, optional
        Noise that agents share, by name: what one standard normal number per step adds to the states of each, such as
        ``{"wind": {"drone_*": {"x": 0.03}, "kite": [0.0, 0.05]}}``, in units of the states (see ``joint_noise``).

    Attributes
    ----------
    declared : mapping from str to Proposition or Pair
        The propositions as they were passed in.
    written_agents : tuple of AnyAgent
        The agents as they were passed in: without outputs for shapes.
    written : mapping from str to Proposition or Pair
        The propositions with families expanded, as they were written.
    propositions : mapping from str to Proposition or Pair
        The same as boxes, ordered agent by agent; those about pairs come last. A shape that consists of several pieces
        has a box for each.
    meanings : mapping from str to Formula
        Of shapes made of several pieces, or of other propositions: a formula of `propositions`.
    pieces : mapping from str to Piece
        The shapes of those `propositions` that come from shapes.
    families : mapping from str to tuple of str
        Members of each family, in agent order.
    labeling : Labeling
        Membership, classes and letters.
    groups : tuple of Group
        Agents with independent tasks, if the automaton of the whole is not built; empty otherwise.
    shared_noise : tuple of (d, K) arrays
        Per agent: what each of the K sources of `joint_noise` adds to its states. The `agents` have all the noise that
        they feel; the `written_agents` have their own alone.

    Raises
    ------
    ValueError
        If an argument is wrong. The message names it, what was expected and what came.

    Examples
    --------
    >>> from certigym import LinearAgent, Proposition
    >>> agent = LinearAgent(
    ...     name="left", A=[[0.9]], B=[[0.5]], noise_covariance=[[0.25]],
    ...     state_low=[-20], state_high=[5], input_low=[-5], input_high=[5], initial_state=[-10],
    ... )
    >>> goal = Proposition("left", [0], [5])
    >>> problem = Problem(
    ...     name="reach", horizon=12, agents=[agent], propositions={"goal": goal},
    ...     specification=Specification("F goal", "co-safe"),
    ... )
    >>> problem.automaton.n_states, problem.n_agents
    (2, 1)
    """

    name: str
    horizon: int
    agents: tuple[AnyAgent, ...]
    written_agents: tuple[AnyAgent, ...]
    declared: Mapping[str, AnyProposition]
    written: Mapping[str, AnyProposition]
    propositions: Mapping[str, AnyProposition]
    meanings: Mapping[str, Formula]
    pieces: Mapping[str, Piece]
    families: Mapping[str, tuple[str, ...]]
    specification: Specification
    labeling: Labeling
    groups: tuple[Group, ...]
    joint_noise: Mapping[str, Mapping[str, Any]]
    shared_noise: tuple[np.ndarray, ...]
    _automaton: Automaton | None

    @names_arguments()
    def __init__(
        self,
        *,
        name: str = "problem",
        horizon: int | None = None,
        agents: AnyAgent | Sequence[AnyAgent],
        propositions: Mapping[str, AnyProposition | Mapping[str, Any]],
        specification: Specification | str,
        joint_noise: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        title = _checked_title(name)
        specification = Specification(specification) if isinstance(specification, str) else specification
        agents = [agents] if isinstance(agents, AnyAgent) else agents
        if horizon is None:
            horizon = default_horizon({"formula": specification.formula, "semantics": specification.semantics})
        if not isinstance(specification, Specification):
            raise ValueError(f"`specification`: expected a Specification, got {shown(specification)}")
        # Expand families first: the labelling, the groups and the automaton all speak of single propositions.
        written_agents = _checked_agents(agents)
        declared = checked_propositions(propositions, [agent.name for agent in written_agents])
        expanded, families = expand(declared, [agent.name for agent in written_agents])
        steps = checked_horizon(horizon)
        regions = regions_of(written_agents, expanded, families, steps)
        sources, shared = checked_sources(joint_noise, written_agents)
        members = tied(_shaken(regions.agents, written_agents, shared))
        labeling = Labeling.of(members, regions.boxes)
        if specification.automaton is not None and specification.automaton.reads_exits:
            labeling = dataclasses.replace(labeling, reads_exits=True)
        # The task speaks of regions as they were written; letters are those of boxes.
        owners = dict(zip(labeling.names, labeling.owners, strict=True))
        places = {agent.name: frozenset([i]) for i, agent in enumerate(members)}
        owners |= {key: places[expanded[key].agent] for key in regions.meanings}
        names = _task_names(labeling.names, expanded, regions.meanings)
        groups = _groups(specification, {key: owners[key] for key in names}, families, len(members))
        automaton = None if groups else _automaton(specification, names, families, labeling.names)
        are_coupled = any(getattr(agent, "others", ()) for agent in members)
        are_coupled |= any(np.any(own) for own in shared)
        if groups and (are_coupled or labeling.pairs):
            # Whoever moves, or is compared, with others has no task alone: the whole may have fewer states than feared.
            formula = specification.formula or ""
            automaton = joint_automaton(formula, specification.semantics, names, families)
            groups = () if automaton is not None else groups
        if groups and are_coupled:
            raise ValueError(
                "`specification`: expected one task of agents whose dynamics name states or inputs of others, or that "
                f"share noise, got independent tasks whose joint automaton has more than {MOST_STATES} states; take "
                "fewer agents or another formula"
            )
        if automaton is not None and regions.meanings:
            automaton = with_meanings(automaton, labeling.names, regions.meanings)
        _check_corners(labeling, steps)
        values = {
            "name": title,
            "horizon": steps,
            "agents": members,
            "written_agents": written_agents,
            "declared": MappingProxyType(declared),
            "written": MappingProxyType(expanded),
            "propositions": MappingProxyType({key: regions.boxes[key] for key in labeling.names}),
            "meanings": MappingProxyType(regions.meanings),
            "pieces": MappingProxyType(regions.pieces),
            "families": MappingProxyType(families),
            "specification": specification,
            "labeling": labeling,
            "groups": groups,
            "joint_noise": MappingProxyType(sources),
            "shared_noise": shared,
            "_automaton": automaton,
        }
        for key, value in values.items():
            object.__setattr__(self, key, value)

    def __repr__(self) -> str:
        return summary_text(f"Problem {self.name!r}", self.agents, self._facts())

    def _repr_html_(self) -> str:
        return summary_html(self.name, self.agents, self._facts())

    def _facts(self) -> list[tuple[str, str]]:
        """Return the rows of a summary below the agents, name and value."""
        if self.groups:
            sizes = [group.automaton.n_states for group in self.groups]
            span = f"{min(sizes)}" if min(sizes) == max(sizes) else f"{min(sizes)} to {max(sizes)}"
            automaton = ("automata", f"{len(self.groups)} independent tasks of {span} states each")
        else:
            automaton = ("automaton", counted(self.automaton.n_states, "state"))
        declared = f" ({names_text(list(self.declared))})" if self.declared else ""
        shared = [("joint noise", names_text(list(self.joint_noise)))] if self.joint_noise else []
        return [
            *shared,
            ("propositions", f"{len(self.written)}{declared}"),
            ("task", shortened(self.specification.formula or "given as an automaton", 200)),
            ("semantics", self.specification.semantics),
            automaton,
            ("horizon", counted(self.horizon, "control step")),
        ]

    def __reduce__(self) -> tuple[Any, ...]:
        # Pickle the arguments alone: unpickling builds and checks the rest anew.
        return _rebuilt, (
            self.name, self.horizon, self.written_agents, dict(self.declared), self.specification,
            dict(self.joint_noise),
        )  # fmt: skip

    @cached_property
    def automaton(self) -> Automaton:
        """Deterministic automaton of the task, complete up to the horizon; its propositions are those of the problem.

        Raises
        ------
        ValueError
            If the task decomposes into independent tasks whose joint automaton would be too large.
        """
        if self._automaton is None:
            raise ValueError(
                f"`problem`: expected a task with one automaton, got {len(self.groups)} independent tasks, whose joint "
                "automaton would be too large; take the problems of `problem.tasks` one by one, or `parallel_env`"
            )
        # What lies beyond the horizon needs no states.
        return within(self._automaton, self.horizon + 1)

    @cached_property
    def tasks(self) -> tuple[Problem, ...]:
        """One problem per independent task, ordered by first agents; the problem itself if there is only one task.

        The probability of satisfying the whole is the product of theirs for finite-trace semantics, and at least that
        product for co-safe semantics (see `groups`).
        """
        return tuple(self._task(group) for group in self.groups) or (self,)

    @cached_property
    def apart(self) -> tuple[Group, ...]:
        """Groups of agents with independent tasks, also where the task has one automaton; none where it is one task.

        Whoever moves, shares noise, or is compared with others has no task alone.
        """
        are_tied = any(getattr(agent, "others", ()) for agent in self.agents) or any(map(np.any, self.shared_noise))
        if self.groups or are_tied or self.labeling.pairs:
            return self.groups
        owners = {self.agent_names[i]: frozenset([i]) for i in range(self.n_agents)}
        of_names = {name: owners[p.agent] for name, p in self.written.items() if isinstance(p, Proposition)}
        return _groups(self.specification, of_names, self.families, self.n_agents, always=True)

    @cached_property
    def tasks_apart(self) -> tuple[Problem, ...]:
        """One problem per group of ``apart``, as ``tasks`` has them; the problem itself if there is only one task."""
        return tuple(self._task(group) for group in self.apart) or (self,)

    def _task(self, group: Group) -> Problem:
        """Return the problem of one group of agents."""
        names = self.labeling.names
        members = [self.agent_names[i] for i in group.agents]
        # As they were written, agent by agent: their boxes are made anew.
        of_agents = [(name, p.agent) for name, p in self.written.items() if isinstance(p, Proposition)]
        group_names = [name for member in members for name, agent in of_agents if agent == member]
        for name, pair in zip(names[self.labeling.first_pair :], self.labeling.pairs):
            group_names += [name] if {pair.first, pair.second} <= {*group.agents} else []
        listed = ", ".join(members[:3]) + (", ..." if len(members) > 3 else "")
        # The automaton of a co-safe group is judged at the horizon, which no formula says: hand it on as it is.
        if self.specification.semantics == "co-safe":
            specification = Specification(automaton=group.automaton)
        else:
            specification = Specification(str(group.formula), "finite-trace")
        return Problem(
            name=f"{self.name[:120]} ({listed[:70]})",
            horizon=self.horizon,
            agents=[self.written_agents[i] for i in group.agents],
            propositions={name: self.written[name] for name in group_names},
            specification=specification,
        )

    def told(self, holding: Iterable[str]) -> list[str]:
        """Return the names of the propositions, as they were written, that hold where these `propositions` hold."""
        here = {*holding}
        if not self.meanings:
            return [name for name in self.propositions if name in here]
        return [
            name
            for name in self.written
            if (_holds(self.meanings[name], here) if name in self.meanings else name in here)
        ]

    @property
    def names_time(self) -> bool:
        """Whether dynamics, scales of noise, regions or pairs name the time `t`: the steps of such a problem differ."""
        return self.labeling.moves or any(agent.names_time for agent in self.agents)

    @property
    def n_agents(self) -> int:
        """Number of agents I."""
        return len(self.agents)

    @property
    def agent_names(self) -> tuple[str, ...]:
        """Names of the agents, in order."""
        return tuple(agent.name for agent in self.agents)

    @property
    def n_states(self) -> int:
        """Number of components D of a joint state."""
        return self.columns[-1].stop

    @property
    def n_inputs(self) -> int:
        """Number of components of a joint input."""
        return self.input_columns[-1].stop

    @cached_property
    def columns(self) -> tuple[slice, ...]:
        """Per agent: where its components stand in a joint state, in agent order."""
        return slices_of(agent.n_states for agent in self.agents)

    @cached_property
    def input_columns(self) -> tuple[slice, ...]:
        """Per agent: where its components stand in a joint input, in agent order."""
        return slices_of(agent.n_inputs for agent in self.agents)

    @cached_property
    def initial_q(self) -> int | None:
        """Automaton state after the letter of the start; None if a start is outside, or if several letters are possible
        that lead to different states."""
        starts = [agent.initial for agent in self.agents]
        if self.starts_outside:
            return None
        labeling = self.labeling.at(0)
        if all(start.is_point for start in starts):
            letters = labeling.letter([start.low for start in starts])[None]
        else:
            single, boxes = labeling.without_pairs(), [(start.low, start.high) for start in starts]
            classes = [single.box_classes(i, *box)[0] for i, box in enumerate(boxes)]
            outputs = [agent.output_range(low[None], high[None]) for agent, (low, high) in zip(self.agents, boxes)]
            ranges = [(low[0], high[0]) for low, high in outputs]
            near = [np.array([*pair.possible(ranges[pair.first], ranges[pair.second])]) for pair in labeling.pairs]
            if np.prod([*(own.sum() for own in classes), *map(len, near)], dtype=float) > MOST_FIRST_LETTERS:
                return None
            possible = [own[here] for own, here in zip(single.classes, classes, strict=True)]
            possible += [both[:, None] for both in near]
            letters = np.stack([np.concatenate(letter) for letter in product(*possible)]).astype(bool)
        states = self.automaton.next_state(np.full(len(letters), self.automaton.initial), letters.T)
        return int(states[0]) if np.all(states == states[0]) else None

    @cached_property
    def starts_outside(self) -> tuple[str, ...]:
        """Names of the agents with a start, or a corner of a start box, outside their closed workspace."""
        return tuple(
            agent.name
            for agent in self.agents
            for start in [agent.initial]
            if not all(inside(corner, agent.state_low, agent.state_high) for corner in (start.low, start.high))
        )

    def replace(
        self,
        *,
        horizon: int | None = None,
        initial_state: Any = None,
        initial_low: Any = None,
        initial_high: Any = None,
        disturbance_scale: float | None = None,
        name: str | None = None,
    ) -> Problem:
        """Return the problem with another horizon, name, start or noise; automata and labelling are not built again.

        Parameters
        ----------
        horizon : int, optional
        initial_state : mapping, or array_like, optional
            Start: a mapping from agent names to vectors (agents not named keep theirs), a list of vectors, or a flat
            joint vector (D,) in agent order. `initial_low` with `initial_high`, in the same forms, give a box.
        disturbance_scale : float, optional
            Factor, at least 0, on the standard deviations of all noise (its square on the covariances).
        name : str, optional

        Raises
        ------
        ValueError
            As at construction.
        """
        if horizon is not None and any(piece.by_time for piece in self.pieces.values()):
            # Shapes that move have outputs for every time: with other times they are made anew.
            anew = Problem(
                name=self.name, horizon=horizon, agents=self.written_agents, propositions=self.declared,
                specification=self.specification, joint_noise=dict(self.joint_noise) or None,
            )  # fmt: skip
            return anew.replace(
                initial_state=initial_state, initial_low=initial_low, initial_high=initial_high,
                disturbance_scale=disturbance_scale, name=name,
            )  # fmt: skip
        # Neither start nor noise changes propositions or regions, so everything derived from them is handed on.
        changes: dict[str, Any] = {}
        if name is not None:
            changes["name"] = _checked_title(name)
        if horizon is not None:
            changes["horizon"] = checked_horizon(horizon)
            _check_corners(self.labeling, changes["horizon"])
        starts = {"initial_state": initial_state, "initial_low": initial_low, "initial_high": initial_high}
        vectors = {key: self._vectors(value, key) for key, value in starts.items() if value is not None}
        if vectors:
            for key in ("agents", "written_agents"):
                changes[key] = tuple(_started(agent, vectors) for agent in getattr(self, key))
        if disturbance_scale is not None:
            # Scale the agents with their new starts, so that both changes apply.
            factor = float(float_array([disturbance_scale], "disturbance_scale", (1,), "0.5")[0])
            if factor < 0.0:
                raise ValueError(f"`disturbance_scale`: expected a number of at least 0, got {factor:g}")
            for key in ("agents", "written_agents"):
                agents = changes.get(key, getattr(self, key))
                changes[key] = tuple(agent.with_noise_times(factor) for agent in agents)
            if self.joint_noise:
                sources = scaled_sources(self.joint_noise, factor)
                changes["joint_noise"], shared = checked_sources(sources, changes["written_agents"])
                changes["shared_noise"] = shared
                changes["agents"] = _shaken(changes["agents"], changes["written_agents"], shared)
        if "agents" in changes:
            changes["agents"] = tied(changes["agents"])
        return self._with(changes)

    def _with(self, changes: Mapping[str, Any]) -> Problem:
        """Return a problem with some fields changed; cached properties are not copied, as they may change, too."""
        changed = object.__new__(Problem)
        for field in fields(Problem):
            object.__setattr__(changed, field.name, changes.get(field.name, getattr(self, field.name)))
        return changed

    def _vectors(self, value: Any, argument: str) -> Mapping[str, Any]:
        """Return one vector per agent name, from a mapping, a list of vectors or a flat joint vector."""
        if isinstance(value, Mapping):
            for key in value:
                if key not in self.agent_names:
                    raise ValueError(
                        f"`{argument}`: expected agents among {', '.join(self.agent_names[:8])}, got {shown(key)}"
                    )
            return value
        if isinstance(value, (list, tuple)) and value and all(np.ndim(vector) == 1 for vector in value):
            if len(value) != self.n_agents:
                raise ValueError(f"`{argument}`: expected {self.n_agents} vectors, one per agent, got {len(value)}")
            return dict(zip(self.agent_names, value))
        # Anything else has to be a joint vector, which is cut into those of the agents.
        joint = float_array(value, argument, (self.n_states,), f"{[0.0] * min(self.n_states, 4)}")
        return {name: joint[columns] for name, columns in zip(self.agent_names, self.columns)}

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of dynamics, boxes, propositions, automaton, start and horizon (not of the name): 64 hex digits."""
        # Problems that behave alike shall agree: hash expanded families and the automaton, not how they were written.
        data = {**self.to_dict(), "agents": [agent.to_dict() for agent in self.agents]}
        del data["name"]
        data["propositions"] = [[key, value.to_dict()] for key, value in self.propositions.items()]
        if self.groups:
            groups = [[group.agents, group.automaton.to_dict()] for group in self.groups]
            data["specification"] = {"semantics": self.specification.semantics, "groups": groups}
            if self.meanings:
                data["meanings"] = {key: str(meaning) for key, meaning in self.meanings.items()}
        else:
            data["specification"] = self.automaton.to_dict()
        text = json.dumps(data, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()

    def to_dict(self) -> dict[str, Any]:
        """Return the problem as plain values, keyed as in problem files (exact); `problem_from_dict` reads it back."""
        shared = {"joint_noise": {key: dict(value) for key, value in self.joint_noise.items()}}
        return {
            "name": self.name,
            "horizon": self.horizon,
            "agents": [agent.to_dict() for agent in self.written_agents],
            **(shared if self.joint_noise else {}),
            "propositions": {key: value.to_dict() for key, value in self.declared.items()},
            "specification": self.specification.to_dict(),
        }


def _shaken(
    agents: Iterable[AnyAgent], written: Iterable[AnyAgent], shared: Iterable[np.ndarray]
) -> tuple[AnyAgent, ...]:
    """Return agents with all the noise that they feel: their own, as it was written, and what they share."""
    each = zip(agents, written, shared, strict=True)
    return tuple(with_sources(agent, own.noise_covariance, factors) for agent, own, factors in each)


def _holds(meaning: Formula, holding: set[str]) -> bool:
    """Return whether a formula of propositions holds."""
    if meaning.operator == "atom":
        return meaning.name in holding
    parts = [_holds(operand, holding) for operand in meaning.operands]
    return not parts[0] if meaning.operator == "!" else all(parts) if meaning.operator == "&" else any(parts)


def _started(agent: AnyAgent, vectors: Mapping[str, Mapping[str, Any]]) -> AnyAgent:
    """Return an agent with what is given for it, by argument and agent, in the place of its start."""
    start = {key: by_name[agent.name] for key, by_name in vectors.items() if agent.name in by_name}
    return agent.replace(**start) if start else agent


def _task_names(
    boxes: tuple[str, ...], written: Mapping[str, AnyProposition], meanings: Mapping[str, Formula]
) -> tuple[str, ...]:
    """Return the names that a task may use: those of boxes that were written, and of what is made of several."""
    return tuple(name for name in boxes if name in written) + tuple(meanings)


def _rebuilt(*values: Any) -> Problem:
    """Return the problem with these arguments (for pickling)."""
    return Problem(**dict(zip(("name", "horizon", "agents", "propositions", "specification", "joint_noise"), values)))


def checked_problem(value: Any) -> Problem:
    """Return `value` if it is a Problem, or raise ValueError with what to do."""
    if not isinstance(value, Problem):
        raise ValueError(
            f"`problem`: expected a Problem, got {shown(value)}; make one with `make_problem`, `load` or `Problem`"
        )
    return value


def checked_horizon(value: Any) -> int:
    """Return the horizon as an int, or raise ValueError."""
    return checked_count(value, "horizon", most=LONGEST_HORIZON, unit="control steps")


def _checked_title(name: Any) -> str:
    """Return the name of a problem if it is one printable line; raise ValueError otherwise."""
    if not isinstance(name, str) or not name.strip() or not name.isprintable() or len(name) > 200:
        raise ValueError(f"`name`: expected a line of 1 to 200 printable characters, got {shown(name)}")
    return name


def _checked_agents(agents: Any) -> tuple[AnyAgent, ...]:
    """Return the agents as a tuple if they differ in name and each has a start; raise ValueError otherwise."""
    if not isinstance(agents, Sequence) or not agents or not all(isinstance(a, AnyAgent) for a in agents):
        raise ValueError(f"`agents`: expected a list of at least one LinearAgent or Agent, got {shown(agents)}")
    seen: set[str] = set()
    for agent in agents:
        if agent.name in seen:
            raise ValueError(f"`agents`: expected different names, got {agent.name!r} twice; rename one")
        seen.add(agent.name)
        if agent.initial_low is None:
            raise ValueError(
                f"`agents`: expected a start for every agent, got none for {agent.name!r}; give it `initial_state`, or "
                "`initial_low` and `initial_high`"
            )
    return tuple(agents)


def _check_corners(labeling: Labeling, horizon: int) -> None:
    """Raise ValueError unless the corners of regions that move are finite at times 0 to T, and meet the workspace."""
    times = np.arange(horizon + 1, dtype=float)
    agents = {agent.name: agent for agent in labeling.agents}
    for name, region in labeling.moving.items():
        try:
            low, high = region.over(times)
        except ValueError as error:
            raise ValueError(f"`propositions.{name}`: {error}") from None
        agent = agents[region.agent]
        bottom, top = (end[:, None] for end in agent.output_ends)
        if region.moves and not ((low <= top) & (high > bottom) & (low < high)).all(axis=0).any():
            raise ValueError(
                f"`propositions.{name}`: expected a region that meets the workspace of agent {agent.name} at some time "
                f"from 0 to {horizon}, got {region.text}; correct the region or the workspace"
            )
    for name, pair in zip(labeling.names[labeling.first_pair :], labeling.pairs, strict=True):
        if pair.moving is not None:
            _check_pair(name, pair, pair.moving.text, labeling.agents, times)


def _check_pair(name: str, pair: PairRegion, text: str, agents: Sequence[AnyAgent], times: np.ndarray) -> None:
    """Raise ValueError unless a pair that moves is finite at all times, and may hold at one."""
    try:
        low, high, _ = pair.over(times)
    except ValueError as error:
        raise ValueError(f"`propositions.{name}`: {error}") from None
    (low_a, high_a), (low_b, high_b) = agents[pair.first].output_ends, agents[pair.second].output_ends
    least = np.array(pair.difference(low_a, high_b))[:, None]
    most = np.array(pair.difference(high_a, low_b))[:, None]
    if not ((low <= most) & (high > least) & (low < high)).all(axis=0).any():
        raise ValueError(
            f"`propositions.{name}`: expected a box, or a distance, that differences of {agents[pair.first].name} and "
            f"{agents[pair.second].name} can meet at some time from 0 to {int(times[-1])}, got {text}; correct it"
        )


def _groups(
    specification: Specification,
    owners: Mapping[str, frozenset[int]],
    families: Mapping[str, tuple[str, ...]],
    n_agents: int,
    always: bool = False,
) -> tuple[Group, ...]:
    """Return the groups of agents with independent tasks; a task given as an automaton is not taken apart."""
    if specification.formula is None:
        return ()
    names = tuple(owners)
    each = tuple(owners.values())
    return independent_groups(
        specification.formula, specification.semantics, names, families, each, n_agents, always=always
    )


def _automaton(
    specification: Specification,
    names: tuple[str, ...],
    families: Mapping[str, tuple[str, ...]],
    boxes: tuple[str, ...],
) -> Automaton:
    """Return the automaton of the task over all propositions of the problem, as they were written."""
    if specification.automaton is None:
        return translate(specification.formula or "", names, specification.semantics, families=families)
    # An automaton may be of boxes: those of problems that were derived are.
    known = tuple(dict.fromkeys((*names, *boxes)))
    unknown = [name for name in specification.automaton.propositions if name not in known]
    if unknown:
        raise ValueError(
            f"`automaton`: expected propositions among {shown(list(names))}, got {shown(unknown[0])}; declare it"
        )
    # Its propositions may stand in another order, and some of the problem's may be missing.
    return over_propositions(specification.automaton, known)
