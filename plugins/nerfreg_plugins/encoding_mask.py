"""Encoding mask: coarse features first. Source: FreeNeRF (Yang et al. 2023), on a hash grid in CombiNeRF."""

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


def active_features(count: int, ratio: float, fractional: bool = False) -> float:
    """How many of `count` features are kept: floor(count * ratio), or count * ratio if `fractional`."""
    kept = count * min(max(ratio, 0.0), 1.0)
    return kept if fractional else float(math.floor(kept))


def feature_mask(
    features: Float[Tensor, "points features"], ratio: float
) -> Float[Tensor, "points features"]:
    """The first floor(l * ratio) of the l features, the rest 0. features: (P, l), coarsest first; ratio in [0, 1].

    The plain version of what the core does with `active_features`, which never evaluates the rest.
    """
    count = features.shape[-1]
    kept = torch.arange(count, device=features.device) < active_features(count, ratio)
    return torch.where(kept, features, 0.0)


class Network(StrEnum):
    """Whose encoded input is masked: the grid's features, or those of the direction."""

    density = auto()
    color = auto()


@dataclass
class EncodingMask(Regularizer):
    """Coarse features first: encoded inputs are unmasked one by one (FreeNeRF, CombiNeRF).

    The kept ratio grows linearly from `initial` to 1 at the fraction `saturation` of the budget. From 0, as the paper
    has it, the network is blind at first: it learns colours of directions in a fog, and that costs. networks: `density`
    masks the hash grid, `color` the direction features. fractional: fade the next feature in instead of rounding
    down. It returns no loss; `weight` only switches it off, by 0.
    """

    networks: list[Network] = field(default_factory=lambda: [Network.density])
    initial: float = 0.25
    saturation: float = 0.9
    fractional: bool = False

    by_layout: ClassVar[dict[str, dict[str, Any]]] = {
        "forward": {"saturation": 0.9},
        "orbit": {"saturation": 0.2},
    }
    cite: ClassVar[str] = "yang2023freenerf"

    def ratio(self, fraction: float) -> float:
        """Share of the features that is kept when this fraction of the budget is spent."""
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
        if Network.density in self.networks:
            kept = active_features(samples.density_width, ratio, self.fractional)
            samples = replace(samples, density_features=kept)
        if Network.color in self.networks:
            kept = active_features(samples.color_width, ratio, self.fractional)
            samples = replace(samples, color_features=kept)
        return samples

    @hookimpl
    def nerfreg_reference(self, given: Any, step: Step) -> dict[str, Any] | None:
        if not isinstance(given, Samples):
            return None
        ratio = mpmath.mpf(self.ratio(step.fraction))
        counts = {"density": given.density_width, "color": given.color_width}
        kept = {
            f"{network}_features": counts[network] * ratio for network in self.networks if ratio < 1
        }
        return {
            name: count if self.fractional else mpmath.floor(count) for name, count in kept.items()
        }
