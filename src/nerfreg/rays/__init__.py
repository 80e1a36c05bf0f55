"""What to render in a step: random pixels, and the patches and unseen views that plugins need."""

from nerfreg.rays.batches import RayBatches

__all__ = ["RayBatches"]
