"""Losses and gradients that are not finite: that there is one, and where it comes from."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields

import torch
from torch import Tensor, nn

from nerfreg.hooks import Rendering
from nerfreg.numerics import not_finite
from nerfreg.rays.batch import Batch
from nerfreg.registry import Hooks, Term
from nerfreg.rendering.renderer import Renderer
from nerfreg.training.loss import label, loss_terms, total_loss


@dataclass(frozen=True)
class Fault:
    """what: "value of kl", "gradient of kl", "value of rendering.density". detail: how many numbers, and which."""

    what: str
    detail: str

    def __str__(self) -> str:
        return self.what


def usable(total: Tensor, parameters: Iterable[nn.Parameter]) -> bool:
    """Whether the loss is finite, and so are all gradients and their squares, which Adam averages.

    One pass over each gradient: a finite sum of squares has nothing but finite squares in it. Only where it is not
    finite, which may be the sum alone, is every element looked at.
    """
    return bool(total.isfinite()) and all(
        _squares_finite(p.grad) for p in parameters if p.grad is not None
    )


def value_faults(terms: Sequence[Term]) -> list[Fault]:
    """The terms whose value is not finite."""
    values = [(label(term), float(term.value.detach())) for term in terms]
    return [
        Fault(f"value of {name}", str(value)) for name, value in values if not math.isfinite(value)
    ]


def rendering_faults(rendering: Rendering) -> list[Fault]:
    """The parts of rays and rendering that are not finite, in the order in which they are computed."""
    return [
        Fault(f"value of {room}.{field.name}", line)
        for room, whole in (("rays", rendering.rays), ("rendering", rendering))
        for field in fields(whole)
        if isinstance(part := getattr(whole, field.name), Tensor)
        for line in not_finite(field.name, part)
    ]


def gradient_faults(terms: Sequence[Term], field: nn.Module) -> Iterator[Fault]:
    """The terms whose value is finite and whose weighted gradient, alone, is not; first the weights that it breaks."""
    names, parameters = zip(*field.named_parameters(), strict=True)
    for term in terms:
        if not (term.value.requires_grad and term.value.isfinite()):
            continue
        gradients = torch.autograd.grad(
            term.weight * term.value, parameters, retain_graph=True, allow_unused=True
        )
        for name, gradient in zip(names, gradients, strict=True):
            if gradient is not None and not _squares_finite(gradient):
                yield Fault(f"gradient of {label(term)}", _extreme(name, gradient))
                break


def faults_of(rendering: Rendering, terms: Sequence[Term], field: nn.Module) -> list[Fault]:
    """What is not finite in a rendered step, what comes first in a step first."""
    faults = [*rendering_faults(rendering), *value_faults(terms), *gradient_faults(terms, field)]
    if not faults:
        together = "all terms together"
        faults = list(gradient_faults([Term(together, together, 1.0, total_loss(terms))], field))
    return faults


def find_faults(
    batch: Batch, terms: Sequence[Term], renderer: Renderer, hooks: Hooks
) -> list[Fault]:
    """What is not finite in a batch whose terms have been `terms`.

    Renders the batch again; plugins see it a second time.
    """
    again = batch.again(renderer)
    rendering = again.render()
    found = faults_of(rendering, loss_terms(rendering, hooks, again.step), renderer.field)
    faults = [*found, *value_faults(terms)]
    return list({fault.what: fault for fault in faults}.values())


def _squares_finite(gradient: Tensor) -> bool:
    flat = gradient.detach().reshape(-1)
    return bool(flat.dot(flat).isfinite()) or bool(flat.square().isfinite().all())


def _extreme(name: str, gradient: Tensor) -> str:
    lines = not_finite(name, gradient)
    return (
        lines[0]
        if lines
        else f"{name}: up to {float(gradient.abs().max()):.3g}, whose square is not finite"
    )
