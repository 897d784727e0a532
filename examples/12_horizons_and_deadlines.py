"""One bound per horizon, further starts of the search, and policies for tasks without a deadline."""

from __future__ import annotations

import certigym as cg

problem = cg.make_problem("reach-avoid-v0")
for result in cg.synthesize_horizons(problem, (5, 6, 7), 100):
    certificate = result.certificate
    print(f"T = {certificate.problem.horizon}: {certificate.lower_bound:.5f}, starts {result.stats['starts']}")

# plans advanced and delayed, agent by agent; what one agent alone could still gain is in the statistics
more = cg.synthesize(problem.replace(horizon=6), 100, restarts=2)
print(f"{more.certificate.lower_bound:.5f}, an agent alone gains about {more.stats['unilateral_gain']:.1e}")

# policies that do not look at the time: the bound rises with the horizon, and holds for every longer one
parking = cg.make_problem("car-park-v0")
for_ever = cg.without_deadline(parking, 60, longest=150).certificate
print(f"within {for_ever.problem.horizon} steps, so at any time: P >= {for_ever.unbounded}")
assert for_ever.stationary
