from __future__ import annotations

import gc
from itertools import count
from types import SimpleNamespace

import pytest
import torch

from nerfreg.bench import timing
from nerfreg.bench.timing import in_turns, median_seconds


def test_calls_take_turns_after_a_warm_up() -> None:
    calls: list[str] = []
    seconds = median_seconds([lambda: calls.append("a"), lambda: calls.append("b")], 3)
    assert "".join(calls) == "ab" + "ababab"
    assert len(seconds) == 2


def test_median_without_the_warm_up(monkeypatch: pytest.MonkeyPatch) -> None:
    # A clock that the calls wind on: 100 seconds for the first, then 1, 2 and 9.
    clock = SimpleNamespace(now=0.0)
    durations = iter([100.0, 1.0, 2.0, 9.0])
    monkeypatch.setattr(timing, "perf_counter", lambda: clock.now)
    assert median_seconds([lambda: setattr(clock, "now", clock.now + next(durations))], 3) == [2.0]


def test_one_thread_inside_and_everything_restored_after_an_error() -> None:
    before = torch.get_num_threads()
    seen: list[tuple[int, bool]] = []
    turns = count()

    def fail() -> None:
        seen.append((torch.get_num_threads(), gc.isenabled()))
        if next(turns) == 1:
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        median_seconds([fail], 2)
    assert seen == [(1, False)] * 2
    assert torch.get_num_threads() == before
    assert gc.isenabled()


def test_rounds_are_kept_apart(clock: SimpleNamespace) -> None:
    durations = {"a": iter([1.0, 2.0, 3.0]), "b": iter([10.0, 20.0, 30.0])}

    def take(name: str) -> None:
        clock.now += next(durations[name])

    assert in_turns([lambda: take("a"), lambda: take("b")], 3) == [
        [1.0, 2.0, 3.0],
        [10.0, 20.0, 30.0],
    ]
