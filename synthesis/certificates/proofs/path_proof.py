"""Proofs along a path: no grid, any number of states, noise that need not reach all of them.

Agents apply ``u_t = ubar_t + K_t (x_t - xbar_t)``, where xbar is the nominal path under the nominal inputs ubar. Under
Gaussian noise all deviations are jointly Gaussian with mean 0, up to a drift where dynamics are not linear. At every
time the certificate says which propositions are to hold and which are not; as long as they do, no agent leaves its
workspace and no input its box, the automaton reads a word that it accepts. The certified bound is that of these linear
inequalities (docs/theory/paths.md): everything else is computed from the problem.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ....envs.systems.backends import is_whole
from ....envs.tasks.problem import Problem
from ...relations.grids import FloatArray
from ...relations.kinds import (
    JointNetworkPolicy,
    NetworkPolicy,
    SymbolicPolicy,
    check_network,
    joint_network_policy,
    network_policy,
)
from ..controllers import JointNetworkController, NetworkController, PathController
from .archive import Pool, Stored
from .certificate import Certificate
from .proof import Capability, FailureProof

GivenPolicy = NetworkPolicy | JointNetworkPolicy | SymbolicPolicy
"""What acts where a policy was given."""

SOMETIME = 2
"""A letter over a window of times: the proposition is to hold at one of them at least."""


@dataclass(frozen=True, eq=False)
class AgentPath:
    """Nominal inputs and states of one agent, its feedback, and the strips in which deviations keep.

    Parameters
    ----------
    inputs : (S, m) array
        Nominal inputs at times 0 to S - 1.
    gains : (S, m, d) array
        Feedback on the deviation from the nominal path at each time; 0 for none.
    states : (S + 1, d) array
        Nominal states.
    strips : (S + 1, d + m) array
        What the linear deviation of each state is kept within, and that of each input (in the last row they say
        nothing); infinite where nothing is asked.
    """

    inputs: FloatArray
    gains: FloatArray
    states: FloatArray
    strips: FloatArray

    @property
    def arrays(self) -> list[FloatArray]:
        """Inputs, gains, states and strips."""
        return [self.inputs, self.gains, self.states, self.strips]

    @property
    def n_steps(self) -> int:
        """Number of steps S."""
        return len(self.inputs)


OTHER_STARTS = (
    "one along a path, which says nothing of other starts; synthesize the problem with another `initial_state`, or "
    "with a box of starts (`initial_low`, `initial_high`)"
)
"""What certificates along paths answer to whoever asks for other starts."""

ONE_RUN = (
    "one along a path, which says nothing of other states and times; it can be checked, validated, stressed, "
    "simulated, compared and reported"
)
"""What certificates along paths answer to whoever asks for values."""


@dataclass(frozen=True, eq=False, repr=False)
class PathProof(FailureProof):
    """A bound from a start that is known, along a nominal path.

    Parameters
    ----------
    paths : tuple of AgentPath
        One for each agent, for S steps; S is the horizon unless the task is satisfied earlier.
    letters : (S + 1, P) int8 array
        Of each proposition of the automaton at times 0 to S: 1 if it is to hold, -1 if not, 0 if that does not matter;
        ``SOMETIME`` at times in a row at one of which it is to hold.
    faces : (S + 1, P) int array
        Where a proposition is not to hold: the side of its region that is kept away from, ``2 k`` for below the lower
        limit of output k, ``2 k + 1`` for above the upper one. Where it is to hold at some time: the side that the path
        comes from. -1 elsewhere.
    failure : float
        Upper bound on the probability that the task is not satisfied.
    normals : (S + 1, sum of p) array, optional
        Of a task about pairs of agents, pair after pair: where one is not to hold, the direction (p,) of the half-space
        ``n.(y_a - y_b) > max over the box of n.z`` in which its difference stays; elsewhere they say nothing.
    networks : tuple of NetworkPolicy or WrittenPolicy, optional
        Of given policies: they act, and the inputs of paths are what they answer without noise.
    radii : tuple of float
        With networks: radii of the ellipsoids in which the errors of each agent keep.
    """

    paths: tuple[AgentPath, ...]
    letters: NDArray[np.int8]
    faces: NDArray[np.int64]
    failure: float
    normals: FloatArray | None = None
    networks: tuple[GivenPolicy, ...] | None = None
    radii: tuple[float, ...] = ()

    kind = "path"
    unsupported = MappingProxyType({Capability.VALUES: ONE_RUN, Capability.OTHER_STARTS: OTHER_STARTS})
    bound = "path"

    @property
    def n_steps(self) -> int:
        """Number of steps S of the path."""
        return len(self.letters) - 1

    @property
    def method(self) -> str:
        """How the bound was found, in words."""
        if self.networks is not None:
            return f"{'networks' if self.acts_by_networks else 'policies'} as they are, along {self.n_steps} steps"
        gains = any(np.any(path.gains) for path in self.paths)
        return f"nominal path of {self.n_steps} steps, {'with feedback' if gains else 'open loop'}"

    @property
    def acts_by_networks(self) -> bool:
        """Whether networks act, and not nominal inputs or expressions."""
        return any(not isinstance(own, SymbolicPolicy) for own in self.networks or ())

    def along(self, certificate: Certificate) -> Certificate:
        """Return the certificate itself."""
        return certificate

    def controller(self, problem: Problem) -> PathController:
        """Return the controllers the bound belongs to."""
        paths = tuple((path.inputs, path.gains, path.states) for path in self.paths)
        if self.networks is None:
            return PathController(problem, paths)
        joint = any(own.sees_all for own in self.networks)
        return (JointNetworkController if joint else NetworkController)(problem, paths, self.networks)

    def written(self, pool: Pool) -> dict[str, Any]:
        """Return the entries of its file."""
        return {
            "failure": float(self.failure),
            "letters": pool.put(self.letters),
            "faces": pool.put(self.faces),
            "agents": [[pool.put(array) for array in path.arrays] for path in self.paths],
            **({} if self.normals is None else {"normals": pool.put(self.normals)}),
            **({} if self.networks is None else {"networks": [own.description for own in self.networks]}),
            **({} if self.networks is None else {"radii": list(self.radii)}),
        }

    @classmethod
    def read(cls, problem: Problem, stored: Stored) -> Self:
        """Return the proof in a file; raise ValueError if there is none."""
        failure, letters, faces = kept_in(problem, stored)
        entries = stored.entry["agents"]
        if len(entries) != problem.n_agents:
            raise ValueError("its agents are not those of a path")
        paths = []
        for agent, numbers in zip(problem.agents, entries, strict=True):
            steps, d, m = len(letters) - 1, agent.n_states, agent.n_inputs
            shapes = [(steps, m), (steps, m, d), (steps + 1, d), (steps + 1, d + m)]
            if len(numbers) == 2:
                raise ValueError("paths with one feedback for all times are gone since 0.4; synthesize anew")
            arrays = [stored.numbers(number) for number in numbers]
            spare = len(arrays) == 4 and arrays[3].shape == (steps + 1, 2 * d + m)
            if spare and np.all(arrays[3][:, d + m :] == np.inf):
                arrays[3] = arrays[3][:, : d + m]  # up to version 0.4 noise could have strips, too
            if [array.shape for array in arrays] != shapes or not all(np.all(np.isfinite(a)) for a in arrays[:3]):
                raise ValueError(f"the inputs of agent {agent.name!r} do not fit")
            if not np.all(arrays[3] >= 0.0):
                raise ValueError(f"the strips of agent {agent.name!r} are none")
            paths.append(AgentPath(*arrays))
        normals = _normals(problem, stored, len(letters))
        return cls(tuple(paths), letters, faces, failure, normals, *_networks(problem, stored))


AlongPath = Certificate[PathProof]
"""A certificate along a path."""


def kept_in(problem: Problem, stored: Stored) -> tuple[float, NDArray[Any], NDArray[Any]]:
    """Return the probability of failing, letters and faces (S + 1, P) in a file."""
    failure = probability(stored.entry["failure"])
    letters, faces = (stored.array(stored.entry[name]) for name in ("letters", "faces"))
    if (
        not (is_whole(letters, signed=True) and is_whole(faces, signed=True))
        or letters.ndim != 2
        or letters.shape != faces.shape
    ):
        raise ValueError("its letters are no whole numbers")
    if not 2 <= len(letters) <= problem.horizon + 1:
        raise ValueError("its letters do not fit the horizon")
    return failure, letters, faces


def probability(value: Any) -> float:
    """Return a number of a file if it is a probability; raise ValueError otherwise."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise ValueError("what it says is a probability is none")
    return float(value)


