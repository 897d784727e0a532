"""Fields, audits, stress tests and reports run from a certificate file alone; reports are safe and self-contained."""

from __future__ import annotations

import html
import html.parser
import json
import re
from pathlib import Path
from typing import Any

import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.synthesis.certificates.proofs import OnGrid, changed
from problems import two_agents


@pytest.fixture(scope="module")
def certificate() -> OnGrid:
    return cg.synthesize(two_agents("F (a & F c)", horizon=4, noise_covariance=[[0.8]]), 40).certificate


@pytest.fixture(scope="module")
def file(certificate: OnGrid, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("certificates") / "c.npz"
    cg.save(certificate, path)
    return str(path)


def run(*arguments: str, out: Path) -> tuple[int, Any]:
    status = main([*arguments, "--json", str(out)])
    return status, json.loads(out.read_text())


def test_mismatch_on_the_command_line(file: str, tmp_path: Path) -> None:
    out = tmp_path / "r.json"
    status, report = run("validate", file, "--episodes", "4000", "--mismatch", "noise_scale=3", "delay=1", out=out)
    assert status == 1 and report["verdict"] == "refuted" and report["mismatch"] == "noise_scale=3.0, delay=1"
    for wrong in ("noise=3", "delay=x", "dropout=7"):
        assert main(["validate", file, "--mismatch", wrong]) == 2


@pytest.mark.parametrize(
    "arguments",
    [
        ["validate-field", "FILE", "--axes", "7"],
        ["audit", "FILE", "--confidence", "2"],
        ["report", "FILE", "--out", "/nowhere/at/all.html", "--episodes", "10"],
        ["validate", "FILE", "--workers", "0"],
    ],
)
def test_bad_input_is_one_line_and_status_2(
    file: str, arguments: list[str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([file if a == "FILE" else a for a in arguments]) == 2
    said = [line for line in capsys.readouterr().err.splitlines() if line.strip() and "it/s" not in line]
    assert len(said) == 1 and said[0].startswith("certigym: "), said


class Page(html.parser.HTMLParser):
    """Collects tags, and checks that they nest."""

    VOID = frozenset({"meta", "br", "th", "td", "tr", "line", "rect", "circle", "path", "polyline"})

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.words: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def parsed(path: Path) -> Page:
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def test_a_report_is_one_self_contained_page(file: str, tmp_path: Path) -> None:
    out, data = tmp_path / "r.html", tmp_path / "r.json"
    assert main(["report", file, "--out", str(out), "--episodes", "3000", "--json", str(data)]) == 0
    page, text = parsed(out), out.read_text(encoding="utf-8")
    assert page.tags.count("svg") >= 5 and "img" not in page.tags and "link" not in page.tags
    assert not re.search(r"""(src|href|url|@import)\s*[=(]\s*["']?(https?:)?//""", text)
    assert [value for name, value in page.attributes if name in ("src", "href")] == []
    assert ("type", "application/json") in page.attributes and page.tags.count("script") == 5
    assert ("name", "viewport") in page.attributes
    titles = ("Claim and verdict", "Bound against horizon", "The task automaton", "Audit of every step")
    for words in (*titles, "fingerprint"):
        assert words in text, words
    assert text.count("<section") == text.count("</section>") and text.count("<svg") == text.count("</svg>")
    content = json.loads(data.read_text())
    inside = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.S)
    assert inside is not None
    embedded = json.loads(inside.group(1))
    assert embedded["fingerprint"] == content["fingerprint"] == cg.load(file).fingerprint
    assert embedded["validation"]["successes"] == content["validation"]["successes"]


def test_hostile_names_and_settings_stay_text(certificate: OnGrid, tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    named = certificate.problem.replace(name=evil)
    hostile = changed(certificate, problem=named, method=evil, settings={evil: evil})
    cg.report(hostile, tmp_path / "r.html", 200)
    page = parsed(tmp_path / "r.html")
    assert page.tags.count("script") == 5 and "img" not in page.tags
    assert not any(name.startswith("on") for name, _ in page.attributes)


def test_a_refuted_certificate_is_reported_as_such(certificate: OnGrid, tmp_path: Path) -> None:
    wrong = changed(certificate, lower_bound=min(1.0, certificate.lower_bound + 0.1))
    path = tmp_path / "c.npz"
    cg.save(wrong, path)
    out = tmp_path / "r.html"
    assert main(["report", str(path), "--out", str(out), "--episodes", "2000"]) == 1
    assert 'class="verdict refuted"' in out.read_text()
