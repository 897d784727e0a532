"""The studio leads from an empty file to a certificate, loses nothing that was written, and serves its owner alone."""

from __future__ import annotations

import http.client
import json
import tomllib
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest

import certigym as cg
from certigym.validation.presentation.studio.folder import place
from certigym.validation.presentation.studio.looking import _MOVED, look
from certigym.validation.presentation.studio.server import MOST_BYTES, Studio
from certigym.validation.presentation.studio.toml_edits import edited
from certigym.validation.presentation.studio.toml_spans import places
from chromium_pages import CHROMIUM, Chromium, Tab
from kinds import mostly_thorough

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted(ROOT.glob("examples/**/*.toml"))
FILES = [*EXAMPLES, ROOT / "benchmarks" / "arch" / "package_delivery_0.2.toml", ROOT / "pyproject.toml"]
UNICYCLE = (ROOT / "examples" / "own" / "unicycle.toml").read_text(encoding="utf-8")

HARD = '''
"a.b" = 1 # [not] a = "heading"
c.d = """x = "y" \\\\ # """ # text
'e"' = { f = [1, { g = 'h]' }, # more
  2979-05-27T07:32:00Z ], i = """q""" }
[[t]]
x = [[1, 2],
     [3, 4]]
[t.u]
v = 1_000.5
[[t]]
[[t.w]]
k = '''
HARD += "'''a\n'b'''\n"


# The text and the picture stay in step.


@pytest.mark.parametrize("text", [HARD, *(path.read_text(encoding="utf-8") for path in FILES)])
def test_every_value_of_a_text_is_found_where_it_stands(text: str) -> None:
    data, found = tomllib.loads(text), places(text).values

    def leaves(value: Any, path: tuple[Any, ...]) -> Iterator[tuple[tuple[Any, ...], Any]]:
        items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, item in items:
            yield from leaves(item, (*path, key))
        if not isinstance(value, dict | list):
            yield path, value

    for path, value in leaves(data, ()):
        span = found[path]
        assert tomllib.loads(f"v = {text[span.start : span.end]}")["v"] == value, path
    for path, span in found.items():
        whole: Any = data
        for key in path:
            whole = whole[key]
        assert tomllib.loads(f"v = {text[span.start : span.end]}")["v"] == whole, path


def test_an_edit_changes_what_it_is_about_and_keeps_every_comment() -> None:
    text = UNICYCLE.replace("[propositions]", "[propositions]  # where")
    moved = edited(
        text, {"set": [[["propositions", "shelf", "low"], [1.5, 2, -6.3]], [["agents", 0, "initial_state", 1], 2.5]]}
    )
    before, after = text.splitlines(), moved.splitlines()
    changed = [(a, b) for a, b in zip(before, after, strict=True) if a != b]
    assert [b for _, b in changed] == [
        "initial_state = [1.0, 2.5, 0.0]",
        'shelf = { agent = "robot", low = [1.5, 2, -6.3], high = [9.5, 9.5, 6.3] }',
    ]
    disc = {"agent": "robot", "disc": {"centre": [5, 5], "radius": 0.5}}
    drawn = edited(text, {"add": ["hole", disc], "role": "avoided"})
    data = tomllib.loads(drawn)
    assert data["propositions"]["hole"] == disc and "# where" in drawn
    assert data["specification"]["formula"] == "(F (shelf & F door) & G !(rack_1 | rack_2)) & G !hole"
    assert edited(drawn, {"remove": "hole"}).replace(" & G !hole", "") == edited(
        text, {"formula": data["specification"]["formula"]}
    ).replace(" & G !hole", "")


@pytest.mark.parametrize(
    ("role", "formula"), [("reached", "F a & F b"), ("avoided", "F a & G !b"), ("kept", "F a & G b"), ("free", "F a")]
)
def test_what_is_drawn_is_asked_for_as_its_role_says(role: str, formula: str) -> None:
    begun = edited("", {"add": ["a", {"agent": "x"}], "role": "reached"})
    assert tomllib.loads(begun) == {"propositions": {"a": {"agent": "x"}}, "specification": {"formula": "F a"}}
    drawn = edited(begun, {"add": ["b", {"agent": "x"}], "role": role})
    assert tomllib.loads(drawn)["specification"]["formula"] == formula
    assert edited(drawn, {"remove": "b"}) == begun


