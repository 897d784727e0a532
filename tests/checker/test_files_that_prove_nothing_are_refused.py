"""Files whose proof does not fit their problem are refused with a reason: whatever proofs assume is asked for.

Each is a file that is proved, with one thing changed; what is refused here and proved elsewhere would be a false claim.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import truncnorm

from canonical_simulator import Simulator
from certificate_files import file_of, one_crane, two_carts, two_tanks
from certigym.synthesis.checker import Unreadable, check_contents, parse_file, read_problem
from certigym.synthesis.checker.constraints import kinds_of, mean_of, sized
from certigym.synthesis.checker.distributions import (
    LIGHT,
    LONG,
    NORMAL,
    STOPPED,
    read_distribution,
)
from certigym.synthesis.checker.fields import Entry
from certigym.synthesis.checker.intervals import mul
from certigym.synthesis.checker.verdict import Verdict

Change = Callable[[dict[str, Any], list[np.ndarray]], None]


@pytest.fixture(autouse=True)
def arithmetic_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("certigym.synthesis.checker.verdict.wrong_arithmetic", lambda: "")


def verdict_of(made: Any, change: Change) -> Verdict:
    header, arrays = made()
    header, arrays = copy.deepcopy(header), [own.copy() for own in arrays]
    header["claim"]["failure"] = 1.0 - 1e-9
    change(header, arrays)
    return check_contents(parse_file(file_of(header, arrays)))


def agent(header: dict[str, Any], i: int = 0) -> dict[str, Any]:
    found: dict[str, Any] = header["problem"]["agents"][i]
    return found


def at(number: int, place: Any, value: Any) -> Change:
    def change(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
        arrays[number][place] = value

    return change


def with_agent(i: int = 1, **more: Any) -> Change:
    return lambda header, arrays: agent(header, i).update(more)


def as_task(text: str) -> Change:
    return lambda header, arrays: header["problem"]["task"].update(formula=text)


def paired(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
    pair = {"name": "near", "agents": [0, 1], "outputs": [[0], [0]], "radius": 0.5}
    header["problem"]["pairs"] = [pair]


def bent(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
    for key in "ABc":
        del agent(header, 1)[key]
    agent(header, 1)["dynamics"] = ["max(0.8*y, -1) + u"]


def sharing(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
    for own in header["problem"]["agents"]:
        own["shared_noise"] = [[0.1]]


def moving_region(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
    header["problem"]["regions"][0]["low"] = [[1.0], [1.0], [1.1]]


def turning(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
    edges = np.linspace(-np.pi, np.pi, 17)
    agent(header, 0).update(angles=["x"], state_low=[float(edges[0])], state_high=[float(edges[-1])])


def without_inverse(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
    for entry in header["proof"]["agents"]:
        entry["inverse"] = None
    del arrays[9]
    for entry in header["proof"]["agents"]:
        for key in ("sets", "start_sets", "policy", "inputs"):
            entry[key] -= entry[key] > 9


CELLS: dict[str, Change] = {
    "pairs": paired,
    "angles": turning,
    "shared noise": sharing,
    "noise of two sources": with_agent(noise=[[0.3, 0.2]]),
    "no noise": with_agent(noise=[[0.0]]),
    "another distribution": with_agent(distributions=[{"law": "laplace", "scale": 0.1}]),
    "another deviation": with_agent(distributions=[{"law": "gaussian", "std": 3.0}]),
    "a size of the noise": with_agent(noise_scale=["1 + y"]),
    "a larger workspace": with_agent(state_high=[5.0]),
    "a smaller workspace": with_agent(state_high=[3.9]),
    "regions that move": moving_region,
    "a box that inputs leave": with_agent(input_high=[1.9]),
    "a box that targets leave": with_agent(0, input_high=[1.0]),
    "dynamics that are bent": bent,
    "no matrix for targets": without_inverse,
    "a guard that leads elsewhere": at(1, 0, 1),
    "a guard out of another state": at(0, 0, 2),
    "guards that overlap": at(2, (0, 1), 1),
    "sets that are larger": at(10, (0, 10), True),
    "sets of the start": at(13, (0, 12), True),
    "another formula": as_task("full_0 & full_1"),
    "a vertex twice": at(3, (1, 2), 0),
    "kept twice": at(5, (1, 2), 0),
    "kept that is not there": at(5, (1, 2), 4),
    "a child that is not there": at(3, (0, 3), 1),
    "rows out of order": at(3, (0, 0), 1),
}


@pytest.mark.parametrize("what", CELLS)
def test_cells_are_refused_with(what: str) -> None:
    assert verdict_of(two_tanks, lambda header, arrays: None)
    verdict = verdict_of(two_tanks, CELLS[what])
    assert not verdict and verdict.recomputed == 1.0 and verdict.lower_bound == 0.0
    assert "REFUSED" in str(verdict) and verdict.reason


NONSENSE: dict[str, Change] = {
    "a negative vertex": at(5, (1, 2), -1),
    "a negative child": at(3, (0, 3), -1),
    "a guard that is not there": at(3, (0, 2), 4),
    "a time beyond the horizon": at(3, (4, 0), 2),
    "a set that is not there": at(2, (0, 0), 2),
    "a negative set": at(2, (0, 0), -1),
    "a choice that is not there": at(14, (0, 0, 0), 4 + 257),
    "edges that do not increase": at(6, 3, -4.0),
    "a lattice that does not increase": at(7, 3, -8.0),
    "a policy for other times": lambda header, arrays: arrays.__setitem__(11, np.repeat(arrays[11], 3, axis=0)),
    "other values": lambda header, arrays: header["proof"]["agents"][0].update(values="points"),
    "a truth value for a number": lambda header, arrays: header["proof"]["agents"][0].update(parts=True),
    "no parts": lambda header, arrays: header["proof"]["agents"][0].update(parts=0),
    "an array that nothing names": lambda header, arrays: arrays.append(np.zeros(2)),
    "a claim beyond 1": lambda header, arrays: header["claim"].update(failure=1.5),
    "another kind": lambda header, arrays: header["proof"].update(kind="trees"),
    "a negative union": lambda header, arrays: arrays.__setitem__(4, np.array([[0, 0, 0, -1, 0, 2]], np.int32)),
    "a union of no agent": lambda header, arrays: arrays.__setitem__(4, np.array([[0, 0, 0, 1, 2, 1]], np.int32)),
    "a remainder of no agent": lambda header, arrays: arrays.__setitem__(4, np.array([[0, 0, 0, 1, 0, 3]], np.int32)),
    "a remainder below all agents": lambda header, arrays: arrays.__setitem__(
        4, np.array([[0, 0, 0, 1, 0, -3]], np.int32)
    ),
}


@pytest.mark.parametrize("what", NONSENSE)
def test_cells_are_unreadable_with(what: str) -> None:
    with pytest.raises(Unreadable):
        verdict_of(two_tanks, NONSENSE[what])


TWICE: dict[str, Change] = {
    "agents": lambda header, arrays: agent(header, 1).update(name="left"),
    "states": with_agent(0, states=["x", "x"], dynamics=["x + u", "x"]),
    "a state and an input": with_agent(0, inputs=["x"]),
    "a state and a disturbance": with_agent(0, disturbances={"x": [0.0, 0.0]}),
    "regions": lambda header, arrays: header["problem"]["regions"][1].update(name="goal_0"),
    "a region and a pair": lambda header, arrays: header["problem"]["pairs"][0].update(name="rock"),
}


@pytest.mark.parametrize("what", TWICE)
def test_a_name_stands_for_one_thing(what: str) -> None:
    with pytest.raises(Unreadable, match="a name stands there twice"):
        verdict_of(two_carts, TWICE[what])


def test_agents_that_differ_in_one_number_share_no_kernel() -> None:
    """Two equal tanks; the second one gets more noise, other inputs, another matrix: only then its value is another."""

    def alike(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
        entry, second = header["proof"]["agents"][0], agent(header, 1)
        header["problem"]["agents"][1] = {**agent(header, 0), "name": "second", "states": ["x"], "outputs": ["x"]}
        assert second["name"] == "second"
        header["problem"]["regions"][1]["high"] = [None]
        header["problem"]["regions"][2]["low"] = [9.0]
        header["problem"]["regions"][2]["high"] = [9.0]
        header["proof"]["agents"][1] = {**entry}
        del arrays[12:]

    def changed(**more: Any) -> float:
        def change(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
            alike(header, arrays)
            agent(header, 1).update(more)

        return verdict_of(two_tanks, change).recomputed

    same = changed()
    assert same < 0.1
    assert changed(noise=[[0.5]]) > 2.0 * same
    assert changed(A=[[0.4]]) != same
    assert changed(input_high=[1.0]) == 1.0


CARTS: dict[str, Change] = {
    "a start outside": with_agent(0, start_high=[11.0]),
    "a start partly outside": with_agent(0, state_low=[-4.02], start_low=[-4.05], start_high=[-3.95]),
    "another start": with_agent(0, start_low=[-4.1], start_high=[-4.1]),
    "nominal inputs outside": with_agent(0, input_high=[0.7]),
    "nominal states outside": with_agent(0, state_low=[-3.5], start_low=[-3.4], start_high=[-3.4]),
    "words that are not accepted": at(0, (4, 0), 0),
    "a letter of a pair that nothing keeps": at(0, (2, 3), 0),
    "a face without limit": at(1, (2, 2), 1),
    "a direction that is none": at(2, (2, 0), 0.0),
    "a crossing of a pair": at(0, (2, 3), 2),
    "another formula": as_task("G !rock"),
    "a formula of other names": as_task("F home"),
    "what is not defined": with_agent(0, dynamics=["x + u + 0.05*sqrt(x)"]),
    "no slope": with_agent(0, dynamics=["x + u + 0.05*log(x + 4)"]),
    "dynamics that explode": with_agent(0, dynamics=["x + u + 1e120*sin(x)"]),
}


@pytest.mark.parametrize("what", CARTS)
def test_trajectories_are_refused_with(what: str) -> None:
    assert verdict_of(two_carts, lambda header, arrays: None)
    verdict = verdict_of(two_carts, CARTS[what])
    assert not verdict and verdict.reason


def test_more_steps_than_the_horizon_are_no_proof() -> None:
    with pytest.raises(Unreadable):
        verdict_of(two_carts, lambda header, arrays: header["problem"].update(horizon=3))
    # a finite-trace task is judged at the horizon
    header, arrays = two_carts()
    header["problem"]["task"] |= {"semantics": "finite-trace", "formula": "true"}
    header["problem"]["task"]["automaton"] = {
        "initial": 0, "accepting": [True], "root": [-1], "variable": [], "low": [], "high": [],
    }  # fmt: skip
    header["claim"]["failure"] = 0.5
    assert check_contents(parse_file(file_of(header, arrays)))
    header["problem"]["horizon"] = 5
    assert "before the horizon" in check_contents(parse_file(file_of(header, arrays))).reason


def test_nominal_inputs_are_in_their_box_also_where_nothing_is_fed_back() -> None:
    def change(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
        agent(header).update(input_high=[0.7])
        arrays[4] = 0.0 * arrays[4]

    assert "the nominal input `u` of `left` leaves its box at time 0" in verdict_of(two_carts, change).reason


def test_a_region_that_a_step_jumps_over_is_not_met() -> None:
    """The load rises by .9 in a step: a window of heights from 2 to 2.3 is below it before it was ever in it."""
    low = verdict_of(one_crane, lambda header, arrays: header["problem"]["regions"][0].update(high=[None, 2.3]))
    assert not low and low.recomputed == 1.0 and "no jump over `hung` at time 3" in low.reason


def test_nothing_is_crossed_along_an_angle() -> None:
    """An angle has copies: a run may come to a region of it from both sides."""
    for face in (0, 1, 4):
        verdict = verdict_of(one_crane, at(1, (slice(2, None), 0), face))
        assert "crossed from no side, or along an angle" in verdict.reason, face


def test_an_agent_is_no_pair_with_itself() -> None:
    """The difference of an agent and itself is 0: nobody means that."""
    with pytest.raises(Unreadable, match="one agent stands there twice"):
        verdict_of(two_carts, lambda header, arrays: header["problem"]["pairs"][0].update(agents=[1, 1]))


def test_sizes_of_noise_that_states_share_and_that_turn_are_refused() -> None:
    """What one source adds to two states may cancel in one size and not in another; an angle is no size."""
    shared = verdict_of(one_crane, with_agent(0, noise=[[1.0, 0.0], [1.0, 0.0]]))
    assert "several states" in shared.reason
    assert "turn further" in verdict_of(one_crane, with_agent(0, noise_scale=["1", "a"])).reason


def sized_in(header: dict[str, Any], t: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Factors of the noise of the first agent at a time, what they may be off by, and what they are before."""
    problem = read_problem(header)
    factor = problem.noise[problem.slices[0]]
    found, off, _ = sized(problem.agents[0], factor, {"t": np.full((2, 1), float(t))}, t)
    return found, off, factor


