"""Command line of the checker: ``python -m certigym.synthesis.checker FILE``, or ``python synthesis/checker FILE``.

Exit status: 0 proved, 1 refused, 2 unreadable.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from pathlib import Path


def main(arguments: list[str] | None = None) -> int:
    """Check the files that are named, and return the largest exit status."""
    parser = argparse.ArgumentParser(prog="checker", description="Prove the claims of certificate files again.")
    parser.add_argument("files", nargs="+", metavar="FILE")
    parser.add_argument("--most-bytes", type=int, default=2**30, help="largest file that is read (default: 1 GiB)")
    options = parser.parse_args(arguments)
    folder, package = Path(__file__).resolve().parent, __package__
    if not package:  # the folder of this file is a package of its own: the rest of the repository is not needed
        sys.path[:] = [*(path for path in sys.path if Path(path).resolve() != folder), str(folder.parent)]
    checker, status = importlib.import_module(package or folder.name), 0
    for name in options.files:
        try:
            verdict = checker.check(name, options.most_bytes)
            line, code = str(verdict), 0 if verdict.proved else 1
        except (checker.Unreadable, OSError) as error:
            line, code = f"UNREADABLE: {error}", 2
        sys.stdout.write(f"{name}: {line}\n")
        status = max(status, code)  # the worst of all files
    return status


if __name__ == "__main__":
    sys.exit(main())
