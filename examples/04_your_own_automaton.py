"""Tasks as automata: from a formula, by hand, and from HOA text that other tools write."""

from __future__ import annotations

import certigym as cg
from certigym.envs.interfaces import automaton_to_dot

automaton: cg.Automaton = cg.translate("F (load & F goal)", ["load", "goal"], "co-safe")
print(automaton)
assert automaton.accepts([["load"], [], ["goal"]]) and not automaton.accepts([["goal"], ["load"]])

# by hand: whoever falls into the hole has to fetch another load
rows = {
    "states": ["empty", "loaded", "done"],
    "initial": "empty",
    "accepting": ["done"],
    "transitions": [
        ("empty", "load", "loaded"),
        ("empty", "!load", "empty"),
        ("loaded", "hole", "empty"),
        ("loaded", "goal & !hole", "done"),
        ("loaded", "!hole & !goal", "loaded"),
        ("done", "true", "done"),
    ],
}
by_hand = cg.translate(rows, ["load", "hole", "goal"])
cart = cg.LinearAgent(
    name="cart",
    A=[[1.0]],
    B=[[1.0]],
    noise_covariance=[[0.04]],
    state_low=[-10],
    state_high=[10],
    input_low=[-2],
    input_high=[2],
    initial_state=[-5],
)
regions = {"load": ([-6], [-4]), "hole": ([-1], [0]), "goal": ([4], [6])}
problem = cg.Problem(
    name="start-again",
    horizon=10,
    agents=[cart],
    propositions={name: cg.Proposition("cart", *box) for name, box in regions.items()},
    specification=cg.Specification(automaton=by_hand),
)
print(f"certified {cg.synthesize(problem, cells=200).certificate.lower_bound:.6f}")

hoa = """HOA: v1
States: 2
Start: 0
AP: 1 "goal"
Acceptance: 1 Inf(0)
--BODY--
State: 0
[!0] 0
[0] 1
State: 1 {0}
[t] 1
--END--
"""
print(automaton_to_dot(cg.translate(hoa, ["goal"])))
