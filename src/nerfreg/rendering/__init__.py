"""Where to sample along rays, and how samples become a pixel; nothing here knows a loss."""

from nerfreg.rendering.compositing import Composite, composite
from nerfreg.rendering.config import SamplerConfig

__all__ = ["Composite", "SamplerConfig", "composite"]
