"""Multi-agent environments with temporal-logic tasks, controllers with certified bounds, and their validation.

The public names are listed in ``__init__.pyi`` and loaded when they are first used, so that importing the package is
cheap. Importing it also registers the environments of the suite with Gymnasium and PettingZoo, once these are loaded.
"""

from pathlib import Path

import lazy_loader

__version__ = "0.3.0"

_HERE = Path(__file__).parent
if not (_HERE / "envs" / "__init__.py").is_file() and (_HERE.parents[1] / "pyproject.toml").is_file():
    __path__.append(str(_HERE.parents[1]))  # a checkout without its symbolic links (zip archive, Windows)

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

from .envs.suite.registration import register_suite as _register_suite  # noqa: E402  (after the search path is set)

_register_suite()
