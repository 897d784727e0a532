"""Commands about the form that the small checker reads: ``check``, and ``canonical``, which writes it.

``check`` of a file in this form loads numpy and the checker, and nothing else of the package.
"""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path
from typing import Any

from ..synthesis.certificates.beliefs import alarm_in, is_canonical
from ..synthesis.checker import MOST_BYTES, check_contents, read_file, shown
from .terminal import on_terminal


def check(options: Namespace) -> int:
    """Prove the claim of a certificate again: by the small checker, or, in the form of 0.3, by the one of its kind."""
    path = options.certificate
    if not Path(path).is_file() or not is_canonical(path):
        from .synthesis_commands import check as check_of_0_3

        return check_of_0_3(options)
    contents = read_file(path, _most_bytes(options))
    if options.problem is not None:  # the rest of the package is loaded only where a problem has to be compared
        from ..synthesis.certificates.proofs.canonical import require_about
        from .given import named_problem

        require_about(contents, named_problem(options.problem, options.horizon))
    verdict = check_contents(contents)
    told = alarm_in(contents, verdict)
    outcome = {
        "valid": verdict.proved,
        "lower_bound": verdict.lower_bound,
        "claimed_failure": verdict.claimed,
        "proved_failure": verdict.recomputed,
        "modules": list(verdict.modules),
        "reason": verdict.reason,
        "alarm": told,
    }
    _show(options, f"{Path(path).name}: {verdict}" + (f"\n{told}" if told else ""), outcome)
    return 0 if verdict else 1


def _most_bytes(options: Namespace) -> int:
    """Return the largest size that is read; the package that reads numbers of bytes is loaded if one is given."""
    if options.max_bytes == "1G":  # the default
        return MOST_BYTES
    from .given import limit_of

    return limit_of(options)


def canonical(options: Namespace) -> int:
    """Print a problem as the checker reads it, or bring a certificate of 0.3 into the form that it reads."""
    source = Path(options.source)
    is_archive = source.suffix == ".npz" and source.is_file()
    if options.out is None:
        problem = read_file(source).header["problem"] if is_archive and is_canonical(source) else _problem(options)
        _show(options, json.dumps(problem, indent=1), problem)
        return 0
    if not is_archive:
        raise ValueError(f"`--out`: expected with a certificate file (.npz), got {options.source!r}; leave `--out` out")
    from ..envs.systems.arguments import write_bytes
    from ..synthesis.certificates.proofs import load_certificate
    from ..synthesis.certificates.proofs.canonical import ClaimsMoreError, canonical_bytes

    certificate = load_certificate(source)
    try:
        raw = canonical_bytes(certificate, options.claim)
    except ClaimsMoreError as error:
        more = {"claimed": error.claimed, "proved": error.proved, "certificate": None}
        reason = f"REFUSED: P >= {error.claimed:.15g} is claimed, and the checker proves P >= {error.proved:.15g}"
        text = f"{reason}; nothing was written. `--claim proved` writes what is proved"
        _show(options, f"{certificate.problem.name}: {text}", {"problem": certificate.problem.name, **more})
        return 1
    write_bytes(options.out, raw)
    failure = read_file(options.out).header["claim"]["failure"]
    outcome = {"problem": certificate.problem.name, "failure": failure, "certificate": options.out}
    _show(options, f"{certificate.problem.name}: P >= {shown(failure)}\nsaved to {options.out}", outcome)
    return 0


def _problem(options: Namespace) -> dict[str, Any]:
    """Return the canonical form of a suite problem, a problem file, or the problem of a certificate of 0.3."""
    from ..synthesis.certificates.proofs import load_certificate
    from ..synthesis.certificates.proofs.canonical import canonical_problem
    from .given import named_problem

    if Path(options.source).suffix == ".npz":
        return canonical_problem(load_certificate(options.source).problem)
    return canonical_problem(named_problem(options.source))


def _show(options: Namespace, text: str, outcome: Any) -> None:
    """Print the text, or write JSON; the package that knows how is loaded for JSON only."""
    if options.json is None:
        print(on_terminal(text), flush=True)
        return
    from .given import show

    show(options, text, outcome)
