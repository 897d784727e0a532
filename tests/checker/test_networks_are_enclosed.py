"""Networks along trajectories: what is enclosed is what they answer, and errors keep in ellipsoids and tubes."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

import certigym as cg
from certigym.synthesis.certificates.proofs import canonical, canonical_problem, contents_of
from certigym.synthesis.checker import Joint, networks, read_problem, read_trajectories, steps, walk
from certigym.synthesis.checker.distributions import LIGHT, LONG, NORMAL, STOPPED
from certigym.synthesis.checker.error_system import Ellipsoid, ErrorSystem, Seen, covariance_of, length_tail
from certigym.synthesis.checker.feedbacks import enclosed_feedback, read_feedback
from certigym.synthesis.checker.fields import Entry, Unreadable
from certigym.synthesis.checker.intervals import interval
from certigym.synthesis.checker.networks import SMOOTH, Network, automaton_states, enclosed
from certigym.synthesis.interop.layers import of_relus
from certigym.synthesis.relations.kinds import ACTIVATIONS as SINGLE
from certigym.synthesis.relations.kinds import Network as Layers
from certigym.synthesis.relations.kinds import NetworkPolicy, OwnView, SymbolicPolicy, seen_jointly
from certigym.synthesis.trajectories.planning import networks_along
from certigym.synthesis.trajectories.planning.policy_paths import _may_have_cells
from kinds import mostly_thorough

KINDS = [
    *((act, out, sees) for act in ("tanh", "relu") for out in ("clip", "tanh", "box") for sees in ("scaled", "raw")),
    *((act, "clip", "scaled") for act in SMOOTH if act != "tanh"),
    *(("leaky", out, "scaled") for out in ("clip", "tanh")),
]


@dataclass(frozen=True, eq=False)
class Leaky(Layers):
    """Layers with lines that have a kink at 0 between them, and their slopes below it, in single precision."""

    slopes: tuple[np.ndarray, ...] = ()

    def actions(self, rows: np.ndarray) -> np.ndarray:
        hidden = np.asarray(rows, dtype=np.float32)
        for weight, bias, slope in zip(self.weights, self.biases, self.slopes, strict=False):
            hidden = hidden @ weight.T + bias
            hidden = np.where(hidden > 0.0, hidden, slope * hidden)
        last = hidden @ self.weights[-1].T + self.biases[-1]
        return np.asarray(np.tanh(last) if self.squashed else np.clip(last, -1.0, 1.0))

    def relus(self, stretched: float = 1.0) -> tuple[list[np.ndarray], list[np.ndarray]]:
        return of_relus(self.weights, self.biases, [np.float32(stretched) * slope for slope in self.slopes])


def layers_of(rng: np.random.Generator, sizes: list[int], size: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
    weights = [size * rng.standard_normal((b, a)) / np.sqrt(a) for a, b in zip(sizes, sizes[1:])]
    biases = [0.3 * rng.standard_normal(b) for b in sizes[1:]]
    return [w.astype(np.float32) for w in weights], [b.astype(np.float32) for b in biases]


def an_agent(d: int, m: int) -> Any:
    agent = cg.LinearAgent(
        name="a", A=np.eye(d), B=np.ones((d, m)), noise_covariance=np.eye(d), state_low=-3.0 - np.arange(d),
        state_high=4.0 + np.arange(d), input_low=[-1.5] * m, input_high=[0.5] * m, initial_state=np.zeros(d),
    )  # fmt: skip
    task = cg.Specification("F b", "co-safe")
    problem = cg.Problem(name="p", horizon=7, agents=[agent], specification=task,
                         propositions={"b": cg.Proposition("a", [0.0] * d, [1.0] * d)})  # fmt: skip
    return problem, read_problem({"problem": canonical_problem(problem)}).agents[0]


def in_box(low: np.ndarray, high: np.ndarray) -> Any:
    """What takes rows to their ends on a box."""

    def besides(rows: np.ndarray) -> np.ndarray:
        products = rows * low, rows * high
        return np.stack([np.minimum(*products).sum(axis=1) - 1e-12, np.maximum(*products).sum(axis=1) + 1e-12])

    return besides


NOTHING = Seen(np.zeros((2, 1)), None, in_box(np.zeros(1), np.zeros(1)))


@pytest.mark.parametrize(("activation", "output", "sees"), KINDS)
@mostly_thorough("size", [0.5, 6.0, 2.0])
def test_answers_are_enclosed(activation: str, output: str, sees: str, size: float) -> None:
    """At points of an ellipsoid with drift, in single precision and in another order of summation."""
    rng = np.random.default_rng(KINDS.index((activation, output, sees)) + int(100 * size))
    d, m, states = 3, 2, 4
    problem, agent = an_agent(d, m)
    view = OwnView(0, 1, d + 1, states, problem.horizon, scale="raw" if sees == "raw" else "unit")
    weights, biases = layers_of(rng, [view.size, 16, 16, m], size)
    form = activation, output == "tanh", "box" if output == "box" else "unit"
    plain = Layers(tuple(weights), tuple(biases), *form)
    if activation == "leaky":
        slopes = (np.full(16, 0.01, np.float32), rng.uniform(-0.5, 1.5, 16).astype(np.float32))
        plain = Leaky(tuple(weights), tuple(biases), *form, slopes)
        weights, biases = plain.relus()
    policy = NetworkPolicy(plain, view, problem.agents[0].workspace, problem.agents[0].input_box)
    exact = (tuple(w.astype(float) for w in weights), tuple(b.astype(float) for b in biases))
    row = seen_jointly(policy, 0, d)
    kind = "relu" if activation == "leaky" else activation
    network = Network(*exact, kind, output, row.matrix, row.offset, row.told)
    for trial in range(8):
        # of the last ones no error is possible, so that what is left out is what rounds
        at, q, t, wide = rng.uniform(-1.0, 1.5, d), int(rng.integers(states)), int(rng.integers(7)), trial < 6
        root, radius = 0.1 * wide * rng.standard_normal((d, d)), 2.0
        low, high = -rng.uniform(0.0, 0.05 * wide, d), rng.uniform(0.0, 0.05 * wide, d)
        g = rng.standard_normal((4000, d))
        g *= (radius * rng.uniform(0.0, 1.0, (len(g), 1)) ** 0.2) / np.linalg.norm(g, axis=1, keepdims=True)
        e = g @ root.T + np.where(rng.random((len(g), d)) < 0.5, low, high)
        far = np.abs(radius * np.linalg.norm(root, axis=1)) + np.maximum(-low, high) + 1e-9
        ellipsoid = Ellipsoid(root, np.linalg.inv(root).astype(float), radius, 0.0) if wide else None
        seen = Seen(np.stack([-far, far]), ellipsoid, in_box(low, high))
        left = float(np.float32(1.0 - t / problem.horizon))
        u, J, rest = enclosed(network, agent, at, (q, states, left), seen)
        answers = policy.inputs((at + e).T, np.full(len(e), q), t).T
        turned = NetworkPolicy(shuffled(plain, rng), view, policy.workspace, policy.input_box)
        for found in (answers, turned.inputs((at + e).T, np.full(len(e), q), t).T):
            left_out = found - u - e @ J.T
            assert np.all(left_out >= rest[0] - 1e-13) and np.all(left_out <= rest[1] + 1e-13)
        assert np.all(np.isfinite(rest))
        # It says something: about as wide as what is seen of it at these points.
        if size == 0.5:
            assert np.all(rest[1] - rest[0] <= 8.0 * np.ptp(answers - u - e @ J.T, axis=0) + 1e-3)


def shuffled(plain: Layers, rng: np.random.Generator) -> Layers:
    """The same network with its hidden numbers in another order: its sums round otherwise."""
    weights, biases, slopes = list(plain.weights), list(plain.biases), list[np.ndarray]()
    for k in range(len(weights) - 1):
        order = rng.permutation(len(biases[k]))
        weights[k], biases[k], weights[k + 1] = weights[k][order], biases[k][order], weights[k + 1][:, order]
        slopes += [plain.slopes[k][order]] if isinstance(plain, Leaky) else []
    more: dict[str, Any] = {"slopes": tuple(slopes)} if slopes else {}
    return replace(plain, weights=tuple(weights), biases=tuple(biases), **more)


def test_another_slope_below_zero_is_another_network() -> None:
    """What makes the cases of leaky layers: a slope that is off by a thousandth leaves what is enclosed."""
    rng = np.random.default_rng(5)
    problem, agent = an_agent(1, 1)
    view = OwnView(0, 1, 1, 2, problem.horizon)
    weights, biases = layers_of(rng, [view.size, 16, 16, 1], 0.5)
    plain = Leaky(tuple(weights), tuple(biases), "leaky", False, "unit", (np.full(16, 0.2, np.float32),) * 2)
    policy = NetworkPolicy(plain, view, problem.agents[0].workspace, problem.agents[0].input_box)
    row, at, left = seen_jointly(policy, 0, 1), np.array([0.3]), float(np.float32(1.0 - 2 / problem.horizon))
    answer = policy.inputs(at[:, None], np.zeros(1, dtype=int), 2)[:, 0]
    inside = []
    for stretched in (1.0, 1.001):
        layers, shifts = (tuple(own.astype(float) for own in each) for each in plain.relus(stretched))
        network = Network(layers, shifts, "relu", "clip", row.matrix, row.offset, row.told)
        u, _, rest = enclosed(network, agent, at, (0, 2, left), NOTHING)
        inside.append(bool(np.all(rest[0] <= answer - u) and np.all(answer - u <= rest[1])))
    assert inside == [True, False]


@pytest.mark.parametrize("activation", [*SMOOTH, "relu", "clip"])
def test_nothing_is_known_of_a_neuron_that_may_get_anything(activation: str) -> None:
    nan, limits = np.full((2, 1), np.nan), np.array([[-1.0], [1.0]])
    with np.errstate(all="ignore"):
        for z, ends in ((np.zeros(1), nan), (np.full(1, np.nan), limits), (np.full(1, np.nan), nan)):
            assert np.all(np.isnan(networks._parabola(activation, z, ends, *limits)[3]))


@pytest.mark.parametrize("sees", ["scaled", "raw"])
def test_rows_in_single_precision_are_between_their_ends(sees: str) -> None:
    """As the package computes and rounds them; halves of what they may be off by are too narrow."""
    problem, _ = an_agent(3, 1)
    view = OwnView(0, 1, 4, 3, problem.horizon, scale="raw" if sees == "raw" else "unit")
    plain = Layers((np.zeros((1, view.size), np.float32),), (np.zeros(1, np.float32),), "tanh", False)
    agent, rng, most = problem.agents[0], np.random.default_rng(5), 0.0
    row = seen_jointly(NetworkPolicy(plain, view, agent.workspace, agent.input_box), 0, 3)
    layers = tuple(w.astype(float) for w in plain.weights), tuple(b.astype(float) for b in plain.biases)
    network = Network(*layers, "tanh", "clip", row.matrix, row.offset, row.told)
    for t in range(5):
        at, far = rng.uniform(-1.0, 1.0, 3), rng.uniform(0.0, 0.5, 3)
        e = rng.uniform(-far, far, (20_000, 3))
        seen = Seen(np.stack([-far, far]), None, in_box(-far, far))
        first = networks.row_seen(network, at, (1, 3, float(np.float32(1.0 - t / problem.horizon))), seen)
        rows = view.rows(agent.workspace, (at + e).T, np.full(len(e), 1), t).astype(float)
        left, rest = rows - first.h - e @ first.C.T, first.rest()
        assert np.all(left >= rest[0]) and np.all(left <= rest[1])
        most = max(most, float(np.max(np.abs(left[:, :3]) / rest[1][:3])))
    assert most > 0.4


def test_ellipsoids_have_the_tails_of_their_noise() -> None:
    """Those of sub-Gaussian noise are left more often than normal ones, and of others nothing is known."""
    errors = a_system(np.random.default_rng(2), 2, 3)[0]
    lost = [Ellipsoid.of(errors, np.arange(2), 4.0, np.full(2, kind)).lost for kind in (NORMAL, STOPPED, LIGHT, LONG)]
    assert lost[0] < lost[1] == lost[2] < lost[3] == 1.0


def an_ellipsoid(rng: np.random.Generator, d: int, drift: float) -> tuple[Seen, np.ndarray]:
    """Errors in an ellipsoid and an interval for each row besides, and many of them, on its edge too."""
    root, radius, low = rng.standard_normal((d, d)), float(rng.uniform(1.0, 7.0)), -drift * rng.random(d)
    high = drift * rng.random(d)
    g = rng.standard_normal((20_000, d))
    g *= radius * rng.choice([1.0, 1.0, 0.7], (len(g), 1)) / np.linalg.norm(g, axis=1, keepdims=True)
    e = g @ root.T + np.where(rng.random(g.shape) < 0.5, low, high)
    far = radius * np.linalg.norm(root, axis=1) + np.maximum(-low, high) + 1e-9
    return Seen(
        np.stack([-far, far]), Ellipsoid(root, np.linalg.inv(root).astype(float), radius, 0.0), in_box(low, high)
    ), e


def test_a_matrix_that_is_no_root_says_nothing() -> None:
    assert np.all(np.isinf(Ellipsoid(np.eye(2), 0.5 * np.eye(2), 1.0, 0.0).widths))
    assert np.all(np.isfinite(Ellipsoid(np.eye(2), np.eye(2), 1.0, 0.0).widths))


def test_networks_answer_with_all_inputs() -> None:
    _, agent = an_agent(3, 2)
    for answers in (1, 2):
        arrays = np.ones((answers, 6)), np.ones(answers), np.ones((6, 3)), np.ones(6)
        told = {
            "weights": [0],
            "biases": [1],
            "activation": "tanh",
            "output": "clip",
            "view": 2,
            "offset": 3,
            "told": 3,
        }
        entry = Entry(told, "network", arrays)
        if answers == 2:
            assert networks.read_network(entry, agent, 3, 2).told == 3
        else:
            with pytest.raises(Unreadable, match="do not answer"):
                networks.read_network(entry, agent, 3, 2)


@pytest.mark.parametrize("drift", [0.0, 0.5, 3.0])
def test_quadratic_forms_are_enclosed(drift: float) -> None:
    """At points on the edge, also of one sign; without drift nothing is given away."""
    rng, outside = np.random.default_rng(int(10 * drift)), 0
    for _ in range(20):
        d = int(rng.integers(1, 6))
        seen, e = an_ellipsoid(rng, d, drift)
        Q = rng.standard_normal((8, d, d))
        Q[:3] = Q[:3] @ Q[:3].swapaxes(1, 2)
        values, ends = np.einsum("nij,mi,mj->mn", Q, e, e), seen.forms(Q)
        assert np.all(values >= ends[0] - 1e-9) and np.all(values <= ends[1] + 1e-9)
        # half of a form, or of what errors are besides g, is too little
        outside += int(np.any(values < 0.5 * ends[0]) or np.any(values > 0.5 * ends[1]))
        if drift == 0.0:
            own: Any = seen.ellipsoid
            truth = own.radius**2 * np.linalg.eigvalsh(own.root.T @ (0.5 * (Q + Q.swapaxes(1, 2))) @ own.root)
            wanted = np.stack([np.minimum(truth[:, 0], 0.0), np.maximum(truth[:, -1], 0.0)])
            assert np.all(np.abs(ends - wanted) <= 1e-8 * (1.0 + np.abs(wanted).max()))
    assert outside > 10


def test_variables_that_follow_errors_have_forms_of_these() -> None:
    """Of errors, inputs that follow them up to offsets, and disturbances; two of three errors are seen."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        seen, e = an_ellipsoid(rng, 3, 0.4)
        other, free, off = rng.uniform(-0.3, 0.3, (len(e), 1)), [1, 0, 3], np.array([0.0, 0.0, 0.2, 0.0])
        gains = rng.standard_normal((1, 2))
        # variables: error 2 and error 0 of those that are seen, an input, a disturbance
        z = np.concatenate([e[:, [0, 2]], other], axis=1)
        u = z[:, :2] @ gains.T + rng.uniform(-0.2, 0.2, (len(e), 1))
        v = np.concatenate([e[:, [2]], e[:, [0]], u, other], axis=1)
        transform = np.zeros((4, 3))
        transform[1, 0] = transform[0, 1] = transform[3, 2] = 1.0
        transform[2, :2] = gains[0]
        which = np.array([[1, 0, 0], [0, 0, 0], [0, 1, 0]], dtype=bool)
        far = np.array([seen.far[2], seen.far[0], float(np.abs(gains[0]) @ seen.far[[0, 2]]) + 0.2, 0.3])
        H = rng.standard_normal((4, 4, 1))
        values = np.einsum("mi,ij,mj->m", v, H[..., 0], v)
        (low,), (high,) = seen.followed(which, transform, off, np.stack([-far, far]), free, H)
        assert low <= values.min() and values.max() <= high
        assert high - low <= 4.0 * np.ptp(values) + 2.0 * 0.2 * np.abs(H[..., 0]).sum(axis=1)[2] * 2.0 * far.max()


