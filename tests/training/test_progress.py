from __future__ import annotations

import io
import itertools

import pytest
from rich.console import Console

from nerfreg.training.progress import Progress


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Counted:
    """A loss term that counts how often it is read."""

    def __init__(self) -> None:
        self.reads = 0

    def __float__(self) -> float:
        self.reads += 1
        return 0.0123


def run(
    steps: int, seconds_per_step: float, terminal: bool, term: Counted, quiet: bool = False
) -> str:
    clock, out = Clock(), io.StringIO()
    console = Console(file=out, force_terminal=terminal, width=160)
    with Progress(quiet=quiet, console=console, clock=clock) as progress:
        for step in range(1, steps + 1):
            clock.now += seconds_per_step
            progress.update(step, step / steps, {"color": term}, 21.5)
    return out.getvalue()


def test_lines_come_at_growing_intervals_and_at_the_end():
    # 20 s in steps of 1/4 s: due at 2, 3, 4.5, 6.75, 10.125 (first step after: 10.25), then
    # 10.25 * 1.5 = 15.375 (first step after: 15.5), and the end at 20: steps 8, 12, 18, 27, 41, 62,
    # 80.
    lines = run(80, 0.25, False, Counted()).splitlines()
    assert [int(line.split("step ")[1].split()[0]) for line in lines] == [8, 12, 18, 27, 41, 62, 80]


def test_a_line_tells_share_rate_time_left_and_terms():
    # at step 8 of 80: 2 s gone, a tenth done, so 18 s left, at 4 steps a second
    first = run(80, 0.25, False, Counted()).splitlines()[0]
    assert first == " 10%  step 8  4.0 it/s  0:18 left  PSNR 21.50  color 0.0123"


def test_long_runs_speak_once_a_minute():
    # 10000 s, one step a second: after the intervals have grown to 60 s, lines are 60 s apart
    steps = [
        int(line.split("step ")[1].split()[0])
        for line in run(10000, 1.0, False, Counted()).splitlines()
    ]
    gaps = [b - a for a, b in itertools.pairwise(steps)]
    assert max(gaps) == 60
    assert len(steps) < 10000 / 60 + 15


def test_a_terminal_is_redrawn_at_most_five_times_a_second():
    # 1000 steps in 1 s: terms are read at most five times, and once at the end
    term = Counted()
    out = run(1000, 0.001, True, term)
    assert 4 <= term.reads <= 6
    assert "step 1000" in out
    assert "100%" in out


def test_plain_output_has_no_control_characters():
    assert "\x1b" not in run(80, 0.25, False, Counted())


@pytest.mark.parametrize("terminal", [True, False])
def test_quiet_says_nothing_and_reads_nothing(terminal):
    term = Counted()
    assert run(100, 1.0, terminal, term, quiet=True) == ""
    assert term.reads == 0


def test_the_last_step_is_not_told_twice():
    # 2 s in one step: shown when due, and not again at the end
    assert len(run(1, 2.0, False, Counted()).splitlines()) == 1


def test_a_run_that_fails_passes_its_error_on_and_frees_the_terminal():
    out = io.StringIO()
    console = Console(file=out, force_terminal=True)
    with pytest.raises(RuntimeError, match="diverged"), Progress(console=console) as progress:
        progress.update(1, 0.0, {}, None)
        raise RuntimeError("diverged")
    assert out.getvalue().endswith("\x1b[?25h")  # the cursor is visible again


def test_unknown_time_left_and_psnr_are_left_open():
    clock, out = Clock(), io.StringIO()
    with Progress(console=Console(file=out, width=160), clock=clock) as progress:
        clock.now += 2.0
        progress.update(0, 0.0, {}, None)
    assert "? left" in out.getvalue()
    assert "PSNR" not in out.getvalue()


def test_brackets_in_messages_are_not_markup():
    out = io.StringIO()
    Progress(console=Console(file=out)).message("reg=[kl] at 0.5")
    assert out.getvalue() == "reg=[kl] at 0.5\n"


def test_warnings_are_said_in_a_quiet_run_too():
    out = io.StringIO()
    progress = Progress(quiet=True, console=Console(file=out))
    progress.message("scoring")
    progress.warning("step 3 left out")
    assert out.getvalue() == "step 3 left out\n"
