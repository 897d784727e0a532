"""Problem files: TOML, read into a `Problem`, with errors that name file, table and field.

Layout of a file:

    name = "my-task"
    horizon = 12                      # left out, or "none": no deadline, or as many steps as windows of the task say
    [[agents]]                        # the arguments of `LinearAgent`, or with `dynamics` those of `Agent`, where
                                      # others may be named: `leader.position` (a state), `boiler.heat` (an input);
                                      # `copies = 20` makes name_0 ... name_19; `[agents.left]` names the table itself;
                                      # `noise_std = [0.1]`, one for each state, says the same as `noise_covariance`;
                                      # `initial_state = [[0.0], [3.0]]` beside `copies = 2` is one start for each,
                                      # and so are `initial_low` and `initial_high`, boxes of starts;
                                      # numbers of boxes may be "pi / 2", those of the input box "2 + sin(0.3*t)"
    [joint_noise]                     # noise that agents share: what one normal number per step adds to states of each
    wind = { "drone_*" = { x = 0.03, y = -0.01 }, kite = [0.05, 0.0] }   # by names of states, or one for each
    [propositions]
    goal = { agent = "left", low = [0.0], high = [5.0] }      # or a family: agent = "drone_*"
    dock = { agent = "ship", disc = { centre = [1, 2], radius = 0.5 } }   # or another shape (see ``agents.shapes``)
    near = { agents = ["left", "right"], low = [-1.0], high = [1.0] }   # of y_left - y_right; or agents = "drone_*"
                                      # for all pairs, with pairs = "neighbours" for those next to each other;
                                      # outputs = [[0], [1]] says which outputs are compared
    [specification]
    formula = "F goal"                # with semantics = "co-safe" or "finite-trace"; left out: co-safe if it is that;
                                      # or `specification = "F goal"` above all tables
    # or: hoa = "HOA text, or the path of a file that holds it"
    # or by hand: semantics, states, initial, accepting, transitions = [[source, guard, target], ...], otherwise
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from ...systems.agents import Agent, AnyAgent, LinearAgent
from ...systems.arguments import MOST_AGENTS, checked_count, shown
from ..automata import Automaton, FormulaError, automaton_from_hoa, automaton_from_transitions
from ..regions import SHAPES, Pair, Proposition
from .canonical_form import in_canonical_form, starts_of_copies
from .default_horizon import default_horizon
from .families import AnyProposition, about_pairs, checked_propositions, expand, keys_of, refuse_shape
from .record import Problem
from .specification import Specification

_BY_HAND = ("states", "initial", "accepting", "transitions")
_ALTERNATIVES = ("formula", "hoa", "states", "automaton")
"""Keys of which a specification has exactly one; it says how the task is written."""
_PROBABILITY = "there is no threshold: a run computes a probability that is proved, and prints it"
_DEVIATION = "standard deviations, one for each state, are `noise_std`"
_ONE_STEP = "write `dynamics`, the mean of each state one step later, such as `x + 0.1*v` for a step of 0.1 s"
_BOXES = "the workspace is `state_low` and `state_high`, and the box of the inputs `input_low` and `input_high`"
_SHAPE = "it stands in the table of a shape, such as `disc = { centre = [0, 0], radius = 1 }`"
_WINDOW = 'times stand in the formula, such as `F[3,8] goal`; corners in quotes may name the time, such as `"0.1*t"`'
_OF = '`of` names the states that a region is about: `of = ["x", "y"]`'
_PAIR = (
    'a pair is a region of two agents: `[propositions.near]` with `agents = ["a", "b"]`, `distance = 1` and the states '
    'that are compared, `of = ["x", "y"]`'
)
_MEASURED = dict.fromkeys(
    (
        *(
            f"{word}{end}"
            for word in ("sensor", "measurement", "observation")
            for end in ("", "s", "_matrix", "_noise")
        ),
        *("C", "H", "sensor_std", "output_noise", "output_noise_std", "output_covariance"),
    ),
    "certificates assume that controllers measure the states exactly, and no key says otherwise; `output_matrix` says "
    "what regions are about, and `sensor_noise` of environments is for learners and rollouts",
)
_START = "a start is `initial_state`, or drawn uniformly from the box `initial_low`, `initial_high`"
_ELSEWHERE = {
    "": {
        **_MEASURED,
        **dict.fromkeys(("initial_std", "initial_covariance", "initial_distribution", "initial_noise"), _START),
        **dict.fromkeys(("state_matrix", "system_matrix"), "the matrix of the states is `A`"),
        "input_matrix": "the matrix of the inputs is `B`",
        "angles": "write the agent as expressions, with `states` and `dynamics`",
        "c": "what is added at every step is `offset`",
        "noise_scale": "write the agent as expressions, with `states` and `dynamics`",
        **dict.fromkeys(("sigma", "std", "stddev", "noise_sigma", "w"), _DEVIATION),
        **dict.fromkeys(("cov", "covariance", "Q", "W"), "variances and covariances are `noise_covariance`"),
        **dict.fromkeys(("ode", "xdot", "derivative", "derivatives", "f"), _ONE_STEP),
        **dict.fromkeys(("x0", "start", "initial", "init"), "the start is `initial_state`"),
        **dict.fromkeys(("low", "high", "bounds", "limits", "domain"), _BOXES),
    },
    "[propositions]": {
        **dict.fromkeys(("centre", "center", "radius", "corners", "tip", "axis", "normal", "offset"), _SHAPE),
        **dict.fromkeys(("normals", "offsets"), "half-spaces together are `polytope = { normals = .., offsets = .. }`"),
        **dict.fromkeys(("axes", "dims", "dimensions", "states", "state", "variables", "indices"), _OF),
        **dict.fromkeys(("t", "time", "window", "steps", "start", "end", "until"), _WINDOW),
        **dict.fromkeys(("pair", "pairs", "distance", "robots", "between"), _PAIR),
    },
    "[specification]": dict.fromkeys(("probability", "threshold", "p", "at_least", "confidence"), _PROBABILITY),
    "the problem": {
        **_MEASURED,
        **dict.fromkeys(("regions", "region", "obstacles", "labels"), "regions are tables [propositions.NAME]"),
        **dict.fromkeys(("pairs", "pair", "distance", "collisions"), _PAIR),
        "agent": "agents are tables, each under its own [[agents]]",
        "formula": "it stands in the table `[specification]`, or above all tables as `specification`",
        **dict.fromkeys(("probability", "threshold"), _PROBABILITY),
    },
}
"""What to do with a key that is known in another place, or is the word of another tool, by the start of the place."""


def load_problem(path: str | Path) -> Problem:
    """Return the problem that a file describes.

    Parameters
    ----------
    path : str or Path
        A TOML file; its layout is described in the module docstring.

    Raises
    ------
    ValueError
        If anything is wrong. The message is one line that names the file, the table and the field.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{shown(str(path))}: expected UTF-8 text, got an invalid byte at {error.start}") from error
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(f"{shown(str(path))}: expected a readable problem file, got: {reason}") from error
    return problem_from_toml(text, source=path.name, folder=path.parent)


