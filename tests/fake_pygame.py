"""A stand-in for pygame that opens no window and remembers what it was shown."""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest


def install(monkeypatch: pytest.MonkeyPatch) -> list[np.ndarray]:
    """Put the stand-in where `import pygame` finds it; return the list to which shown frames are added."""
    shown: list[np.ndarray] = []
    module: Any = ModuleType("pygame")
    screen = SimpleNamespace(blit=lambda surface, place: shown.append(surface))
    module.display = SimpleNamespace(
        init=lambda: None,
        set_caption=lambda title: None,
        set_mode=lambda size: screen,
        flip=lambda: None,
        quit=lambda: None,
    )
    module.time = SimpleNamespace(Clock=lambda: SimpleNamespace(tick=lambda rate: None))
    module.event = SimpleNamespace(pump=lambda: None)
    module.surfarray = SimpleNamespace(make_surface=lambda array: np.swapaxes(array, 0, 1))
    monkeypatch.setitem(sys.modules, "pygame", module)
    return shown
