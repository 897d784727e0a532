"""Convex sets of starts keep what they claim between their corners, and their check finds what is wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from balls import check_rigorous
from certigym.cli.main import main
from certigym.synthesis.certificates import Certificate, HullProof, changed, corner, from_start
from certigym.synthesis.nominal_paths import certified_starts

FOLDER = Path(__file__).parents[2] / "benchmarks" / "arch"


def hull_of(row: str, level: float, rays: int = 16) -> Certificate[HullProof]:
    """Return the set of starts of a row over its first two states."""
    certificate: Any = cg.synthesize(FOLDER / f"{row}.toml", relation="path").certificate
    return certified_starts(certificate, level, (0, 1), rays)


@pytest.fixture(scope="module")
def chain() -> Certificate[HullProof]:
    return hull_of("chain_2", 0.8, 64)


def test_sets_are_at_least_as_large_as_those_published(chain: Certificate[HullProof]) -> None:
    assert chain.proof.share(chain.problem) > 0.629 and chain.proof.failure <= 0.2
    assert cg.check(chain).valid


def test_starts_between_the_corners_have_certificates_of_their_own(chain: Certificate[HullProof]) -> None:
    generator = np.random.default_rng(0)
    for _ in range(2):
        weights = generator.dirichlet(np.full(len(chain.proof.corners), 0.05))
        certificate = from_start(chain, weights @ chain.proof.corners)
        assert cg.check(certificate).valid
    with pytest.raises(ValueError, match="hull of the corners"):
        from_start(chain, [9.9, 9.9])


def test_rollouts_are_asked_for_a_start_of_the_set(chain: Certificate[HullProof]) -> None:
    """False alarm 1e-6."""
    middle = chain.proof.corners.mean(axis=0)
    name = chain.problem.agent_names[0]
    for start in (middle, {name: middle.tolist()}):
        report = cg.validate(chain, 1000, initial_state=start, confidence=1.0 - 1e-6)
        assert not report.refuted and report.lower_bound == chain.lower_bound
    with pytest.raises(ValueError, match="validate"):
        cg.validate(chain, 1000)


def test_rollouts_do_not_refute_corners(chain: Certificate[HullProof]) -> None:
    """Four corners by 20,000 rollouts each; false alarm 1e-6 altogether."""
    for i in range(0, 64, 16):
        certificate = corner(chain, i)
        verdict = cg.validate(certificate, 20_000, seed=i, confidence=1.0 - 1e-6 / 4)
        assert verdict.verdict != "refuted"


def test_the_check_finds_what_is_wrong(chain: Certificate[HullProof]) -> None:
    far = chain.proof.corners.copy()
    far[0] = 1.05 * far[0]
    assert not cg.check(changed(chain, corners=far))
    assert not cg.check(changed(chain, failure=0.5 * chain.proof.failure))
    letters = chain.proof.letters.copy()
    letters[-1] = 0
    assert not cg.check(changed(chain, letters=letters))
    assert not cg.check(changed(chain, inputs=-chain.proof.inputs))


def test_first_letters_must_not_depend_on_the_start() -> None:
    hull = hull_of("bas_4_deviation", 0.8)
    assert cg.check(hull).valid and hull.proof.share(hull.problem) > 0.9
    # A corner on the edge of the safe set, up to rounding, may be on either side of it.
    edge = hull.proof.corners.copy()
    edge[np.argmax(edge[:, 0]), 0] = 20.5
    assert "first letter" in str(cg.check(changed(hull, corners=edge)))


def test_the_command_line_refuses_a_set_that_claims_too_much(
    chain: Certificate[HullProof], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad, far = (str(tmp_path / name) for name in ("good.npz", "bad.npz", "far.npz"))
    cg.save(chain, good)
    assert main(["check", good]) == 0 and "valid" in capsys.readouterr().out
    kept: Any = cg.load(good)
    assert np.array_equal(kept.proof.corners, chain.proof.corners) and kept.lower_bound == chain.lower_bound
    cg.save(changed(chain, failure=0.5 * chain.proof.failure), bad)
    assert main(["check", bad]) == 1 and "recomputed" in capsys.readouterr().out
    # Corners that vary in a state which the set does not name would count twice.
    cg.save(changed(chain, axes=(0,)), far)
    assert main(["check", far]) == 1 and "axes" in capsys.readouterr().out
    assert cg.check(good).valid and not cg.check(chain, "reach-avoid-v0")
    pytest.importorskip("flint")
    assert check_rigorous(good) and not check_rigorous(bad)


def test_the_command_line_certifies_and_validates_a_set(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hull = str(tmp_path / "hull.npz")
    chain = str(FOLDER / "chain_2.toml")
    assert main(["synthesize", chain, "--starts", "0.8", "--out", hull]) == 0
    assert "64 corners" in capsys.readouterr().out
    assert main(["check", hull]) == 0
    # 5000 rollouts at the limits of .999: a false alarm is no failure of this test, it would be one of its fixed seed
    assert main(["validate", hull, "--initial-state", "1", "0", "--episodes", "5000"]) == 0
    capsys.readouterr()
    assert main(["validate", hull]) == 2 and "--initial-state" in capsys.readouterr().err
    assert main(["validate", hull, "--initial-state", "9.9", "9.9"]) == 2 and "hull" in capsys.readouterr().err
    assert main(["synthesize", chain, "--starts", "1.5", "--out", hull]) == 2
    assert main(["synthesize", chain, "--starts", "0.8", "--relation", "linear", "--cells", "8", "--out", hull]) == 2


def test_probabilities_below_a_half_are_refused(chain: Certificate[HullProof]) -> None:
    certificate = corner(chain, 0)
    with pytest.raises(ValueError, match="`probability`"):
        certified_starts(certificate, 0.3)


def test_the_share_of_a_line_is_its_length() -> None:
    """An agent of one state has a set of starts, too: an interval."""
    cart = cg.LinearAgent(
        name="cart", A=[[0.9]], B=[[0.5]], noise_covariance=[[0.01]], state_low=[-4], state_high=[4],
        input_low=[-4], input_high=[4], initial_state=[-1],
    )  # fmt: skip
    problem = cg.Problem(
        name="line", horizon=3, agents=[cart], propositions={"goal": cg.Proposition("cart", [1], [4])},
        specification=cg.Specification("F goal", "co-safe"),
    )  # fmt: skip
    hull = certified_starts(cg.synthesize(problem, relation="path").certificate, 0.9)
    ends = hull.proof.corners[:, 0]
    assert hull.proof.share(hull.problem) == (ends.max() - ends.min()) / 8 > 0.1 and cg.check(hull)
