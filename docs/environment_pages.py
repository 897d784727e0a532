"""Write the pages of the environments: `python docs/environment_pages.py`.

Everything on a page comes from the problem itself, from its module's docstring (the story and the versions) or from
`environments/measured.json` (see `measure_environments.py`), so a page cannot say what the code does not do; a test
writes all pages again and compares.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from inspect import cleandoc, signature
from pathlib import Path
from typing import Any

import numpy as np

import certigym as cg
from certigym.envs.interfaces import edges
from certigym.envs.interfaces.automaton_drawing import svg
from certigym.envs.suite import made_by, tier_of_id
from certigym.envs.suite.ids import MODULES, gymnasium_id
from certigym.envs.systems.agents import AnyAgent, LinearAgent
from certigym.envs.systems.arguments import counted
from certigym.envs.tasks.regions import Pair
from certigym.synthesis.certificates.proofs.digits import shown_bound

FOLDER = Path(__file__).parent / "environments"
MEASURED = FOLDER / "measured.json"
OPTIONS = (
    ("initial_state", "the problem's", "start of all agents, a point; or a box `initial_low`, `initial_high`"),
    ("disturbance_scale", "1", "factor on the standard deviations of the noise"),
    ("render_mode", "None", '"ansi", "rgb_array" or "human"'),
    (
        "observation",
        '"local"',
        'PettingZoo only; "full": the states of the other agents too; "relative": where they are from the own place',
    ),
    (
        "reward",
        '"sparse"',
        '"shaped": potential-based, the same policies are optimal; "progress": pays good failures more',
    ),
    ("discount", "1", "of the learner, for the shaped reward"),
    ("preset", "None", '"learner": `scale="unit"`, `dtype="float32"`, `actions="unit"`, but for what is given'),
    ("scale", '"raw"; `team_env` "unit"', '"unit": workspaces mapped to [-1, 1], states outside count as their edges'),
    ("automaton", '"one-hot"', 'how its state is seen; "number" or "hidden"'),
    ("neighbours", "None", 'PettingZoo and `team_env`, with observation "neighbours": how many others are seen'),
    ("sensor_noise", "0", "standard deviation of the errors with which states are read"),
    ("disturbance", '"zero"', 'what bounded disturbances do: "zero", "random", "periodic", "greedy", or a function'),
    ("dtype", '"float64"', 'of observations; or "float32"'),
    ("actions", '"input"; Gymnasium "unit"', '"input": the input box; "unit": scaled to [-1, 1], float32'),
    ("infos", '"numbers"', '"words": also the names of the propositions that hold (`letter`)'),
    ("credit", '"team"', 'batches only: with "own", `own_rewards` (n, M) says what every agent has earned itself'),
    ("spread", "0", "batches only: share of the episodes that begin anywhere, for learners"),
)
_DELIVERY = (
    "Carrying is lost when one robot crosses the edge of a band alone, so all four have to learn the same step at "
    "once, and exploring robots hardly ever cross together. One robot alone learns its delivery "
    "([.997](package-delivery-single-v0.md))."
)
WHY_NOT = {
    "corridor-v0": "it stays at 0 within a minute, also with a central critic: both robots are paid for going ahead, "
    "meet in the corridor, and the one that would have to wait first has to unlearn what it was paid for. If they may "
    "meet, or if there are no walls, every episode succeeds within 40 seconds; four times the time, or one learner for "
    "both, changes nothing (tested).",
    "cyclic-delivery-v0": "it stays at 0: a load counts only if all four robots pick it up at the same time, and one "
    "robot that strays makes all begin again.",
    "invariance-b-100-v0": "a hundred agents that share one policy fail together as soon as one of them leaves, so an "
    "episode hardly ever shows that a step was better than another.",
    "package-delivery-kinematic-v0": f"it stays at 0. {_DELIVERY}",
    "package-delivery-v0": f"it stays at 0. {_DELIVERY}",
    "package-delivery-eased-v0": "trainings of 400,000 and 900,000 world steps stayed at 0. " + _DELIVERY,
}
"""Why the learner without help misses .8 of the certified share, where it does."""

HARD: dict[str, str] = {
    "courier-v0": "the mission is long: one of two customers is learned by PPO without help in 40 seconds, one of "
    "four is not, also without the pond, in a given order, or with four times the time "
    "(tested).",
    "needle-v0": "a learner that keeps noise in its actions hardly ever passes all three gates, and so sees little "
    "of the last one. More steps help, which was tested: PPO without help came to .02 after 175,000 world steps "
    "and to .34 after 357,000, one seed each.",
    "fleet-6-v0": "all six have to be in their places at the same time: two vehicles learn to pass one another in "
    "40 seconds, and six stay at 0 even if they may meet (tested).",
    "swarm-8-v0": "this is not known. It was said to be the agreement on one sense of going around, but robots "
    "that may meet, and two in place of eight, stay at 0 within 40 seconds, too "
    "(tested).",
    "rendezvous-3-v0": "three followers keep within reach of a leader that they do not see: PPO comes to .90 and "
    ".9999 with two seeds if they need not, and stays at 0 if they need not keep apart "
    "(tested).",
    "invariance-b-50-v0": "the task is lost by whoever leaves first of fifty, so the return says little of what "
    "one agent did. The number is what counts, which was tested: with 20 agents PPO comes to .999, with 100 to "
    ".002.",
    "reach-avoid-20-rough-v0": "twenty agents have to succeed together, which takes time and nothing else: PPO "
    "comes to .72 after 103,000 world steps and to .81 after four times as long "
    "(tested); on the leaderboard it had 29,184.",
    "car-park-rough-v0": "what is left is where a step of bad luck costs least, which takes time: PPO comes to .74 "
    "in 40 seconds and to .77 in four times as long, and another reward changes nothing "
    "(tested).",
}
"""What is hard about problems that were made to tell learners apart, and whether an experiment has tested that."""

DOMAINS = {
    "robots": (
        "Robots that share a floor",
        "They meet, pass doors, keep watch and stay out of each other's way.",
        "corridor courier door-formation meeting needle patrol-recharge patrol-robot rendezvous rendezvous-3 "
        "swarm swarm-8",
    ),
    "deliveries": (
        "Deliveries",
        "Loads are picked up together and delivered together, through corridors and wind.",
        "package-delivery-single package-delivery package-delivery-eased package-delivery-kinematic cyclic-delivery "
        "windy-delivery",
    ),
    "vehicles": (
        "Vehicles",
        "Cars that park and turn, platoons, a fleet on a circle, a quadrotor: most of them cannot move sideways.",
        "car-park car-park-planar car-park-rough car-slalom dubins-team fleet fleet-6 platoon "
        "platoon-distance quadrotor",
    ),
    "plants": (
        "Buildings and oscillators",
        "Temperatures, circuits and chains of integrators that have to stay within their bounds.",
        "building-automation room-network van-der-pol integrator-chain",
    ),
    "scaling": (
        "Benchmarks that scale",
        "Simple agents, up to a hundred of them: the size is what is hard.",
        "reach-avoid reach-avoid-planar reach-avoid-kinematic reach-avoid-n reach-avoid-20 "
        "reach-avoid-20-rough invariance invariance-4 "
        "invariance-20 invariance-b-20 invariance-b-50 invariance-b-100 decoupled-chain decoupled-chain-14",
    ),
}
"""Environments by domain: title, sentence, ids without their versions, in the order in which they are read."""

TIERS = {
    "solved": ("Solved", "A learner without help comes as far as is known to be possible."),
    "open": (
        "Open",
        "A learner without help comes half of the way or more, and not as far as is known to be possible.",
    ),
    "hard": ("Hard", "No learner without help comes half of the way to what is known to be possible."),
    "unrated": ("Unrated", "No learner was judged on these problems so far."),
}
"""Tiers: title, and what is left to learn on their problems."""

USE = """```python
import certigym as cg

# PettingZoo; also `cg.aec_env`
env = cg.parallel_env("meeting-v0", render_mode="rgb_array")
# Gymnasium: one learner moves all agents
env = cg.central_env("meeting-v0", reward="shaped")
# Gymnasium, in one batch
envs = cg.vector_env("meeting-v0", 1000, autoreset_mode="SameStep")
# or a `cg.Problem`: all three take an id, a file or a problem
env = cg.parallel_env("my-task.toml")
```

