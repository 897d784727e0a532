"""What was probably meant is said: of names in files, of dynamics like derivatives, of windows too long."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import certigym as cg
from certigym.cli.main import main
from certigym.envs.tasks.problem import doubts, problem_from_toml, why_unsatisfiable

FILE = """
specification = "F goal"
horizon = 20
[[agents]]
name = "cart"
states = ["x", "y"]
inputs = ["u", "v"]
dynamics = ["x + 0.5*u", "y + 0.5*v"]
noise_std = 0.1
state_low = -5
state_high = 5
input_low = -1
input_high = 1
initial_state = 0
[propositions.goal]
agent = "cart"
low = [2, 2]
high = [3, 3]
"""


def test_one_number_stands_for_all_axes() -> None:
    agent = problem_from_toml(FILE).agents[0]
    assert agent.state_low.tolist() == [-5.0, -5.0] and agent.input_high.tolist() == [1.0, 1.0]
    assert np.array_equal(agent.noise_covariance, np.diag([0.1**2, 0.1**2]))
    laws = problem_from_toml(FILE.replace("noise_std = 0.1", 'noise = { law = "laplace", scale = 0.1 }')).agents[0].laws
    assert laws is not None and len(laws) == 2


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"x + 0.5*u", "y + 0.5*v"', '"u", "v"', 'write dynamics = ["x + dt*(u)", "y + dt*(v)"]'),
        ('"F goal"', '"F[5,30] goal"', "runs end after 20 steps"),
        (
            '"F goal"',
            '"!goal U[5,40] goal"',
            "`!goal U[5,40] goal` has a window beyond the horizon",
        ),
        ('"F goal"', '"!goal U[5,20] goal"', ""),
        ('"F goal"', '"G F[2,25] goal"', "end the window at 20"),
        ('"F goal"', '"F[5,20] goal"', ""),
        ('"x + 0.5*u", "y + 0.5*v"', '"y", "x + u + v"', 'write dynamics = ["x + dt*(y)"'),
        ('"x + 0.5*u", "y + 0.5*v"', '"y", "0.5*y + u + v"', ""),
    ],
)
def test_doubts(old: str, new: str, says: str) -> None:
    told = doubts(problem_from_toml(FILE.replace(old, new)))
    assert says in "".join(told) and bool(told) == bool(says)


def test_doubts_are_none_in_the_suite() -> None:
    assert {name: told for name in cg.problem_ids() if (told := doubts(cg.make_problem(name)))} == {}


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("noise_std = 0.1", 'noise = { law = "studnt-t", scale = 0.1 }', "did you mean 'student-t'?"),
        ('"x + 0.5*u"', '"x\' = x + 0.5*u"', "give the right-hand side alone"),
        ("input_high = 1\n", "", "`input_high` is missing"),
        ('"F goal"', '"F gaol"', "did you mean goal?"),
    ],
)
def test_files(old: str, new: str, says: str) -> None:
    with pytest.raises(ValueError) as refused:
        problem_from_toml(FILE.replace(old, new))
    assert says in str(refused.value)


def test_files_and_relations_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cart.toml").write_text(FILE, encoding="utf-8")
    for words, says in (["cart"], "`cart.toml`"), (["crat.toml"], "`cart.toml`"):
        assert main(["run", *words]) == 2 and f"did you mean {says}?" in capsys.readouterr().err
    assert main(["run", "cart.toml", "--relation", "linaer"]) == 2
    assert "did you mean 'linear'?" in capsys.readouterr().err


def test_a_formula_that_looks_beyond_the_horizon_says_how_far() -> None:
    assert "it looks 30 steps ahead" in why_unsatisfiable(problem_from_toml(FILE.replace('"F goal"', '"X[30] goal"')))


def test_a_certificate_has_a_name_by_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cart.toml").write_text(FILE, encoding="utf-8")
    assert main(["synthesize", "cart.toml", "--cells", "6"]) == 0 and (tmp_path / "cart.npz").is_file()
    assert main(["synthesize", "cart.toml", "--cells", "6"]) == 2  # what was found is not written over
    assert "already there" in capsys.readouterr().err