def test_sizes_that_name_the_time_are_known_with_their_signs() -> None:
    """One source moves two states in opposite directions; factors are off by no more than is said, and that is tiny."""
    header, _ = one_crane()
    agent(header).update(
        noise=[[0.3], [0.2]], noise_scale=["1 + 0.5*sin(t)", "-exp(0.1*t)"], shared_noise=[[0.7], [0.4]]
    )
    del agent(header)["distributions"]
    for t in range(5):
        found, off, factor = sized_in(header, t)
        true = np.array([[0.3 * (1.0 + 0.5 * np.sin(t)), 0.7], [-0.2 * np.exp(0.1 * t), 0.4]])
        assert np.all(np.abs(found - true) <= off + 1e-16 * np.abs(true)) and np.all(off <= 1e-13)
        assert np.all(off[:, 0] > 0.0) and np.array_equal(found[:, 1], factor[:, 1]) and np.all(off[:, 1] == 0.0)


def test_sources_that_move_some_of_the_states_are_read_at_random_times() -> None:
    header, _ = one_crane()
    agent(header).update(noise=[[0.3, 0.0], [0.0, 0.2]], noise_scale=["1 + 0.1*y", "1"])
    agent(header).pop("distributions")
    assert kinds_in(header) == [STOPPED, STOPPED]