def policy_in_file(path: str | Path) -> dict[str, Any] | None:
    """Return the policy that a problem file says in its table ``[policy]``; None if it has none.

    It is no part of the problem: expressions of inputs, for ``certify`` and whoever acts.
    """
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8")).get("policy")
    except (OSError, ValueError):
        return None
    return dict(table) if isinstance(table, dict) else None


def problem_from_toml(text: str, source: str = "problem file", folder: Path | None = None) -> Problem:
    """Return the problem that a TOML text describes.

    Parameters
    ----------
    text : str
    source : str
        Name of the text in errors.
    folder : Path, optional
        Folder of relative paths (`hoa`); without it the text may not refer to files.

    Raises
    ------
    ValueError
        If anything is wrong. The message is one line that names source, table and field.
    """
    try:
        data = tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError, and integers of thousands of digits
        headings = {form for form in (r"\[\[agents\]\]", r"\[agents\.") if re.search(rf"(?m)^\s*{form}", text)}
        both = "; the headings [[agents]] and [agents.NAME] do not mix: write all agents in one of the two ways"
        raise ValueError(f"{source}: expected TOML, got: {_line(error)}{both if len(headings) > 1 else ''}") from error
    except RecursionError as error:
        raise ValueError(f"{source}: expected TOML, got arrays or tables nested too deeply") from error
    try:
        return problem_from_dict({"name": _name_of(source), **data}, folder)
    except ValueError as error:
        raise ValueError(f"{source}: {_line(error)}") from error


