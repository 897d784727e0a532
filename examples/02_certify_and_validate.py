"""From a problem to a certificate, its check, and rollouts that test it."""

from __future__ import annotations

import tempfile
from pathlib import Path

import certigym as cg
from certigym.synthesis.certificates.controllers import AgentController, Controller
from certigym.synthesis.certificates.proofs.canonical import save_canonical
from certigym.validation.statistical_tests import Rollouts, ValidationReport

problem = cg.make_problem("reach-avoid-v0", horizon=6)
result: cg.Synthesis = cg.synthesize(problem, cells=400)
certificate: cg.Certificate = result.certificate
print(f"certified {certificate.lower_bound:.6f} on average over the start box ({certificate.proof.bound} bound)")
print("from two other starts", certificate.at([[-15.0, -3.0], [-20.0, -3.0]]))
print("from everywhere in a box", certificate.min([-12.0, -4.0], [-10.0, -3.0]))

# and in the middle of a run: at these states, in the first automaton state, with four steps to go
print("with four steps left", cg.value_in_time(certificate).at([[-4.0, -3.0], [-8.0, -3.0]], 0, 4))

# verified by separate code and without simulation; the second argument asks whether it is about this problem
verified = cg.check(certificate, problem)
print(verified)
assert verified

# and by the small checker, which reads a file and rounds every operation to the side that claims less
save_canonical(certificate, file := Path(tempfile.mkdtemp()) / "certificate.npz")
print(cg.check(file))

# tested by simulation, which proves nothing
report: ValidationReport = cg.validate(result, episodes=20_000, seed=0)
print(report)
assert report.verdict != "refuted"
rollouts: Rollouts = cg.rollout(problem, result.controller, 5_000, seed=1, initial_state=[-20.0, -3.0])
print(f"{rollouts.successes} of {rollouts.episodes} from the far corner")

# written and read: a certificate is a file that can be passed on
cg.save(certificate, "reach_avoid.npz")
again = cg.load("reach_avoid.npz")
assert again.lower_bound == certificate.lower_bound

# the controllers act on the observations of the environment
controller: Controller = again.controller
env = cg.parallel_env(problem)
observations, infos = env.reset(seed=0)
controller.reset(observations, infos)
while env.agents:
    observations, rewards, terminations, truncations, infos = env.step(controller.act(observations, infos))
print("satisfied" if infos["agent_0"]["satisfied"] else "not satisfied")
first: AgentController = controller.agents[0]
print(f"{first.name} looks its input up in a table of shape {first.policy.shape} (time, automaton state, cell)")