@pytest.mark.parametrize("activation", SMOOTH)
def test_small_networks_are_enclosed_at_points_on_the_edge(activation: str) -> None:
    """Of all points of a fine net around the ellipse, with every corner of what errors are besides: none is outside."""
    rng = np.random.default_rng(4)
    turns = np.linspace(0.0, 2.0 * np.pi, 721)
    circle = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    _, agent = an_agent(2, 1)
    for _ in range(10):
        weights, biases = layers_of(rng, [2, 3, 2, 1], 1.0)
        root, radius = 0.15 * rng.standard_normal((2, 2)), 3.0
        low, high = -rng.uniform(0.0, 0.05, 2), rng.uniform(0.0, 0.05, 2)
        corners = np.array(list(itertools.product(*zip(low, high, strict=True))))
        e = (radius * circle @ root.T)[None] * np.array([1.0, 0.6, 0.0])[:, None, None]
        e = (e[:, :, None] + corners).reshape(-1, 2)
        far = radius * np.linalg.norm(root, axis=1) + np.maximum(-low, high) + 1e-9
        seen = Seen(
            np.stack([-far, far]), Ellipsoid(root, np.linalg.inv(root).astype(float), radius, 0.0), in_box(low, high)
        )
        exact = (tuple(w.astype(float) for w in weights), tuple(b.astype(float) for b in biases))
        view = np.concatenate([np.eye(2), np.zeros((2, 2))])
        first = np.concatenate([exact[0][0], np.zeros((3, 2))], axis=1)
        network = Network((first, *exact[0][1:]), exact[1], activation, "clip", view, np.zeros(4), 2)
        at = rng.uniform(-0.5, 0.5, 2)
        u, J, rest = enclosed(network, agent, at, (0, 1, 1.0), seen)
        hidden, f = at + e, functions(activation, ())
        for weight, bias in zip(exact[0][:-1], exact[1][:-1], strict=True):
            hidden = f(hidden @ weight.T + bias)
        out = np.clip(hidden @ exact[0][-1].T + exact[1][-1], -1.0, 1.0)
        left = agent.input_box.mean(axis=0) + 0.5 * np.diff(agent.input_box, axis=0)[0] * out - u - e @ J.T
        assert np.all(left >= rest[0]) and np.all(left <= rest[1])
        assert np.ptp(left) >= 0.15 * float(rest[1, 0] - rest[0, 0]) - 1e-4


