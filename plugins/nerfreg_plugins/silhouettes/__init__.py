"""Space is empty outside of the silhouettes that photographs with alpha, or masks, show.

Source: Laurentini 1994, the visual hull. Here it decides where rays are sampled and which are
drawn; what it leaves is shaped by the photographs as before.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor, nn

from nerfreg import OccupancyGrid, Photographs, Regularizer, hookimpl
from nerfreg.errors import NerfregWarning, require_range
from nerfreg_plugins.silhouettes.hull import visual_hull
from nerfreg_plugins.silhouettes.views import silhouettes


class Cells(nn.Module):
    """The cells of the hull, as checkpoints hold them: one bit each.

    Attributes:
        bits: Eight cells in each byte, (n^3 / 8,).
        low: (3,) lowest corner of the grid.
        cell: () length of a cell, 0 as long as nothing is known.
    """

    bits: Tensor
    low: Tensor
    cell: Tensor

    def __init__(self, resolution: int) -> None:
        super().__init__()
        self.resolution = resolution
        self.register_buffer("bits", torch.zeros(-(-(resolution**3) // 8), dtype=torch.uint8))
        self.register_buffer("low", torch.zeros(3))
        self.register_buffer("cell", torch.zeros(()))
        self._made: tuple[object, OccupancyGrid | None] = (None, None)

    def fill(self, grid: OccupancyGrid) -> None:
        """Take over the cells of a grid of at most `resolution` cells along each side."""
        cube = torch.zeros((self.resolution,) * 3, dtype=torch.bool)
        x, y, z = grid.occupied.shape
        cube[:x, :y, :z] = grid.occupied
        flat = torch.zeros(8 * len(self.bits), dtype=torch.uint8)
        flat[: cube.numel()] = cube.flatten()
        self.bits.copy_((flat.view(-1, 8) << torch.arange(8, dtype=torch.uint8)).sum(dim=1))
        self.low.copy_(grid.low)
        self.cell.fill_(grid.cell)

    @property
    def grid(self) -> OccupancyGrid | None:
        """The cells, unpacked when they change; None as long as nothing is known."""
        # A checkpoint is restored into the buffers, and moving the field to a device replaces them.
        parts = (self.bits, self.low, self.cell)
        key = tuple((part._version, part.data_ptr(), part.device, part.dtype) for part in parts)
        if key != self._made[0]:
            self._made = (key, self._unpacked())
        return self._made[1]

    def _unpacked(self) -> OccupancyGrid | None:
        cell = float(self.cell)
        if cell == 0:
            return None
        places = torch.arange(8, dtype=torch.uint8, device=self.bits.device)
        flat = (self.bits[:, None] >> places) & 1
        cells = flat.flatten()[: self.resolution**3].bool()
        return OccupancyGrid(cells.view((self.resolution,) * 3), self.low.clone(), cell)


@dataclass
class Silhouettes(Regularizer):
    """Space is empty outside of the visual hull of all silhouettes.

    It is not sampled, and pixels whose rays meet no cell of the hull are not drawn. Photographs
    without alpha and masks show no silhouettes; then the plugin does nothing, and says so.

    Attributes:
        weight: There is no loss; 0 switches it off, anything else has no effect.
        resolution: Cells along the longest side of the hull.
        alpha: Pixels of more alpha than this belong to a silhouette.
        margin: By how many pixels silhouettes are grown, rounded up, in case what lies between the
            centres of pixels is seen by none.
        frame: Whether space outside of an image is empty if its silhouette, grown, does not touch
            the border. It is not for a thing in several pieces that some photographs show in part.
    """

    resolution: int = 192
    alpha: float = 0.01
    margin: float = 1.0
    frame: bool = True

    cite: ClassVar[str] = "laurentini1994hull"

    def __post_init__(self) -> None:
        require_range(
            "reg.silhouettes", self, resolution=(8, 512), alpha=(0.0, 1.0), margin=(0.0, 1e3)
        )

    @hookimpl
    def nerfreg_module(self) -> nn.Module:
        self._cells = Cells(self.resolution)
        return self._cells

    @hookimpl
    def nerfreg_prepare(self, photographs: Photographs) -> dict[str, Tensor]:
        covered = silhouettes(photographs, self.alpha)
        if covered is None:
            self._say("neither alpha nor masks of the photographs show a silhouette")
            return {}
        grid = visual_hull(photographs, covered, self.resolution, self.margin, self.frame)
        if grid is None:
            self._say(
                "the silhouettes contradict each other, by more than reg.silhouettes.margin="
                f"{self.margin:g} pixels; check poses and masks"
            )
            return {}
        self._cells.fill(grid)
        return {}

    @hookimpl
    def nerfreg_occupancy(self) -> OccupancyGrid | None:
        return self._cells.grid

    def _say(self, why: str) -> None:
        warnings.warn(f"reg.{self.instance}: does nothing: {why}", NerfregWarning, stacklevel=2)
