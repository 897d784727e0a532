"""The checker is read, run and trusted on its own: the standard library and numpy are all that it imports."""

from __future__ import annotations

import ast
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import certigym as cg
from certificate_files import changed, file_of, two_carts

FOLDER = Path(__file__).parents[2] / "synthesis" / "checker"
FILES = sorted(FOLDER.glob("*.py"))
MOST_LINES, MOST_IN_A_FILE = 5000, 325


def test_it_imports_the_standard_library_and_numpy_alone() -> None:
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""] if node.level == 0 else []
                assert node.level <= 1, f"{path.name} reaches beyond its folder"
            else:
                continue
            assert all(name.split(".")[0] in {*sys.stdlib_module_names, "numpy"} for name in names), path.name


def test_it_can_be_read_in_a_day() -> None:
    lines = {path.name: path.read_text(encoding="utf-8").count("\n") for path in FILES}
    assert sum(lines.values()) <= MOST_LINES
    assert max(lines.values()) <= MOST_IN_A_FILE, lines


def test_every_sabotage_changes_a_line_that_is_there() -> None:
    """Mutants (``benchmarks/checker_mutants.py``) whose line was written anew would sabotage nothing."""
    place = Path(__file__).parents[2] / "benchmarks" / "checker_mutants.py"
    spec = importlib.util.spec_from_file_location(place.stem, place)
    assert spec is not None and spec.loader is not None
    benchmark = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    texts = {path.stem: path.read_text(encoding="utf-8") for path in FILES}
    assert [mutant for mutant in benchmark.MUTANTS if mutant.old not in texts[mutant.file]] == []


def test_no_statement_of_it_vanishes_under_optimisation() -> None:
    """``assert`` states facts about the program's own cases, never about a file: Python may leave it out."""
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Assert):
                assert {name.id for name in ast.walk(node.test) if isinstance(name, ast.Name)} <= {"name"}, path.name


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-O", "-s", str(folder), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder.parent)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the folder, with nothing of the package around it."""
    return Path(shutil.copytree(FOLDER, tmp_path_factory.mktemp("alone") / "checker"))


@pytest.mark.thorough
def test_it_runs_from_its_folder_and_its_status_is_the_verdict(alone: Path, tmp_path: Path) -> None:
    header, arrays = two_carts()
    good, bad, none = (tmp_path / name for name in ("good.npz", "bad.npz", "none.npz"))
    good.write_bytes(file_of(header, arrays))
    bad.write_bytes(file_of(changed(header, ("claim", "failure"), 0.01), arrays))
    none.write_bytes(b"PK")
    done = run(alone, str(good))
    assert done.returncode == 0, done.stderr
    assert "PROVED: P >= 0.899999" in done.stdout and "trajectories" in done.stdout
    done = run(alone, str(bad))
    assert done.returncode == 1
    assert "a failure of at most 0.05361" in done.stdout and "not 0.01" in done.stdout and "goal_0" in done.stdout
    for path in (none, tmp_path / "missing.npz"):
        done = run(alone, str(path))
        assert done.returncode == 2 and "UNREADABLE" in done.stdout
    assert run(alone, str(good), str(bad), str(none)).returncode == 2


def test_files_beyond_a_size_are_not_read(alone: Path, tmp_path: Path) -> None:
    path = tmp_path / "large.npz"
    path.write_bytes(file_of(*two_carts()))
    done = run(alone, "--most-bytes", "1000", str(path))
    assert done.returncode == 2 and "more than 1000" in done.stdout


def test_the_verb_of_the_package_gives_the_same_verdict(tmp_path: Path) -> None:
    header, arrays = two_carts()
    path = tmp_path / "carts.npz"
    path.write_bytes(file_of(header, arrays))
    report = cg.check(path)
    assert report and report.claimed == pytest.approx(0.9) and 0.94 < report.recomputed < 0.95
    path.write_bytes(file_of(changed(header, ("claim", "failure"), 0.01), arrays))
    report = cg.check(path)
    assert not report and "most probable" in report.failures[0]
    with pytest.raises(ValueError, match="another one, with other horizon, agents"):
        cg.check(path, "integrator-chain-v0")
    with pytest.raises(ValueError, match="canonical form, which `check` reads"):
        cg.load(path)


def test_the_command_loads_no_simulation_for_a_file_of_its_form(tmp_path: Path) -> None:
    """``certigym check`` starts with the checker, the parser of options and names of environments."""
    path = tmp_path / "carts.npz"
    path.write_bytes(file_of(*two_carts()))
    code = f"""
import sys
from certigym.cli.main import main
main(["check", {str(path)!r}])
rest = "certigym.validation", "certigym.synthesis.certificates.proofs", "scipy", "gymnasium", "pettingzoo"
wrong = [name for name in sys.modules if name.startswith(rest)]
assert not wrong, wrong
"""
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    from certigym.cli.terminal import LABEL_WIDTH
    from certigym.validation import statistical_tests as simulation

    assert LABEL_WIDTH == simulation.LABEL_WIDTH
