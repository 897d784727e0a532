"""The house keeps its plan: every file has a room, imports go down the table below and through doors, names are told
apart, and what checks a certificate reaches nothing that searches for one."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import rooms as drawn

ROOT = Path(__file__).parents[2]
WINGS = tuple(drawn.ORDER)

ENVS = "envs.arrays envs.expressions envs.agents envs.logic envs.problem envs.dynamics"
CERTIFICATES = (
    "synthesis.values synthesis.cells synthesis.relations synthesis.controllers synthesis.masses synthesis.certificates"
)
EVIDENCE = f"{ENVS} {CERTIFICATES} validation.statistics validation.simulation"

MAY_IMPORT = {
    "envs.arrays": "",
    "envs.expressions": "envs.arrays",
    "envs.agents": "envs.arrays envs.expressions",
    "envs.logic": "",
    "envs.problem": "envs.expressions envs.agents envs.logic",
    "envs.dynamics": "envs.arrays envs.expressions envs.agents envs.logic envs.problem",
    "envs.pictures": "envs.agents envs.logic envs.problem",
    "envs.interfaces": f"{ENVS} envs.pictures",
    "envs.solo": ENVS,
    "envs.teams": ENVS,
    "envs.suite": f"{ENVS} envs.interfaces",
    "synthesis.checker": "",
    "synthesis.values": "envs.arrays",
    "synthesis.cells": ENVS,
    "synthesis.relations": f"{ENVS} synthesis.cells",
    "synthesis.readings": f"{ENVS} synthesis.values synthesis.cells synthesis.relations",
    "synthesis.models": f"{ENVS} envs.suite synthesis.values synthesis.cells synthesis.relations synthesis.readings",
    "synthesis.search": f"{ENVS} synthesis.values synthesis.cells synthesis.models",
    "synthesis.bounds": f"{ENVS} synthesis.values synthesis.cells synthesis.relations synthesis.readings "
    "synthesis.models synthesis.search",
    "synthesis.controllers": f"{ENVS} synthesis.cells synthesis.relations",
    "synthesis.masses": f"{ENVS} synthesis.values synthesis.cells synthesis.relations",
    "synthesis.certificates": f"{ENVS} synthesis.values synthesis.cells synthesis.relations synthesis.controllers "
    "synthesis.masses synthesis.checker",
    "synthesis.bridges": f"{ENVS} envs.interfaces envs.suite synthesis.relations synthesis.controllers "
    "synthesis.certificates",
    "synthesis.step_checking": f"{ENVS} {CERTIFICATES}",
    "synthesis.checking": f"{ENVS} envs.suite {CERTIFICATES} synthesis.checker synthesis.step_checking",
    "synthesis.shielding": f"{ENVS} {CERTIFICATES} synthesis.step_checking synthesis.checking",
    "synthesis.choosing": f"{ENVS} {CERTIFICATES} synthesis.readings synthesis.models synthesis.search",
    "synthesis.path_bounds": f"{ENVS} {CERTIFICATES}",
    "synthesis.path_words": f"{ENVS} {CERTIFICATES} synthesis.path_bounds",
    "synthesis.nominal_paths": f"{ENVS} {CERTIFICATES} synthesis.checker synthesis.path_bounds synthesis.path_words",
    "synthesis.pairs": f"{ENVS} {CERTIFICATES} synthesis.models synthesis.search",
    "synthesis": f"{ENVS} envs.suite {CERTIFICATES} synthesis.checker synthesis.models synthesis.search "
    "synthesis.bounds synthesis.choosing synthesis.nominal_paths synthesis.pairs synthesis.checking synthesis.bridges",
    "validation.statistics": "",
    "validation.simulation": f"{ENVS} envs.suite synthesis.bridges",
    "validation.verdicts": f"{EVIDENCE} synthesis synthesis.checking",
    "validation.audits": f"{EVIDENCE} synthesis.checking",
    "validation.shields": f"{EVIDENCE} envs.interfaces envs.suite synthesis.bridges synthesis.shielding",
    "validation.policies": f"{EVIDENCE} envs.interfaces envs.suite synthesis synthesis.bridges synthesis.checking "
    "synthesis.shielding validation.shields",
    "validation.figures": f"{EVIDENCE} envs.pictures envs.suite synthesis synthesis.checking "
    "validation.verdicts validation.audits validation.policies",
    "validation.reports": f"{EVIDENCE} envs.pictures synthesis.checking validation.verdicts validation.audits",
    "validation.studio": f"{EVIDENCE} envs.pictures synthesis validation.reports",
    "validation.paper": f"{EVIDENCE} envs.pictures envs.suite synthesis synthesis.models "
    "synthesis.search synthesis.bounds validation.verdicts",
}
"""Rooms that the files of a room may import, lazily or for types alone, too; ``synthesis`` is its hall, the verbs."""

SEARCH = ("search", "readings", "models", "bounds", "choosing", "path_bounds", "path_words", "nominal_paths", "pairs")
"""Rooms that the check must not reach."""


@cache
def modules() -> dict[str, Path]:
    """All files of the house by their dotted names, packages by their own."""
    found = {}
    for wing in WINGS:
        for path in sorted((ROOT / wing).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def room_of(module: str) -> str:
    """The room that a module is in; a package is its own door."""
    return module if modules()[module].stem == "__init__" else module.rpartition(".")[0]


@cache
def import_nodes(text: str) -> tuple[ast.Import | ast.ImportFrom, ...]:
    """All imports of a text: most texts are asked about by every test here."""
    return tuple(node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import | ast.ImportFrom))


def imports(module: str) -> Iterator[tuple[str, str]]:
    """Everything of the house that a module imports anywhere, as (module, name)."""
    path = modules()[module]
    package = module.split(".") if path.stem == "__init__" else module.split(".")[:-1]
    for node in import_nodes(path.read_text(encoding="utf-8")):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
            assert not any(name.split(".")[0] in (*WINGS, "certigym") for name in names), f"{module} imports {names}"
        if isinstance(node, ast.ImportFrom):
            if node.level == 0:
                assert (node.module or "").split(".")[0] not in (*WINGS, "certigym"), f"{module}: relative imports only"
                continue
            base = ["certigym", *package][: len(package) + 2 - node.level][1:]
            target = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                full = f"{target}.{alias.name}".lstrip(".")
                yield (full, "") if full in modules() else (target, alias.name)


def test_every_file_is_in_a_room_of_the_table() -> None:
    doors = {name for name, path in modules().items() if path.stem == "__init__"} - {"envs", "validation"}
    assert doors == set(MAY_IMPORT)
    loose = [name for name in modules() if room_of(name) not in MAY_IMPORT and name not in ("envs", "validation")]
    assert loose == []


def test_imports_go_down_the_table() -> None:
    wrong = []
    for module in modules():
        if module == "envs":  # its door loads the modules of the suite by name
            continue
        room = room_of(module)
        for target, name in imports(module):
            if target == "" and name == "__version__":
                continue
            if room_of(target) not in (room, *MAY_IMPORT[room].split()):
                wrong.append(f"{module} imports {target}")
    assert wrong == []


def test_the_table_says_no_more_than_the_code_needs() -> None:
    used: dict[str, set[str]] = {room: set() for room in MAY_IMPORT}
    for module in modules():
        for target, _ in imports(module):
            if target and room_of(module) in used:
                used[room_of(module)].add(room_of(target))
    shared = {*ENVS.split(), *EVIDENCE.split()}  # named together, for brevity
    spare = {room: {*text.split()} - used[room] - shared for room, text in MAY_IMPORT.items()}
    assert {room: left for room, left in spare.items() if left} == {}


def test_other_rooms_are_entered_by_their_doors() -> None:
    wrong = []
    for module in modules():
        for target, name in imports(module):
            own = room_of(module)
            if target in ("", own) or room_of(target) == own or module == "envs":
                continue
            hall = room_of(target) == "synthesis"  # the verbs stand open
            if (
                modules()[target].stem != "__init__"
                and not hall
                and not (target == "envs.dynamics.worlds" and not name)
            ):
                wrong.append(f"{module} imports {name or 'the file'} from {target}")
    assert wrong == []


def test_no_imports_go_round_in_circles() -> None:
    graph = {module: {target for target, _ in imports(module) if target} for module in modules()}
    finished: set[str] = set()

    def visit(module: str, way: tuple[str, ...]) -> None:
        assert module not in way, " -> ".join([*way[way.index(module) :], module])
        if module not in finished:
            for target in sorted(graph[module]):
                if not (target == room_of(module) and modules()[target].stem == "__init__"):
                    visit(target, (*way, module))
            finished.add(module)

    for module in graph:
        visit(module, ())


def test_files_do_not_enter_their_own_room_by_the_door() -> None:
    wrong = [
        module
        for module in modules()
        for target, name in imports(module)
        if name and target == room_of(module) and modules()[module].stem != "__init__"
    ]
    assert wrong == []


def test_no_two_modules_share_a_name() -> None:
    # the checker is read on its own, imports nothing of the house, and has the plain words for its files
    names = Counter(name.rpartition(".")[2] for name in modules() if room_of(name) != "synthesis.checker")
    assert [name for name, count in names.items() if count > 1] == []


def test_doors_offer_nothing_under_the_name_of_a_file() -> None:
    """Else ``from room import name`` would give now the file, now what it holds."""
    for name, path in modules().items():
        if path.stem == "__init__":
            tree = ast.parse(path.read_text(encoding="utf-8"))
            offered = {a.asname or a.name for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) for a in n.names}
            assert offered & {file.stem for file in path.parent.glob("*.py")} == set(), name


def test_the_check_reaches_nothing_of_the_search() -> None:
    program = "import sys, certigym.synthesis.checking; print(*(name for name in sys.modules if 'certigym.' in name))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT / "src")
    loaded = done.stdout.split()
    assert "certigym.synthesis.checking" in loaded
    rooms = tuple(f"certigym.synthesis.{room}" for room in SEARCH)
    assert [name for name in loaded if name.startswith(rooms)] == []
    hall = [name for name in loaded if name.startswith("certigym.synthesis.") and name.count(".") == 2]
    assert {name.rpartition(".")[2] for name in hall} <= {room.name for room in drawn.rooms("synthesis")}


@pytest.mark.parametrize("statement", ["from ..search import sweep", "from ...validation.verdicts import validate"])
def test_the_table_would_refuse_the_search_in_the_check(
    statement: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "spy.py"
    path.write_text(f"def lazily():\n    {statement}\n")
    monkeypatch.setitem(modules(), "synthesis.checking.spy", path)
    with pytest.raises(AssertionError, match="spy"):
        test_imports_go_down_the_table()


def test_the_drawing_of_the_rooms_is_true() -> None:
    text = drawn.PAGE.read_text(encoding="utf-8")
    assert text == drawn.page(text), "design.md has drifted; run `python docs/rooms.py`"


def test_every_file_and_room_says_what_it_is() -> None:
    for name, path in modules().items():
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
        assert text and "TODO" not in text, name
