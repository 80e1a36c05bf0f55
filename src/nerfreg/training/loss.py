"""The loss of a step: the colour error that every run has, and the terms of the plugins."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg.hooks import Rendering, Step
from nerfreg.registry import Hooks, Term

COLOR = "color"
"""Name of the loss term that every run has: the mean squared error of the colours."""


def loss_terms(rendering: Rendering, hooks: Hooks, step: Step) -> list[Term]:
    """Return all terms of a loss, unweighted, the colour error first."""
    return [Term(COLOR, COLOR, 1.0, color_error(rendering)), *hooks.losses(rendering, step)]


def total_loss(terms: Sequence[Term]) -> Float[Tensor, ""]:
    """Return the sum of weight times value."""
    return torch.stack([term.weight * term.value for term in terms]).sum()


def label(term: Term) -> str:
    """Return a term's name in reports: `plugin.term`, or the plugin's if the term has the same."""
    return term.name if term.name == term.plugin else f"{term.plugin}.{term.name}"


def color_error(rendering: Rendering) -> Float[Tensor, ""]:
    """Return the mean squared error of the rays that have a target.

    Each ray is weighted by `Rays.target_weights`, where there are any.
    """
    rays = rendering.rays
    # Rays with a target come first; extra neighbours and unseen views follow them.
    errors = (rendering.rgb[: len(rays.targets)] - rays.targets).square().mean(dim=1)
    return errors.mean() if rays.target_weights is None else (rays.target_weights * errors).mean()
