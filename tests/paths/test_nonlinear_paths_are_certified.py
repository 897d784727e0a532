"""Paths of agents written as expressions: certified below the truth, checked by other code, carried out, kept."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom, norm

import certigym as cg
from certigym.synthesis.certificates.proofs import AgentPath, AlongPath, PathProof, changed, start_of_claim
from certigym.synthesis.policy_search.cell_certificates.agreement import agreed, agreed_path
from certigym.synthesis.trajectories.chance_constraints import feedback_bounds
from certigym.synthesis.trajectories.planning.counted_work import CountedWork
from certigym.synthesis.trajectories.planning.nonlinear_search import FeedbackTrajectory, NonlinearSearch
from fleet_problems import path_of
from kinds import mostly_thorough

FALSE_ALARM = 1e-6
"""Probability that a test of rollouts fails although the claim is true."""


def problem_of(agents: list[Any], regions: dict[str, cg.Proposition], formula: str, horizon: int) -> cg.Problem:
    """Return a problem; formulas with G are judged at the end."""
    task = cg.Specification(formula, "finite-trace" if "G" in formula else "co-safe")
    return cg.Problem(name="path", agents=agents, propositions=regions, specification=task, horizon=horizon)


def cart(**changes: Any) -> cg.Agent:
    """A car with four states: place, heading and speed."""
    arguments: dict[str, Any] = {
        "states": ["x", "y", "heading", "speed"], "inputs": ["turn", "push"],
        "dynamics": ["x + 0.4*speed*cos(heading)", "y + 0.4*speed*sin(heading)", "heading + 0.4*turn",
                     "speed + 0.4*push"],
        "noise_covariance": np.diag([0.03**2, 0.03**2, 0.03**2, 0.03**2]), "state_low": [-1, -3, -3, -1],
        "state_high": [7, 3, 3, 2], "input_low": [-2, -2], "input_high": [2, 2], "initial_state": [0, 0, 0, 0.5],
        "outputs": ["x", "y"],
    }  # fmt: skip
    return cg.Agent(name="cart", **{**arguments, **changes})


def bend(horizon: int = 12, **changes: Any) -> cg.Problem:
    """Return the cart that passes a rock on its way to a dock."""
    regions = {"rock": cg.Proposition("cart", [1.5, -1.0], [2.5, 0.4]), "dock": cg.Proposition("cart", [4, -1], [6, 1])}
    return problem_of([cart(**changes)], regions, "(!rock) U dock", horizon)


def tank(least: float = -0.01, most: float = 0.02) -> cg.Problem:
    """Return a tank whose outflow is a root, with noise that grows with the level, and a disturbance."""
    agent = cg.Agent(
        name="tank", states=["upper", "lower"], inputs=["pump"], disturbances={"leak": [least, most]},
        dynamics=["upper + 0.2*pump - 0.2*sqrt(upper)", "lower + 0.2*sqrt(upper) - 0.2*sqrt(lower) - leak"],
        noise=[{"law": "gaussian", "std": 0.02}, {"law": "gaussian", "std": 0.02}],
        noise_scale=["0.5 + 0.5*upper", "1"], state_low=[0.1, 0.1], state_high=[4, 4], input_low=[0], input_high=[2],
        initial_state=[1, 1],
    )  # fmt: skip
    return problem_of([agent], {"full": cg.Proposition("tank", [1.4, 1.3], [2.2, 2.0])}, "F full", 16)


PROBLEMS = {"cart": bend(), "box": bend(initial_state=None, initial_low=[-0.1, -0.1, -0.05, 0.45],
                                       initial_high=[0.1, 0.1, 0.05, 0.55]), "tank": tank()}  # fmt: skip


@pytest.fixture(scope="module")
def certificates() -> dict[str, AlongPath]:
    return {name: path_of(problem) for name, problem in PROBLEMS.items()}


@pytest.mark.parametrize("name", sorted(PROBLEMS))
def test_certificates_are_checked_and_not_refuted(name: str, certificates: dict[str, AlongPath]) -> None:
    certificate = certificates[name]
    report = cg.check(certificate, PROBLEMS[name])
    assert report.valid, report.failures
    assert certificate.lower_bound > 0.9
    verdict = cg.validate(certificate, 20_000, seed=1, confidence=1.0 - FALSE_ALARM / 3)
    assert verdict.verdict != "refuted"


@pytest.mark.parametrize("start", [[-0.1, -0.1, -0.05, 0.45], [0.1, 0.1, 0.05, 0.55], [0.1, -0.1, 0.05, 0.45]])
def test_corners_of_a_start_box_keep_the_bound(start: list[float], certificates: dict[str, AlongPath]) -> None:
    certificate = certificates["box"]
    assert start_of_claim(certificate) == "mean" and start_of_claim(certificates["cart"]) == "point"
    problem = PROBLEMS["box"].replace(initial_state=start)
    done = cg.rollout(problem, certificate.controller, 20_000, seed=3)
    assert binom.cdf(done.successes, 20_000, certificate.lower_bound) > FALSE_ALARM / 3


@pytest.mark.parametrize("leak", [-0.01, 0.02])
def test_disturbances_at_their_ends_keep_the_bound(leak: float, certificates: dict[str, AlongPath]) -> None:
    """Against dynamics written here once more."""
    certificate, rng, n = certificates["tank"], np.random.default_rng(4), 20_000
    (path,) = certificate.proof.paths
    assert path.states is not None
    x, kept = np.ones((2, n)), np.ones(n, dtype=bool)
    reached = np.zeros(n, dtype=bool)
    for t in range(certificate.proof.n_steps):
        u = np.clip(path.inputs[t][:, None] + path.gains[t] @ (x - path.states[t][:, None]), 0.0, 2.0)
        upper, lower = x
        scale = np.stack([0.5 + 0.5 * upper, np.ones(n)])
        flow, out = 0.2 * np.sqrt(upper), 0.2 * np.sqrt(lower)
        mean = np.stack([upper + 0.2 * u[0] - flow, lower + flow - out - leak])
        x = mean + 0.02 * scale * rng.standard_normal((2, n))
        kept &= np.all((x >= 0.1) & (x <= 4.0), axis=0) | reached
        reached |= kept & (x[0] >= 1.4) & (x[0] < 2.2) & (x[1] >= 1.3) & (x[1] < 2.0)
        x = np.clip(x, 0.1, 4.0)
    assert binom.cdf(int(reached.sum()), n, certificate.lower_bound) > FALSE_ALARM / 2


def test_one_step_is_nearly_exact() -> None:
    """A step without any past has no drift: the bound is that of the interval that is to be hit."""
    agent = cg.Agent(
        name="one", states=["x"], inputs=["u"], dynamics=["x + u*cos(x)"], noise_covariance=[[0.04]], state_low=[-3],
        state_high=[3], input_low=[-1], input_high=[1], initial_state=[0.3],
    )  # fmt: skip
    certificate = path_of(problem_of([agent], {"goal": cg.Proposition("one", [0.6], [1.4])}, "F goal", 1))
    truth = 2.0 * norm.cdf(0.4 / 0.2) - 1.0
    assert truth - 1e-5 < certificate.lower_bound <= truth
    assert cg.check(certificate)


def shifted(certificate: AlongPath, **changes: Any) -> AlongPath:
    (path,) = certificate.proof.paths
    return changed(certificate, paths=(replace(path, **{k: f(getattr(path, k)) for k, f in changes.items()}),))


FORGERIES = {
    "failure": lambda c: changed(c, failure=0.9 * c.proof.failure),
    "no failure": lambda c: changed(c, failure=0.0),
    "letters": lambda c: changed(c, letters=np.zeros_like(c.proof.letters)),
    "sides": lambda c: changed(c, faces=np.where(c.proof.faces >= 0, c.proof.faces ^ 1, -1)),
    "inputs": lambda c: shifted(c, inputs=lambda u: 0.9 * u),
    "states": lambda c: shifted(c, states=lambda x: x + 0.05),
    "start": lambda c: shifted(c, states=lambda x: np.vstack([x[:1] + 0.3, x[1:]])),
    "gains": lambda c: shifted(c, gains=lambda k: 1.5 * k),
    "gains of another step": lambda c: shifted(c, gains=lambda k: np.roll(k, 3, axis=0)),
    "no feedback": lambda c: shifted(c, gains=lambda k: 0.0 * k),
    "wide strips": lambda c: shifted(c, strips=lambda s: 4.0 * s),
    "no strips": lambda c: shifted(c, strips=lambda s: np.full_like(s, np.inf)),
    "narrow strips": lambda c: shifted(c, strips=lambda s: 0.5 * s),
    "strips that are none": lambda c: shifted(c, strips=lambda s: -s),
    "too large inputs": lambda c: shifted(c, inputs=lambda u: u + 3.0),
    "one step less": lambda c: changed(
        c, letters=c.proof.letters[1:], faces=c.proof.faces[1:],
        paths=tuple(AgentPath(p.inputs[1:], p.gains[1:], p.states[1:], p.strips[1:]) for p in c.proof.paths)),
    "form": lambda c: shifted(c, states=lambda x: x[:-1]),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(FORGERIES))
def test_forgeries_are_refused(name: str, certificates: dict[str, AlongPath]) -> None:
    assert not cg.check(FORGERIES[name](certificates["cart"]))


@pytest.mark.thorough
def test_what_is_certified_of_a_calm_world_is_refused_for_a_windy_one() -> None:
    """The search forgets that a disturbance has two ends, and claims what is true of the middle of them."""
    claim = path_of(tank(0.0049, 0.0051))
    assert cg.check(claim)
    assert not cg.check(replace(claim, problem=PROBLEMS["tank"]))


@mostly_thorough(
    ("value", "gain", "admissible"),
    [(-1.0, 0.0, True), (1.0, 0.0, True), (1.01, 0.0, False), (-1.01, 0.0, False), (1.0, 0.1, False),
     (-1.0, 0.1, False), (0.0, 0.1, True)], first=4,
)  # fmt: skip
def test_inputs_keep_their_box_with_their_feedback(value: float, gain: float, admissible: bool) -> None:
    """A third input moves nothing: what is asked of it is its box alone."""
    agent = cart(inputs=["turn", "push", "idle"], input_low=[-2, -2, -1], input_high=[2, 2, 1])
    problem = problem_of([agent], {"dock": cg.Proposition("cart", [1.0, -1], [6, 1])}, "F dock", 5)
    search = NonlinearSearch(problem, 0, CountedWork())
    letters = np.zeros((6, 1), dtype=np.int8)
    letters[5] = 1
    found = search.quick(letters)
    assert found is not None
    inputs, gains = found.path.inputs.copy(), found.path.gains.copy()
    inputs[:, 2], gains[:, 2] = value, [gain, 0.0, 0.0, 0.0]
    path = replace(found.path, inputs=inputs, gains=gains)
    certificate = cg.Certificate(problem, PathProof((path,), letters, np.full((6, 1), -1), 0.1), {})
    assert bool(cg.check(certificate)) == admissible


def noisy() -> cg.Problem:
    """The cart with so much noise that failures are not negligible."""
    noise = np.diag([0.05**2, 0.05**2, 0.06**2, 0.04**2])
    return bend(noise_covariance=noise, input_low=[-1, -1], input_high=[1, 1])


def along(problem: cg.Problem, calm: cg.Problem | None = None) -> tuple[FeedbackTrajectory, AlongPath]:
    """What little work finds along a path, as in a calm world, and its certificate."""
    certificate = replace(path_of(calm or problem), problem=problem)
    found = NonlinearSearch(problem, 0, CountedWork()).quick(certificate.proof.letters)
    assert found is not None
    return found, changed(certificate, paths=(found.path,), faces=found.faces, failure=found.failure)


def without_the_tube(*arguments: Any, **named: Any) -> Any:
    """Remainders at the point in place of the tube: none."""
    middle, half = true_remainders(*arguments, **named)
    return 0.0 * middle, 0.0 * half


def with_the_other_sign(*arguments: Any, **named: Any) -> Any:
    """Remainders that bend to the other side."""
    middle, half = true_remainders(*arguments, **named)
    return -middle, half


true_remainders: Any = feedback_bounds.remainders


class NoDrift(feedback_bounds._Walk):
    """Tubes, inputs and limits that only linear deviations are kept from."""

    def of_rows(self, t: int, rows: Any) -> Any:
        shift, linearization_error, variance = super().of_rows(t, rows)
        return shift, 0.0 * linearization_error, variance


class NoTubeRows(feedback_bounds._Walk):
    """Tubes that are not asked for in the product."""

    def walked(self) -> Any:
        worth, spreads = super().walked()
        worth.strip = [np.full(part.shape, np.inf) for part in worth.strip]
        return worth, spreads


SABOTAGES: dict[str, tuple[str, Any]] = {
    "remainder at the point": ("remainders", without_the_tube),
    "tube without drift": ("_Walk", NoDrift),
    "tube rows left out": ("_Walk", NoTubeRows),
}


def bowl() -> cg.Problem:
    """A ball that rolls to the middle, and a cost that its square adds to: all of the bend is on one side."""
    noise = [{"law": "gaussian", "std": 0.05}, {"law": "gaussian", "std": 0.01}]
    agent = cg.Agent(name="ball", states=["x", "cost"], dynamics=["0.8*x", "0.9*cost + 0.3*x**2"], noise=noise,
                     state_low=[-2, -1], state_high=[2, 1], initial_state=[0.5, 0.0])  # fmt: skip
    return problem_of([agent], {"dear": cg.Proposition("ball", [-2, 0.4], [2, 1])}, "G !dear", 6)


@cache
def honest(bowled: bool) -> tuple[FeedbackTrajectory, AlongPath]:
    """What is found for the ball, or for noisy agents; the check accepts it."""
    found, certificate = along(bowl()) if bowled else along(noisy(), bend(input_low=[-1, -1], input_high=[1, 1]))
    return found, agreed_path(certificate)


@mostly_thorough("name", [*sorted(SABOTAGES), "remainder of the other sign", "jacobian of a later step"])
def test_sabotage_of_the_search_is_refused_by_the_check(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    found, certificate = honest(name not in SABOTAGES)
    nominal = found.nominal
    if name in SABOTAGES:
        monkeypatch.setattr(feedback_bounds, *SABOTAGES[name])
    elif name == "remainder of the other sign":
        monkeypatch.setattr(feedback_bounds, "remainders", with_the_other_sign)
    else:
        nominal = feedback_bounds.NominalPath(nominal.model, nominal.limits, nominal.states, nominal.inputs)
        nominal.__dict__["linear"] = tuple(np.vstack([m[1:], m[-1:]]) for m in found.nominal.linear)
    feedback = found.feedback
    worth, spreads = nominal.worth(feedback)
    path = AgentPath(found.nominal.inputs, feedback.gains[0], found.nominal.states, spreads.strips)
    # The check adds up less than the search does: the fault takes the same share from what it proves.
    share = float(worth.failures()[0]) / found.failure
    forged = changed(certificate, paths=(path,), failure=share * certificate.proof.failure)
    assert forged.proof.failure < 0.999 * certificate.proof.failure and not cg.check(forged)


@pytest.mark.thorough
@pytest.mark.parametrize("longest", [30.0, 3000.0])
def test_a_clock_is_a_state_without_noise(longest: float) -> None:
    """A reference that moves with the time: the check refused strips that were thinner than what it rounds by."""
    agent = cg.Agent(
        name="one", states=["x", "clock"], inputs=["u"], dynamics=["x + u", "clock + 1"],
        outputs=["x - 2*sin(0.4*clock)"], noise=[{"law": "gaussian", "std": std} for std in (0.1, 0.0)],
        state_low=[-4, -1], state_high=[4, longest], input_low=[-1], input_high=[1], initial_state=[0, 0],
    )  # fmt: skip
    certificate = path_of(problem_of([agent], {"near": cg.Proposition("one", [-0.5], [0.5])}, "G near", 20))
    assert certificate.lower_bound > 0.999 and cg.check(certificate)
    assert cg.validate(certificate, 20_000, seed=2, confidence=1.0 - FALSE_ALARM).verdict != "refuted"


@pytest.mark.thorough
def test_noise_that_grows_with_the_state_is_certified_at_any_size() -> None:
    """Noise of which no strip is small: the largest scale on the tube counts, and no more than the tails double."""
    agent = cg.Agent(
        name="plant", states=["upper", "lower"], inputs=["pump"],
        dynamics=["upper + 0.5*(pump - 0.4*sqrt(max(upper, 0)))",
                  "lower + 0.5*(0.4*sqrt(max(upper, 0)) - 0.35*sqrt(max(lower, 0)))"],
        noise=[{"law": "gaussian", "std": 1.0}] * 2,
        noise_scale=["0.02 + 0.05*pump", "0.02 + 0.02*sqrt(max(upper, 0))"], state_low=[0, 0], state_high=[4, 4],
        input_low=[0], input_high=[1], initial_state=[1, 0.5],
    )  # fmt: skip
    regions = {"good": cg.Proposition("plant", [0.5, 1.4], [3.0, 2.2]), "full": cg.Proposition("plant", [0, 3], [4, 4])}
    certificate = path_of(problem_of([agent], regions, "(!full) U good", 25))
    assert certificate.lower_bound > 0.97
    assert cg.check(certificate)
    assert cg.validate(certificate, 20_000, seed=1, confidence=1.0 - FALSE_ALARM).verdict != "refuted"


def test_outputs_of_which_nothing_is_known_on_the_tube_certify_nothing() -> None:
    """The logarithm of a state that the tube takes beyond 0 has no bounds: no limit on it is kept."""
    agent = cg.Agent(
        name="one", states=["x"], inputs=["u"], dynamics=["x + u"], noise_covariance=[[1e-4]], state_low=[-1],
        state_high=[1], input_low=[-1], input_high=[1], initial_state=[0.505], outputs=["log(x)"],
    )  # fmt: skip
    problem = problem_of([agent], {"bad": cg.Proposition("one", [-9.0], [-0.69])}, "G !bad", 1)
    path = AgentPath(np.zeros((1, 1)), np.zeros((1, 1, 1)), np.full((2, 1), 0.505), np.full((2, 2), np.inf))
    letters, faces = np.array([[0], [-1]], dtype=np.int8), np.array([[-1], [1]])
    for failure in (0.6, 0.99):
        assert not cg.check(cg.Certificate(problem, PathProof((path,), letters, faces, failure), {}))


def test_independent_agents_multiply() -> None:
    """Two carts, one of which has matrices, with one task about both."""
    second = cg.LinearAgent(
        name="wagon", A=[[1.0, 0.4], [0.0, 1.0]], B=[[0.0], [0.4]], noise_covariance=1e-3 * np.eye(2),
        state_low=[-3, -2], state_high=[5, 2], input_low=[-1], input_high=[1], initial_state=[0, 0],
    )  # fmt: skip
    regions = {"dock": cg.Proposition("cart", [3, -1], [6, 1]), "stop": cg.Proposition("wagon", [1, -2], [4, 2])}
    certificate = path_of(problem_of([cart(), second], regions, "F (dock & stop)", 10))
    assert cg.check(certificate) and certificate.lower_bound > 0.99
    verdict = cg.validate(certificate, 5000, seed=2, confidence=1.0 - FALSE_ALARM)
    assert verdict.verdict != "refuted"


@pytest.mark.thorough
def test_no_more_is_claimed_than_the_check_proves() -> None:
    """Search and check enclose expressions by code of their own: the larger failure of both is claimed."""
    _, certificate = along(noisy())
    bold: Any = changed(certificate, failure=0.5 * certificate.proof.failure)
    assert not cg.check(bold)
    modest = agreed(cg.Synthesis(bold, bold.controller, {})).certificate
    assert cg.check(modest) and modest.lower_bound <= cg.check(certificate).recomputed
    assert agreed(cg.Synthesis(modest, modest.controller, {})).certificate.lower_bound == modest.lower_bound
