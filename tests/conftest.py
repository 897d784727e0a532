"""What several tests use and what is expensive to make: made once in a session (on each worker).

Searches are smaller here than users have them (``smaller_searches``): what is claimed is as true, and proved by the
same code. Tests of how much is found say so: ``pytest.mark.thorough``.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import settings

import certigym as cg
from certigym.synthesis import agreement
from certigym.synthesis.cells import in_grid_coordinates
from certigym.synthesis.choosing import cell_budget, effort
from certigym.synthesis.models import box_model, common_choices, ellipsoid_program, ellipsoid_search
from certigym.synthesis.nominal_paths import nonlinear_search, nonlinear_team
from certigym.validation.policies import imitation, probing
from certigym.validation.reports import explorer
from network_problems import RNG

# A suite that draws anew fails by luck; `pytest --hypothesis-profile=anew` explores.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("anew", deadline=None)
settings.load_profile("same")

SMALLER: tuple[tuple[Any, str, Any], ...] = (
    # Ways to certify are tried as long as effort is left, which is about a minute for users.
    (effort, "EFFORT", 2.0),
    # Quick upper ends, which users have by default: an evaluation more of each certificate, in file and check, too.
    (effort, "SHARE_ABOVE", 0.0),
    # An eighth of the semidefinite programs, of which each ellipsoid takes hundreds.
    (ellipsoid_search, "LABEL_SHARES", (2.0, 1.0, 0.7, 0.45, 0.2, 0.1)),
    (ellipsoid_search, "FIRST_MULTIPLIERS", (0.2, 0.5, 0.8, 0.95)),
    (ellipsoid_search, "LAST_STEP", 2e-2),
    # Menus of inputs: less than half of them in each dimension.
    *((module, "INPUT_LEVELS", {1: 7, 2: 5, 3: 3}) for module in (box_model, common_choices, cell_budget)),
    # Paths are planned with more times, refined and moved a little a hundred times: the first few gain the most.
    (nonlinear_search, "GENERATIONS", 3),
    (nonlinear_search, "MORE_REPLANS", 0),
    (nonlinear_team, "MOST_MOVES", 2),
    (nonlinear_team, "REFINED", 1),
    (nonlinear_team, "POLISHED", ((1, 6),)),
    # Clones of controllers: a sixth of the regression, and of the episodes that choose among attempts.
    (imitation, "ROUNDS", 600),
    (probing, "CHOOSING", 1000),
    # Reports ask the check about a tenth of the starts around that of a path.
    (explorer, "MOST_WORK", 400),
)
"""Modules, constants, and values with which searches end earlier."""


@pytest.fixture(scope="session", autouse=True)
def smaller_searches() -> Iterator[None]:
    """Searches whose results the tests do not judge take a share of the time, also in fixtures of modules."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in SMALLER:
            patch.setattr(module, name, value)
        patch.setattr(ellipsoid_search, "EllipsoidProgram", known_program)
        yield


PROGRAMS: dict[tuple[Any, ...], ellipsoid_program.EllipsoidProgram] = {}


def known_program(agent: cg.LinearAgent, *numbers: Any) -> ellipsoid_program.EllipsoidProgram:
    """The semidefinite program of an ellipsoid: one with the same numbers is compiled, and asked the same, once."""
    coordinates, half, room, delta = numbers
    moves, box = in_grid_coordinates(agent, coordinates), agent.input_box
    arrays = (moves.A, moves.B, moves.covariance, box.low, box.high, coordinates, half, room)
    key = (delta, *((np.shape(array), np.asarray(array, dtype=float).tobytes()) for array in arrays))
    if key not in PROGRAMS or sys.modules.get("cvxpy") is None:
        PROGRAMS[key] = ellipsoid_program.EllipsoidProgram(agent, *numbers)
    return PROGRAMS[key]


USUAL = [getattr(module, name) for module, name, _ in SMALLER]


