"""What happens at each hook point when no plugin is there."""

from __future__ import annotations

from torch import Tensor, nn

from nerfreg.field.layers import Linear
from nerfreg.hooks import DensitySamples, Rays, Rendering, Samples, hookimpl


class CoreDefaults:
    """What happens at each hook point when no plugin is there."""

    @hookimpl(trylast=True)
    def nerfreg_layer(self, in_features: int, out_features: int, activation: str) -> nn.Module:
        """Make a plain linear layer without bias."""
        return Linear(in_features, out_features, activation)

    @hookimpl(trylast=True)
    def nerfreg_ray_bounds(self, rays: Rays) -> tuple[Tensor, Tensor]:
        """Return the bounds that the rays have."""
        return rays.near, rays.far

    @hookimpl(trylast=True)
    def nerfreg_rays(self, rays: Rays) -> Rays:
        """Return the rays as they are."""
        return rays

    @hookimpl(trylast=True)
    def nerfreg_encoder_input(self, samples: Samples) -> Samples:
        """Return the samples as they are."""
        return samples

    @hookimpl(trylast=True)
    def nerfreg_density(self, samples: DensitySamples) -> Tensor:
        """Return the densities as they are."""
        return samples.density

    @hookimpl(trylast=True)
    def nerfreg_rendering(self, rendering: Rendering) -> Rendering:
        """Return the rendering as it is."""
        return rendering
