"""Report pages in headless Chromium, where it is installed: no errors, nothing beyond the edge, a working player."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

import certigym as cg

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

pytestmark = [pytest.mark.thorough, pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")]

# Runs after the page's own script, plays an episode to its end, and writes what it sees into the title.
PROBE = """
<script>
var slide=document.querySelector(".player input"),wide=[];slide.value=slide.max;slide.dispatchEvent(new Event("input"));
document.querySelectorAll("main *").forEach(function(e){var r=e.getBoundingClientRect();
if(!e.closest(".scroll")&&!e.closest("svg")&&r.right>document.documentElement.clientWidth+1)wide.push(e.tagName+"."+e.className)});
var box=document.createElement("pre");box.id="seen";
box.textContent=JSON.stringify({errors:window.errors,wide:wide,
scroll:document.documentElement.scrollWidth,width:document.documentElement.clientWidth,
said:document.querySelector("output").textContent,drawn:document.querySelectorAll(".one polyline").length,
here:document.querySelectorAll(".here").length,background:getComputedStyle(document.body).backgroundColor});
document.body.appendChild(box);
</script>
"""


def seen(page: Path, folder: Path, width: int, *flags: str) -> dict[str, Any]:
    """Load a page in a window of some width, and return what the probe saw."""
    text = page.read_text(encoding="utf-8")
    text = text.replace("<head>", "<head><script>window.errors=[];onerror=function(m){errors.push(m)}</script>")
    probed = folder / f"probed-{width}.html"
    probed.write_text(text.replace("</body>", PROBE + "</body>"), encoding="utf-8")
    command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    command += [
        "--no-first-run",
        "--disable-component-update",
        "--disable-sync",
        f"--user-data-dir={folder / 'profile'}",
    ]
    command += [f"--window-size={width},900", *flags, "--dump-dom", probed.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    found = re.search(r'<pre id="seen">(.*?)</pre>', done.stdout, re.S)
    assert found, done.stderr[-500:]
    return dict(json.loads(html.unescape(found.group(1))))


@pytest.mark.parametrize(("id", "cells"), [("meeting-v0", 16)])
def test_pages_have_no_errors_and_fit_wide_and_narrow_windows(id: str, cells: int, tmp_path: Path) -> None:
    problem = cg.make_problem(id)
    problem = problem.replace(horizon=min(problem.horizon, 10))
    page = tmp_path / "r.html"
    cg.report(cg.synthesize(problem, cells, relation="exact"), page, 400)
    curves = len(problem.agents) if id != "meeting-v0" else 2
    for width in (1200, 520):
        view = seen(page, tmp_path, width)
        assert view["errors"] == [] and view["wide"] == [] and view["scroll"] <= view["width"]
        assert view["drawn"] >= min(curves, 6) and "satisfied" in view["said"] and view["here"] >= (not problem.groups)