@pytest.mark.parametrize("sees", ["scaled", "raw"])
def test_what_a_network_sees_is_no_larger_than_its_size(sees: str) -> None:
    """At the corners of what errors may be: sizes are what single precision is charged by."""
    none = (np.zeros((1, 9)), np.zeros(1))
    view = np.eye(9)[:, :3] * (1.0 if sees == "raw" else np.array([0.3, 2.0, 0.7]))
    network = Network((none[0],), (none[1],), "relu", "clip", view, np.linspace(-1.0, 1.0, 9), 4)
    at, far = np.array([0.5, -1.0, 2.0]), np.array([0.2, 0.1, 0.4])
    first = networks.row_seen(network, at, (1, 3, 0.5), Seen(np.stack([-far, far]), None, in_box(-far, far)))
    for signs in itertools.product((-1.0, 1.0), repeat=3):
        row = first.h + first.C @ (np.array(signs) * far) + np.abs(first.rest()).max(axis=0)
        assert np.all(np.abs(row) <= first.size * (1.0 + 1e-12) + 1e-280), signs


@pytest.mark.parametrize("d", [1, 2, 3, 4, 7, 12, 25])
def test_tails_of_lengths_are_those_of_the_chi_square_distribution(d: int) -> None:
    for radius in (0.3, 1.0, 3.0, 6.0, 9.0):
        for largest in (1.0, 1.3):
            truth, found = chi2.sf(radius**2 / largest, d), length_tail(radius, d, largest)
            assert truth * (1.0 - 1e-12) <= found <= truth * (1.0 + 1e-9) + 1e-300
    assert length_tail(-1.0, d, 1.0) == length_tail(2.0, d, np.inf) == 1.0


