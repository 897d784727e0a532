"""Six robots swap places across a circle without coming near each other; two vehicles stay within reach."""

from __future__ import annotations

import certigym as cg

# every robot sees itself alone: who goes around whom is agreed in the policies
swarm = cg.make_problem("swarm-v0", n_agents=6)
print(swarm.declared["near"], len(swarm.families["near"]), "pairs")
result = cg.synthesize(swarm, 40)
print(result.certificate)
assert cg.check(result.certificate, swarm)
print(cg.validate(result, episodes=10_000))

# distances that are wanted: a small team whose agents see one another
back = cg.LinearAgent(
    name="back",
    A=[[1.0]],
    B=[[1.0]],
    noise_covariance=[[0.01]],
    state_low=[-4.0],
    state_high=[4.0],
    input_low=[-1.0],
    input_high=[1.0],
    initial_state=[-2.0],
)
team = cg.Problem(
    name="within-reach",
    horizon=6,
    agents=[back, back.replace(name="front", initial_state=[0.0])],
    propositions={
        "reach": cg.Pair(["back", "front"], [-3.0], [3.0]),
        "near": cg.Pair(["back", "front"], [-1.0], [1.0]),
        "goal": cg.Proposition("front", [2.0], [4.0]),
    },
    specification=cg.Specification("G (reach & !near) & F goal", "finite-trace"),
)
result = cg.synthesize(team, 40)
print(result.certificate, result.stats["tried"])
assert cg.check(result.certificate, team)
