"""The same report from one core, several processes, or a Dask cluster (needs the extra `distributed`)."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor

import certigym as cg
from certigym.validation.statistical_tests import DaskExecutor, TrialPlan


def main() -> None:
    problem = cg.make_problem("reach-avoid-v0", horizon=4)
    certificate = cg.synthesize(problem, cells=100).certificate
    here = cg.validate(certificate, 20_000)
    with ProcessPoolExecutor(2) as pool:
        plan = TrialPlan(episodes=20_000, executor=pool)  # one record for every verb that simulates
        there = cg.validate(certificate, plan)
    assert (here.successes, here.verdict) == (there.successes, there.verdict)

    from dask.distributed import Client

    # workers in threads of this process; `Client("tcp://head:8786")` for a cluster
    with Client(processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None) as client:
        elsewhere = cg.validate(certificate, 20_000, executor=DaskExecutor(client))
    assert elsewhere.successes == here.successes
    print(f"{here.successes} of {here.episodes}, wherever it is computed: {here.verdict}")


if __name__ == "__main__":
    main()
