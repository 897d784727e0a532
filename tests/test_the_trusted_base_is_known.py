"""The page of what must be trusted names every module that the check imports, with its lines."""

from __future__ import annotations

import trusted_base


def test_every_module_of_the_check_is_on_a_list() -> None:
    """A module that joins the check has to be called trusted, verified, or unused: with a reason."""
    listed = [name for modules in trusted_base.TRUSTED.values() for name in modules.split()]
    listed += [*trusted_base.VERIFIED.split(), *trusted_base.BESIDE.split()]
    assert len(listed) == len(set(listed))
    assert set(listed) == trusted_base.reached(trusted_base.CHECK)


def test_balls_add_three_modules() -> None:
    more = trusted_base.reached(trusted_base.RIGOROUS) - trusted_base.reached(trusted_base.CHECK)
    assert more == {*trusted_base.BALLS.split()}


def test_the_trusted_base_holds_nothing_of_the_search() -> None:
    for room in ("models", "search", "bounds", "choosing"):
        assert not [name for name in trusted_base.reached(trusted_base.CHECK) if f"synthesis.{room}." in name]


def test_the_page_has_the_lines_of_today() -> None:
    """``python3 docs/trusted_base.py`` writes it anew."""
    text = trusted_base.PAGE.read_text(encoding="utf-8")
    assert text == trusted_base.page(text)
