"""Logarithms of opacities, without cancellation."""

from __future__ import annotations

import math

import torch
from jaxtyping import Float
from torch import Tensor

MIN_OPACITY = 1e-4
"""Rays below this opacity are empty: their depth is `far`, and no depth or distribution term counts them."""


def log_alpha(tau: Float[Tensor, "*any"]) -> Float[Tensor, "*any"]:
    """log(1 - exp(-tau)) for optical thickness tau >= 0, exact for thin and thick; -inf with gradient 0 at 0.

    The two branches are those of Maechler, "Accurately computing log(1 - exp(-|a|))" (2012).
    """
    positive = tau > 0
    safe = torch.where(positive, tau, torch.ones_like(tau))
    thin = safe < math.log(2)
    one = torch.ones_like(safe)
    log_thin = torch.log(-torch.expm1(-torch.where(thin, safe, one)))
    log_thick = torch.log1p(-torch.exp(-torch.where(thin, one, safe)))
    return torch.where(positive, torch.where(thin, log_thin, log_thick), tau.new_tensor(-torch.inf))
