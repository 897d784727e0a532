"""What a search believed and what the checker recomputes are one, and a difference between them is an alarm.

A search walks into whatever the checker gets wrong: so each of some faults of the checker raises the alarm, and nothing
else does.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.synthesis.certificates.beliefs import alarm, alarm_in
from certigym.synthesis.certificates.proofs import Certificate, ClaimsMoreError, alarm_of, canonical, verdict_of
from certigym.synthesis.certificates.proofs.canonical import archive, canonical_bytes, save_canonical
from certigym.synthesis.checker import Contents, check_contents, constraints, error_system, parse_file, read_file
from kinds import mostly_thorough

EXAMPLES = sorted((Path(__file__).parents[2] / "examples" / "certificates").glob("*.npz"))
QUICK = ("integrator-chain-v0", "invariance-v0", "reach-avoid-v0", "car-slalom-v0", "invariance-4-v0")
"""Linear agents along a path, cells twice, agents with curved dynamics along a path, and cells of a larger team."""


@pytest.fixture(scope="module")
def along() -> Certificate:
    return cg.synthesize("integrator-chain-v0").certificate


@pytest.fixture(scope="module")
def cells() -> Certificate:
    return cg.synthesize("invariance-v0").certificate


@pytest.mark.parametrize("file", EXAMPLES, ids=lambda file: file.stem)
def test_examples_raise_no_alarm(file: Path) -> None:
    contents = read_file(file)
    assert ("notes" in contents.header) == ("linear" not in file.stem)  # whose values are charged in other ways
    assert alarm_in(contents, check_contents(contents)) == ""


@mostly_thorough("name", QUICK)
def test_searches_and_the_checker_agree(name: str) -> None:
    certificate = cg.synthesize(name).certificate
    contents = parse_file(canonical_bytes(certificate))
    assert contents.header["notes"]["believed"] == certificate.settings["believed"]
    assert alarm_in(contents, check_contents(contents)) == ""
    assert cg.check(certificate).alarm == "" and "ALARM" not in str(cg.check(certificate))


def step(key: str, t: int, factor: float) -> Callable[[dict[str, Any]], None]:
    def change(believed: dict[str, Any]) -> None:
        believed[key][t] = (factor * np.array(believed[key][t])).tolist()

    return change


TAMPERED: dict[str, tuple[Callable[[dict[str, Any]], Any], str]] = {
    "smaller deviations": (step("deviations", 2, 0.999), "as the deviation of state 0 at step 2"),
    "larger deviations": (step("deviations", 3, 1.001), "as the deviation of state 0 at step 3"),
    "limits farther away": (step("nearest", 4, 1.001), "deviations to the nearest limit (`safe` at time 4) at step 4"),
    "limits nearer": (step("nearest", 1, 0.999), "at time 1) at step 1"),
    "nan": (step("nearest", 1, np.nan), "the search believed nan, the checker recomputes"),
    "a step less": (lambda believed: believed["nearest"].pop(), "not readable, or of other steps"),
    "a state less": (lambda believed: [row.pop() for row in believed["deviations"]], "not readable, or of other steps"),
    "words": (lambda believed: believed.update(nearest="far"), "not readable, or of other steps"),
    "a table of tables": (lambda believed: believed.update(deviations={"a": {}}), "not readable, or of other steps"),
}


@pytest.mark.parametrize("what", TAMPERED)
def test_another_belief_raises_the_alarm(along: Certificate, what: str) -> None:
    change, told = TAMPERED[what]
    believed = json.loads(json.dumps(along.settings["believed"]))
    change(believed)
    found = alarm(believed, verdict_of(along))
    assert found.startswith("ALARM: ") and told in found


@pytest.mark.parametrize("believed", [[], "far", 1.0, True, {"value": "much"}, {"value": None}, [["value"]]])
def test_notes_may_be_anything(along: Certificate, believed: Any) -> None:
    assert alarm(believed, verdict_of(along)).startswith("ALARM: ") and alarm(None, verdict_of(along)) == ""
    header = {"notes": believed}
    assert alarm_in(Contents(header, (), set()), verdict_of(along)) == ""  # notes of others are about something else


def test_values_of_cells_are_compared(cells: Certificate) -> None:
    verdict = verdict_of(cells)
    value = cells.settings["believed"]["value"]
    for off in (-1e-6, 1e-6):
        found = alarm({"value": value + off}, verdict)
        assert found.startswith(f"ALARM: the search believed {value + off:.12g}, the checker recomputes")
        assert found.endswith("as the value at the start")
        # the extended check says so, too
        assert cg.check(replace(cells, settings={"believed": {"value": value + off}})).alarm.startswith("ALARM: ")


@pytest.mark.parametrize("form", ["canonical", "0.3"])
def test_the_command_shows_the_alarm(
    along: Certificate, form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever was believed, the proof stands: the alarm is a line of its own, and the status that of the verdict."""
    believed = json.loads(json.dumps(along.settings["believed"]))
    believed["deviations"][2][0] *= 2.0
    tampered = replace(along, settings={**along.settings, "believed": believed})
    path, report = tmp_path / "c.npz", tmp_path / "report.json"
    (save_canonical if form == "canonical" else cg.save)(tampered, path)
    assert main(["check", str(path), "--json", str(report)]) == 0
    told = "ALARM: the search believed "
    assert told in capsys.readouterr().out and told in report.read_text(encoding="utf-8")
    assert cg.check(path).valid and told in cg.check(path).alarm and told in str(cg.check(path))


