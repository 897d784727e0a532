"""Forgeries of one cell: one entry of an honest claim changed, the claim adapted to what the check would then prove.

``forgeries`` changes fields of files in the large; here a single policy entry, factor, guard bit, lattice point, union,
input, letter, corner or weight is another one, so that nothing but the one check that is about it can
see it. The forger knows the check: it claims what is recomputed from the changed certificate, or a little more than the
honest claim if that is all that the check says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.certificates.proofs import PathProof, changed
from certigym.synthesis.certificates.value_functions import Terms

Forged = tuple[str, Any]
"""What was changed, and the changed claim."""


def forgeries_of(claim: Any, rng: np.random.Generator, each: int) -> Iterator[Forged]:
    """Forgeries of a claim, ``each`` of every sort."""
    if isinstance(claim.proof, PathProof):
        for along in (_nominal_input, _gain, _letter, _face):
            yield from _repeated(along, claim, rng, each)
    elif isinstance(claim, cg.Certificate):
        yield from _of_parts(claim, rng, each)
        for one in (_factor, _guard, _start_guard, _union, _kept):
            yield from _repeated(one, claim, rng, each)


def _repeated(
    one: Callable[[Any, np.random.Generator], Forged | None], claim: Any, rng: np.random.Generator, each: int
) -> Iterator[Forged]:
    for _ in range(each):
        found = one(claim, rng)
        if found is not None:
            yield found


def _of_parts(certificate: cg.Certificate, rng: np.random.Generator, each: int) -> Iterator[Forged]:
    """Forgeries of what is stored of one agent."""
    changes = (_choice, _best_choice, _mask, _start_mask, _lattice, _menu_point, _number, _weight)
    for change in changes:
        for _ in range(each):
            i = int(rng.integers(len(certificate.proof.agents)))
            part = change(certificate.proof.agents[i], rng)
            if part is not None:
                agents = (*certificate.proof.agents[:i], part, *certificate.proof.agents[i + 1 :])
                yield change.__name__.strip("_").replace("_", " "), changed(certificate, agents=agents)


def _put(array: np.ndarray, place: Any, value: Any) -> np.ndarray:
    array = array.copy()
    array[place] = value
    return array


def _anywhere(array: np.ndarray, rng: np.random.Generator) -> tuple[int, ...] | None:
    return tuple(int(rng.integers(n)) for n in array.shape) if array.size else None


def _choice(part: Any, rng: np.random.Generator) -> Any:
    """Another choice that occurs somewhere, in one cell."""
    place = _anywhere(part.policy, rng)
    return replace(part, policy=_put(part.policy, place, rng.choice(np.unique(part.policy))))


def _best_choice(part: Any, rng: np.random.Generator) -> Any:
    """In one cell without a choice, or any, the commonest choice of its time and automaton state."""
    empty = np.argwhere(part.policy < 0)
    place = tuple(empty[int(rng.integers(len(empty)))]) if len(empty) else _anywhere(part.policy, rng)
    assert place is not None
    row = part.policy[place[0], place[1]]
    known = row[row >= 0]
    return replace(part, policy=_put(part.policy, place, np.bincount(known).argmax())) if len(known) else None


def _mask(part: Any, rng: np.random.Generator) -> Any:
    """One more cell in which a guard holds."""
    absent = np.argwhere(~part.masks)
    if not len(absent):
        return None
    return replace(part, masks=_put(part.masks, tuple(absent[int(rng.integers(len(absent)))]), True))


def _start_mask(part: Any, rng: np.random.Generator) -> Any:
    """One more cell in which a start is read in a guard's favour."""
    absent = np.argwhere(~part.start_masks)
    if not len(absent):
        return None
    return replace(part, start_masks=_put(part.start_masks, tuple(absent[int(rng.integers(len(absent)))]), True))


