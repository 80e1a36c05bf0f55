from __future__ import annotations

from types import SimpleNamespace

import pytest

from nerfreg.bench import stopwatch
from nerfreg.bench.stopwatch import Stopwatch


@pytest.fixture
def wait(monkeypatch: pytest.MonkeyPatch):
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(stopwatch, "perf_counter", lambda: clock.now)

    def wait(seconds: float) -> None:
        clock.now += seconds

    return wait


def test_an_inner_part_stops_the_outer_one(wait) -> None:
    watch = Stopwatch()
    wait(7)  # before anything is entered: nobody's
    with watch.part("outer"):
        wait(1)
        with watch.part("inner"):
            wait(2)
            with watch.part("outer"):
                wait(4)
        wait(8)
    wait(16)
    assert watch.take() == {"outer": 1 + 4 + 8, "inner": 2}
    assert watch.take() == {}


def test_an_error_leaves_the_part(wait) -> None:
    watch = Stopwatch()
    with watch.part("outer"):
        with pytest.raises(ValueError), watch.part("inner"):
            wait(1)
            raise ValueError
        wait(2)
    assert watch.take() == {"outer": 2, "inner": 1}
