"""How long each part of a computation takes, where parts lie inside each other."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter


class Stopwatch:
    """Adds up seconds by part. A part that is entered inside another stops the time of that one until it is left.

    So the seconds of all parts add up to those of the outermost.
    """

    def __init__(self) -> None:
        self._seconds: defaultdict[str, float] = defaultdict(float)
        self._open: list[str] = []
        self._since = 0.0

    def enter(self, part: str) -> None:
        self._credit()
        self._open.append(part)

    def leave(self) -> None:
        """Leave the part that was entered last; the time of the one around it goes on."""
        self._credit()
        self._open.pop()

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        self.enter(name)
        try:
            yield
        finally:
            self.leave()

    def take(self) -> dict[str, float]:
        """Seconds by part since the last call, and begin again from 0."""
        taken = dict(self._seconds)
        self._seconds.clear()
        return taken

    def _credit(self) -> None:
        now = perf_counter()
        if self._open:
            self._seconds[self._open[-1]] += now - self._since
        self._since = now
