"""The certified bound of a deployed network is below what it attains, and no changed network or enclosure passes."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

import certigym as cg
from certigym.cli.main import main
from certigym.synthesis.abstraction.models import network_abstraction
from certigym.synthesis.abstraction.models.network_model import NetworkChoices
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.extended_check.steps.network_enclosures import network_spans
from certigym.synthesis.relations.kinds import Network, boxes
from certigym.synthesis.relations.kinds.network_bounds import line_around, mean_bounds
from certigym.synthesis.verbs.raw_networks import certify_network, differences, repair_network
from certigym.validation.policies.actors import CentralActor, SharedActor, load_actor, save_actor
from certigym.validation.policies.views import CentralView, SharedView
from kinds import mostly_thorough
from network_problems import RNG, means_at, network, proportional, reach, with_network
from problems import cart, linear, scalar_agent


@pytest.fixture(scope="module")
def certified() -> tuple[cg.Problem, SharedActor, cg.Synthesis]:
    """Two scalar agents and the certificate of their network."""
    problem = reach(scalar_agent("a"), scalar_agent("b"))
    actor = proportional(problem)
    return problem, actor, certify_network(problem, actor, 100)


SHAPES = [
    ([8], "tanh", False),
    ([16, 16], "tanh", False),
    ([16, 16], "tanh", True),
    ([16, 16], "relu", False),
    ([8, 8, 8], "relu", True),
    ([], "tanh", False),
]


@pytest.mark.parametrize("hidden, activation, squashed", SHAPES)
@mostly_thorough("make", [scalar_agent, cart])
def test_no_point_of_a_cell_leaves_its_box(hidden: list[int], activation: str, squashed: bool, make: Any) -> None:
    """Dense samples of closed cells, corners among them; the boxes of the check lie inside those of the search."""
    agent = make() if make is cart else make("a")
    problem, d = reach(agent, horizon=2), agent.n_states
    view = SharedView(problem)
    actor = SharedActor(problem, network([view.size, *hidden, view.n_actions], activation, squashed))
    abstraction = network_abstraction(problem, [actor.agent_policy(0)], 12 if d == 1 else 6, relation="boxes")
    model = abstraction.models[0]
    synthesis = certify_network(problem, actor, 12 if d == 1 else 6, relation="boxes")
    part = synthesis.certificate.proof.agents[0]
    found = model.relation.mean_boxes(model.grid.low, model.grid.high)  # type: ignore[union-attr]
    shares = np.concatenate([RNG.random((200, d)), np.array(np.meshgrid(*[[0.0, 1.0]] * d)).reshape(d, -1).T])
    for mode in range(2 * problem.automaton.n_states):
        t, q = divmod(mode, problem.automaton.n_states)
        again = network_spans(agent, part, np.arange(model.grid.n_cells), mode)
        assert np.all(found.low[:, mode] <= again[0]) and np.all(again[1] <= found.high[:, mode])
        for cell, (low, high) in enumerate(zip(model.grid.low, model.grid.high, strict=True)):
            means = means_at(problem, actor, 0, (low + shares * (high - low)).T, q, t).T
            # The agent's own sum is rounded in double precision, which is not part of the spans of the check.
            assert np.all(again[0][cell] - 1e-13 <= means) and np.all(means <= again[1][cell] + 1e-13)


def test_enclosures_are_off_by_second_order() -> None:
    """With cells half as wide, what boxes are wider than the means of samples falls to about a quarter."""
    problem = reach(scalar_agent("a"))
    actor = SharedActor(problem, network([SharedView(problem).size, 16, 16, 1], "tanh", True))
    agent, excess = linear(problem.agents[0]), []
    for cells in (24, 48):
        edges = np.linspace(-4.0, 4.0, cells + 1)[:, None]
        low, high = edges[:-1], edges[1:]
        moves = (agent.A, agent.B, agent.offset)
        first, last = mean_bounds(actor.agent_policy(0), moves, np.eye(1), (low, high), 1)
        shares = np.linspace(0.0, 1.0, 33)
        states = (low + shares * (high - low)).reshape(1, -1)
        means = means_at(problem, actor, 0, states, 0, 0).reshape(len(low), -1)
        wider = (last - first)[:, 0, 0] - np.ptp(means, axis=1)
        assert np.all(wider > 0.0)
        excess.append(wider.mean())
    assert excess[1] < 0.35 * excess[0]


@pytest.mark.parametrize("kind", ["tanh", "relu", "clip"])
def test_lines_hold_their_function(kind: str) -> None:
    """On intervals of all widths, degenerate ones among them."""
    ends = np.sort(RNG.uniform(-4.0, 4.0, (2, 500)), axis=0)
    ends[1, :50] = ends[0, :50]
    ends[1, 50:100] = ends[0, 50:100] + 1e-13
    line = line_around(kind, *ends)
    function = {"tanh": np.tanh, "relu": lambda z: np.maximum(z, 0.0), "clip": lambda z: np.clip(z, -1.0, 1.0)}[kind]
    for share in np.linspace(0.0, 1.0, 101):
        z = ends[0] + share * (ends[1] - ends[0])
        assert np.all(np.abs(function(z) - line.slope * z - line.middle) <= line.radius)  # type: ignore[operator]


def dense(problem: cg.Problem, actor: Any, points: int) -> float:
    """Probability that one scalar agent reaches [1, 3], by the midpoint rule on many points."""
    agent = problem.agents[0]
    edges = np.linspace(-4.0, 4.0, points + 1)
    middle, std = 0.5 * (edges[1:] + edges[:-1]), float(np.sqrt(agent.noise_covariance[0, 0]))
    goal = (middle >= 1.0) & (middle < 3.0)
    initial = problem.automaton.initial
    value = goal.astype(float)
    start = np.array(agent.initial.low)[:, None]
    for t in reversed(range(problem.horizon)):
        at = start if t == 0 else middle[None]
        means = means_at(problem, actor, 0, at, initial, t)[0]
        later = np.diff(norm.cdf((edges[None] - means[:, None]) / std), axis=1) @ value
        value = later if t == 0 else np.where(goal, 1.0, later)
    return float(value[0])


@pytest.mark.thorough
def test_bounds_approach_dense_programming_from_below() -> None:
    """One agent: the bound rises with the cells, and stays below a computation with many points."""
    problem = reach(scalar_agent("a", initial_state=[-2.0]), horizon=3)
    actor = proportional(problem)
    truth = dense(problem, actor, 2000)
    assert abs(truth - dense(problem, actor, 1000)) < 1e-5
    bounds = [certify_network(problem, actor, cells).certificate.lower_bound for cells in (25, 100, 800)]
    assert bounds[0] < bounds[1] < bounds[2] < truth
    assert truth - bounds[2] < 0.01


def test_certificates_hold_and_travel(certified: tuple[cg.Problem, SharedActor, cg.Synthesis], tmp_path: Path) -> None:
    """Checked, saved and loaded; the controllers of the file do what the network does, and rollouts agree."""
    problem, actor, synthesis = certified
    certificate = synthesis.certificate
    assert cg.check(certificate) and certificate.lower_bound > 0.3
    cg.save(certificate, tmp_path / "c.npz")
    loaded = cg.load(tmp_path / "c.npz")
    assert cg.check(loaded) and loaded.lower_bound == certificate.lower_bound
    save_actor(actor, tmp_path / "a.npz")
    same: Any = load_actor(tmp_path / "a.npz", problem)
    assert differences(loaded, same) == []
    # The network itself and the controllers of the certificate succeed in the same episodes.
    ours = cg.rollout(problem, loaded.controller, episodes=20_000, seed=1)
    deployed = cg.rollout(problem, cg.as_controller(problem, same), episodes=20_000, seed=1)
    assert np.array_equal(ours.success, deployed.success)
    # False alarm 1e-6; a bound that is too large by .02 is refuted.
    report = cg.validate(synthesis, episodes=20_000, seed=1, confidence=1.0 - 1e-6)
    assert report.ci_high >= certificate.lower_bound


def test_a_single_agent_may_have_a_network_that_sees_all() -> None:
    """SAC: squashed, and not told which agent it is; rollouts are those of the actor itself."""
    problem = reach(scalar_agent("a", initial_state=[-1.0]), horizon=3)
    view = CentralView(problem)
    actor: Any = CentralActor(problem, network([view.size, 16, 16, 1], "relu", True))
    synthesis = cg.certify(problem, actor, 200)
    assert cg.check(synthesis) and differences(synthesis.certificate, actor) == []
    ours, deployed = (cg.rollout(problem, policy, episodes=5000, seed=0) for policy in (synthesis.controller, actor))
    assert np.array_equal(ours.success, deployed.success)
    assert not cg.check(with_network(synthesis.certificate, squashed=False))


def test_correlated_noise_and_two_inputs(certified: Any) -> None:
    """Cells that are no boxes of states: forms go through the coordinates."""
    agent = cart(
        B=[[0.5, 0.0], [0.0, 0.5]], input_low=[-2.0, -1.0], input_high=[2.0, 1.0],
        noise_covariance=[[0.04, 0.02], [0.02, 0.05]], initial_state=[-1.0, 0.0],
    )  # fmt: skip
    problem = reach(agent, horizon=3)
    synthesis = certify_network(problem, proportional(problem), 20)
    assert cg.check(synthesis)
    rate = cg.rollout(problem, synthesis.controller, episodes=5000, seed=0).success.mean()
    assert 0.0 < synthesis.certificate.lower_bound < rate


def test_enclosures_that_are_too_small_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """By a hundredth; the bound is then larger than what the check finds."""
    problem = reach(scalar_agent("a"))
    actor, true = proportional(problem), boxes.mean_bounds
    synthesis = certify_network(problem, actor, 100, relation="boxes")
    assert cg.check(synthesis)

    def smaller(*arguments: Any) -> Any:
        low, high = true(*arguments)
        return low + 0.005 * (high - low), high - 0.005 * (high - low)

    monkeypatch.setattr(boxes, "mean_bounds", smaller)
    wrong = certify_network(problem, actor, 100, relation="boxes").certificate
    monkeypatch.undo()
    assert wrong.lower_bound > synthesis.certificate.lower_bound
    report = cg.check(wrong)
    assert not report and "exceeds" in str(report)


def test_other_weights_are_refused(certified: tuple[cg.Problem, SharedActor, cg.Synthesis]) -> None:
    """A bias of the last layer that was changed after certification."""
    _, actor, synthesis = certified
    last = [bias.tolist() for bias in actor.network.biases]
    last[-1] = [-0.2]
    wrong = with_network(synthesis.certificate, biases=last)
    assert not cg.check(wrong)
    assert differences(wrong, actor) != []


def test_squashing_matters(certified: tuple[cg.Problem, SharedActor, cg.Synthesis]) -> None:
    """A network that is squashed where the certificate was made for one that is clipped."""
    _, _, synthesis = certified
    assert not cg.check(with_network(synthesis.certificate, squashed=True))


def test_the_wrong_time_is_refused(certified: tuple[cg.Problem, SharedActor, cg.Synthesis]) -> None:
    """What the network does at another time, and a view of another horizon, of another agent or of fewer states."""
    problem, _, synthesis = certified
    part = synthesis.certificate.proof.agents[0]
    shifted = part.policy.copy()
    shifted[0] = part.policy[1]
    wrong = dataclasses.replace(part, policy=shifted)
    report = cg.check(changed(synthesis.certificate, agents=(wrong, synthesis.certificate.proof.agents[1])))
    assert "another time" in str(report)
    for facts in ({"horizon": problem.horizon - 1}, {"agent": 1}):
        assert "another problem" in str(cg.check(with_network(synthesis.certificate, **facts)))


def test_what_is_not_certified_is_refused_in_words(certified: tuple[cg.Problem, SharedActor, cg.Synthesis]) -> None:
    """Networks that see all states, weights of double precision, other relations."""
    problem, actor, _ = certified
    view = CentralView(problem)
    with pytest.raises(ValueError, match="own state"):
        central: Any = CentralActor(problem, network([view.size, 2]))
        cg.certify(problem, central, 50)
    double = Network(tuple(w.astype(float) for w in actor.network.weights), actor.network.biases, "tanh", False)
    with pytest.raises(ValueError, match="single precision"):
        cg.certify(problem, SharedActor(problem, double), 50)
    with pytest.raises(ValueError, match="share"):
        repair_network(problem, actor, 50, share=2.0)


def test_repairs_raise_the_bound_where_networks_lose() -> None:
    """A network that stands still in a band is replaced there, and hardly anywhere else."""
    problem = reach(scalar_agent("a", initial_state=[-2.0]), horizon=4)
    actor = proportional(problem)
    flat = actor.network.weights[-1] * np.float32(0.05)  # nearly no effort
    weak = SharedActor(problem, dataclasses.replace(actor.network, weights=(*actor.network.weights[:-1], flat)))
    poor = certify_network(problem, weak, 100, relation="boxes").certificate.lower_bound
    repaired, places = repair_network(problem, weak, 100)
    best = cg.synthesize(problem, 100).certificate.lower_bound
    assert poor < 0.5 * best
    assert repaired.certificate.lower_bound > 0.95 * best
    assert cg.check(repaired)
    some, _ = repair_network(problem, weak, 100, share=0.5)
    nothing, _ = repair_network(problem, weak, 100, share=0.0)
    assert poor < some.certificate.lower_bound < repaired.certificate.lower_bound
    counts: list[Any] = [nothing.stats["repaired"], some.stats["repaired"], repaired.stats["repaired"]]
    assert 0 == counts[0] < counts[1] < counts[2] < 4 * 100
    assert abs(nothing.certificate.lower_bound - poor) < 1e-6
    worst = places.worst(5)
    assert worst[0]["loss"] == max(float(loss.max()) for loss in places.losses)
    assert sorted(worst, key=lambda place: -place["loss"]) == worst
    # At the first step the network is at its start, and nowhere else.
    at_first = np.flatnonzero(places.losses[0][0].sum(axis=0))
    edges = places.edges[0][0]
    assert len(at_first) == 1 and edges[at_first[0]] <= -2.0 < edges[at_first[0] + 1]


def test_losses_are_those_of_a_step() -> None:
    """At the last step the loss of the start cell is the value of the best input less that of the network."""
    problem = reach(scalar_agent("a", initial_state=[-0.3]), horizon=1)
    actor = proportional(problem)
    idle = np.zeros_like(actor.network.weights[-1])
    actor = SharedActor(problem, dataclasses.replace(actor.network, weights=(*actor.network.weights[:-1], idle)))
    abstraction = network_abstraction(problem, [actor.agent_policy(0)], 50, relation="boxes", with_menu=True)
    model = abstraction.models[0]
    assert isinstance(model.choices, NetworkChoices)
    _, places = repair_network(problem, actor, 50)
    cell = int(model.grid.cell_of(np.array([[-0.3]]))[0])
    goal = ((model.grid.centres[:, 0] >= 1.0) & (model.grid.centres[:, 0] < 3.0)).astype(float)
    backed_up, every = model.kernel.backup(goal[None]), range(model.choices.size.shape[1])
    values = [model.choices.read(backed_up, np.full(50, a, dtype=np.int32))[0, cell] for a in every]
    own = values[problem.automaton.initial]
    expected = max(values[actor.agent_policy(0).n_modes :]) - own
    assert expected > 0.1
    assert places.losses[0].sum() == pytest.approx(expected, abs=1e-9)


@pytest.mark.thorough
def test_the_command_line_certifies_and_repairs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An actor beside its problem, and in the place of it; list and picture of weak places; bounds as in Python."""
    problem = cg.make_problem("reach-avoid-v0", horizon=2)
    actor = proportional(problem)
    save_actor(actor, tmp_path / "a.npz")
    file, out, picture = str(tmp_path / "a.npz"), str(tmp_path / "c.npz"), str(tmp_path / "weak.svg")
    common = ["--cells", "60", "--episodes", "100", "--horizon", "2"]
    assert main(["certify", file, "--above", "--out", out, *common]) == 0
    printed = capsys.readouterr().out
    assert "holds for the deployed policy" in printed and "succeeds with P <= " in printed
    stored = cg.load(out)
    assert stored.lower_bound == cg.certify(problem, actor, 60).certificate.lower_bound
    options = ["certify", "reach-avoid-v0", "--policy", file, "--repair", "0.9", "--plot", picture]
    assert main([*options, "--json", out + ".json", *common]) == 0
    assert "replaced in" in capsys.readouterr().out
    assert "where the network loses" in Path(picture).read_text(encoding="utf-8")
    assert isinstance(json.loads(Path(out + ".json").read_text(encoding="utf-8"))["weak_places"], list)
    # Mistakes are one line and status 2.
    assert main(["certify", "reach-avoid-v0", *common]) == 2
    assert "--policy" in capsys.readouterr().err
    assert main(["certify", file, "--above", *common]) == 0
    assert "P >=" in capsys.readouterr().out
    assert main(["certify", file, "--relation", "exact", *common]) == 0
    assert "wrapped on the cells" in capsys.readouterr().out


