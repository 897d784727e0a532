"""One thread of linear algebra: results depend on no machine then, and small systems do not wait for threads.

Libraries of linear algebra cut products into as many pieces as there are cores, which changes the order of sums; and
for matrices of a few rows, of which this package has many, starting threads takes longer than the product, on a busy
machine by a factor of ten and more. Whoever has several cores runs several problems at once.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

from threadpoolctl import ThreadpoolController

from .kept_memory import keep_freed_memory

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def on_one_thread(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """Return a function that is run with one thread of linear algebra; afterwards there are as many as before.

    What it frees is kept for its next arrays.
    """

    @wraps(function)
    def limited(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        keep_freed_memory()
        with _libraries().limit(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


@cache
def _libraries() -> Any:
    """Return the libraries of linear algebra that are loaded: those of numpy and scipy, once both are imported."""
    import scipy.linalg  # noqa: F401 - what is loaded later would not be limited

    return ThreadpoolController()
