"""What becomes of a step whose loss or gradient is not finite: it is left out, named and saved; three end the run."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

from jaxtyping import Float
from torch import Tensor

from nerfreg.errors import NonFiniteError
from nerfreg.field import RadianceField
from nerfreg.rays.batch import Batch
from nerfreg.registry import Hooks, Term
from nerfreg.rendering.renderer import Renderer
from nerfreg.training.faults import Fault, find_faults

LIMIT = 3
"""So many steps in a row that cannot be used end the run."""


@runtime_checkable
class Recorder(Protocol):
    """Keeps a step for later."""

    def save(
        self, batch: Batch, field: RadianceField, box: Float[Tensor, "2 3"], faults: Sequence[Fault]
    ) -> Path: ...


def to_stderr(line: str) -> None:
    print(line, file=sys.stderr)


class Guard:
    """Counts the steps that were left out, and says why.

    skipped: how many there were. recorder: keeps them; None: nobody does. report: takes a line about each.
    """

    def __init__(
        self, recorder: Recorder | None = None, report: Callable[[str], None] = to_stderr
    ) -> None:
        self.skipped = 0
        self._in_a_row = 0
        self._recorder = recorder
        self._report = report

    def passed(self) -> None:
        """A step was used."""
        self._in_a_row = 0

    def refused(
        self,
        batch: Batch,
        terms: Sequence[Term],
        renderer: Renderer,
        hooks: Hooks,
        box: Float[Tensor, "2 3"],
    ) -> None:
        """A step with these terms was left out, for want of a finite loss or gradient.

        Raises NonFiniteError if it is the third in a row.
        """
        self.skipped += 1
        self._in_a_row += 1
        faults = find_faults(batch, terms, renderer, hooks)
        line = f"step {batch.step.index} left out: {_in_words(faults)}"
        advice = "a smaller optim.lr may help"
        if self._recorder is not None:
            path = self._recorder.save(batch, renderer.field, box, faults)
            advice = f"see nerfreg check --replay {path}"
        if self._in_a_row == LIMIT:
            raise NonFiniteError(f"{line}; the {LIMIT}rd in a row ends the run; {advice}")
        self._report(f"{line}; {advice}")


def _in_words(faults: Sequence[Fault]) -> str:
    if not faults:
        return "loss or gradient not finite, but all of it is when the step is rendered again"
    first, *others = faults
    more = f", and {', '.join(fault.what for fault in others)}" if others else ""
    return f"{first.what} not finite ({first.detail}){more}"
