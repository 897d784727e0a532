"""The named problems, and environments by name.

Loaded when first used: registration, which happens when the package is imported, needs the ids alone.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
