"""A claim that stands in balls stands in exact arithmetic: every number that the check relies on is proved."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import certigym as cg
from balls import check_rigorous, rigorous
from balls.ball_laws import ExactLaw
from certigym.envs.systems.distributions import Gaussian, Law
from certigym.synthesis.certificates.cell_probabilities import checked_kernel, checked_laws, hat_tables
from certigym.synthesis.certificates.proofs import GridProof, changed
from certigym.synthesis.extended_check.claims import pairs_check
from certigym.synthesis.extended_check.steps import (
    execution_of,
    map_enclosures,
    mean_enclosures,
    network_enclosures,
    relation_check,
    step_intervals,
)
from certigym.synthesis.relations.kinds import Network
from certigym.validation.policies.actors import SharedActor
from certigym.validation.policies.views import SharedView
from composing import certificate_of, problem_of
from kinds import mostly_thorough
from test_controllers_carry_out_what_is_certified import ordinary

flint = pytest.importorskip("flint")

from balls.ball_masses import lost  # noqa: E402
from balls.ball_memory import Memory  # noqa: E402
from balls.ball_proofs import PROOFS  # noqa: E402
from balls.ball_relations import mean_targets, targets  # noqa: E402

ROOT = Path(__file__).parents[2]


def synthesized(name: str, cells: int, **options: Any) -> Any:
    problem = cg.make_problem(name)
    problem = problem.replace(horizon=options.pop("horizon", min(6, problem.horizon)))
    return cg.synthesize(problem, cells, **options).certificate


KINDS: dict[str, tuple[str, int, dict[str, Any]]] = {
    "scalar agents": ("reach-avoid-v0", 60, {}),
    "independent tasks": ("invariance-4-v0", 40, {}),
    "twenty agents": ("reach-avoid-20-v0", 40, {"relation": "exact"}),
    "expressions": ("van-der-pol-v0", 10, {}),
    "trains": ("reach-avoid-v0", 40, {"search": cg.SearchOptions(value="train")}),
}


@mostly_thorough("kind", KINDS)
def test_honest_claims_stand(kind: str) -> None:
    name, cells, options = KINDS[kind]
    certificate = synthesized(name, cells, **options)
    plain, report = cg.check(certificate), check_rigorous(certificate)
    assert plain and report and report.numbers > 100, (plain, report)
    # What sums may have gained is taken off, and is small.
    assert certificate.lower_bound <= report.low <= plain.recomputed
    assert plain.recomputed == pytest.approx(report.low, abs=1e-8)


def test_coupled_axes_stand() -> None:
    certificate = cg.synthesize(ordinary(), 24, relation="exact").certificate
    report = check_rigorous(certificate)
    assert report and report.low == pytest.approx(certificate.lower_bound, abs=1e-8) and report.low > 0.5


def test_a_start_box_is_averaged() -> None:
    report = check_rigorous(cg.synthesize(robot(noise_covariance=[[0.04]], initial_state=None,
                                                initial_low=[-0.3], initial_high=[0.7]), 30).certificate)  # fmt: skip
    assert report and report.claimed <= report.low <= report.claimed + 1e-8


def robot(**changes: Any) -> cg.Problem:
    """One agent that is to reach a goal and keep its workspace."""
    agent: dict[str, Any] = {
        "name": "robot", "A": [[0.9]], "B": [[1.0]], "state_low": [-1.0], "state_high": [1.0],
        "input_low": [-0.6], "input_high": [0.6], "initial_state": [-0.3],
    }  # fmt: skip
    agent = {key: value for key, value in {**agent, **changes}.items() if value is not None}
    return cg.Problem(
        name="laws",
        horizon=3,
        agents=[cg.LinearAgent(**agent)],
        propositions={"goal": cg.Proposition("robot", [0.2], [0.6])},
        specification=cg.Specification("F goal", "co-safe"),
    )


LAWS: list[dict[str, Any]] = [
    {"law": "gaussian", "std": 0.2},
    {"law": "laplace", "scale": 0.1},
    {"law": "uniform", "low": -0.2, "high": 0.25},
    {"law": "triangular", "low": -0.2, "mode": 0.1, "high": 0.2},
    {"law": "triangular", "low": -0.2, "mode": -0.2, "high": 0.2},
    {"law": "logistic", "scale": 0.1},
    {"law": "student-t", "scale": 0.1, "df": 4.5},
    {"law": "truncated-gaussian", "spread": 0.2, "low": -0.1, "high": 0.3},
    {
        "law": "mixture",
        "parts": [
            {"weight": 0.3, "mean": -0.1, "law": "gaussian", "std": 0.2},
            {"weight": 0.7, "law": "laplace", "scale": 0.1},
        ],
    },
]  # fmt: skip


def name_of(law: dict[str, Any]) -> str:
    return f"{law['law']} {law.get('mode', '')}".strip()


def law_of(numbers: dict[str, Any]) -> Law:
    """The law with these numbers; agents with normal noise alone keep its variance instead."""
    laws = robot(noise=[numbers]).agents[0].laws
    return Gaussian(numbers["std"]) if laws is None else laws[0]


@mostly_thorough("numbers", LAWS, ids=name_of)
def test_every_law_is_proved(numbers: dict[str, Any]) -> None:
    for relation in ("exact", "boxes"):
        certificate = cg.synthesize(robot(noise=[numbers]), 40, relation=relation).certificate
        report = check_rigorous(certificate)
        assert report and certificate.lower_bound <= report.low, report


def density(law: Law, x: Any, m: Any) -> Any:
    """The density of a law, from the books, in the numbers of mpmath."""
    n = {key: m.mpf(value) for key, value in vars(law).items() if isinstance(value, float)}
    if law.name == "mixture":
        rows = zip(law.weights, law.means, law.laws, strict=True)  # type: ignore[attr-defined]
        return sum(m.mpf(w) * density(part, x - m.mpf(mean), m) for w, mean, part in rows)
    if law.name in ("gaussian", "truncated-gaussian"):
        spread = n["std"] if law.name == "gaussian" else n["spread"]
        inside = law.name == "gaussian" or n["low"] <= x <= n["high"]
        share = 1 if law.name == "gaussian" else m.ncdf(n["high"] / spread) - m.ncdf(n["low"] / spread)
        return m.npdf(x, 0, spread) / share if inside else m.mpf(0)
    if law.name == "uniform":
        return 1 / (n["high"] - n["low"]) if n["low"] <= x <= n["high"] else m.mpf(0)
    if law.name == "triangular":
        if not n["low"] <= x <= n["high"]:
            return m.mpf(0)
        side = (x - n["low"], n["mode"] - n["low"]) if x < n["mode"] else (n["high"] - x, n["high"] - n["mode"])
        return 2 / (n["high"] - n["low"]) * side[0] / side[1]
    if law.name == "laplace":
        return m.exp(-abs(x) / n["scale"]) / (2 * n["scale"])
    if law.name == "logistic":
        return 1 / (4 * n["scale"] * m.cosh(x / (2 * n["scale"])) ** 2)
    nu = n["df"]
    height = m.gamma((nu + 1) / 2) / (m.sqrt(nu * m.pi) * m.gamma(nu / 2) * n["scale"])
    return height * (1 + (x / n["scale"]) ** 2 / nu) ** (-(nu + 1) / 2)


@pytest.mark.parametrize("numbers", LAWS, ids=name_of)
def test_laws_mean_their_densities(numbers: dict[str, Any]) -> None:
    """Balls around probabilities of intervals hold the integral of the density; both tails hold all that there is."""
    m, law = pytest.importorskip("mpmath"), law_of(numbers)
    exact = ExactLaw(law)
    flint.ctx.prec = 106
    places = [-0.35, -0.15, -0.05, 0.0, 0.02, 0.15, 0.27]
    with m.workdps(30):
        ends = [getattr(law, name) for name in ("low", "mode", "high") if hasattr(law, name)]
        for a, b in zip(places, places[1:], strict=False):
            cuts = sorted({a, b, *(x for x in (*ends, 0.0, -0.1) if a < x < b)})
            true = m.quad(lambda x: density(law, x, m), [m.mpf(x) for x in cuts])
            for tail, sign in ((exact.cdf_ball, 1), (exact.sf_ball, -1)):
                ball = sign * (tail(flint.arb(b)) - tail(flint.arb(a)))
                assert abs(m.mpf(ball.mid().str(30, radius=False)) - true) < m.mpf("1e-15"), (a, b)
    for x in places:
        assert abs(exact.cdf_ball(flint.arb(x)) + exact.sf_ball(flint.arb(x)) - 1) < 1e-25


@pytest.mark.parametrize("numbers", [LAWS[0], LAWS[2]], ids=name_of)
def test_first_moments_mean_their_densities(numbers: dict[str, Any]) -> None:
    m, law = pytest.importorskip("mpmath"), law_of(numbers)
    exact = ExactLaw(law)
    flint.ctx.prec = 106
    with m.workdps(30):
        for a, b in ((-0.15, -0.05), (-0.05, 0.2), (0.1, 0.3)):
            inside = [m.mpf(x) for x in (a, *(e for e in (getattr(law, "high", 9.0),) if a < e < b), b)]
            true = m.quad(lambda x: x * density(law, x, m), inside)
            ball = exact.exact_mean(flint.arb(a), flint.arb(b))
            assert abs(m.mpf(ball.mid().str(30, radius=False)) - true) < m.mpf("1e-15")


def test_laws_that_are_numbers_of_their_author_are_refused() -> None:
    """No formula is known of them: what their author states is all that there is."""
    numbers = {"law": "scipy", "name": "gumbel_r", "scale": 0.1, "cdf_error": 1e-12, "variation": 8.0}
    certificate = cg.synthesize(robot(noise=[numbers]), 40, relation="exact").certificate
    assert cg.check(certificate)
    with pytest.raises(ValueError, match=r"noise whose law has a formula, got the law 'scipy'.*its author"):
        check_rigorous(certificate)


def test_a_claim_above_what_is_proved_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    certificate = synthesized("reach-avoid-v0", 60)
    plain, low = cg.check(certificate), check_rigorous(certificate).low
    recompute = rigorous.check
    # As if double precision let the claim pass: what is stated stays what it is.
    monkeypatch.setattr(rigorous, "check", lambda *_: recompute(certificate) and plain)
    for claimed, stands in ((low, True), (math.nextafter(low, 1.0), False), (low + 1e-9, False)):
        raised = changed(certificate, lower_bound=claimed, bounds={"nominal": claimed})
        assert bool(check_rigorous(raised)) == stands, claimed


# --- sabotage: what the check takes from libraries is off by a billionth, and the check does not see it ---------
def times(module: Any, name: str, factor: float) -> Callable[[pytest.MonkeyPatch], None]:
    """A function whose results are off."""
    honest = getattr(module, name)

    def wrong(*arguments: Any, **options: Any) -> Any:
        return honest(*arguments, **options) * factor

    return lambda patch: patch.setattr(module, name, wrong)


UP, DOWN = 1.0 + 1e-9, 1.0 - 1e-9


def shrunk(patch: pytest.MonkeyPatch) -> None:
    """Enclosures that are narrower by a billionth of their width on either side."""
    honest = mean_enclosures.bounds

    def wrong(*arguments: Any) -> Any:
        return [np.stack([e[0] + 1e-9 * (e[1] - e[0]), e[1] - 1e-9 * (e[1] - e[0])]) for e in honest(*arguments)]

    patch.setattr(mean_enclosures, "bounds", wrong)


def another_law(patch: pytest.MonkeyPatch) -> None:
    """Masses of noise that is less than there is."""
    honest = checked_laws.probability_below
    patch.setattr(checked_laws, "probability_below", lambda law, x: honest(law.scaled(0.9), x))


def lower_charges(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(checked_laws, "OUTWARD", DOWN)


def flat_maps(patch: pytest.MonkeyPatch) -> None:
    """What is left of maps is less than there is."""
    honest = map_enclosures.bounds
    patch.setattr(map_enclosures, "bounds", lambda *arguments: [0.999 * ends for ends in honest(*arguments)])


def rounded_sines(patch: pytest.MonkeyPatch) -> None:
    """Elementary functions that are off by more than is said, and say so of none."""
    patch.setattr(step_intervals, "OFF", -1e-9)


SABOTAGE: dict[str, tuple[str, Callable[[pytest.MonkeyPatch], None], str]] = {
    "the complementary error function": ("exact matrices", times(checked_kernel, "erfc", UP), "a cell mass"),
    "a normal law of trains": ("train", times(checked_kernel, "erfc", UP), "a cell mass"),
    "a normal law of menus": ("paper", times(checked_kernel, "erfc", UP), "a cell mass"),
    "the Laplace law": ("exact Laplace", times(checked_laws, "probability_below", UP), "a cell mass"),
    "masses of boxes": ("boxes Laplace", times(checked_laws, "probability_below", UP), "a cell mass"),
    "masses of scales": ("boxes noise scale", times(checked_laws, "probability_below", UP), "a cell mass"),
    "another law": ("exact Laplace", another_law, "a cell mass"),
    "hats": ("linear expressions", times(hat_tables, "erfc", UP), "a mass of a hat"),
    "charges of laws": ("boxes Laplace", lower_charges, "a charge"),
    "boxes of expressions": ("boxes disturbance", shrunk, "were not shown to hold"),
    "maps of expressions": ("linear expressions", flat_maps, "were not shown to hold"),
    "boxes of matrices": ("boxes matrices", shrunk, "were not shown to hold"),
    "elementary functions": ("boxes expressions", rounded_sines, "values of the function `sin`"),
    "near pairs": ("subtraction", times(pairs_check, "erfc", DOWN), "two agents are near"),
    "couplings of intervals": ("paper", times(relation_check, "erf", 1.0 - 1e-6), "a distance between"),
}  # fmt: skip


def without_an_upper_end(certificate: Any) -> Any:
    """The same claim from below alone: an upper end sees masses that are too large."""
    if isinstance(certificate, cg.Certificate) and hasattr(certificate.proof, "base"):
        return changed(certificate, base=without_an_upper_end(certificate.proof.base))
    return changed(certificate, gap=None) if isinstance(certificate.proof, GridProof) else certificate


@mostly_thorough("kind", SABOTAGE, first=2)
def test_what_the_check_takes_on_trust_is_proved(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    row, sabotage, said = SABOTAGE[kind]
    certificate = without_an_upper_end(certificate_of(row))
    assert check_rigorous(certificate)
    sabotage(monkeypatch)
    assert cg.check(certificate), "the check was not deceived, so that this proves nothing"
    report = check_rigorous(certificate)
    assert not report and any(said in text for text in report.failures), report
    assert math.isnan(report.low)


@pytest.mark.parametrize("relation", ["exact"])
def test_targets_are_judged_in_balls(relation: str) -> None:
    """Sabotage: a box that is smaller, an agent that is less stable."""
    certificate = synthesized("reach-avoid-v0", 60, relation=relation)
    agent, part = certificate.problem.agents[0], certificate.proof.agents[0]
    own = certificate.controller.agents[0].relation
    execution = execution_of(agent, part, own)
    honest = (targets(Memory(), agent, part, own, part.policy, execution.inputs),
              mean_targets(Memory(), agent, part, own, execution.mean))  # fmt: skip
    assert all(count and not wrong for count, wrong in honest)
    narrow = agent.replace(input_low=0.9 * agent.input_box.low, input_high=0.9 * agent.input_box.high)
    assert targets(Memory(), narrow, part, own, part.policy, execution.inputs)[1]
    assert mean_targets(Memory(), agent.replace(A=agent.A + 1e-12), part, own, execution.mean)[1]


@pytest.mark.thorough
def test_networks_are_proved_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their masses, and the bent function of their layers; what forms through layers lose is bounded by hand."""
    problem = problem_of("linear matrices")
    view, rng = SharedView(problem), np.random.default_rng(0)
    first = 0.2 * rng.normal(size=(4, view.size)).astype(np.float32)
    last = np.full((view.n_actions, 4), 0.2, dtype=np.float32)
    layers = Network((first, last), (np.full(4, 0.5, np.float32), np.zeros(view.n_actions, np.float32)), "tanh", False)
    certificate = cg.certify(problem, SharedActor(problem, layers), 24).certificate
    report = check_rigorous(certificate)
    assert report and certificate.lower_bound <= report.low, report
    # Sabotage: a hyperbolic tangent that is off by less than single precision is.
    honest = np.tanh
    monkeypatch.setattr(network_enclosures.np, "tanh", lambda z: honest(z) * UP)
    assert cg.check(certificate)
    assert any("values of the function `tanh`" in text for text in check_rigorous(certificate).failures)


