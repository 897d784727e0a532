"""Proofs for independent tasks, multiplied.

Where a task decomposes into tasks of disjoint groups of agents (``envs.problem.groups``), every group is certified
separately, and the product of the lower bounds is a lower bound for the whole: noises, starts and policies of different
groups are independent. Time and memory are sums over the groups, so that they grow linearly with the number of agents;
groups that differ in nothing but names are synthesized once.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from ..cell_probabilities import AgentRecord
from ..controllers import ProductController
from ..value_functions import UNIT
from .archive import Pool, Stored
from .certificate import Certificate, alike_among, nameless
from .claim import joint_states
from .proof import Proof


@dataclass(frozen=True, eq=False, repr=False)
class ProductProof(Proof):
    """A bound for a task that decomposes: the product of the bounds of its independent tasks.

    Parameters
    ----------
    parts : tuple of Certificate
        One for each of the problem's ``tasks_apart``, in order.
    """

    parts: tuple[Certificate, ...]

    kind = "product"
    inside = frozenset({"grid", "path", "timed", "vertex-grid"})

    @property
    def factors(self) -> tuple[Certificate, ...]:
        """Its parts."""
        return self.parts

    @property
    def lower_bound(self) -> float:
        """Certified lower bound at the problem's start."""
        return _product(part.lower_bound for part in self.parts)

    def gap_of(self, problem: Problem) -> float | None:
        """Return the gap: None for co-safe tasks, since their parts ask for more than the whole does."""
        gaps = [part.gap for part in self.parts if part.gap is not None]
        if len(gaps) < len(self.parts) or problem.specification.is_co_safe:
            return None
        most = math.prod(min(1.0, part.lower_bound + gap) for part, gap in zip(self.parts, gaps, strict=True))
        return min(1.0, most * (1.0 + 4.0 * len(gaps) * UNIT)) - self.lower_bound

    @property
    def has_cells(self) -> bool:
        """Whether all parts are about cells."""
        return all(part.proof.has_cells for part in self.parts)

    @property
    def method(self) -> str:
        """Relation, bound and policy search of the parts, in words."""
        methods = sorted({part.proof.method for part in self.parts})
        return f"{len(self.parts)} independent tasks, {'; '.join(methods)}"

    @property
    def bound(self) -> str:
        """Names of the bounds of the parts."""
        return ", ".join(sorted({part.proof.bound for part in self.parts}))

    @property
    def rank(self) -> int:
        """Largest number of terms, or of columns of a bond, of any part."""
        return max(part.proof.rank for part in self.parts)

    def settings_of_parts(self) -> dict[str, Any]:
        """Return the settings of the parts, but for what was believed of them: each that occurs, and which have it."""
        by_text: dict[str, dict[str, Any]] = {}
        for k, part in enumerate(self.parts):
            own = {key: value for key, value in part.settings.items() if key != "believed"}
            by_text.setdefault(json.dumps(own), {"settings": own, "parts": []})["parts"].append(k)
        return {"parts": list(by_text.values())}

    def agents_of(self, problem: Problem) -> tuple[AgentRecord, ...]:
        """Return what is stored of each agent, in the order of the problem's agents."""
        stored: dict[int, AgentRecord] = {}
        for group, part in zip(problem.apart, self.parts, strict=True):
            stored |= dict(zip(group.agents, part.proof.agents_of(part.problem), strict=True))
        return tuple(stored[i] for i in range(problem.n_agents))

    def with_claims(self, certificate: Certificate, change: Callable[[Any], Any]) -> Certificate:
        """Return the same claim, with what a function makes of its parts: once of those that differ in names alone."""
        changed: dict[int, Certificate] = {}
        for same in alike_among(self.parts):
            first = self.parts[same[0]]
            changed |= dict.fromkeys(same, first.proof.with_claims(first, change))
        product = product_certificate(certificate.problem, tuple(changed[k] for k in range(len(self.parts))))
        return replace(certificate, proof=product.proof)

    def controller(self, problem: Problem) -> ProductController:
        """Return the controllers the bound belongs to."""
        return ProductController(problem, tuple(part.controller for part in self.parts))

    def claim(self, certificate: Certificate) -> ProductClaim:
        """Return the product of the claims of the parts."""
        return ProductClaim(certificate.problem, self.parts)

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        numbers: dict[int, int] = {}
        for same in alike_among(self.parts):
            # Parts that differ in names alone share one file in the archive.
            numbers |= dict.fromkeys(same, pool.put_file(self.parts[same[0]]))
        return {"parts": [numbers[k] for k in range(len(self.parts))]}

    @classmethod
    def read(cls, problem: Problem, stored: Stored) -> Self:
        """Return the proof in a file; the problem itself says which tasks these are."""
        if not problem.apart:
            raise ValueError("its problem does not decompose into independent tasks")
        parts = tuple(stored.certificate(number) for number in stored.entry["parts"])
        return cls(product_certificate(problem, parts).proof.parts)


