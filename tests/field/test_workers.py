"""Shares of a batch."""

from __future__ import annotations

import numba
import torch

from nerfreg.field.workers import in_shares, set_threads, threads


def test_shares_are_contiguous_whole_chunks_in_order() -> None:
    for count in (0, 1, 10, 11, 99, 100, 101):
        shares = in_shares(count, 10, lambda start, stop: (start, stop))
        covered = [i for start, stop in shares for i in range(start, stop)]
        assert covered == list(range(count))
        assert all(start % 10 == 0 for start, _ in shares)
        assert len(shares) <= threads()


def test_threads_of_the_caller_are_left_as_they_are() -> None:
    before = threads(), torch.get_num_threads()
    inside = in_shares(1000, 10, lambda start, stop: (threads(), torch.get_num_threads()))
    assert len(inside) == threads() and set(inside) == {(1, 1)}
    assert (threads(), torch.get_num_threads()) == before


def test_torch_gets_half_of_the_threads_and_one_at_least() -> None:
    before = threads(), torch.get_num_threads()
    for count in range(1, numba.config.NUMBA_NUM_THREADS + 1):
        set_threads(count)
        assert (threads(), torch.get_num_threads()) == (count, max(1, count // 2))
    numba.set_num_threads(before[0])
    torch.set_num_threads(before[1])


def test_gradients_are_off_in_the_threads_where_they_are_off_outside() -> None:
    with torch.no_grad():
        assert not any(in_shares(1000, 10, lambda start, stop: torch.is_grad_enabled()))
