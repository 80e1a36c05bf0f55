"""What to render in a step: random pixels, patches, neighbours and unseen views, as the plugins need."""

from nerfreg.rays.batches import RayBatches

__all__ = ["RayBatches"]
