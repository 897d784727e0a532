"""The one way to say that a relation does not apply, told apart from mistakes of the caller."""

from __future__ import annotations

from ....envs.systems.agents import AnyAgent, LinearAgent
from ....envs.tasks.problem import JOINT_NOISE_REFUSAL, Problem

LAWFUL = ("exact", "boxes")
"""Relations that hold for noise of any law."""


class RelationRefused(ValueError):
    """No relation of the kind that was asked for ties this agent to these cells; the text says what to try.

    A search over relations or cells catches it and continues; other errors are mistakes of the caller and end it.
    """


FEWER = "; ask for fewer `cells` or `targets_per_cell`"
"""What cells that take too much are refused with, for those who asked for them."""


def to_who_asked_for_none(text: object) -> str:
    """Return why cells take too much, in one line, without the advice to ask for fewer: nobody asked for any."""
    return " ".join(str(text).split()).replace(FEWER, "")


def refuse_shared_noise(problem: Problem) -> None:
    """Raise RelationRefused where agents share noise, for relations that take them for independent."""
    if problem.joint_noise:
        raise RelationRefused(JOINT_NOISE_REFUSAL)


class NoRunFound(RelationRefused):
    """No run without noise satisfies the task, as far as a search of stated effort can tell; no proof of it."""


def refuse_uneven_noise(agent: AnyAgent, relation: str) -> None:
    """Refuse a relation that needs noise in every state, of one size everywhere."""
    if not agent.has_plain_noise:
        what = "a `noise_scale`" if agent.noise_scale is not None else "a state without noise"
        raise RelationRefused(
            f"agent `{agent.name}`: the relation `{relation}` is for noise in every state that is the same everywhere, "
            f"got {what}; ask for `boxes`"
        )


def refuse_angles(agent: AnyAgent, relation: str) -> None:
    """Refuse a relation that takes states for numbers."""
    if agent.angles:
        raise RelationRefused(
            f"agent `{agent.name}`: the relation `{relation}` is for states that are numbers, got the angle "
            f"{agent.angles[0]!r}, which wraps; ask for `boxes` or `path`"
        )


def linear_agent(agent: AnyAgent, relation: str) -> LinearAgent:
    """Return an agent whose dynamics are matrices, or refuse a relation that needs them, or Gaussian noise."""
    if not isinstance(agent, LinearAgent):
        raise RelationRefused(
            f"agent `{agent.name}`: the relation `{relation}` is for linear dynamics (A and B), got "
            "expressions; ask for `boxes`"
        )
    if agent.laws is not None and relation not in LAWFUL:
        raise RelationRefused(
            f"agent `{agent.name}`: the relation `{relation}` is for Gaussian noise, got other laws; ask for "
            f"{' or '.join(f'`{name}`' for name in LAWFUL)}"
        )
    return agent
