"""The check answers, and never breaks off, whatever numbers a certificate in memory has been given."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import OnGrid
from kinds import mostly_thorough

Path = tuple[Any, ...]

OUTSIDE = {"guard_mask", "start_mask", "guard_source", "guard_target", "start_target"}
"""Numbers of guards: what is out of their range is never accepted."""


def whole_numbers(value: Any, path: Path = ()) -> Iterator[tuple[Path, np.ndarray]]:
    """Yield every array of whole numbers below a value, with the names that lead to it."""
    if isinstance(value, np.ndarray):
        if value.size and value.dtype.kind in "iu":
            yield path, value
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            if field.name not in ("problem", "controller"):
                yield from whole_numbers(getattr(value, field.name), (*path, field.name))
    elif isinstance(value, tuple | list):
        for k, inner in enumerate(value):
            yield from whole_numbers(inner, (*path, k))


def put(value: Any, path: Path, array: np.ndarray) -> Any:
    """Return the value with another array at the end of a path."""
    if not path:
        return array
    first, *rest = path
    if dataclasses.is_dataclass(value):
        return dataclasses.replace(value, **{first: put(getattr(value, first), tuple(rest), array)})  # type: ignore[type-var]
    items = list(value)
    items[first] = put(items[first], tuple(rest), array)
    return type(value)(items)


@pytest.fixture(scope="module", params=["exact", "paper", "boxes"])
def certificate(request: pytest.FixtureRequest) -> OnGrid:
    options = cg.SearchOptions(epsilon=0.6 if request.param == "paper" else None)
    problem = cg.make_problem("reach-avoid-v0", horizon=4)
    made = cg.synthesize(problem, 30, relation=request.param, search=options).certificate
    assert cg.check(made)
    return made


@mostly_thorough("number", [-7, 10**6])
def test_numbers_out_of_range_are_answered(certificate: OnGrid, number: int) -> None:
    arrays = list(whole_numbers(certificate))
    assert len(arrays) > 15
    for path, array in arrays:
        if not np.iinfo(array.dtype).min <= number <= np.iinfo(array.dtype).max:
            continue
        forged = array.copy()
        forged.flat[0] = number
        report = cg.check(put(certificate, path, forged))
        assert report.failures if path[-1] in OUTSIDE else report is not None