def _name_of(source: str) -> str:
    """Return the name of a problem that says none: that of its file."""
    return re.sub(r"[^\w-]+", "-", Path(source).stem).strip("-")[:100] or "problem"


def problem_from_dict(data: Mapping[str, Any], folder: Path | None = None) -> Problem:
    """Return the problem that plain values describe, keyed as in problem files.

    Raises
    ------
    ValueError
        If anything is wrong. The message is one line that names table and field.
    """
    _check_keys(
        data, "the problem", ("name", "agents", "propositions", "specification"), ["horizon", "joint_noise", "policy"]
    )
    horizon = data.get("horizon", "none")
    horizon = default_horizon(data["specification"]) if horizon == "none" else horizon
    agents = _agents(data["agents"], horizon)
    propositions = _propositions(data["propositions"])
    expand(propositions, [agent.name for agent in agents])  # errors in patterns come before those of the task
    specification = _specification(data["specification"], propositions, agents, folder)
    try:
        return Problem(
            name=data["name"],
            horizon=horizon,
            agents=agents,
            propositions=propositions,
            specification=specification,
            joint_noise=data.get("joint_noise"),
        )
    except FormulaError as error:
        raise ValueError(f"[specification]: `formula`: {_line(error)}") from error


def _agents(tables: Any, horizon: Any) -> list[AnyAgent]:
    """Return the agents of the tables, those with `copies` repeated under numbered names."""
    if isinstance(tables, Mapping):
        tables = [_named(name, table) for name, table in tables.items()]
    if not isinstance(tables, list) or not tables:
        raise ValueError(f"[[agents]]: expected at least one table, got {shown(tables)}")
    agents: list[AnyAgent] = []
    for position, table in enumerate(tables):
        # Name the table by its number, and by its name if it has a readable one.
        where = f"[[agents]] number {position + 1}"
        if isinstance(table, Mapping) and isinstance(table.get("name"), str):
            where += f" ({shown(table['name'], 40)})"
        most = MOST_AGENTS - len(agents)
        agents += _prefixed(where, lambda table=table, most=most: _of_table(table, horizon, tables, most))
    return agents


def _of_table(table: Any, horizon: Any, tables: Sequence[Any], most: int) -> Sequence[AnyAgent]:
    """Return the agents of one table, `most` at most."""
    kind = _kind(table)
    if isinstance(table, Mapping) and "copies" in table and isinstance(name := table.get("name"), str):
        # Copies are `drone_*` elsewhere, and may be so here.
        table = {**table, "name": name.removesuffix("_*")}
    table = in_canonical_form(table, horizon, tables)
    required, besides = _keys(kind)
    _refuse_nested_agents(table)
    _check_keys(table, "", required, besides)
    copies = table.get("copies")
    given = {key: value for key, value in table.items() if key != "copies"}
    if copies is None:
        return [kind(**given)]
    checked_count(copies, "copies", most=most)
    apart = starts_of_copies(given, copies)
    return kind(**given).copies(copies) if apart is None else [kind(**own) for own in apart]


def _refuse_nested_agents(table: Any) -> None:
    """Raise ValueError where an agent holds another one: TOML reads `[agents.cart]` after `[[agents]]` so."""
    for key, value in table.items() if isinstance(table, Mapping) else ():
        if isinstance(value, Mapping) and ("states" in value or "A" in value):
            raise ValueError(
                f"a heading [agents.{shown(key, 40)[1:-1]}] after [[agents]] makes that agent a part of this one; "
                "write [[agents]] there too, and the name below it, or [agents.NAME] for all of them"
            )


