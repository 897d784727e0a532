"""Figures show the certificate's own numbers, and the command draws every kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.validation.presentation.figures import certificate_figures as figures
from certigym.validation.statistical_tests import OddsScale


@pytest.fixture(scope="module")
def certificate() -> cg.Certificate:
    return cg.synthesize(cg.make_problem("reach-avoid-v0", horizon=3), cells=50).certificate


def test_a_map_shows_the_bounds_of_the_certificate(certificate: cg.Certificate) -> None:
    figure = figures.value_figure(certificate, points=20)
    mesh = figure.axes[0].collections[0]
    assert mesh.get_clim() == (0.0, 1.0)
    values: Any = np.asarray(mesh.get_array()).reshape(20, 20)
    centres = [-20 + 25 * (k + 0.5) / 20 for k in range(20)]
    bounds = certificate.at([[x, y] for y in centres for x in centres]).reshape(20, 20)
    odds = OddsScale.of(bounds)
    assert values[3, 7] == odds.at(bounds[3, 7]) and 0.0 < odds.at(bounds[3, 7]) < 1.0
    assert "lower bound" in figure.axes[1].get_ylabel()
    assert [label.get_text() for label in figure.axes[1].get_yticklabels()] == [name for name, _ in odds.ticks]


@pytest.mark.thorough
def test_the_command_draws_every_kind(
    certificate: cg.Certificate, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "c.npz"
    cg.save(certificate, file)
    for kind in ("value", "rollouts", "automaton", "rank", "tree"):
        out = tmp_path / f"{kind}.png"
        assert main(["plot", kind, str(file), "--out", str(out)]) == 0
        assert out.stat().st_size > 5_000
    out = tmp_path / "horizon.svg"
    arguments = ["plot", "horizon", "reach-avoid-v0", "--horizons", "1", "2", "--cells", "20", "--episodes", "100"]
    assert main([*arguments, "--out", str(out)]) == 0
    assert out.stat().st_size > 5_000
    assert main(["plot", "value", str(file), "--out", str(tmp_path / "v.txt")]) == 2
    assert "`--out`: expected a file name that ends in .png" in capsys.readouterr().err
    assert main(["plot", "value", str(file), "--out", str(tmp_path / "v.png"), "--axes", "0", "9"]) == 2
    assert "`axes`: expected one or two different joint coordinates" in capsys.readouterr().err
