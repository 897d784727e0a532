"""Arrays of numpy and of the libraries of accelerators. Knows nothing of agents."""

from .libraries import (
    HOST,
    LIBRARIES,
    Array,
    beside,
    concatenated,
    device_put,
    is_host,
    namespace,
    special,
    to_host,
)

__all__ = [
    "Array",
    "HOST",
    "LIBRARIES",
    "beside",
    "concatenated",
    "device_put",
    "is_host",
    "namespace",
    "special",
    "to_host",
]
