"""Libraries that nobody here wrote find what they expect: numbers in infos, Python's own error for an unknown argument,
the same names in both registries, and refusals in words."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pettingzoo
import pytest

import certigym as cg
from certigym.envs.suite.ids import gymnasium_id
from certigym.envs.systems.arguments import UnknownArgument
from kinds import ALL_IDS, IDS_OF_KINDS

FORMS = ("parallel", "aec", "central", "vector")


def infos_of(id: str, form: str, **options: Any) -> list[dict[str, Any]]:
    """Infos of a reset and a few steps with random actions, one dictionary per agent and time."""
    if form == "central":
        env: Any = cg.central_env(id, **options)
        env.action_space.seed(0)
        return [env.reset(seed=0)[1], env.step(env.action_space.sample())[-1]]
    if form == "vector":
        env = cg.vector_env(id, 3, **options)
        env.action_space.seed(0)
        return [env.reset(seed=0)[1], env.step(env.action_space.sample())[-1]]
    if form == "aec":
        env = cg.aec_env(id, **options)
        env.reset(seed=0)
        return list(env.infos.values())
    env = cg.parallel_env(id, **options)
    infos = list(env.reset(seed=0)[1].values())
    while env.agents:
        infos += list(env.step({name: env.action_space(name).sample() for name in env.agents})[-1].values())
    return infos


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("id", IDS_OF_KINDS)
def test_infos_hold_numbers_and_arrays_of_fixed_shape(id: str, form: str) -> None:
    infos = infos_of(id, form)
    shapes: dict[str, set[tuple[int, ...]]] = {}
    for info in infos:
        assert {"automaton_state", "satisfied", "time", "state"} <= info.keys()
        for name, value in info.items():
            array = np.asarray(value)
            assert array.dtype.kind in "bif", f"{name}: {value!r}"
            if name not in ("state", "_state"):  # agents of one problem may have states of different sizes
                shapes.setdefault(name, set()).add(array.shape)
    assert all(len(found) == 1 for found in shapes.values()), shapes


@pytest.mark.parametrize("form", ["parallel", "aec", "central"])
def test_words_come_on_request(form: str) -> None:
    problem: Any = cg.make_problem("reach-avoid-v0", initial_state=[0.0, -4.0])
    assert infos_of(problem, form, infos="words")[0]["letter"] == ("p1",)
    with pytest.raises(ValueError, match="`infos`: expected 'numbers' or 'words', got 'letters'"):
        infos_of(problem, form, infos="letters")


@pytest.mark.parametrize("make", [cg.parallel_env, cg.aec_env, cg.central_env, cg.vector_env, cg.make_problem])
def test_an_unknown_argument_is_a_mistake_of_both_kinds(make: Any) -> None:
    with pytest.raises(UnknownArgument) as caught:
        make("meeting-v0", frameskip=4)
    assert isinstance(caught.value, ValueError) and isinstance(caught.value, TypeError)
    assert "unexpected keyword argument 'frameskip'" in str(caught.value)
    assert "horizon" in str(caught.value)
    assert ("reward" in str(caught.value)) == (make is not cg.make_problem)  # options of environments alone
    if make is not cg.make_problem:
        with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
            make(cg.make_problem("meeting-v0"), frameskip=4)


@pytest.mark.parametrize("id", ALL_IDS)
def test_both_libraries_know_both_names(id: str) -> None:
    for name in (f"certigym/{id}", gymnasium_id(id)):
        assert gymnasium.spec(name).kwargs == {"problem": id}
        assert cg.make_problem(name).fingerprint == cg.make_problem(id).fingerprint
    made: Any = gymnasium.make(f"certigym/{id}").unwrapped
    other: Any = pettingzoo.make("parallel", gymnasium_id(id))
    assert made.problem.fingerprint == other.problem.fingerprint == cg.make_problem(id).fingerprint


@pytest.mark.parametrize("form", ["parallel", "central", "vector"])
def test_unknown_keys_of_reset_are_refused(form: str) -> None:
    env: Any = getattr(cg, f"{form}_env")("reach-avoid-v0")
    with pytest.raises(ValueError, match=r"`options`: expected the keys 'initial_state'.*, got 'initial_sate'"):
        env.reset(seed=0, options={"initial_sate": [-7.0, -3.0]})
    env.reset(seed=0, options={"initial_state": [-7.0, -3.0]})
    env.reset(seed=0, options={"options": 1})  # PettingZoo's conformance tests pass this to every environment
