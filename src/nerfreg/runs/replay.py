"""Render a step that training left out again, and show what is not finite: terms, rays, samples."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from rich.console import Console
from rich.table import Table
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.hooks import Rendering
from nerfreg.registry import Hooks, Term
from nerfreg.registry.field import make_field
from nerfreg.rendering.renderer import Renderer
from nerfreg.runs.recording import Recording, load_recording
from nerfreg.training.faults import Fault, faults_of
from nerfreg.training.loss import label, loss_terms

SHOWN = 5
"""Number of rays that are listed."""


def replay(path: Path) -> int:
    """Render a saved step again, on the CPU, and print what is not finite.

    The plugins are those that are installed now, so that a repaired plugin can be tried.

    Args:
        path: A file of RUN/nonfinite, or a copy of it.

    Returns:
        The exit code: 1 if anything is not finite, else 0.

    Raises:
        NerfregError: The file is not such a step, or its weights do not fit the plugins.
    """
    recording = load_recording(path)
    config, batch = recording.config, recording.batch
    hooks = Hooks(config.reg)
    field = make_field(config.field, recording.scene, hooks)
    hooks.load_state_dict(recording.states)
    try:
        field.load_state_dict(recording.weights)
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise NerfregError(
            f"{path}: its weights do not fit the plugins that are installed now: {reason}"
        ) from error
    again = batch.again(Renderer(field, config.sampler, hooks))
    hooks.begin(again.step)
    # The rays are there already, but hooks remember what each plugin asked for.
    hooks.needs(again.step)
    rendering = again.render()
    terms = loss_terms(rendering, hooks, again.step)
    faults = faults_of(rendering, terms, field)
    _report(recording, rendering, terms, faults)
    return 1 if faults else 0


def _report(
    recording: Recording, rendering: Rendering, terms: Sequence[Term], faults: Sequence[Fault]
) -> None:
    batch = recording.batch
    # Soft wrapping leaves lines whole where the output is not a terminal.
    console = Console(markup=False, highlight=False, soft_wrap=True)
    place = f"step {batch.step.index} of {batch.step.total}, {len(batch.rays)} rays"
    console.print(f"{place}, left out because of")
    console.print(f"  {', '.join(recording.faults) or 'a fault that was not found again'}")
    console.print(_term_table(terms, faults))
    for fault in faults:
        console.print(f"{fault.what}: {fault.detail}")
    if faults:
        console.print(_sample_table(rendering, _gradient(rendering, terms)))
    else:
        console.print("everything is finite now")


def _term_table(terms: Sequence[Term], faults: Sequence[Fault]) -> Table:
    broken = {fault.what for fault in faults}
    table = Table("term", "weight", "value", "gradient", box=None, pad_edge=False)
    for term in terms:
        if f"value of {label(term)}" in broken:
            # The gradient of such a value means nothing.
            verdict = "not checked"
        else:
            verdict = "NOT FINITE" if f"gradient of {label(term)}" in broken else "finite"
        table.add_row(label(term), f"{term.weight:g}", f"{float(term.value.detach()):g}", verdict)
    return table


def _gradient(rendering: Rendering, terms: Sequence[Term]) -> Float[Tensor, "rays samples"]:
    """Return the gradient of the loss with respect to the density, term by term.

    It is not finite at the samples where a term's gradient is not.
    """
    total = torch.zeros_like(rendering.density)
    for term in terms:
        if term.value.requires_grad and rendering.density.requires_grad:
            [part] = torch.autograd.grad(
                term.value, rendering.density, retain_graph=True, allow_unused=True
            )
            total = total if part is None else total + term.weight * part
    return total


def _sample_table(rendering: Rendering, gradient: Float[Tensor, "rays samples"]) -> Table:
    """Return a table of the first sample at fault on each ray."""
    suspects = _suspects(rendering, gradient)
    rays = suspects.any(dim=1).nonzero()[:, 0]
    title = (
        f"{int(suspects.sum())} samples on {len(rays)} of {len(suspects)} rays; "
        "the first on each ray"
    )
    columns = ("ray", "sample", "t", "density", "weight", "depth", "d loss / d density")
    table = Table(
        *columns, box=None, pad_edge=False, title=title, title_justify="left", title_style=""
    )
    for ray in rays[:SHOWN].tolist():
        sample = int(suspects[ray].nonzero()[0, 0])
        numbers = (
            rendering.t[ray, sample],
            rendering.density[ray, sample],
            rendering.weights[ray, sample],
            rendering.depth[ray],
            gradient[ray, sample],
        )
        table.add_row(str(ray), str(sample), *(f"{float(number.detach()):g}" for number in numbers))
    return table


def _suspects(
    rendering: Rendering, gradient: Float[Tensor, "rays samples"]
) -> Bool[Tensor, "rays samples"]:
    # Depth and colour belong to a whole ray, all of whose samples are then suspects.
    fine = (
        gradient.isfinite()
        & rendering.depth.isfinite()[:, None]
        & rendering.rgb.isfinite().all(dim=1)[:, None]
    )
    for part in (rendering.t, rendering.density, rendering.weights):
        fine = fine & part.isfinite()
    return ~fine
