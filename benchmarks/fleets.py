"""Time of certificates along paths against agents, steps and states: ``python benchmarks/fleets.py [--json PATH]``.

Vehicles on a circle swap places (``fleet-v0``), and a chain of integrators goes to a box. Seconds are those of the
processor, of search and check; the exponent is that of a power of the number, fitted by least squares on logarithms.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time

import numpy as np

import certigym as cg
from measuring import Row, Rows, save, show

AGENTS, STEPS, STATES = (5, 10, 20, 40), (20, 40, 80), (4, 8, 12)
"""Numbers that are tried, the others as in the first row of each table."""


def chain(d: int, horizon: int = 20) -> cg.Problem:
    """An agent whose states pull each other along a sine; the last one is pushed."""
    rows = [f"0.8*x{k} + 0.2*sin(x{k + 1})" for k in range(d - 1)] + [f"0.8*x{d - 1} + u"]
    agent = cg.Agent(
        name="chain", states=[f"x{k}" for k in range(d)], inputs=["u"], dynamics=rows, outputs=["x0"],
        noise_covariance=1e-4 * np.eye(d), state_low=[-3.0] * d, state_high=[3.0] * d, input_low=[-1], input_high=[1],
        initial_state=[0.0] * d,
    )  # fmt: skip
    regions = {"goal": cg.Proposition("chain", [-0.3], [0.5])}
    return cg.Problem(name="chain", horizon=horizon, agents=[agent], propositions=regions,
                      specification=cg.Specification("G goal", "finite-trace"))  # fmt: skip


def row_of(name: str, number: int, problem: cg.Problem) -> Row:
    """Certify one problem and check it."""
    began = time.process_time()
    certificate = cg.synthesize(problem, relation="path").certificate
    searched = time.process_time()
    report = cg.check(certificate, problem)
    checked = time.process_time()
    return {"what": name, "number": number, "fails at most": 1.0 - certificate.lower_bound,
            "search s": searched - began, "check s": checked - searched, "valid": report.valid}  # fmt: skip


def exponent(rows: Rows, key: str) -> float:
    """The slope of logarithms of seconds over those of the number."""
    numbers, seconds = (np.log([float(row[name]) for row in rows]) for name in ("number", key))
    return float(np.polyfit(numbers, seconds, 1)[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", metavar="PATH")
    parser.add_argument("--most", type=int, default=max(AGENTS), help="largest fleet")
    options = parser.parse_args()
    fleets = [row_of("agents", n, cg.make_problem("fleet-v0", n_agents=n)) for n in AGENTS if n <= options.most]
    steps = [row_of("steps", t, cg.make_problem("fleet-v0", n_agents=4, horizon=t)) for t in STEPS]
    states = [row_of("states", d, chain(d)) for d in STATES]
    summary: Rows = [
        {"what": rows[0]["what"], "exponent, search": exponent(rows, "search s"),
         "exponent, check": exponent(rows, "check s")}
        for rows in (fleets, steps, states)
    ]  # fmt: skip
    show("Certificates along paths", [*fleets, *steps, *states])
    show("Powers of the number", summary)
    if options.json:
        save(options.json, {"rows": [*fleets, *steps, *states], "exponents": summary})


if __name__ == "__main__":
    main()
