"""What the value explorer of a report shows is what the certificate says at the same points, rounded down."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.validation.presentation.reports.explorer import EPISODES, UNIT, _down, bounds_of_starts, explored
from certigym.validation.presentation.reports.other_starts import begun_at, bounds_from
from certigym.validation.statistical_tests import task_tracks

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

# Reads every point by keys and some by pointer and touch, at the start and at later times.
PROBE = """
<script>
var home=document.querySelector(".explorer"),map=home.querySelector(".map"),ring=home.querySelector(".x-handle"),
pick=home.querySelector("select"),slide=home.querySelector("input[type=range]"),out={errors:window.errors,read:[],later:[]};
function said(){var b=home.querySelector(".read b");return [+b.dataset.point,+b.dataset.units,b.textContent]}
function key(name){ring.dispatchEvent(new KeyboardEvent("keydown",{key:name,bubbles:true,cancelable:true}))}
function each(list){for(var k=0;k<99;k++){key("ArrowLeft");key("ArrowDown")}
for(var i=0;i<SIDE;i++){for(var j=0;j<DEPTH;j++){list.push(said());if(j<DEPTH-1)key("ArrowUp")}
for(j=0;j<99;j++)key("ArrowDown");for(j=0;j<=i;j++)key(FLAT?"none":"ArrowRight");if(!FLAT){for(j=0;j<99;j++)key("ArrowLeft");
for(j=0;j<=i;j++)key("ArrowRight")}}}
out.ends=[...document.querySelectorAll(".x-paths :is(circle,polygon)")].map(function(e){
return e.tagName+(e.getAttribute("transform")||"").replace(/^.*rotate/,"")});
each(out.read);
out.paths=document.querySelectorAll(".x-paths .x-path").length;
function touch(kind,x,y){map.dispatchEvent(new PointerEvent(kind,{clientX:x,clientY:y,pointerId:7,pointerType:"touch",
bubbles:true,cancelable:true}))}
var c=map.querySelectorAll(".cell"),ends=[c[0],c[c.length-1]].map(function(e){var r=e.getBoundingClientRect();
return [r.left+r.width/2,r.top+r.height/2]});
touch("pointerdown",ends[0][0],ends[0][1]);out.corner=said()[0];
touch("pointermove",ends[1][0],ends[1][1]);out.opposite=said()[0];
touch("pointerup",0,0);touch("pointermove",ends[0][0],ends[0][1]);out.released=said()[0];
out.scale=JSON.parse(document.getElementById("explorer").textContent).grid.map(function(x,k){
return Math.abs(ends[1][k]-ends[0][k])/(x[x.length-1]-x[0])});
if(!home.querySelector(".later").hidden)for(var t=0;t<=+slide.max;t++)for(var q=1;q<pick.options.length;q++){
pick.value=pick.options[q].value;pick.dispatchEvent(new Event("change"));slide.value=t;
slide.dispatchEvent(new Event("input"));out.later.push([t,q-1].concat(said()))}
var box=document.createElement("pre");box.id="seen";box.textContent=JSON.stringify(out);document.body.append(box);
</script>
"""


def dragged(page: Path, folder: Path, shape: tuple[int, ...]) -> dict[str, Any]:
    """Load a report, move the ring of its explorer, and return what it said."""
    side, depth = (1, shape[0]) if len(shape) == 1 else shape
    probe = PROBE.replace("SIDE", str(side)).replace("DEPTH", str(depth)).replace("FLAT", str(int(len(shape) == 1)))
    text = page.read_text(encoding="utf-8")
    text = text.replace("<head>", "<head><script>window.errors=[];onerror=function(m){errors.push(m)}</script>")
    probed = folder / "probed.html"
    probed.write_text(text.replace("</body>", probe + "</body>"), encoding="utf-8")
    command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={folder / 'profile'}"]
    command += ["--host-resolver-rules=MAP * ~NOTFOUND", "--window-size=390,900", "--dump-dom", probed.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    found = re.search(r'<pre id="seen">(.*?)</pre>', done.stdout, re.S)
    assert found, done.stderr[-500:]
    return dict(json.loads(html.unescape(found.group(1))))


@pytest.mark.thorough
@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
@pytest.mark.parametrize(("id", "cells"), [("reach-avoid-v0", 40), ("patrol-robot-v0", 24)])
def test_the_explorer_says_what_the_certificate_says(
    id: str, cells: int, tmp_path: Path, synthesized: Callable[..., cg.Synthesis]
) -> None:
    certificate: Any = synthesized(id, cells).certificate
    page = tmp_path / "r.html"
    content = cg.report(certificate, page, 300)
    shown = content.explored
    assert shown is not None and shown.bounds.max() > 0.0 and len(np.unique(shown.bounds)) > 1
    seen = dragged(page, tmp_path, shown.shape)
    assert seen["errors"] == [] and seen["paths"] > 0
    # Every point was reached by keys, and reads the bound there: never above it, and by one unit below it at most.
    truth = certificate.at(shown.starts)
    read = {point: (units, text) for point, units, text in seen["read"]}
    assert set(read) == set(range(len(truth)))
    for point, (units, text) in read.items():
        assert units / UNIT <= truth[point] and truth[point] - units / UNIT < 2 / UNIT
        assert float(text.removeprefix("P ≥ ")) <= truth[point]
        assert truth[point] - float(text.removeprefix("P ≥ ")) < 1e-6
    # Touch: from one corner to the other, and nothing moves once the finger is lifted.
    assert seen["corner"] == 0 and seen["opposite"] == seen["released"] == len(truth) - 1
    # A map of places is drawn in scale; one of two agents has an axis for each.
    assert max(seen["scale"]) < 1.001 * min(seen["scale"]) or id == "reach-avoid-v0"
    # Later: at the corner that was left, every time and automaton state.
    values = cg.value_in_time(certificate)
    assert len(seen["later"]) == len(shown.times) * certificate.problem.automaton.n_states > 0
    for t, q, point, units, _ in seen["later"]:
        bound = float(values.at(shown.starts[point], q, certificate.problem.horizon - shown.times[t])[0])
        assert units / UNIT <= bound < (units + 2) / UNIT


@pytest.mark.thorough
def test_the_episodes_of_a_point_begin_there_and_end_as_is_said(synthesized: Callable[..., cg.Synthesis]) -> None:
    certificate: Any = synthesized("patrol-robot-v0", 12).certificate
    shown = explored(certificate, seed=3)
    count = len(shown.starts)
    assert shown.axes == (0, 1) and shown.states.shape[1] == EPISODES * count
    for r in range(EPISODES * count):
        assert np.array_equal(shown.states[0, r], shown.starts[r % count])
    # The paths themselves tell who succeeded.
    read, _ = task_tracks(certificate.problem, shown.states)
    assert np.array_equal(certificate.problem.automaton.accepting[read[-1]], shown.success)
    assert shown.success.any() and not shown.success.all()


def test_starts_around_that_of_a_path_have_bounds_of_their_own() -> None:
    """One state and three steps: the certificate's own start is among the points, and none is worth more."""
    agent = cg.LinearAgent(name="a", A=0.9, B=0.5, noise=0.1, state_space=(-4, 4), input_space=(-1, 1), start=[-1.0])
    problem = cg.Problem(
        horizon=3, agents=agent, propositions={"g": cg.Proposition("a", -0.5, 1.0)}, specification="F g"
    )
    certificate: Any = cg.synthesize(problem, relation="path").certificate
    starts, shape, own, bounds = bounds_of_starts(certificate, (0,), 24.0)
    assert own is not None and starts[own] == -1.0 and shape == (len(starts),)
    assert certificate.lower_bound <= bounds[own] <= 1.0 and len(np.unique(bounds)) > 2


