"""The relation that certifies most: what applies is tried, what cannot exceed the best is left out.

Agents with the same dynamics, cells and wishes form a group and share a relation; groups may have different ones. Each
group has finite models under every relation that applies to it. For a combination of relations, one per group, a bound
from above is known before any search: the product of what each agent could do if the team followed (``relaxation``).
The search begins with the combination of the largest such bound, or (unless that is ``exact`` throughout) with another
one that after a single sweep is ahead of it; then one group after the other is changed. Combinations whose bound from
above is not worth a search are passed over, and so are those that after one sweep are far behind. So the number of
searches grows with the number of groups, not of combinations; it is not claimed that no other combination is better
(docs/theory/relations.md, "Which relation certifies most?").

An agent for which ``exact`` applies is *settled*, and nothing else is looked at, if no cell is without a target and the
reserve takes at most ``SETTLED`` of its inputs. No theorem says that it is then the best on the same cells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ....envs.systems.agents import Agent, AnyAgent, LinearAgent
from ....envs.tasks.problem import Problem
from ...abstraction.models import (
    Abstraction,
    AgentModel,
    JointModel,
    Settings,
    check_names,
    join,
    lost_beside,
    models_of,
    reaches_every_mean,
    start_of,
)
from ...certificates.proofs import Synthesis, rounded_up
from ...relations.grids import CellCounts, RelationRefused, cells_of_agent
from ..ascent import MANY_TERMS, Limits, Relaxation, relax, relaxed_policies, sweep, upper_bound

SETTLED = 0.1
"""Share of the inputs, per cell, that the ``exact`` relation may keep in reserve where nothing else is tried."""

LEAST_GAIN = 1e-3
"""Gains up to this are not worth a search."""

PROMISING = 0.5
"""Share of the best bound that one sweep must reach for the search to go on."""

MOST_LINEAR_AGENTS = 2
"""Agents of a task up to which linear cells are tried without being asked for, unless each has a single state."""

Combination = tuple[str, ...]
"""Relation of each group."""

Tried = dict[str, float | str]
"""By relation, the bound that it gave, or why there is none."""

RunOnModels = Callable[[Abstraction, JointModel, tuple[Relaxation, ...]], Synthesis]
"""Synthesis on finite models."""


@dataclass(frozen=True, eq=False)
class AgentGroup:
    """Agents that are alike, and their finite models under each relation that they may have.

    Parameters
    ----------
    members : tuple of int
        Numbers of the agents.
    models : dict
        By relation, the model of each member.
    refused : dict
        By relation, why it does not apply.
    """

    members: tuple[int, ...]
    models: dict[str, dict[int, AgentModel]]
    refused: dict[str, str]


def groups_of(problem: Problem, cells: CellCounts, asked: Sequence[str], settings: Settings) -> list[AgentGroup]:
    """Return groups of agents with their models; ``asked`` names a relation per agent, or ``"auto"`` or ``"best"``.

    Raises
    ------
    ValueError
        If no relation applies to a group.
    """
    check_names("cells", cells, problem)
    settings.refuse_foreign(asked)
    # Equal arrays, cells and wishes make equal models: compare once for all members.
    alike: dict[object, list[int]] = {}
    for i, agent in enumerate(problem.agents):
        key = (asked[i], cells_of_agent(agent, cells), *agent.model_key)
        alike.setdefault(key, []).append(i)
    return [_group(problem, cells, asked[members[0]], tuple(members), settings) for members in alike.values()]


def _group(problem: Problem, cells: CellCounts, asked: str, members: tuple[int, ...], settings: Settings) -> AgentGroup:
    """Return the group with its models under all relations that are asked for and apply."""
    models: dict[str, dict[int, AgentModel]] = {}
    refused: dict[str, str] = {}
    first = problem.agents[members[0]]
    if asked in ("auto", "best") and not first.has_plain_noise:
        asked = "boxes"
    automatic = ("exact",) if first.has_full_rank else ("linear",)
    wanted: dict[str, tuple[str, ...]] = {"auto": automatic, "best": (*automatic, "paper")}
    if not isinstance(first, LinearAgent):
        is_smooth = problem.n_agents <= MOST_LINEAR_AGENTS and has_linear_cells(first)
        first_try = ("exact",) if reaches_every_mean(first) else ()
        wanted = dict.fromkeys(wanted, (*first_try, *(("linear", "boxes") if is_smooth else ("boxes",))))
    elif first.laws is not None:
        wanted = dict.fromkeys(wanted, ("exact", "boxes") if first.has_full_rank else ("boxes",))
    for relation in wanted.get(asked, (asked,)):
        try:
            member_models = models_of(problem, cells, dict.fromkeys(members, relation), settings)
        except RelationRefused as error:
            refused[relation] = " ".join(str(error).split())
            continue
        kinds = {model.relation.kind for model in member_models.values()}
        models["/".join(sorted(kinds)) if relation == "quick" else relation] = member_models
        if asked == "auto" and all(map(is_settled, member_models.values())):
            break
    if not models:
        if len({*refused.values()}) == 1:
            raise RelationRefused(*{*refused.values()})
        name = problem.agents[members[0]].name
        listed = "; ".join(f"{relation}: {reason}" for relation, reason in refused.items())
        raise RelationRefused(f"`relation`: expected one that applies to agent `{name}`, got none: {listed}")
    return AgentGroup(members, models, refused)


def has_linear_cells(agent: AnyAgent) -> bool:
    """Return whether linear cells hold for the noise of an agent, and no other agent moves it.

    Neighbours would be disturbances under linear cells; mean boxes cancel those that are communicated.
    """
    if not agent.has_plain_noise or agent.angles:
        return False
    if isinstance(agent, Agent):
        return not agent.others and all(law.name == "gaussian" for law in agent.laws or ())
    return agent.laws is None


def is_settled(model: AgentModel) -> bool:
    """Return whether the relation is ``exact``, every cell has a target, and the reserve takes few of the inputs."""
    return model.choices.is_settled(1.0 - SETTLED)


@dataclass(eq=False)
class Tries:
    """Combinations of relations for a team, and what was computed of them.

    Parameters
    ----------
    problem : Problem
    groups : list of AgentGroup
    settings : Settings
    """

    problem: Problem
    groups: list[AgentGroup]
    settings: Settings

    def __post_init__(self) -> None:
        self._joined: dict[Combination, tuple[Abstraction, JointModel] | str] = {}
        self._relaxations: dict[object, Relaxation] = {}
        self._values: dict[Combination, float] = {}

    def name(self, combination: Combination) -> str:
        """Return the relation, or the relation of each group where they differ, in words."""
        if len({*combination}) == 1:
            return combination[0]
        words = []
        for group, relation in zip(self.groups, combination, strict=True):
            others = f" and {len(group.members) - 1} alike" if len(group.members) > 1 else ""
            words.append(f"{relation} for {self.problem.agents[group.members[0]].name}{others}")
        return ", ".join(words)

    def models(self, combination: Combination) -> tuple[Abstraction, JointModel] | str:
        """Return the finite models of a combination, alone and joined; or why they cannot be joined."""
        if combination not in self._joined:
            pairs = zip(self.groups, combination, strict=True)
            models = dict(item for group, relation in pairs for item in group.models[relation].items())
            ordered = tuple(models[i] for i in range(self.problem.n_agents))
            abstraction = Abstraction(ordered, self.settings.used_by(ordered))
            if why := lost_beside(ordered):
                self._joined[combination] = why
                return why
            try:
                self._joined[combination] = abstraction, join(self.problem, abstraction)
            except RelationRefused as error:  # labels that are not certain can mean too many guards
                self._joined[combination] = " ".join(str(error).split())
        return self._joined[combination]

    def most(self, combination: Combination) -> float:
        """Return an upper bound on what any policy attains on these models; -1 where they cannot be joined."""
        models = self.models(combination)
        if isinstance(models, str):
            return -1.0
        joint = models[1]
        return upper_bound(joint, start_of(self.problem, joint), self.relaxations(joint))

    def relaxations(self, joint: JointModel) -> tuple[Relaxation, ...]:
        """Return the relaxations of a combination; models that several combinations share are solved once."""
        return relax(self.problem, joint, self._relaxations)

    def value(self, combination: Combination) -> float:
        """Return what one sweep attains, to compare combinations by; with one agent the bound from above says it."""
        models = self.models(combination)
        if isinstance(models, str) or self.problem.n_agents == 1:
            return self.most(combination)
        if combination not in self._values:
            joint, limits = models[1], Limits(rank=MANY_TERMS)
            policies = relaxed_policies(self.relaxations(joint))
            outcome = sweep(joint, policies, start_of(self.problem, joint), limits, improve=True)
            self._values[combination] = outcome.value
        return self._values[combination]

    def first(self) -> Combination:
        """Return the combination to begin with: of the largest bounds from above, unless one sweep says otherwise."""
        usual = tuple(next(iter(group.models)) for group in self.groups)
        if all(len(group.models) == 1 for group in self.groups):
            return usual
        # For each group the first relation, in order of preference, whose bound from above is as good as any.
        chosen = usual
        for g, group in enumerate(self.groups):
            bounds = {relation: self.most(_changed(usual, g, relation)) for relation in group.models}
            enough = max(bounds.values()) - LEAST_GAIN
            chosen = _changed(chosen, g, next(relation for relation in group.models if bounds[relation] >= enough))
        if {*chosen} == {"exact"}:
            return chosen  # what it certifies may well leave nothing worth a sweep over the others
        value = self.value(chosen)
        for g, relation in self._options():
            combination = _changed(chosen, g, relation)
            if self.most(combination) > value + LEAST_GAIN and self.value(combination) > value:
                chosen, value = combination, self.value(combination)
        return chosen

    def best(self, run: RunOnModels, earlier: Synthesis | None = None, every: bool = False) -> tuple[Synthesis, Tried]:
        """Return the synthesis with the largest bound, and what was tried: its bound, or why it was not computed.

        Parameters
        ----------
        run : callable
            Synthesis on finite models.
        earlier : Synthesis, optional
            One that was made on the same cells: it counts as tried.
        every : bool
            Whether no combination is passed over.
        """
        chosen, best = self.first() if earlier is None else self._of(earlier), earlier
        tried: Tried = {} if earlier is None else {self.name(chosen): float(earlier.certificate.lower_bound)}
        # The first combination, then the best so far with one group changed at a time.
        for g, relation in ((0, chosen[0]), *self._options()):
            combination = _changed(chosen, g, relation)
            name, models = self.name(combination), self.models(combination)
            if name in tried:
                continue
            # Without a best there is nothing to compare with: the first combination that can be joined is run.
            passed = None if best is None or every else self._passed_over(combination, chosen, best)
            if isinstance(models, str) or passed is not None:
                tried[name] = passed or str(models)
                continue
            result = run(*models, self.relaxations(models[1]))
            tried[name] = float(result.certificate.lower_bound)
            if best is None or result.certificate.lower_bound > best.certificate.lower_bound:
                best, chosen = result, combination
        # Relations that do not apply are part of the record, too.
        for group in self.groups:
            where = "" if len(self.groups) == 1 else f" for {self.problem.agents[group.members[0]].name}"
            tried |= {f"{relation}{where}": reason for relation, reason in group.refused.items()}
        if best is None:
            raise RelationRefused("; ".join(dict.fromkeys(map(str, tried.values()))))
        return best, tried

    def _options(self) -> list[tuple[int, str]]:
        """Return every group with each of its relations."""
        return [(g, relation) for g, group in enumerate(self.groups) for relation in group.models]

    def _of(self, synthesis: Synthesis) -> Combination:
        """Return the relations of a synthesis."""
        kinds = [part.relation["kind"] for part in synthesis.certificate.proof.agents]
        return tuple(kinds[group.members[0]] for group in self.groups)

    def _passed_over(self, combination: Combination, chosen: Combination, best: Synthesis) -> str | None:
        """Return why a combination is not worth a search next to ``best``, which is ``chosen``; None if it may be."""
        # What is certified is never more than the value of the finite models, and so than their bound from above.
        lower, most = best.certificate.lower_bound, self.most(combination)
        if 0.0 <= most <= lower + LEAST_GAIN:
            return f"at most {rounded_up(most)}, not computed"
        if 0.0 <= self.value(combination) < PROMISING * lower:
            return f"{self.value(combination):.3g} after one sweep, not gone on with"
        return None


def _changed(combination: Combination, g: int, relation: str) -> Combination:
    """Return the combination with another relation of group g."""
    return (*combination[:g], relation, *combination[g + 1 :])
