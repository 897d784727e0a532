"""Paths of agents with angles: planned where angles are numbers of several turns, and said of the angles themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....envs.tasks.problem import Problem, Unrolled, unrolled
from ...certificates.proofs import SOMETIME, AlongPath, Synthesis, changed
from .counted_work import CountedWork

SearchOf = Callable[[Problem, CountedWork], Synthesis]
"""A search for a path of a problem without angles."""


def along_angles(problem: Problem, search: SearchOf, work: CountedWork) -> Synthesis:
    """Return a certificate along a path of a problem with angles, from that of the problem unrolled."""
    flat = unrolled(problem)
    found = search(flat.problem, work)
    certificate = _rolled(problem, flat, found.certificate)
    return replace(found, certificate=certificate, controller=certificate.controller)


def _rolled(problem: Problem, flat: Unrolled, found: AlongPath) -> AlongPath:
    """Return the certificate of the problem itself: the same paths, and letters of regions in place of their copies."""
    there = {name: p for p, name in enumerate(flat.problem.automaton.propositions)}
    names = problem.automaton.propositions
    shape = (len(found.proof.letters), len(names))
    letters, faces = np.zeros(shape, dtype=found.proof.letters.dtype), np.full(shape, -1, dtype=found.proof.faces.dtype)
    for p, name in enumerate(names):
        if name not in flat.copies:
            letters[:, p], faces[:, p] = found.proof.letters[:, there[name]], found.proof.faces[:, there[name]]
            continue
        columns = [there[copy] for copy in flat.copies[name]]
        own = found.proof.letters[:, columns]
        # One copy is met at a time, all are missed together.
        letters[:, p] = np.where(np.any(own > 0, axis=1), own.max(axis=1), np.where(np.all(own < 0, axis=1), -1, 0))
        sides = _sides(problem, flat, found, name, columns)
        crossed = found.proof.faces[:, columns][np.arange(len(own)), np.argmax(own, axis=1)]
        faces[:, p] = np.where(letters[:, p] == SOMETIME, crossed, sides)
    has_side = (letters < 0) | (letters == SOMETIME)
    found = replace(found, problem=problem, settings=_without_limits(found.settings))
    return changed(found, letters=letters, faces=np.where(has_side, faces, -1))


def _without_limits(settings: dict[str, Any]) -> dict[str, Any]:
    """Return settings without how near limits are: the search may have asked for another copy of a region."""
    believed = {key: value for key, value in settings.get("believed", {}).items() if key != "nearest"}
    return {**settings, **({"believed": believed} if believed else {})}


def _sides(problem: Problem, flat: Unrolled, found: AlongPath, name: str, columns: list[int]) -> NDArray[np.int64]:
    """Return the sides (S + 1,) on which a region is passed.

    Between two copies, unless one of the two is passed along another output, which then passes all copies.
    """
    i = problem.agent_names.index(problem.propositions[name].agent)
    agent, states = flat.problem.agents[i], found.proof.paths[i].states
    outputs, angles = agent.outputs(states.T), problem.agents[i].angle_outputs
    sides = np.full(len(states), -1)
    regions = [flat.problem.propositions[copy] for copy in flat.copies[name]]
    for t in range(len(states)):
        chosen = [int(found.proof.faces[t, column]) for column in columns]
        # Copies differ along angles alone; those next to the path come first.
        k = next((face // 2 for face in chosen if face >= 0 and face // 2 in angles), angles[0])
        centres = [0.5 * float(region.low[k] + region.high[k]) for region in regions]
        near = np.argsort(np.abs(np.array(centres) - outputs[k, t]), kind="stable")[:2]
        others = [chosen[c] for c in near if chosen[c] >= 0 and chosen[c] // 2 not in angles]
        sides[t] = others[0] if others else chosen[near[0]]
    return sides
