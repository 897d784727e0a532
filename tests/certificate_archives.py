"""Certificate files taken apart and written anew, as a forger writes them: with a digest that fits."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from certigym.synthesis.certificates.proofs.archive import _digest


def contents(raw: bytes) -> tuple[dict[str, Any], list[np.ndarray]]:
    """Header and arrays of a file."""
    with np.load(io.BytesIO(raw)) as archive:
        header = json.loads(bytes(archive["header"]).decode())
        return header, [archive[str(k)] for k in range(len(archive.files) - 1)]


def packed(header: dict[str, Any], arrays: list[np.ndarray], path: Path, renew: bool = True) -> Path:
    """Write a file, by default with a digest that fits."""
    if renew:
        header["digest"] = _digest(header, arrays)
    text = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    np.savez_compressed(path, allow_pickle=False, header=text, **{str(k): a for k, a in enumerate(arrays)})
    return path