def a_system(rng: np.random.Generator, d: int, steps: int) -> tuple[ErrorSystem, list[np.ndarray], list[np.ndarray]]:
    errors, loops, noises = ErrorSystem(np.zeros(d), d), [], []
    for _ in range(steps):
        loops.append(0.5 * np.eye(d) + 0.3 * rng.standard_normal((d, d)))
        noises.append(np.diag(rng.uniform(0.0, 1.0, d) * (rng.random(d) < 0.7)))
        errors.step(loops[-1], np.zeros((2, d)), np.ones(d), noises[-1])
    return errors, loops, noises


def test_forms_keep_in_ellipsoids_as_often_as_is_said() -> None:
    """Exact covariances; 200,000 draws of the form, a false alarm of 1e-6 for all of them (5.3 deviations)."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        d = int(rng.integers(1, 5))
        errors, loops, noises = a_system(rng, d, int(rng.integers(1, 5)))
        covariance = np.zeros((d, d))
        for F, L in zip(loops, noises, strict=True):
            covariance = F @ covariance @ F.T + L @ L.T
        _, forms = errors.rows(np.eye(d))
        found, off = covariance_of(forms, forms)
        assert np.all(np.abs(found - covariance) <= off + 1e-14) and np.all(off < 1e-12)
        ellipsoid = Ellipsoid.of(errors, np.arange(d), float(rng.uniform(1.0, 3.0)), np.zeros(d, int))
        g = rng.standard_normal((200_000, d)) @ np.linalg.cholesky(covariance + 1e-300 * np.eye(d)).T if np.all(
            np.linalg.eigvalsh(covariance) > 1e-12) else None  # fmt: skip
        if g is None:
            continue
        inside = np.linalg.norm(g @ ellipsoid.white.T, axis=1) <= ellipsoid.radius
        p = ellipsoid.lost
        assert np.mean(~inside) <= p + 5.3 * np.sqrt(p / len(g))
        rows = rng.standard_normal((6, d))
        most = np.abs(g[inside]).max(axis=0)
        assert np.all(np.abs(g[inside] @ rows.T).max(axis=0) <= ellipsoid.reach(rows, most))
        assert np.all(most <= ellipsoid.widths)


def glider(std: float = 0.02) -> tuple[cg.Problem, list[NetworkPolicy]]:
    """A point that turns and drifts, and a network about as good as a linear feedback."""
    agent = cg.Agent(
        name="a", states=["x", "y", "v"], inputs=["u"],
        dynamics=["x + 0.3*cos(v)", "y + 0.3*sin(v) + 0.05*x", "v + 0.3*u"],
        noise=[{"law": "gaussian", "std": std}] * 3,
        state_low=[-3, -3, -2], state_high=[6, 3, 2], input_low=[-2], input_high=[2], initial_state=[-1, 0.4, 0],
    )  # fmt: skip
    goal = cg.Proposition("a", [0.8, -0.6, -2.0], [3.0, 0.8, 2.0])
    wall = cg.Proposition("a", [-1.0, 1.0, -2.0], [3.0, 3.0, 2.0])
    problem = cg.Problem(name="glider", horizon=10, agents=[agent], propositions={"goal": goal, "wall": wall},
                         specification=cg.Specification("!wall U goal"))  # fmt: skip
    view = OwnView(0, 1, 3, problem.automaton.n_states, 10)
    rng = np.random.default_rng(1)
    weights, biases = layers_of(rng, [view.size, 12, 1], 0.15)
    weights[0][:3, :3] = np.array([[0.0, 0.6, 0.0], [0.0, 0.0, 0.7], [0.1, 0.2, 0.1]], dtype=np.float32)
    weights[1][0, :3] = np.array([-1.3, -0.9, 0.1], dtype=np.float32)
    layers = Layers(tuple(weights), tuple(biases), "tanh", False)
    return problem, [NetworkPolicy(layers, view, agent.workspace, agent.input_box)]


def test_runs_stay_in_tubes_wherever_forms_keep_in_ellipsoids() -> None:
    """Pathwise: of 20,000 runs, some with more noise, those whose forms keep in all ellipsoids are in all tubes."""
    problem, policies = glider()
    certificate = networks_along(problem, policies)
    assert certificate.proof.failure < 1e-3 and cg.check(certificate)
    known = read_problem({"problem": canonical_problem(problem)})
    radius = 2.5  # so that many runs are near the edge
    proof = replace(certificate.proof, radii=(radius,))
    read = read_trajectories(contents_of(replace(certificate, proof=proof)), known)
    joint = Joint.of(known, read.trajectories, read.letters)
    rng, n = np.random.default_rng(0), 20_000
    x, g, kept = np.tile(joint.states[0][:, None], n), np.zeros((3, n)), np.ones(n, dtype=bool)
    noise = np.zeros((3, n))
    seen = automaton_states(known, certificate.proof.letters.astype(np.int64))
    for around in walk(joint):
        if t := around.t:  # the step that was taken last
            g = joint.errors.steps[-1][0] @ g + noise
            kept &= np.linalg.norm(around.ellipsoids[0].white @ g, axis=0) <= radius  # type: ignore[union-attr]
        e = x - joint.states[t][:, None]
        kept &= np.all((x >= joint.box[0][:, None]) & (x <= joint.box[1][:, None]), axis=0)
        inside = np.all((e >= around.ends[0][:, None] - 1e-9) & (e <= around.ends[1][:, None] + 1e-9), axis=0)
        assert inside[kept].all(), t
        if t < len(joint.states) - 1:
            u = policies[0].inputs(x, np.full(n, max(seen[t], 0)), t)
            noise = some_noise(rng, n)
            x = (
                np.array([x[0] + 0.3 * np.cos(x[2]), x[1] + 0.3 * np.sin(x[2]) + 0.05 * x[0], x[2] + 0.3 * u[0]])
                + noise
            )
    assert 0.05 < kept.mean() < 0.999


def test_what_a_network_leaves_out_is_charged_where_products_follow_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    """An input is what its gains say, up to what they leave out: dynamics are expanded with both."""
    problem, policies = glider()
    known, offsets, honest = read_problem({"problem": canonical_problem(problem)}), list[np.ndarray](), steps.expanded

    def spied(*arguments: Any) -> Any:
        offsets.append(arguments[6].args[2])
        return honest(*arguments)

    read = read_trajectories(contents_of(networks_along(problem, policies)), known)
    monkeypatch.setattr(steps, "expanded", spied)
    assert len([*walk(Joint.of(known, read.trajectories, read.letters))]) == len(offsets) + 1 > 3
    assert all(off[3] > 1e-8 and not off[:3].any() for off in offsets)


def test_messages_speak_of_cells_only_where_there_are_some() -> None:
    """Cells under networks have linear dynamics; what is certified along a run has any."""
    problem, policies = glider()
    linear, _ = an_agent(3, 1)
    wide, _ = an_agent(4, 1)
    smooth = [replace(policies[0], network=replace(policies[0].network, activation="silu"))]
    found = [_may_have_cells(*each) for each in
             ((linear, policies), (problem, policies), (wide, policies), (linear, smooth))]  # fmt: skip
    assert found == [True, False, False, False]


def some_noise(rng: np.random.Generator, n: int) -> np.ndarray:
    return 0.02 * rng.standard_normal((3, n)) * rng.choice([0.5, 1.0, 1.6], n)


def test_files_hold_networks_and_forgeries_are_refused(tmp_path: Any) -> None:
    problem, policies = glider()
    certificate = networks_along(problem, policies)
    cg.save(certificate, tmp_path / "c.npz")
    again: Any = cg.load(tmp_path / "c.npz")
    assert cg.check(again, problem) and again.proof.failure == certificate.proof.failure
    assert cg.validate(again, 20_000, seed=2, confidence=1.0 - 1e-6).verdict != "refuted"
    proof, (policy,) = certificate.proof, policies
    smaller = replace(proof, failure=0.9 * proof.failure)
    wilder = replace(policy, network=replace(policy.network, weights=tuple(3 * w for w in policy.network.weights)))
    path = replace(proof.paths[0], states=proof.paths[0].states + 0.05)
    for forged in (
        smaller,
        replace(proof, networks=(wilder,)),
        replace(proof, radii=(2.0,)),
        replace(proof, paths=(path,)),
    ):
        assert not cg.check(replace(certificate, proof=forged))
    windy, _ = glider(0.06)
    assert not cg.check(replace(certificate, problem=windy), windy)


SABOTAGE: dict[str, tuple[Any, str, Any]] = {
    "radius of a dimension less": (steps.Ellipsoid, "of", None),
    "what rounds and bends is dropped": (networks.Layer, "rest", None),
    "the automaton state of another step": (steps, "automaton_states", None),
}


@mostly_thorough("name", SABOTAGE)
def test_sabotage_claims_less_failure_or_another_network(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What makes these tests: that each sabotage changes what is proved of an honest certificate."""
    problem, policies = glider(0.05)
    certificate = networks_along(problem, policies)
    owner, attribute, _ = SABOTAGE[name]
    if attribute == "of":
        honest: Any = Ellipsoid.of

        def fewer(errors: ErrorSystem, places: Any, radius: float, kinds: Any) -> Ellipsoid:
            own = honest(errors, places, radius, kinds)
            return replace(own, lost=length_tail(radius, len(own.root) - 1, 1.0))

        monkeypatch.setattr(owner, attribute, staticmethod(fewer))
    elif attribute == "rest":
        monkeypatch.setattr(owner, attribute, lambda self: np.zeros((2, len(self.h))))
    else:
        monkeypatch.setattr(
            owner, attribute, lambda problem, letters: [q + 1 for q in automaton_states(problem, letters)]
        )
    monkeypatch.setattr(canonical, "_verdicts", {})
    try:
        found = canonical.verdict_of(certificate).recomputed
    except (IndexError, ValueError):
        return
    assert found != pytest.approx(certificate.proof.failure, rel=1e-6)


