"""Headers of files of 0.1 and 0.2, which had one layout for each kind of proof, as those of version 2."""

from __future__ import annotations

from typing import Any

KEYS = {
    "parts": "product",
    "path": "path",
    "hull": "hull",
    "mixed": "mixed",
    "without_pairs": "subtraction",
    "written_out": "timed",
    "team": "joint",
}
"""Entries by which kinds of proofs were told; a file without any of them was about cells."""


def upgraded(header: dict[str, Any]) -> dict[str, Any]:
    """Return the header of a file of version 1 as one of version 2; nothing in it is trusted."""
    key = next((key for key in KEYS if key in header), None)
    entry = {name: header[name] for name in header if name not in ("problem", "fingerprint", "settings")}
    if key in ("path", "hull"):
        entry = {**header[key], "failure": header["failure"]}
    elif key is not None:
        entry["parts" if key in ("parts", "mixed") else "base"] = header[key]
    entry["kind"] = "grid" if key is None else KEYS[key]
    # Products, joint agents and problems written out had the settings of their parts alone.
    common = {name: header[name] for name in ("problem", "fingerprint")}
    return {**common, "settings": header.get("settings"), "proof": entry}