def kinds_in(header: dict[str, Any]) -> list[int]:
    """What is known of the tails of all sources."""
    found: list[int] = kinds_of(read_problem(header)).tolist()
    return found


def test_sources_have_the_kind_of_their_law_and_of_what_multiplies_it() -> None:
    """Normal noise whose size names a state, an input or a disturbance is read at a random time; the time is none."""
    sizes = {"1 + 0.1*t": NORMAL, "2": NORMAL, "1 + 0.1*x": STOPPED, "1 + 0.1*u": STOPPED, "1 + v": STOPPED}
    for size, kind in sizes.items():
        header, _ = two_carts()
        agent(header).update(noise_scale=[size], disturbances={"v": [-0.1, 0.1]})
        assert kinds_in(header) == [kind, NORMAL, NORMAL]
        for law, tail in (
            ({"law": "uniform", "low": -1.0, "high": 1.0}, LIGHT),
            ({"law": "laplace", "scale": 1.0}, LONG),
        ):
            agent(header).update(distributions=[law])
            assert kinds_in(header) == [tail, NORMAL, NORMAL]


def test_factors_of_noise_have_deviations_and_shared_sources_stand_last() -> None:
    header, _ = two_carts()
    agent(header, 1).update(noise=[[0.3, -0.2]], distributions=[{"law": "gaussian", "std": 0.5}] * 2)
    assert read_problem(header).noise.tolist() == [[0.1, 0.0, 0.0, 0.02], [0.0, 0.15, -0.1, 0.02]]