def _lattice(part: Any, rng: np.random.Generator) -> Any:
    """One lattice point moved a little towards the middle, or the whole way to the next one."""
    k = int(rng.integers(len(part.lattice)))
    axis = part.lattice[k]
    if len(axis) < 3:
        return None
    place = int(rng.integers(len(axis) - 1))
    moved = axis[place] + float(rng.choice([0.01, 0.4])) * (axis[place + 1] - axis[place])
    return replace(part, lattice=(*part.lattice[:k], _put(axis, place, moved), *part.lattice[k + 1 :]))


def _menu_point(part: Any, rng: np.random.Generator) -> Any:
    """One cell of which an input is said to lead to another lattice point."""
    if part.input_set is None:
        return None
    place = _anywhere(part.input_set, rng)
    return replace(part, input_set=_put(part.input_set, place, rng.choice(np.unique(part.input_set))))


def _number(part: Any, rng: np.random.Generator) -> Any:
    """One number of the relation: an input of the menu, or a gain."""
    names = [name for name in ("menu", "feedback", "F", "inputs") if np.size(part.relation.get(name, ()))]
    if not names:
        return None
    name = str(rng.choice(names))
    values = np.array(part.relation[name], dtype=float)
    place = _anywhere(values, rng)
    moved = values[place] + float(rng.choice([-0.05, 0.05, 0.3])) * (float(np.ptp(values)) or 1.0)
    return replace(part, relation={**part.relation, name: _put(values, place, moved).tolist()})


def _weight(part: Any, rng: np.random.Generator) -> Any:
    """One weight of a network."""
    network = part.relation.get("network")
    if network is None:
        return None
    layers = [np.array(layer) for layer in network["weights"]]
    k = int(rng.integers(len(layers)))
    place = _anywhere(layers[k], rng)
    layers[k] = _put(layers[k], place, np.float32(layers[k][place] + rng.choice([-0.3, 0.3])))
    weights = [layer.tolist() if isinstance(old, list) else layer for layer, old in zip(layers, network["weights"])]
    return replace(part, relation={**part.relation, "network": {**network, "weights": weights}})


def _factor(certificate: cg.Certificate, rng: np.random.Generator) -> Forged | None:
    """One stored value raised."""
    if certificate.proof.terms is None:
        return None
    i = int(rng.integers(len(certificate.proof.terms.factors)))
    factors = certificate.proof.terms.factors[i]
    place = _anywhere(factors, rng)
    if place is None:
        return None
    raised = _put(factors, place, factors[place] + float(rng.choice([1e-6, 0.01, 0.3])))
    every = (*certificate.proof.terms.factors[:i], raised, *certificate.proof.terms.factors[i + 1 :])
    return "factor", changed(certificate, terms=Terms(every, certificate.proof.terms.index))


def _guard(certificate: cg.Certificate, rng: np.random.Generator) -> Forged | None:
    """One agent's factor of one guard is another mask, or the guard leads elsewhere."""
    return _guard_of(certificate, rng, "guard_target", "guard_mask", "masks")


def _start_guard(certificate: cg.Certificate, rng: np.random.Generator) -> Forged | None:
    """The same for the letter of time 0."""
    return _guard_of(certificate, rng, "start_target", "start_mask", "start_masks")


def _guard_of(certificate: Any, rng: np.random.Generator, target: str, mask: str, masks: str) -> Forged | None:
    targets, chosen = getattr(certificate.proof, target), getattr(certificate.proof, mask)
    if not len(targets):
        return None
    if rng.random() < 0.5:
        states = certificate.problem.automaton.n_states
        other = _put(targets, int(rng.integers(len(targets))), rng.integers(states))
        return target, changed(certificate, **{target: other})
    place = _anywhere(chosen, rng)
    assert place is not None
    number = len(getattr(certificate.proof.agents[place[1]], masks))
    return mask, changed(certificate, **{mask: _put(chosen, place, rng.integers(number))})


