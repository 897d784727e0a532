"""Why nothing is proved of a network along its run: at which step, and which layer of it leaves out most.

A network is a feedback and what is left out of it (the checker's ``networks``): what its activations bend on the tube,
and each layer what these leave out of parabolas. Numbers here are estimates, on which no proof rests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...checker import CheckedProblem, Joint, Network, Refused, Tube, row_seen, walk

NOTICED = 0.1
"""Share of half the range of an input from which on what is left out of a network widens the tube."""


@dataclass(frozen=True)
class WideLayer:
    """A layer (from 1) of an agent's network, at a time: what it leaves out of an input, half the range of that.

    ``neurons`` is by how much what a neuron of it gets may differ, at most.
    """

    agent: str
    time: int
    layer: int
    left_out: float
    half_range: float
    neurons: float

    def __str__(self) -> str:
        return (
            f"the tube of the network of `{self.agent}` widens at step {self.time}: layer {self.layer}, whose neurons "
            f"get +-{self.neurons:.2g}, leaves +-{self.left_out:.2g} of an input of +-{self.half_range:.2g} open"
        )


def widening_layer(known: CheckedProblem, joint: Joint) -> WideLayer | None:
    """Return the layer that leaves out most where a tube first widens, or anywhere; None if no network acts."""
    worst: WideLayer | None = None
    try:
        for tube in walk(joint):
            if not 0 < tube.t < len(joint.states) - 1:
                continue
            for i, own in enumerate(joint.trajectories):
                network = own.network
                found = _of_network(known, joint, tube, i, network) if isinstance(network, Network) else None
                if found is not None and (worst is None or _share(found) > _share(worst)):
                    worst = found
            if worst is not None and _share(worst) >= NOTICED:
                break
    except Refused:
        pass
    return worst


def _share(found: WideLayer) -> float:
    return found.left_out / found.half_range


def _of_network(known: CheckedProblem, joint: Joint, tube: Tube, i: int, network: Network) -> WideLayer | None:
    """Return the layer of the network of agent i that leaves out most at a time."""
    agent, seen = known.agents[i], tube.seen(joint, i)
    left = float(np.float32(1.0 - tube.t / known.horizon))
    row = joint.seen[tube.t], len(known.automaton.accepting), left
    forms, wide = row_seen(network, joint.states[tube.t, joint.trajectories[i].places], row, seen), []
    m, half = len(agent.inputs), 0.5 * (agent.input_box[1] - agent.input_box[0])
    for weight, bias in zip(network.weights[:-1], network.biases[:-1], strict=True):
        forms = forms.times(weight, bias)
        ends = seen.rows(forms.C) + forms.rest()
        wide.append(float(np.max(ends[1] - ends[0])) / 2.0)
        forms = forms.through(network.activation)
    # Every layer adds a part: what it rounds, and what its activations leave out of a parabola.
    last = forms.times(network.weights[-1][:m], network.biases[-1][:m])
    scale = np.ones(m) if network.output == "box" else half
    bent = [scale * (np.abs(matrix) @ (0.5 * (q[1] - q[0]))) for matrix, q in last.parts[1:]]
    if bent:  # what they bend together counts where neurons get most
        bent[int(np.argmax(wide))] += scale * np.abs(seen.forms(last.Q)).max(axis=0)
    if not bent or not np.all(np.isfinite(bent)) or not np.all(half > 0.0):
        return None
    layer, k = np.unravel_index(int(np.argmax(np.array(bent) / half)), (len(bent), m))
    numbers = float(bent[layer][k]), float(half[k]), wide[layer]
    return WideLayer(agent.name, tube.t, int(layer) + 1, *numbers)
