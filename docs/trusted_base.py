"""Write the tables of ``trusted-base.md``: ``python3 docs/trusted_base.py``. A test compares the two.

What the check imports is read from the sources, so that a module which joins it must be put into one of the lists here.
"""

from __future__ import annotations

import ast
from pathlib import Path

PAGE = Path(__file__).with_name("trusted-base.md")
ROOT = PAGE.parents[1]
BEGIN, END = "<!-- trusted base, written by docs/trusted_base.py -->", "<!-- end of trusted base -->"
FIRST_BEGIN, FIRST_END = (
    "<!-- what to read first, written by docs/trusted_base.py -->",
    "<!-- end of what to read first -->",
)

CHECK = "synthesis.checking.certificate_check"

TRUSTED = {
    "What the problem means": (
        "envs.agents.agent envs.agents.any_agent envs.agents.box envs.agents.checks "
        "envs.agents.angles "
        "envs.agents.expression_agent envs.agents.composed_laws envs.agents.declared_names envs.agents.laws "
        "envs.agents.labeling envs.agents.majorants "
        "envs.agents.neighbours envs.agents.noise envs.agents.pair envs.agents.pieces "
        "envs.agents.products envs.agents.proposition envs.agents.shapes envs.agents.timed_corners "
        "envs.arrays.kept_memory envs.arrays.libraries envs.arrays.one_thread "
        "envs.expressions.affine_inputs envs.expressions.linear_systems "
        "envs.expressions.evaluation envs.expressions.reading "
        "envs.expressions.expression_tree envs.expressions.repeating "
        "envs.problem.families envs.problem.groups envs.problem.joint_noise envs.problem.opposite "
        "envs.problem.problem_file "
        "envs.problem.spelling envs.problem.record envs.problem.regions envs.problem.specification "
        "envs.problem.usual_horizon envs.problem.writing_out"
    ),
    "What the formula means": (
        "envs.logic.automaton envs.logic.decision_diagram envs.logic.formula envs.logic.guard_diagrams "
        "envs.logic.minimal envs.logic.normal_form envs.logic.obligations envs.logic.parser "
        "envs.logic.rebuilt envs.logic.translation envs.logic.windows"
    ),
    "What the certificate holds": (
        "synthesis.cells.axes_of_lattices synthesis.cells.corners synthesis.cells.grid synthesis.cells.grid_dynamics "
        "synthesis.cells.turned_starts "
        "synthesis.certificates.certificate synthesis.certificates.certificate_file "
        "synthesis.certificates.grid_reader synthesis.certificates.claim synthesis.masses.part "
        "synthesis.certificates.proof synthesis.certificates.grid_proof synthesis.certificates.path_proof "
        "synthesis.certificates.hull_proof synthesis.certificates.subtraction_proof "
        "synthesis.certificates.timed_proof "
        "synthesis.certificates.product_proof synthesis.certificates.seen "
        "synthesis.certificates.archive synthesis.certificates.written_values "
        "synthesis.values.terms"
    ),
    "What the controllers do": (
        "synthesis.cells.lookup synthesis.controllers.abstract_state synthesis.controllers.agent_controller "
        "synthesis.controllers.controller "
        "synthesis.controllers.path_controller synthesis.controllers.product_controller "
        ""
        "synthesis.controllers.timed_controller synthesis.controllers.told "
        "synthesis.controllers.steering synthesis.relations.coupled synthesis.relations.description "
        "synthesis.relations.affine_means synthesis.relations.coordinates "
        "synthesis.relations.ellipsoid_facts synthesis.relations.boxes synthesis.relations.commands "
        "synthesis.relations.common_means synthesis.relations.sectors "
        "synthesis.relations.input_forms synthesis.relations.solved_means "
        "synthesis.relations.exact synthesis.relations.networks synthesis.relations.rows "
        "synthesis.relations.written_means"
    ),
    "The check": (
        "synthesis.masses.checked_kernel synthesis.masses.checked_laws synthesis.masses.stated "
        "synthesis.checking.certificate_check synthesis.certificates.check_report "
        "synthesis.step_checking.carrying_out synthesis.step_checking.common_check synthesis.step_checking.execution "
        "synthesis.checking.forward_mass synthesis.step_checking.geometry synthesis.checking.grid_check "
        "synthesis.checking.guard_check synthesis.step_checking.boxes_check synthesis.step_checking.near_slack "
        "synthesis.step_checking.linear_check "
        "synthesis.step_checking.linear_tables synthesis.step_checking.mean_spans synthesis.step_checking.aim_spans "
        "synthesis.step_checking.map_spans synthesis.checking.network_check synthesis.step_checking.network_enclosures "
        "synthesis.checking.pair_moves "
        "synthesis.path_checking.own_intervals "
        "synthesis.checking.pairs_check synthesis.checking.opposite_task synthesis.path_checking.path_check "
        "synthesis.path_checking.hull_check synthesis.path_checking.own_bends "
        "synthesis.path_checking.law_moments synthesis.path_checking.linear_deviations "
        "synthesis.path_checking.nonlinear_check synthesis.path_checking.moving synthesis.path_checking.moment "
        "synthesis.path_checking.limits_kept synthesis.path_checking.crossings "
        "synthesis.path_checking.gaussian_inequalities "
        "synthesis.path_checking.pair_limits_check synthesis.path_checking.roundings "
        "synthesis.step_checking.checked_readings synthesis.checking.regrown_tree "
        "synthesis.step_checking.relation_check "
        "synthesis.path_checking.own_angles synthesis.path_checking.own_regions synthesis.path_checking.start_check "
        "synthesis.checking.timed_check "
        "synthesis.checking.train_check "
        "synthesis.step_checking.turned_boxes "
        "synthesis.step_checking.uniform_noise synthesis.checking.upper_end synthesis.step_checking.written_linear"
    ),
}
"""Modules in which a mistake could let a false claim pass."""

