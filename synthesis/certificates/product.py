"""Certificates of independent tasks, multiplied.

Where a task decomposes into tasks of disjoint groups of agents (``envs.problem.groups``), every group is certified
separately, and the product of the lower bounds is a lower bound for the whole: noises, starts and policies of different
groups are independent. Time and memory are sums over the groups, so that they grow linearly with the number of agents;
groups that differ in nothing but names are synthesized once.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from ...envs.agents import tree_text
from ...envs.problem import Problem
from ..cells import FloatArray
from ..controllers import ProductController
from ..values import UNIT
from .archive import Pool
from .certificate import Certificate
from .claim import joint_states
from .digits import EXACT_GAP
from .part import AgentPart
from .summaries import certificate_facts, certificate_html
from .two_ended import TwoEnded


@dataclass(frozen=True, eq=False, repr=False)
class ProductCertificate(TwoEnded):
    """A certified lower bound for a task that decomposes: the product of the bounds of its independent tasks.

    Parameters
    ----------
    problem : Problem
        The whole problem.
    parts : tuple of Certificate
        One for each of ``problem.tasks``, in order.
    """

    problem: Problem
    parts: tuple[Certificate, ...]

    @property
    def member_agents(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the agents of each task."""
        return tuple(group.agents for group in self.problem.groups)

    @property
    def relations_tried(self) -> dict[str, float | str]:
        """Bound of each relation that was tried, or why there is none; of parts that are alike, those of one."""
        tried: dict[str, float | str] = {}
        for part in (self.parts[same[0]] for same in self.alike):
            name = part.problem.agent_names[0]
            tried |= {f"{relation}, task of {name}": outcome for relation, outcome in part.relations_tried.items()}
        return tried

    @property
    def why_nothing(self) -> str:
        """Why nothing was certified, task by task."""
        if self.lower_bound > 0.0:
            return ""
        parts = [self.parts[same[0]] for same in self.alike]
        told = {part.problem.agent_names[0]: part.why_nothing for part in parts}
        return "; ".join(f"task of {name}: {text}" for name, text in told.items() if text)

    @property
    def members(self) -> tuple[Any, ...]:
        """Its parts."""
        return self.parts

    def __repr__(self) -> str:
        return tree_text(f"ProductCertificate of {self.problem.name!r}", certificate_facts(self))

    def _repr_html_(self) -> str:
        return certificate_html(f"Certificate of {self.problem.name}", self)

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        # Parts that differ in names alone share one file in the archive.
        files = {k: file for same in self.alike for file in [pool.put_file(self.parts[same[0]])] for k in same}
        return {"parts": [files[k] for k in range(len(self.parts))]}

    @property
    def lower_bound(self) -> float:
        """Certified lower bound at the problem's start."""
        return _less_rounding(self, math.prod(part.lower_bound for part in self.parts))

    @property
    def gap(self) -> float | None:
        """If not None, ``lower_bound + gap`` is an upper bound on the satisfaction probability of this controller.

        None for co-safe tasks, since their parts ask for more than the whole does.
        """
        gaps = [part.gap for part in self.parts if part.gap is not None]
        if len(gaps) < len(self.parts) or self.problem.specification.is_co_safe:
            return None
        most = math.prod(min(1.0, part.lower_bound + gap) for part, gap in zip(self.parts, gaps, strict=True))
        return min(1.0, most * (1.0 + 4.0 * len(gaps) * UNIT)) - self.lower_bound

    def with_claims(self, change: Callable[[Any], Any]) -> Self:
        """Return the same claim, with what a function makes of its parts: once of those that differ in names alone."""
        changed = {k: made for same in self.alike for made in [self.parts[same[0]].with_claims(change)] for k in same}
        parts = product_certificate(self.problem, tuple(changed[k] for k in range(len(self.parts)))).parts
        return replace(self, parts=parts)

    @property
    def exact(self) -> bool:
        """Whether the probability is known to ``EXACT_GAP``."""
        return self.gap is not None and self.gap <= EXACT_GAP

    @property
    def start(self) -> str:
        """``"point"``, or ``"mean"`` where any part starts in a box."""
        return "mean" if any(part.start == "mean" for part in self.parts) else "point"

    @property
    def has_cells(self) -> bool:
        """Whether all parts are about cells."""
        return all(part.has_cells for part in self.parts)

    @property
    def method(self) -> str:
        """Relation, bound and policy search of the parts, in words."""
        methods = sorted({part.method for part in self.parts})
        return f"{len(self.parts)} independent tasks, {'; '.join(methods)}"

    @property
    def bound(self) -> str:
        """Names of the bounds of the parts."""
        return ", ".join(sorted({part.bound for part in self.parts}))

    @property
    def rank(self) -> int:
        """Largest number of terms, or of columns of a bond, of any part."""
        return max(part.rank for part in self.parts)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the parts: each that occurs, and which parts have it."""
        by_text: dict[str, dict[str, Any]] = {}
        for k, part in enumerate(self.parts):
            by_text.setdefault(json.dumps(part.settings), {"settings": part.settings, "parts": []})["parts"].append(k)
        return {"parts": list(by_text.values())}

    @cached_property
    def controller(self) -> ProductController:
        """The controllers the bound belongs to."""
        return ProductController(self.problem, tuple(part.controller for part in self.parts))

    @cached_property
    def agents(self) -> tuple[AgentPart, ...]:
        """What is stored of each agent, in the order of the problem's agents."""
        pairs = zip(self.problem.groups, self.parts, strict=True)
        stored = {i: agent for group, part in pairs for i, agent in zip(group.agents, part.agents, strict=True)}
        return tuple(stored[i] for i in range(self.problem.n_agents))

    def at(self, states: Any) -> FloatArray:
        """Return lower bounds (M,) from each of M joint initial states, in any form that ``Certificate.at`` takes."""
        joint = joint_states(self.problem, states)
        values = np.ones(len(joint))
        for part, columns in zip(self.parts, self._columns, strict=True):
            values *= part.at(joint[:, columns])
        # Independent tasks: probabilities multiply, and every product may have been rounded up.
        return np.maximum(0.0, values * (1.0 - 4.0 * len(self.parts) * UNIT))

    def mean(self, low: Any, high: Any) -> float:
        """Return a lower bound from a start drawn uniformly from ``[low, high)``; forms as for ``Certificate.mean``."""
        return _less_rounding(self, math.prod(part.mean(*box) for part, box in _boxes(self, low, high)))

    def min(self, low: Any, high: Any) -> float:
        """Return a lower bound from every start in the box; forms as for ``Certificate.min``."""
        return _less_rounding(self, math.prod(part.min(*box) for part, box in _boxes(self, low, high)))

    @cached_property
    def alike(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the parts, those that differ in nothing but names together."""
        by_content: dict[object, list[int]] = {}
        for k, part in enumerate(self.parts):
            # Parts that came from one synthesis share their arrays; comparing these by identity is quick.
            content = tuple(id(getattr(part, field.name)) for field in fields(part) if field.name != "problem")
            by_content.setdefault((content, nameless(part.problem)), []).append(k)
        return tuple(tuple(same) for same in by_content.values())

    def split(self, state: Any) -> list[tuple[Certificate, FloatArray]]:
        """Return each part with its share of a joint state, in any form that ``at`` takes."""
        joint = joint_states(self.problem, state)[0]
        return [(part, joint[columns]) for part, columns in zip(self.parts, self._columns, strict=True)]

    @cached_property
    def _columns(self) -> tuple[Any, ...]:
        """Components of each part's agents in a joint state."""
        components = np.arange(self.problem.n_states)
        of_agent = [components[columns] for columns in self.problem.columns]
        return tuple(np.concatenate([of_agent[i] for i in group.agents]) for group in self.problem.groups)


def _less_rounding(product: ProductCertificate, value: float) -> float:
    """Return a product over the parts less what its rounding may have added: a lower bound."""
    return max(0.0, value * (1.0 - 4.0 * len(product.parts) * UNIT))


def _boxes(product: ProductCertificate, low: Any, high: Any) -> list[tuple[Certificate, tuple[FloatArray, FloatArray]]]:
    """Return each part with its share of a box."""
    corners = zip(product.split(low), product.split(high), strict=True)
    return [(part, (first, last)) for (part, first), (_, last) in corners]


def product_certificate(problem: Problem, parts: tuple[Certificate, ...]) -> ProductCertificate:
    """Return the product of certificates, each given the names of its agents.

    Raises
    ------
    ValueError
        If a certificate is not of the task it stands for, up to names.
    """
    tasks = problem.tasks
    if len(parts) != len(tasks):
        raise ValueError(f"`parts`: expected one certificate per task, {len(tasks)}, got {len(parts)}")
    named = []
    for task, part in zip(tasks, parts, strict=True):
        if nameless(part.problem) != nameless(task):
            raise ValueError(f"`parts`: expected a certificate of {task.name!r}, got one of {part.problem.name!r}")
        named.append(replace(part, problem=task))
    return ProductCertificate(problem, tuple(named))


def nameless(problem: Problem) -> str:
    """Return everything that a certificate of the problem depends on, as text: names of agents are left out."""
    agents = [agent.to_dict() for agent in problem.agents]
    places = {agent.name: i for i, agent in enumerate(problem.agents)}
    for agent in agents:
        del agent["name"]
    regions = [{**region.to_dict(), "agent": places[region.agent]} for region in problem.propositions.values()]
    automaton = problem.automaton.to_dict()
    # Propositions are told by their place in the automaton, agents by their place in the problem.
    order = {name: k for k, name in enumerate(automaton["propositions"])}
    asked = [order[name] for name in problem.propositions]
    task = {key: value for key, value in automaton.items() if key != "propositions"}
    return json.dumps([problem.horizon, agents, regions, asked, task], sort_keys=True)
