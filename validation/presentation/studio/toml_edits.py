"""What the picture changes in the text: values, propositions and the formula; all else stays as it was written.

Every edit is proved: the text afterwards is read again and must say what the text before said, with the edit made.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any

from .toml_spans import Path, places

REFUSAL = "this cannot be changed from the picture as it is written; change it in the text"
"""What is said of texts that are written in a way that the picture cannot change."""

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_EDITABLE = ("agents", "propositions", "specification")
_MOST_SETS = 64
_WEAK = re.compile(r"->|[|]|\b[UWRM]\b")
"""Operators that bind less than `&`, or are not told from it at a glance."""

ASKED = {"reached": "F {}", "avoided": "G !{}", "kept": "G {}"}
"""What the formula says of a region that is drawn, by the role that it is to have."""


def edited(text: str, edit: Any) -> str:
    """Return the text with an edit of the picture made.

    Parameters
    ----------
    text : str
        Valid TOML.
    edit : object
        ``{"set": [[path, value], ...]}``, ``{"add": [name, table], "role": role}``, ``{"remove": name}`` or
        ``{"formula": text}``; values are numbers, strings and lists of them. What is added is asked for by the formula,
        too, as its role says: ``reached``, ``avoided``, ``kept`` or ``free``; what is removed no longer is, where the
        formula has a part that asks for it alone.

    Raises
    ------
    ValueError
        If the text is no TOML, the edit is none of these, or the text is written so that the edit cannot be made.
    """
    goal = tomllib.loads(text)
    if not isinstance(edit, Mapping) or not edit or not set(edit) <= {"set", "add", "role", "remove", "formula"}:
        raise ValueError("`edit`: expected one of set, add, remove, formula")
    formula = edit.get("formula")
    for path, value in _sets(edit.get("set", [])):
        _put(goal, path, value)
        span = places(text).values.get(path)
        if span is None:
            raise ValueError(REFUSAL)
        text = text[: span.start] + literal(value) + text[span.end :]
    if "add" in edit:
        name, table = _added(edit["add"], goal)
        text = _with_proposition(text, goal, name, table)
        goal.setdefault("propositions", {})[name] = table
        formula = _asked_too(formula_of(goal), name, edit.get("role"))
    if "remove" in edit:
        text = _without_proposition(text, edit["remove"])
        del goal["propositions"][edit["remove"]]
        formula = _asked_no_more(formula_of(goal), edit["remove"])
    if formula is not None:
        text = _with_formula(text, goal, str(formula))
    if _read(text) != goal:
        raise ValueError(REFUSAL)
    return text


def formula_of(data: Mapping[str, Any]) -> str | None:
    """Return the formula of a text, ``""`` if it has none yet; None where the task is written in another way."""
    table = data.get("specification", "")
    if isinstance(table, dict):
        table = table.get("formula", None if set(table) - {"semantics"} else "")
    return table if isinstance(table, str) else None


def _asked_too(formula: str | None, name: str, role: Any) -> str | None:
    """Return a formula with one more part; None if it stays as it is."""
    if formula is None or role not in ASKED:
        return None
    part = ASKED[role].format(name)
    # A part joined by `&` to what binds less would be joined to a piece of it.
    whole = f"({formula})" if _WEAK.search(formula) else formula
    return f"{whole} & {part}" if formula.strip() else part


def _asked_no_more(formula: str | None, name: str) -> str | None:
    """Return a formula without the parts that are about one proposition alone; None if it has none."""
    parts = (formula or "").split(" & ")
    left = [part for part in parts if part.strip() not in {words.format(name) for words in ASKED.values()}]
    return None if len(left) == len(parts) else " & ".join(left)


def literal(value: Any) -> str:
    """Return a value as TOML.

    Examples
    --------
    >>> literal({"agent": "cart", "disc": {"centre": [1.5, 2], "radius": 0.5}})
    '{ agent = "cart", disc = { centre = [1.5, 2], radius = 0.5 } }'
    """
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {literal(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(literal, value)) + "]"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, int | float) and not isinstance(value, bool):
        return repr(value)
    raise ValueError("`edit`: expected numbers, strings and lists of them")


def _read(text: str) -> Any:
    try:
        return tomllib.loads(text)
    except ValueError:
        return None


def _sets(listed: Any) -> list[tuple[Path, Any]]:
    """Return paths and values of an edit, checked."""
    if not isinstance(listed, list) or len(listed) > _MOST_SETS:
        raise ValueError(f"`set`: expected at most {_MOST_SETS} pairs of a path and a value")
    pairs = []
    for item in listed:
        if not (isinstance(item, list) and len(item) == 2 and isinstance(item[0], list) and len(item[0]) > 1):
            raise ValueError("`set`: expected pairs of a path and a value")
        path = item[0]
        if path[0] not in _EDITABLE or not all(type(key) in (str, int) for key in path):
            raise ValueError(f"`set`: expected paths that begin with one of {', '.join(_EDITABLE)}")
        pairs.append((tuple(path), item[1]))
    return pairs


def _put(data: Any, path: Path, value: Any) -> None:
    """Change a value that is there."""
    try:
        for key in path[:-1]:
            data = data[key]
        data[path[-1]]  # what is not there is not made
        data[path[-1]] = value
    except (KeyError, IndexError, TypeError):
        raise ValueError("`set`: expected the path of a value that the text has") from None


def _added(pair: Any, data: Mapping[str, Any]) -> tuple[str, dict[str, Any]]:
    if not (isinstance(pair, list) and len(pair) == 2 and isinstance(pair[0], str) and isinstance(pair[1], dict)):
        raise ValueError("`add`: expected a name and a table")
    if pair[0] in data.get("propositions", {}) or not _BARE.fullmatch(pair[0]):
        raise ValueError("`add`: expected a name that is free, of letters, digits and _")
    return pair[0], pair[1]


def _with_proposition(text: str, data: Mapping[str, Any], name: str, table: Mapping[str, Any]) -> str:
    """Return the text with one more proposition: behind the others, or in a table of their own at the end."""
    found = places(text)
    line = f"{name} = {literal(table)}"
    within = [span.end for path, span in found.values.items() if len(path) == 2 and path[0] == "propositions"]
    heading = next((end for path, _, end in found.headings if path == ("propositions",)), None)
    if heading is not None:
        at = _end_of_line(text, max([heading, *within]))
        return f"{text[:at]}\n{line}{text[at:]}"
    end = text.rstrip("\n") + "\n\n" if text.strip() else ""
    if "propositions" not in data:
        return f"{end}[propositions]\n{line}\n"
    entries = "".join(f"{_key(key)} = {literal(value)}\n" for key, value in table.items())
    return f"{end}[propositions.{name}]\n{entries}"


def _without_proposition(text: str, name: Any) -> str:
    """Return the text without the line, or the lines, of a proposition."""
    span = places(text).values.get(("propositions", name))
    if span is None:
        raise ValueError(REFUSAL)
    begin, end = text.rfind("\n", 0, span.key) + 1, _end_of_line(text, span.end)
    return text[:begin] + text[min(end + 1, len(text)) :]


def _with_formula(text: str, goal: dict[str, Any], formula: str) -> str:
    """Return the text with another formula, and change what it is to say likewise."""
    found, table = places(text), goal.get("specification")
    if isinstance(table, dict):
        if set(table) & {"hoa", "states", "automaton"}:
            raise ValueError(REFUSAL)
        table["formula"] = formula
        span = found.values.get(("specification", "formula"))
        if span is None:
            heading = next((end for path, _, end in found.headings if path == ("specification",)), None)
            if heading is None:
                raise ValueError(REFUSAL)
            at = _end_of_line(text, heading)
            return f"{text[:at]}\nformula = {literal(formula)}{text[at:]}"
        return text[: span.start] + literal(formula) + text[span.end :]
    span = found.values.get(("specification",))
    if span is not None:
        goal["specification"] = formula
        return text[: span.start] + literal(formula) + text[span.end :]
    # There is none: a table at the end can follow anything.
    goal["specification"] = {"formula": formula}
    return f"{text.rstrip()}\n\n[specification]\nformula = {literal(formula)}\n"


def _end_of_line(text: str, at: int) -> int:
    """Return where the line of a position ends: its line end, or the end of the text."""
    end = text.find("\n", at)
    return len(text) if end < 0 else end


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else literal(key)