def test_agents_without_inputs_have_proofs() -> None:
    """A state that nothing steers: the bound is there, and runs fail no more often."""
    steps = 3
    own = {
        "name": "a", "states": ["x"], "inputs": [], "dynamics": ["0.5*x"], "outputs": ["x"], "state_low": [-1.0],
        "state_high": [1.0], "input_low": [], "input_high": [], "start_low": [0.5], "start_high": [0.5],
        "noise": [[0.25]],
    }  # fmt: skip
    accepts = {"initial": 0, "accepting": [True], "root": [-1], "variable": [], "low": [], "high": []}
    task = {"semantics": "finite-trace", "automaton": accepts}
    header: dict[str, Any] = {
        "format": "certigym-certificate", "version": 3, "name": "still", "claim": {"failure": 0.1},
        "problem": {"horizon": steps, "agents": [own], "regions": [], "pairs": [], "task": task},
        "proof": {"kind": "trajectory", "letters": 0, "faces": 0, "normals": 1,
                  "agents": [{"inputs": 2, "gains": 3, "states": 4, "widths": 5}]},
    }  # fmt: skip
    states = 0.5 ** np.arange(1, steps + 2)[:, None]
    arrays: list[np.ndarray] = [np.zeros((steps + 1, 0), np.int8), np.zeros((steps + 1, 0)), np.zeros((steps, 0)),
              np.zeros((steps, 0, 1)), states, np.full((steps + 1, 1), np.inf)]  # fmt: skip
    verdict = check_contents(parse_file(file_of(header, arrays)))
    failed = Simulator(header["problem"]).failures(header["proof"], arrays, np.random.default_rng(0), 20_000) / 20_000
    assert verdict and 1e-3 < failed < verdict.recomputed + 0.01 and "no formula" in str(verdict)


