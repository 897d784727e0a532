"""Large arrays that come and go take the same memory again."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

PAGES = """
import resource
import numpy as np
from certigym.envs.arrays.kept_memory import keep_freed_memory

assert keep_freed_memory()
for turn in range(20):
    if turn == 1:  # the first array is new
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(3_000_000)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other systems decide by themselves")
def test_no_page_is_new_after_the_first_array() -> None:
    """24 MB are 5,860 pages, each time that they are new to the process (some dozens where pages are huge)."""
    pages = subprocess.run([sys.executable, "-c", PAGES], capture_output=True, text=True, check=True)
    assert int(pages.stdout) < 100
