"""Write the table of ``trusted-base.md``: ``python3 docs/trusted_base.py``. A test compares the two.

What the check imports is read from the sources, so that a module which joins it must be put into one of the lists here.
"""

from __future__ import annotations

import ast
from pathlib import Path

PAGE = Path(__file__).with_name("trusted-base.md")
ROOT = PAGE.parents[1]
BEGIN, END = "<!-- trusted base, written by docs/trusted_base.py -->", "<!-- end of trusted base -->"

CHECK, RIGOROUS = "synthesis.checking.certificate_check", "synthesis.balls.rigorous"

TRUSTED = {
    "What the problem means": (
        "envs.agents.agent envs.agents.any_agent envs.agents.box envs.agents.checks "
        "envs.agents.expression_agent envs.agents.composed_laws envs.agents.declared_names envs.agents.laws "
        "envs.agents.labeling "
        "envs.agents.neighbours envs.agents.noise envs.agents.pair envs.agents.pieces "
        "envs.agents.products envs.agents.proposition envs.agents.shapes envs.arrays.libraries "
        "envs.expressions.affine_inputs envs.expressions.linear_systems "
        "envs.expressions.evaluation envs.expressions.reading "
        "envs.expressions.expression_tree envs.problem.families envs.problem.groups envs.problem.problem_file "
        "envs.problem.record envs.problem.regions envs.problem.specification envs.problem.writing_out"
    ),
    "What the formula means": (
        "envs.logic.automaton envs.logic.decision_diagram envs.logic.formula envs.logic.guard_diagrams "
        "envs.logic.minimal envs.logic.normal_form envs.logic.obligations envs.logic.parser "
        "envs.logic.rebuilt envs.logic.translation"
    ),
    "What the certificate holds": (
        "synthesis.cells.axes_of_lattices synthesis.cells.corners synthesis.cells.grid synthesis.cells.grid_dynamics "
        "synthesis.certificates.certificate synthesis.certificates.certificate_file "
        "synthesis.certificates.certificate_reader synthesis.certificates.claim synthesis.certificates.part "
        "synthesis.certificates.pairs_certificate synthesis.certificates.pairs_file "
        "synthesis.certificates.path_certificate "
        "synthesis.certificates.path_file synthesis.certificates.start_hull synthesis.certificates.hull_file "
        "synthesis.certificates.product synthesis.certificates.team_certificate "
        "synthesis.certificates.timed_certificate synthesis.values.terms"
    ),
    "What the controllers do": (
        "synthesis.cells.lookup synthesis.controllers.abstract_state synthesis.controllers.agent_controller "
        "synthesis.controllers.controller synthesis.controllers.path_controller "
        "synthesis.controllers.product_controller synthesis.controllers.team_controller "
        "synthesis.controllers.timed_controller synthesis.controllers.told "
        "synthesis.controllers.steering synthesis.relations.coupled synthesis.relations.description "
        "synthesis.relations.affine_means synthesis.relations.aims synthesis.relations.coordinates "
        "synthesis.relations.ellipsoid_facts synthesis.relations.boxes synthesis.relations.commands "
        "synthesis.relations.common_means synthesis.relations.sectors "
        "synthesis.relations.input_forms synthesis.relations.solved_means "
        "synthesis.relations.exact synthesis.relations.linear synthesis.relations.networks synthesis.relations.rows "
        "synthesis.relations.written_means"
    ),
    "The check": (
        "synthesis.certificates.checked_kernel synthesis.certificates.checked_laws synthesis.certificates.stated "
        "synthesis.checking.certificate_check "
        "synthesis.checking.carrying_out synthesis.checking.common_check synthesis.checking.execution "
        "synthesis.checking.forward_mass synthesis.checking.geometry synthesis.checking.grid_check "
        "synthesis.checking.guard_check synthesis.checking.boxes_check synthesis.checking.linear_check "
        "synthesis.checking.linear_tables synthesis.checking.mean_spans synthesis.checking.aim_spans "
        "synthesis.checking.network_spans "
        "synthesis.path_checking.own_intervals synthesis.checking.pairs_check synthesis.path_checking.path_check "
        "synthesis.path_checking.hull_check synthesis.path_checking.own_bends "
        "synthesis.path_checking.law_moments synthesis.path_checking.linear_deviations "
        "synthesis.path_checking.nonlinear_check synthesis.path_checking.gaussian_inequalities "
        "synthesis.path_checking.pair_limits_check synthesis.path_checking.roundings "
        "synthesis.checking.readings synthesis.checking.regrown_tree synthesis.checking.relation_check "
        "synthesis.path_checking.own_regions synthesis.path_checking.start_check "
        "synthesis.checking.team_check synthesis.checking.timed_check "
        "synthesis.checking.train_check "
        "synthesis.checking.uniform_noise synthesis.checking.upper_end synthesis.checking.written_linear"
    ),
}
"""Modules in which a mistake could let a false claim pass."""

