"""Options of searches are one record; keywords of 0.3 warn and say what to write, unknown ones name the nearest."""

from __future__ import annotations

import inspect
import pickle
from dataclasses import FrozenInstanceError, fields
from typing import Any

import pytest

import certigym as cg
from certigym.synthesis.policy_search.ascent.limits import Limits
from certigym.synthesis.verbs.search_options import OPTIONS

VERBS = (cg.synthesize, cg.certify, cg.improve, cg.abstract)
OLD: dict[str, Any] = {
    "max_sweeps": 1, "restarts": 1, "stationary": True, "value": "tree", "limits": Limits(rank=50),
    "targets_per_cell": 3, "epsilon": 0.1, "feedback": 0.0, "inputs": 10,
}  # fmt: skip
"""Keywords of 0.3 and a value of each; ``delta`` and ``share`` need the relation ``ellipsoid``."""


def test_verbs_have_at_most_nine_keywords_and_the_record() -> None:
    for verb in VERBS:
        parameters = inspect.signature(verb).parameters.values()
        named = [one.name for one in parameters if one.kind is not one.VAR_KEYWORD]
        assert len(set(named) - {"problem", "search"}) <= 9, named
        assert "search" in named and not {*named} & ({*OPTIONS} - {"share"})


def test_the_record_is_frozen_short_and_travels() -> None:
    options = cg.SearchOptions(max_sweeps=2, restarts=1)
    assert repr(options) == "SearchOptions(max_sweeps=2, restarts=1)" and repr(cg.SearchOptions()) == "SearchOptions()"
    assert pickle.loads(pickle.dumps(options)) == options == cg.SearchOptions(restarts=1, max_sweeps=2)
    with pytest.raises(FrozenInstanceError):
        options.max_sweeps = 3  # type: ignore[misc]
    assert all(field.name in (cg.SearchOptions.__doc__ or "") for field in fields(options))
    assert [*inspect.signature(cg.SearchOptions).parameters] == [*OPTIONS]


@pytest.mark.parametrize("name", OLD)
def test_old_keywords_work_warn_and_say_what_to_write(name: str) -> None:
    problem = cg.make_problem("reach-avoid-v0", horizon=2)
    arguments: dict[str, Any] = {"problem": problem, "cells": 16, "relation": "exact", "above": False}
    with pytest.warns(DeprecationWarning, match=rf"write search=cg.SearchOptions\({name}=") as told:
        old = cg.synthesize(**arguments, **{name: OLD[name]})
    assert [warning.filename for warning in told] == [__file__], "the line that has to change is the caller's"
    new = cg.synthesize(**arguments, search=cg.SearchOptions(**{name: OLD[name]}))
    assert old.lower_bound == new.lower_bound > 0.0
    assert old.certificate.settings == new.certificate.settings


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("verbose", "`progress`"),
        ("timeout", "`seconds`"),
        ("method", "`relation`"),
        ("efort", "`effort`"),
        ("max_sweep", r"`search=SearchOptions\(max_sweeps=...\)`"),
        ("n_jobs", "the arguments are problem, cells"),
    ],
)
def test_unknown_keywords_name_what_was_meant(name: str, meant: str) -> None:
    with pytest.raises(ValueError, match=rf"`{name}`: expected an argument of `synthesize`, got .*; .*{meant}"):
        cg.synthesize("reach-avoid-v0", **{name: 1})


def test_what_is_no_option_is_refused() -> None:
    with pytest.raises(ValueError, match=r"of `SearchOptions`, .*did you mean `restarts`"):
        cg.SearchOptions(restart=1)  # type: ignore[call-arg]
    record: Any = {"max_sweeps": 1}
    with pytest.raises(ValueError, match=r"`search`: expected a record such as .*, got dict"):
        cg.synthesize("reach-avoid-v0", search=record)
    with pytest.raises(ValueError, match="`max_sweeps`: expected an option that `abstract` uses"):
        cg.abstract("reach-avoid-v0", search=cg.SearchOptions(max_sweeps=1))
    refused: list[dict[str, Any]] = [{"max_sweeps": -1}, {"value": "oak"}, {"delta": 2.0}]
    for wrong in refused:
        with pytest.raises(ValueError, match=f"`{next(iter(wrong))}`"):
            cg.SearchOptions(**wrong)
