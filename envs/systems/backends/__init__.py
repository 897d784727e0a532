"""Arrays of numpy and of libraries of accelerators.

Arrays of numpy and of the libraries of accelerators. Knows nothing of agents.
"""

from .libraries import (
    HOST,
    LIBRARIES,
    Array,
    concatenated,
    device_put,
    double,
    is_host,
    is_whole,
    namespace,
    single,
    special,
    to_host,
)
from .one_thread import on_one_thread
from .random_numbers import Numbers, numbers_beside
