"""What becomes of a step whose loss or gradient is not finite.

It is left out, named and saved; three in a row end the run.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from nerfreg.errors import NonFiniteError
from nerfreg.field import RadianceField
from nerfreg.rays.batch import Batch
from nerfreg.registry import Hooks, Term
from nerfreg.rendering.renderer import Renderer
from nerfreg.training.faults import Fault, find_faults

LIMIT = 3
"""Number of consecutive steps that cannot be used after which the run ends."""


@runtime_checkable
class FaultRecorder(Protocol):
    """Saves steps that cannot be used; `nerfreg.runs.recording.StepRecorder` is one."""

    def save(
        self,
        batch: Batch,
        field: RadianceField,
        box: Float[Tensor, "2 3"],
        faults: Sequence[Fault],
        states: dict[str, dict[str, Any]],
    ) -> Path:
        """Save a step.

        Args:
            batch: The rays of the step.
            field: The field, with its weights before the step.
            box: (2, 3) corners of the scene's box.
            faults: What was not finite.
            states: The state of plugins, by name.

        Returns:
            The file.
        """


def to_stderr(line: str) -> None:
    """Print a line to standard error."""
    print(line, file=sys.stderr)


class Guard:
    """Counts the steps that were left out, and reports why.

    Attributes:
        skipped: Number of steps that were left out.
    """

    def __init__(
        self, recorder: FaultRecorder | None = None, report: Callable[[str], None] = to_stderr
    ) -> None:
        """Make a guard of one run.

        Args:
            recorder: Saves the steps; None: they are not saved.
            report: Called with one line about each.
        """
        self.skipped = 0
        self._in_a_row = 0
        self._recorder = recorder
        self._report = report

    def passed(self) -> None:
        """Note that a step was used."""
        self._in_a_row = 0

    def refused(
        self,
        batch: Batch,
        terms: Sequence[Term],
        renderer: Renderer,
        hooks: Hooks,
        box: Float[Tensor, "2 3"],
    ) -> None:
        """Report and save a step that was left out.

        Args:
            batch: The rays of the step.
            terms: The terms of its loss.
            renderer: Renders the batch again, to find what is not finite.
            hooks: The hooks of the run.
            box: (2, 3) corners of the scene's box.

        Raises:
            NonFiniteError: It is the third in a row.
        """
        self.skipped += 1
        self._in_a_row += 1
        faults = find_faults(batch, terms, renderer, hooks)
        line = f"step {batch.step.index} left out: {_in_words(faults)}"
        advice = "a smaller optim.lr may help"
        if self._recorder is not None:
            path = self._recorder.save(batch, renderer.field, box, faults, hooks.state_dict())
            advice = f"see nerfreg check --replay {path}"
        # The weights have not changed and the rays were others each time, so that the next step is
        # unlikely to fare better.
        if self._in_a_row == LIMIT:
            raise NonFiniteError(
                f"{line}; this is the {LIMIT}rd in a row and ends the run; {advice}"
            )
        self._report(f"{line}; {advice}")


def _in_words(faults: Sequence[Fault]) -> str:
    if not faults:
        return "loss or gradient not finite, but finite when the step is rendered again"
    first, *others = faults
    more = f", and {', '.join(fault.what for fault in others)}" if others else ""
    return f"{first.what} is not finite ({first.detail}){more}"