FIRST = {
    "synthesis.checking.certificate_check": "the order of the steps; nothing is called valid before all have passed",
    "synthesis.masses.part": "what a certificate holds of each agent: grid, labels, menu, policy, relation",
    "synthesis.certificates.grid_proof": "what it holds of all of them: guards, tree, value, bound",
    "synthesis.certificates.certificate": "the claim: a problem, a proof, and the two ends that are read from it",
    "synthesis.checking.grid_check": "cells tile the workspace, and each has the labels that hold in all of it",
    "synthesis.step_checking.geometry": "the boxes behind that: half-open, exact comparisons, no tolerance",
    "synthesis.checking.guard_check": "guards are disjoint products that lead where the automaton leads",
    "synthesis.step_checking.relation_check": "inputs are admissible in the whole cell, and lead to the claimed mean",
    "synthesis.step_checking.execution": "how far a controller in floating point can be off, from the matrices",
    "synthesis.step_checking.carrying_out": "the controllers themselves, run on thousands of points of their cells",
    "synthesis.masses.checked_kernel": "masses of cells, from below: the only probabilities that there are",
    "synthesis.step_checking.checked_readings": "how a factor is taken one step back, through these masses",
    "synthesis.checking.regrown_tree": "the recursion over time; a term that is dropped only lowers the sum",
    "synthesis.checking.forward_mass": "the same sum from the start on, for the upper end",
    "synthesis.checking.upper_end": "the upper end, where one is claimed",
    "synthesis.cells.lookup": "in which cell a state is",
    "synthesis.controllers.agent_controller": "which input the policy plays there",
    "synthesis.controllers.controller": "all agents, and the automaton that reads letters as they run",
}
"""What proves an ordinary certificate (cells, relation `exact`, a tree), in the order of reading, and what to ask."""

