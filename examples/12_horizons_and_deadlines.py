"""One bound per horizon, further searches from perturbed plans, and policies for tasks without a deadline."""

from __future__ import annotations

import certigym as cg

problem = cg.make_problem("reach-avoid-v0")
for result in cg.synthesize(problem, 100, horizon=(5, 6, 7)):
    certificate = result.certificate
    print(f"T = {certificate.problem.horizon}: {certificate.lower_bound:.5f}, starts {result.stats['starts']}")

# try plans again, advanced and delayed agent by agent; the statistics say what one agent alone could still gain
more = cg.synthesize(problem.replace(horizon=6), 100, search=cg.SearchOptions(restarts=2))
print(f"{more.certificate.lower_bound:.5f}, one agent alone can gain about {more.stats['unilateral_gain']:.1e}")

# policies that do not look at the time: the bound rises with the horizon, and holds for every longer one
stationary = cg.synthesize(problem, 60, horizon=None).certificate
print(f"within {stationary.problem.horizon} steps, and so without a deadline: P >= {stationary.lower_bound}")
assert stationary.proof.stationary

# Safety without a deadline: a bound that holds for every number of steps at once.
safe = cg.synthesize("invariance-b-20-v0", 100, horizon=None)
lasting = cg.safety_rate(safe)
print("safe for k steps:", lasting, lasting.at([1, 100, 10_000]))

# The other end: how often these controllers succeed at most, under any relation with cells.
parked = cg.synthesize("car-park-v0", above=True).certificate
print(f"the controllers park with a probability of {parked.lower_bound} at least, {parked.upper_bound} at most")
assert parked.lower_bound <= parked.upper_bound and cg.check(parked)
