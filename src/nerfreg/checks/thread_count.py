"""The number of threads of a check."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numba
import torch

from nerfreg.field.workers import set_threads, threads


@contextmanager
def threads_set(count: int) -> Iterator[None]:
    """Let torch, numba and our own workers have so many threads within this context.

    The tensors of most checks are so small that a second thread would do nothing but wait.
    """
    before, of_torch = threads(), torch.get_num_threads()
    set_threads(min(count, numba.config.NUMBA_NUM_THREADS))
    torch.set_num_threads(count)
    try:
        yield
    finally:
        set_threads(before)
        torch.set_num_threads(of_torch)