WRITTEN = (
    "clip(-0.6*x - 1.2*y, -1, 0.4)", "max(-1, min(1, -0.6*x)) + 0.3*tanh(2*y)", "-tanh(x + 3*y)*min(1, t/4 + 0.3)",
    "0.5*x*y - max(x - 0.2, 0)", "sin(x) - min(0.1, y)", "-(max(x, 0) - 2*min(y, 0.3))*0.5", "max(x, y)", "0.3*t - 1",
)  # fmt: skip


@pytest.mark.parametrize("text", WRITTEN)
def test_expressions_are_enclosed(text: str) -> None:
    """At points of boxes around random states, corners among them; controllers may be off by a billionth."""
    rng = np.random.default_rng(WRITTEN.index(text))
    agent = cg.Agent(name="a", states=["x", "y"], inputs=["u"], dynamics=["x + u", "y"],
                     noise=[{"law": "gaussian", "std": 1}] * 2, state_low=[-9] * 2, state_high=[9] * 2,
                     input_low=[-0.9], input_high=[1.1], initial_state=[0, 0])  # fmt: skip
    problem = cg.Problem(name="p", horizon=5, agents=[agent], specification=cg.Specification("F b"),
                         propositions={"b": cg.Proposition("a", [0, 0], [1, 1])})  # fmt: skip
    own = read_problem({"problem": canonical_problem(problem)}).agents[0]
    feedback, policy = read_feedback(Entry([text], "feedback"), own), SymbolicPolicy.of(agent, [text])
    for _ in range(20):
        at, t = rng.uniform(-1.0, 1.0, 2), int(rng.integers(5))
        ends = np.stack([-rng.uniform(0.0, 0.4, 2), rng.uniform(0.0, 0.4, 2)])
        e = np.where(rng.random((2000, 2)) < 0.3, rng.choice([0, 1], (2000, 2)), rng.random((2000, 2)))
        e = ends[0] + e * (ends[1] - ends[0])

        u, J, rest = enclosed_feedback(feedback, own, at, t, Seen(ends, None, in_box(*ends)))
        found = policy.inputs((at + e).T, np.zeros(len(e), dtype=int), t).T
        left = found - u - e @ J.T
        off = 0.9e-9 * ((found > -0.899) & (found < 0.399))  # by which a controller may be off that is not cut off
        assert np.all(left - off >= rest[0]) and np.all(left + off <= rest[1])
        assert np.all(rest[1] - rest[0] <= 8.0 * np.ptp(left, axis=0) + 1e-8) or "*y" in text or "max(x, y)" in text


