"""Every code block of README and documentation runs: Python, commands, problem files; and every link leads somewhere.

Blocks of a page share one namespace and one folder. `python` and `console` blocks (lines after `$ `, whose exit status
is 0 or the one that a comment announces) are executed; `toml` blocks are read as problems and saved under the name that
the page uses; `sh` blocks hold commands that need a cluster, a network or long times: their `certigym` lines must be
understood by the command line. Other blocks hold words.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest

import certigym as cg
import draw_figures
from certigym.cli.main import build_parser, main
from certigym.envs.tasks.problem.problem_file import problem_from_toml
from certigym.synthesis.policy_search.portfolio import effort
from certigym.validation.presentation.figures import certificate_figures as figures
from certigym.validation.presentation.figures import figure_scenes

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]
PAGES = [page for page in PAGES if "_build" not in page.parts]
WORDS = {"text", "toml", "python", "console", "sh", "bibtex"}
FENCE = re.compile(r"^```([^\n`]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


FINDING = {"how_do_i_say.md": 8.0}
"""Effort of pages that say how much is found by default."""

QUICKER: dict[str, dict[str, str]] = {
    "boxes.md": {"(problem, 28,": "(problem, 12,", "episodes=20_000": "episodes=2_000"},
    "bring_your_own_controller.md": {
        "cells=300": "cells=200",
        "episodes=4000": "episodes=1000",
    },
    "choose_cells.md": {
        "(25, 100, 400)": "(25, 50)",
        "cells=100)": "cells=50)",
        "(problem, 100": "(problem, 60",
    },
    "figures.md": {"--cells 200": "--cells 40", "--cells 100": "--cells 40"},
    "learned_policies.md": {"steps=4_000": "steps=512", "steps=2_000": "steps=512", "episodes=4000": "episodes=1000"},
    "many_agents.md": {
        "(problem, 20)": "(problem, 10)",
        "5_000": "1_000",
        '"invariance-b-20-v0", 100': '"invariance-b-20-v0", 40',
    },
    "networks.md": {"steps=2_000": "steps=512"},
    "probe.md": {"episodes=5000, steps=2000": "episodes=500, steps=256"},
    "scale_out.md": {"--episodes 100000": "--episodes 10000", "200_000": "20_000"},
    "my_robot.md": {"(0.04, 0.06)": "(0.04,)"},
    "safety_filter.md": {"steps=8_000": "steps=512", "episodes=4000": "episodes=500"},
    "sb3_policy.md": {"30_000": "4_096", "episodes=4000": "episodes=500"},
    "validate.md": {"--episodes 100000": "--episodes 20000", "--episodes 200000": "--episodes 20000"},
}
"""Numbers of pages that say how long something takes, and smaller ones with which it is run here."""


def blocks(page: Path) -> list[tuple[str, str]]:
    """Language and text of each fenced block; directives of Sphinx are left out."""
    found = FENCE.findall(page.read_text(encoding="utf-8"))
    return [(language.strip(), text) for language, text in found if not language.startswith("{")]


def commands(text: str, prompt: str) -> list[tuple[list[str], int]]:
    """Words of the `certigym` lines of a block, without the program itself, and their exit status."""
    # A backslash at the end of a line goes on in the next one.
    joined = re.sub(r"\\\n +", "", text)
    lines = [line.removeprefix(prompt) for line in joined.splitlines() if line.startswith(prompt + "certigym ")]
    return [(shlex.split(line, comments=True)[1:], int("# exit status 1" in line)) for line in lines]


def run_page(page: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Execute the blocks of a page in order."""
    monkeypatch.chdir(folder)
    if page.name in FINDING:
        monkeypatch.setattr(effort, "EFFORT", FINDING[page.name])
    names: dict[str, Any] = {}
    text = page.read_text(encoding="utf-8")
    assert all(usual in text for usual in QUICKER.get(page.name, {})), "it is no longer on the page"
    for language, block in blocks(page):
        for usual, small in QUICKER.get(page.name, {}).items():
            block = block.replace(usual, small)
        if language == "toml":
            (folder / toml_name(block)).write_text(block, encoding="utf-8")
        elif language == "python":
            if "mine.py" in text and not (folder / "mine.py").exists():
                (folder / "mine.py").write_text(block, encoding="utf-8")
            exec(compile(block, page.name, "exec"), names)
        elif language == "console":
            for words, status in commands(block, "$ "):
                assert main(words) == status, f"{page.name}: certigym {shlex.join(words)}"
    return names


def toml_name(block: str) -> str:
    return problem_from_toml(block).name.replace("-", "_") + ".toml"


