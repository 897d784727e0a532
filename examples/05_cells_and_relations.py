"""How many cells, and which relation: look at finite models, compare attempts and horizons."""

from __future__ import annotations

import certigym as cg
from certigym.synthesis.relations.grids import Grid

problem = cg.make_problem("reach-avoid-v0", horizon=5)

for relation in ("exact", "linear", "paper"):
    abstraction = cg.abstract(problem, 250, relation=relation)
    model = abstraction.models[0]
    grid: Grid = model.grid
    print(f"{relation}: {grid.shape} cells, delta {model.delta:.4f}, exact {abstraction.is_exact}")

for cells in (25, 100, 400):
    result = cg.synthesize(problem, cells=cells)
    report = cg.validate(result, episodes=4_000)
    print(f"{cells} cells: certified {result.certificate.lower_bound:.4f}, rollouts {report.estimate:.4f}")

attempts = [cg.synthesize(problem, 100, search=cg.SearchOptions(max_sweeps=sweeps)) for sweeps in (2, 8)]
print("attempts", [attempt.lower_bound for attempt in attempts])

for result in cg.synthesize(problem, 100, horizon=range(1, 8)):
    report = cg.validate(result, 2_000)
    print(f"T = {report.horizon}: certified {report.lower_bound:.4f}, rollouts {report.estimate:.4f}")
