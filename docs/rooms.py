"""The rooms of the package, as they are in the code: ``python docs/rooms.py`` writes the drawing in ``design.md``."""

from __future__ import annotations

import ast
import textwrap
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "design.md"
ORDER = {
    "envs": "arrays expressions agents logic problem dynamics pictures interfaces solo teams suite",
    "synthesis": "checker cells relations values readings models search bounds choosing path_bounds path_words "
    "nominal_paths pairs controllers masses certificates bridges path_checking step_checking checking shielding",
    "validation": "statistics simulation verdicts audits shields policies figures reports studio paper",
}
"""The rooms of each wing, in the order in which a problem passes through them."""
WIDTH = 80
"""Columns of the drawing: as many as pages show without wrapping."""
BEGIN, END = "<!-- rooms -->\n", "<!-- end of rooms -->"


def rooms(wing: str) -> list[Path]:
    """Folders of a wing that hold modules, in their order; one that the order does not name comes last."""
    found = {path.parent.name: path.parent for path in (ROOT / wing).glob("*/__init__.py")}
    named = [name for name in ORDER[wing].split() if name in found]
    return [found[name] for name in [*named, *sorted({*found} - {*named})]]


def sentence(room: Path) -> str:
    """First sentence of what a room says of itself."""
    text = ast.get_docstring(ast.parse((room / "__init__.py").read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())


def files(room: Path) -> list[str]:
    """Modules of a room; of the suite without the files of single problems."""
    return [path.stem for path in sorted(room.glob("*.py")) if path.stem != "__init__" and not path.stem[-1].isdigit()]


def drawing() -> str:
    """The tree of rooms, lowest first in every wing, as a fenced block."""
    lines = []
    for wing in ORDER:
        lines.append(f"{wing}/")
        hall = [path.stem for path in sorted((ROOT / wing).glob("*.py")) if path.stem != "__init__"]
        entries = [(f"{room.name}/", sentence(room), files(room)) for room in rooms(wing)]
        if hall:
            entries.append(("(hall)", "The verbs.", hall))
        for name, what, modules in entries:
            first, *more = textwrap.wrap(what, WIDTH - 18)
            lines.append(f"    {name:<14}{first}")
            lines += [f"    {'':<14}{line}" for line in more]
            lines += [f"    {'':<14}    {line}" for line in textwrap.wrap(" ".join(modules), WIDTH - 22)]
        lines.append("")
    return "```text\n" + "\n".join(lines).rstrip() + "\n```\n"


def page(text: str) -> str:
    """The page with the drawing as it should be."""
    before, rest = text.split(BEGIN, 1)
    return before + BEGIN + drawing() + END + rest.split(END, 1)[1]


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
