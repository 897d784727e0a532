# %% [markdown]
# # Policies by hand and by search
#
# A policy written by hand, what can be certified about it, and how coordinate ascent improves it. A notebook kept as a
# script, in `# %%` cells.

# %%
from typing import Any

import numpy as np

import certigym as cg
from certigym.validation.figures import save_figure, value_figure

problem = cg.make_problem("reach-avoid-v0", horizon=5)

# %% [markdown]
# The policy is timid: it takes half of the input that it would need.


# %%
def timid(x: Any, q: int, time: int) -> Any:
    return np.clip(0.5 * (2.5 - 0.9 * x) / 0.5, -5.0, 5.0)


# %% [markdown]
# `certify` wraps the policy on cells and evaluates it there. The certificate is about the wrapped policy.

# %%
bounds = []
for cells in (25, 50, 100, 200):
    certified = cg.certify(problem, timid, cells=cells)
    bounds.append(certified.certificate.lower_bound)
    print(cells, f"{bounds[-1]:.4f}")
assert max(bounds) > 0.0

# %% [markdown]
# `improve` continues from there: the agents take turns with their best responses, and the bound never falls.

# %%
improved = cg.improve(problem, timid, cells=200)
synthesized = cg.synthesize(problem, cells=200)
results = {"given": certified, "improved": improved, "synthesized": synthesized}
for name, result in results.items():
    print(name, f"{result.certificate.lower_bound:.4f}")
    save_figure(value_figure(result.certificate, axes=[0]), f"{name}.png")
assert improved.certificate.lower_bound >= bounds[-1]

# %% [markdown]
# All of them, simulated on the same noise.

# %%
print(cg.compare(problem, {"raw": timid, **results}, episodes=4_000))
