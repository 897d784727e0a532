"""Whoever keeps to the menus of a permissive certificate succeeds as promised; wrong menus are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

import certigym as cg
from certigym.envs.dynamics import Dynamics
from certigym.envs.dynamics import worlds as core
from certigym.synthesis.permissions import Menus, Permission
from certigym.synthesis.shielding import ActionValues, action_values
from certigym.validation.figures import menu_figure
from composing import certificate_of, problem_of
from shield_trials import moved, states_of

FALSE_ALARM = 1e-6
EPISODES = 5000


@pytest.fixture(scope="module")
def certificate() -> cg.Certificate:
    problem = cg.make_problem("reach-avoid-v0", horizon=5).replace(initial_state=[-14.0, -4.0])
    found = cg.synthesize(problem, 60, relation="exact").certificate
    assert isinstance(found, cg.Certificate)
    return found


@pytest.fixture(scope="module")
def permission(certificate: cg.Certificate) -> Permission:
    return cg.permit(certificate, probability=0.6)


def successes(permission: Permission, worst: bool, seed: int, values: ActionValues) -> int:
    """Episodes that succeed under choices from the menus: random ones, or the worst of eight joint ones."""
    problem, rng = permission.problem, np.random.default_rng(seed)
    dynamics = Dynamics.of(problem)
    worlds = core.initial(dynamics, rng, EPISODES)
    for time in range(problem.horizon):
        going = np.flatnonzero(~(worlds.failed | problem.automaton.absorbing[worlds.q]))
        states = tuple(x[:, going] for x in states_of(dynamics, worlds))
        q = int(worlds.q[going[0]])
        assert np.all(worlds.q[going] == q)
        best, least = None, np.full(len(going), np.inf)
        for _ in range(8 if worst else 1):
            tried = tuple(
                chosen(permission, agent.name, x, q, time, rng) for agent, x in zip(problem.agents, states, strict=True)
            )
            worth = values.of_inputs(time, q, states, tried)
            best = tried if best is None else best
            for u, new in zip(best, tried, strict=True):
                u[:, worth < least] = new[:, worth < least]
            least = np.minimum(least, worth)
        assert best is not None
        worlds = moved(dynamics, worlds, going, best, rng)
    return int(core.satisfied(dynamics, worlds).sum())


def chosen(permission: Permission, name: str, x: Any, q: int, time: int, rng: np.random.Generator) -> np.ndarray:
    """Random choices from the menus of one agent at states (d, M), as inputs; the middle where there is no menu."""
    allowed = permission.mask(name, x.T, q, time)
    points = np.argmax(rng.random(allowed.shape) * allowed, axis=1)
    box = permission.problem.agents[permission.problem.agent_names.index(name)].input_box
    inputs = permission.inputs(name, x.T, points).T
    return np.clip(np.where(allowed.any(axis=1), inputs, 0.0), box.low[:, None], box.high[:, None])


@pytest.mark.parametrize("worst", [False, True])
def test_whoever_keeps_to_the_menus_succeeds(permission: Permission, worst: bool) -> None:
    values = action_values(permission.certificate)
    found = successes(permission, worst, 3, values)
    assert permission.lower_bound >= 0.6
    assert binom.cdf(found, EPISODES, permission.lower_bound) >= FALSE_ALARM


KINDS = [
    "linear matrices",
    "linear expressions",
    "boxes matrices",
    "boxes Laplace",
    "boxes noise scale",
    "boxes no noise",
]


@pytest.mark.parametrize("kind", KINDS)
def test_menus_of_inputs_keep_what_they_promise(kind: str, tmp_path: Path) -> None:
    """Relations whose choices are inputs: random and adversarial behaviours, the check, files and forgeries."""
    found = certificate_of(kind)
    permission = cg.permit(found, probability=0.7 * found.lower_bound)
    assert cg.check(permission) and permission.lower_bound >= 0.7 * found.lower_bound
    values = action_values(permission.certificate)
    for seed, worst in enumerate((False, True)):
        assert binom.cdf(successes(permission, worst, seed, values), EPISODES, permission.lower_bound) >= FALSE_ALARM
    (menus,) = permission.menus
    assert len(menus.choices) > 1.5 * np.count_nonzero(menus.counts)
    cg.save(permission, tmp_path / "menus.npz")
    assert cg.check(cg.load(tmp_path / "menus.npz"))
    # One more choice on the menu of one cell, where the run begins: the worst input there is.
    forged = with_one_more(permission)
    report = cg.check(forged)
    assert not report and any("exceeds the recomputed" in text for text in report.failures)


def with_one_more(permission: Permission) -> Permission:
    """The permission with an input on the menu of the first cell at which the claim is lost."""
    (menus,), (part,) = permission.menus, permission.certificate.proof.agents
    controller = permission.certificate.controller.agents[0]
    start = permission.problem.agents[0].initial.low[:, None]
    cell, q = int(controller.grid.cell_of(controller.project(start))[0]), permission.problem.initial_q
    place = (0 * menus.counts.shape[1] + q) * menus.counts.shape[2] + cell
    end = int(menus.ends[place])
    there = menus.choices[end - int(menus.counts[0, q, cell]) : end]
    least = None
    for choice in np.setdiff1d(np.arange(len(part.relation["menu"])), there):
        counts = menus.counts.copy()
        counts[0, q, cell] += 1
        at = end - len(there) + int(np.searchsorted(there, choice))
        forged = replace(permission, menus=(Menus(counts, np.insert(menus.choices, at, choice).astype(np.int32)),))
        value = cg.check(forged).recomputed
        if least is None or value < least[0]:
            least = value, forged
    assert least is not None
    return least[1]


def test_menus_grow_as_less_is_kept(certificate: cg.Certificate, permission: Permission) -> None:
    tight = cg.permit(certificate, probability=0.79)
    loose = cg.permit(certificate, probability=0.2)
    sizes = [sum(len(menus.choices) for menus in found.menus) for found in (tight, permission, loose)]
    assert sizes[0] < sizes[1] < sizes[2]
    for menus, part in zip(
        tight.menus, certificate.proof.agents, strict=True
    ):  # the certificate's own choices are on them
        open_states = ~certificate.problem.automaton.absorbing
        assert np.all((menus.counts > 0)[:, open_states] == (part.policy >= 0)[:, open_states])


def test_menus_are_checked_and_saved(permission: Permission, tmp_path: Path) -> None:
    report = cg.check(permission)
    assert report and report.recomputed >= permission.lower_bound
    cg.save(permission, tmp_path / "menus.npz")
    loaded = cg.load(tmp_path / "menus.npz")
    assert cg.check(loaded) and loaded.lower_bound == permission.lower_bound
    assert [path.name for path in tmp_path.iterdir()] == ["menus.npz"]
    for mine, yours in zip(permission.menus, loaded.menus, strict=True):
        np.testing.assert_array_equal(mine.choices, yours.choices)
    (tmp_path / "other.npz").write_bytes(b"nothing")
    with pytest.raises(ValueError, match="expected a certigym certificate"):
        cg.load(tmp_path / "other.npz")


def test_wrong_menus_are_refused(permission: Permission) -> None:
    certificate, menus = permission.certificate, permission.menus
    too_much = replace(permission, lower_bound=permission.lower_bound + 1e-6)
    assert any("exceeds the recomputed" in text for text in cg.check(too_much).failures)
    # An input far beyond the box: the last lattice point for the first cell that has a choice.
    choices = menus[0].choices.copy()
    choices[0] = int(np.prod(certificate.proof.agents[0].lattice_shape)) - 1
    beyond = replace(permission, menus=(Menus(menus[0].counts, choices), *menus[1:]))
    assert any("beyond its input box" in text for text in cg.check(beyond).failures)
    choices = menus[0].choices.copy()
    choices[0] = 10**6
    for wrong, words in (
        ((Menus(menus[0].counts, choices), *menus[1:]), "not there"),
        ((Menus(menus[0].counts, choices[1:]), *menus[1:]), "not as many choices"),
        ((Menus(menus[0].counts[1:], choices), *menus[1:]), "do not fit"),
        (menus[:1], "one set of menus"),
    ):
        assert any(words in text for text in cg.check(replace(permission, menus=wrong)).failures)


def test_menus_are_drawn(permission: Permission) -> None:
    pytest.importorskip("matplotlib")
    figure = menu_figure(permission)
    q = int(np.flatnonzero(~permission.problem.automaton.absorbing)[0])
    drawn = np.asarray(figure.axes[0].collections[0].get_array()).reshape(5, -1)
    np.testing.assert_array_equal(drawn, permission.menus[0].counts[:, q])
    assert "control steps" in figure.axes[0].get_ylabel()
    with pytest.raises(ValueError, match="`agent`: expected a number from 0 to 1"):
        menu_figure(permission, agent=2)


def test_what_has_no_menus_is_refused_in_words(certificate: cg.Certificate) -> None:
    with pytest.raises(ValueError, match="`probability`: expected at most 0"):
        cg.permit(certificate, probability=0.9)
    with pytest.raises(ValueError, match="`probability`: expected a number"):
        cg.permit(certificate, probability=0)
    tube = cg.synthesize(problem_of("tube"), 24, relation="tube").certificate
    with pytest.raises(ValueError, match="expected the relation 'exact', 'boxes' or 'linear' for all agents, got tube"):
        cg.permit(tube, probability=0.01)
    trains = cg.synthesize(certificate.problem, 40, relation="exact", value="train").certificate
    with pytest.raises(ValueError, match="value tree"):
        cg.permit(trains, probability=0.1)
    with pytest.raises(ValueError, match="`agent`: expected one of"):
        cg.permit(certificate, probability=0.5).mask("nobody", [[0.0]], 0, 0)