EXECUTED = [page for page in PAGES if any(language in ("python", "console", "toml") for language, _ in blocks(page))]
LEARNING = {"learned_policies.md", "probe.md", "safety_filter.md", "sb3_policy.md"}


@pytest.mark.pages
@pytest.mark.parametrize("page", EXECUTED, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_blocks_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if page.name in LEARNING:
        pytest.importorskip("stable_baselines3", reason="needs the extra `rl`")
    if page.name in ("devices.md", "batches.md"):
        pytest.importorskip("torch", reason="needs torch")
    if page == DOCS / "environments" / "README.md":
        (tmp_path / "my-task.toml").write_bytes((ROOT / "examples" / "courier_and_drones.toml").read_bytes())
    names = run_page(page, tmp_path, monkeypatch)
    check_claims(page.name, names)


def check_claims(page: str, names: dict[str, Any]) -> None:
    """What pages say of their numbers beyond their own asserts."""
    if page == "bring_your_own_controller.md":
        raw, wrapped = names["result"].entries
        assert raw.lower_bound is None and raw.inadmissible == 0 and wrapped.lower_bound > 0.7
        assert wrapped.ci_high >= wrapped.lower_bound and abs(raw.rate - wrapped.rate) < 0.05
        assert names["improved"].certificate.lower_bound > 0.8
        assert all(names[other].certificate.lower_bound > 0.0 for other in ("mixed", "again"))
    if page == "learned_policies.md":
        raw, certified, improved = names["result"].entries
        assert raw.lower_bound is None and 0.0 < certified.lower_bound <= improved.lower_bound


def test_commands_that_are_not_run_are_understood() -> None:
    parser, count = build_parser(), 0
    for page in PAGES:
        for language, block in blocks(page):
            for words, _ in commands(block, "") if language == "sh" else []:
                count += 1
                parser.parse_args(words)
    assert count >= 8


def test_no_block_has_an_unknown_language_and_none_is_indented() -> None:
    for page in PAGES:
        assert {language for language, _ in blocks(page)} <= WORDS, page.name
        outside = FENCE.sub("", page.read_text(encoding="utf-8"))
        indented = [
            line for line in outside.splitlines() if line.startswith("    ") and line.strip().startswith("certigym ")
        ]
        assert not indented, (page.name, indented)


def test_every_command_is_on_its_page() -> None:
    text = (DOCS / "command_line.md").read_text(encoding="utf-8").partition("\n## JSON")[0]
    listed = set(re.findall(r"^\| `([\w-]+)` \|", text, re.MULTILINE))
    (action,) = (a for a in build_parser()._actions if a.dest == "command")
    assert action.choices is not None and listed == set(action.choices)


def test_every_public_name_is_in_the_reference() -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md"))
    named = re.findall(r"^\.\. auto(?:function|class):: (\w+)$", text, flags=re.MULTILINE)
    assert set(cg.__all__) - {"__version__"} <= set(named) and len(named) == len(set(named))
    drawn = {name for module in (figures, figure_scenes) for name in vars(module) if name.endswith("_figure")}
    assert {name for name in named if name.endswith("_figure")} == (drawn - {"new_figure"}) | {"save_figure"}


def test_every_figure_is_drawn_by_the_script_and_used() -> None:
    present = {path.stem for path in (DOCS / "figures").glob("*.png")}
    used = {name for page in PAGES for name in re.findall(r"figures/(\w+)\.png", page.read_text(encoding="utf-8"))}
    # The studio is a page, drawn by `draw_studio.py`.
    assert present == used == {*draw_figures.FIGURES, "studio"}
    for path in (DOCS / "figures").iterdir():
        assert path.stat().st_size < (250_000 if path.suffix == ".gif" else 100_000), "small enough to commit"


LINK = re.compile(r"(?<!!)\[[^\]\n]+\]\(([^)\s]+)\)|!\[[^\]\n]*\]\(([^)\s]+)\)")


def anchors(page: Path) -> set[str]:
    """Names of the headings of a page, as GitHub and MyST make them."""
    heads = re.findall(r"^#+ (.+)$", FENCE.sub("", page.read_text(encoding="utf-8")), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    text = re.sub(r"\$\$.*?\$\$|\$[^$\n]*\$|`[^`]*`", "", text, flags=re.DOTALL)
    for pair in LINK.findall(text):
        target = pair[0] or pair[1]
        if target.startswith(("http://", "https://", "mailto:")):
            assert re.fullmatch(r"https://[\w.\-]+(/\S*)?", target), f"{page.name}: {target}"
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), f"{page.name} links to {target}"
        assert ROOT in there.parents
        if anchor:
            assert anchor in anchors(there), f"{page.name} links to {target}"
