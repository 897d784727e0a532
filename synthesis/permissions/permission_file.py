"""Permissive certificates on disk: one ``.npz`` with a JSON header and the file of the certificate inside."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ...envs.agents import write_bytes
from ..certificates import MAX_BYTES, UNREADABLE, certificate_in, check_sizes, packed
from .permission import Menus, Permission

FORMAT, VERSION = "certigym-permission", 1


def save_permission(permission: Permission, path: str | Path) -> None:
    """Write a permissive certificate to ``path`` (``.npz``), completely or not at all."""
    header = {
        "format": FORMAT,
        "version": VERSION,
        "lower_bound": permission.lower_bound,
        "agents": len(permission.menus),
        "fingerprint": permission.certificate.fingerprint,
    }
    inside = packed(permission.certificate)
    arrays: dict[str, Any] = {"certificate": np.frombuffer(inside, np.uint8)}
    for i, menus in enumerate(permission.menus):
        arrays |= {f"counts_{i}": menus.counts, f"choices_{i}": menus.choices}
    file = io.BytesIO()
    text = np.frombuffer(json.dumps(header, allow_nan=False).encode(), np.uint8)
    np.savez_compressed(file, allow_pickle=False, header=text, **arrays)
    write_bytes(path, file.getvalue())


def is_permission_file(path: str | Path) -> bool:
    """Whether a file looks like one of a permission, by the names of its arrays alone."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {"certificate.npy", "counts_0.npy"} <= {*archive.namelist()}
    except (OSError, zipfile.BadZipFile):
        return False


def load_permission(path: str | Path, max_bytes: int = MAX_BYTES) -> Permission:
    """Return the permissive certificate in a file; it is well-formed then, not yet checked (``check_permission``).

    Parameters
    ----------
    path : str or Path
    max_bytes : int
        Largest size, unpacked, that is read (default: 1 GiB).

    Raises
    ------
    ValueError
        If the file holds none.
    """
    try:
        raw = Path(path).read_bytes()
        # Look at the sizes before unpacking anything: a small file may announce gigabytes.
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            check_sizes(archive, max_bytes)
        with np.load(io.BytesIO(raw), allow_pickle=False) as arrays:
            header = json.loads(arrays["header"].tobytes().decode())
            if header["format"] != FORMAT or header["version"] != VERSION:
                raise ValueError("it is a file of another kind")
            menus = tuple(
                Menus(arrays[f"counts_{i}"].astype(np.int32), arrays[f"choices_{i}"].astype(np.int32))
                for i in range(int(header["agents"]))
            )
            certificate = certificate_in(arrays["certificate"].tobytes(), max_bytes)
        return Permission(certificate, menus, float(header["lower_bound"]))
    except (OSError, *UNREADABLE) as error:
        raise ValueError(f"`path`: expected a permissive certificate in {str(path)!r}, got none: {error}") from error