@pytest.mark.parametrize(
    ("text", "edit"),
    [
        ("a = 1", {"set": [[["a"], 2]]}),
        (UNICYCLE, {"set": [[["propositions", "shelf", "lo"], 2]]}),
        (UNICYCLE, {"set": [[["propositions", "shelf", "low"], {"x": float("nan")}]]}),
        (UNICYCLE, {"add": ["shelf", {}]}),
        (UNICYCLE, {"run": "rm"}),
        ("propositions = { a = 1 }", {"add": ["b", {}]}),
        ("[a", {"formula": "F a"}),
    ],
)
def test_what_cannot_be_edited_is_refused(text: str, edit: Any) -> None:
    with pytest.raises(ValueError):
        edited(text, edit)


COUNTING = {"patrol", "queue", "samples"}
"""Examples with boxes alone, as others have, whose automata take seconds to build."""

DRAWN = [path for path in EXAMPLES if path.stem not in COUNTING][::4]


@mostly_thorough("path", DRAWN[::3], first=2, ids=lambda path: path.stem)
def test_what_can_be_moved_is_drawn_where_the_task_has_it(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    seen = look(text, path.name, path.parent)
    assert seen["error"] is None and seen["fingerprint"] == cg.load(path).fingerprint
    data = tomllib.loads(text)
    for panel in seen["picture"]["panels"]:
        for shape in panel["shapes"]:
            for key in _MOVED[shape["kind"]]:
                value = data["propositions"][shape["name"]]
                for step in (*shape["at"], key):
                    value = value[step]
                assert value == shape[key]


# Nothing is written outside of the folder.


@pytest.mark.parametrize(
    "name",
    [
        "../c.npz",
        "/tmp/c.npz",
        "a/c.npz",
        "c.toml",
        ".npz",
        "",
        "..npz/../c.npz",
        "c.npz\0",
        "link.npz",
        "dir.npz",
        None,
        3,
    ],
)
def test_files_outside_of_the_folder_are_refused(name: Any, tmp_path: Path) -> None:
    folder, outside = tmp_path / "in", tmp_path / "out.npz"
    folder.mkdir()
    outside.write_text("mine")
    (folder / "link.npz").symlink_to(outside)
    (folder / "dir.npz").mkdir()
    with pytest.raises(ValueError, match="`name`: expected a file"):
        place(folder, name, ".npz")
    assert place(folder, "c.npz", ".npz") == folder / "c.npz"


def test_a_file_that_leads_elsewhere_is_not_opened(tmp_path: Path) -> None:
    (tmp_path / "out.toml").write_text(UNICYCLE)
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "task.toml").symlink_to(tmp_path / "out.toml")
    with pytest.raises(ValueError, match="leads elsewhere"):
        Studio(folder, "task.toml")


# The server.


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Studio]:
    page = Studio(tmp_path_factory.mktemp("studio"), "task.toml").start()
    yield page
    page.stop()


def asked(page: Studio, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, Any]:
    """Status and answer of a request."""
    port = page._server.server_port
    data = None if body is None else body if isinstance(body, bytes) else json.dumps(body).encode()
    sent = {"Content-Type": "application/json"} if data is not None else {}
    sent |= {name.replace("_", "-"): value for name, value in headers.items()}
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=30)) as connection:
        with suppress(BrokenPipeError, ConnectionResetError):  # what is too long is refused before it is read
            connection.request(method, path, data, sent)
        answer = connection.getresponse()
        text = answer.read()
    return answer.status, json.loads(text) if "json" in (answer.getheader("Content-Type") or "") else text


REQUESTS: list[tuple[str, str, Any]] = [
    ("GET", "", None),
    ("GET", "page.js", None),
    ("GET", "state", None),
    *(("POST", action, {}) for action in ("text", "edit", "certify", "stop", "play", "save", "certificate")),
]


