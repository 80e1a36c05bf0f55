"""A step that training left out, rendered again: which term is not finite, on which rays and samples."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import torch
from jaxtyping import Bool, Float
from rich.console import Console
from rich.table import Table
from torch import Tensor

from nerfreg.errors import NerfregError
from nerfreg.field import RadianceField
from nerfreg.hooks import Rendering
from nerfreg.registry import Hooks, Term
from nerfreg.rendering.renderer import Renderer
from nerfreg.runs.recording import load_recording
from nerfreg.training.faults import Fault, faults_of
from nerfreg.training.loss import label, loss_terms

SHOWN = 5
"""Rays that are listed."""


def replay(path: Path) -> int:
    """Render the step saved in `path` again, on the CPU, and print what is not finite.

    Returns 1 if anything is not, 0 if all is finite with the plugins as they are installed now. Raises NerfregError
    for a file that is no such step.
    """
    recording = load_recording(path)
    config, batch = recording.config, recording.batch
    hooks = Hooks(config.reg)
    field = RadianceField(config.field, recording.box, hooks.layer)
    try:
        field.load_state_dict(recording.weights)
    except RuntimeError as error:
        reason = str(error).splitlines()[0]
        raise NerfregError(
            f"{path}: its weights do not fit the plugins as they are now: {reason}"
        ) from error
    again = batch.again(Renderer(field, config.sampler, hooks))
    rendering = again.render()
    terms = loss_terms(rendering, hooks, again.step)
    faults = faults_of(rendering, terms, field)

    console = Console(markup=False, highlight=False, soft_wrap=True)
    console.print(
        f"step {batch.step.index} of {batch.step.total}, {len(batch.rays)} rays, left out for"
    )
    console.print(f"  {', '.join(recording.faults) or 'something that was not found'}")
    console.print(_term_table(terms, faults))
    for fault in faults:
        console.print(f"{fault.what}: {fault.detail}")
    if faults:
        console.print(_sample_table(rendering, _gradient(rendering, terms)))
    else:
        console.print("all is finite now")
    return 1 if faults else 0


def _term_table(terms: Sequence[Term], faults: Sequence[Fault]) -> Table:
    broken = {fault.what for fault in faults}
    table = Table("term", "weight", "value", "gradient", box=None, pad_edge=False)
    for term in terms:
        if f"value of {label(term)}" in broken:
            verdict = "not looked at"
        else:
            verdict = "NOT FINITE" if f"gradient of {label(term)}" in broken else "finite"
        table.add_row(label(term), f"{term.weight:g}", f"{float(term.value.detach()):g}", verdict)
    return table


def _gradient(rendering: Rendering, terms: Sequence[Term]) -> Float[Tensor, "rays samples"]:
    """Gradient of the whole loss with respect to the density; where a term is at fault it is not finite."""
    total = torch.zeros_like(rendering.density)
    for term in terms:
        if term.value.requires_grad and rendering.density.requires_grad:
            [part] = torch.autograd.grad(
                term.value, rendering.density, retain_graph=True, allow_unused=True
            )
            total = total if part is None else total + term.weight * part
    return total


def _sample_table(rendering: Rendering, gradient: Float[Tensor, "rays samples"]) -> Table:
    """The first sample of each ray where the rendering or the gradient of the density is not finite."""
    suspects = _suspects(rendering, gradient)
    rays = suspects.any(dim=1).nonzero()[:, 0]
    title = f"{int(suspects.sum())} samples on {len(rays)} of {len(suspects)} rays; the first on each ray"
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
    fine = (
        gradient.isfinite()
        & rendering.depth.isfinite()[:, None]
        & rendering.rgb.isfinite().all(dim=1)[:, None]
    )
    for part in (rendering.t, rendering.density, rendering.weights):
        fine = fine & part.isfinite()
    return ~fine