THEN = {
    "the problem itself": "envs.agents.agent envs.agents.noise envs.agents.proposition envs.agents.labeling "
    "envs.problem.specification envs.problem.record envs.problem.joint_noise",
    "the formula": "envs.logic.automaton envs.logic.parser envs.logic.normal_form envs.logic.obligations "
    "envs.logic.translation envs.logic.minimal",
    "files": "synthesis.certificates.certificate_file synthesis.certificates.grid_reader envs.problem.problem_file",
    "linear cells": "synthesis.step_checking.linear_check synthesis.step_checking.linear_tables "
    "synthesis.step_checking.written_linear synthesis.step_checking.map_spans synthesis.relations.affine_means",
    "mean boxes": "synthesis.step_checking.boxes_check synthesis.step_checking.near_slack "
    "synthesis.step_checking.mean_spans synthesis.step_checking.aim_spans synthesis.relations.boxes "
    "synthesis.relations.solved_means synthesis.relations.written_means",
    "networks": "synthesis.step_checking.network_enclosures synthesis.checking.network_check "
    "synthesis.checking.pair_moves synthesis.relations.networks",
    "tubes and ellipsoids": "synthesis.relations.coupled synthesis.relations.ellipsoid_facts "
    "synthesis.controllers.abstract_state",
    "noise of other laws": "envs.agents.laws envs.agents.composed_laws synthesis.masses.checked_laws "
    "synthesis.step_checking.uniform_noise",
    "tensor trains": "synthesis.checking.train_check",
    "paths": "synthesis.path_checking.path_check synthesis.path_checking.linear_deviations "
    "synthesis.path_checking.nonlinear_check synthesis.path_checking.own_intervals "
    "synthesis.path_checking.moving synthesis.path_checking.moment synthesis.path_checking.limits_kept "
    "synthesis.path_checking.crossings "
    "synthesis.path_checking.own_bends synthesis.path_checking.gaussian_inequalities "
    "synthesis.path_checking.law_moments synthesis.certificates.path_proof "
    "synthesis.controllers.path_controller",
    "pairs of agents, teams": "synthesis.checking.pairs_check "
    "synthesis.path_checking.pair_limits_check "
    "envs.agents.pair",
    "angles": "synthesis.path_checking.own_angles envs.agents.angles envs.expressions.repeating",
    "regions and dynamics in time": "synthesis.checking.timed_check envs.problem.writing_out",
}
"""What to read next, by what the certificate in hand is about."""

LINES_A_MINUTE = 15
"""How quickly code is read that is meant to be doubted."""

VERIFIED = (
    "envs.expressions.enclosure envs.expressions.intervals synthesis.relations.ellipsoid "
    "synthesis.relations.driven_means synthesis.relations.network_bounds synthesis.relations.network_maps "
    "synthesis.relations.rounding synthesis.relations.scalar synthesis.relations.tube "
    "synthesis.cells.noise_reach"
)
"""Modules that are loaded and whose results are verified: a mistake makes the check refuse, or changes nothing."""

BESIDE = (
    "envs.agents.printing envs.agents.saving "
    "envs.dynamics.blocks envs.dynamics.diagrams "
    "envs.dynamics.disturbances envs.dynamics.rules "
    "envs.dynamics.tables "
    "envs.dynamics.worlds envs.expressions.compiled envs.logic.by_hand envs.logic.hoa envs.logic.hoa_text "
    "envs.logic.mona "
    "envs.problem.summary synthesis.cells.refusal synthesis.cells.sizes synthesis.certificates.digits "
    "synthesis.certificates.given_certificate synthesis.masses.regrown_trains "
    "synthesis.certificates.result synthesis.certificates.summaries synthesis.values.devices "
    "synthesis.values.tensor_train synthesis.values.train_values synthesis.values.value_function"
)
"""Modules that are loaded with the others and that the check of a lower bound at the start does not use."""


def reached(first: str) -> set[str]:
    """Return the modules of the package that a module imports, itself included, however far."""
    found: set[str] = set()
    waiting = [first]
    while waiting:
        module = waiting.pop()
        if module not in found:
            found.add(module)
            waiting += [owner for where, name in _imports(module) if (owner := _owner(where, name)) is not None]
    return {module for module in found if _path(module).name != "__init__.py"}