def test_what_masses_lack_is_proved() -> None:
    """Sabotage: hardly less than they lack is said; what is said is enough."""
    certificate = certificate_of("boxes matrices")
    agent, part = certificate.problem.agents[0], certificate.proof.agents[0]
    said = checked_kernel.lost_to_rounding(agent, part)
    memory = Memory()
    assert lost(memory, agent, part, said)[1] == []
    assert lost(Memory(), agent, part, 0.99 * float(memory.missing(agent, part)))[1]


def test_every_statement_has_a_proof() -> None:
    rooms = ("certificates", "extended_check")
    files = [file for room in rooms for file in (ROOT / "synthesis" / room).rglob("*.py")]
    stated = {name for file in files for name in re.findall(r"\bstate\(\s*\"([\w ]+)\"", file.read_text("utf-8"))}
    assert stated == {*PROOFS}


def test_subtractions_are_proved() -> None:
    from pair_problems import followers

    certificate: Any = cg.synthesize(followers("G !any(near)", ([-0.5], [0.5])), 24, relation="exact").certificate
    report = check_rigorous(certificate)
    assert report and certificate.lower_bound <= report.low <= certificate.lower_bound + 1e-6, report
    # Sabotage: a team that is another one is refused before anything is proved.
    assert not check_rigorous(replace(certificate, problem=certificate.problem.replace(disturbance_scale=0.5)))


def test_trees_and_trains_are_proved_and_forged_ones_are_not(tmp_path: Path) -> None:
    file = tmp_path / "own.npz"
    for options in ({}, {"search": cg.SearchOptions(value="train")}):
        cg.save(synthesized("reach-avoid-v0", 40, **options), file)
        assert "proved in balls" in str(check_rigorous(file))
    forged = synthesized("reach-avoid-v0", 40)
    cg.save(changed(forged, lower_bound=1.0, bounds={"nominal": 1.0}), file)
    assert "NOT proved" in str(check_rigorous(file))