def _networks(problem: Problem, stored: Stored) -> tuple[tuple[GivenPolicy, ...] | None, tuple[float, ...]]:
    """Return the networks in a file and the radii of their ellipsoids; None where nominal inputs act."""
    if "networks" not in stored.entry:
        return None, ()
    radii = stored.entry["radii"]
    if len(radii) != problem.n_agents:
        raise ValueError("its networks are not those of its agents")
    if any(isinstance(radius, bool) or not isinstance(radius, int | float) or not radius > 0.0 for radius in radii):
        raise ValueError("the radii of its ellipsoids are none")
    return networks_in(problem, stored.entry["networks"]), tuple(float(radius) for radius in radii)


def networks_in(problem: Problem, networks: Any) -> tuple[GivenPolicy, ...]:
    """Return the policies of all agents in a file; raise ValueError if they are not those of the problem."""
    if not isinstance(networks, list) or len(networks) != problem.n_agents:
        raise ValueError("its networks are not those of its agents")
    made = list[GivenPolicy]()
    for description, agent in zip(networks, problem.agents, strict=True):
        if isinstance(description, dict) and "expressions" in description:
            made.append(SymbolicPolicy.of(agent, [str(text) for text in description["expressions"]]))
            continue
        if isinstance(description, dict) and "matrix" in description:
            made.append(joint_network_policy(description, agent, problem.n_states))
            continue
        check_network(description, agent, 2**31)
        made.append(network_policy(description, agent))
    return tuple(made)


def _normals(problem: Problem, stored: Stored, times: int) -> NDArray[np.float64] | None:
    """Return the directions of pairs (S + 1, sum of p); None for tasks that are about none."""
    pairs = problem.labeling.pairs
    if ("normals" in stored.entry) != bool(pairs):
        raise ValueError("it has directions of pairs and its problem has no pairs, or the other way round")
    if not pairs:
        return None
    normals = stored.numbers(stored.entry["normals"])
    if normals.shape != (times, sum(pair.size for pair in pairs)) or not np.all(np.isfinite(normals)):
        raise ValueError("its directions of pairs do not fit")
    return normals
