"""Memory that was freed stays with the process: large arrays come and go at every step of a search.

The memory manager of most Linux systems gives freed memory back at once, so that every array of some megabytes is new
to the process, page by page: a fifth of the time of a search on fine cells. Elsewhere nothing is changed.
"""

from __future__ import annotations

import ctypes
import platform
from functools import cache

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Numbers of these parameters (``malloc.h``)."""

MOST_KEPT = 2**31 - 1
"""Bytes at the end of what is used that are kept."""

LARGEST = (2**30, 2**25)
"""Bytes of the largest arrays that are kept; older systems know no more than the second number."""


@cache
def keep_freed_memory() -> bool:
    """Ask the memory manager to keep what is freed; return whether it does, which depends on the system alone."""
    if platform.libc_ver()[0] != "glibc":
        return False
    adjust = ctypes.CDLL(None).mallopt
    return any(adjust(MMAP_THRESHOLD, size) for size in LARGEST) and bool(adjust(TRIM_THRESHOLD, MOST_KEPT))
