"""Wheel and sdist hold one package, made of the folders, and work where they are installed; importing it is light."""

from __future__ import annotations

import importlib.metadata
import os
import runpy
import subprocess
import sys
import sysconfig
import tarfile
import venv
import zipfile
from pathlib import Path

import pytest

import certigym

ROOT = Path(__file__).parents[2]
FOLDERS = ("envs", "synthesis", "validation")
HEAVY = ("matplotlib", "torch", "pygame", "scipy.stats", "stable_baselines3", "PIL", "cvxpy")


def python(program: str, cwd: Path = ROOT, path: Path = ROOT / "src") -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(path)}
    return subprocess.run(
        [sys.executable, "-c", program], cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )


def build(kind: str, target: Path) -> Path:
    """Build an archive of the checkout."""
    command = [sys.executable, "-m", "hatchling", "build", "--target", kind, "--directory", str(target)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    (built,) = target.iterdir()
    return built


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("wheel", tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build("sdist", tmp_path_factory.mktemp("sdist"))


def installed(archive: Path, folder: Path) -> Path:
    """A new environment with the archive in it; its dependencies are those of this one, so no network is needed."""
    pytest.importorskip("pip")
    venv.create(folder, with_pip=False)
    binary = folder / ("Scripts" if os.name == "nt" else "bin")
    program = binary / "python"
    inside = {"base": str(folder), "platbase": str(folder)}
    site, here = (Path(sysconfig.get_path("purelib", vars=v)) for v in (inside, None))
    (site / "dependencies.pth").write_text(f"{here}\n", encoding="utf-8")  # of a path so named, .pth files do not count
    command = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        str(program),
        "install",
        "--quiet",
        "--no-deps",
        "--no-index",
        "--no-build-isolation",
        "--no-warn-script-location",
        str(archive),
    ]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return binary


def sources() -> dict[str, Path]:
    """Module files by their place in the package."""
    places = {"certigym": ROOT / "src" / "certigym"} | {f"certigym/{folder}": ROOT / folder for folder in FOLDERS}
    files = {}
    for name, place in places.items():
        for path in place.rglob("*"):
            if path.is_file() and "__pycache__" not in path.parts and not any(up.is_symlink() for up in path.parents):
                files[f"{name}/{path.relative_to(place).as_posix()}"] = path
    return files


def packed() -> dict[str, Path]:
    """Problems and numbers of the field's benchmarks, which wheels hold, too."""
    folder = ROOT / "benchmarks" / "arch"
    return {f"certigym/validation/presentation/paper/field/{path.name}": path for path in folder.glob("*.[jt]*")}


def test_the_wheel_holds_exactly_the_folders(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        inside = {name for name in archive.namelist() if ".dist-info/" not in name}
        expected = sources() | packed()
        assert inside == set(expected)
        for name, path in expected.items():
            assert archive.read(name) == path.read_bytes(), name
        extra = [name for name in archive.namelist() if name.endswith("entry_points.txt")]
        assert "certigym = certigym.cli.main:main" in archive.read(extra[0]).decode()


@pytest.mark.thorough
def test_the_wheel_works_without_the_checkout(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path / "site")
    said = python(
        "import certigym as cg; print(cg.__file__); print(cg.make_problem('reach-avoid-v0').n_agents)",
        cwd=tmp_path,
        path=tmp_path / "site",
    )
    assert said.returncode == 0, said.stderr
    assert said.stdout.split() == [str(tmp_path / "site" / "certigym" / "__init__.py"), "2"]


@pytest.mark.thorough
def test_archives_work_where_they_are_installed(sdist: Path, tmp_path: Path) -> None:
    """Of the sources a wheel is made, of the same files as the other one, and that is installed."""
    binary = installed(sdist, tmp_path / "environment")
    clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}

    def said(*words: str) -> str:
        done = subprocess.run(words, cwd=tmp_path, env=clean, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout

    command = str(binary / "certigym")
    where = said(str(binary / "python"), "-c", "import certigym; print(certigym.__file__)")
    assert (tmp_path / "environment").resolve() in Path(where.strip()).resolve().parents
    assert "COMMAND" in said(command, "--help")
    assert said(command, "--version").strip() == f"certigym {certigym.__version__}"
    report = said(
        command, "run", "reach-avoid-v0", "--horizon", "2", "--cells", "30", "--episodes", "500", "--out", "c.npz"
    )
    assert "PROVED P >= 0.2" in report and "CHECKED" in report
    assert "valid" in said(command, "check", "c.npz")
    assert "bas-7" in said(command, "reproduce", "arch", "--row", "bas-7")  # status 0: as it was recorded


def test_the_sdist_is_the_repository(sdist: Path) -> None:
    """Everything that is tracked is in it, but for what belongs to the repository alone."""
    if not (ROOT / ".git").exists():
        pytest.skip("needs the repository")
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout.split(
        "\n"
    )
    tracked = {name for name in listed if name and not name.startswith((".ci/", "src/certigym/envs"))}
    links = {f"src/certigym/{folder}" for folder in FOLDERS}
    with tarfile.open(sdist) as archive:
        inside = {name.partition("/")[2] for name in archive.getnames()}
    assert tracked - links - inside == set()


def test_the_package_is_typed(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        assert "certigym/py.typed" in archive.namelist()
        (metadata,) = (name for name in archive.namelist() if name.endswith("/METADATA"))
        assert "Classifier: Typing :: Typed" in archive.read(metadata).decode()


@pytest.mark.thorough
def test_a_checkout_without_links_finds_its_folders(tmp_path: Path) -> None:
    for path in sources().values():
        place = tmp_path / path.relative_to(ROOT)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_bytes(path.read_bytes())
    (tmp_path / "pyproject.toml").write_bytes((ROOT / "pyproject.toml").read_bytes())
    program = "import certigym as cg; print(cg.make_problem('invariance-4-v0').n_agents)"
    said = python(program, tmp_path, tmp_path / "src")
    assert said.stdout.strip() == "4", said.stderr


@pytest.mark.thorough
def test_importing_certigym_is_light() -> None:
    said = python(f"import sys, certigym; print([name for name in {HEAVY!r} if name in sys.modules])")
    assert said.stdout.strip() == "[]", said.stderr
    said = python(
        "import sys, certigym as cg; [getattr(cg, name) for name in cg.__all__];"
        f"cg.parallel_env('reach-avoid-v0').reset(seed=0); print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    assert said.stdout.strip() == "[]", said.stderr


@pytest.mark.parametrize("folder", FOLDERS)
def test_folders_refuse_to_be_imported_by_their_bare_names(folder: str) -> None:
    said = python(f"import {folder}", path=ROOT)
    assert said.returncode != 0
    assert f"ImportError: import `certigym.{folder}`, not `{folder}`" in said.stderr


def test_every_exported_name_exists_and_is_listed() -> None:
    for name in certigym.__all__:
        assert getattr(certigym, name) is not None
        assert name in dir(certigym)
    with pytest.raises(AttributeError, match="attribute nothing"):
        certigym.nothing  # type: ignore[attr-defined]  # noqa: B018


def test_type_checkers_see_the_exported_names() -> None:
    text = (ROOT / "src" / "certigym" / "__init__.pyi").read_text(encoding="utf-8")
    for name in certigym.__all__:
        if name != "__version__":
            assert f"{name} as {name}" in text, name


def test_versions_agree() -> None:
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert f'version = "{certigym.__version__}"' in project
    assert f"\nversion: {certigym.__version__}\n" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"## {certigym.__version__} (" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_pages_have_the_version_of_the_installed_package(monkeypatch: pytest.MonkeyPatch) -> None:
    assert importlib.metadata.version("certigym") == certigym.__version__
    monkeypatch.setattr(importlib.metadata, "version", {"certigym": "9.8.7"}.__getitem__)
    monkeypatch.setattr(sys, "path", [*sys.path])
    settings = runpy.run_path(str(ROOT / "docs" / "conf.py"))
    assert settings["release"] == "9.8.7" and settings["html_title"] == "certigym 9.8.7"
