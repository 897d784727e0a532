"""Describe agents, regions and a task: in Python, and in a file."""

from __future__ import annotations

from pathlib import Path

import certigym as cg
from certigym.envs.systems.agents import Box

cart = cg.LinearAgent(
    name="cart",
    A=[[0.9]],
    B=[[0.5]],
    noise_covariance=[[0.04]],
    state_low=[-10],
    state_high=[10],
    input_low=[-3],
    input_high=[3],
    initial_state=[-6],
)
doors = cg.LinearAgent(
    name="door",
    A=[[1.0]],
    B=[[0.2]],
    noise_covariance=[[0.01]],
    state_low=[0],
    state_high=[1],
    input_low=[-1],
    input_high=[1],
    initial_state=[0.2],
).copies(2)
room: Box = cart.workspace
print("the cart moves between", room.low, "and", room.high)

problem = cg.Problem(
    name="two-rooms",
    horizon=8,
    agents=[cart, *doors],
    propositions={
        "far": cg.Proposition("cart", [4], [10]),
        "between": cg.Proposition("cart", [-1], [1]),
        "open": cg.Proposition("door_*", [0.5], [1]),  # a family: open_0, open_1
    },
    specification=cg.Specification("(between -> all(open)) U far", "co-safe"),
)
print(problem)
print(f"certified {cg.synthesize(problem, cells=150).certificate.lower_bound:.6f}")

# an error points at the place in the formula
try:
    cg.Problem(
        name="typo",
        horizon=8,
        agents=[cart],
        propositions={"far": cg.Proposition("cart", [4], [10])},
        specification=cg.Specification("F fra", "co-safe"),
    )
except cg.FormulaError as error:
    print(error)

# the same from a TOML file
convoy = cg.load(Path(__file__).parent / "courier_and_drones.toml")
print(convoy, f"certified {cg.synthesize(convoy, cells=100).certificate.lower_bound:.6f}")
