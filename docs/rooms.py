"""The rooms of the package, as they are in the code: ``python docs/rooms.py`` writes the drawing in ``design.md``."""

from __future__ import annotations

import ast
import textwrap
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "design.md"
ORDER = {
    "envs": {
        "systems": "backends arguments distributions expressions agents",
        "tasks": "regions automata problem",
        "simulation": "",
        "interfaces": "",
        "suite": "single_agent multi_agent",
    },
    "synthesis": {
        "checker": "",
        "relations": "grids kinds",
        "certificates": "value_functions cell_probabilities controllers beliefs proofs",
        "abstraction": "kernels models",
        "extended_check": "vertex_grids steps claims shields",
        "interop": "",
        "trajectories": "chance_constraints words planning",
        "policy_search": "ascent bounds portfolio cell_certificates vertex_values",
        "composition": "",
        "verbs": "",
    },
    "validation": {"statistical_tests": "", "policies": "", "presentation": "paper reports figures studio"},
}
"""The rooms of each wing and the chapters of each room, each above all that it imports."""
WIDTH = 80
"""Columns of the drawing: as many as pages show without wrapping."""
BEGIN, END = "<!-- rooms -->\n", "<!-- end of rooms -->"


def folders(place: Path, order: list[str]) -> list[Path]:
    """Folders of a place that hold modules, in their order; one that the order does not name comes last."""
    found = {path.parent.name: path.parent for path in place.glob("*/__init__.py")}
    named = [name for name in order if name in found]
    return [found[name] for name in [*named, *sorted({*found} - {*named})]]


def rooms(wing: str) -> list[Path]:
    """Rooms of a wing, lowest first."""
    return folders(ROOT / wing, [*ORDER[wing]])


def chapters(room: Path) -> list[Path]:
    """Chapters of a room, lowest first; none where its files are in one folder."""
    return folders(room, ORDER[room.parent.name].get(room.name, "").split())


def sentence(room: Path) -> str:
    """First sentence of what a room says of itself."""
    text = ast.get_docstring(ast.parse((room / "__init__.py").read_text(encoding="utf-8"))) or ""
    return " ".join(text.split("\n\n")[0].split())


def neighbours(room: Path) -> list[str]:
    """Rooms of its wing that the files of a room import, in their order."""
    names = set[str]()
    for path in room.rglob("*.py"):
        depth = len(path.relative_to(room.parent).parts)  # so many dots lead from a file of the room to the wing
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == depth:
                names |= {node.module.split(".")[0]} if node.module else {alias.name for alias in node.names}
    return [other.name for other in rooms(room.parent.name) if other.name in names]


def entry(name: str, what: str, column: int) -> list[str]:
    """Lines of one name and what is said of it, from a column on."""
    first, *more = textwrap.wrap(what, WIDTH - column)
    return [f"{name:<{column}}{first}", *(f"{'':<{column}}{line}" for line in more)]


def drawing() -> str:
    """The tree of rooms, lowest first in every wing, as a fenced block."""
    lines = []
    for wing in ORDER:
        lines.append(f"{wing}/")
        for room in rooms(wing):
            lines += entry(f"  {room.name}/", sentence(room), 21)
            others = neighbours(room)
            lines += [f"{'':<21}{line}" for line in textwrap.wrap(f"[on {', '.join(others)}]", WIDTH - 21) if others]
            for chapter in chapters(room):
                lines += entry(f"    {chapter.name}/", sentence(chapter), 25)
        lines.append("")
    return "```text\n" + "\n".join(lines).rstrip() + "\n```\n"


def page(text: str) -> str:
    """The page with the drawing as it should be."""
    before, rest = text.split(BEGIN, 1)
    return before + BEGIN + drawing() + END + rest.split(END, 1)[1]


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
