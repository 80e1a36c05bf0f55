"""Nothing is outside of the visual hull of the silhouettes (Laurentini 1994)."""

import math
from dataclasses import dataclass
from typing import ClassVar

import torch

from nerfreg import NerfregError, OccupancyGrid, Regularizer, hookimpl

BIBTEX = """@article{laurentini1994hull, author = {Laurentini, Aldo}, year = {1994},
  title = {The Visual Hull Concept for Silhouette-Based Image Understanding},
  journal = {IEEE Transactions on Pattern Analysis and Machine Intelligence}}"""


@dataclass
class Hull(Regularizer):
    """Space is empty where a training view is transparent; rays are not sampled there.

    Attributes:
        weight: There is no loss; 0 switches it off, anything else has no effect.
        resolution: Cells along each side of the cube around the box.
    """

    resolution: int = 128

    cite: ClassVar[str] = BIBTEX

    @hookimpl
    def nerfreg_module(self, scene_info):
        self._cells = torch.nn.Module()
        self._cells.register_buffer("occupied", torch.ones((self.resolution,) * 3) > 0)
        self._scene, self._grid = scene_info, None
        return self._cells

    @hookimpl
    def nerfreg_prepare(self, photographs):
        if photographs.images.shape[-1] < 4:
            raise NerfregError("reg.hull: the photographs have no alpha channel")
        cameras, grid = photographs.cameras, self.nerfreg_occupancy()
        centers, radius = grid.centers.view(-1, 3).cpu(), grid.cell * math.sqrt(3) / 2
        kept = torch.ones(len(centers), dtype=torch.bool)
        for view, image in enumerate(photographs.images):
            depth = (centers - cameras.positions[view]) @ cameras.axes[view]
            x, y = cameras.project(centers, view).unbind(dim=1)
            shown = (x >= 0) & (x < cameras.width) & (y >= 0) & (y < cameras.height)
            shown &= depth > 2 * radius
            # No cell reaches further in pixels; one that is not transparent keeps the cell.
            size = cameras.focal[view].max() * radius / (depth[shown].min() - radius)
            reach = math.ceil(float(size))
            pooled = torch.nn.functional.max_pool2d(image[None, ..., 3], 2 * reach + 1, 1, reach)[0]
            kept[shown] &= pooled[y[shown].long(), x[shown].long()] > 0
        self._cells.occupied = kept.view_as(grid.occupied).to(grid.occupied.device)

    @hookimpl
    def nerfreg_occupancy(self):
        occupied, scene = self._cells.occupied, self._scene
        if self._grid is None or self._grid.occupied is not occupied:
            self._grid = OccupancyGrid.over(scene.center, scene.half_box, occupied)
        return self._grid