@pytest.fixture(autouse=True)
def usual_searches(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Searches as users have them, for tests marked ``thorough``: all of them, or the modules that the mark names."""
    mark = request.node.get_closest_marker("thorough")
    if mark is not None:
        assert {*mark.args} <= {module for module, _, _ in SMALLER}, mark.args
        for (module, name, _), value in zip(SMALLER, USUAL, strict=True):
            if not mark.args or module in mark.args:
                monkeypatch.setattr(module, name, value)


SLOW = """
    adversary agents_may_be_coupled boxes_certificates_are_checked boxes_values_are_below_the_truth
    certificates_are_checked certificates_have_another_end check_answers_whatever_it_is_given
    claims_hold_in_ball_arithmetic clients_find_what_they_expect command_line
    common_inputs_stand_against_another_simulation coupled_tasks_have_one_automaton
    deadlines_leave_few_states_at_a_time describe_says_which_ways_apply disturbances_have_a_behaviour
    environments_behind_shields every_id_conforms every_way_that_applies_is_tried everything_composes
    examples_ship_certificates expressions_are_read_and_enclosed expressions_have_exact_targets field_benchmarks
    findings_are_as_told finer_levels_gain fleets_are_certified_along_paths given_policies_are_certified
    guards_are_disjoint gymnasium_envs inner_terms_are_rounded inputs_are_chosen_in_common
    inputs_stand_beside_targets labeling ladders_stay_below_the_sum laws_of_the_value learners_train_behind_shields
    limits_hold_for_hostile_input linear_certificates_are_checked linear_tables_bound_what_they_say
    linear_values_are_below_the_truth menus_keep_what_they_promise mixed_teams_are_certified
    models_of_strangers_are_measured mona_agrees networks_are_certified_as_they_are networks_have_linear_cells
    networks_keep_apart networks_move_bent_agents networks_of_problems_written_in_another_way
    networks_see_states_in_their_units noise_of_any_law noise_that_is_uneven nominal_paths_are_nearly_optimal
    nonlinear_paths_are_certified nothing_is_certified_with_a_reason other_programs_agree pairs_are_subtracted
    pairs_may_be_distances pairs_may_be_polygons parallel_env paths_are_certified
    paths_are_found_where_plans_are_hard paths_are_reported paths_know_other_laws
    paths_of_agents_that_name_each_other paths_reach_regions_of_shapes polar_inputs_reach_sectors policies_come_back
    probes_are_fair problem_files public_records_are_short regions_are_crossed regions_are_what_they_are rendering
    report_pages_in_a_browser reports_print_themselves reviewers_see_what_passes rounding_refuses_nothing_true
    safety_lasts_as_long_as_is_claimed sensors_may_be_noisy_or_see_neighbours sets_of_starts_are_certified
    shaped_rewards shields_keep_what_they_promise shields_know_any_noise shields_of_agents_with_expressions
    split_axes suite teams_are_one_agent teams_are_touched_up the_best_relation_is_kept
    the_check_grows_trains_itself the_clock_decides_nothing the_page_of_defaults_is_true
    the_studio_keeps_what_is_drawn the_trusted_base_is_known the_value_explorer_reads_what_is_certified
    theory_pages_are_whole time_is_certified trains_stay_within_their_error translation_is_correct
    tree_equals_dense_programming tube_relation validation_on_the_command_line values_hold_at_any_time
    what_is_shared_is_equal words_of_few_cubes worlds_live_on_devices written_agents_have_linear_cells
    written_certificates_are_checked
"""
"""Files that take some seconds on one core, without `test_`: `make quick` leaves them out."""


# What is collected stays until the end: there is no garbage to look for in it.
gc.disable()


def pytest_collection_finish() -> None:
    """Look for garbage from now on, among what tests make."""
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of slow files."""
    slow = {f"test_{name}" for name in SLOW.split()}
    for item in items:
        if item.path.stem in slow:
            item.add_marker(pytest.mark.slow)


@pytest.fixture(autouse=True)
def same_draws() -> None:
    """Networks and points are drawn anew for every test, the same whatever other tests ran before."""
    RNG.bit_generator.state = np.random.default_rng(0).bit_generator.state


@pytest.fixture(scope="session")
def synthesized() -> Callable[..., cg.Synthesis]:
    """``synthesized(problem, cells, **options)``, of an id or a Problem: the same result every time."""
    known: dict[tuple[Any, ...], cg.Synthesis] = {}

    def of(problem: str | cg.Problem, cells: Any = None, **options: Any) -> cg.Synthesis:
        problem = cg.make_problem(problem) if isinstance(problem, str) else problem
        key = (problem.fingerprint, repr(cells), *sorted((name, repr(value)) for name, value in options.items()))
        if key not in known:
            known[key] = cg.synthesize(problem, cells, **options)
        return known[key]

    return of


@pytest.fixture
def search_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Claims along paths as the search makes them, for sabotage of the search: the checker is not asked beforehand."""
    monkeypatch.setattr(agreement, "agreed_path", lambda certificate: certificate)
