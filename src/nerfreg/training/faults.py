"""Losses and gradients that are not finite: whether there are any, and where they come from."""

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

UNKNOWN_IS_NAN = ("known_depth", "pixel")
"""The attributes of rays that are NaN where nothing is known."""


@dataclass(frozen=True)
class Fault:
    """Something that is not finite.

    Attributes:
        what: For example "value of kl", "gradient of kl" or "value of rendering.density".
        detail: How many numbers are not finite, and the first of them.
    """

    what: str
    detail: str

    def __str__(self) -> str:
        return self.what


def usable(total: Tensor, parameters: Iterable[nn.Parameter]) -> bool:
    """Return whether a step can be applied.

    The loss, all gradients and their squares have to be finite: Adam averages the squares, and an
    infinite average would never become finite again and stop the weight for the rest of the run.

    Args:
        total: The loss.
        parameters: The trained weights, with their gradients.
    """
    return bool(total.isfinite()) and all(
        _squares_finite(p.grad) for p in parameters if p.grad is not None
    )


def value_faults(terms: Sequence[Term]) -> list[Fault]:
    """Return the terms whose value is not finite."""
    values = [(label(term), float(term.value.detach())) for term in terms]
    return [
        Fault(f"value of {name}", str(value)) for name, value in values if not math.isfinite(value)
    ]


def rendering_faults(rendering: Rendering) -> list[Fault]:
    """Return the tensors of rays and rendering that are not finite."""
    # The fields are declared in the order in which they are computed, so that the first fault is
    # the nearest to the cause.
    return [
        Fault(f"value of {owner}.{field.name}", line)
        for owner, whole in (("rays", rendering.rays), ("rendering", rendering))
        for field in fields(whole)
        if field.name not in UNKNOWN_IS_NAN
        if isinstance(part := getattr(whole, field.name), Tensor)
        for line in not_finite(field.name, part)
    ]


def gradient_faults(terms: Sequence[Term], field: nn.Module) -> Iterator[Fault]:
    """Yield the terms whose value is finite but whose gradient is not.

    Args:
        terms: Terms whose graphs are still there. Each is differentiated alone and weighted, since
            a weight may be what makes a gradient overflow.
        field: The module whose parameters are differentiated by.

    Yields:
        One fault per term, which tells of the first parameter whose gradient is not finite.
    """
    names, parameters = zip(*field.named_parameters(), strict=True)
    for term in terms:
        # A value that is not finite has no meaningful gradient, and is a fault of its own.
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
    """Return what is not finite in a rendered step, in the order in which a step computes it.

    Args:
        rendering: The rendering.
        terms: The terms of its loss, whose graphs are still there.
        field: The field that was rendered.
    """
    faults = [*rendering_faults(rendering), *value_faults(terms), *gradient_faults(terms, field)]
    if not faults:
        # Gradients that are finite one by one may overflow in their sum.
        together = "all terms together"
        faults = list(gradient_faults([Term(together, together, 1.0, total_loss(terms))], field))
    return faults


def find_faults(
    batch: Batch, terms: Sequence[Term], renderer: Renderer, hooks: Hooks
) -> list[Fault]:
    """Return what is not finite in a batch, which is rendered again to find out.

    The hooks of the plugins are called a second time.

    Args:
        batch: The batch.
        terms: Its terms in training.
        renderer: Renders the batch again, apart from the one that counts the points of training.
        hooks: The hooks of the run.
    """
    # The backward pass of the step has freed its graph, so that gradients of single terms need a
    # new one.
    again = batch.again(renderer)
    rendering = again.render()
    found = faults_of(rendering, loss_terms(rendering, hooks, again.step), renderer.field)
    # A plugin that is random or keeps state may be finite the second time, so that the values of
    # the first time count as well; each fault is named once.
    faults = [*found, *value_faults(terms)]
    return list({fault.what: fault for fault in faults}.values())


def _squares_finite(gradient: Tensor) -> bool:
    flat = gradient.detach().reshape(-1)
    # One pass, without a temporary tensor: if the sum of squares is finite, so is every square.
    # Only if it is not, which may be due to the sum alone, each element is looked at.
    return bool(flat.dot(flat).isfinite()) or bool(flat.square().isfinite().all())


def _extreme(name: str, gradient: Tensor) -> str:
    lines = not_finite(name, gradient)
    return (
        lines[0]
        if lines
        else f"{name}: up to {float(gradient.abs().max()):.3g}, whose square is not finite"
    )
