"""Threads that each take their share of a batch through many small operations.

A pool of its own, and not torch's: torch joins its threads at the end of every operation, of which a batch has
hundreds, and one that is late holds up all the others. Here they meet once. What torch does outside of shares is small,
and waking a second thread for it costs more than the thread brings: so torch gets half as many (`set_threads`).
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
    """How many threads a step takes."""
    return int(numba.get_num_threads())


def set_threads(count: int) -> None:
    """Let steps take so many threads."""
    _set(count, max(1, count // 2))


def in_shares(count: int, chunk: int, work: Callable[[int, int], Result]) -> list[Result]:
    """Split 0..count into one contiguous share per thread, in whole chunks, and return work(start, stop) of each.

    The shares depend on the number of threads alone, and the results come in their order. The caller takes the
    first share.
    """
    sharers = threads()
    chunks = -(-count // chunk)
    per_share = -(-chunks // sharers) * chunk
    shares = [
        (start, min(start + per_share, count)) for start in range(0, count, max(per_share, 1))
    ]
    if len(shares) < 2:
        return [work(*share) for share in shares]
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
    """What the caller runs takes one thread, as in a worker."""
    of_numba, of_torch = numba.get_num_threads(), torch.get_num_threads()
    _set(1, 1)
    try:
        yield
    finally:
        _set(of_numba, of_torch)


def _set(of_numba: int, of_torch: int) -> None:
    # In this order: when numba starts its threads, it may change the number that OpenMP has for both.
    numba.set_num_threads(of_numba)
    torch.set_num_threads(of_torch)


@cache
def _pool(workers: int) -> ThreadPoolExecutor:
    of_torch = torch.get_num_threads()
    pool = ThreadPoolExecutor(workers, "nerfreg", initializer=lambda: _set(1, 1))
    list(pool.map(lambda _: torch.get_num_threads(), range(workers)))
    torch.set_num_threads(
        of_torch
    )  # the number is kept per thread, but new threads take the latest
    return pool