def _named(name: str, table: Any) -> dict[str, Any]:
    """Return the table of an agent whose name stands in its heading."""
    if not isinstance(table, Mapping):
        raise ValueError(f"[agents]: expected tables such as [agents.robot], got {shown(name)} = {shown(table)}")
    if "name" in table:
        raise ValueError(f"[agents.{shown(name, 40)}]: expected no `name` beside that of the table; leave it out")
    return {"name": name, **table}


def _kind(table: Any) -> type[AnyAgent]:
    """Return the class of an agent: dynamics are expressions, or matrices."""
    is_written = isinstance(table, Mapping) and ("dynamics" in table or ("states" in table and "A" not in table))
    return Agent if is_written else LinearAgent


def _keys(kind: type[AnyAgent]) -> tuple[list[str], list[str]]:
    """Return the keys that a table of an agent must have, and those that it may have."""
    return [*kind.needed_keys], [*kind.other_keys, "copies"]


def _propositions(table: Any) -> dict[str, AnyProposition]:
    if not isinstance(table, Mapping):
        raise ValueError(
            f"[propositions]: expected a table, got {shown(table)}; write [propositions.NAME] for each of them, "
            "and below it what it is"
        )
    result = {}
    for name, value in table.items():
        where = f"[propositions] {shown(name)}"
        if not isinstance(value, Mapping):
            raise ValueError(
                f'{where}: expected a table, such as {{ agent = "car", of = ["x"], low = [3], high = [5] }}, '
                f"got {shown(value)}"
            )
        if about_pairs(value):
            refuse_shape(value, where)
            _check_keys(value, where, *keys_of(value))
            result[name] = _prefixed(where, lambda value=value: Pair(**value))
            continue
        required, besides = keys_of(value)
        is_open = isinstance(value, Mapping) and not {"low", "high", *SHAPES} & {*value}
        _check_keys(value, where, required, (*besides, *SHAPES) if is_open else besides)
        result[name] = _prefixed(where, lambda value=value: Proposition(**value))
    return checked_propositions(result)


def _specification(
    table: Any, propositions: Mapping[str, AnyProposition], agents: Sequence[AnyAgent], folder: Path | None
) -> Specification:
    """Return the specification of the table: a formula, HOA text, an automaton as plain values, or one by hand."""
    where = "[specification]"
    if isinstance(table, str):
        table = {"formula": table}
    if not isinstance(table, Mapping):
        raise ValueError(f"{where}: expected a table, got {shown(table)}")
    written_as = [key for key in _ALTERNATIVES if key in table]
    if len(written_as) != 1:
        # A misspelled key is the likely cause: complain about it first.
        _check_keys(table, where, (), (*_ALTERNATIVES, *_BY_HAND, "semantics", "otherwise"))
        got = ", ".join(written_as) or "none"
        raise ValueError(f"{where}: expected exactly one of {', '.join(_ALTERNATIVES)}, got {got}")
    if written_as == ["formula"]:
        _check_keys(table, where, ("formula",), ("semantics",))
        return _prefixed(where, lambda: Specification(table["formula"], table.get("semantics")))
    # Automata are stated over single propositions, so families are expanded.
    names, families = expand(propositions, [agent.name for agent in agents])
    if written_as == ["hoa"]:
        _check_keys(table, where, ("hoa",), ("semantics",))
        text = _hoa_text(table["hoa"], folder)
        automaton = _prefixed(f"{where} `hoa`", lambda: automaton_from_hoa(text, list(names)))
    elif written_as == ["automaton"]:
        _check_keys(table, where, ("automaton",), ("semantics",))
        if not isinstance(table["automaton"], Mapping):
            raise ValueError(f"{where}: `automaton`: expected a table, got {shown(table['automaton'])}")
        automaton = _prefixed(f"{where} `automaton`", lambda: Automaton.from_dict(table["automaton"]))
    else:
        automaton = _prefixed(where, lambda: _by_hand(table, list(names), families))
    return _prefixed(where, lambda: Specification(semantics=table.get("semantics"), automaton=automaton))