@pytest.mark.parametrize(("method", "action", "body"), REQUESTS)
def test_only_who_knows_the_address_is_answered(studio: Studio, method: str, action: str, body: Any) -> None:
    own = f"/{studio.token}/{action}"
    if action != "save":  # with the token the same request is answered, or refused for what it says
        assert asked(studio, method, own, body)[0] in (200, 400, 409)
    for path in (
        f"/{action}",
        f"//{action}",
        f"/{studio.token[:-1]}/{action}",
        f"/{studio.token}x/{action}",
        f"/é/{action}",
    ):
        assert asked(studio, method, path.encode("latin-1").decode("latin-1").replace("é", "%E9"), body)[0] == 403
    port = studio._server.server_port
    for headers in (
        {"Host": "evil.example"},
        {"Host": f"evil.example:{port}"},
        {"Host": f"localhost.evil.example:{port}"},
        {"Host": f"127.0.0.1:{port + 1}"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": f"http://localhost:{port + 1}"},
        {"Origin": f"https://127.0.0.1:{port}"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
    ):
        status, answer = asked(studio, method, own, body, **headers)
        assert status == 403 and set(answer) == {"error"}, headers


def test_requests_are_limited_in_size_and_kind(studio: Studio) -> None:
    path = f"/{studio.token}/text"
    before = studio.session.state(-1, 0.0)["text"]
    assert asked(studio, "POST", path, b"x" * (MOST_BYTES + 1))[0] == 413
    assert asked(studio, "POST", path, b"{}", Content_Type="text/plain")[0] == 415
    assert asked(studio, "POST", path, b"[" * 100_000)[0] == 400
    assert asked(studio, "POST", path, b"[]")[0] == 400
    assert asked(studio, "POST", path, {"text": 3, "base": 0})[0] == 400
    assert asked(studio, "POST", path, {"text": "x" * 500_000, "base": 0})[0] == 400
    assert asked(studio, "POST", path, b"{}", Content_Length="-5")[0] == 411
    assert asked(studio, "POST", f"/{studio.token}/shutdown", {})[0] == 404
    assert asked(studio, "GET", f"/{studio.token}/../../etc/passwd")[0] == 404
    assert studio.session.state(-1, 0.0)["text"] == before
    assert studio._server.server_address[0] == "127.0.0.1"


def test_the_page_may_load_nothing_from_elsewhere(studio: Studio) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", studio._server.server_port)
    connection.request("GET", f"/{studio.token}/")
    answer = connection.getresponse()
    policy, page = answer.getheader("Content-Security-Policy") or "", answer.read().decode()
    connection.close()
    assert "default-src 'none'" in policy and "frame-ancestors 'none'" in policy and "script-src 'self';" in policy
    assert answer.getheader("Referrer-Policy") == "no-referrer" and studio.token not in page
    assert "http://" not in page.replace("http://www.w3.org", "") and "https://" not in page


def test_two_who_write_at_once_are_told(tmp_path: Path) -> None:
    page = Studio(tmp_path, "task.toml").start()
    try:
        text, save = f"/{page.token}/text", f"/{page.token}/save"
        status, state = asked(page, "POST", text, {"text": "a = 1", "base": 0})
        assert status == 200 and state["revision"] == 1
        status, answer = asked(page, "POST", text, {"text": "b = 2", "base": 0})
        assert status == 409 and answer["state"]["text"] == "a = 1"
        assert asked(page, "POST", save, {})[0] == 200
        assert (tmp_path / "task.toml").read_text() == "a = 1"
        # Another program changes the file: it is not replaced unless that is asked for.
        (tmp_path / "task.toml").write_text("c = 3")
        assert asked(page, "POST", text, {"text": "d = 4", "base": 1})[0] == 200
        assert asked(page, "POST", save, {})[0] == 409
        assert (tmp_path / "task.toml").read_text() == "c = 3"
        assert asked(page, "POST", save, {"anyway": True})[0] == 200
        assert (tmp_path / "task.toml").read_text() == "d = 4"
    finally:
        page.stop()


@pytest.mark.thorough
def test_a_process_that_ends_is_told_and_replaced(tmp_path: Path) -> None:
    (tmp_path / "cart.toml").write_text((ROOT / "examples" / "pendulum_and_cart.toml").read_text())
    page = Studio(tmp_path, "cart.toml").start()
    try:
        session = page.session
        state = session.state(-1, 0.0)
        while state["seen"] is None:
            state = session.state(state["version"], 30.0)
        session.certify(None)
        assert session._computer is not None
        session._computer._process.kill()
        while state["job"]["state"] in ("none", "running"):
            state = session.state(state["version"], 30.0)
        assert state["job"]["state"] == "failed" and "has ended" in state["job"]["why"]
        session.certify(1.0)
        while state["job"]["state"] != "running" or state["job"]["now"] is None:
            state = session.state(state["version"], 30.0)
        # Pressed twice it is stopped at once.
        session.stop()
        session.stop()
        state = session.state(-1, 0.0)
        assert state["job"]["state"] in ("failed", "done") and state["text"]
    finally:
        page.stop()


# In a browser.


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    if CHROMIUM is None:
        pytest.skip("needs Chromium")
    opened = Chromium(tmp_path_factory.mktemp("profile"))
    yield opened
    opened.close()


def spot(tab: Tab, x: float, y: float) -> tuple[float, float]:
    """Where a point of the first panel is on the screen."""
    found = tab.run(
        "(() => {const v = studio.picture.views[0], r = v.svg.getBoundingClientRect();"
        "const k = r.width / v.svg.viewBox.baseVal.width;"
        f"return [r.x + k * v.axes.x({x}), r.y + k * v.axes.y({y})]}})()"
    )
    return found[0], found[1]


SEEN = "window.studio && studio.link.state && studio.link.state.seen && studio.link.state.current"


@pytest.mark.thorough
def test_from_an_empty_file_to_a_certificate(browser: Chromium, tmp_path: Path) -> None:
    page = Studio(tmp_path, "task.toml").start()
    try:
        tab = browser.open(page.address)
        tab.until(SEEN)
        assert tab.run("studio.link.text") == "" and tab.run("document.getElementById('result').hidden")
        tab.click("[data-begin=robot]")
        tab.until("document.querySelectorAll('#panels svg').length === 1")
        # Regions are drawn, and stand in the text and in the formula.
        for tool, role, begin, end in (
            ("box", "reached", (7, 7), (9, 9)),
            ("disc", "avoided", (4, 5), (5, 5)),
            ("polygon", "avoided", (6, 2), (8, 4)),
        ):
            count = tab.run("Object.keys(studio.link.text.match(/agent = /g) || []).length")
            tab.click(f"[data-tool={tool}]")
            tab.run(f"document.getElementById('role').value = '{role}'")
            tab.drag(spot(tab, *begin), spot(tab, *end))
            tab.until(f"Object.keys(studio.link.text.match(/agent = /g) || []).length > {count}")
        data = tomllib.loads(tab.run("document.getElementById('text').value"))
        assert data["propositions"]["goal"] == {"agent": "robot", "low": [7, 7], "high": [9, 9]}
        assert data["propositions"]["rock"] == {"agent": "robot", "disc": {"centre": [4, 5], "radius": 1}}
        assert len(data["propositions"]["rock_2"]["polygon"]["corners"]) == 6
        assert data["specification"]["formula"] == "F goal & G !rock & G !rock_2"
        # One is moved, one resized by a knob, the start dragged: the text follows.
        tab.until(f"{SEEN} && document.querySelector('[data-key=\"0/rock\"]')")
        tab.drag(spot(tab, 4, 5), spot(tab, 4.5, 5.5))
        tab.until("studio.link.text.includes('centre = [4.5, 5.5]')")
        tab.drag(spot(tab, 5.5, 5.5), spot(tab, 5, 5.5))
        tab.until("studio.link.text.includes('radius = 0.5')")
        tab.drag(spot(tab, 1.5, 1.5), spot(tab, 2.5, 1.5))
        tab.until("studio.link.text.includes('initial_state = [2.5, 1.5]')")
        # Keys move what has the focus, and every change can be taken back.
        tab.run("document.querySelector('[data-key=\"0/rock\"]').focus()")
        tab.press("ArrowRight")
        tab.until("studio.link.text.includes('centre = [4.6, 5.5]')")
        tab.press("Delete")
        tab.until("!studio.link.text.includes('rock =') && !studio.link.text.includes('!rock ')")
        for _ in range(2):
            tab.click("#undo")
        tab.until("studio.link.text.includes('centre = [4.5, 5.5]') && studio.link.text.includes('G !rock ')")
        tab.click("#redo")
        tab.until("studio.link.text.includes('centre = [4.6, 5.5]')")
        # And the picture follows the text.
        tab.run("studio.link.write(studio.link.text.replace('low = [7, 7]', 'low = [6, 7]'), true)")
        tab.until(
            f"{SEEN} && studio.picture.picture.panels[0].shapes[0].low[0] === 6 && studio.link.state.seen.fingerprint"
        )
        tab.until("!document.getElementById('certify').disabled")
        tab.click("#certify")
        tab.until("studio.link.state.job.state === 'done'")
        bound = tab.run("document.getElementById('bound').textContent")
        assert bound.startswith("P ≥ 0.9") and "checked by separate code" in tab.run(
            "document.getElementById('way').textContent"
        )
        tab.click("#play")
        tab.until("studio.result.run && document.querySelectorAll('#panels .way').length === 24")
        tab.click("[data-keep='.npz']")
        tab.until("studio.link.state.message === 'saved task.npz'")
        tab.click("#save")
        tab.until("studio.link.state.message === 'saved task.toml'")
        assert tab.run("wrong") == []
        # What was saved is what was shown, and holds.
        certificate = cg.load(tmp_path / "task.npz")
        assert certificate.problem.fingerprint == cg.load(tmp_path / "task.toml").fingerprint
        assert cg.check(certificate) and float(bound.removeprefix("P ≥ ").split()[0]) <= certificate.lower_bound
        assert sorted(path.name for path in tmp_path.iterdir()) == ["task.npz", "task.toml"]
    finally:
        page.stop()
