"""Permissive certificates on disk: one ``.npz`` with a JSON header and the file of the certificate inside."""

from __future__ import annotations

import io
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.agents import write_bytes
from ..certificates import Certificate, load_certificate, save_certificate
from .permission import Menus, Permission

FORMAT, VERSION = "certigym-permission", 1

MAX_BYTES = 2 * 2**30
"""Largest file that is read."""


def save_permission(permission: Permission, path: str | Path) -> None:
    """Write a permissive certificate to ``path`` (``.npz``), completely or not at all."""
    target = Path(path)
    header = {
        "format": FORMAT,
        "version": VERSION,
        "lower_bound": permission.lower_bound,
        "agents": len(permission.menus),
        "fingerprint": permission.certificate.fingerprint,
    }
    inside = target.with_name(f"{target.name}.certificate")
    save_certificate(permission.certificate, inside)
    try:
        arrays: dict[str, Any] = {"certificate": np.frombuffer(inside.read_bytes(), np.uint8)}
    finally:
        inside.unlink()
    for i, menus in enumerate(permission.menus):
        arrays |= {f"counts_{i}": menus.counts, f"choices_{i}": menus.choices}
    file = io.BytesIO()
    text = np.frombuffer(json.dumps(header, allow_nan=False).encode(), np.uint8)
    np.savez_compressed(file, allow_pickle=False, header=text, **arrays)
    write_bytes(target, file.getvalue())


def load_permission(path: str | Path) -> Permission:
    """Return the permissive certificate in a file; it is well-formed then, not yet checked (``check_permission``).

    Raises
    ------
    ValueError
        If the file holds none.
    """
    source = Path(path)
    try:
        if source.stat().st_size > MAX_BYTES:
            raise ValueError(f"the file has more than {MAX_BYTES} bytes")
        with np.load(source, allow_pickle=False) as archive:
            header = json.loads(archive["header"].tobytes().decode())
            if header["format"] != FORMAT or header["version"] != VERSION:
                raise ValueError("it is a file of another kind")
            menus = tuple(
                Menus(archive[f"counts_{i}"].astype(np.int32), archive[f"choices_{i}"].astype(np.int32))
                for i in range(int(header["agents"]))
            )
            inside = archive["certificate"].tobytes()
            lower_bound = float(header["lower_bound"])
    except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"`path`: expected a permissive certificate in {str(path)!r}, got none: {error}") from error
    certificate = _certificate_of(inside, source)
    return Permission(certificate, menus, lower_bound)


def _certificate_of(data: bytes, source: Path) -> Certificate:
    """Return the certificate in the bytes of a file."""
    with tempfile.TemporaryDirectory() as folder:
        inside = Path(folder) / "certificate.npz"
        inside.write_bytes(data)
        certificate = load_certificate(inside)
    if not isinstance(certificate, Certificate):
        raise ValueError(f"`path`: expected a permissive certificate of one task in {str(source)!r}")
    return certificate
