"""Guards of a certificate are disjoint and lead where they say; forged ones are refused, whatever else is right."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import certigym as cg
from certigym.synthesis.certificates.proofs import changed
from test_controllers_carry_out_what_is_certified import ordinary


def certificate() -> Any:
    """One guard: from inside the region to inside the region; nothing is claimed from above."""
    honest = cg.synthesize(ordinary(), 16, relation="exact").certificate
    return changed(honest, gap=None)


def guards_twice(certificate: Any) -> Any:
    """Every guard listed twice, and the last step back taken through both: the value at time 0 is doubled."""
    step, count = certificate.proof.merge_log[0], len(certificate.proof.guard_source)
    origin = tuple(np.concatenate([rows, rows + np.array([count, 0])]) for rows in step.origin)
    kept = tuple(np.concatenate([rows, rows + len(o)]) for rows, o in zip(step.kept, step.origin, strict=True))
    pairs = zip(certificate.proof.terms.index, step.origin, strict=True)
    index = tuple(np.concatenate([rows, rows]) if len(o) else rows for rows, o in pairs)
    guards = ("guard_source", "guard_target", "guard_mask")
    return changed(
        certificate,
        merge_log=(replace(step, origin=origin, kept=kept), *certificate.proof.merge_log[1:]),
        terms=replace(certificate.proof.terms, index=index),
        **{name: np.concatenate([getattr(certificate.proof, name)] * 2) for name in guards},
    )


def test_the_same_guard_twice_is_an_overlap() -> None:
    """No vertex is listed twice then, but all of their probability is counted twice."""
    forged = guards_twice(certificate())
    report = cg.check(forged)
    assert not report and "overlap" in str(report)


def test_a_guard_with_cells_of_another_letter_is_refused() -> None:
    """Some of its letters lead where it says, and others to failure."""
    own = certificate()
    part = own.proof.agents[0]
    forged = changed(own, agents=(replace(part, masks=np.ones_like(part.masks)),))
    report = cg.check(forged)
    assert not report and "does not always lead" in str(report)