STEP, ADD = error_system.ErrorSystem.step, constraints.Constraints.add


def with_less_noise(self: Any, matrix: Any, pushed: Any, reach: Any, noise: Any, off: Any) -> None:
    STEP(self, matrix, pushed, reach, 0.5 * noise, 0.5 * off)


def with_far_ends(self: Any, low: Any, high: Any, *rest: Any) -> None:
    ADD(self, np.asarray(low) + 0.01, np.asarray(high) + 0.01, *rest)


FAULTS: dict[str, tuple[Any, str, Any]] = {
    "noise of half the size": (error_system.ErrorSystem, "step", with_less_noise),
    "ends of constraints farther away": (constraints.Constraints, "add", with_far_ends),
    "tails that vanish": (constraints.Constraints, "failure", lambda self: 0.0),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_the_checker_raise_the_alarm(along: Certificate, fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(*FAULTS[fault])
    monkeypatch.setattr(canonical, "_verdicts", {})
    assert alarm_of(along, verdict_of(along)).startswith("ALARM: ")


# Claims that are higher than what is proved.


def claiming(certificate: Certificate, share: float) -> Certificate:
    """A certificate whose controllers are said to fail with so many times the probability that it claims."""
    proof: Any = certificate.proof
    if proof.kind == "path":
        return replace(certificate, proof=replace(proof, failure=share * proof.failure))
    return replace(certificate, proof=replace(proof, lower_bound=1.0 - share * (1.0 - proof.lower_bound)))


@pytest.mark.parametrize("kind", ["along", "cells"])
def test_false_claims_are_not_written_anew_as_if_they_were_true(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    honest: Certificate = request.getfixturevalue(kind)
    old, new, report = (tmp_path / name for name in ("old.npz", "new.npz", "report.json"))
    forged = claiming(honest, 0.01)
    cg.save(forged, old)
    command = ["canonical", str(old), "--out", str(new), "--json", str(report)]
    assert main(command) == 1 and not new.exists()
    proved = verdict_of(honest)
    told, outcome = capsys.readouterr().out, json.loads(report.read_text(encoding="utf-8"))
    assert outcome["claimed"] == forged.lower_bound > outcome["proved"] > 0.0
    assert "REFUSED" in told and "nothing was written" in told and "--claim proved" in told
    assert f"{forged.lower_bound:.15g}" in told and f"{outcome['proved']:.15g}" in told
    with pytest.raises(ClaimsMoreError, match="claim what is proved"):
        save_canonical(forged, new)
    assert not new.exists()
    # what is proved may be asked for
    assert main([*command, "--claim", "proved"]) == 0
    assert main(["check", str(new)]) == 0
    assert read_file(new).header["claim"]["failure"] == pytest.approx(proved.recomputed, rel=1e-8)


@pytest.mark.parametrize("kind", ["along", "cells"])
def test_honest_and_modest_claims_are_written(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    honest: Certificate = request.getfixturevalue(kind)
    for share in (1.0, 3.0):
        cg.save(claiming(honest, share), tmp_path / "old.npz")
        assert main(["canonical", str(tmp_path / "old.npz"), "--out", str(tmp_path / "new.npz")]) == 0
    with pytest.raises(ValueError, match="expected same or proved"):
        canonical_bytes(honest, claim="all")


def test_files_without_notes_are_read_as_before(along: Certificate) -> None:
    contents = parse_file(canonical_bytes(replace(along, settings={})))
    assert "notes" not in contents.header and alarm_in(contents, check_contents(contents)) == ""
    noted = archive({**contents.header, "notes": {"believed": None}}, contents.arrays)
    assert alarm_in(parse_file(noted), check_contents(parse_file(noted))) == ""
