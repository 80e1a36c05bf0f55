"""Progress of a run: a live bar on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import SupportsFloat

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

REFRESH_SECONDS = 0.2
"""Shortest time between two redrawings of the bar."""
FIRST_LINE_SECONDS = 2.0
"""Time before the first plain line."""
LINE_GROWTH = 1.5
"""Each plain line comes after this many times the time of the one before."""
LONGEST_SILENCE_SECONDS = 60.0
"""Longest time between two plain lines."""


class Progress:
    """Shows step, steps per second, remaining time, PSNR and loss terms of a run.

        with Progress(quiet=False) as progress:
            progress.update(step, fraction, {"color": loss}, psnr)

    On a terminal a bar is redrawn at most five times a second. Elsewhere lines are printed after
    2 s, 3 s, 4.5 s ..., at least one a minute, and one at the end.
    """

    def __init__(
        self,
        quiet: bool = False,
        console: Console | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Prepare to show progress; nothing is shown before the context is entered.

        Args:
            quiet: Show nothing but warnings.
            console: Where to show it; None: on standard error.
            clock: Returns the time in seconds.
        """
        self._console = console or Console(stderr=True)
        self._clock = clock
        self._quiet = quiet
        self._live: Live | None = None
        self._latest: tuple[int, float, Mapping[str, SupportsFloat], float | None] | None = None
        self._shown_step: int | None = None
        self._started = self._rate_since = self._due = 0.0
        self._rate_step, self._rate = 0, 0.0

    def __enter__(self) -> Progress:
        self._started = self._rate_since = self._clock()
        self._due = self._started + (
            REFRESH_SECONDS if self._console.is_terminal else FIRST_LINE_SECONDS
        )
        if self._console.is_terminal and not self._quiet:
            # No automatic refresh, because its thread would compete with training.
            self._live = Live(console=self._console, auto_refresh=False)
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._latest is not None and self._shown_step != self._latest[0] and not self._quiet:
            self._show(self._clock())
        if self._live is not None:
            self._live.stop()
            self._live = None

    def update(
        self,
        step: int,
        fraction: float,
        terms: Mapping[str, SupportsFloat],
        psnr: float | None = None,
    ) -> None:
        """Note what has been done, and show it if it is time; called after every step.

        Args:
            step: Number of steps done.
            fraction: Share of the budget that is spent, 0 to 1.
            terms: Terms of the loss of the last step, by name.
            psnr: The latest PSNR on test views, in dB; None: there is none yet.
        """
        if self._quiet:
            return
        # Terms are kept as tensors and turned into numbers only when they are shown, since that
        # waits for the device. Between two showings a call only reads the clock.
        self._latest = (step, fraction, terms, psnr)
        now = self._clock()
        if now >= self._due:
            self._show(now)

    def message(self, text: str) -> None:
        """Print a line above the bar, unless the run is quiet."""
        if not self._quiet:
            self.warning(text)

    def warning(self, text: str) -> None:
        """Print a line above the bar, in a quiet run too."""
        # Brackets in overrides such as reg=[kl] are not rich's markup, and a line that is wrapped
        # could not be found by a search.
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)

    def _show(self, now: float) -> None:
        assert self._latest is not None
        step, fraction, terms, psnr = self._latest
        self._shown_step = step
        self._measure_rate(step, now)
        elapsed = now - self._started
        parts = [
            f"step {step}",
            f"{self._rate:.1f} it/s",
            f"{_duration(_time_left(elapsed, fraction))} left",
        ]
        if psnr is not None:
            parts.append(f"PSNR {psnr:.2f}")
        parts += [f"{name} {float(value):.3g}" for name, value in terms.items()]
        if self._live is not None:
            self._live.update(_bar(fraction, "  ".join(parts)), refresh=True)
            self._due = now + REFRESH_SECONDS
        else:
            self.message(f"{fraction:4.0%}  " + "  ".join(parts))
            self._due = now + min(
                (LINE_GROWTH - 1) * max(elapsed, FIRST_LINE_SECONDS), LONGEST_SILENCE_SECONDS
            )

    def _measure_rate(self, step: int, now: float) -> None:
        """Measure steps per second since the last showing."""
        # On a terminal showings are close together and the rate would flicker, so it is smoothed.
        if now > self._rate_since and step > self._rate_step:
            rate = (step - self._rate_step) / (now - self._rate_since)
            self._rate = (
                0.8 * self._rate + 0.2 * rate if self._live is not None and self._rate else rate
            )
            self._rate_since, self._rate_step = now, step


def _time_left(elapsed: float, fraction: float) -> float | None:
    return elapsed * (1.0 - fraction) / fraction if fraction > 0 else None


def _duration(seconds: float | None) -> str:
    if seconds is None:
        return "?"
    minutes, rest = divmod(round(max(seconds, 0.0)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def _bar(fraction: float, text: str) -> Table:
    table = Table.grid(padding=(0, 1))
    table.add_row(
        ProgressBar(total=1.0, completed=min(fraction, 1.0), width=24),
        f"{fraction:4.0%}",
        Text(text),
    )
    return table
