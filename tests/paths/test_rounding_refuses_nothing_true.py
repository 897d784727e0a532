"""Where numbers nearly meet, or have units far apart, what is true passes the check, or the search says why not.

Each of these was found by the small problems of ``benchmarks/adversary.py``; sabotages stand beside the repairs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import certigym as cg
from certigym.synthesis.certificates.proofs import changed
from certigym.synthesis.trajectories.planning import path_certificate
from certigym.synthesis.verbs.raw_networks import certify_network
from kinds import mostly_thorough
from network_problems import proportional

EDGE = 0.3


def beside(steps: int, **changes: Any) -> cg.Problem:
    """A task of two regions, the edge of one beyond that of the other by units of rounding."""
    other = EDGE
    for _ in range(steps):
        other = float(np.nextafter(other, 1.0))
    facts: dict[str, Any] = {
        "A": [[0.9]], "B": [[0.5]], "noise_covariance": [[0.04]], "state_low": [-1.0], "state_high": [1.0],
        "input_low": [-1.0], "input_high": [1.0], "initial_state": [0.0],
    }  # fmt: skip
    return cg.Problem(
        name="beside",
        horizon=3,
        agents=[cg.LinearAgent(name="a", **{**facts, **changes})],
        propositions={"p": cg.Proposition("a", [EDGE], [1.0]), "q": cg.Proposition("a", [-1.0], [other])},
        specification=cg.Specification("F (p & F q)", "co-safe"),
    )


@pytest.mark.parametrize("relation", ["exact", "paper", "linear", "boxes", "auto", "best"])
@mostly_thorough("steps", [1, 1000])
def test_edges_that_differ_by_rounding_are_certified(relation: str, steps: int) -> None:
    """Cells between them hold no mass; relations that feed the place in a cell back get little, and by default others
    are taken."""
    certificate = cg.synthesize(beside(steps), 20, relation=relation).certificate
    assert cg.check(certificate)
    if relation in ("exact", "boxes", "auto", "best"):
        assert certificate.lower_bound > 0.9


def test_so_is_an_edge_beside_the_workspace_and_the_grid_of_a_network() -> None:
    low = float(np.nextafter(EDGE, 0.0))
    near = beside(0, state_low=[low], initial_state=[0.5])
    facts = {name: getattr(near, name) for name in ("name", "horizon", "agents", "propositions")}
    near = cg.Problem(**facts, specification=cg.Specification("G[0,2] p", "finite-trace"))
    certificate = cg.synthesize(near, 20, relation="exact").certificate
    assert cg.check(certificate) and certificate.lower_bound > 0.5
    assert cg.check(certify_network(beside(1), proportional(beside(1)), 20).certificate)


@pytest.mark.parametrize("relation", ["exact", "boxes"])
@pytest.mark.parametrize("steps", [0, 1, 3, 10])
def test_the_check_looks_at_narrow_cells_from_inside(relation: str, steps: int) -> None:
    """Certificates with such cells are honest, and a controller that steers elsewhere is still seen."""
    certificate = cg.synthesize(beside(steps), 20, relation=relation).certificate
    assert isinstance(certificate, cg.Certificate) and certificate.lower_bound > 0.9
    assert cg.check(certificate)
    part = certificate.proof.agents[0]
    policy = np.where(part.policy >= 0, np.roll(part.policy, 3, axis=2), -1)
    assert not cg.check(changed(certificate, agents=(replace(part, policy=policy),)))


def test_a_task_on_such_edges_has_a_path() -> None:
    """A certificate along a path needs no cells."""
    problem = beside(1, noise_covariance=[[0.002]])
    assert cg.check(cg.synthesize(problem, relation="path").certificate)


def turned(unit: list[float], **changes: Any) -> cg.Problem:
    """Two states in units of their own that are to stay near the middle."""
    u = np.array(unit)
    facts: dict[str, Any] = {
        "A": [[1.0, 0.5], [0.0, 0.9]], "B": [[0.0], [0.5]], "noise_covariance": 0.01 * np.eye(2),
    }  # fmt: skip
    agent = cg.LinearAgent(
        name="a", A=u[:, None] * np.array(facts["A"]) / u, B=u[:, None] * np.array(facts["B"]),
        noise_covariance=np.array(changes.get("noise", facts["noise_covariance"])) * np.outer(u, u), state_low=-u,
        state_high=u, input_low=[-1.0], input_high=[1.0], initial_state=u * changes.get("start", [0.1, 0.0]),
    )  # fmt: skip
    safe = cg.Proposition("a", (-0.6 * u).tolist(), (0.6 * u).tolist())
    task = cg.Specification("G safe", "finite-trace")
    return cg.Problem(name="turned", horizon=4, agents=[agent], propositions={"safe": safe}, specification=task)


def rescaled(unit: list[float]) -> Any:
    """Return a certificate along a path in units of its own: that of plain units, with all its numbers."""
    certificate: Any = path_certificate(turned([1.0, 1.0])).certificate
    (path,), u = certificate.proof.paths, np.array(unit)
    strips = path.strips * np.append(u, 1.0)
    path = replace(path, states=path.states * u, gains=path.gains / u, strips=strips)
    return changed(
        replace(certificate, problem=turned(unit)), paths=(path,), failure=1.0001 * certificate.proof.failure
    )


@mostly_thorough("unit", [[3e4, 7e-4], [1e-7, 1e8]])
def test_the_check_of_paths_proves_the_same_in_all_units(unit: list[float]) -> None:
    """Rounding of states that are counted in large numbers is not charged to those counted in small ones."""
    plain = cg.check(rescaled([1.0, 1.0]))
    certificate = rescaled(unit)
    report = cg.check(certificate)
    assert report, report.failures
    # which of two earlier constraints is looked at may hang on the last bits
    assert report.recomputed == pytest.approx(plain.recomputed, rel=1e-8)
    assert not cg.check(changed(certificate, failure=0.9999 * (1.0 - report.recomputed)))


def test_rollouts_agree_in_uneven_units() -> None:
    """20,000 episodes with a fixed seed; a true claim is refuted with probability 1e-6."""
    certificate = rescaled([3e4, 7e-4])
    assert cg.validate(certificate, 20_000, seed=1, confidence=1.0 - 1e-6).verdict != "refuted"
