"""Write the report of a certificate, and draw figures (needs the extra `viz`)."""

from __future__ import annotations

import certigym as cg
from certigym.validation.presentation.figures import (
    automaton_figure,
    horizon_figure,
    rank_figure,
    rollouts_figure,
    save_figure,
    tree_figure,
    value_figure,
)

problem = cg.make_problem("reach-avoid-v0", horizon=4)
certificate = cg.synthesize(problem, cells=100).certificate

content = cg.report(certificate, "report.html", episodes=5_000)
assert content.audit is not None
print("report.html:", content.validation.verdict, content.audit.verdict)

save_figure(value_figure(certificate), "value.png")
save_figure(rank_figure(certificate), "rank.png")
save_figure(rollouts_figure(certificate, episodes=20), "rollouts.png")
save_figure(automaton_figure(problem), "automaton.png")
save_figure(tree_figure(certificate), "tree.png")
shorter = cg.synthesize(problem, 50, horizon=[1, 2, 3, 4])
save_figure(horizon_figure([cg.validate(result, 1_000) for result in shorter]), "horizon.png")
