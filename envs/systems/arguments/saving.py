"""Files are written whole or not at all: beside their place first, then moved there.

A disk that is full, or a process that is killed, leaves the old file as it was.
"""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write a file; at any time there is the old one or the new one, never a part of it.

    Raises
    ------
    OSError
        If it cannot be written; what was there before is untouched then.
    """
    target = Path(path)
    if target.is_symlink():  # the file that is meant, not the link
        target = target.resolve()
    if target.exists() and not target.is_file():  # a device such as /dev/null, or a pipe: nothing to be kept
        target.write_bytes(data)
        return
    with NamedTemporaryFile(dir=target.parent, prefix=f".{target.name}.", suffix=".part", delete=False) as file:
        try:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
            os.chmod(file.name, _mode(target))
            os.replace(file.name, target)
        except BaseException:
            with suppress(OSError):
                os.unlink(file.name)
            raise


def write_text(path: str | Path, text: str) -> None:
    """Write text as UTF-8, as `write_bytes` does."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: str | Path, data: Any) -> None:
    """Write plain values as JSON, as `write_bytes` does; ValueError for numbers that JSON has not."""
    write_text(path, json.dumps(data, indent=2, allow_nan=False) + "\n")


def _mode(target: Path) -> int:
    """Permissions of the file that is replaced, or those that a new one gets."""
    if target.exists():
        return target.stat().st_mode & 0o777
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask
