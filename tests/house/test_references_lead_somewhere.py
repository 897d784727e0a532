"""References in the code lead to a heading of a page: `docs/theory/NAME.md, "Heading"` exists, word by word."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]

WINGS = ("envs", "synthesis", "validation", "src")
"""Folders whose references are followed."""

FINISHED = ("envs", "validation", "src", "tests", "benchmarks", "examples", "docs")
"""Folders that no longer refer to a document outside the repository; the next one is `synthesis`."""

REFERENCE = re.compile(r'(docs/[\w/]+\.md)((?:(?:, | and |, and )"[^"]+")*)')
FORMER = re.compile(r"THEORY(?:\.md|\s+sections?\b)")


def files(folders: tuple[str, ...]) -> Iterator[Path]:
    """All Python files of some folders, without the folders that are linked into `src`."""
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if not any(parent.is_symlink() for parent in path.parents) and path != Path(__file__):
                yield path


def words(path: Path) -> str:
    """The text of a file with line breaks, also those within comments, as blanks."""
    return re.sub(r"\s*\n\s*(?:#+\s*)?", " ", path.read_text(encoding="utf-8"))


def headings(page: Path) -> set[str]:
    return set(re.findall(r"^#+ (.+?)\s*$", page.read_text(encoding="utf-8"), flags=re.MULTILINE))


def references(text: str) -> Iterator[tuple[str, list[str]]]:
    """Pages that a text refers to, each with the headings that it names."""
    for page, names in REFERENCE.findall(text):
        yield page, re.findall(r'"([^"]+)"', names)


def wrong_references(text: str) -> list[str]:
    wrong = []
    for page, names in references(text):
        if not (ROOT / page).is_file():
            wrong.append(page)
        else:
            wrong += [f'{page}, "{name}"' for name in names if name not in headings(ROOT / page)]
    return wrong


def test_every_reference_leads_to_a_heading() -> None:
    found = 0
    for path in files(WINGS):
        text = words(path)
        found += sum(1 for _ in references(text))
        assert wrong_references(text) == [], path.relative_to(ROOT)
    assert found >= 15


def test_nothing_refers_to_a_document_outside_the_repository() -> None:
    former = [str(path.relative_to(ROOT)) for path in files(FINISHED) if FORMER.search(words(path))]
    assert former == []


KINDS = "Theorem|Lemma|Proposition|Corollary"

STATEMENT = re.compile(rf"^\s*\*+({KINDS})(?: ([\w.]+))?(?: \([^)]*\))?\.\*+", flags=re.MULTILINE)
"""Where a statement is made: its name in bold or italics, at the beginning of a line."""

CITED = re.compile(rf"\b({KINDS}) (\d\w*|[A-Z][a-z]+\.\d+\w*)")


def statements(page: str, text: str) -> tuple[list[str], list[str]]:
    """Names of the statements of a page, such as ``Theorem Boxes.1``, and what is wrong with them."""
    found = [(kind, number or "") for kind, number in STATEMENT.findall(text)]
    wrong = [f"{page}: {kind} {number}" for kind, number in found if not re.fullmatch(rf"{page}\.\d+[a-z]?", number)]
    numbers = [number for _, number in found]
    wrong += [f"{page}: {number} twice" for number in {*numbers} if numbers.count(number) > 1]
    return [f"{kind} {number}" for kind, number in found], wrong


def test_statements_have_names_that_are_used_once() -> None:
    """The page is part of the name, so that no two pages share one; what is cited is there."""
    made, cited = set[str](), list[tuple[str, str]]()
    for page in sorted((ROOT / "docs" / "theory").glob("*.md")):
        text = page.read_text(encoding="utf-8")
        names, wrong = statements(page.stem.capitalize(), text)
        assert wrong == []
        made |= {*names}
    places = [*(ROOT / "docs").rglob("*.md"), *files(WINGS)]
    for path in places:
        if path.name not in ("changelog.md",):
            cited += [(str(path.relative_to(ROOT)), f"{kind} {number}") for kind, number in CITED.findall(words(path))]
    assert len(made) >= 30 and len(cited) >= len(made)
    assert [(path, name) for path, name in cited if name not in made] == []
