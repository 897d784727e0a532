"""The page of what must be trusted names every module that the check imports, with its lines."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import certigym as cg
import trusted_base


def test_every_module_of_the_check_is_on_a_list() -> None:
    """A module that joins the check has to be called trusted, verified, or unused: with a reason."""
    listed = [name for modules in trusted_base.TRUSTED.values() for name in modules.split()]
    listed += [*trusted_base.VERIFIED.split(), *trusted_base.BESIDE.split()]
    assert len(listed) == len(set(listed))
    assert set(listed) == trusted_base.reached(trusted_base.CHECK)


def test_what_is_read_first_is_trusted_once_and_fits_into_an_afternoon() -> None:
    trusted = {name for modules in trusted_base.TRUSTED.values() for name in modules.split()}
    assert set(trusted_base.FIRST) <= trusted
    later = [name for modules in trusted_base.THEN.values() for name in modules.split()]
    assert len(later) == len(set(later)) and set(later) <= trusted - set(trusted_base.FIRST)
    lines = sum(count for module in trusted_base.FIRST for _, count in trusted_base.lines_of(module))
    assert lines / trusted_base.LINES_A_MINUTE < 4 * 60


def test_what_is_read_first_runs_when_a_certificate_is_checked() -> None:
    """Functions of the modules of the check that the page names first are called, of each at least one."""
    certificate = cg.synthesize(cg.make_problem("reach-avoid-v0"), 60, relation="exact").certificate
    called = set()

    def note(frame: Any, event: str, _: object) -> None:
        if event == "call":
            called.add(Path(frame.f_code.co_filename).resolve())

    sys.setprofile(note)
    try:
        assert cg.check(certificate)
    finally:
        sys.setprofile(None)
    named = [module for module in trusted_base.FIRST if "checking." in module or module.endswith("checked_kernel")]
    root = trusted_base.ROOT.resolve()
    files = {module: (root / Path(*module.split("."))).with_suffix(".py") for module in named}
    assert len(named) >= 10 and [module for module, file in files.items() if file not in called] == []


def test_the_trusted_base_holds_nothing_of_the_search() -> None:
    for room in (
        "readings",
        "models",
        "search",
        "bounds",
        "choosing",
        "path_bounds",
        "path_words",
        "nominal_paths",
        "pairs",
    ):
        assert not [name for name in trusted_base.reached(trusted_base.CHECK) if f"synthesis.{room}." in name]


def test_the_page_names_the_modules_of_today() -> None:
    """``python3 docs/trusted_base.py`` writes it anew; counts of lines may be off by a tenth, or by ten lines."""
    text = trusted_base.PAGE.read_text(encoding="utf-8")
    today = trusted_base.page(text)
    assert COUNT.sub("#", text) == COUNT.sub("#", today)
    for said, counted in zip(_counts(text), _counts(today), strict=True):
        assert abs(said - counted) <= max(10, 0.1 * counted)


COUNT = re.compile(r"(?<=\| )\**[\d,]+\**(?= \|)|[\d.]+(?= hours)")
"""A cell of a table that is a number of lines, and the hours that they take."""


def _counts(text: str) -> list[float]:
    return [float(found.group().strip("*").replace(",", "")) for found in COUNT.finditer(text)]