def _hoa_text(value: Any, folder: Path | None) -> str:
    """Return HOA text as it stands in the table, or from the file that the table names."""
    where = "[specification] `hoa`"
    if not isinstance(value, str):
        raise ValueError(f"{where}: expected HOA text or a path, got {shown(value)}")
    # No path starts like the text of an automaton.
    if value.lstrip().startswith("HOA:"):
        return value
    if folder is None:
        raise ValueError(f"{where}: expected text that starts with 'HOA:', got {shown(value)}")
    try:
        return (folder / value).read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise ValueError(f"{where}: expected a file of UTF-8 text, got {shown(value)}") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ValueError(f"{where}: expected HOA text or a readable file, got {shown(value)}: {reason}") from error


def _by_hand(table: Mapping[str, Any], names: list[str], families: Mapping[str, Sequence[str]]) -> Automaton:
    """Return the automaton of states and transitions written in the table."""
    where = "the automaton"
    _check_keys(table, where, ("semantics", *_BY_HAND), ("otherwise",))
    for key in ("states", "accepting"):
        _check_strings(table[key], key)
    rows = table["transitions"]
    if not isinstance(rows, list):
        raise ValueError(f"`transitions`: expected a list of [source, guard, target], got {shown(rows)}")
    # TOML gives plain values: check them here, so that errors name the key and not a Python type.
    for row in rows:
        if not isinstance(row, list) or len(row) != 3 or not all(isinstance(text, str) for text in row):
            raise ValueError(f"`transitions`: expected [source, guard, target], three strings, got {shown(row)}")
    for key in ("initial", "semantics", "otherwise"):
        if key in table and not isinstance(table[key], str):
            raise ValueError(f"`{key}`: expected a string, got {shown(table[key])}")
    return automaton_from_transitions(
        names,
        table["states"],
        table["initial"],
        table["accepting"],
        [(source, guard, target) for source, guard, target in rows],
        table["semantics"],
        otherwise=table.get("otherwise"),
        families=families,
    )


def _check_strings(value: Any, key: str) -> None:
    if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
        raise ValueError(f"`{key}`: expected a list of names, got {shown(value)}")


def _check_keys(table: Any, where: str, required: Iterable[str], optional: Iterable[str] = ()) -> None:
    """Raise ValueError unless a table holds all required keys, and no others than these and the optional ones."""
    if not isinstance(table, Mapping):
        raise ValueError(f"{where}: expected a table, got {shown(table)}".removeprefix(": "))
    required, allowed = list(required), [*required, *optional]
    where = where and f"{where}: "
    for key in table:
        if key not in allowed:
            close = get_close_matches(str(key), allowed, n=1)
            remedy = f"did you mean `{close[0]}`?" if close else f"the keys are {', '.join(allowed)}"
            told = next((words for place, words in _ELSEWHERE.items() if place and where.startswith(place)), {})
            told = told if where else _ELSEWHERE[""]
            raise ValueError(f"{where}unknown key {shown(key)}; {told.get(str(key), remedy)}")
    for key in required:
        if key not in table:
            raise ValueError(f"{where}`{key}` is missing")


def _prefixed(where: str, make: Any) -> Any:
    """Return what `make` returns; put the place in front of the message if it raises ValueError."""
    try:
        return make()
    except ValueError as error:
        raise ValueError(f"{where}: {_line(error)}") from error


def _line(error: Exception) -> str:
    """Return the message of an error on one line, below it an expression with a caret under the mistake if it has one.

    Formulas may be long: the number of the character stands for the caret.
    """
    if isinstance(error, FormulaError):
        place = f" (character {error.start + 1} of the formula)" if error.text else ""
        return " ".join(error.problem.split()) + place
    said, _, below = str(error).partition("\n    ")
    if below.endswith("^"):
        return " ".join(said.split()) + "\n    " + below
    return " ".join(str(error).split()) or type(error).__name__