@pytest.mark.thorough
@pytest.mark.parametrize("algorithm", ["ippo", "sac"])
def test_trained_actors_are_certified(algorithm: str) -> None:
    """Actors of Stable-Baselines3, hardly trained: PPO clips and has tanh, SAC squashes and has relu."""
    pytest.importorskip("stable_baselines3")
    agents = [scalar_agent("a"), scalar_agent("b")] if algorithm == "ippo" else [scalar_agent("a")]
    problem = reach(*agents, horizon=3)
    settings: dict[str, Any] = {"worlds": 8, "hidden": [16, 16]}
    settings |= {"learning_starts": 64, "batch_size": 32} if algorithm == "sac" else {}
    actor: Any = cg.train(problem, algorithm, steps=256, seed=0, **settings).actor
    certified = cg.certify(problem, actor, 150)
    assert cg.check(certified) and differences(certified.certificate, actor) == []
    found = {part.relation["network"]["activation"] for part in certified.certificate.proof.agents}
    assert found == {"tanh" if algorithm == "ippo" else "relu"}
    # False alarm 1e-6; a bound that is too large by .04 is refuted.
    report = cg.validate(certified, episodes=4000, seed=1, confidence=1.0 - 1e-6)
    assert report.ci_high >= certified.certificate.lower_bound
