"""The gallery shows a card for every environment, and its filters show those of which the problems say the same."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

import certigym as cg
import environment_pages
from certigym.envs.agents import LinearAgent

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DOCS = Path(environment_pages.__file__).parent
README = (DOCS / "environments" / "README.md").read_text(encoding="utf-8")
CARD = re.compile(r"^\| \[!\[.*?\]\(([\w-]+)\.png\)\]\(\1\.md\) \| (.*) \|$", re.MULTILINE)

PROBE = """
<script>document.addEventListener("DOMContentLoaded",function(){
var picks={},seen={};document.querySelectorAll("select").forEach(function(s){picks[s.name]=s});
function shown(){return Array.from(document.querySelectorAll("tbody tr")).filter(function(r){return !r.hidden})
.map(function(r){return r.id})}
seen.first=shown();
Object.keys(picks).forEach(function(kind){Array.from(picks[kind].options).forEach(function(o){
picks[kind].value=o.value;picks[kind].dispatchEvent(new Event("change"));seen[kind+": "+o.value]=shown();
picks[kind].value="any"})});
picks.agents.value="one";picks.dynamics.value="nonlinear";picks.dynamics.dispatchEvent(new Event("change"));
seen.both=shown();seen.said=document.querySelector("output").textContent;
var box=document.createElement("pre");box.id="seen";box.textContent=JSON.stringify(seen);document.body.append(box)});
</script>
"""


def cards() -> list[tuple[str, str]]:
    """Id and words of each card."""
    return CARD.findall(README)


def test_every_environment_has_a_card_and_a_domain() -> None:
    ids = [id for domain in environment_pages.DOMAINS for id in environment_pages.members(domain)]
    assert len(ids) == len(set(ids)) and set(ids) == set(cg.problem_ids()) == {id for id, _ in cards()}
    said = re.search(r"Step (\d+) tasks", (DOCS / "index.md").read_text(encoding="utf-8"))
    assert said and int(said[1]) == len(ids)


def test_cards_are_small_files_twice_as_wide_as_they_are_shown() -> None:
    from PIL import Image

    for id in cg.problem_ids():
        path = environment_pages.FOLDER / f"{id}.png"
        with Image.open(path) as picture:
            assert picture.size == (600, 440)
        assert path.stat().st_size < 40_000


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
def test_filters_show_what_the_problems_say(tmp_path: Path) -> None:
    rows = "".join(f'<tr id="{id}"><td></td><td>{words}</td></tr>' for id, words in cards())
    page = tmp_path / "gallery.html"
    script = (DOCS / "_static" / "gallery.js").read_text(encoding="utf-8")
    page.write_text(
        f'<meta charset="utf-8"><script>{script}</script>{PROBE}<section id="cards"><div class="table-wrapper">'
        f"<table><tbody>{rows}</tbody></table></div></section>",
        encoding="utf-8",
    )
    command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    done = subprocess.run([*command, "--dump-dom", page.as_uri()], capture_output=True, text=True, timeout=120)
    found = re.search(r'<pre id="seen">(.*?)</pre>', done.stdout, re.S)
    assert found, done.stderr[-500:]
    seen = json.loads(html.unescape(found.group(1)))
    problems = {id: cg.make_problem(id) for id in cg.problem_ids()}

    def ids(fits: Callable[[cg.Problem], bool]) -> set[str]:
        return {id for id, problem in problems.items() if fits(problem)}

    def states(problem: cg.Problem) -> int:
        return max(agent.n_states for agent in problem.agents)

    def linear(problem: cg.Problem) -> bool:
        return all(isinstance(agent, LinearAgent) for agent in problem.agents)

    assert set(seen["first"]) == set(problems)
    assert set(seen["agents: one"]) == ids(lambda p: p.n_agents == 1) != set()
    assert set(seen["agents: 2 to 4"]) == ids(lambda p: 2 <= p.n_agents <= 4) != set()
    assert set(seen["agents: 5 and more"]) == ids(lambda p: p.n_agents >= 5) != set()
    assert set(seen["states of an agent: two"]) == ids(lambda p: states(p) == 2) != set()
    assert set(seen["states of an agent: 3 and more"]) == ids(lambda p: states(p) >= 3) != set()
    assert set(seen["dynamics: linear"]) == ids(linear) != set()
    for tier in ("open", "hard", "solved"):
        assert set(seen[f"left to learn: {tier}"]) == set(cg.problem_ids(tier)) != set()
    assert set(seen["both"]) == ids(lambda p: p.n_agents == 1 and not linear(p)) != set()
    assert seen["said"] == f"{len(seen['both'])} of {len(problems)}"
    bands = [set(seen[f"certified: {band}"]) for band in ("above .99", ".5 to .99", "below .5")]
    assert set.union(*bands) == set(problems) and sum(map(len, bands)) == len(problems)
