"""A model trained elsewhere acts here as it acted there: the same rows, the same inputs; what is refused says why."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.baselines import central_vec_env, load_actor, shared_vec_env
from certigym.cli.main import main
from certigym.envs.simulation import Dynamics, Worlds
from certigym.synthesis.relations.kinds import Network
from certigym.validation.policies.actors import SharedActor, save_actor
from kinds import mostly_thorough
from network_problems import proportional, reach
from problems import cart, scalar_agent

sb3 = pytest.importorskip("stable_baselines3")
torch = pytest.importorskip("torch")
Module: Any = torch.nn.Module
Sequential: Any = torch.nn.Sequential

RNG = np.random.default_rng(0)
PARALLEL = [
    {"observation": observation, "scale": scale, "automaton": automaton, "actions": actions}
    for observation, scale, automaton, actions in [
        ("local", "raw", "one-hot", "input"),
        ("local", "unit", "one-hot", "unit"),
        ("local", "raw", "number", "unit"),
        ("local", "unit", "hidden", "input"),
        ("full", "raw", "one-hot", "unit"),
        ("relative", "unit", "one-hot", "input"),
        ("neighbours", "raw", "number", "unit"),
    ]
]


@pytest.fixture(scope="module")
def problem() -> cg.Problem:
    """Two agents of the same kind, with input boxes that are not [-1, 1]."""
    return reach(scalar_agent("a"), scalar_agent("b"))


@pytest.fixture(scope="module")
def uneven() -> cg.Problem:
    """Two agents that differ in their numbers of states and inputs."""
    return reach(scalar_agent("a"), cart())


def chain(observed: int, answered: int, *more: Any) -> Any:
    torch.manual_seed(0)
    layers = [torch.nn.Linear(observed, 8), torch.nn.Tanh(), torch.nn.Linear(8, answered), *more]
    module = torch.nn.Sequential(*layers)
    with torch.no_grad():
        module[2].weight *= 3.0
    return module


def space_size(space: Any) -> int:
    return int(space.shape[0])


def inputs_at(policy: Any, problem: cg.Problem, states: Any, q: int, time: int) -> list[Any]:
    """Inputs (m,) of all agents at states of theirs, as rollouts ask for them."""
    dynamics = Dynamics.of(problem)
    blocks = tuple(np.stack([np.asarray(states[i])[:, None] for i in b.agents], axis=1) for b in dynamics.blocks)
    no = np.zeros(1, dtype=bool)
    worlds = Worlds(blocks, np.array([q], dtype=np.int32), time, no, no)
    batch = policy.batch(dynamics)
    answers, _ = batch.act(worlds, batch.begin(worlds, np.random.default_rng(0)))
    return [answers[block][:, place, 0] for block, place in dynamics.position]


def test_rows_are_those_that_environments_show(problem: cg.Problem, uneven: cg.Problem) -> None:
    """Every environment and option: the model is asked by its own observations there, and by ours here."""
    for task in (problem, uneven):
        for options in PARALLEL:
            env = cg.parallel_env(task, **options)
            models = {}
            for name in env.possible_agents:
                observed = space_size(env.observation_space(name))
                models[name] = chain(observed, space_size(env.action_space(name)))
            policy = cg.as_policy(models, task, env)
            seen, infos = env.reset(seed=3)
            for time in range(3):
                actions = {n: models[n](torch.as_tensor(seen[n]).float()).detach().numpy() for n in env.agents}
                states = [infos[name]["state"] for name in env.possible_agents]
                q = infos[env.possible_agents[0]]["automaton_state"]
                ours = inputs_at(policy, task, states, q, time)
                for agent, name, mine in zip(task.agents, env.possible_agents, ours, strict=True):
                    theirs = np.clip(actions[name].astype(float), -1.0, 1.0)
                    if options["actions"] == "unit":
                        theirs = 0.5 * (agent.input_low + agent.input_high) + theirs * agent.input_box.half_width
                    theirs = np.clip(actions[name] if options["actions"] == "input" else theirs,
                                     agent.input_low, agent.input_high)  # fmt: skip
                    assert np.allclose(mine, theirs, atol=2e-5), (options, name)
                seen, *_, infos = env.step(actions)
                if not env.agents:
                    break


@pytest.mark.parametrize("observation", ["own", "joint", "neighbours"])
@pytest.mark.parametrize("scale", ["unit", "raw"])
def test_rows_of_teams(problem: cg.Problem, observation: str, scale: str) -> None:
    env = cg.team_env(problem, 4, observation=observation, scale=scale)
    step = env.reset(seed=0)
    models = {name: chain(step.observations[name].shape[1], 1) for name in env.agents}
    policy = cg.as_policy(models, problem, env)
    start = [np.array(agent.initial_low) for agent in problem.agents]
    ours = inputs_at(policy, problem, start, int(step.automaton_state[0]), 0)
    for agent, name, mine in zip(problem.agents, env.agents, ours, strict=True):
        action = np.clip(models[name](torch.as_tensor(step.observations[name]))[0].detach().numpy(), -1.0, 1.0)
        middle = 0.5 * (agent.input_low + agent.input_high)
        assert np.allclose(mine, middle + action * agent.input_box.half_width, atol=2e-5)


@mostly_thorough("scale", ["unit", "raw"])
@mostly_thorough("actions", ["unit", "input"])
def test_rows_of_one_learner_for_all(uneven: cg.Problem, scale: str, actions: str) -> None:
    """The centralised environment steps as rollouts do: the same inputs at the states of an episode."""
    env = cg.central_env(uneven, scale=scale, actions=actions)
    model = sb3.PPO("MlpPolicy", env, device="cpu", seed=1)
    with torch.no_grad():
        model.policy.action_net.weight *= 100.0
    policy = cg.as_policy(model, uneven)
    assert policy.models[0].observation_map.maker.startswith("central_env")
    seen, info = env.reset(seed=5)
    for time in range(3):
        action = model.predict(seen, deterministic=True)[0].astype(float)
        states = [info["state"][columns] for columns in uneven.columns]
        ours = inputs_at(policy, uneven, states, info["automaton_state"], time)
        for agent, columns, mine in zip(uneven.agents, uneven.input_columns, ours, strict=True):
            middle = 0.5 * (agent.input_low + agent.input_high)
            theirs = middle + action[columns] * agent.input_box.half_width if actions == "unit" else action[columns]
            assert np.allclose(mine, theirs, atol=1e-4)
        seen, _, ended, cut, info = env.step(action)
        if ended or cut:
            break


ALGORITHMS = [
    ("PPO", {"n_steps": 8, "batch_size": 16}),
    ("SAC", {}),
    ("PPO", {"n_steps": 8, "batch_size": 16, "use_sde": True, "policy_kwargs": {"activation_fn": torch.nn.ReLU}}),
]


@pytest.mark.parametrize("name, options", ALGORITHMS)
@mostly_thorough("worlds", [shared_vec_env, central_vec_env])
def test_models_of_stable_baselines(
    problem: cg.Problem, name: str, options: dict[str, Any], worlds: Any, tmp_path: Path
) -> None:
    """Actions in the rows of the worlds for Stable-Baselines3 are the inputs of the policy; files are the models."""
    env = worlds(problem, 4)
    env.seed(0)
    model = getattr(sb3, name)("MlpPolicy", env, seed=0, device="cpu", **options)
    model.learn(32)
    policy = cg.as_policy(model, problem)
    rows = env.reset()
    actions, _ = model.predict(rows, deterministic=True)
    joint = env.view.joint_actions(actions)[0]
    start = [np.array(agent.initial_low) for agent in problem.agents]
    q = problem.automaton.initial
    theirs = [0.5 * (a.input_low + a.input_high) + joint[c] * a.input_box.half_width
              for a, c in zip(problem.agents, problem.input_columns, strict=True)]  # fmt: skip
    model.save(tmp_path / "model.zip")
    for each in (policy, cg.as_policy(model.policy, problem), cg.as_policy(tmp_path / "model.zip", problem)):
        ours = inputs_at(each, problem, start, _state_of(problem, q, start), 0)
        assert np.allclose(np.concatenate(ours), np.concatenate(theirs), atol=2e-5)
        if worlds is shared_vec_env:
            assert each.why_not_as_it_is == ""
            assert each.information == "own state, automaton state, time"
        else:
            assert "sees states of all agents" in each.why_not_certified


def _state_of(problem: cg.Problem, q: int, start: list[Any]) -> int:
    """Automaton state in which episodes begin: after the letter of the start."""
    env = cg.parallel_env(problem)
    _, infos = env.reset(seed=0)
    return int(infos[env.possible_agents[0]]["automaton_state"])


def test_observations_that_are_normalised_are_normalised_here(problem: cg.Problem) -> None:
    from stable_baselines3.common.vec_env import VecNormalize

    env = VecNormalize(shared_vec_env(problem, 4))
    model = sb3.PPO("MlpPolicy", env, n_steps=8, batch_size=16, seed=0, device="cpu")
    model.learn(64)
    policy = cg.as_policy(model, problem)
    assert "VecNormalize" in policy.why_not_as_it_is
    rows = shared_vec_env(problem, 1)
    rows.seed(0)
    seen = rows.reset()
    wanted, _ = model.predict(env.normalize_obs(seen), deterministic=True)
    start = [np.array(agent.initial_low) for agent in problem.agents]
    ours = inputs_at(policy, problem, start, _state_of(problem, 0, start), 0)
    theirs = [0.5 * (a.input_low + a.input_high) + w * a.input_box.half_width
              for a, w in zip(problem.agents, wanted, strict=True)]  # fmt: skip
    assert np.allclose(np.concatenate(ours), np.concatenate(theirs), atol=1e-5)


def seeker(network: Network) -> Any:
    """A network as a module of torch."""
    layers: list[Any] = []
    for weight, bias in zip(network.weights, network.biases, strict=True):
        linear = torch.nn.Linear(weight.shape[1], weight.shape[0])
        linear.load_state_dict({"weight": torch.as_tensor(weight), "bias": torch.as_tensor(bias)})
        layers += [linear, torch.nn.Tanh()]
    return torch.nn.Sequential(*layers[:-1])


def test_arrays_modules_and_files_are_the_same_policy(problem: cg.Problem, tmp_path: Path) -> None:
    network = proportional(problem).network
    pairs = [(w.T, b) for w, b in zip(network.weights, network.biases, strict=True)]
    flax = {"params": {f"Dense_{k}": {"kernel": w, "bias": b} for k, (w, b) in enumerate(pairs)}}
    named = {"weights": network.weights, "biases": network.biases, "activation": "tanh"}
    torch.save(seeker(network), tmp_path / "a.pt")
    save_actor(SharedActor(problem, network), tmp_path / "a.npz")
    forms = [network, pairs, flax, named, seeker(network), tmp_path / "a.pt"]
    policies = [cg.as_policy(form, problem, "shared_vec_env") for form in forms]
    policies += [cg.as_policy(tmp_path / "a.npz", problem), load_actor(tmp_path / "a.npz", problem)]
    policies.append(cg.as_policy(f"{tmp_path / 'a.pt'}@shared_vec_env", problem))
    states, q = RNG.uniform(-4.0, 4.0, (1, 50)), np.zeros(50, dtype=int)
    expected = policies[-2].inputs(1, states, q, 2)
    for policy in policies:
        assert np.allclose(policy.inputs(1, states, q, 2), expected, atol=1e-6)
    assert {type(policy).__name__ for policy in policies[:-2]} == {"OwnModels"}


def test_what_cannot_be_certified_as_it_is_says_why(problem: cg.Problem) -> None:
    n = 1 + problem.automaton.n_states + 1
    strange = torch.nn.Sequential(torch.nn.Linear(n, 4), torch.nn.GELU(), torch.nn.Linear(4, 1))
    steep = torch.nn.Sequential(torch.nn.Linear(n, 4), torch.nn.ELU(2.0), torch.nn.Linear(4, 1))
    mixed = torch.nn.Sequential(*chain(n, 4), torch.nn.ReLU(), torch.nn.Linear(4, 1))
    double = chain(n, 1).double()
    for module, words in (
        (strange, "GELU"),
        (torch.nn.Sequential(torch.nn.Linear(n, 4), torch.nn.LayerNorm(4), *chain(4, 1)), "LayerNorm"),
        (steep, "alpha = 1"),
        (mixed, "one kind of activation"),
        (double, "float64"),
    ):
        policy = cg.as_policy(module, problem, "team_env")
        assert words in policy.why_not_as_it_is and words in repr(policy)
        assert cg.certify(problem, policy, 20).certificate.lower_bound >= 0.0  # wrapped
        with pytest.raises(ValueError, match=rf"as it is.*{words}.*measure it by rollouts.*`--wrap`"):
            cg.certify(problem, policy)
    torn = torch.nn.Sequential(torch.nn.Linear(n, 4), torch.nn.Tanh(), torch.nn.Linear(5, 1))
    with pytest.raises(ValueError, match="layers that fit together, got 4 outputs before 5 inputs"):
        cg.as_policy(torn, problem, "team_env")
    central = sb3.PPO("MlpPolicy", central_vec_env(problem, 2), device="cpu")
    for verb in (cg.certify, cg.improve):
        with pytest.raises(ValueError, match=r"sees states of all agents.*rollouts"):
            verb(problem, central, 20)
    with pytest.raises(ValueError, match="sees states of all agents"):
        cg.certify(problem, central, 20)


@pytest.mark.parametrize("kind", ["Sigmoid", "SiLU", "PReLU"])
def test_networks_with_other_activations_are_certified_along_their_run(kind: str, tmp_path: Path) -> None:
    """A module that was trained to steer, and its graph of ONNX: its run proves it, and cells refuse smooth ones."""
    one = reach(scalar_agent("a"))
    n = 1 + one.automaton.n_states + 1
    torch.manual_seed(1)
    act = getattr(torch.nn, kind)
    module = torch.nn.Sequential(torch.nn.Linear(n, 16), act(), torch.nn.Linear(16, 1))
    aim, learner = proportional(one), torch.optim.Adam(module.parameters(), 0.02)
    rng = np.random.default_rng(0)
    for _ in range(300):
        states, q = rng.uniform(-4.0, 4.0, (1, 64)), np.zeros(64, dtype=int)
        view = aim.agent_policy(0).view
        rows = torch.as_tensor(view.rows(one.agents[0].workspace, states, q, int(rng.integers(one.horizon))))
        box = one.agents[0].input_box
        wanted = 2.0 * (aim.inputs(0, states, q, 0).T - box.low) / (box.high - box.low) - 1.0
        loss = ((module(rows[:, :n]) - torch.as_tensor(wanted).float()) ** 2).mean()
        learner.zero_grad()
        loss.backward()
        learner.step()
    policy = cg.as_policy(module, one, "team_env")
    assert policy.why_not_as_it_is == ""
    found = cg.certify(one, policy, relation="path")
    assert "as they are, along" in found.certificate.proof.method
    assert cg.check(found.certificate)
    ran = cg.rollout(one, found.controller, 4000, seed=0)
    assert 0.5 < found.certificate.lower_bound <= ran.successes / 4000 + 0.04  # false alarm: below 1e-6 (Hoeffding)
    x = RNG.uniform(-4.0, 4.0, (1, 30))
    rows = torch.as_tensor(aim.agent_policy(0).view.rows(one.agents[0].workspace, x, np.zeros(30, dtype=int), 1)[:, :n])
    answers = box.low + 0.5 * (module(rows).clamp(-1.0, 1.0).detach().numpy() + 1.0) * (box.high - box.low)
    assert np.allclose(policy.inputs(0, x, np.zeros(30, dtype=int), 1).T, answers, atol=1e-5)
    if kind == "PReLU":  # made of relus, which have cells
        assert cg.check(cg.certify(one, policy, 20))
        return
    with pytest.raises(ValueError, match=r"on cells have tanh or relu, got .* along its trajectory"):
        cg.certify(one, policy, 20)
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    cg.save(policy, tmp_path / "p.onnx")
    back = cg.as_policy(tmp_path / "p.onnx", one)
    assert back.why_not_as_it_is == ""
    states, q = RNG.uniform(-4.0, 4.0, (1, 30)), np.zeros(30, dtype=int)
    assert np.allclose(back.inputs(0, states, q, 1), policy.inputs(0, states, q, 1), atol=1e-6)


class Wrong(Module):
    """Layers in the order of a chain that are used otherwise."""

    def __init__(self, n: int) -> None:
        super().__init__()
        self.actor = Shifted(chain(n, 1))


class Shifted(Sequential):
    def __init__(self, inner: Any) -> None:
        super().__init__(*inner)

    def forward(self, rows: Any) -> Any:
        return super().forward(rows) + 0.5


def test_layers_that_do_not_compute_the_answer_are_not_certified(problem: cg.Problem) -> None:
    """The layers look like a chain, and their module adds something: found by comparing both."""
    policy = cg.as_policy(Wrong(1 + problem.automaton.n_states + 1), problem, "team_env")
    assert "do not compute what it answers" in policy.why_not_as_it_is


def remembers(problem: cg.Problem) -> Any:
    """A stand-in for RecurrentPPO of sb3-contrib, which is not installed here: a policy with `lstm_actor`."""
    from stable_baselines3.common.policies import ActorCriticPolicy

    class Recurrent(ActorCriticPolicy):
        lstm_actor = None

        def predict(self, rows: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False) -> Any:
            total = rows[:, :1] if state is None or episode_start[0] else state + rows[:, :1]
            return np.clip(-total, -1.0, 1.0), total

    env = shared_vec_env(problem, 1)
    return Recurrent(env.observation_space, env.action_space, lambda _: 0.0)


def test_models_that_remember_are_judged_by_rollouts(problem: cg.Problem) -> None:
    policy = cg.as_policy(remembers(problem), problem)
    assert "remembers" in policy.why_not_certified and "what it remembers" in policy.information
    assert cg.rollout(problem, policy, 50).episodes == 50
    with pytest.raises(ValueError, match="remembers earlier observations"):
        cg.certify(problem, policy, 20)
    # Two steps of two worlds: what is remembered of one does not enter the other, and adds up.
    dynamics = Dynamics.of(problem)
    no = np.zeros(2, dtype=bool)
    worlds = Worlds((np.array([[[1.0, -2.0], [0.4, 0.0]]]),), np.zeros(2, dtype=np.int32), 0, no, no)
    batch = policy.batch(dynamics)
    first, memory = batch.act(worlds, batch.begin(worlds, np.random.default_rng(0)))
    second, _ = batch.act(worlds, memory)
    assert np.allclose(second[0][0, 1], np.maximum(2.0 * first[0][0, 1], -problem.agents[1].input_high))


class Intruder:
    """An object whose reading makes a folder."""

    def __init__(self, made: Path) -> None:
        self.made = made

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.mkdir, (self.made,)


@mostly_thorough("verb", ["compare", "certify", "record", "save-policy", "leaderboard", "plot"], first=5)
def test_files_run_no_code_unless_they_are_trusted(
    verb: str, problem: cg.Problem, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made, file = tmp_path / "made", str(tmp_path / "a.pt")
    torch.save(Intruder(made), file)
    asked = {
        "compare": ["--policies", file],
        "leaderboard": ["--add", f"mine={file}"],
        "plot": ["--beside", file],
    }.get(verb, ["--policy", file])
    words = [verb, *(["episode"] if verb == "plot" else []), "reach-avoid-v0", *asked]
    words += (
        [] if verb == "compare" else ["--out", str(tmp_path / {"plot": "a.png", "save-policy": "a.h"}.get(verb, "a"))]
    )
    assert main(words) == 2
    assert "runs code" in (said := capsys.readouterr()).err and "--trust" in said.err
    assert not made.exists()
    assert main([*words, "--trust"]) == 2  # a folder is no policy
    assert "may run code" in capsys.readouterr().err
    assert made.exists()


def test_every_kind_of_file_that_is_unpickled_may_be_refused(problem: cg.Problem, tmp_path: Path) -> None:
    sb3.PPO("MlpPolicy", shared_vec_env(problem, 2), n_steps=8, batch_size=16, device="cpu").save(tmp_path / "m.zip")
    torch.save(chain(4, 1), tmp_path / "m.pt")
    for name in ("m.zip", "m.pt"):
        with pytest.raises(ValueError, match="runs code"):
            cg.as_policy(tmp_path / name, problem, trust=False)


CC = shutil.which("cc")

MAIN = """
#include <stdio.h>
#include <string.h>
#include "ctl.h"
int main(void) {
    double x[8], u[8]; int agent, q, time, d, m, i; unsigned long long bits;
    while (scanf("%d %d %d %d %d", &agent, &q, &time, &d, &m) == 5) {
        for (i = 0; i < d; i++) { if (scanf("%llx", &bits) != 1) return 1; memcpy(&x[i], &bits, 8); }
        CALLS
        for (i = 0; i < m; i++) { memcpy(&bits, &u[i], 8); printf("%llx ", bits); }
        printf("\\n");
    }
    return 0;
}
"""


@pytest.mark.skipif(CC is None, reason="no C compiler")
@mostly_thorough("relation", ["exact", "linear"])
@mostly_thorough("make", [scalar_agent, cart])
def test_c_gives_the_same_inputs_to_the_last_bit(relation: str, make: Any, tmp_path: Path) -> None:
    """Certified tables as a C header, at points inside and outside, on edges of cells, and at what is no number."""
    if make is cart and relation == "exact":
        agents = [cart(B=[[0.5, 0.0], [0.0, 0.5]], input_low=[-2.0, -1.0], input_high=[2.0, 1.0])]
    else:
        agents = [scalar_agent("a"), scalar_agent("b")] if make is scalar_agent else [cart()]
    problem = reach(*agents, horizon=3)
    found = cg.synthesize(problem, 12, relation=relation)
    cg.save(found, tmp_path / "ctl.h")
    names = problem.agent_names
    calls = "\n".join(f"if (agent == {i}) ctl_{name}_act(x, q, time, u);" for i, name in enumerate(names))
    (tmp_path / "main.c").write_text(MAIN.replace("CALLS", calls))
    command = [str(CC), "-O2", "-ffp-contract=off", "-Wall", "-Werror", "-o", "run", "main.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    lines, wanted = [], []
    for i, (agent, controller) in enumerate(zip(problem.agents, found.controller.agents, strict=True)):
        d, m = agent.n_states, agent.n_inputs
        low, high = agent.workspace.low, agent.workspace.high
        on_edges = np.stack([axis[RNG.integers(0, len(axis), 50)] for axis in controller.grid.edges], axis=1)
        anywhere = RNG.uniform(low - 1.0, high + 1.0, (300, d))
        points = np.concatenate([anywhere, [low, high, np.full(d, np.nan)], on_edges])
        for point in points:
            q, time = int(RNG.integers(problem.automaton.n_states)), int(RNG.integers(5))
            u, _ = controller.act(point[:, None, None], np.array([q]), time, None)
            lines.append(f"{i} {q} {time} {d} {m} " + " ".join(format(int(b), "x") for b in point.view(np.uint64)))
            wanted.append([format(int(b), "x") for b in np.ascontiguousarray(u[:, 0, 0]).view(np.uint64)])
    answer = subprocess.run(["./run"], cwd=tmp_path, input="\n".join(lines), text=True, capture_output=True, check=True)
    assert [line.split() for line in answer.stdout.splitlines()] == wanted


def test_networks_go_out_and_come_back_as_onnx(problem: cg.Problem, tmp_path: Path) -> None:
    """What is written is read back as the same network, so that it can be certified again."""
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    n = 1 + problem.automaton.n_states + 1
    states, q = RNG.uniform(-4.0, 4.0, (1, 30)), np.zeros(30, dtype=int)
    sources = [
        proportional(problem),
        cg.as_policy(chain(n, 1), problem, "parallel_env"),
        cg.as_policy(chain(n, 1), problem, "team_env"),
        cg.certify(problem, cg.as_policy(chain(n, 1), problem, "parallel_env"), 20),
    ]
    for source in sources:
        agent = "a" if source is sources[3] else None
        cg.save(source, tmp_path / "p.onnx", agent=agent)
        back = cg.as_policy(tmp_path / "p.onnx", problem)
        assert back.why_not_as_it_is == ""
        policy = getattr(source, "controller", source)
        if hasattr(policy, "inputs"):
            assert np.allclose(back.inputs(0, states, q, 1), policy.inputs(0, states, q, 1), atol=1e-6)
    # A graph of another origin, which nobody has named.
    module = torch.nn.Sequential(*chain(n, 1), torch.nn.Tanh())
    network = Network(
        tuple(module[k].weight.detach().numpy() for k in (0, 2)),
        tuple(module[k].bias.detach().numpy() for k in (0, 2)), "tanh", True,
    )  # fmt: skip
    from certigym.synthesis.interop.onnx_files import written

    (tmp_path / "o.onnx").write_bytes(written(network, {}))
    graph = __import__("onnx").load(tmp_path / "o.onnx")
    del graph.metadata_props[:]
    (tmp_path / "o.onnx").write_bytes(graph.SerializeToString())
    with pytest.raises(ValueError, match=r"expected the environment"):
        cg.as_policy(tmp_path / "o.onnx", problem)
    again = cg.as_policy(f"{tmp_path / 'o.onnx'}@team_env", problem)
    same = cg.as_policy(module, problem, "team_env")
    assert np.allclose(again.inputs(0, states, q, 1), same.inputs(0, states, q, 1), atol=1e-6)