def _union(certificate: cg.Certificate, rng: np.random.Generator) -> Forged | None:
    """One more union of two rows, or one that is there in another agent's factor."""
    if not certificate.proof.merge_log:
        return None
    t = int(rng.integers(len(certificate.proof.merge_log)))
    step = certificate.proof.merge_log[t]
    wide = [q for q, rows in enumerate(step.origin) if len(rows) > 1]
    if not wide:
        return None
    q = int(rng.choice(wide))
    merges, agent = step.merges[q], int(rng.integers(len(certificate.proof.agents)))
    gone = set(merges.absorbed.tolist())
    left = [k for k in range(len(step.origin[q])) if k not in gone]
    if len(left) < 2:
        return None
    into, absorbed = (int(k) for k in rng.permutation(left)[:2])
    united = replace(
        merges,
        into=np.append(merges.into, into), absorbed=np.append(merges.absorbed, absorbed),
        agent=np.append(merges.agent, agent), rest=np.append(merges.rests, 0),
    )  # fmt: skip
    kept = step.kept[q][step.kept[q] != absorbed] if rng.random() < 0.5 else step.kept[q]
    other = replace(
        step,
        merges=(*step.merges[:q], united, *step.merges[q + 1 :]),
        kept=(*step.kept[:q], kept, *step.kept[q + 1 :]),
    )
    merge_log = (*certificate.proof.merge_log[:t], other, *certificate.proof.merge_log[t + 1 :])
    return "union", changed(certificate, merge_log=merge_log)


def _kept(certificate: cg.Certificate, rng: np.random.Generator) -> Forged | None:
    """One vertex counted twice, or kept in the place of another."""
    if not certificate.proof.merge_log:
        return None
    t = int(rng.integers(len(certificate.proof.merge_log)))
    step = certificate.proof.merge_log[t]
    some = [q for q, rows in enumerate(step.kept) if len(rows)]
    if not some:
        return None
    q = int(rng.choice(some))
    kept = step.kept[q]
    again = np.append(kept, kept[-1]) if rng.random() < 0.5 else _put(kept, 0, rng.integers(len(step.origin[q])))
    other = replace(step, kept=(*step.kept[:q], again.astype(kept.dtype), *step.kept[q + 1 :]))
    merge_log = (*certificate.proof.merge_log[:t], other, *certificate.proof.merge_log[t + 1 :])
    return "kept vertex", changed(certificate, merge_log=merge_log)


def _of_path(certificate: Any, rng: np.random.Generator, name: str, share: float) -> Forged | None:
    i = int(rng.integers(len(certificate.proof.paths)))
    path = certificate.proof.paths[i]
    values = getattr(path, name)
    place = _anywhere(values, rng)
    agent = certificate.problem.agents[i]
    size = float(np.max(agent.input_high - agent.input_low)) if name == "inputs" else float(np.abs(values).max()) or 0.1
    other = replace(path, **{name: _put(values, place, values[place] + float(rng.choice([-1, 1])) * share * size)})
    return name, changed(certificate, paths=(*certificate.proof.paths[:i], other, *certificate.proof.paths[i + 1 :]))


def _nominal_input(certificate: Any, rng: np.random.Generator) -> Forged | None:
    """One nominal input moved."""
    return _of_path(certificate, rng, "inputs", 0.2)


def _gain(certificate: Any, rng: np.random.Generator) -> Forged | None:
    """One number of the feedback moved."""
    return _of_path(certificate, rng, "gains", 0.5)


def _letter(certificate: Any, rng: np.random.Generator) -> Forged | None:
    """One proposition at one time no longer asked for, or asked for otherwise."""
    place = _anywhere(certificate.proof.letters, rng)
    if place is None:
        return None
    value = rng.choice([v for v in (-1, 0, 0, 1) if v != certificate.proof.letters[place]])
    return "letter", changed(certificate, letters=_put(certificate.proof.letters, place, value))


def _face(certificate: Any, rng: np.random.Generator) -> Forged | None:
    """One region kept away from on another side."""
    avoided = np.argwhere(certificate.proof.letters < 0)
    if not len(avoided):
        return None
    place = tuple(avoided[int(rng.integers(len(avoided)))])
    return "face", changed(certificate, faces=_put(certificate.proof.faces, place, rng.integers(-1, 4)))
