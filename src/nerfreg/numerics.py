"""What keeps digits: precision of inputs, logarithms of opacities, sums that cancel, exact numbers to compare with."""

from __future__ import annotations

import math
from typing import Any

import mpmath
import torch
from jaxtyping import Float
from torch import Tensor

MIN_OPACITY = 1e-4
"""Rays below this opacity are empty: their depth is `far`, and no depth or distribution term counts them."""


def single(x: Float[Tensor, "*any"]) -> Float[Tensor, "*any"]:
    """Half precision as float32; float32 and float64 as they are."""
    return x.float() if x.dtype in (torch.float16, torch.bfloat16) else x


def double(x: Float[Tensor, "*any"]) -> Float[Tensor, "*any"]:
    """As float64, where small differences of large numbers count; as float32 on devices that know no float64."""
    return x.float() if x.device.type == "mps" else x.double()


def log_alpha(tau: Float[Tensor, "*any"]) -> Float[Tensor, "*any"]:
    """log(1 - exp(-tau)) for optical thickness tau >= 0, exact for thin and thick.

    Below the smallest normal number tau counts as 0: the result is -inf, with gradient 0, since 1 / tau would overflow.
    The two branches are those of Maechler, "Accurately computing log(1 - exp(-|a|))" (2012).
    """
    tau = single(tau)
    positive = tau >= torch.finfo(tau.dtype).tiny
    safe = torch.where(positive, tau, torch.ones_like(tau))
    thin = safe < math.log(2)
    one = torch.ones_like(safe)
    log_thin = torch.log(-torch.expm1(-torch.where(thin, safe, one)))
    log_thick = torch.log1p(-torch.exp(-torch.where(thin, one, safe)))
    return torch.where(positive, torch.where(thin, log_thin, log_thick), tau.new_tensor(-torch.inf))


@torch.no_grad()
def one_minus_sum(x: Float[Tensor, "rays samples"]) -> Float[Tensor, " rays"]:
    """1 - sum x of each row, (R,), exact where the sum is almost 1; no gradient.

    Added up in pairs; what each addition rounds away (Knuth, The Art of Computer Programming, 4.2.2) is kept.
    """
    total = torch.cat([x.new_ones(len(x), 1), -x], dim=1)
    lost = torch.zeros_like(total)
    while total.shape[1] > 1:
        if total.shape[1] % 2:
            total, lost = (torch.nn.functional.pad(part, (0, 1)) for part in (total, lost))
        a, b = total[:, ::2], total[:, 1::2]
        total = a + b
        part = total - a
        lost = lost[:, ::2] + lost[:, 1::2] + ((a - (total - part)) + (b - part))
    return (total + lost)[:, 0]


def exact(values: Float[Tensor, "*any"]) -> Any:
    """The numbers of a tensor as (nested lists of) mpmath numbers, for `nerfreg_reference`."""

    def convert(value: Any) -> Any:
        return [convert(item) for item in value] if isinstance(value, list) else mpmath.mpf(value)

    return convert(values.detach().double().tolist())


def not_finite(name: str, values: Tensor) -> list[str]:
    """One line with how many of the values, of any shape, are not finite, and the first of them; none if all are."""
    values = values.detach()
    bad = (~values.isfinite()).nonzero()
    if len(bad) == 0:
        return []
    place = tuple(int(index) for index in bad[0])
    first = float(values[place])
    if not place:
        return [f"{name} is {first}"]
    return [
        f"{name}: {len(bad)} of {values.numel()} values not finite, the first at {list(place)}: {first}"
    ]