@pytest.mark.parametrize("activation", networks.SMOOTH)
def test_smooth_activations_bend_no_more_than_is_said(activation: str) -> None:
    """Second differences at points that are dense where the activation bends, and values in single precision."""
    f, bend = networks.SMOOTH[activation]
    x, h = np.linspace(-12.0, 12.0, 200_001), 1e-3
    low, high = f(interval(x))
    assert np.all(low <= high) and np.all(high - low <= 1e-13 * (1.0 + np.abs(x)))
    middle, beside = f(interval(x)).mean(axis=0), [f(interval(x + side)).mean(axis=0) for side in (-h, h)]
    assert np.abs(beside[0] - 2.0 * middle + beside[1]).max() / h**2 <= bend + 1e-6
    single = SINGLE[activation](x.astype(np.float32)).astype(float)
    exact = f(interval(x.astype(np.float32).astype(float)))
    off = np.maximum(exact[0] - single, single - exact[1])
    assert np.all(off <= 0.5 * networks.ACTIVATION_OFF * np.maximum(1.0, np.abs(middle)))


@pytest.mark.parametrize("activation", [*networks.SMOOTH, "relu", "clip"])
def test_parabolas_hold_at_all_points_of_an_interval(activation: str) -> None:
    """Wide and narrow intervals; each point of which is compared with the parabola and what it leaves."""
    rng = np.random.default_rng(7)
    n = 400
    z, width = rng.uniform(-6.0, 6.0, n), 10.0 ** rng.uniform(-9.0, 1.0, n)
    ends = np.stack([-width * rng.uniform(0.0, 1.0, n), width * rng.uniform(0.0, 1.0, n)])
    limits, smooth = (0.0, np.inf) if activation == "relu" else (-1.0, 1.0), activation in networks.SMOOTH
    slope, bend, value, rest = networks._parabola(activation, z, ends, *limits)
    for share in np.linspace(0.0, 1.0, 211):
        d = ends[0] + share * (ends[1] - ends[0])
        there = functions(activation, limits)(z + d)
        left = there - value - slope * d - bend * d**2
        assert np.all(left >= rest[0]) and np.all(left <= rest[1])
    # and it says something: what is left of narrow intervals is a cube of their width, or of kinks a part of it
    wide, off = ends[1] - ends[0], 1e-8 + 4.0 * networks.ACTIVATION_OFF * (1.0 + np.abs(z) + width)
    assert np.all(rest[1] - rest[0] <= (np.minimum(wide**2, 0.2 * wide**3) + off if smooth else 0.3 * wide + 1e-8))


def functions(activation: str, limits: Any) -> Any:
    if activation in networks.SMOOTH:
        return lambda x: networks.SMOOTH[activation][0](interval(x)).mean(axis=0)
    return lambda x: np.clip(x, *limits)
