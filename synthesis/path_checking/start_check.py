"""Time 0: what every proof has to ask of the start, before it speaks of any step.

A start outside the closed workspace has the probability 0 (docs/theory/setting.md, "Satisfaction"), and the automaton
has read a letter before the first control. Values on grids are 0 outside of the grid; a proof without a grid asks here.
"""

from __future__ import annotations

from ...envs.problem import Problem


def wrong_start(problem: Problem) -> list[str]:
    """Return what is wrong with the starts: a corner outside its closed workspace, or letters that part the runs."""
    if problem.starts_outside:
        return [f"the start of agent `{name}` is outside its workspace" for name in problem.starts_outside]
    if problem.initial_q is None:
        return ["where the automaton is after the first letter depends on the start"]
    return []