def _path(module: str) -> Path:
    """Return the file of a module, or of a package."""
    path = ROOT / Path(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def _imports(module: str) -> list[tuple[str, str]]:
    """Return what a module takes from where, in this package; what is for type checkers alone is left out."""
    path = _path(module)
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []
    taken = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = package[: len(package) - node.level + 1] + (node.module.split(".") if node.module else [])
            taken += [(".".join(base), alias.name) for alias in node.names]
    return taken


def _owner(where: str, name: str) -> str | None:
    """Return the module in which a name is defined that was imported from a module or a package."""
    if _path(f"{where}.{name}").is_file():
        return f"{where}.{name}"
    if _path(where).name == "__init__.py":
        for other, taken in _imports(where):
            if taken == name:
                return _owner(other, name)
    return where if _path(where).is_file() else None


def lines_of(modules: str) -> list[tuple[str, int]]:
    """Return modules with their line counts."""
    return [(module, len(_path(module).read_text(encoding="utf-8").splitlines())) for module in modules.split()]


def first() -> str:
    """Return the table of what to read first, and that of what to read next."""
    counted = [(module, lines) for module in FIRST for _, lines in lines_of(module)]
    rows = ["| | module | lines | ask whether it is so |", "|---:|---|---:|---|"]
    for number, (module, lines) in enumerate(counted, 1):
        rows.append(f"| {number} | `{_short(module)}` | {lines} | {FIRST[module]} |")
    total = sum(lines for _, lines in counted)
    rows.append(f"| | **together** | **{total:,}** | at {LINES_A_MINUTE} lines a minute {_hours(total)} |")
    rows += ["", "| where your certificate is about | read next | lines |", "|---|---|---:|"]
    for kind, modules in THEN.items():
        names = ", ".join(f"`{_short(module)}`" for module in modules.split())
        rows.append(f"| {kind} | {names} | {sum(lines for _, lines in lines_of(modules)):,} |")
    return "\n".join(rows)


def _hours(lines: int) -> str:
    """Return how long lines take to read, in half hours."""
    return f"{round(lines / LINES_A_MINUTE / 30) / 2:g} hours"


def table() -> str:
    """Return the lists of all modules as they should stand on the page: sums first, then one table for each part."""
    parts = {
        **TRUSTED,
        "Loaded, and verified": VERIFIED,
        "Loaded, not used for a lower bound": BESIDE,
    }
    rows = ["| part | modules | lines |", "|---|---:|---:|"]
    for part, modules in parts.items():
        rows.append(f"| {part} | {len(modules.split())} | {_sum(modules):,} |")
        if part == list(TRUSTED)[-1]:
            count, total = (sum(f(modules) for modules in TRUSTED.values()) for f in (_count, _sum))
            rows.append(f"| **trusted** | **{count}** | **{total:,}** |")
    for part, modules in parts.items():
        rows += ["", f"### {part.replace('`', '')}", "", "| module | what it is | lines |", "|---|---|---:|"]
        rows += [f"| `{_short(module)}` | {_sentence(module)} | {lines} |" for module, lines in lines_of(modules)]
    return "\n".join(rows)


def _count(modules: str) -> int:
    return len(modules.split())


def _sum(modules: str) -> int:
    return sum(lines for _, lines in lines_of(modules))


def _short(module: str) -> str:
    """Return the last two names of a module."""
    return ".".join(module.split(".")[-2:])


def _sentence(module: str) -> str:
    """Return the first sentence that a module says of itself, as a cell of a table."""
    text = ast.get_docstring(ast.parse(_path(module).read_text(encoding="utf-8"))) or ""
    sentence = " ".join(text.split("\n\n")[0].split())
    return sentence.replace("``", "`").replace("|", "\\|")


def page(text: str) -> str:
    """Return the page with the tables of today."""
    for begin, end, body in ((FIRST_BEGIN, FIRST_END, first()), (BEGIN, END, table())):
        before, _, rest = text.partition(begin)
        _, _, after = rest.partition(end)
        text = f"{before}{begin}\n{body}\n{end}{after}"
    return text


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
