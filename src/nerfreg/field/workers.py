"""Threads that each take their share of a batch through many small operations.

A pool of its own, and not torch's: torch joins its threads at the end of every operation, of which a batch has
hundreds, and one that is late holds up all the others. Here they meet once.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

import numba
import torch

Result = TypeVar("Result")


def in_shares(count: int, chunk: int, work: Callable[[int, int], Result]) -> list[Result]:
    """Split 0..count into one contiguous share per thread, in whole chunks, and return work(start, stop) of each.

    The shares depend on the number of torch's threads alone, and the results come in their order.
    """
    threads = torch.get_num_threads()
    chunks = -(-count // chunk)
    per_share = -(-chunks // threads) * chunk
    shares = [(start, min(start + per_share, count)) for start in range(0, count, max(per_share, 1))]
    if len(shares) < 2:
        return [work(*share) for share in shares]
    grad = torch.is_grad_enabled()

    def run(share: tuple[int, int]) -> Result:
        with torch.set_grad_enabled(grad):
            return work(*share)

    return list(_pool(threads).map(run, shares))


def _alone() -> None:
    """What a worker calls runs in its own thread, be it torch's or numba's."""
    numba.set_num_threads(1)
    torch.set_num_threads(1)


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    pool = ThreadPoolExecutor(threads, "nerfreg", initializer=_alone)
    list(pool.map(lambda _: torch.get_num_threads(), range(threads)))
    torch.set_num_threads(threads)  # the number is kept per thread, but new threads take the latest
    return pool
