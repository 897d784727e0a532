"""Write the pages of the environments: `python docs/environment_pages.py`.

Everything on a page comes from the problem itself, from its module's docstring (the story and the versions) or from
`defaults.json` (see `numbers_of_pages.py`), so a page cannot say what the code does not do; a test writes all pages
again and compares. Problems that differ from another one in a parameter are rows on its page.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from inspect import cleandoc, signature
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import certigym as cg
import numbers_of_pages as numbers
from certigym.envs.interfaces import edges
from certigym.envs.interfaces.automaton_drawing import svg
from certigym.envs.suite import made_by, tier_of_id
from certigym.envs.suite.ids import MODULES, gymnasium_id
from certigym.envs.systems.agents import AnyAgent, LinearAgent
from certigym.envs.systems.arguments import counted
from certigym.envs.tasks.regions import Pair

FOLDER = Path(__file__).parent / "environments"
OPTIONS = (
    ("initial_state", "the problem's", "start of all agents, a point; or a box `initial_low`, `initial_high`"),
    ("disturbance_scale", "1", "factor on the standard deviations of the noise"),
    ("render_mode", "None", '"ansi", "rgb_array" or "human"'),
    ("reward", '"sparse"', '"shaped", "progress"; `discount` of the learner, for the shaped one'),
    ("disturbance", '"zero"', '"random", "periodic", "greedy", or a function'),
    ("infos", '"numbers"', '"words": also the names of the propositions that hold (`letter`)'),
    ("credit", '"team"', 'batches only: with "own", `own_rewards` (n, M) says what every agent has earned itself'),
)
_DELIVERY = (
    "carrying is lost when one robot crosses the edge of a band alone, so all four have to learn the same time step at "
    "once. [One robot](package-delivery-single-v0.md) learns its delivery."
)
WHY_NOT = {
    "corridor-v0": "both robots are paid for going ahead and meet in the corridor; the one that has to wait must "
    "unlearn what it was paid for. Without walls, or if they may meet, they learn in 40 s; four times the time or "
    "a central critic changes nothing (tested).",
    "package-delivery-v0": _DELIVERY,
}
"""Why the learner without help misses .8 of the certified share, where it does."""

HARD: dict[str, str] = {
    "needle-v0": "a learner that keeps noise in its actions hardly ever passes all three gates. Three times the "
    "steps change nothing (tested).",
    "swarm-8-v0": "the reason is not known. Robots that may meet fail, too, and so do two in place of eight (tested).",
    "car-park-rough-v0": "what is left is where a step of bad luck costs least. Four times the time helps a little, "
    "another reward does not (tested).",
}
"""What is hard about problems that were made to tell learners apart, and whether an experiment has tested that."""

VARIANTS = {
    "car-park": "car-park-rough car-park-planar",
    "decoupled-chain": "decoupled-chain-14",
    "fleet": "fleet-6",
    "invariance": "invariance-4 invariance-20 invariance-b-20 invariance-b-50 invariance-b-100",
    "package-delivery": "package-delivery-eased package-delivery-kinematic",
    "platoon": "platoon-distance",
    "reach-avoid": "reach-avoid-kinematic",
    "reach-avoid-n": "reach-avoid-20 reach-avoid-20-rough",
    "rendezvous": "rendezvous-3",
    "swarm": "swarm-8",
}
"""Problems that are rows on the page of another one, without their versions."""

OTHER_SYSTEMS = (
    "car-park-planar-v0",
    "package-delivery-kinematic-v0",
    "platoon-distance-v0",
    "reach-avoid-kinematic-v0",
)
"""Variants with dynamics or regions of their own: their pages show these, and a film."""

MOST = 6
"""Regions and starts that a page lists if there are many; `certigym describe` prints all."""

LONG = 8
"""Transitions of an automaton up to which a page has the table; longer tables are files beside the page."""


def page_of_id(id: str) -> str:
    """Return the id whose page shows a problem.

    Examples
    --------
    >>> page_of_id("invariance-b-20-v0"), page_of_id("meeting-v0")
    ('invariance-v0', 'meeting-v0')
    """
    name = id.removesuffix("-v0")
    return next((f"{base}-v0" for base, rest in VARIANTS.items() if name in rest.split()), id)


def variants_of(id: str) -> list[str]:
    """Return the ids on the page of an id, itself first."""
    return [id, *(f"{name}-v0" for name in VARIANTS.get(id.removesuffix("-v0"), "").split())]


def filmed() -> list[str]:
    """Return the ids with a card, a film and an automaton of their own."""
    return [id for id in cg.problem_ids() if page_of_id(id) == id or id in OTHER_SYSTEMS]


DOMAINS = {
    "Robots": "corridor courier door-formation meeting needle patrol-recharge patrol-robot rendezvous swarm",
    "Deliveries": "package-delivery-single package-delivery cyclic-delivery windy-delivery",
    "Vehicles": "car-park car-slalom dubins-team fleet platoon quadrotor",
    "Plants": "building-automation room-network van-der-pol integrator-chain",
    "Scaling": "reach-avoid reach-avoid-planar reach-avoid-n invariance decoupled-chain",
}
"""Pages by domain: ids without their versions, in the order in which they are read."""

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
    """Return the text of every file of the folder but the pictures."""
    result = {"README.md": _index()}
    for id in cg.problem_ids():
        if page_of_id(id) != id:
            continue
        parts = {name: _sections(name) for name in variants_of(id)}
        result[f"{id}.md"] = _page(id, parts)
        for name, part in parts.items():
            if name in filmed():
                result[f"{name}.svg"] = part.drawing
                result |= {f"{name}.csv": part.transitions} if part.transitions else {}
    return result


class Sections(NamedTuple):
    """What a page says of one problem."""

    about: str
    dynamics: str
    regions: str
    task: str
    start: str
    drawing: str
    transitions: str


def _sections(id: str) -> Sections:
    problem = cg.make_problem(id)
    about = _docstring(id)[1]
    drawn = edges(problem)
    rows = _transitions(problem)
    task = f"{_task(problem)}\n\n{_automaton(id, problem, rows)}"
    texts = (about, _dynamics(problem), _regions(problem), task, _start(problem), svg(problem.automaton, drawn))
    return Sections(*texts, _as_csv(rows) if len(rows) > LONG else "")


def _page(id: str, parts: dict[str, Sections]) -> str:
    problem = cg.make_problem(id)
    name, about, story, versions = _docstring(id)
    base = parts[id]
    return "\n\n".join(
        [
            f"# {name}",
            f"*{about}.*",
            f"![One episode under certified controllers]({id}.gif)",
            *([story] if story else []),
            "## Certified bound and measured rate",
            _numbers(list(parts)),
            *_why(list(parts)),
            "## Spaces",
            _summary(id, problem),
            "## Dynamics",
            _law(problem),
            base.dynamics,
            "## Regions",
            base.regions,
            "## Task",
            base.task,
            f"Start: {base.start}",
            *_own_arguments(id),
            *(text for name in parts if name in OTHER_SYSTEMS for text in _variant(name, parts[name], base)),
            f"Observations, rewards, ends: [all environments](README.md#all-environments).{_more(versions)}\n",
        ]
    )


def _variant(id: str, part: Sections, base: Sections) -> list[str]:
    """What a variant with other dynamics or regions has of its own."""
    name, about, story, _ = _docstring(id)
    texts = [f"## {name}", f"*`{id}`: {about[:1].lower() if about[0] != '`' else about[0]}{about[1:]}.*"]
    texts += [f"![One episode under certified controllers]({id}.gif)", *([story] if story else [])]
    for own, of_base in zip(part[1:4], base[1:4], strict=True):
        texts += [own] if own.replace(id, "") != of_base.replace(page_of_id(id), "") else []
    return [*texts, f"Start: {part.start}"]


def _more(versions: str) -> str:
    """Return what the versions of a problem changed, if there are several."""
    return "" if versions == "v0: the first version." else f" {versions}"


def _why(ids: list[str]) -> list[str]:
    """Why learners without help fail, where that is known or was asked."""
    lines = [f"- `{id}` is hard for learners: {HARD[id]}" for id in ids if id in HARD]
    lines += [f"- PPO without help fails on `{id}`: {WHY_NOT[id]}" for id in ids if id in WHY_NOT]
    return ["\n".join(lines)] if lines else []


def _table(name: str) -> dict[str, Any]:
    """Return the numbers of a JSON file of the documentation."""
    return numbers.table(name)


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
    rows = [
        ("Ids", f"`certigym/{id}`, `{gymnasium_id(id)}`; module `certigym.envs.{MODULES[id]}`"),
        ("Agents", ", ".join(f"`{name}`" if name != "..." else name for name in names)),
        ("Action", f"{', '.join(shapes)} in {_ranges([(a.input_low, a.input_high) for a in problem.agents])}"),
        ("Observation", f"{', '.join(seen)}, {problem.automaton.n_states} automaton states"),
        ("State", f"{env.state_space.shape}"),
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
        return "`x' = A x + B u + c + w`, `w ~ N(0, Sigma)`."
    return "`x' = f(x, u) + w`, `w ~ N(0, Sigma)`."


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
    declared = dict(list(problem.declared.items())[: MOST if len(problem.declared) > 2 * MOST else None])
    for name, proposition in declared.items():
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
    more = len(problem.declared) - len(declared)
    return "\n".join(lines) + (f"\n\n{more} more: `certigym describe {problem.name}`." if more else "")


def _region(low: np.ndarray, high: np.ndarray, agent: AnyAgent) -> str:
    axes = []
    for k, (a, b) in enumerate(zip(low, high)):
        closed = agent.has_identity_output and b >= agent.state_high[k]
        axes.append(f"[{a:g}, {b:g}{']' if closed else ')'}")
    return " x ".join(axes)


def _task(problem: cg.Problem) -> str:
    semantics = {
        "co-safe": "co-safe: satisfied as soon as the automaton accepts",
        "finite-trace": "finite-trace: judged by the automaton state at the horizon",
    }[problem.automaton.semantics]
    formula = problem.specification.formula
    task = f"`{formula}`" if formula else "An automaton given by hand"
    return f"{task}; {semantics}."


def _transitions(problem: cg.Problem) -> list[tuple[str, str, str]]:
    """State with its kind, letter, next state of every transition."""
    automaton = problem.automaton
    kinds = {q: [] for q in range(automaton.n_states)}  # type: dict[int, list[str]]
    kinds[automaton.initial].append("initial")
    for q in range(automaton.n_states):
        kinds[q] += ["accepting"] * bool(automaton.accepting[q]) + ["no way to acceptance"] * bool(automaton.dead[q])
    rows = []
    for edge in edges(problem):
        kind = f" ({', '.join(kinds[edge.source])})" if kinds[edge.source] else ""
        guard = edge.guard
        if guard != "otherwise":
            guard = " or ".join(cube if cube.endswith(" more") else f"`{cube}`" for cube in guard.split(" or "))
        rows.append((automaton.state_names[edge.source] + kind, guard, automaton.state_names[edge.target]))
    return rows


def _automaton(id: str, problem: cg.Problem, rows: list[tuple[str, str, str]]) -> str:
    picture = f"![The task automaton: {problem.automaton.n_states} states]({id}.svg)\n\n"
    if len(rows) > LONG:
        return f"{picture}[All {len(rows)} transitions]({id}.csv)"
    lines = ["| | state | letter | next |", "|---|---|---|---|"]
    lines += [f"| {number} | {' | '.join(row)} |" for number, row in enumerate(rows, 1)]
    return picture + "\n".join(lines)


def _as_csv(rows: list[tuple[str, str, str]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["number", "state", "letter", "next"])
    writer.writerows([number, *(cell.replace("`", "") for cell in row)] for number, row in enumerate(rows, 1))
    return text.getvalue()


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
    starts = [f"{_names(names)}: {text}" for text, names in groups.items()]
    return "; ".join([*starts[:3], "...", starts[-1]] if len(starts) > MOST else starts) + "."


def _own_arguments(id: str) -> list[str]:
    """Arguments of this problem besides the horizon."""
    make, _ = made_by(id)
    rows = [
        f"`{name}` = {json.dumps(p.default)}" for name, p in signature(make).parameters.items() if name != "horizon"
    ]
    return [f"Arguments besides those of all environments: {', '.join(rows)}."] if rows else []


def _rows_of(rows: Sequence[tuple[str, str, str]]) -> str:
    lines = ["| argument | default | |", "|---|---|---|"]
    return "\n".join([*lines, *(f"| `{name}` | {default} | {text} |" for name, default, text in rows)])


def _numbers(ids: list[str]) -> str:
    kept = numbers.table("defaults")
    many = len(ids) > 1
    lines = [
        f"| {'id | ' if many else ''}agents | steps | proved | measured | any policy | random inputs | tier |",
        f"|{'---|' if many else ''}---|---|---|---|---|---|---|",
    ]
    for id in ids:
        problem, entry = cg.make_problem(id), kept[id]
        cells = [str(problem.n_agents), str(problem.horizon), f"**{numbers.proved(entry)}**", numbers.measured(entry)]
        cells += [numbers.at_most(entry), numbers.random_inputs(entry), tier_of_id(id)]
        lines.append(f"| {f'`{id}` | ' if many else ''}{' | '.join(cells)} |")
    notes = [f"`{id}`: {_docstring(id)[1]}." for id in ids[1:] if id not in OTHER_SYSTEMS]
    notes += ["Settings: [defaults](../defaults.md). Learners: [leaderboard](../leaderboard.md)."]
    return "\n".join(lines) + "\n\n" + "\n".join(notes)


def _index() -> str:
    ids = [f"{name}-v0" for names in DOMAINS.values() for name in names.split()]
    lines = [
        "# Environments\n",
        f"{len(cg.problem_ids())} cooperative tasks in linear temporal logic on {len(ids)} pages, with noise; "
        "agents are linear or nonlinear. Each picture shows some episodes under the controllers that `certigym run ID` "
        "computes; each page has an animation of one episode. Numbers: [defaults](../defaults.md), "
        "[leaderboard](../leaderboard.md).\n",
        PALETTE,
        "## Cards\n",
        *_cards(ids),
        "\n## Use\n",
        USE,
        "## All environments\n",
        SHARED,
        "## Arguments\n",
        f"{_rows_of(OPTIONS)}\n",
        "`observation`, `neighbours`, `scale`, `actions`, `dtype`, `automaton`, `sensor_noise`, `preset`: "
        "[observations](../how-to/observations.md).\n",
        "```{toctree}\n:hidden:\n",
        *sorted(ids),
        "```\n",
    ]
    return "\n".join(lines)


SHARED = """- **Observation**: own state, automaton state (one-hot), fraction of time left. States are raw numbers,
  which leave the workspace when an episode ends by leaving it; `scale="unit"` maps workspaces to [-1, 1] and clips.