Ids are registered with PettingZoo and Gymnasium when `certigym` is imported. Pictures need the extra `viz`
(in a checkout `pip install -e ".[viz]"`), windows pygame.
`certigym plot episode meeting-v0 --cells 64 --out meeting.gif` shows an episode under certified controllers.
"""


def pages() -> dict[str, str]:
    """Return the text of every file of the folder but the measured numbers."""
    measured = json.loads(MEASURED.read_text(encoding="utf-8")) if MEASURED.exists() else {}
    result = {"README.md": _index(measured)}
    result |= {f"{domain}.md": _domain(domain, measured) for domain in DOMAINS}
    result |= {f"{tier}.md": _tier(tier, measured) for tier in TIERS}
    for id in cg.problem_ids():
        problem = cg.make_problem(id)
        drawn = edges(problem)
        result[f"{id}.svg"] = svg(problem.automaton, drawn)
        result[f"{id}.md"] = _page(id, problem, measured.get(id))
    return result


def _page(id: str, problem: cg.Problem, measured: dict[str, Any] | None) -> str:
    name, about, story, versions = _docstring(id)
    return "\n\n".join(
        [
            f"# {name}",
            f"*{about}.*",
            *([f"![One episode under certified controllers]({id}.gif)"] if (FOLDER / f"{id}.gif").exists() else []),
            _summary(id, problem),
            *([story] if story else []),
            "## Dynamics",
            _law(problem) + "The workspace is closed; an agent that leaves it violates the task.",
            _dynamics(problem),
            "## Regions",
            _regions(problem),
            "## Task",
            _task(problem),
            _automaton(id, problem),
            "## Rewards",
            "1 to every agent when the task is satisfied, once, and 0 otherwise: the undiscounted return is "
            'satisfaction, and its mean the satisfaction probability. With `reward="shaped"` differences of a '
            "potential between 0 and 1 are added, so that rewards lie in [-1, 2]; "
            '`reward="progress"` adds those of a level that is kept at the end, and takes 1 for a lost task.',
            "## Start",
            _start(problem),
            "## Episode ends",
            _ends(problem),
            "## Arguments",
            _arguments(id),
            "## Certified bound and measured rate",
            _numbers(problem, measured),
            *_learners(id),
            "## Versions",
            versions,
            "*Written by `python docs/environment_pages.py`; change the code, not this page.*\n",
        ]
    )


def _learners(id: str) -> list[str]:
    """What learners reach without help and with it, if that was measured."""
    alone, helped = (_table(name).get(id) for name in ("learners", "probes"))
    lines = [f"- Tier: **{tier_of_id(id)}**, by the rule of the [leaderboard](../leaderboard.md)."]
    if id in HARD:
        lines.append(f"- Why it is hard: {HARD[id]}")
    if alone is not None:
        lines.append(
            f"- Without help (`certigym train {id}`): success {alone['ppo']:.4f} of 20,000 episodes after "
            f"{alone['steps']:,} world steps ({alone['seconds']} s), where the certified controllers reach "
            f"{alone['certified']:.4f}."
        )
    lines += _minute(id)
    if id in WHY_NOT:
        lines.append(f"- Why PPO without help misses it: {WHY_NOT[id]}")
    if helped is not None:
        lines.append(
            f"- Started from the certified controllers (`certigym probe {id}`): {helped['learner']:.4f} against their "
            f"{helped['controllers']:.4f} on common random numbers; the gain {helped['gain']:+.4f} has the exact "
            f"99.9 % limits [{helped['gain_low']:+.4f}, {helped['gain_high']:+.4f}]."
        )
    return ["## Learners", "\n".join(lines)] if lines else []


def _minute(id: str) -> list[str]:
    """What learners of the leaderboard reach."""
    names = {
        "ppo": "PPO without help",
        "mappo": "MAPPO (central critic) without help",
        "warm-ppo": "PPO from a clone of the certified controllers",
        "shielded-ppo": "PPO behind the shield of the certificate",
        "sac": "SAC without help",
    }
    rows = {row["policy"]: row for row in _table("leaderboard")["rows"] if row["problem"] == id}
    rates = {
        policy: sum(row["successes"]) / (row["episodes"] * max(1, len(row["successes"])))
        for policy, row in rows.items()
    }
    told = [f"{name} {rates[policy]:.4f}" for policy, name in names.items() if policy in rates]
    if not told:
        return []
    return [f"- On the [leaderboard](../leaderboard.md), after a minute or two of training each: {', '.join(told)}."]


def _table(name: str) -> dict[str, Any]:
    """The numbers that `benchmarks/learners.py` or `benchmarks/probes.py` has written."""
    path = FOLDER.parent / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def _docstring(id: str) -> tuple[str, str, str, str]:
    """Name, sentence, story and versions in the docstring of a suite module, whose title is "Name: sentence."."""
    text = cleandoc(made_by(id)[1])
    title, _, rest = text.partition("\n")
    story, _, versions = rest.partition("**Versions**:")
    name, _, about = title.strip().rstrip(".").partition(": ")
    return name.split(" (")[0], about[:1].upper() + about[1:], story.strip(), versions.strip()


def _summary(id: str, problem: cg.Problem) -> str:
    env = cg.parallel_env(problem)
    names = env.possible_agents if problem.n_agents <= 8 else [*env.possible_agents[:3], "...", env.possible_agents[-1]]
    shapes = sorted({str(env.action_space(agent).shape) for agent in env.possible_agents})
    seen = sorted({str(env.observation_space(agent).shape) for agent in env.possible_agents})
    workspaces = _ranges([(a.state_low, a.state_high) for a in problem.agents])
    rows = [
        ("PettingZoo", f'`pettingzoo.make("parallel", "certigym/{id}")`'),
        ("Gymnasium", f'`gymnasium.make("{gymnasium_id(id)}")`'),
        ("Gymnasium, batched", f'`gymnasium.make_vec("{gymnasium_id(id)}", num_envs=64)`'),
        ("Import", f"`from certigym.envs import {MODULES[id]}`"),
        ("Problem", f'`certigym.make_problem("{id}")`'),
        ("Agents", ", ".join(f"`{name}`" if name != "..." else name for name in names)),
        ("Actions", "continuous; values beyond the box are clipped"),
        ("Action Shape", ", ".join(shapes)),
        ("Action Values", _ranges([(a.input_low, a.input_high) for a in problem.agents])),
        (
            "Observation Shape",
            f"{', '.join(seen)}: own state, {problem.automaton.n_states} automaton "
            "states one-hot, fraction of time left",
        ),
        (
            "Observation Values",
            f"any real numbers, states as they are: inside of the workspace {workspaces}, and, when an episode ends by "
            'leaving it, outside; then [0, 1]. With `scale="unit"` [-1, 1], states outside count as the edge',
        ),
        ("State Shape", f"{env.state_space.shape}: the states of all agents, then as above"),
        ("State Values", "as the observations"),
        ("Centralised", f"action {(sum(a.n_inputs for a in problem.agents),)} in [-1, 1], observation = state"),
    ]
    return "| | |\n|---|---|\n" + "\n".join(f"| {key} | {value} |" for key, value in rows)


def _ranges(boxes: list[tuple[np.ndarray, np.ndarray]]) -> str:
    return "; ".join(dict.fromkeys(_box(low, high) for low, high in boxes))


def _box(low: Any, high: Any) -> str:
    """A box as a product of intervals, equal ones as a power."""
    axes = [f"[{a:g}, {b:g}]" for a, b in zip(low, high)]
    if len(axes) > 1 and len(set(axes)) == 1:
        return f"{axes[0]}^{len(axes)}"
    return " x ".join(axes)


def _matrix(value: np.ndarray) -> str:
    rows = [", ".join(f"{number:.10g}" for number in row) for row in np.atleast_2d(value)]
    return "`[" + rows[0] + "]`" if value.ndim == 1 else "`[[" + "], [".join(rows) + "]]`"


def _covariance(value: np.ndarray) -> str:
    """Write a matrix, one of several components that is diagonal by its diagonal, or by its one number."""
    diagonal = np.diag(value)
    if len(value) == 1 or np.any(value != np.diag(diagonal)):
        return _matrix(value)
    if np.all(diagonal == diagonal[0]):
        return f"`{diagonal[0]:.10g} I`"
    return f"`diag({', '.join(f'{number:.10g}' for number in diagonal)})`"


def _intervals(names: Sequence[str], low: np.ndarray, high: np.ndarray) -> str:
    """Write the interval of each state or input, by its name."""
    return "<br>".join(f"`{name}` in [{a:g}, {b:g}]" for name, a, b in zip(names, low, high))


def _law(problem: cg.Problem) -> str:
    if all(isinstance(agent, LinearAgent) for agent in problem.agents):
        law = "`x' = A x + B u + c + w`, `w ~ N(0, Sigma)`"
    else:
        law = "`x' = f(x, u) + w` with the means below, `w ~ N(0, Sigma)`"
    return f"{law} independent over time and agents; Sigma is a covariance. "


def _written_dynamics(problem: cg.Problem) -> str:
    """Expressions of all agents, those that are equal up to the names of neighbours once."""
    groups: dict[Any, list[cg.Agent]] = {}
    for agent in problem.agents:
        assert isinstance(agent, cg.Agent)
        groups.setdefault(agent.motion_key, []).append(agent)
    lines = ["| agents | mean one step later | Sigma | workspace | inputs |", "|---|---|---|---|---|"]
    notes = []
    for agents in groups.values():
        agent = agents[0]
        means = "<br>".join(f"`{x}' = {text}`" for x, text in zip(agent.states, agent.dynamics))
        boxes = (
            _intervals(agent.states, agent.state_low, agent.state_high),
            _intervals(agent.inputs, agent.input_low, agent.input_high),
        )
        sigma = _covariance(agent.noise_covariance)
        lines.append(f"| {_names([a.name for a in agents])} | {means} | {sigma} | {boxes[0]} | {boxes[1]} |")
        ranges = [f"`{name}` in [{low:g}, {high:g}]" for name, (low, high) in agent.disturbances.items()]
        notes += [f"Bounded, and otherwise unknown: {', '.join(ranges)}."] if ranges else []
        told = [f"`{name}`" for name in agent.communicated]
        notes += [f"`{agent.name}` is told the states of {' and '.join(told)} before it acts."] if told else []
    return "\n".join(lines) + "".join(f"\n\n{note}" for note in dict.fromkeys(notes))


def _dynamics(problem: cg.Problem) -> str:
    if any(isinstance(agent, cg.Agent) for agent in problem.agents):
        return _written_dynamics(problem)
    groups: dict[str, list[LinearAgent]] = {}
    for agent in problem.agents:
        assert isinstance(agent, LinearAgent)
        data = {key: value for key, value in agent.to_dict().items() if key != "name" and "initial" not in key}
        groups.setdefault(json.dumps(data), []).append(agent)
    lines = ["| agents | A | B | c | Sigma | workspace | inputs |", "|---|---|---|---|---|---|---|"]
    for agents in groups.values():
        agent = agents[0]
        cells = [
            _names([a.name for a in agents]),
            _matrix(agent.A),
            _matrix(agent.B),
            _matrix(agent.offset),
            _covariance(agent.noise_covariance),
            _box(agent.state_low, agent.state_high),
            _box(agent.input_low, agent.input_high),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    outputs = [a for agents in groups.values() for a in agents if not a.has_identity_output]
    lines += [f"\nOutput of `{a.name}`: `y = C x`, C = {_matrix(a.output_matrix)}." for a in outputs]
    return "\n".join(lines)


def _names(names: list[str]) -> str:
    shown = names if len(names) <= 8 else [*names[:2], "...", names[-1]]
    return ", ".join(name if name == "..." else f"`{name}`" for name in shown)


def _of_pair(pair: Pair) -> str:
    if pair.distance is not None or pair.moves:
        return pair.text
    return "difference in " + " x ".join(f"[{low:g}, {high:g})" for low, high in zip(pair.low, pair.high))


def _regions(problem: cg.Problem) -> str:
    if not problem.declared:
        return "None."
    lines = ["| proposition | agent | box |", "|---|---|---|"]
    for name, proposition in problem.declared.items():
        members = problem.families.get(name)
        label = f"`{name}`" if members is None else f"`{name}`: {_names(list(members))}"
        first = problem.propositions[name if members is None else members[0]]
        if isinstance(proposition, Pair):
            agents = proposition.agents if isinstance(proposition.agents, str) else " less ".join(proposition.agents)
            which = f"pairs of `{agents}`" if isinstance(proposition.agents, str) else f"`{agents}`"
            which += ", next to each other" if proposition.pairs == "neighbours" else ""
            lines.append(f"| {label} | {which} | {_of_pair(proposition)} |")
            continue
        if proposition.moves:
            lines.append(f"| {label} | `{proposition.agent}` | {proposition.text} |")
            continue
        owner = problem.agents[problem.agent_names.index(first.agent)]
        lines.append(f"| {label} | `{proposition.agent}` | {_region(proposition.low, proposition.high, owner)} |")
    return "\n".join(lines) + "\n\nA region holds its lower faces, and its upper ones at the edge of the workspace."


def _region(low: np.ndarray, high: np.ndarray, agent: AnyAgent) -> str:
    axes = []
    for k, (a, b) in enumerate(zip(low, high)):
        closed = agent.has_identity_output and b >= agent.state_high[k]
        axes.append(f"[{a:g}, {b:g}{']' if closed else ')'}")
    return " x ".join(axes)


def _task(problem: cg.Problem) -> str:
    semantics = {
        "co-safe": "satisfied as soon as the automaton accepts, within the horizon",
        "finite-trace": "judged by the state of the automaton at the horizon",
    }[problem.automaton.semantics]
    formula = problem.specification.formula
    task = f"`{formula}`" if formula else "An automaton given by hand"
    return f"{task}; {problem.automaton.semantics}: {semantics}. Horizon {problem.horizon} control steps."


def _automaton(id: str, problem: cg.Problem) -> str:
    automaton = problem.automaton
    drawn = edges(problem)
    kinds = {q: [] for q in range(automaton.n_states)}  # type: dict[int, list[str]]
    kinds[automaton.initial].append("initial")
    for q in range(automaton.n_states):
        kinds[q] += ["accepting"] * bool(automaton.accepting[q]) + ["no way to acceptance"] * bool(automaton.dead[q])
    lines = ["| | state | letter | next |", "|---|---|---|---|"]
    for number, edge in enumerate(drawn, 1):
        name = automaton.state_names[edge.source]
        kind = f" ({', '.join(kinds[edge.source])})" if kinds[edge.source] else ""
        guard = edge.guard
        if guard != "otherwise":
            guard = " or ".join(cube if cube.endswith(" more") else f"`{cube}`" for cube in guard.split(" or "))
        lines.append(f"| {number} | {name}{kind} | {guard} | {automaton.state_names[edge.target]} |")
    first = problem.initial_q
    begin = "" if first is None else f" The letter of the start leads to {automaton.state_names[first]}."
    return (
        f"![The task automaton: {automaton.n_states} states]({id}.svg)\n\n"
        + "\n".join(lines)
        + f"\n\nThe first letter read is that of the start.{begin} Letters that no point of the workspace has are left "
        "out."
    )


def _start(problem: cg.Problem) -> str:
    groups: dict[str, list[str]] = {}
    for agent in problem.agents:
        start = agent.initial
        if start.is_point:
            text = f"({', '.join(f'{v:g}' for v in start.low)})"
        else:
            axes = (f"[{a:g}, {b:g})" if a < b else f"{{{a:g}}}" for a, b in zip(start.low, start.high))
            text = f"uniform in {' x '.join(axes)}"
        groups.setdefault(text, []).append(agent.name)
    return "; ".join(f"{_names(names)}: {text}" for text, names in groups.items()) + "."


def _ends(problem: cg.Problem) -> str:
    automaton = problem.automaton
    ends = []
    if automaton.semantics == "co-safe":
        ends.append("the task is satisfied: terminated;")
    ends.append("an agent leaves its workspace: terminated, also where another one completes the task in that step;")
    dead = [name for q, name in enumerate(automaton.state_names) if automaton.dead[q]]
    if dead:
        ends.append(f"the automaton reaches {' or '.join(dead)}, from where it can accept no more: terminated;")
    judged = ", where the task is judged" if automaton.semantics == "finite-trace" else ""
    ends.append(f"the horizon, {problem.horizon} steps{judged}: truncated.")
    return "\n".join(f"{number}. {text}" for number, text in enumerate(ends, 1))


def _arguments(id: str) -> str:
    make, _ = made_by(id)
    rows = [(name, json.dumps(p.default), "of the problem") for name, p in signature(make).parameters.items()]
    own = f"{_rows_of(rows)}\n\nBesides, all" if rows else "All"
    return f"{own} [arguments of environments](README.md#arguments)."


def _rows_of(rows: Sequence[tuple[str, str, str]]) -> str:
    lines = ["| argument | default | |", "|---|---|---|"]
    return "\n".join([*lines, *(f"| `{name}` | {default} | {text} |" for name, default, text in rows)])


def _numbers(problem: cg.Problem, measured: dict[str, Any] | None) -> str:
    if measured is None:
        return "Not measured yet."
    lines = []
    certificate = measured["certificate"]
    if certificate is None:
        lines.append(f"- No certificate yet: {measured['reason']}")
    elif certificate["lower_bound"] < 1e-12:
        lines.append("- Certified: nothing worth the name yet; the policies found satisfy the task with P < 1e-12.")
    else:
        start = {"point": "from the start", "mean": "on average over the start box"}[certificate["start"]]
        lines.append(
            f"- Certified: **{shown_bound(certificate['lower_bound'], certificate['gap'])}** {start} "
            f"({certificate['method']}; {certificate['bound']} bound; {_cells(certificate['cells']) or 'no'} cells)."
        )
        lines.append(
            f"- Measured under the certified controllers: {_rate(certificate['rollouts'])}: {verdict(certificate)}."
        )
        lines.append(
            f"- Synthesis took {_number(certificate['seconds'])} CPU seconds, the process {certificate['mebibytes']} "
            f"MiB{_at_most(certificate['abstract_upper_bound'])}."
        )
    lines.append(f"- Measured under inputs drawn uniformly: {_rate(measured['random'])}.")
    lines.append("\nNumbers of `python docs/measure_environments.py`; the horizon and the start are the defaults.")
    return "\n".join(lines)


def _at_most(bound: float | None) -> str:
    """What is known from above; nothing is under mean boxes."""
    return "" if bound is None else f"; no policy on these finite models does better than {_up(bound)}"


def _cells(shapes: list[list[int]]) -> str:
    """Cells per axis of all agents, such as `150 x 60`."""
    return ", ".join(" x ".join(map(str, shape)) for shape in shapes)


def _number(value: float) -> str:
    """Two digits of a small number, all of a large one."""
    return f"{value:.0f}" if value >= 9.95 else f"{value:.1f}"


def _up(value: float) -> str:
    """A probability, rounded up."""
    return f"{min(1.0, np.ceil(value * 1e4) / 1e4):.4f}"


def verdict(certificate: dict[str, Any]) -> str:
    """What the rollouts say of the bound, at their confidence."""
    rollouts, bound, gap = certificate["rollouts"], certificate["lower_bound"], certificate["gap"]
    if rollouts["high"] < bound or (certificate["exact"] and rollouts["low"] > bound + gap):
        return "refuted"
    if bound <= 0.0:
        return "vacuous"
    return "confirmed" if rollouts["low"] >= bound else "consistent"


def _rate(rollouts: dict[str, Any]) -> str:
    return (
        f"{rollouts['successes']} of {rollouts['episodes']} episodes (seed {rollouts['seed']}), "
        f"{100 * rollouts['confidence']:g} % limits [{rollouts['low']:.5f}, {rollouts['high']:.5f}]"
    )


def _index(measured: dict[str, Any]) -> str:
    lines = [
        "# Gallery\n",
        "One page for every problem of the suite. All are cooperative, with noise and a temporal-logic task; agents "
        "are linear, or move as expressions say. Each picture is some episodes under the controllers that `certigym "
        "run` finds when it is given the id alone; its page has a film of one of them.\n",
        PALETTE,
        "## Cards\n",
        *_cards([id for domain in DOMAINS for id in members(domain)], measured),
        "\n## Use\n",
        USE,
        "## Arguments\n",
        "Every environment takes these, and its page says which ones it has besides.\n",
        f"{_rows_of(OPTIONS)}\n",
    ]
    lines += ["## Measured\n", MEASURED_WITH, *_measured_rows(measured)]
    return "\n".join(lines) + "\n\n*Written by `python docs/environment_pages.py`.*\n"


PALETTE = """In every picture of the package **green** with rising lines is what has to be reached, **vermilion** with
crosses what has to be avoided, **blue** with level lines what has to be kept, and **yellow** with upright lines what is
one at some times and another at others: the task automaton says which. Agents have colours of their own. Episodes begin
at a ring, and end at a dot, or at an arrow where agents have a heading; one that fails ends in a cross.
"""


def members(domain: str) -> list[str]:
    """Return the ids of a domain."""
    return [f"{name}-v0" for name in DOMAINS[domain][2].split()]


def _domain(domain: str, measured: dict[str, Any]) -> str:
    """Return the page of a domain: its cards, and below them in the sidebar the pages of its environments."""
    title, about, _ = DOMAINS[domain]
    tree = "\n".join(members(domain))
    lines = [f"# {title}\n", f"{about}\n", "## Cards\n", *_cards(members(domain), measured)]
    lines += [f"\n```{{toctree}}\n:hidden:\n\n{tree}\n```\n", "*Written by `python docs/environment_pages.py`.*\n"]
    return "\n".join(lines)


def _tier(tier: str, measured: dict[str, Any]) -> str:
    """Return the page of a tier: what it means, and its cards."""
    title, about = TIERS[tier]
    ids = [id for domain in DOMAINS for id in members(domain) if tier_of_id(id) == tier]
    rule = "By the rule of the [leaderboard](../leaderboard.md), which has the numbers."
    lines = [f"# {title}\n", f"{about} {rule}\n", "## Cards\n", *_cards(ids, measured)]
    return "\n".join([*lines, "\n*Written by `python docs/environment_pages.py`.*\n"])


def _cards(ids: list[str], measured: dict[str, Any]) -> list[str]:
    """Return a table with a card for each environment: the style sheet lays it out, a script filters it."""
    lines = ["| | |\n|---|---|"]
    for id in ids:
        problem = cg.make_problem(id)
        certificate = (measured.get(id) or {}).get("certificate")
        bound = "none yet" if certificate is None else f"{np.floor(certificate['lower_bound'] * 1e4) / 1e4:.4f}"
        name, about, *_ = _docstring(id)
        linear = all(isinstance(agent, LinearAgent) for agent in problem.agents)
        facts = [
            counted(problem.n_agents, "agent"),
            f"{counted(max(agent.n_states for agent in problem.agents), 'state')} each",
            "linear" if linear else "nonlinear",
            counted(problem.horizon, "step"),
            tier_of_id(id),
            f"certified {bound}",
        ]
        picture = f"[![{name}]({id}.png)]({id}.md)"
        lines.append(f"| {picture} | **[{name}]({id}.md)**<br>{about}.<br>{' · '.join(facts)} |")
    return lines


MEASURED_WITH = """Certified lower bounds against rollouts of the same controllers from the same start: estimate and
99.9 % limits of `python docs/measure_environments.py`. `confirmed`: the lower limit is not below the bound;
`consistent`: the bound lies between the limits (as those that are *exact*, equal to the probability up to 1e-6, have
to). Cells are those per axis of one agent, seconds those of one thread for the synthesis, memory is the peak of the
process. "Of these models at most" bounds what any policy of the finite models attains; one of the continuous system may
attain more.

