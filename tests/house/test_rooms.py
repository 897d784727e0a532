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

ENVS = "envs.systems envs.tasks envs.simulation"
CERTIFICATES = "synthesis.relations synthesis.certificates"
EVIDENCE = f"{ENVS} {CERTIFICATES}"

MAY_IMPORT = {
    "envs.systems.backends": "",
    "envs.systems.arguments": "",
    "envs.systems.distributions": "envs.systems.backends envs.systems.arguments",
    "envs.systems.expressions": "envs.systems.backends",
    "envs.systems.agents": "envs.systems.backends envs.systems.arguments envs.systems.distributions "
    "envs.systems.expressions",
    "envs.tasks.regions": "envs.systems",
    "envs.tasks.automata": "",
    "envs.tasks.problem": "envs.systems envs.tasks.regions envs.tasks.automata",
    "envs.simulation": "envs.systems envs.tasks",
    "envs.interfaces": ENVS,
    "envs.suite": f"{ENVS} envs.interfaces",
    "envs.suite.single_agent": "envs.systems envs.tasks",
    "envs.suite.multi_agent": "envs.systems envs.tasks",
    "synthesis.checker": "",
    "synthesis.relations.grids": ENVS,
    "synthesis.relations.kinds": f"{ENVS} synthesis.relations.grids",
    "synthesis.certificates.value_functions": "",
    "synthesis.certificates.cell_probabilities": f"{ENVS} synthesis.relations synthesis.certificates.value_functions",
    "synthesis.certificates.controllers": f"{ENVS} synthesis.relations",
    "synthesis.certificates.beliefs": "synthesis.checker",
    "synthesis.certificates.proofs": f"{ENVS} synthesis.checker synthesis.relations "
    "synthesis.certificates.beliefs synthesis.certificates.value_functions synthesis.certificates.cell_probabilities "
    "synthesis.certificates.controllers",
    "synthesis.abstraction.kernels": f"{ENVS} synthesis.relations synthesis.certificates.value_functions",
    "synthesis.abstraction.models": f"{ENVS} synthesis.relations synthesis.certificates.value_functions "
    "synthesis.abstraction.kernels",
    "synthesis.extended_check.vertex_grids": "envs.systems.distributions synthesis.certificates.cell_probabilities "
    "synthesis.checker",
    "synthesis.extended_check.steps": f"{ENVS} {CERTIFICATES}",
    "synthesis.extended_check.claims": f"{ENVS} envs.suite {CERTIFICATES} synthesis.checker "
    "synthesis.extended_check.vertex_grids synthesis.extended_check.steps",
    "synthesis.extended_check.shields": f"{ENVS} {CERTIFICATES} synthesis.extended_check.steps "
    "synthesis.extended_check.claims",
    "synthesis.interop": f"{ENVS} envs.interfaces envs.suite {CERTIFICATES}",
    "synthesis.trajectories.chance_constraints": f"{ENVS} {CERTIFICATES}",
    "synthesis.trajectories.words": f"{ENVS} {CERTIFICATES} synthesis.trajectories.chance_constraints",
    "synthesis.trajectories.planning": f"{ENVS} {CERTIFICATES} synthesis.checker "
    "synthesis.trajectories.chance_constraints synthesis.trajectories.words",
    "synthesis.policy_search.ascent": f"{ENVS} synthesis.relations synthesis.certificates.value_functions "
    "synthesis.abstraction.models",
    "synthesis.policy_search.bounds": f"{ENVS} synthesis.relations synthesis.certificates.value_functions "
    "synthesis.abstraction synthesis.policy_search.ascent",
    "synthesis.policy_search.portfolio": f"{ENVS} {CERTIFICATES} synthesis.abstraction synthesis.policy_search.ascent",
    "synthesis.policy_search.cell_certificates": f"{ENVS} {CERTIFICATES} synthesis.abstraction.models "
    "synthesis.extended_check.claims synthesis.trajectories.planning synthesis.policy_search.ascent "
    "synthesis.policy_search.bounds synthesis.policy_search.portfolio",
    "synthesis.policy_search.vertex_values": f"{ENVS} {CERTIFICATES} synthesis.checker synthesis.abstraction.models "
    "synthesis.extended_check.vertex_grids synthesis.trajectories.planning synthesis.policy_search.ascent",
    "synthesis.composition": f"{ENVS} {CERTIFICATES} synthesis.abstraction.models synthesis.extended_check.claims "
    "synthesis.trajectories.planning synthesis.policy_search.ascent synthesis.policy_search.portfolio "
    "synthesis.policy_search.cell_certificates",
    "synthesis.verbs": f"{ENVS} envs.suite {CERTIFICATES} synthesis.checker synthesis.abstraction.models "
    "synthesis.extended_check.claims synthesis.interop synthesis.trajectories.planning synthesis.policy_search.ascent "
    "synthesis.policy_search.portfolio synthesis.policy_search.cell_certificates "
    "synthesis.policy_search.vertex_values synthesis.composition",
    "validation.statistical_tests": f"{EVIDENCE} envs.suite synthesis.extended_check.claims synthesis.interop "
    "synthesis.composition synthesis.verbs",
    "validation.policies": f"{EVIDENCE} envs.interfaces envs.suite synthesis.extended_check.claims "
    "synthesis.extended_check.shields synthesis.interop synthesis.verbs validation.statistical_tests",
    "validation.presentation.paper": f"{EVIDENCE} envs.interfaces envs.suite synthesis.abstraction.models "
    "synthesis.checker synthesis.interop synthesis.policy_search.ascent synthesis.policy_search.bounds "
    "synthesis.verbs validation.statistical_tests",
    "validation.presentation.reports": f"{EVIDENCE} envs.interfaces synthesis.extended_check.claims "
    "validation.statistical_tests",
    "validation.presentation.figures": f"{EVIDENCE} envs.interfaces envs.suite synthesis.extended_check.claims "
    "validation.statistical_tests validation.policies",
    "validation.presentation.studio": f"{EVIDENCE} envs.interfaces synthesis.verbs validation.statistical_tests "
    "validation.presentation.reports validation.presentation.figures",
}
"""Rooms and chapters that files of one may import, lazily or for types, too; a room stands for its chapters."""

