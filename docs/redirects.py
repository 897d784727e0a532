"""Sphinx extension: addresses of pages that moved lead to the page where their contents are now."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import environment_pages

MOVED = {
    "environments/robots": "environments/README",
    "environments/deliveries": "environments/README",
    "environments/vehicles": "environments/README",
    "environments/plants": "environments/README",
    "environments/scaling": "environments/README",
    "environments/solved": "leaderboard",
    "environments/open": "leaderboard",
    "environments/hard": "leaderboard",
    "environments/unrated": "leaderboard",
    "learners": "leaderboard",
    "how-to/devices": "how-to/batches",
}
"""Old and new address, without the ending; the variants of environments follow from their pages."""

PAGE = '<!doctype html><meta charset="utf-8"><title>Moved</title><meta http-equiv="refresh" content="0; url={0}">' + (
    '<link rel="canonical" href="{0}"><a href="{0}">This page has moved.</a>\n'
)


def moved() -> dict[str, str]:
    """Return the new address of every page that moved."""
    ids = {id: environment_pages.page_of_id(id) for id in environment_pages.cg.problem_ids()}
    return MOVED | {f"environments/{id}": f"environments/{page}" for id, page in ids.items() if page != id}


def write(app: Any, error: Exception | None) -> None:
    """Write a page for each old address that leads to the new one."""
    if error is not None or app.builder.format != "html":
        return
    for old, new in moved().items():
        path = Path(app.outdir) / f"{old}.html"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(PAGE.format("../" * old.count("/") + f"{new}.html"), encoding="utf-8")


def setup(app: Any) -> dict[str, bool]:
    """Register the extension."""
    app.connect("build-finished", write)
    return {"parallel_read_safe": True}