- **State** (central view, `env.state()`): the states of all agents, then as above. **Central action**: all actions in
  [-1, 1].
- **Actions** are continuous; values beyond the box are clipped.
- **Dynamics**: noise is independent over time and agents; Sigma is its covariance. The workspace is closed; an agent
  that leaves it violates the task.
- **Regions** contain their lower faces, and their upper faces only at the boundary of the workspace.
- **Automaton**: the first letter read is that of the start. Letters that no point of the workspace has are left out.
- **Reward** `"sparse"`: 1 to every agent when the task is satisfied, once, and 0 otherwise, so the mean return is the
  satisfaction probability. `"shaped"` adds differences of a potential between 0 and 1 (rewards lie in [-1, 2]);
  `"progress"` adds those of a level that is kept at the end, and subtracts 1 for a lost task.
- **Ends**: terminated when the task is satisfied (co-safe tasks), when an agent leaves its workspace (also if another
  agent completes the task in that step), or when the automaton can no longer accept; truncated at the horizon, where
  finite-trace tasks are judged.
"""

PALETTE = """Colours of regions: **green** with rising lines must be reached, **vermilion** with crosses avoided,
**blue** with level lines kept; the role of **yellow** with upright lines depends on the state of the task automaton.
Episodes begin at a ring, and end at a dot or an arrow; one that fails ends in a cross.
"""


def _cards(ids: list[str]) -> list[str]:
    """Return a table with a card for each page: the style sheet lays it out, a script filters it."""
    lines, kept = ["| | |\n|---|---|"], numbers.table("defaults")
    domains = {f"{name}-v0": domain for domain, names in DOMAINS.items() for name in names.split()}
    for id in ids:
        problem = cg.make_problem(id)
        name, about, *_ = _docstring(id)
        linear = all(isinstance(agent, LinearAgent) for agent in problem.agents)
        rest = variants_of(id)[1:]
        also = f"<br>Also {', '.join(f'`{other}`' for other in rest)}." if rest else ""
        facts = [
            domains[id],
            counted(problem.n_agents, "agent"),
            f"{counted(max(agent.n_states for agent in problem.agents), 'state')} each",
            "linear" if linear else "nonlinear",
            counted(problem.horizon, "step"),
            " and ".join(dict.fromkeys(tier_of_id(name) for name in variants_of(id))),
            numbers.proved(kept[id]),
        ]
        picture = f"[![{name}]({id}.png)]({id}.md)"
        lines.append(f"| {picture} | **[{name}]({id}.md)**<br>{about}.{also}<br>{', '.join(facts)} |")
    return lines


def main() -> None:
    """Write all pages."""
    FOLDER.mkdir(exist_ok=True)
    texts = pages()
    for name, text in texts.items():
        (FOLDER / name).write_text(text, encoding="utf-8")
    for path in FOLDER.iterdir():
        if path.name not in texts and not (path.stem in filmed() and path.suffix in (".gif", ".png")):
            path.unlink()
    print(f"{len(texts)} files in {FOLDER}")


if __name__ == "__main__":
    main()
