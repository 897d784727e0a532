"""A hundred agents in pairs that have to meet: a task that decomposes into independent tasks, one per pair."""

from __future__ import annotations

import certigym as cg

drone = cg.LinearAgent(
    name="left",
    A=[[0.9]],
    B=[[0.5]],
    noise_covariance=[[0.1]],
    state_low=[-4.0],
    state_high=[4.0],
    input_low=[-2.0],
    input_high=[2.0],
    initial_state=[-2.0],
)
agents = [*drone.copies(50), *drone.replace(name="right", initial_state=[2.0]).copies(50)]
regions = {
    f"{name}_{side}": cg.Proposition(f"{side}_*", [low], [high])
    for side in ("left", "right")
    for name, low, high in (("here", -1.0, 0.0), ("there", 0.0, 1.0), ("safe", -3.5, 3.5))
}
meetings = [f"F (here_left_{k} & here_right_{k} | there_left_{k} & there_right_{k})" for k in range(50)]
problem = cg.Problem(
    name="fifty-pairs",
    horizon=8,
    agents=agents,
    propositions=regions,
    specification=cg.Specification(f"G (all(safe_left) & all(safe_right)) & {' & '.join(meetings)}", "finite-trace"),
)
print(problem)  # the automaton of the whole would have 2^50 states, and is not built
print(f"the first of {len(problem.tasks)} independent tasks: {problem.tasks[0].specification.formula}")

result = cg.synthesize(problem, cells=60, search=cg.SearchOptions(restarts=4))
certificate = result.certificate
print(f"{result.stats['distinct_tasks']} synthesis for {len(certificate.proof.parts)} tasks: {result.stats['seconds']}")
print(cg.validate(result, episodes=10_000))
assert cg.check(certificate, problem)

# the environment of one pair
env = cg.parallel_env(problem.tasks[0])
print(env.possible_agents)
