"""Dynamics that are not linear, written as expressions: simulated, certified, checked and validated."""

from __future__ import annotations

import certigym as cg

oscillator = cg.Agent(
    name="oscillator",
    states=["x", "y"],
    inputs=["push"],
    parameters={"step": 0.1},
    dynamics=["x + step*y", "y + step*(-x + (1 - x**2)*y) + push"],
    noise=[{"law": "gaussian", "std": 0.2}, {"law": "gaussian", "std": 0.2}],
    state_low=[-3, -3],
    state_high=[3, 3],
    input_low=[-1],
    input_high=[1],
    initial_state=[-1, 1],
)
problem = cg.Problem(
    name="oscillator",
    horizon=20,
    agents=[oscillator],
    propositions={"goal": cg.Proposition("oscillator", [-1.4, -2.9], [-0.7, -2])},
    specification=cg.Specification("F goal", "co-safe"),
)
print(problem.agents[0])

# the relation is `boxes`: all that is used are boxes that hold the means of every cell under every input
for cells in (20, 40):
    result = cg.synthesize(problem, cells)
    print(f"{cells} x {cells} cells: {result.certificate.lower_bound:.3f}, {cg.check(result.certificate)}")
print(cg.validate(result.certificate, 5000, seed=0))