SEARCH = ("abstraction", "trajectories", "policy_search", "composition", "verbs")
"""Rooms that the check must not reach."""

OPEN = ("synthesis.verbs",)
"""Rooms whose files are entered directly: a verb is a file, which loads what it needs."""

LEMMAS = {"synthesis.extended_check.vertex_grids": "synthesis.checker"}
"""Chapters that are written on the checker's own files, as its modules are: intervals, jets."""


WORDS = (
    "Bellman backup, value iteration, product automaton, DFA, LTL, reachable set, chance constraint, feedback gain, "
    "linearization error, constraint tightening, trajectory, occupancy, simulation relation, action value, union bound"
)
"""What experts of control, formal methods and learning look for, each in the first line of the room where it lives."""


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
    """The folder that a module is in: a chapter, or a room without chapters; a package is its own door."""
    return module if modules()[module].stem == "__init__" else module.rpartition(".")[0]


def whole(room: str) -> str:
    """The room that a chapter belongs to."""
    return ".".join(room.split(".")[:2])


def listed(room: str, names: str) -> bool:
    """Whether a room or chapter is among names, by itself or with its room."""
    return room in names.split() or whole(room) in names.split()


def arrows(wing: str) -> dict[str, set[str]]:
    """Rooms of a wing, and the rooms of the same wing that each one imports."""
    found: dict[str, set[str]] = {f"{wing}.{room.name}": set() for room in drawn.rooms(wing)}
    for module in modules():
        if whole(module) in found:
            targets = {whole(target) for target, _ in imports(module) if target}
            found[whole(module)] |= (targets & {*found}) - {whole(module)}
    return found


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
    doors = {name for name, path in modules().items() if path.stem == "__init__"} - {*WINGS}
    rooms_of_chapters = {whole(room) for room in MAY_IMPORT} - {*MAY_IMPORT}
    assert doors == {*MAY_IMPORT} | rooms_of_chapters
    loose = [name for name in modules() if room_of(name) not in {*MAY_IMPORT, *rooms_of_chapters, *WINGS}]
    assert loose == []
    for room in rooms_of_chapters:  # all their files are in chapters, which are entered one by one
        assert [*imports(room)] == [] and not [*modules()[room].parent.glob("[!_]*.py")], room


