"""Theory pages: numbers of statements are unique, formulas need no network, and examples print what they say."""

from __future__ import annotations

import contextlib
import io
import re
from collections import Counter
from pathlib import Path

import pytest

import certigym
from certigym.synthesis.abstraction.models import box_model

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted((DOCS / "theory").glob("*.md"))
CODE = re.compile(r"^```.*?^```$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
KINDS = "Theorem|Lemma|Proposition|Corollary"
STATED = re.compile(rf"\*\*(?:{KINDS}) (\w+\.\d+[a-z]?)")
NAMED = re.compile(rf"(?:{KINDS})s? (\w+\.\d+[a-z]?)")
FORMULA = re.compile(r"\$\$(.+?)\$\$|(?<![\\$])\$([^$\n]+?)\$", re.DOTALL)


def words(page: Path) -> str:
    return CODE.sub("", page.read_text(encoding="utf-8"))


def test_every_statement_has_a_number_of_its_own_and_the_name_of_its_page() -> None:
    stated = [(number, page.stem) for page in PAGES for number in STATED.findall(words(page))]
    twice = [number for number, count in Counter(number for number, _ in stated).items() if count > 1]
    assert len(stated) > 40 and not twice
    assert [(number, page) for number, page in stated if number.split(".")[0].lower() != page] == []


def test_every_statement_that_is_named_anywhere_is_stated() -> None:
    stated = {number for page in PAGES for number in STATED.findall(words(page))}
    root = DOCS.parent
    files = [
        *DOCS.rglob("*.md"),
        *(f for wing in ("envs", "synthesis", "validation") for f in (root / wing).rglob("*.py")),
    ]
    named = {
        (number, file.relative_to(root).as_posix())
        for file in files
        if "_build" not in file.parts
        for number in NAMED.findall(file.read_text(encoding="utf-8"))
        if number.split(".")[0].lower() in {page.stem for page in PAGES}
    }
    assert len(named) > 50 and {pair for pair in named if pair[0] not in stated} == set()


def test_formulas_become_markup_without_a_network() -> None:
    pytest.importorskip("latex2mathml", reason="needs the extra `docs`")
    import mathml

    count = 0
    for page in sorted(DOCS.rglob("*.md")):
        if "_build" in page.parts:
            continue
        for block, inline in FORMULA.findall(words(page)):
            drawn = mathml.markup(block or inline, "block" if block else "inline")
            count += 1
            assert drawn.startswith("<math") and drawn.endswith("</math>")
            # What the converter does not know is left as it is: a command in the place of a sign.
            shown = drawn.partition("<annotation")[0]
            assert not re.search(r">[^<]*\\[a-zA-Z]+[^<]*<", shown), (page.name, block or inline)
            assert not re.search(r'<mi mathvariant="(?!normal)', shown), "browsers no longer know it"
    assert count > 800
    settings = (DOCS / "conf.py").read_text(encoding="utf-8")
    assert "mathjax" not in settings and "http" not in settings
    assert all("http" not in path.read_text(encoding="utf-8") for path in (DOCS / "_static").iterdir())


@pytest.mark.pages
@pytest.mark.full_search(box_model)
def test_the_worked_example_prints_what_the_page_says() -> None:
    text = (DOCS / "theory" / "bounds.md").read_text(encoding="utf-8")
    found = re.search(r"^```python\n(.*?)^```\n\nprints\n\n```text\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    assert found is not None and certigym.__name__ in found[1]
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(found[1], "bounds.md", "exec"), {})
    assert printed.getvalue() == found[2]
