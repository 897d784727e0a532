"""The named problems, and environments by name.

Problems are loaded on first use: registration, at the import of the package, needs the ids alone.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