| id | T | certified | of these models at most | rollouts | limits | verdict | cells | rank | seconds | MiB |
|---|---|---|---|---|---|---|---|---|---|---|"""


def _measured_rows(measured: dict[str, Any]) -> list[str]:
    """One row per problem; the optimum is that of the finite models, no bound for the continuous system."""
    rows = []
    for id in cg.problem_ids():
        entry, problem = measured.get(id) or {}, cg.make_problem(id)
        certificate = entry.get("certificate")
        if certificate is None:
            rows.append(f"| [{id}]({id}.md) | {problem.horizon} | none | | | | | | | | |")
            continue
        rollouts = certificate["rollouts"]
        bound = f"{np.floor(certificate['lower_bound'] * 1e5) / 1e5:.5f}" + (" exact" if certificate["exact"] else "")
        cells = [
            f"{rollouts['successes'] / rollouts['episodes']:.5f}",
            f"[{rollouts['low']:.5f}, {rollouts['high']:.5f}]",
            verdict(certificate),
            _cells(certificate["cells"]) or "-",
            str(certificate["rank"]),
            _number(certificate["seconds"]),
            str(certificate["mebibytes"]),
        ]
        best = "" if certificate["abstract_upper_bound"] is None else _up(certificate["abstract_upper_bound"])
        rows.append(f"| [{id}]({id}.md) | {problem.horizon} | {bound} | {best} | {' | '.join(cells)} |")
    return rows


def main() -> None:
    """Write all pages."""
    FOLDER.mkdir(exist_ok=True)
    texts = pages()
    for name, text in texts.items():
        (FOLDER / name).write_text(text, encoding="utf-8")
    for path in FOLDER.iterdir():
        if path.name not in texts and path != MEASURED and path.stem not in cg.problem_ids():
            path.unlink()
    print(f"{len(texts)} files in {FOLDER}")


if __name__ == "__main__":
    main()
