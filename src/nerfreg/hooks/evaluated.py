"""A rendered view beside its photograph, for metrics of plugins."""

from __future__ import annotations

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class EvaluatedView:
    """A test view at full size.

    Attributes:
        label: Name of the view.
        pose: (3, 4) camera-to-world matrix.
        rgb: (H, W, 3) rendered colours in [0, 1].
        depth: (H, W) rendered distance along the rays, in world units; `far` where they are empty.
        opacity: (H, W) rendered opacity.
        target: (H, W, 3) the photograph in [0, 1], on the same background.
        true_depth: (H, W) true distance along the rays, inf where there is nothing; None where it
            is not known.
    """

    label: str
    pose: Float[Tensor, "3 4"]
    rgb: Float[Tensor, "height width 3"]
    depth: Float[Tensor, "height width"]
    opacity: Float[Tensor, "height width"]
    target: Float[Tensor, "height width 3"]
    true_depth: Float[Tensor, "height width"] | None = None
