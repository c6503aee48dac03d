"""Threads of the BLAS: one, but for matrices so large that more are worth their company.

Between two products OpenBLAS's threads go on waiting, and where another program has the second core, each product waits
for the helper to get its turn: some 10 ms. On two cores that others use, too, 3,000 images (30 10^9 multiplications)
take 1 to 2 s with one thread, and 4 to 28 s with two.
"""

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache

from threadpoolctl import ThreadpoolController

_WORTHWHILE = 1e10
"""Multiplications of one clique from which on more threads are worth their waiting."""


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for the BLAS, in the whole process."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


def many_threads(operations: float) -> AbstractContextManager[object]:
    """Within `one_thread`: all processors for so many multiplications, where that is worth it."""
    if operations < _WORTHWHILE:
        return nullcontext()
    limit: AbstractContextManager[object] = _controller().limit(limits=os.cpu_count() or 1, user_api="blas")
    return limit