VERIFIED = (
    "envs.expressions.enclosure envs.expressions.intervals synthesis.relations.ellipsoid "
    "synthesis.relations.network_bounds synthesis.relations.network_maps "
    "synthesis.relations.rounding synthesis.relations.scalar synthesis.relations.tube"
)
"""Modules that are loaded and whose results are verified: a mistake makes the check refuse, or changes nothing."""

BESIDE = (
    "envs.agents.printing envs.agents.saving "
    "envs.dynamics.blocks envs.dynamics.diagrams "
    "envs.dynamics.disturbances envs.dynamics.rules "
    "envs.dynamics.tables "
    "envs.dynamics.worlds envs.logic.by_hand envs.logic.hoa envs.logic.hoa_text envs.logic.mona "
    "envs.problem.summary synthesis.cells.refusal synthesis.cells.sizes synthesis.certificates.digits "
    "synthesis.certificates.given_certificate synthesis.certificates.regrown_trains "
    "synthesis.certificates.result synthesis.certificates.summaries synthesis.values.devices "
    "synthesis.values.tensor_train synthesis.values.train_values synthesis.values.value_function"
)
"""Modules that are loaded with the others and that the check of a lower bound at the start does not use."""

BALLS = (
    "synthesis.balls.ball_masses synthesis.balls.ball_memory synthesis.balls.ball_numbers synthesis.balls.ball_proofs "
    "synthesis.balls.ball_relations synthesis.balls.ball_spans synthesis.balls.ball_sums synthesis.balls.rigorous"
)
"""Modules that ``check --rigorous`` adds."""


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


def table() -> str:
    """Return the table as it should stand on the page."""
    rows = ["| part | modules | lines |", "|---|---|---:|"]
    total = 0
    for part, modules in TRUSTED.items():
        counted = lines_of(modules)
        total += sum(n for _, n in counted)
        rows.append(f"| {part} | {_listed(counted)} | {sum(n for _, n in counted):,} |")
    rows.append(
        f"| **trusted** | {sum(len(modules.split()) for modules in TRUSTED.values())} modules | **{total:,}** |"
    )
    for part, modules in (("loaded, and verified", VERIFIED), ("loaded, not used for a lower bound", BESIDE)):
        counted = lines_of(modules)
        rows.append(f"| {part} | {_listed(counted)} | {sum(n for _, n in counted):,} |")
    extra = lines_of(BALLS)
    rows.append(f"| `check --rigorous`, on top | {_listed(extra)} | {sum(n for _, n in extra):,} |")
    return "\n".join(rows)


def _listed(counted: list[tuple[str, int]]) -> str:
    """Return modules with their lines, by their last two names."""
    return ", ".join(f"`{'.'.join(module.split('.')[-2:])}` {n}" for module, n in counted)


def page(text: str) -> str:
    """Return the page with the table of today."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{table()}\n{END}{after}"


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
