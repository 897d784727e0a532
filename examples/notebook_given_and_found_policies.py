# %% [markdown]
# # Given and found policies
#
# A policy written by hand, what of it can be certified, and what coordinate ascent makes of it. A notebook kept as a
# script, in `# %%` cells.

# %%
from typing import Any

import numpy as np

import certigym as cg
from certigym.validation.figures.certificate_figures import value_figure
from certigym.validation.figures.figure_style import save_figure

problem = cg.make_problem("reach-avoid-v0", horizon=5)

# %% [markdown]
# The policy is timid: it takes half of the input it would need.


# %%
def timid(x: Any, q: int, time: int) -> Any:
    return np.clip(0.5 * (2.5 - 0.9 * x) / 0.5, -5.0, 5.0)


# %% [markdown]
# `certify` puts it on the cells and evaluates it there. The certificate belongs to the wrapped policy.

# %%
bounds = []
for cells in (25, 50, 100, 200):
    certified = cg.certify(problem, timid, cells=cells)
    bounds.append(certified.certificate.lower_bound)
    print(cells, f"{bounds[-1]:.4f}")
assert max(bounds) > 0.0

# %% [markdown]
# `improve` goes on from there: the agents answer each other in turn, and the bound never falls.

# %%
improved = cg.improve(problem, timid, cells=200)
found = cg.synthesize(problem, cells=200)
for name, one in {"given": certified, "improved": improved, "found": found}.items():
    print(name, f"{one.certificate.lower_bound:.4f}")
    save_figure(value_figure(one.certificate, axes=[0]), f"{name}.png")
assert improved.certificate.lower_bound >= bounds[-1]

# %% [markdown]
# All of them on the same noise.

# %%
print(cg.compare(problem, {"raw": timid, "given": certified, "improved": improved, "found": found}, episodes=4_000))
