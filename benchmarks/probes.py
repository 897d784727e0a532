"""How much better than the certified controllers a learner does that starts from them: the table of ``docs/probes.md``.

``python benchmarks/probes.py [--seconds 120] [--certificates FOLDER] [--out docs/probes.md] [ID ...]`` probes suite
problems and writes their rows; rows of other problems that the page already has stay. Certificates are made with the
defaults, and kept in the folder if one is given. Needs the extra `rl`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import certigym as cg

HEAD = """# What a probe gains over the certified controllers

`certigym probe ID` lets a learner try to beat the certified controllers of a problem with the same information: it
clones them, improves the clone by PPO, and meets them on new episodes with common random numbers
([how](how-to/probe.md)). The gain is the success probability of the best actor less that of the controllers, with exact
99.9 % limits. A gain above 0 says that the certificate leaves something on the table; a gain around 0 is no proof that
nobody can do better. Certificates are those of the defaults; the controllers of most succeed more often than certified,
so the last column shows how far above the certified bound the learner is.

Made by `python benchmarks/probes.py`; 20,000 episodes each; how far a learner comes in its seconds depends on the
machine.

| id | certified | controllers | clone | learner | gain | its limits | world steps | seconds | above the bound |
|---|---|---|---|---|---|---|---|---|---|
"""


def certificate_of(name: str, folder: Path | None) -> cg.Certificate | cg.ProductCertificate:
    """Return the certificate of the defaults, from the folder if it is there."""
    path = None if folder is None else folder / f"{name}.npz"
    if path is not None and path.is_file():
        return cg.load_certificate(path)
    certificate = cg.synthesize(name).certificate
    if path is not None:
        cg.save_certificate(certificate, path)
    return certificate


def row(name: str, seconds: float, folder: Path | None) -> str:
    """Probe one problem and return its row."""
    found = cg.probe(name, certificate_of(name, folder), 20_000, seconds=seconds)
    rates = found.lower_bound, found.certified / found.episodes, found.cloned, found.learned / found.episodes
    steps = sum(attempt.steps for attempt in found.attempts)
    return (
        f"| {name} | {' | '.join(f'{rate:.4f}' for rate in rates)} | {found.gain:+.4f} | "
        f"[{found.gain_low:+.4f}, {found.gain_high:+.4f}] | {steps} | {found.seconds:.0f} | "
        f"{rates[3] - rates[0]:+.4f} |"
    )


def rows_of(page: Path | None) -> dict[str, str]:
    """Return the rows that a page already has, by id."""
    if page is None or not page.is_file():
        return {}
    lines = [line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("| ")]
    return {line.split(" | ")[0].removeprefix("| "): line for line in lines if not line.startswith("| id ")}


def main() -> None:
    """Probe the problems one after the other, and write the page after each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("ids", nargs="*", default=cg.problem_ids())
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--certificates", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = rows_of(options.out)
    for name in options.ids:
        rows[name] = row(name, options.seconds, options.certificates)
        print(rows[name], flush=True)
        if options.out is not None:
            options.out.write_text(HEAD + "\n".join(rows[id] for id in sorted(rows)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
