"""From options to arguments: problem, cells, relation and budget; and where results are printed and written."""

from __future__ import annotations

import json
import math
import re
from argparse import Namespace
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from ..envs.suite import make_problem, problem_ids
from ..envs.systems.arguments import write_json as save_json
from ..envs.tasks.problem import Problem, load_problem
from ..synthesis.verbs.search_options import SearchOptions
from .terminal import on_terminal

SIZE = re.compile(r"([0-9]+(?:\.[0-9]*)?)([KMGkmg]?)(?:i?[Bb])?")
"""How a number of bytes is written: 500M, 1.5G, 2GiB."""


def named_problem(name: str, horizon: int | None = None) -> Problem:
    """Return the problem of a suite id or a file name, with another horizon if one is given."""
    if name in problem_ids():
        problem = make_problem(name)
    elif Path(name).is_file():
        problem = load_problem(name)
    else:
        files = [str(one) for one in Path(name).parent.glob("*.toml")]
        close = [f"{name}.toml"] if f"{name}.toml" in files else get_close_matches(name, [*problem_ids(), *files], n=1)
        remedy = f"did you mean `{close[0]}`?" if close else "`certigym describe` lists the ids"
        raise ValueError(f"`{name}`: expected a suite id or a problem file, found neither; {remedy}")
    return problem if horizon is None else problem.replace(horizon=horizon)


def problem_of(options: Namespace) -> Problem:
    """Return the problem that ``problem``, ``--horizon`` and ``--initial-state`` describe."""
    problem, state = named_problem(options.problem, _one_horizon(options)), state_of(options)
    return problem if state is None else problem.replace(initial_state=state)


def _one_horizon(options: Namespace) -> int | None:
    """Return the horizon of the options if it is one number; None for others, which searches take care of."""
    asked = options.horizon
    if isinstance(asked, list):
        return asked[0] if len(asked) == 1 else None
    return asked


def several_horizons(options: Namespace) -> list[int] | None:
    """Return the horizons of the options if they are several; raise ValueError if `none` is among them."""
    asked = options.horizon
    if not isinstance(asked, list) or len(asked) == 1:
        return None
    if None in asked:
        raise ValueError("`--horizon`: expected numbers, or `none` alone, got both; leave `none` out")
    return asked


def is_endless(options: Namespace) -> bool:
    """Whether the options ask for no deadline."""
    return bool(options.horizon == [None])


def state_of(options: Namespace) -> list[float] | None:
    """Return the joint state of ``--initial-state``, numbers separated by blanks or commas; None if it is not given."""
    if options.initial_state is None:
        return None
    words = " ".join(options.initial_state).replace(",", " ").split()
    try:
        return [float(word) for word in words]
    except ValueError:
        raise ValueError(f"`--initial-state`: expected numbers, got {' '.join(words)!r}") from None


def cells_of(options: Namespace) -> int | list[int] | None:
    """Return the cells per axis of ``--cells``: None, one number for all axes, or one number per axis."""
    if options.cells is None:
        return None
    return options.cells[0] if len(options.cells) == 1 else list(options.cells)


def budget_of(options: Namespace) -> dict[str, Any]:
    """Return the budgets of the options, if any, as keyword arguments of ``synthesize``."""
    given = {name: getattr(options, name) for name in ("effort", "seconds", "until")}
    return {name: value for name, value in given.items() if value is not None}


def limit_of(options: Namespace) -> int:
    """Return the largest size in bytes of ``--max-bytes``."""
    return int(_bytes("--max-bytes", options.max_bytes))


def _bytes(option: str, text: str) -> float:
    """Return the number of bytes that an option says."""
    size = SIZE.fullmatch(text.strip())
    if size is None:
        raise ValueError(f"`{option}`: expected a number of bytes such as 500M or 2G, got {text!r}")
    return float(size[1]) * 1024 ** " KMG".index((size[2] or " ").upper())


def relation_of(options: Namespace) -> dict[str, Any]:
    """Return ``--relation`` and the options of the search, as keyword arguments of ``synthesize``.

    The option ``--relation`` holds one name for all agents, or ``AGENT=NAME`` for some of them.
    """
    # Blanks and commas both separate words; an equals sign tells names by agent from one name for all.
    words = [word for text in options.relation for word in text.split(",") if word]
    relation: str | dict[str, str] = words[0] if len(words) == 1 and "=" not in words[0] else {}
    if isinstance(relation, dict):
        for word in words:
            agent, equals, name = word.rpartition("=")
            if not equals or not agent or agent in relation:
                raise ValueError(
                    f"`--relation`: expected one name, or AGENT=NAME once per agent, got {' '.join(words)!r}"
                )
            relation[agent] = name
    return {"relation": relation, "search": search_of(options)}


def search_of(options: Namespace) -> SearchOptions:
    """Return what options of the search ask for; commands that have none of them get the defaults."""
    names = {"restarts": "restarts", "stationary": "stationary"}
    names |= {"delta": "delta", "targets_per_cell": "targets"}
    return SearchOptions(**{name: getattr(options, given) for name, given in names.items() if hasattr(options, given)})


def show(options: Namespace, text: Any, data: Any) -> None:
    """Print the text, and write the data as JSON if ``--json`` asks for it (``-``: data instead of text)."""
    say(options, text)
    write_json(options, data)


def say(options: Namespace, text: Any) -> None:
    """Print a part of the result, unless JSON takes its place; on a terminal as wide as that, and with colours."""
    if options.json != "-":
        print(on_terminal(str(text)), flush=True)


def write_json(options: Namespace, data: Any) -> None:
    """Write JSON to the path, or to standard output (``-``), that ``--json`` names; without ``--json`` do nothing."""
    if options.json == "-":
        # What else is printed goes to standard error then (see `main`).
        json.dump(plain(data), options.results, indent=2, allow_nan=False)
        print(file=options.results, flush=True)
    elif options.json is not None:
        save_json(options.json, plain(data))


def plain(data: Any) -> Any:
    """Return data as JSON can hold them, no number rounded: what is no number is null, and infinity is a word.

    Examples
    --------
    >>> plain({"p": float("nan"), "log_e": [float("-inf"), 0.1 + 0.2]})
    {'p': None, 'log_e': ['-inf', 0.30000000000000004]}
    """
    if isinstance(data, Mapping):
        return {str(key): plain(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [plain(value) for value in data]
    if isinstance(data, np.ndarray | np.generic):
        return plain(data.tolist())
    if isinstance(data, float) and not math.isfinite(data):
        return None if math.isnan(data) else f"{data}"
    return data