@dataclass(frozen=True, eq=False)
class ProductClaim:
    """Lower bounds from every start: products of those of independent tasks.

    Parameters
    ----------
    problem : Problem
    parts : tuple of Certificate
    """

    problem: Problem
    parts: tuple[Certificate, ...]

    def at(self, states: Any) -> FloatArray:
        """Return lower bounds (M,) from each of M joint initial states, in any form that ``Certificate.at`` takes."""
        values: Any = 1.0
        for part, shares in zip(self.parts, split(self.problem, states), strict=True):
            values = values * part.at(shares)
        # Independent tasks: probabilities multiply, and every product may have been rounded up.
        return np.maximum(0.0, values * (1.0 - 4.0 * len(self.parts) * UNIT))

    def mean(self, low: Any, high: Any) -> float:
        """Return a lower bound from a start drawn uniformly from ``[low, high)``; forms as for ``Certificate.mean``."""
        return _product(part.mean(a[0], b[0]) for part, a, b in self._boxes(low, high))

    def min(self, low: Any, high: Any) -> float:
        """Return a lower bound from every start in the box; forms as for ``Certificate.min``."""
        return _product(part.min(a[0], b[0]) for part, a, b in self._boxes(low, high))

    def _boxes(self, low: Any, high: Any) -> Any:
        """Return each part with its share of a box."""
        return zip(self.parts, split(self.problem, low), split(self.problem, high), strict=True)


def split(problem: Problem, states: Any) -> list[FloatArray]:
    """Return the shares (M, D_k) of each independent task in joint states, in any form that ``at`` takes."""
    joint, components = joint_states(problem, states), np.arange(problem.n_states)
    of_agent = [components[columns] for columns in problem.columns]
    return [joint[:, np.concatenate([of_agent[i] for i in group.agents])] for group in problem.apart]


def _product(values: Any) -> float:
    """Return a product over parts less what its rounding may have added: a lower bound."""
    numbers = tuple(values)
    return max(0.0, math.prod(numbers) * (1.0 - 4.0 * len(numbers) * UNIT))


def product_certificate(problem: Problem, parts: tuple[Certificate, ...]) -> Certificate[ProductProof]:
    """Return the product of certificates, each given the names of its agents.

    Raises
    ------
    ValueError
        If a certificate is not of the task it stands for, up to names.
    """
    tasks = problem.tasks_apart
    if len(parts) != len(tasks):
        raise ValueError(f"`parts`: expected one certificate per task, {len(tasks)}, got {len(parts)}")
    named = []
    for task, part in zip(tasks, parts, strict=True):
        if nameless(part.problem) != nameless(task):
            raise ValueError(f"`parts`: expected a certificate of {task.name!r}, got one of {part.problem.name!r}")
        named.append(replace(part, problem=task, proof=part.proof.named(task)))
    proof = ProductProof(tuple(named))
    return Certificate(problem, proof, proof.settings_of_parts())
