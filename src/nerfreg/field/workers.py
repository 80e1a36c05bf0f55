"""Threads that each take a share of a batch through many small operations.

The pool is our own and not torch's: torch joins its threads at the end of every operation, of which
a batch has hundreds, and one late thread holds up all the others. Here they meet once per batch.
What torch does outside of the shares is small, and waking a second thread for it costs more time
than the thread saves, so torch gets half as many threads (`set_threads`). Together that saves 10 to
20 % of a step on two cores.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

import numba
import torch

Result = TypeVar("Result")


def threads() -> int:
    """Return the number of threads that a step uses."""
    # numba's number is the one that `set_threads` sets in full.
    return int(numba.get_num_threads())


def set_threads(count: int) -> None:
    """Set the number of threads that a step uses."""
    _set(count, max(1, count // 2))


def in_shares(count: int, chunk: int, work: Callable[[int, int], Result]) -> list[Result]:
    """Split a range into one contiguous share per thread, and work on the shares in parallel.

    The shares depend on the number of threads alone. The calling thread takes the first one.

    Args:
        count: Length of the range, which begins at 0.
        chunk: Granularity: every share but the last is a multiple of it.
        work: Called with start and stop of each share. It must let go of the interpreter lock for
            most of its time to gain anything.

    Returns:
        What `work` returned, in the order of the shares.
    """
    sharers = threads()
    chunks = -(-count // chunk)
    per_share = -(-chunks // sharers) * chunk
    shares = [
        (start, min(start + per_share, count)) for start in range(0, count, max(per_share, 1))
    ]
    # A small batch wakes nobody, and torch and numba keep their own threads for it.
    if len(shares) < 2:
        return [work(*share) for share in shares]
    # Whether gradients are recorded is a setting per thread, and the workers have the default.
    grad = torch.is_grad_enabled()

    def run(share: tuple[int, int]) -> Result:
        with torch.set_grad_enabled(grad):
            return work(*share)

    others = [_pool(sharers - 1).submit(run, share) for share in shares[1:]]
    with _one_thread():
        first = work(*shares[0])
    return [first, *(other.result() for other in others)]


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limit the calling thread to one thread of torch and numba, as the workers are.

    Its operations would otherwise compete with the workers for the cores.
    """
    of_numba, of_torch = numba.get_num_threads(), torch.get_num_threads()
    _set(1, 1)
    try:
        yield
    finally:
        _set(of_numba, of_torch)


def _set(of_numba: int, of_torch: int) -> None:
    # In this order: when numba starts its threads, it may reset the number that OpenMP holds for
    # both, and torch would use all cores again.
    numba.set_num_threads(of_numba)
    torch.set_num_threads(of_torch)


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    of_torch = torch.get_num_threads()
    pool = ThreadPoolExecutor(workers, "nerfreg", initializer=lambda: _set(1, 1))
    # The executor starts a thread when a task comes; these tasks make the workers start now.
    list(pool.map(lambda _: torch.get_num_threads(), range(workers)))
    # torch keeps the number per thread, but a new thread takes the latest that any thread has set,
    # which is the 1 of the workers by now.
    torch.set_num_threads(of_torch)
    return pool
