"""Actors that are smoothed until something is certified of them: imitation with a penalty on how much a network bends.

A student of half the width learns what the best actor so far does where more noise than there is leads it, and pays
for second differences on the scale of what noise moves rows by: these are what a tube along its run is lost by
(docs/theory/paths.md, "Networks"). The student carries no promise but its certificate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...synthesis.certificates.proofs import Synthesis
from ...synthesis.relations.kinds import Network
from ...synthesis.verbs.certify import certify
from .actors import Actor, actor_of, networks_of
from .imitation import demonstrate
from .views import CentralView, SharedView, View

Array = NDArray[Any]

BENDS = (1.0, 10.0, 10.0)
"""Weights of the penalty that are tried, in turn, each on the best actor so far."""

ENOUGH = 0.999999
"""Bound from which on nothing more is tried."""

EPISODES, NOISES = 400, (1.0, 2.0, 4.0)
"""Episodes that are shown under each multiple of the noise."""

ROUNDS, BATCH, FIRST_RATE, DECAY = 3000, 512, 3e-3, 1e-3
"""Steps of the regression, rows of each, first learning rate, which falls to a fiftieth, and decay of weights."""

REACH = 2.0
"""Deviations at which second differences are taken."""


@dataclass(frozen=True, eq=False)
class SmoothActor:
    """The best actor that was found, what is certified of it, and what was certified of each that was tried."""

    actor: Actor
    certified: Synthesis | None
    tried: dict[str, float | str] = field(default_factory=dict)


def smoothed(actor: Actor, bends: Sequence[float] = BENDS, seed: int = 0) -> SmoothActor:
    """Return an actor that does about the same and can be certified along its run; the actor itself if it can be.

    Parameters
    ----------
    actor : Actor
        One network for all agents, or a central one.
    bends : sequence of float
        Weights of the penalty, tried in turn until the bound is at least ``ENOUGH``.
    seed : int
        Of demonstrations and students.

    Raises
    ------
    ValueError
        If every agent has a network of its own.
    """
    if len(networks_of(actor)) > 1:
        raise ValueError("`actor`: expected one network for all agents, or a central one, got one for each agent")
    tried: dict[str, float | str] = {}
    best = SmoothActor(actor, _certified(actor, "as trained", tried), tried)
    view: View = CentralView(actor.problem) if actor.view == "central" else SharedView(actor.problem)
    for k, bend in enumerate(bends, start=1):
        if best.certified is not None and best.certified.certificate.lower_bound >= ENOUGH:
            break
        data = _demonstrated(view, best.actor, seed)
        student = actor_of(view, (_student(networks_of(best.actor)[0], data, bend, seed),))
        found = _certified(student, f"{k}, smoothed, {bend:g}", tried)
        if found is not None and (
            best.certified is None or found.certificate.lower_bound > best.certified.certificate.lower_bound
        ):
            best = SmoothActor(student, found, tried)
    return best


def _certified(actor: Actor, name: str, tried: dict[str, float | str]) -> Synthesis | None:
    """Return what is certified of an actor along its run; None if nothing is, and why."""
    try:
        found = certify(actor.problem, actor, relation="path")
    except ValueError as refused:
        tried[name] = str(refused)
        return None
    tried[name] = found.certificate.lower_bound
    return found


def _demonstrated(view: View, actor: Actor, seed: int) -> tuple[Array, Array, Array, Array]:
    """Return rows (N, n), actions (N, m), which of these count (N, m), and deviations (N, n) of rows at their times."""
    shown = [demonstrate(view, actor, EPISODES, seed, 0.0, noise) for noise in NOISES]
    # Deviations are those without more noise, by the time that a row tells: all that varies besides states is told.
    n_q, T = view.problem.automaton.n_states, view.problem.horizon
    width = view.problem.n_states if isinstance(view, CentralView) else view.width
    times = [np.rint((1.0 - each.rows[:, width + n_q]) * T).astype(int) for each in shown]
    who = [np.zeros(len(t), int) if isinstance(view, CentralView) else each.rows[:, width + n_q + 1 :].argmax(axis=1)
           for t, each in zip(times, shown, strict=True)]  # fmt: skip
    deviations = np.zeros((T + 1, max(1, view.rows), view.size), dtype=np.float32)
    for t in range(T):
        for i in range(view.rows):
            own = shown[0].rows[(times[0] == t) & (who[0] == i)]
            if len(own) > 1:
                deviations[t, i, :width] = own[:, :width].std(axis=0)
    spread = np.concatenate([deviations[t, i] for t, i in zip(times, who, strict=True)])
    rows, actions, used = (
        np.concatenate([getattr(each, key) for each in shown]) for key in ("rows", "actions", "used")
    )
    return rows, actions, used, spread


def _student(teacher: Network, data: tuple[Array, Array, Array, Array], bend: float, seed: int) -> Network:
    """Return a network of half the width that does what data show, and bends little where rows deviate."""
    import torch

    torch.manual_seed(seed)
    rows, actions, used, spread = (torch.as_tensor(array) for array in data)
    sizes = [rows.shape[1], *(max(8, len(bias) // 2) for bias in teacher.biases[:-1]), len(teacher.biases[-1])]
    own = [torch.nn.Linear(first, second) for first, second in zip(sizes, sizes[1:])]
    parameters = [number for layer in own for number in layer.parameters()]
    optimizer = torch.optim.AdamW(parameters, lr=FIRST_RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.LinearLR(optimizer, 1.0, 0.02, ROUNDS)
    rng = np.random.default_rng(seed)
    for _ in range(ROUNDS):
        batch = torch.as_tensor(rng.integers(0, len(rows), BATCH))
        moved = REACH * spread[batch] * torch.randn(BATCH, rows.shape[1])
        z, bent = _bent(own, rows[batch], moved)
        # numbers beyond the box may be a little so: they are cut off
        inside = z.clamp(-1.05, 1.05)
        miss = (((inside - actions[batch]) ** 2 + 0.01 * (z - inside) ** 2) * used[batch]).mean()
        optimizer.zero_grad()
        (miss + bend * bent).backward()
        optimizer.step()
        schedule.step()
    weights, biases = ([getattr(layer, key).detach().numpy().copy() for layer in own] for key in ("weight", "bias"))
    return Network(tuple(weights), tuple(biases), "tanh", False)


def _bent(layers: Sequence[Any], x: Any, moved: Any) -> tuple[Any, Any]:
    """Return the outputs at rows x, and how much neurons of all layers bend them between x - moved and x + moved.

    Bends of neurons add up and never cancel, as in the enclosure of a tube.
    """
    import torch

    here, beyond, behind, slopes, bends = x, x + moved, x - moved, [], []
    for layer in layers[:-1]:
        here, beyond, behind = (torch.tanh(layer(part)) for part in (here, beyond, behind))
        slopes.append(1.0 - here**2)
        bends.append((beyond + behind - 2.0 * here).abs())
    # from the last layer to the first: how outputs follow the neurons of each
    follow, total = layers[-1].weight[None], 0.0
    for layer, slope, bend in zip(layers[-2::-1], slopes[::-1], bends[::-1], strict=True):
        total = total + (follow.abs() @ bend[:, :, None]).mean()
        follow = (follow * slope[:, None]) @ layer.weight
    return layers[-1](here), total
