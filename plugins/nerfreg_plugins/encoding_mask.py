"""Encoding mask: coarse features first.

Source: FreeNeRF (Yang et al. 2023), on a hash grid in CombiNeRF (Bonotto et al. 2024).
"""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass, field, replace
from enum import StrEnum, auto
from typing import Any, ClassVar, no_type_check

import mpmath
import torch
from jaxtyping import Float
from torch import Tensor

from nerfreg import Regularizer, Samples, Step, hookimpl
from nerfreg_plugins.references import encoding_mask as reference


def active_features(count: int, ratio: float, fractional: bool = False) -> float:
    """Return how many of `count` features are kept.

    Args:
        count: Number of features.
        ratio: Share of them to keep; it is clipped to [0, 1].
        fractional: Keep count * ratio features, the last one in part, instead of rounding down.
    """
    kept = count * min(max(ratio, 0.0), 1.0)
    return kept if fractional else float(math.floor(kept))


def feature_mask(
    features: Float[Tensor, "points features"], ratio: float
) -> Float[Tensor, "points features"]:
    """Return the first floor(l * ratio) of the l features, with 0 in place of the rest.

    The plain version of what the core does with `active_features`, which never evaluates the rest.

    Args:
        features: `(P, l)`, coarsest first.
        ratio: Share to keep, in [0, 1].
    """
    count = features.shape[-1]
    kept = torch.arange(count, device=features.device) < active_features(count, ratio)
    return torch.where(kept, features, 0.0)


class MaskedNetwork(StrEnum):
    """Whose encoded input is masked: the grid's features, or those of the direction."""

    density = auto()
    color = auto()


@dataclass
class EncodingMask(Regularizer):
    """Coarse features first: encoded inputs are unmasked one by one (FreeNeRF, CombiNeRF).

    The kept ratio grows linearly from `initial` to 1 at the fraction `saturation` of the budget.

    Attributes:
        weight: There is no loss; 0 switches the mask off, anything else has no effect.
        networks: `density` masks the hash grid, `color` the direction features.
        initial: Share of the features that is kept at first; CombiNeRF has 0.
        saturation: Fraction of the budget at which all features are there: 0.9 where the cameras
            face forward, 0.2 on orbits; both are CombiNeRF's.
        fractional: Fade the next feature in instead of rounding down.
    """

    # Without any feature the density network is blind at first. The colour network then learns
    # colours of directions in a fog, which the rest of a short run does not undo: it costs 3 dB on
    # the procedural scene after 300 steps.
    networks: list[MaskedNetwork] = field(default_factory=lambda: [MaskedNetwork.density])
    initial: float = 0.25
    saturation: float = 0.9
    fractional: bool = False

    by_layout: ClassVar[dict[str, dict[str, Any]]] = {
        "forward": {"saturation": 0.9},
        "orbit": {"saturation": 0.2},
    }
    cite: ClassVar[str] = "yang2023freenerf"

    def ratio(self, fraction: float) -> float:
        """Return the share of features that is kept when this fraction of the budget is spent."""
        # Exactly 1, by which the hook knows that nothing is masked; the formula may round to less.
        if fraction >= self.saturation:
            return 1.0
        return self.initial + (1 - self.initial) * fraction / self.saturation

    @hookimpl(wrapper=True)
    @no_type_check  # a checker that wraps the generator would hide it from pluggy
    def nerfreg_encoder_input(self, step: Step) -> Generator[None, Samples, Samples]:
        samples = yield
        ratio = self.ratio(step.fraction)
        if ratio == 1.0:
            return samples
        if MaskedNetwork.density in self.networks:
            kept = active_features(samples.density_width, ratio, self.fractional)
            samples = replace(samples, density_features=kept)
        if MaskedNetwork.color in self.networks:
            kept = active_features(samples.color_width, ratio, self.fractional)
            samples = replace(samples, color_features=kept)
        return samples

    @hookimpl
    def nerfreg_reference(self, given: Any, step: Step) -> dict[str, Any] | None:
        ratio = self.ratio(step.fraction)
        if not isinstance(given, Samples) or ratio >= 1.0:
            return None
        widths = {"density": given.density_width, "color": given.color_width}
        kept = reference.fractional_features if self.fractional else reference.whole_features
        return {f"{name}_features": kept(widths[name], mpmath.mpf(ratio)) for name in self.networks}
