"""Names that the pages take from the package exist: a room that moves must not leave its old address behind."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
DIRECTIVE = re.compile(r"^\.\. (?:py:)?(currentmodule|auto\w+):: *([\w.]+)", re.MULTILINE)
DOTTED = re.compile(r"\bcertigym(?:\.[A-Za-z_]\w*)+(?![\w/-])")


def resolve(name: str) -> object:
    """The object of a dotted name; raises AttributeError or ImportError."""
    first, *rest = name.split(".")
    found: object = importlib.import_module(first)
    for at, part in enumerate(rest):
        if not hasattr(found, part):
            importlib.import_module(".".join([first, *rest[: at + 1]]))
        found = getattr(found, part)
    return found


@pytest.mark.parametrize("page", sorted((DOCS / "api").glob("*.md")), ids=lambda page: page.stem)
def test_directives_of_the_reference_resolve(page: Path) -> None:
    module = "certigym"
    for directive, name in DIRECTIVE.findall(page.read_text()):
        if directive == "currentmodule":
            module = name
        full = name if name.startswith("certigym.") else f"{module}.{name}"
        resolve(name if directive == "currentmodule" else full)


def test_dotted_names_of_the_pages_resolve() -> None:
    files = {"toml", "json", "yaml", "html", "npz", "csv", "md"}
    wrong = []
    for page in sorted(DOCS.rglob("*.md")):
        if "_build" in page.parts:
            continue
        for name in DOTTED.findall(page.read_text()):
            if name.rsplit(".", 1)[-1] in files or name == "certigym.NAME":
                continue
            try:
                resolve(name)
            except (AttributeError, ImportError):
                wrong.append(f"{page.relative_to(DOCS)}: {name}")
    assert not wrong, wrong