def test_bounds_are_rounded_down_also_where_products_are_rounded_up() -> None:
    rng = np.random.default_rng(0)
    whole = rng.integers(1, UNIT, 200_000)
    below = np.nextafter(whole / UNIT, 0.0)  # the largest number that is less than so many units
    assert np.all(_down(below) / UNIT <= below)
    assert np.all(_down(np.array([0.0, 1.0])) == [0, UNIT])
    assert np.any(np.floor(below * UNIT) / UNIT > below), "without the second step some would be rounded up"


FOLDER = Path(__file__).parents[2] / "benchmarks" / "arch"
UNIFORM = Path(__file__).parents[2] / "examples" / "own" / "heat_pump.toml"


def moved_inputs(certificate: Any, start: np.ndarray[Any, Any]) -> list[np.ndarray[Any, Any]]:
    """The inputs that the certificate's own controllers give without noise from another start."""
    inputs, states = [], np.split(start, [columns.stop for columns in certificate.problem.columns][:-1])
    for t in range(certificate.proof.n_steps):
        pairs = zip(certificate.proof.paths, certificate.controller.nominal, states, strict=True)
        now = [path.inputs[t] + path.gains[t] @ (x - nominal[t]) for path, nominal, x in pairs]
        inputs.append(np.concatenate(now))
        agents = zip(certificate.problem.agents, states, now, strict=True)
        states = [agent.A @ x + agent.B @ u + agent.offset for agent, x, u in agents]
    return inputs


def test_a_path_moved_to_another_start_is_followed_by_the_same_controllers() -> None:
    """Its nominal inputs are those of the old controllers there, so that ``u`` is the same for every noise."""
    certificate: Any = cg.synthesize(FOLDER / "bas_4_deviation.toml", relation="path").certificate
    start = np.concatenate([agent.initial.low for agent in certificate.problem.agents])
    assert np.any(certificate.proof.paths[0].gains), "without feedback nothing would be seen"
    moved = begun_at(certificate, start + 0.01)
    for t, inputs in enumerate(moved_inputs(certificate, start + 0.01)):
        np.testing.assert_allclose(np.concatenate([path.inputs[t] for path in moved.proof.paths]), inputs, rtol=1e-12)
    assert moved.lower_bound == 0.0, "it claims nothing before it is checked"


@pytest.mark.thorough
@pytest.mark.parametrize("source", [FOLDER / "bas_4_deviation.toml", UNIFORM], ids=["linear", "uniform"])
def test_what_is_shown_elsewhere_is_what_rollouts_keep(source: Path) -> None:
    """2000 episodes from five starts; 1e-6 for all of them. A linear path and a nonlinear one; outside nothing is."""
    certificate: Any = cg.synthesize(source, relation="path").certificate
    problem = certificate.problem
    start = np.concatenate([agent.initial.low for agent in problem.agents])
    width = problem.agents[0].state_high - problem.agents[0].state_low
    starts = start + np.outer([0.0, 0.02, 0.06, 0.12, 10.0], np.eye(len(start))[-1] * width)
    bounds = bounds_from(certificate, starts)
    assert bounds[0] >= certificate.lower_bound and bounds[-1] == 0.0 and len(np.unique(bounds)) > 2
    for bound, place in zip(bounds[:-1], starts[:-1], strict=True):
        report = cg.validate(begun_at(certificate, place), 2000, confidence=1 - 2e-7)
        assert report.ci_high >= bound, place