def test_the_house_is_small() -> None:
    """Ten rooms on six floors at most, at most forty arrows, and no folder of more than 24 files."""
    for wing, most_rooms, most_floors, most_arrows in (
        ("envs", 5, 5, 10),
        ("synthesis", 10, 6, 40),
        ("validation", 3, 3, 3),
    ):
        graph = arrows(wing)
        assert len(graph) <= most_rooms and sum(map(len, graph.values())) <= most_arrows, wing
        floors, left = 0, {*graph}
        while left:
            ground = {room for room in left if not graph[room] & left}
            assert ground, f"rooms import one another in a circle: {sorted(left)}"
            left -= ground
            floors += 1
        assert floors <= most_floors, wing
        assert len([*(ROOT / wing).glob("*.py")]) <= 5, wing
    for room in {room_of(module) for module in modules()} - {"synthesis.checker"}:  # which is counted in lines
        assert sum(room_of(module) == room for module in modules()) <= 24, room


def test_imports_go_down_the_table() -> None:
    wrong = []
    for module in modules():
        if module == "envs":  # its door loads the modules of the suite by name
            continue
        room = room_of(module)
        for target, name in imports(module):
            if target == "" and name == "__version__":
                continue
            if room_of(target) != room and not listed(room_of(target), MAY_IMPORT[room]):
                wrong.append(f"{module} imports {target}")
    assert wrong == []


def test_the_table_says_no_more_than_the_code_needs() -> None:
    used: dict[str, set[str]] = {room: set() for room in MAY_IMPORT}
    for module in modules():
        for target, _ in imports(module):
            if target and room_of(module) in used:
                used[room_of(module)] |= {room_of(target), whole(target)}
    shared = {*EVIDENCE.split()}  # named together, for brevity
    spare = {room: {*text.split()} - used[room] - shared for room, text in MAY_IMPORT.items()}
    assert {room: left for room, left in spare.items() if left} == {}


def test_other_rooms_are_entered_by_their_doors() -> None:
    wrong = []
    for module in modules():
        for target, name in imports(module):
            own = room_of(module)
            if target in ("", own) or room_of(target) == own or module == "envs":
                continue
            if (
                modules()[target].stem != "__init__"
                and room_of(target) not in (*OPEN, LEMMAS.get(own))
                and not (target == "envs.simulation.batch_simulator" and not name)
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
    check = "certigym.synthesis.extended_check.claims"
    program = f"import sys, {check}; print(*(name for name in sys.modules if 'certigym.' in name))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT / "src")
    loaded = done.stdout.split()
    assert check in loaded
    rooms = tuple(f"certigym.synthesis.{room}" for room in SEARCH)
    assert [name for name in loaded if name.startswith(rooms)] == []
    hall = [name for name in loaded if name.startswith("certigym.synthesis.") and name.count(".") == 2]
    assert {name.rpartition(".")[2] for name in hall} <= {room.name for room in drawn.rooms("synthesis")}


@pytest.mark.parametrize(
    "statement", ["from ...policy_search.ascent import sweep", "from ....validation.statistical_tests import validate"]
)
def test_the_table_would_refuse_the_search_in_the_check(
    statement: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "spy.py"
    path.write_text(f"def lazily():\n    {statement}\n")
    monkeypatch.setitem(modules(), "synthesis.extended_check.claims.spy", path)
    with pytest.raises(AssertionError, match="spy"):
        test_imports_go_down_the_table()


def test_the_drawing_of_the_rooms_is_true() -> None:
    text = drawn.PAGE.read_text(encoding="utf-8")
    assert text == drawn.page(text), "design.md has drifted; run `python docs/rooms.py`"


def test_every_file_and_room_says_what_it_is() -> None:
    for name, path in modules().items():
        before, text, *_ = path.read_text(encoding="utf-8").split('"""', 2)
        assert all(line.startswith("#") for line in before.splitlines()), name
        assert text and "TODO" not in text, name


@pytest.mark.parametrize("word", WORDS.split(", "))
def test_experts_find_their_words(word: str) -> None:
    doors = [path.read_text(encoding="utf-8") for path in modules().values() if path.stem == "__init__"]
    assert any(word.lower() in text.split("\n", 1)[0].lower() for text in doors)
