"""Whatever was proved is one class with a dozen members, and one file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certificate_archives import contents, packed
from certigym.synthesis.certificates.proofs import certificate_from, changed, on_cells

FOLDER = Path(__file__).parents[1] / "data" / "kinds"
"""One small certificate of each kind."""

KINDS = {
    "opposite": "grid", "path": "path", "product": "product",
    "subtraction": "subtraction", "timed": "timed", "train": "grid",
}  # fmt: skip
"""Names of files, and how what they hold was proved."""


def with_header(path: Path, target: Path, entries: dict[str, Any]) -> Path:
    """The same file with other entries of its header, as a forger writes it."""
    header, arrays = contents(path.read_bytes())
    return packed({**header, **entries}, arrays, target)


@pytest.mark.parametrize("name", KINDS)
def test_files_are_read_and_written_anew(name: str, tmp_path: Path) -> None:
    old, new = FOLDER / f"{name}.npz", tmp_path / "new.npz"
    certificate = cg.load(old)
    assert type(certificate) is cg.Certificate and certificate.proof.kind == KINDS[name]
    assert cg.check(certificate)
    cg.save(certificate, new)
    header = contents(new.read_bytes())[0]
    assert header["version"] == 2 and header["proof"]["kind"] == KINDS[name]
    assert {*header} == {"format", "version", "problem", "fingerprint", "settings", "proof", "digest"}
    again = cg.load(new)
    assert cg.check(again, certificate.problem) and again.settings == certificate.settings
    assert (again.lower_bound, again.upper_bound) == (certificate.lower_bound, certificate.upper_bound)
    assert len(again.proof.parts) == len(certificate.proof.parts)
    assert all(type(part) is cg.Certificate for part in again.proof.parts)


@pytest.mark.parametrize("name", sorted(KINDS))
def test_controllers_of_files_keep_their_bound(name: str) -> None:
    """Fixed seed, 2,000 rollouts each, false alarm 1e-6."""
    assert not cg.validate(FOLDER / f"{name}.npz", 2000, seed=1, confidence=1 - 1e-6).refuted


def test_members_that_a_proof_has_no_answer_to_say_what_to_do() -> None:
    for name in ("path", "subtraction"):
        certificate = cg.load(FOLDER / f"{name}.npz")
        for ask in (certificate.at, lambda states, c=certificate: c.mean(states, states)):
            with pytest.raises(ValueError, match="`certificate`: expected"):
                ask(np.zeros(certificate.problem.n_states))


def test_values_are_those_of_the_certificate_on_cells() -> None:
    certificate = cg.load(FOLDER / "timed.npz")
    start = np.concatenate([agent.initial.low for agent in certificate.problem.agents])
    assert certificate.at(start) == on_cells(certificate).at(start) >= certificate.lower_bound - 1e-5
    assert certificate.min(start, start) == on_cells(certificate).min(start, start)
    product = cg.load(FOLDER / "product.npz")
    start = np.concatenate([agent.initial.low for agent in product.problem.agents])
    assert product.mean(start, start) == pytest.approx(product.lower_bound, rel=1e-3)


@pytest.mark.parametrize("name", ["path", "timed"])
@pytest.mark.parametrize(
    "entries",
    [
        {"fingerprint": "0" * 64}, {"problem": {}}, {"settings": [1]}, {"settings": None}, {"agents": "all"},
        {"proof": {"kind": "grid"}}, {"proof": {"kind": "paths"}}, {"proof": []}, {"version": 1},
    ],
    ids=str,
)  # fmt: skip
def test_hostile_headers_are_refused(name: str, entries: dict[str, Any], tmp_path: Path) -> None:
    """What they say beside their own entries decides nothing, or they are refused with one kind of error."""
    path = with_header(FOLDER / f"{name}.npz", tmp_path / "forged.npz", entries)
    try:
        loaded = cg.load(path)
    except ValueError as error:
        assert "expected a certigym certificate" in str(error)
    else:
        assert loaded.proof.kind == KINDS[name] and cg.check(loaded)
        assert "agents" in entries


def test_parts_are_of_the_kinds_that_belong_there(tmp_path: Path) -> None:
    """A file of a product in the place of the problem written out, and so on: refused when it is read."""
    for name, outer in (
        ("product", "subtraction"),
        ("train", "timed"),
        ("timed", "subtraction"),
        ("subtraction", "timed"),
    ):
        whole = cg.load(FOLDER / f"{outer}.npz")
        inner = cg.load(FOLDER / f"{name}.npz")
        wrong: Any = (inner,) * len(whole.proof.parts) if outer == "product" else inner
        object.__setattr__(whole.proof, "parts" if outer == "product" else "base", wrong)
        cg.save(whole, tmp_path / "wrong.npz")
        with pytest.raises(ValueError, match="expected a certigym certificate"):
            cg.load(tmp_path / "wrong.npz")


def test_parts_are_of_the_kinds_that_belong_there_in_memory_too() -> None:
    """Nothing rests on a bound by subtraction: what pairs may spoil was taken off for one task alone."""
    inner = cg.load(FOLDER / "subtraction.npz")
    for outer in ("timed", "subtraction", "product"):
        whole: Any = cg.load(FOLDER / f"{outer}.npz")
        fields = {"parts": (inner,) * len(whole.proof.parts)} if outer == "product" else {"base": inner}
        forged = changed(whole, **fields)
        assert "proved in other ways" in str(cg.check(forged))


def test_what_is_given_may_be_a_synthesis_a_certificate_or_a_path() -> None:
    path = FOLDER / "path.npz"
    assert certificate_from(path).proof.kind == certificate_from(cg.load(path)).proof.kind == "path"
    with pytest.raises(ValueError, match="expected a Synthesis, a certificate or the path of one, got int"):
        certificate_from(3)
