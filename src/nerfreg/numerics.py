"""Accurate arithmetic: input precision, logarithms of opacities, cancelling sums, exact numbers.

docs/numerics.md says what loses accuracy without these functions, and by how much.
"""

from __future__ import annotations

import math
from typing import Any

import mpmath
import torch
from jaxtyping import Float
from torch import Tensor

MIN_OPACITY = 1e-4
"""Rays below this opacity are empty.

Their depth is `far`, and no term on depth or on the distribution along the ray counts them: both
are quotients by the opacity and mean nothing where it is almost 0.
"""


def single(x: Float[Tensor, "*any"]) -> Float[Tensor, "*any"]:
    """Return half precision as float32, and float32 and float64 as they are."""
    return x.float() if x.dtype in (torch.float16, torch.bfloat16) else x


def double(x: Float[Tensor, "*any"]) -> Float[Tensor, "*any"]:
    """Return float64, for small differences of large numbers.

    On devices without float64, which is Apple's GPU, the result is float32.
    """
    return x.float() if x.device.type == "mps" else x.double()


def of_rays(name: str, x: Tensor, axes: int, samples: int | None = None) -> Tensor:
    """Return a tensor without the last axis of length 1 that other programs' tensors have.

    Args:
        name: Name of the tensor, for the message.
        x: A tensor with `axes` axes, or with one more of length 1.
        axes: How many axes the result has.
        samples: Length of its last axis; None: any.

    Raises:
        ValueError: The tensor has another shape.
    """
    flat = x[..., 0] if x.ndim == axes + 1 and x.shape[-1] == 1 else x
    if flat.ndim != axes or samples not in (None, flat.shape[-1]):
        length = "" if samples is None else f", the last of them of length {samples}"
        raise ValueError(f"{name} has shape {tuple(x.shape)}, not {axes} axes{length}")
    return flat


def ray_samples(weights: Tensor, t_edges: Tensor) -> tuple[Tensor, Tensor]:
    """Return weights (R, N) and their interval borders (R, N+1), both checked.

    Args:
        weights: (R, N), or (R, N, 1).
        t_edges: (R, N+1), or (R, N+1, 1).

    Raises:
        ValueError: They have other shapes, or do not fit.
    """
    weights = of_rays("weights", weights, 2)
    return weights, of_rays("t_edges", t_edges, 2, weights.shape[1] + 1)


def log_alpha(tau: Float[Tensor, "*any"]) -> Float[Tensor, "*any"]:
    """Return log(1 - exp(-tau)), accurate for thin and for thick intervals.

    The two branches are those of Maechler, "Accurately computing log(1 - exp(-|a|))" (2012).

    Args:
        tau: Optical thickness, at least 0. Below the smallest normal number it counts as 0.

    Returns:
        The logarithm of the opacity; -inf, with gradient 0, where tau counts as 0.
    """
    tau = single(tau)
    # The gradient is about 1 / tau for small tau, which overflows below the smallest normal number.
    positive = tau >= torch.finfo(tau.dtype).tiny
    # Every branch is computed for all elements, and the gradient of one that `where` discards is
    # multiplied by 0, which makes NaN of an infinite one. So each branch gets a harmless argument
    # in place of those that it is not meant for.
    safe = torch.where(positive, tau, torch.ones_like(tau))
    # Below log 2 the opacity is less than 1/2 and 1 - exp(-tau) cancels, which expm1 avoids; above
    # it the opacity is close to 1 and its logarithm is close to 0, which log1p resolves.
    thin = safe < math.log(2)
    one = torch.ones_like(safe)
    log_thin = torch.log(-torch.expm1(-torch.where(thin, safe, one)))
    log_thick = torch.log1p(-torch.exp(-torch.where(thin, one, safe)))
    return torch.where(positive, torch.where(thin, log_thin, log_thick), tau.new_tensor(-torch.inf))


@torch.no_grad()
def one_minus_sum(x: Float[Tensor, "rays samples"]) -> Float[Tensor, " rays"]:
    """Return 1 - sum x of each row, accurate where the sum is almost 1; without a gradient.

    Terms are added in pairs, and what each addition rounds away is added up separately (two-sum;
    Knuth, The Art of Computer Programming, volume 2, section 4.2.2).

    Args:
        x: (R, N) terms.

    Returns:
        (R,) the differences.
    """
    # The 1 is a term like the others. Subtracted at the end, it would meet a sum that has already
    # been rounded to 1.
    total = torch.cat([x.new_ones(len(x), 1), -x], dim=1)
    lost = torch.zeros_like(total)
    while total.shape[1] > 1:
        if total.shape[1] % 2:
            total, lost = (torch.nn.functional.pad(part, (0, 1)) for part in (total, lost))
        a, b = total[:, ::2], total[:, 1::2]
        total = a + b
        # The two brackets are what is missing of a and of b in the rounded sum. In exact arithmetic
        # both are 0, so that simplifying this would remove it; it holds for any order of magnitude.
        part = total - a
        lost = lost[:, ::2] + lost[:, 1::2] + ((a - (total - part)) + (b - part))
    return (total + lost)[:, 0]


def exact(values: Float[Tensor, "*any"]) -> Any:
    """Return the numbers of a tensor as (nested lists of) mpmath numbers.

    `nerfreg_reference` computes its exact values from these.
    """

    def convert(value: Any) -> Any:
        return [convert(item) for item in value] if isinstance(value, list) else mpmath.mpf(value)

    # Every number of a smaller type is also a float64, so that nothing is rounded here.
    return convert(values.detach().double().tolist())


def not_finite(name: str, values: Tensor) -> list[str]:
    """Describe the values of a tensor that are not finite.

    Args:
        name: Name of the tensor, for the message.
        values: Values of any shape.

    Returns:
        One line with the number of such values and the first of them; none if all are finite.
    """
    values = values.detach()
    bad = (~values.isfinite()).nonzero()
    if len(bad) == 0:
        return []
    place = tuple(int(index) for index in bad[0])
    first = float(values[place])
    if not place:
        return [f"{name} is {first}"]
    count = f"{len(bad)} of {values.numel()} values not finite"
    return [f"{name}: {count}, the first at {list(place)}: {first}"]
