# %% [markdown]
# # A first certificate
#
# A notebook kept as a script: open it in any editor that knows `# %%` cells, convert it with jupytext, or run it.
#
# Two agents live on lines. The first must reach its goal p1; on the way, the first must not be in p2 while the second
# is in p3.

# %%
import numpy as np

import certigym as cg
from certigym.validation.figures import automaton_figure, rollouts_figure, save_figure, value_figure

problem = cg.make_problem("reach-avoid-v0", horizon=6)
print(problem.specification.formula)
for name, proposition in problem.propositions.items():
    print(name, proposition.agent, proposition.low, proposition.high)

# %% [markdown]
# The formula becomes an automaton. It reads one letter per step: the set of propositions that hold.

# %%
save_figure(automaton_figure(problem), "automaton.png")

# %% [markdown]
# Synthesis cuts each line into cells, finds controllers, and proves a bound for them.

# %%
result = cg.synthesize(problem, cells=400)
certificate = result.certificate
print(f"P >= {certificate.lower_bound} on average over the start box; exact: {certificate.exact}")

# %% [markdown]
# The bound at every start. Near -20, six steps are hardly enough.

# %%
save_figure(value_figure(certificate), "value.png")
starts = np.column_stack([np.linspace(-19.9, -10.1, 5), np.full(5, -3.0)])
for start, bound in zip(starts, certificate.at(starts), strict=True):
    print(start, f"{bound:.4f}")

# %% [markdown]
# Is the bound true? Rollouts of the continuous system can refute it, but not prove it.

# %%
report = cg.validate(result, episodes=20_000)
print(report)
assert report.verdict != "refuted" and cg.check(certificate, problem)
save_figure(rollouts_figure(certificate), "rollouts.png")