def test_noise_of_students_law_that_is_given_up_is_claimed_by_nobody() -> None:
    """Each step of each source counts what its envelope gives up, also where nothing else can fail."""
    law = {"law": "student-t", "scale": 1e-6, "df": 4.0}
    lost = read_distribution(Entry(law, "it")).lost

    def change(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
        agent(header).update(distributions=[{"law": "uniform", "low": -1e-6, "high": 1e-6}, law])

    assert 3 * lost <= verdict_of(one_crane, change).recomputed < 3.1 * lost


def test_what_a_direction_multiplies_is_multiplied_with_it() -> None:
    """A pair that is kept apart along 2 n, or n / 2, is the same claim."""
    found = [verdict_of(two_carts, at(2, slice(None), -size)).recomputed for size in (0.5, 1.0, 2.0)]
    assert max(found) - min(found) < 1e-9


def test_guards_of_the_start_and_of_steps_are_both_asked() -> None:
    """The letter of time 0 has guards of its own: either table may lead elsewhere."""

    def apart(forged: int) -> Change:
        def change(header: dict[str, Any], arrays: list[np.ndarray]) -> None:
            header["proof"]["start"].update(target=len(arrays))
            arrays.append(arrays[1].copy())
            if forged:
                arrays[forged][0] = 1

        return change

    assert verdict_of(two_tanks, apart(0))
    for number in (1, 15):
        assert "does not always lead" in verdict_of(two_tanks, apart(number)).reason


def test_means_of_noise_are_multiplied_by_its_size_and_may_be_off() -> None:
    """The mean of a law, for all sizes, lies between the ends of what is pushed."""
    header, _ = two_carts()
    law = {"law": "truncated-gaussian", "spread": 0.3, "low": -0.25, "high": 1.0}
    agent(header).update(noise=[[2.0]], distributions=[law])
    own = read_problem(header).agents[0]
    low, high = mul(np.array([[0.5], [3.0]]), mean_of(own))[:, 0].tolist()
    mean = 2.0 * float(truncnorm(-0.25 / 0.3, 1.0 / 0.3, scale=0.3).mean())
    assert low <= 0.5 * mean and high >= 3.0 * mean and high - low <= 2.6 * mean
